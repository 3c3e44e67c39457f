"""Which models the Jacobians through the inverse dynamics cover, and which way a model is linearized.

Everything that shapes the step has to be known to the kernel: what is not is refused here, with its reason, and the
model falls back to differences of the step.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.forces.unmodelled_forces import (
    AFFINE_BIASES,
    AFFINE_GAINS,
    is_spatial,
    on_one_branch,
    unmodelled_forces,
)
from mjslq.dynamics.mujoco.inverse.readings.outputs import TYPES, sensors
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.continuous import continuous_model, has_odd_activations, is_runge_kutta
from mjslq.dynamics.mujoco.inverse.table.fluid_plan import in_fluid
from mjslq.dynamics.mujoco.inverse.table.plan import (
    EQ,
    GEOM,
    INT,
    OFF,
    ON,
    TRN,
    can_be_constrained,
    can_rub,
    dampers,
    disabled,
    has_contacts,
    implicit_level,
    joint_of,
    lone_dofs,
    tendon_dofs,
    tendons,
    tied_bodies,
)

_OWN = "differences of their own forces"
_ARMS = "analytic; moment arms that are no straight lines by differences"
_POSITIONS = "by position differences of positions alone"
_NO_WEIGHT = 1e-10
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
    if is_runge_kutta(model):
        model = continuous_model(model)
    rows = _forces(model) + _describe_sensors(model)
    if model.neq:
        rows.append((f"{model.neq} equality constraints", _served_equalities(model)))
    if has_contacts(model):
        rows.append(("contacts that planes and spheres make, capsules with capsules", "analytic"))
        rows.append(("other contacts", f"analytic, {_POSES}"))
        if _has_distance_fields(model):
            rows.append(("contacts of signed distance fields", f"analytic by velocity and control; {_POSITIONS}"))
    return rows


def _has_distance_fields(model: mujoco.MjModel) -> bool:
    return has_contacts(model) and bool((model.geom_type == GEOM.mjGEOM_SDF).any())


def _served_equalities(model: mujoco.MjModel) -> str:
    on_bodies = np.isin(model.eq_type, [EQ.mjEQ_CONNECT, EQ.mjEQ_WELD]).any()
    return f"analytic; connect and weld {_POSITIONS}" if on_bodies and implicit_level(model) == 3 else "analytic"


def _forces(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Rows of the smooth forces that have no closed form; all others are analytic."""
    rest = unmodelled_forces(model)
    rows = [
        (what.format(which.sum()), _OWN)
        for what, which in (
            ("springs of {} free joints", rest.joints),
            ("forces of {} actuators", rest.actuators),
        )
        if which.any()
    ]
    rows += [
        (what.format(which.sum()), _ARMS)
        for what, which in (
            ("springs and dampers of {} tendons", rest.moving_arm_tendons),
            (f"forces of {{}}{' other' if rest.actuators.any() else ''} actuators", rest.moving_arm_actuators),
        )
        if which.any()
    ]
    rows += [("fluid", "analytic")] if in_fluid(model) else []
    return rows + ([("gravity compensation", _OWN)] if rest.clipped_gravcomp else [])


def _describe_sensors(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Which sensors have Jacobians in closed form, and which are differenced."""
    if not model.nsensor:
        return []
    kinds, rows = sensors(model)["sen_kind"], []
    closed = kinds > columns.CONSTANT
    if closed.any():
        on_contacts = (kinds >= columns.FORCE).any() and _has_distance_fields(model)
        rest = f"; of those on contacts of signed distance fields, {_POSITIONS}" if on_contacts else ""
        rows.append((f"{int(closed.sum())} sensors", f"outputs y; their Jacobians analytic{rest}"))
    for chosen, served in (
        (kinds == columns.CONSTANT, "which no state or control changes"),
        (kinds == columns.BY_DIFFERENCES, "their Jacobians by differences of their own stage, without a step"),
    ):
        if chosen.any():
            names = ", ".join(sorted({TYPES[int(kind)] for kind in model.sensor_type[chosen]}))
            rows.append((f"{int(chosen.sum())} sensors: {names}", f"outputs y; {served}"))
    return rows


def refusals(model: mujoco.MjModel) -> list[str]:
    """What `model` has that the inverse Jacobians do not cover; empty when they cover it."""
    reasons = []
    if is_runge_kutta(model):
        if has_odd_activations(model):
            reasons.append("RK4 advances its activations in a way of its own")
        model = continuous_model(model)
    return reasons + [reason for is_so, reason in _REFUSALS if is_so(model)]


def _odd_drag(model: mujoco.MjModel) -> bool:
    """Whether an actuator lends damping or armature to something other than a scalar joint or a tendon."""
    for i in range(model.nactuator):
        drags = model.actuator_damping[i] or model.actuator_dampingpoly[i].any() or model.actuator_armature[i]
        if drags and joint_of(model, i) < 0 and model.actuator_trntype[i] != TRN.mjTRN_TENDON:
            return True
    return False


def _beyond_the_metric(model: mujoco.MjModel) -> bool:
    """Whether the discrete integrator meets forces that are no springs, dampers or servos with constant arms."""
    if implicit_level(model) != 3:
        return False
    rest = unmodelled_forces(model)
    plain = (
        np.isin(model.actuator_gaintype, AFFINE_GAINS).all() and np.isin(model.actuator_biastype, AFFINE_BIASES).all()
    )
    spatial = any(is_spatial(model, t) and _makes_rows(model, t) for t in range(model.ntendon))
    open_ = rest.exists or rest.moving_arm_tendons.any() or rest.moving_arm_actuators.any()
    return bool(not plain or open_ or spatial or in_fluid(model))


def _turns_with_the_world(model: mujoco.MjModel) -> bool:
    """Whether contacts depend on more than how their geoms lie to each other.

    MuJoCo's older convex collisions find further contacts by tilting the geoms about axes fixed in the world.
    """
    older = disabled(model, OFF.mjDSBL_NATIVECCD) and not disabled(model, OFF.mjDSBL_MULTICCD)
    convex = np.isin(model.geom_type, [GEOM.mjGEOM_CYLINDER, GEOM.mjGEOM_ELLIPSOID, GEOM.mjGEOM_MESH]).any()
    return bool(older and convex and has_contacts(model))


def _weightless(model: mujoco.MjModel) -> bool:
    """Whether a connect or weld constraint is infinitely stiff, since no force moves its bodies' centres."""
    if not can_be_constrained(model) or disabled(model, OFF.mjDSBL_EQUALITY):
        return False
    for e in np.flatnonzero(np.isin(model.eq_type, [EQ.mjEQ_CONNECT, EQ.mjEQ_WELD])):
        bodies = tied_bodies(model, int(e))
        weights = model.body_invweight0[bodies].sum(axis=0)[: 2 if model.eq_type[e] == EQ.mjEQ_WELD else 1]
        if model.body_weldid[bodies].any() and (weights < _NO_WEIGHT).any():
            return True
    return False


def _dragged_apart(model: mujoco.MjModel) -> bool:
    """Whether a fluid couples dofs that the integrator takes one by one."""
    bodies = model.dof_bodyid[lone_dofs(model)]
    return in_fluid(model) and len(set(bodies.tolist())) < len(bodies)


def _feels_discrete_rows(model: mujoco.MjModel) -> bool:
    """Whether sensors read forces of rows whose weights depend on the state."""
    if implicit_level(model) != 3 or not can_be_constrained(model):
        return False
    return bool(sensors(model)["sensors_on_rows"])


def _makes_rows(model: mujoco.MjModel, t: int) -> bool:
    """Whether tendon t has limits, friction or an equality constraint."""
    ends = (model.eq_obj1id == t) | (model.eq_obj2id == t)
    tied = ((model.eq_type == EQ.mjEQ_TENDON) & ends).any()
    return bool(model.tendon_limited[t] or model.tendon_frictionloss[t] or tied)


def _heavy_tendon(model: mujoco.MjModel) -> bool:
    """Whether a tendon with inertia is spatial, or runs across branches."""
    inertia = tendons(model)["ten_prm"][:, columns.ARMATURE]
    return any(
        inertia[t] and (is_spatial(model, t) or not on_one_branch(model, tendon_dofs(model, t)[0]))
        for t in range(model.ntendon)
    )


_REFUSALS: tuple[tuple[Callable[[mujoco.MjModel], bool], str], ...] = (
    (lambda m: m.nflex > 0, "it has flexes"),
    (
        lambda m: m.opt.noslip_iterations > 0 and can_rub(m),
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
    (lambda m: disabled(m, OFF.mjDSBL_ACTUATION), "its actuators are disabled"),
    (_odd_drag, "it has actuators with damping or armature that is not a hinge's, slide's or tendon's"),
    (_beyond_the_metric, "the discrete integrator takes forces implicitly that have no closed form here"),
    (_turns_with_the_world, "multiple contacts of convex geoms are found without nativeccd"),
    (_weightless, "its connect or weld constraints are on bodies without inverse weight, too stiff for the solver"),
    (_dragged_apart, "implicitfast neglects how a fluid couples the slides of simple bodies"),
    (_feels_discrete_rows, "its sensors feel constraint forces, which the discrete integrator weighs by the state"),
    (_heavy_tendon, "it has tendons with armature that are spatial or run between branches"),
    (
        lambda m: m.opt.integrator == INT.mjINT_EULER and bool((dampers(m) < 0).any()),
        "it has negative damping under Euler",
    ),
)
