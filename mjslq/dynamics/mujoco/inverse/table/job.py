"""What the kernel of the inverse Jacobians is given: a record of sizes, addresses, offsets, and how to read it.

Notation
--------
    nv, na, nu, ny       velocities, activations, controls, sensor readings
    columns              2 nv + na + nu: what is differentiated by, z = (q, v, act, u)

Entries of a job, arrays by address:

    SIZES                counts and switches
    OBJECTS              mjModel, the one that constraint rows are made with (`plan.row_model`), mjData
    INTEGERS, NUMBERS    what the plan (`plan`) found out about the model, constant
    VIEWS                arrays of mjData, filled by MuJoCo's own functions at each knot
    WORK                 arrays for intermediate results, one set per worker
    RESULTS              states, controls, states between the knots, where the steps end, and the Jacobians
    SECOND, SECOND_WORK  what second derivatives need besides
    OFFSETS              where mjData and mjContact hold what lies in the arena (`layout`)

Names are those of mjModel and mjData wherever they mean the same. A compiled function takes the whole job and makes
the arrays that it needs of it, with `integers`, `vector`, `matrix`: that is free, and keeps its signature short.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.table.columns import FORCE_NUMBERS
from mjslq.dynamics.mujoco.inverse.table.layout import ARENA, CONTACT, COUNTS
from mjslq.native.declare import helper
from mjslq.native.memory import carray, pointer

SIZES = (
    "N", "first", "last", "substeps",
    "nq", "nv", "na", "nu", "ny", "columns", "nbody", "ngeom", "nsite", "nspring", "nball",
    "ntendon", "nten_coef", "nact_coef", "nquat", "implicit", "gyroscopic", "compensated", "constrained", "neq",
    "bodies_tied", "neq_coef", "npair", "geom_types", "collision_functions", "nsensor", "sensors_differenced",
    "sensors_accelerated", "sensors_on_rows", "sensors_of_energy", "sensors_cut", "sensors_of_bodies",
    "sensors_of_actuators", "sparse", "centered", "coupled", "bends", "refsafe", "nrest_q", "nrest_v", "nrest_act",
    "nrest_u", "nrest_next", "rest_passive", "rest_acts", "rest_poses", "nfluid", "narm", "narm_dof", "narm_square",
    "narm_q", "arms_act", "npiece", "rest_touches", "nout", "nD", "symmetric",
)  # fmt: skip
OBJECTS = ("model", "row_model", "rest_model", "data", "ten_J_rownnz", "ten_J_rowadr", "ten_J_colind")
INTEGERS = (
    "body_parentid", "body_rootid", "body_dofadr", "body_dofnum", "body_lastdof", "dof_bodyid", "dof_parentid",
    "dof_group", "dof_groupend", "dof_qadr", "dof_gyroscopic", "spring_dof", "spring_qadr", "ball_dof", "ball_qadr",
    "ten_first", "ten_dof", "act_first", "act_dof", "act_adr", "act_dynamics", "act_early", "act_enabled", "act_site",
    "act_body", "quat_dof", "geom_bodyid", "geom_kind", "dof_treeid", "geom_type", "pair_geoms", "sen_kind",
    "sen_adr", "sen_dim", "sen_stage", "sen_target", "sen_body", "sen_reference", "sen_sides", "sen_fields",
    "sen_reduction", "act_tendon", "site_type", "eq_kind", "eq_body", "eq_first", "eq_dof", "rest_q", "rest_v",
    "rest_act", "rest_u", "rest_next", "D_rownnz", "D_rowadr", "D_colind", "ten_constant", "arm_q", "arm_tendon",
    "arm_out", "arm_row", "act_arm", "arm_first", "arm_dof", "arm_at", "arm_branch", "fluid_body", "fluid_geom",
    "arm_straight", "piece_arm", "piece_from", "piece_to", "site_bodyid", "dof_lone",
)  # fmt: skip
NUMBERS = (
    "dof_armature", "dof_damping", "dof_force_range", "body_gravcomp", "spring_prm", "ball_prm", "ten_coef",
    "ten_prm", "act_coef", "act_prm", "act_gear", "gravity", "geom_size", "geom_gap", "pair_gap", "eq_coef",
    "tie_prm", "sen_prm", "eq_prm", "body_subtreemass", "jnt_solref", "ten_solref", "sen_range", "site_size",
    "magnetic", "act_muscle", "ctrl_range", "fluid_prm", "wind", "arm_prm", "piece_share",
)  # fmt: skip
VIEWS = (
    "qpos", "qvel", "act", "ctrl", "qacc", "cdof", "cinert", "subtree_com", "site_xpos", "site_xmat", "geom_xpos",
    "geom_xmat", "qacc_warmstart", "xpos", "xquat", "ten_J", "ten_velocity", "actuator_moment", "moment_rownnz",
    "moment_rowadr", "moment_colind", "actuator_velocity", "qfrc_passive", "qfrc_actuator", "qDeriv", "xipos",
    "ximat", "ten_length", "actuator_length", "sensordata",
)  # fmt: skip
WORK: dict[str, tuple[int | str, int | str]] = {
    "body_vel": ("nbody", 6), "body_acc": ("nbody", 6), "body_momentum": ("nbody", 6), "body_force": ("nbody", 6),
    "body_Y": ("nbody", 6), "body_inertia": ("nbody", 10), "dof_P": ("nv", 6), "dof_Q": ("nv", 6), "dof_R": ("nv", 6),
    "act_input": ("nu", 3), "next_act": ("nu", 2), "act_force": ("nu", FORCE_NUMBERS), "act_free": ("nv", 1),
    "act_sum": ("nv", 1),
    "M": ("nv", "nv"), "M_hat": ("nv", "nv"), "G": ("nv", "nv"), "T": ("nv", "nv"), "F": ("nv", "columns"),
    "E": ("nv", "columns"), "mixed": ("nv", "columns"), "acc_d": ("nv", 1), "acc_c": ("nv", 1), "change": ("nv", 1),
    "small": (24, 1), "jacobian": (10, "nv"), "directions": (10, 6), "djar": (10, 1), "before_a": ("nv", 6),
    "before_v": ("nv", 6), "values": ("nv", 1), "plus": ("nv", 1), "minus": ("nv", 1),
    "metric_slope": ("nv", "columns"), "mass_change": ("nv", "nv"), "row_change": ("columns", 1),
    "rest_plus": ("columns", 1), "rest_minus": ("columns", 1), "rest_rows": ("na", "columns"),
    "arm_J": ("narm_dof", 1), "arm_L": ("narm_dof", 1), "arm_G": ("narm_square", 1), "arm_motion": ("narm", 2),
    "arm_plus": ("narm_dof", 1), "arm_minus": ("narm_dof", 1), "arm_ahead": ("narm", 2), "arm_behind": ("narm", 2),
    "piece_start": ("nv", 3), "piece_end": ("nv", 3), "arm_pose": ("nq", 1),
    "fluid_K": ("nbody", 36), "fluid_hat": ("nbody", 36), "fluid_bend": ("nbody", 36), "fluid_W": ("nbody", 6),
    "fluid_U": ("nbody", 6), "fluid_X": (6, 6), "fluid_B": (18, 6), "fluid_local": (4, 6), "fluid_complex": (16, 6),
    "acc_rate": ("nv", "columns"), "lever": ("nv", 3), "covectors": (3, 18), "reading": ("ny", 1), "middle": ("ny", 1),
    "tables": (306, 7), "tabulated": (2, 6), "found": (100, 10), "chained": ("columns", "columns"),
    "product": ("columns", "columns"), "no_control": ("nu", 1),
}  # fmt: skip
"""Shapes of the arrays for intermediate results."""
INDICES = ("dofs", "chain", "marked", "member", "spinning")
"""Arrays of nv integers for intermediate results."""
RESULTS = ("X", "U", "S", "ends", "A", "B", "C", "D")
SECOND = ("pull", "weights", "sen_bent", "Z", "Xd", "Xc", "Sc", "apart")
"""Of second derivatives (`curvature.kernel`): derivative of lambda' x_{n+1} by the step's acceleration (N, nv), weights
of the readings (N + 1, ny), address 0 for none, what serves each sensor; results, and marks of the knots with all."""
SECOND_WORK: dict[str, tuple[int | str, int | str]] = {
    "dof_W": ("nv", 6), "body_W": ("nbody", 6), "body_IW": ("nbody", 6), "body_y": ("nbody", 3),
    "body_YW": ("nbody", 6), "w1": ("nv", 1), "w2": ("nv", 1), "masked": ("nv", 1), "Sd": ("nv", "columns"),
    "Zg": ("columns", "columns"), "Xg": ("nv", "columns"), "weightless": (3, 1), "slopes": (6, "nv"),
    "before_w": ("nv", 6), "body_V": ("nbody", 18), "loads": ("nbody", 24), "cone_rates": (6, "columns"),
    "cone": (6, 6),
}  # fmt: skip
"""Shapes of the arrays for intermediate results of second derivatives."""
OFFSETS = tuple(f"at_{name}" for name in ARENA + COUNTS + tuple(f"contact_{name}" for name in (*CONTACT, "size")))
JOB = np.dtype(
    [(name, np.int64) for name in (*SIZES, *OBJECTS, *INTEGERS, *NUMBERS, *VIEWS, *WORK, *INDICES, *RESULTS, *OFFSETS)]
    + [(name, np.int64) for name in (*SECOND, *SECOND_WORK)]
    + [("h", np.float64), ("eps", np.float64)]
)
"""One row of this per worker."""


@helper(forceinline=True)
def integers(address, size):
    """Array of 64-bit integers at an address. Shape (size,)."""
    return carray(pointer(address), (size,), np.int64)


@helper(forceinline=True)
def vector(address, size):
    """Array of numbers at an address. Shape (size,)."""
    return carray(pointer(address), (size,), np.float64)


@helper(forceinline=True)
def matrix(address, rows, columns):
    """Matrix of numbers at an address. Shape (rows, columns)."""
    return carray(pointer(address), (rows, columns), np.float64)


@helper(forceinline=True)
def flags(address, size):
    """Array of C integers at an address. Shape (size,)."""
    return carray(pointer(address), (size,), np.int32)


@helper(forceinline=True)
def entry_address(address):
    """Pointer that is kept at an address."""
    return carray(pointer(address), (1,), np.int64)[0]


@helper(forceinline=True)
def entry_count(address):
    """C integer that is kept at an address."""
    return carray(pointer(address), (1,), np.int32)[0]
