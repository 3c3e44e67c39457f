"""Which models have second derivatives in closed form, and what serves their sensors."""

from __future__ import annotations

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.forces.unmodelled_forces import is_spatial, unmodelled_forces
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.columns import CLOSED, DIFFERENCED, FLAT, OPEN
from mjslq.dynamics.mujoco.inverse.table.fluid_plan import in_fluid
from mjslq.dynamics.mujoco.inverse.table.plan import (
    BIAS,
    DYN,
    GAIN,
    GEOM,
    INT,
    Table,
    can_be_constrained,
    has_contacts,
)
from mjslq.validation import Array

_LINEAR = (
    columns.CONSTANT, columns.JOINT_POS, columns.JOINT_VEL, columns.TENDON_POS, columns.TENDON_VEL,
    columns.ACTUATOR_POS, columns.ACTUATOR_VEL, columns.BALL_VEL,
)  # fmt: skip
_MOTIONS = (
    columns.BALL_QUAT, columns.FRAME_POS, columns.FRAME_QUAT, columns.FRAME_AXIS, columns.FRAME_VEL,
    columns.FRAME_TURN, columns.LOCAL_VEL, columns.LOCAL_TURN, columns.LOCAL_FIELD, columns.SUBTREE_COM,
    columns.SUBTREE_VEL, columns.SUBTREE_TURN,
)  # fmt: skip


def reasons(model: mujoco.MjModel) -> list[str]:
    """What `model`, which the inverse Jacobians cover, has that its second derivatives do not; empty when nothing."""
    return [reason for is_so, reason in _REASONS if is_so(model)]


def _odd_forces(model: mujoco.MjModel) -> bool:
    rest = unmodelled_forces(model)
    return bool(rest.exists or rest.moving_arm_tendons.any() or rest.moving_arm_actuators.any())


def _muscles(model: mujoco.MjModel) -> bool:
    kinds = (
        (model.actuator_gaintype, GAIN.mjGAIN_MUSCLE), (model.actuator_biastype, BIAS.mjBIAS_MUSCLE),
        (model.actuator_dyntype, DYN.mjDYN_MUSCLE),
    )  # fmt: skip
    return any(bool((given == muscle).any()) for given, muscle in kinds)


_REASONS = (
    (
        lambda m: m.opt.integrator not in (INT.mjINT_EULER, INT.mjINT_IMPLICIT, INT.mjINT_IMPLICITFAST),
        "its integrator is not Euler, implicit or implicitfast",
    ),
    (in_fluid, "it moves in a fluid"),
    (_odd_forces, "it has forces without a closed form, or with moment arms that move"),
    (_muscles, "it has muscles"),
    (
        lambda m: can_be_constrained(m) and any(is_spatial(m, t) for t in range(m.ntendon)),
        "its spatial tendons may make constraint rows",
    ),
    (
        lambda m: has_contacts(m) and bool((m.geom_type == GEOM.mjGEOM_SDF).any()),
        "it has contacts of signed distance fields",
    ),
)


def served_sensors(model: mujoco.MjModel, table: Table) -> Array:
    """Tell for each sensor what serves its second derivatives (`readings`). Shape (nsensor,)."""
    kinds, static = table["sen_kind"], model.body_weldid[table["sen_reference"]] == 0
    served = np.where(np.isin(kinds, _MOTIONS), DIFFERENCED, OPEN)
    served[np.isin(kinds, _LINEAR)] = FLAT
    at_rest = np.isin(kinds, [columns.FRAME_POS, columns.FRAME_AXIS]) & static
    served[at_rest | (kinds == columns.SUBTREE_COM)] = CLOSED
    limited = np.isfinite(table["sen_range"]).any(axis=1)
    served[limited] = OPEN
    return served
