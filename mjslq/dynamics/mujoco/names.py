"""Names of the entries of states, controls and outputs, made of the names in the model, and the controls' limits."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.dynamics import Output
from mjslq.validation import Array

_POSITIONS = {
    mujoco.mjtJoint.mjJNT_FREE: (".x", ".y", ".z", ".qw", ".qx", ".qy", ".qz"),
    mujoco.mjtJoint.mjJNT_BALL: (".qw", ".qx", ".qy", ".qz"),
    mujoco.mjtJoint.mjJNT_SLIDE: ("",),
    mujoco.mjtJoint.mjJNT_HINGE: ("",),
}
_VELOCITIES = {
    mujoco.mjtJoint.mjJNT_FREE: (".vx", ".vy", ".vz", ".wx", ".wy", ".wz"),
    mujoco.mjtJoint.mjJNT_BALL: (".wx", ".wy", ".wz"),
    mujoco.mjtJoint.mjJNT_SLIDE: (".vel",),
    mujoco.mjtJoint.mjJNT_HINGE: (".vel",),
}


def state_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of x: positions "hip", "root.qw"; velocities "hip.vel", "root.wx"; activations "muscle.act"."""
    positions, velocities = [], []
    for j in range(model.njnt):
        name, kind = _name(model.joint(j), "joint"), mujoco.mjtJoint(model.jnt_type[j])
        positions += [name + end for end in _POSITIONS[kind]]
        velocities += [name + end for end in _VELOCITIES[kind]]
    activations: list[str] = []
    for a in range(model.nactuator):
        if model.actuator_actnum[a] > 0:
            activations += _numbered(_name(model.actuator(a), "actuator") + ".act", int(model.actuator_actnum[a]))
    return (*positions, *velocities, *activations)


def control_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of u: the actuators, with their inputs when they have several: "wrist.rx"."""
    names: list[str] = []
    for a in range(model.nactuator):
        name, count = _name(model.actuator(a), "actuator"), int(model.actuator_ctrlnum[a])
        inputs = [mujoco.mj_actuatorInputName(model, a, k) or str(k) for k in range(count)]
        names += [name] if count == 1 else [f"{name}.{given}" for given in inputs]
    return tuple(names)


def control_limits(model: mujoco.MjModel) -> Array:
    """Range that MuJoCo clamps each control to; -inf and inf where it does not. Shape (nu, 2)."""
    clamped = np.asarray(model.actuator_ctrllimited, dtype=bool)
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL):
        clamped = np.zeros_like(clamped)
    limits: Array = np.where(clamped[:, None], model.actuator_ctrlrange, [-np.inf, np.inf])
    return limits


def joint_ranges(model: mujoco.MjModel) -> dict[str, tuple[float, float]]:
    """Ranges of the joints with one axis that have one."""
    one_axis = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
    joints = [j for j in range(model.njnt) if model.jnt_limited[j] and mujoco.mjtJoint(model.jnt_type[j]) in one_axis]
    return {
        _name(model.joint(j), "joint"): (float(model.jnt_range[j, 0]), float(model.jnt_range[j, 1])) for j in joints
    }


def output_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of y: a sensor's own name, with an index when it has several readings: "hand[0]"."""
    names: list[str] = []
    for s in range(model.nsensor):
        names += _numbered(_name(model.sensor(s), "sensor"), int(model.sensor_dim[s]))
    return tuple(names)


def outputs(model: mujoco.MjModel) -> dict[str, Output]:
    """Sensors by name, and where their readings stand in y."""
    quaternions = (mujoco.mjtSensor.mjSENS_FRAMEQUAT, mujoco.mjtSensor.mjSENS_BALLQUAT)
    found = {}
    for s in range(model.nsensor):
        start = int(model.sensor_adr[s])
        columns = slice(start, start + int(model.sensor_dim[s]))
        found[_name(model.sensor(s), "sensor")] = Output(columns, mujoco.mjtSensor(model.sensor_type[s]) in quaternions)
    return found


def places(model: mujoco.MjModel) -> frozenset[str]:
    """Names of the sensors that read a point in the world."""
    points = (mujoco.mjtSensor.mjSENS_FRAMEPOS, mujoco.mjtSensor.mjSENS_SUBTREECOM)
    found = [s for s in range(model.nsensor) if mujoco.mjtSensor(model.sensor_type[s]) in points]
    return frozenset(_name(model.sensor(s), "sensor") for s in found if model.sensor_refid[s] < 0)


def model_name(model: mujoco.MjModel) -> str | None:
    """Return the name in the model itself; None when it has only MuJoCo's default."""
    name = bytes(model.names).split(b"\0", 1)[0].decode(errors="replace")
    return None if name in ("", "MuJoCo Model") else name


def _name(element: Any, kind: str) -> str:
    return element.name or f"{kind}{element.id}"


def _numbered(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name}[{i}]" for i in range(count)]
