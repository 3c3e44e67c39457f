"""Violated constraints: which they are, and whether the linearized system could reduce them.

Least violation of the linearized system: with c the violations of an iterate, scaled, and J their Jacobian,

    minimize over d within the limits of the controls   1/2 |c + J d|^2,   relative to 1/2 |c|^2

Near one, the iterate is a stationary point of the violation: a local verdict. Far below one there is a way, and the
penalty was too light for it, as with constraints whose units make them small.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mjslq.bound_constraints import BoundConstraint
from mjslq.lq.box import solve_in_box
from mjslq.lq.problem import NotPositiveDefinite
from mjslq.problem import Problem
from mjslq.residuals import Identity
from mjslq.solvers.augmented import Augmented, zero_multipliers
from mjslq.solvers.iterate import Iterate
from mjslq.validation import Array

SHIFT = 1e-6
"""Multiplier on the controls, relative to what they weigh by their effect on the violations."""


def fixed(start: Iterate, tol: float) -> str:
    """Which constraints the initial state violates where nothing free enters them: nothing can be done about these."""
    free = start.problem.free_start
    for constraint in start.problem.unpenalized.bound_constraints:
        if constraint.seen_at[0] > 0:
            continue
        J = constraint.residual.jacobian(start.trajectory, start.linearization)
        if J.u is not None or (free is not None and isinstance(J.x, np.ndarray) and J.x[0][:, free].any()):
            continue
        violation = float(constraint.violation(start.trajectory)[0])
        if violation > tol:
            return f"The initial state itself violates {constraint.name!r}, by {violation:.3g}."
    return ""


def granted(problem: Problem, U: Array) -> Problem:
    """The problem with what its initial state violates granted at knot 0, where no control enters it.

    For receding horizons: a state that was measured beyond a limit is no reason not to plan the way back. `U` (N, nu)
    are the controls to judge by. The same problem where there is nothing to grant.
    """
    of_start = [c for c in problem.bound_constraints if c.seen_at[0] == 0]
    if not of_start:
        return problem
    trajectory = problem.rollout(U)
    if trajectory.diverged or not any(c.violation(trajectory)[0] > 0.0 for c in of_start):
        return problem
    linearization = problem.dynamics.linearize(trajectory)

    def widened(c: BoundConstraint) -> BoundConstraint:
        if c not in of_start:
            return c
        r, by_u = c.residual.value(trajectory)[0], c.residual.jacobian(trajectory, linearization).u
        if by_u is None:
            stuck = np.ones(r.shape, dtype=bool)
        elif isinstance(by_u, Identity):
            return c
        else:
            stuck = ~by_u[0].any(axis=1)
        lower, upper = c.lower.copy(), c.upper.copy()
        lower[0], upper[0] = np.where(stuck, [np.minimum(lower[0], r), np.maximum(upper[0], r)], [lower[0], upper[0]])
        return replace(c, lower=lower, upper=upper)

    return problem.with_constraints(tuple(widened(c) for c in problem.bound_constraints))


def verdict(here: Iterate, tol: float) -> str:
    """Which constraints are violated, and where."""
    found = []
    for name, violation in here.problem.unpenalized.violations(here.trajectory).items():
        knots = np.flatnonzero(violation > tol)
        if knots.size:
            worst = int(violation.argmax())
            where = f"knot {knots[0]}" if knots.size == 1 else f"{knots.size} of the knots {knots[0]} to {knots[-1]}"
            found.append((float(violation[worst]), f"{name!r} at {where}, by up to {violation[worst]:.3g}"))
    found.sort(reverse=True)
    return "Violated: " + "; ".join(text for _, text in found) + "." if found else ""


def reducible(here: Iterate, scales: tuple[Array, ...]) -> float:
    """Share of the squared violations that the linearized system leaves at least, whatever it costs."""
    problem = here.problem.unpenalized
    base = Iterate(problem, here.trajectory)
    base.__dict__["linearization"] = here.linearization
    penalized = Augmented.of(problem, zero_multipliers(problem), scales, 1.0).about(base)
    squares = penalized.cost - base.cost
    if not 0.0 < squares < np.inf:
        return 1.0
    model, cost = penalized.gauss_newton, base.gauss_newton
    parts = {name: getattr(model, name) - getattr(cost, name) for name in "QRMqr"}
    alone = model._replace(**parts)
    shift = SHIFT * float(np.abs(alone.Q).max() * np.abs(alone.B).max() ** 2 + np.abs(alone.R).max())
    try:
        lq = solve_in_box(alone, base.box, shift or 1.0).lq
    except NotPositiveDefinite:
        return 1.0
    return 1.0 + alone.value(lq.X, lq.U) / squares


def beyond(constraint: BoundConstraint, here: Iterate) -> Array:
    """Violation of each entry. Shape (k, m)."""
    r = constraint.residual.value(here.trajectory)
    return np.maximum(np.maximum(constraint.lower - r, r - constraint.upper), 0.0)
