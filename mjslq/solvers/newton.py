"""`newton`: Newton's method in the controls, by LQ sweeps with the Hessians of the Hamiltonian.

    1  roll out U, linearize the steps, find costates lambda
    2  U_bar <- minimizer of the LQ problem with the stage Hessians

           [ H_xx  H_ux' ]       H_n = l_n(x, u) + lambda_{n+1}' f_n(x, u),     x_N: the terminal cost's
           [ H_ux  H_uu  ]

    3  U <- U + alpha U_bar, alpha by line search on the true cost, open loop or closed loop

Costates. With those of the trajectory, dJ/dx ("adjoint"), step 2 has the whole second-order expansion of the total
cost J(U), states eliminated: U_bar solves (d^2J/dU^2) U_bar = -dJ/dU. On an unstable system these costates grow
without bound over the horizon, as the trajectory's sensitivity does. The Gauss-Newton sweep knows what the costates
will be after a step under its feedback, p + P x_bar ("sweep"); with these, step 2 is the one of sequential quadratic
programming, which weighs curvature by the multipliers of the latest subproblem. Both are the same at a solution, and
both converge quadratically. On the particle in drag the first takes 21-55 iterations, the second 6 or 7.

Convexity. Far from a minimum the LQ problem need not have one. Three ways out, by the option `modification`:

    "multiplier"    mu I is added to H_uu at all stages, mu growing by fours until the sweep meets positive definite
                    H_uu + B'P B at every stage; beyond `LARGEST` (unstable systems), "blend"
    "blend"         H <- H_GN + theta (H - H_GN), theta = 1/2, 1/4, ... until the sweep is content; H_GN is the
                    convex, Gauss-Newton part
    "stage"         E_n is added to H_uu at the stages where the sweep is not content, and there alone
                    (`mjslq.lq.modified`)

None touches a problem that is convex, so that the last steps are Newton's own. Where the line search finds no step all
the same, a Levenberg-Marquardt multiplier comes in (`damping`).

Sources: Sideris and Bobrow 2005, section 4.1 (the modified Newton method compared with); Dunn and Bertsekas 1989,
"Efficient dynamic programming implementations of Newton's method for unconstrained optimal control problems";
Nocedal and Wright, Numerical Optimization, section 18.1.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mjslq.lq.modified import convexified
from mjslq.lq.modified import modification as stage_modification
from mjslq.lq.riccati import LQProblem, LQSolution, NotPositiveDefinite, solve
from mjslq.solvers.advance import line_searching
from mjslq.solvers.damping import Damping
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.loop import Monitor, Outcome, Stopping, descend
from mjslq.validation import Array, choose

COSTATES = ("sweep", "adjoint")
FLOOR = 1e-3
"""Least curvature that a stage is given, relative to its largest control weight."""
LARGEST = 1e8
"""Multiplier, relative to the largest control weight, that leaves next to nothing of a step."""
LEAST_SHARE = 1e-3
"""Share of the curvature below which none is kept."""


def newton(
    start: Iterate,
    stopping: Stopping,
    monitor: Monitor,
    *,
    line_search: str = "quadratic-fit",
    step: str = "auto",
    acceleration: bool = True,
    modification: str = "multiplier",
    costates: str = "sweep",
) -> Outcome:
    """Minimize from `start`.

    Parameters
    ----------
    line_search : str
        "quadratic-fit", "armijo", "goldstein", "wolfe" or "exact".
    step : str
        "open-loop", "closed-loop", or "auto": closed loop on the engines that simulate robots, open loop elsewhere.
    acceleration : bool
        After a step that the line search had to shorten, also search along the previous change of the controls.
    modification : str
        "multiplier", "blend" or "stage": how an indefinite Hessian is made positive definite.
    costates : str
        "sweep" or "adjoint", see above.
    """
    advance = line_searching(start, line_search, step, acceleration)
    modify = MODIFICATIONS[choose("modification", modification, MODIFICATIONS)]
    choose("costates", costates, COSTATES)

    damper, latest = Damping(start, step, None), None

    def direction(here: Iterate) -> Direction:
        nonlocal latest
        latest = here.newton if costates == "adjoint" else here.hamiltonian(costates_ahead(here))
        if damper.mu > 0.0:
            return damper.direction(latest)
        lq, multiplier = convex_solution(latest, here.gauss_newton, modify)
        return Direction(lq.U, lq.k, lq.K, multiplier, limited=multiplier > 0.0)

    guarded = damper.guard(advance, lambda here: here.newton if latest is None else latest)
    return descend(start, direction, guarded, stopping, monitor)


def costates_ahead(here: Iterate) -> Array:
    """Costates after a Gauss-Newton step under feedback; those of the trajectory where there is no such step."""
    try:
        lq = solve(here.gauss_newton)
    except NotPositiveDefinite:
        return here.costates
    return lq.p + np.einsum("nij,nj->ni", lq.P, lq.X)


Modify = Callable[[LQProblem, LQProblem], tuple[LQSolution, float]]


def convex_solution(model: LQProblem, convex: LQProblem, modify: Modify) -> tuple[LQSolution, float]:
    """Minimizer of the model, modified if it must be, and the multiplier spent on it."""
    try:
        return solve(model), 0.0
    except NotPositiveDefinite:
        return modify(model, convex)


def by_multiplier(model: LQProblem, convex: LQProblem) -> tuple[LQSolution, float]:
    """Raise the curvature at all stages alike; where that would leave no step, blend."""
    scale = _scale(convex)
    multiplier = 1e-3 * scale
    while multiplier <= LARGEST * scale:
        try:
            return solve(model, multiplier), multiplier
        except NotPositiveDefinite:
            multiplier *= 4.0
    return by_blend(model, convex)


def by_blend(model: LQProblem, convex: LQProblem) -> tuple[LQSolution, float]:
    """Keep the largest share of the curvature that leaves the problem convex."""
    share = 0.5
    while share > LEAST_SHARE:
        parts = {name: _between(getattr(convex, name), getattr(model, name), share) for name in "QRM"}
        try:
            return solve(convex._replace(**parts)), 0.0
        except NotPositiveDefinite:
            share *= 0.5
    return convexified(convex)


def by_stage(model: LQProblem, convex: LQProblem) -> tuple[LQSolution, float]:
    """Raise the curvature at the stages where it is missing; the multiplier told is the largest raise."""
    weights = np.abs(convex.R).max(axis=(1, 2), initial=0.0)
    floor = FLOOR * np.maximum(weights, 1e-3 * _scale(convex))
    while True:
        E = stage_modification(model, floor)
        try:
            return solve(model._replace(R=model.R + E)), float(np.abs(E).max())
        except NotPositiveDefinite:  # rounding took what had been added
            floor = 100.0 * floor
            if not floor.max() < 1e12 * max(1.0, weights.max()):
                raise


def _scale(convex: LQProblem) -> float:
    return max(1e-9, float(np.abs(convex.R).max(initial=0.0)))


def _between(first: Array, second: Array, share: float) -> Array:
    return first + share * (second - first)


MODIFICATIONS: dict[str, Modify] = {"multiplier": by_multiplier, "blend": by_blend, "stage": by_stage}
