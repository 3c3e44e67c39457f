"""What the kernel of the inverse Jacobians is given: a record of sizes, addresses, offsets, and how to read it.

Notation
--------
    nv, na, nu, ny       velocities, activations, controls, sensor readings
    columns              2 nv + na + nu: what is differentiated by, z = (q, v, act, u)

Entries of a job, arrays by address:

    SIZES                counts and switches
    INTEGERS, NUMBERS    what the plan (`plan`) found out about the model, constant
    VIEWS                arrays of mjData, filled by MuJoCo's own functions at each knot
    WORK                 arrays for intermediate results, one set per worker
    RESULTS              the trajectory and its Jacobians
    OFFSETS              where mjData and mjContact hold what lies in the arena (`layout`)

Names are those of mjModel and mjData wherever they mean the same. A compiled function takes the whole job and makes
the arrays that it needs of it, with `integers`, `vector`, `matrix`: that is free, and keeps its signature short.
"""

from __future__ import annotations

import numba
import numpy as np

from mjslq.dynamics.mujoco.inverse.layout import ARENA, CONTACT, COUNTS
from mjslq.dynamics.mujoco.kernels import _pointer

SIZES = (
    "N", "first", "last", "nq", "nv", "na", "nu", "ny", "columns", "nbody", "ngeom", "nsite", "nspring", "nball",
    "ntendon", "nten_coef", "nact_coef", "nquat", "implicit", "gyroscopic", "compensated", "constrained", "neq",
    "bodies_tied", "neq_coef", "npair", "geom_types", "collision_functions",
    "nsensor", "sensors_differenced", "sparse", "centered",
)  # fmt: skip
INTEGERS = (
    "body_parentid", "body_rootid", "body_dofadr", "body_dofnum", "body_lastdof", "dof_bodyid", "dof_parentid",
    "dof_group", "dof_groupend", "dof_qadr", "dof_gyroscopic", "spring_dof", "spring_qadr", "ball_dof", "ball_qadr",
    "ten_first", "ten_dof", "act_first", "act_dof", "act_adr", "act_dynamics", "act_early", "act_enabled", "act_site",
    "act_body", "quat_dof", "geom_bodyid", "geom_kind", "dof_treeid", "geom_type",
    "pair_geoms",
    "sen_kind", "sen_adr", "sen_target", "sen_body", "sen_reference", "eq_kind", "eq_body", "eq_first", "eq_dof",
)  # fmt: skip
NUMBERS = (
    "dof_armature", "dof_damping", "dof_force_range", "body_gravcomp", "spring_prm", "ball_prm", "ten_coef", "ten_prm",
    "act_coef", "act_prm", "act_gear", "gravity", "geom_size", "geom_gap", "pair_gap", "sen_prm", "eq_prm",
    "eq_coef", "tie_prm", "body_subtreemass",
)  # fmt: skip
VIEWS = (
    "qpos", "qvel", "act", "ctrl", "qacc", "cdof", "cinert", "subtree_com", "site_xpos", "site_xmat", "geom_xpos",
    "geom_xmat", "qacc_warmstart", "xpos", "xquat",
)  # fmt: skip
WORK: dict[str, tuple[int | str, int | str]] = {
    "body_vel": ("nbody", 6), "body_acc": ("nbody", 6), "body_momentum": ("nbody", 6), "body_force": ("nbody", 6),
    "body_Y": ("nbody", 6), "body_inertia": ("nbody", 10), "dof_P": ("nv", 6), "dof_Q": ("nv", 6), "dof_R": ("nv", 6),
    "act_input": ("nu", 3), "next_act": ("nu", 2), "act_force": ("nu", 6), "act_free": ("nv", 1), "act_sum": ("nv", 1),
    "M": ("nv", "nv"), "M_hat": ("nv", "nv"), "G": ("nv", "nv"), "T": ("nv", "nv"), "F": ("nv", "columns"),
    "E": ("nv", "columns"), "mixed": ("nv", "columns"), "acc_d": ("nv", 1), "acc_c": ("nv", 1), "change": ("nv", 1),
    "small": (24, 1), "jacobian": (10, "nv"), "directions": (10, 6), "djar": (10, 1), "before_a": ("nv", 6),
    "before_v": ("nv", 6), "values": ("nv", 1), "plus": ("nv", 1), "minus": ("nv", 1), "tables": (306, 7),
    "tabulated": (2, 6), "found": (100, 10),
}  # fmt: skip
"""Shapes of the arrays for intermediate results."""
INDICES = ("dofs", "chain", "marked", "member")
"""Arrays of nv integers for intermediate results."""
RESULTS = ("X", "U", "A", "B", "C", "D")
OFFSETS = tuple(f"at_{name}" for name in ARENA + COUNTS + tuple(f"contact_{name}" for name in (*CONTACT, "size")))
JOB = np.dtype(
    [
        (name, np.int64)
        for name in (*SIZES, "model", "data", *INTEGERS, *NUMBERS, *VIEWS, *WORK, *INDICES, *RESULTS, *OFFSETS)
    ]
    + [("h", np.float64), ("eps", np.float64)]
)
"""One row of this per worker."""


@numba.njit(forceinline=True)
def integers(address, size):
    """Array of 64-bit integers at an address. Shape (size,)."""
    return numba.carray(_pointer(address), (size,), np.int64)


@numba.njit(forceinline=True)
def vector(address, size):
    """Array of numbers at an address. Shape (size,)."""
    return numba.carray(_pointer(address), (size,), np.float64)


@numba.njit(forceinline=True)
def matrix(address, rows, columns):
    """Matrix of numbers at an address. Shape (rows, columns)."""
    return numba.carray(_pointer(address), (rows, columns), np.float64)


@numba.njit(forceinline=True)
def flags(address, size):
    """Array of C integers at an address. Shape (size,)."""
    return numba.carray(_pointer(address), (size,), np.int32)


@numba.njit(forceinline=True)
def entry_address(address):
    """Pointer that is kept at an address."""
    return numba.carray(_pointer(address), (1,), np.int64)[0]


@numba.njit(forceinline=True)
def entry_count(address):
    """C integer that is kept at an address."""
    return numba.carray(_pointer(address), (1,), np.int32)[0]
