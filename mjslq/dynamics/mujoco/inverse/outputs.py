"""What the kernel of the inverse Jacobians has to know about a model's sensors.

Sensors that costs are made of have derivatives in closed form (`sensors`). When a model has others,
readings are differenced (mjd_transitionFD, C and D alone), and the closed forms put over that where there are some.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse import columns
from mjslq.dynamics.mujoco.inverse.plan import ON_JOINTS, SCALAR, TRN, tendon_dofs, whole
from mjslq.dynamics.mujoco.inverse.remainder import Remainder, is_spatial, remainder

_SENSOR, _OBJECT = whole(mujoco.mjtSensor), whole(mujoco.mjtObj)
TYPES = {int(kind): name.removeprefix("mjSENS_").lower() for name, kind in mujoco.mjtSensor.__members__.items()}
"""Names of the types of sensors."""
_ON_DOFS = {
    _SENSOR.mjSENS_JOINTPOS: columns.JOINT_POS,
    _SENSOR.mjSENS_JOINTVEL: columns.JOINT_VEL,
    _SENSOR.mjSENS_JOINTACTFRC: columns.JOINT_FORCE,
    _SENSOR.mjSENS_BALLQUAT: columns.BALL_QUAT,
    _SENSOR.mjSENS_BALLANGVEL: columns.BALL_VEL,
}
_ON_TENDONS = {_SENSOR.mjSENS_TENDONPOS: columns.TENDON_POS, _SENSOR.mjSENS_TENDONVEL: columns.TENDON_VEL}
_ON_ACTUATORS = {_SENSOR.mjSENS_ACTUATORPOS: columns.ACTUATOR_POS, _SENSOR.mjSENS_ACTUATORVEL: columns.ACTUATOR_VEL}
_ON_FRAMES = {
    _SENSOR.mjSENS_FRAMEPOS: columns.FRAME_POS,
    _SENSOR.mjSENS_FRAMEQUAT: columns.FRAME_QUAT,
    _SENSOR.mjSENS_FRAMEXAXIS: columns.FRAME_AXIS,
    _SENSOR.mjSENS_FRAMEYAXIS: columns.FRAME_AXIS,
    _SENSOR.mjSENS_FRAMEZAXIS: columns.FRAME_AXIS,
    _SENSOR.mjSENS_FRAMELINVEL: columns.FRAME_VEL,
    _SENSOR.mjSENS_FRAMEANGVEL: columns.FRAME_TURN,
    _SENSOR.mjSENS_VELOCIMETER: columns.LOCAL_VEL,
    _SENSOR.mjSENS_GYRO: columns.LOCAL_TURN,
}
_AXES = {_SENSOR.mjSENS_FRAMEXAXIS: 0, _SENSOR.mjSENS_FRAMEYAXIS: 1, _SENSOR.mjSENS_FRAMEZAXIS: 2}
_ON_SUBTREES = {
    _SENSOR.mjSENS_SUBTREECOM: columns.SUBTREE_COM,
    _SENSOR.mjSENS_SUBTREELINVEL: columns.SUBTREE_VEL,
    _SENSOR.mjSENS_SUBTREEANGMOM: columns.SUBTREE_TURN,
}


def sensor_kind(model: mujoco.MjModel, s: int, rest: Remainder) -> int:
    """Kind of sensor s; BY_DIFFERENCES when there is no closed form for it, or for the force it reads."""
    kind, target = int(model.sensor_type[s]), int(model.sensor_objid[s])
    if model.sensor_cutoff[s] > 0:
        return columns.BY_DIFFERENCES
    if kind in _ON_DOFS:
        shared = model.jnt_actgravcomp[target] or (model.actuator_trntype == TRN.mjTRN_SITE).any()
        unknown = kind == _SENSOR.mjSENS_JOINTACTFRC and (shared or (rest.actuators | rest.swinging).any())
        return columns.BY_DIFFERENCES if unknown else _ON_DOFS[kind]
    if kind in _ON_TENDONS:
        return _ON_TENDONS[kind] if len(tendon_dofs(model, target)[0]) else columns.BY_DIFFERENCES
    if kind == _SENSOR.mjSENS_ACTUATORFRC:
        known = _has_row(model) and not (rest.actuators | rest.swinging)[target]
        return columns.ACTUATOR_FORCE if known else columns.BY_DIFFERENCES
    if kind in _ON_ACTUATORS:
        return _ON_ACTUATORS[kind] if _has_length(model, target) else columns.BY_DIFFERENCES
    if kind in _ON_FRAMES:
        known = _frame(model, int(model.sensor_objtype[s]), target) is not None
        known = known and _frame(model, int(model.sensor_reftype[s]), int(model.sensor_refid[s])) is not None
        return _ON_FRAMES[kind] if known else columns.BY_DIFFERENCES
    if kind in _ON_SUBTREES:
        about_world = kind == _SENSOR.mjSENS_SUBTREEANGMOM and target == 0
        return columns.BY_DIFFERENCES if about_world else _ON_SUBTREES[kind]
    return columns.BY_DIFFERENCES


def sensors(model: mujoco.MjModel) -> dict[str, Any]:
    """Kinds, addresses, targets and frames of the sensors."""
    count = model.nsensor
    rest = remainder(model)
    kinds = np.array([sensor_kind(model, s, rest) for s in range(count)], np.int64)
    target, body, reference = np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros(count, np.int64)
    prm = np.zeros((count, columns.FRAME_NUMBERS))
    for s, kind in enumerate(kinds):
        of, to = int(model.sensor_objid[s]), int(model.sensor_type[s])
        target[s] = of
        if to in _ON_DOFS:
            target[s] = model.jnt_dofadr[of]
        elif to in _ON_SUBTREES:
            body[s] = of
        elif kind != columns.BY_DIFFERENCES and to in _ON_FRAMES:
            target[s] = _AXES.get(to, 0)
            frame = _frame(model, int(model.sensor_objtype[s]), of)
            other = _frame(model, int(model.sensor_reftype[s]), int(model.sensor_refid[s]))
            assert frame is not None and other is not None
            body[s], reference[s] = frame[0], other[0]
            prm[s] = np.concatenate([frame[1], frame[2], other[1], other[2]])
    return {
        "nsensor": count, "sen_kind": kinds, "sen_adr": model.sensor_adr, "sen_target": target, "sen_body": body,
        "sen_reference": reference, "sen_prm": prm, "sensors_differenced": int((kinds == columns.BY_DIFFERENCES).any()),
        "body_subtreemass": model.body_subtreemass,
    }  # fmt: skip


def _has_length(model: mujoco.MjModel, i: int) -> bool:
    """Whether the length of actuator i is linear in the joints' positions."""
    kind, target = model.actuator_trntype[i], model.actuator_trnid[i, 0]
    if not _has_row(model):
        return False
    if kind == TRN.mjTRN_TENDON:
        return not is_spatial(model, target)
    return bool(kind in ON_JOINTS and model.jnt_type[target] in SCALAR)


def _has_row(model: mujoco.MjModel) -> bool:
    """Whether actuators, controls and forces are numbered alike."""
    return bool(model.nactuator == model.nu == model.nout)


def _frame(model: mujoco.MjModel, kind: int, index: int) -> tuple[int, Any, Any] | None:
    """Body, place and orientation in it of a frame; None for cameras and other things, the world for none at all."""
    if kind == _OBJECT.mjOBJ_UNKNOWN or index < 0:
        return 0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    if kind == _OBJECT.mjOBJ_XBODY:
        return index, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    if kind == _OBJECT.mjOBJ_BODY:
        return index, model.body_ipos[index], model.body_iquat[index]
    if kind == _OBJECT.mjOBJ_GEOM:
        return int(model.geom_bodyid[index]), model.geom_pos[index], model.geom_quat[index]
    if kind == _OBJECT.mjOBJ_SITE:
        return int(model.site_bodyid[index]), model.site_pos[index], model.site_quat[index]
    return None
