"""What a model consists of, and what serves each part: for `mjslq check`."""

from __future__ import annotations

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.cover import describe, refusals
from mjslq.dynamics.mujoco.inverse.curvature.cover import reasons, served_sensors
from mjslq.dynamics.mujoco.inverse.readings.outputs import sensors
from mjslq.dynamics.mujoco.inverse.table.columns import OPEN
from mjslq.dynamics.mujoco.inverse.table.plan import arrays, can_be_constrained, has_contacts
from mjslq.dynamics.mujoco.names import control_limits

_JOINT_NAMES = {
    mujoco.mjtJoint.mjJNT_FREE: "free joints",
    mujoco.mjtJoint.mjJNT_BALL: "ball joints",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide joints",
    mujoco.mjtJoint.mjJNT_HINGE: "hinge joints",
}
_INTEGRATORS = {
    mujoco.mjtIntegrator.mjINT_EULER: "Euler",
    mujoco.mjtIntegrator.mjINT_IMPLICIT: "implicit",
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST: "implicitfast",
    mujoco.mjtIntegrator.mjINT_DISCRETE: "discrete",
}
_SOLVERS = {
    mujoco.mjtSolver.mjSOL_PGS: "PGS",
    mujoco.mjtSolver.mjSOL_CG: "CG",
    mujoco.mjtSolver.mjSOL_NEWTON: "Newton",
}
_FEW_ITERATIONS = 20
"""Fewer than that, and the constraint solver is likely to stop short of its tolerance."""


def report(model: mujoco.MjModel, differences: str, jacobian: str) -> list[tuple[str, str]]:
    """List the parts `model` has as (part, what serves it); `differences` says how "transition" linearizes the step."""
    if jacobian == "inverse":
        return [*_parts(model, "analytic, through the inverse dynamics"), *describe(model), _second_derivatives(model)]
    reasons = "; ".join(refusals(model)) or "not asked for"
    return [*_parts(model, differences), *_rest(model, differences), ('no jacobian="inverse"', reasons)]


def _second_derivatives(model: mujoco.MjModel) -> tuple[str, str]:
    """Row on the second derivatives of a model that "inverse" serves."""
    name, why = "second derivatives", "; ".join(reasons(model))
    if why:
        return name, f"differences of Jacobians along every state and control, since {why}"
    pushing = "; of forces of constraints, in positions, differences of their gradient"
    by_differences = "; of some sensors, differences of Jacobians along every state and control"
    open_sensors = bool((served_sensors(model, arrays(sensors(model))) == OPEN).any())
    return (
        name,
        "analytic" + (pushing if can_be_constrained(model) else "") + (by_differences if open_sensors else ""),
    )


def _parts(model: mujoco.MjModel, differences: str) -> list[tuple[str, str]]:
    rows = [(f"integrator {_INTEGRATORS[mujoco.mjtIntegrator(model.opt.integrator)]}", differences)]
    for kind, name in _JOINT_NAMES.items():
        number = int((model.jnt_type == kind).sum())
        chart = "quaternion: tangent directions" if kind in (0, 1) else "plain numbers"
        rows.append((f"{number} {name}", chart) if number else ("", ""))
    limited = int(np.isfinite(control_limits(model)).any(axis=1).sum())
    rows.append((f"{model.nu} controls", f"{limited} with limits, clamped by MuJoCo"))
    rows.append((f"{model.na} activations", "part of the state") if model.na else ("", ""))
    rows.append((f"{model.ntendon} tendons", differences) if model.ntendon else ("", ""))
    if not has_contacts(model):
        rows.append(("contacts", "none possible"))
    if can_be_constrained(model) and model.opt.iterations < _FEW_ITERATIONS:
        rows.append(_hurried_solver(model))
    if not model.nsensor:
        rows.append(("0 sensors", "none: costs on states and controls only"))
    if model.nmocap:
        rows.append((f"{model.nmocap} mocap bodies", "stay where the model has them"))
    return [row for row in rows if row[0]]


def _hurried_solver(model: mujoco.MjModel) -> tuple[str, str]:
    """Row on a constraint solver that is cut short, whose steps no Jacobian describes."""
    name, count = _SOLVERS[mujoco.mjtSolver(model.opt.solver)], model.opt.iterations
    return (
        f"constraint solver {name}, {count} iteration{'s' if count > 1 else ''}",
        "too few to converge: the steps then differ from what their Jacobians say; usual is iterations=100",
    )


def _rest(model: mujoco.MjModel, differences: str) -> list[tuple[str, str]]:
    """Rows of those parts which "inverse" does not serve all in the same way."""
    rows = []
    if model.nsensor:
        readings = f"outputs y, {model.nsensordata} readings; their Jacobians by {differences}"
        rows.append((f"{model.nsensor} sensors", readings))
    for number, name in ((model.neq, "equality constraints"), (model.nflex, "flexes")):
        rows.append((f"{number} {name}", differences) if number else ("", ""))
    rows.append(("contacts", differences) if has_contacts(model) else ("", ""))
    return [row for row in rows if row[0]]
