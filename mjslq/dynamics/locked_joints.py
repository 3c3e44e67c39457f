"""Joints that are fixed at a position: how they are given, and how a MuJoCo specification loses them.

Stands beside the engines, so that a model for MuJoCo needs no Pinocchio, and the other way round.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.validation import as_array, choose

if TYPE_CHECKING:
    import mujoco

LockedJoints = Sequence[str] | Mapping[str, float]
"""Names of joints that are fixed at zero, or a mapping from names to positions. [rad or m]"""


def locked_positions(joints: LockedJoints | None) -> dict[str, float]:
    """Joints to lock, and where. [rad or m]"""
    if isinstance(joints, str):
        raise ValueError(f"locked_joints must be a sequence of names, got the text {joints!r}; write ({joints!r},)")
    if isinstance(joints, Mapping):
        return {name: float(as_array(f"locked_joints[{name!r}]", value, ())) for name, value in joints.items()}
    return dict.fromkeys(joints or (), 0.0)


def lock_spec(spec: mujoco.MjSpec, joints: LockedJoints | None) -> None:
    """Weld joints of a MuJoCo specification of a URDF at zero, or at the positions given."""
    import mujoco

    for name, position in locked_positions(joints).items():
        joint = spec.joint(choose("joint to lock", name, (joint.name for joint in spec.joints)))
        body, turn = joint.parent, np.zeros(4)
        if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
            along = np.zeros(3)
            mujoco.mju_rotVecQuat(along, np.asarray(joint.axis), np.asarray(body.quat))
            body.pos = np.asarray(body.pos) + position * along
        elif joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            mujoco.mju_axisAngle2Quat(turn, np.asarray(joint.axis) / np.linalg.norm(joint.axis), position)
            turned = np.zeros(4)
            mujoco.mju_mulQuat(turned, np.asarray(body.quat), turn)
            body.quat = turned
        for element in _attached(spec, name):
            spec.delete(element)
        spec.delete(joint)


def _attached(spec: mujoco.MjSpec, joint: str) -> Iterable[Any]:
    """Motors of a joint, and equalities that tie it to another."""
    yield from [actuator for actuator in spec.actuators if actuator.target == joint]
    yield from [equality for equality in spec.equalities if joint in (equality.name1, equality.name2)]
