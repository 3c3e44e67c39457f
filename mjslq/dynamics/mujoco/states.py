"""The state space of a MuJoCo model: its differences are those of mj_differentiatePos and mj_integratePos."""

from __future__ import annotations

import mujoco
import numpy as np

from mjslq.lie_groups import ROTATION
from mjslq.manifold import StateSpace
from mjslq.validation import Array


def state_space(model: mujoco.MjModel) -> StateSpace:
    """State space of x = (qpos, qvel, act), with a rotation in each free joint, behind its position, and ball joint."""
    rotations = []
    for j in range(model.njnt):
        kind, x, dx = model.jnt_type[j], int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            rotations.append((ROTATION, range(x + 3, x + 7), range(dx + 3, dx + 6)))
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            rotations.append((ROTATION, range(x, x + 4), range(dx, dx + 3)))
    return StateSpace.of(model.nq + model.nv + model.na, 2 * model.nv + model.na, rotations)


def reset_controls(model: mujoco.MjModel) -> Array:
    """Controls of a new mjData: zero, but quaternions at the identity. Shape (nu,)."""
    return np.array(mujoco.MjData(model).ctrl)
