"""Which models the Jacobians through the inverse dynamics cover, and which way a model is linearized.

Everything that shapes the step has to be known to the kernel: what is not is refused here, with its reason, and the
model falls back to differences of the step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse import columns
from mjslq.dynamics.mujoco.inverse.outputs import TYPES, sensors
from mjslq.dynamics.mujoco.inverse.plan import (
    BIAS,
    DYN,
    EQ,
    GAIN,
    GEOM,
    INT,
    JOINT,
    OFF,
    ON,
    SCALAR,
    TRN,
    can_be_constrained,
    dampers,
    disabled,
    has_contacts,
    implicit_level,
    joint_of,
    tendon_dofs,
    tendons,
)

_DYNAMICS = [int(kind) for kind in (DYN.mjDYN_NONE, DYN.mjDYN_INTEGRATOR, DYN.mjDYN_FILTER, DYN.mjDYN_FILTEREXACT)]
_GAINS = [int(GAIN.mjGAIN_FIXED), int(GAIN.mjGAIN_AFFINE)]
_BIASES = [int(BIAS.mjBIAS_NONE), int(BIAS.mjBIAS_AFFINE)]

_POSITIONS = "by position differences of positions alone"
_POSES = "but for how the contact itself moves: differences in the six relative motions of its geoms"


def choose_jacobian(model: mujoco.MjModel, wanted: str) -> str:
    """Make "inverse" or "transition" of "auto"; ValueError for "inverse" on a model that it does not cover."""
    reasons = refusals(model)
    if wanted == "auto":
        return "transition" if reasons else "inverse"
    if wanted == "inverse" and reasons:
        raise ValueError(f'jacobian="inverse" does not cover this model: {"; ".join(reasons)}; use jacobian="auto"')
    return wanted


def describe(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """What serves the sensors and the constraints of a covered model, as (part, what serves it)."""
    rows = []
    if model.nsensor:
        kinds = sensors(model)["sen_kind"]
        closed = kinds != columns.BY_DIFFERENCES
        if closed.any():
            rows.append((f"{int(closed.sum())} sensors", "outputs y; their Jacobians analytic"))
        if not closed.all():
            rest = sorted({TYPES[int(kind)] for kind in model.sensor_type[~closed]})
            rows.append((f"{int((~closed).sum())} sensors: {', '.join(rest)}", "outputs y; differences of the step"))
    if model.neq:
        rows.append((f"{model.neq} equality constraints", "analytic"))
    if has_contacts(model):
        rows.append(("contacts that planes and spheres make, capsules with capsules", "analytic"))
        rows.append(("other contacts", f"analytic, {_POSES}"))
        if (model.geom_type == GEOM.mjGEOM_SDF).any():
            rows.append(("contacts of signed distance fields", f"analytic by velocity and control; {_POSITIONS}"))
    return rows


def refusals(model: mujoco.MjModel) -> list[str]:
    """What `model` has that the inverse Jacobians do not cover; empty when they cover it."""
    return [reason for is_so, reason in _REFUSALS if is_so(model)]


def _moving_target(model: mujoco.MjModel, i: int) -> bool:
    """Whether actuator i needs a length or velocity that has no constant derivative."""
    prm_gain, prm_bias = model.actuator_gainprm[i, 1:3], model.actuator_biasprm[i, 1:3]
    feels = (model.actuator_gaintype[i] == GAIN.mjGAIN_AFFINE and prm_gain.any()) or (
        model.actuator_biastype[i] == BIAS.mjBIAS_AFFINE and prm_bias.any()
    )
    return bool(feels)


def _odd_transmission(model: mujoco.MjModel) -> bool:
    for i in range(model.nu):
        kind, target = model.actuator_trntype[i], model.actuator_trnid[i]
        if joint_of(model, i) >= 0:
            continue
        drags = model.actuator_damping[i] or model.actuator_dampingpoly[i].any() or model.actuator_armature[i]
        if kind == TRN.mjTRN_JOINT or (kind == TRN.mjTRN_SITE and target[1] < 0):
            if _moving_target(model, i) or drags:
                return True
        elif kind != TRN.mjTRN_TENDON:
            return True
    return False


def _busy_spatial_tendon(model: mujoco.MjModel) -> bool:
    """Whether a spatial tendon has any effect on the motion."""
    for t in range(model.ntendon):
        if len(tendon_dofs(model, t)[0]):
            continue
        coefficients = (
            model.tendon_stiffness[t], *model.tendon_stiffnesspoly[t], model.tendon_damping[t],
            *model.tendon_dampingpoly[t], model.tendon_armature[t], model.tendon_frictionloss[t],
        )  # fmt: skip
        driven = ((model.actuator_trntype == TRN.mjTRN_TENDON) & (model.actuator_trnid[:, 0] == t)).any()
        tied = ((model.eq_type == EQ.mjEQ_TENDON) & (model.eq_obj1id == t)).any()
        if any(coefficients) or driven or model.tendon_limited[t] or tied:
            return True
    return False


def _branching_tendon(model: mujoco.MjModel) -> bool:
    """Whether a tendon across branches has armature, or nonlinear damping that an integrator takes implicitly."""
    table = tendons(model)
    for t in range(model.ntendon):
        dofs = np.sort(tendon_dofs(model, t)[0])
        prm = table["ten_prm"][t]
        nonlinear = implicit_level(model) == 2 and prm[columns.DAMPING + 1 : columns.DAMPING + 3].any()
        if len(dofs) > 1 and (prm[columns.ARMATURE] or nonlinear) and not _on_one_branch(model, dofs):
            return True
    return False


def _on_one_branch(model: mujoco.MjModel, dofs: Any) -> bool:
    ancestors, i = set(), int(dofs[-1])
    while i >= 0:
        ancestors.add(i)
        i = int(model.dof_parentid[i])
    return set(dofs.tolist()) <= ancestors


def _clipped_sum(model: mujoco.MjModel) -> bool:
    """Whether a joint clips forces in a way that couples it with others, or with gravity compensation."""
    limited = np.asarray(model.jnt_actfrclimited, bool)
    shared = (model.actuator_trntype == TRN.mjTRN_TENDON) | (model.actuator_trntype == TRN.mjTRN_SITE)
    lifted = np.asarray(model.jnt_actgravcomp, bool)
    odd = ~np.isin(model.jnt_type, SCALAR)
    return bool((limited & (lifted | odd)).any() or (limited.any() and shared.any()))


_REFUSALS: tuple[tuple[Callable[[mujoco.MjModel], bool], str], ...] = (
    (lambda m: m.opt.integrator == INT.mjINT_DISCRETE, "the integrator is discrete"),
    (lambda m: m.nflex > 0, "it has flexes"),
    (
        lambda m: can_be_constrained(m) and m.opt.noslip_iterations > 0,
        "noslip iterations change the constraint forces",
    ),
    (
        lambda m: has_contacts(m) and bool(m.geom_surfacevel.any() or m.geom_adhesion.any() or m.pair_adhesion.any()),
        "it has geoms with surface velocities or adhesion",
    ),
    (
        lambda m: bool(m.opt.enableflags & (ON.mjENBL_DIAGEXACT | ON.mjENBL_SPECULATIVE)),
        "exact constraint diagonals or speculative contacts are enabled",
    ),
    (lambda m: m.nplugin > 0, "it has plugins"),
    (lambda m: m.opt.density > 0 or m.opt.viscosity > 0, "a fluid acts on its bodies"),
    (lambda m: disabled(m, OFF.mjDSBL_ACTUATION), "its actuators are disabled"),
    (
        lambda m: m.nactuator != m.nu or m.nout != m.nactuator or bool((m.actuator_actnum > 1).any()),
        "it has actuators with several inputs, outputs or activations",
    ),
    (
        lambda m: not np.isin(m.actuator_dyntype, _DYNAMICS).all(),
        "it has activation dynamics other than integrator, filter, filterexact",
    ),
    (
        lambda m: not (np.isin(m.actuator_gaintype, _GAINS).all() and np.isin(m.actuator_biastype, _BIASES).all()),
        "it has actuators with gain or bias other than fixed and affine",
    ),
    (
        _odd_transmission,
        "it has actuators whose moment arm or length is not that of a joint, fixed tendon or plain site",
    ),
    (_busy_spatial_tendon, "it has spatial tendons that act on the motion"),
    (_branching_tendon, "it has tendons with armature or nonlinear damping between branches"),
    (lambda m: bool(np.any(m.tendon_actfrclimited)), "it has tendons with actuator force limits"),
    (
        _clipped_sum,
        "it has joints with actuator force limits beside actuators on tendons or sites, or gravity compensation",
    ),
    (
        lambda m: bool(m.jnt_stiffnesspoly[m.jnt_type == JOINT.mjJNT_FREE].any()),
        "it has free joints with nonlinear springs",
    ),
    (
        lambda m: m.opt.integrator == INT.mjINT_EULER and bool((dampers(m) < 0).any()),
        "it has negative damping under Euler",
    ),
)
