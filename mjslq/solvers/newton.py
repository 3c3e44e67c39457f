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
from typing import Any

import numpy as np

from mjslq.lq.box import Box, solve_in_box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.regularize import Damped, Ladder, damped, largest_weight, modification, solve_with
from mjslq.options import NewtonOptions
from mjslq.solvers.damping import UNDAMPED, Damping
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Method, Step
from mjslq.solvers.steps import LineSearch
from mjslq.validation import Array

FLOOR = 1e-3
"""Least curvature that a stage is given, relative to its largest control weight."""
LADDER = Ladder(1e-3, 4.0, 1e8)
"""Multipliers, up to one that leaves next to nothing of a step."""
LEAST_SHARE = 1e-3
"""Share of the curvature below which none is kept."""


class Newton(Method):
    """The method, with its multiplier."""

    def __init__(self, options: NewtonOptions) -> None:
        self.options = options
        self.search, self.damping = LineSearch(options), Damping()
        self._modify = MODIFICATIONS[options.modification]
        self._model: tuple[Iterate, LQProblem] | None = None  # of the latest direction

    def direction(self, here: Iterate) -> Direction:
        """Step 2, with the model made convex where it is not."""
        model = here.newton if self.options.costates == "adjoint" else here.hamiltonian(costates_ahead(here))
        self._model = here, model
        if self.damping.mu > 0.0:
            return self.damping.direction(model, here.box)
        return Direction.to(model, convex_solution(model, here.gauss_newton, here.box, self._modify))

    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """Step 3."""
        step = self.search(here, direction, merit)
        if step.iterate is not None:
            self.damping.adapt(step)
            return step
        if here.gaps is not None or self._model is None:
            return step
        rescued = self.damping.rescue(here, self._model[1], self.options.step, merit)
        return Step(rescued.iterate, rescued.alpha, step.rollouts + rescued.rollouts)


def costates_ahead(here: Iterate) -> Array:
    """Costates after a Gauss-Newton step under feedback; those of the trajectory where there is no such step."""
    try:
        return damped(here.gauss_newton, here.box, ladder=UNDAMPED).found.lq.costates
    except NotPositiveDefinite:
        return here.costates


Modify = Callable[[LQProblem, LQProblem, Box], Damped]


def convex_solution(model: LQProblem, convex: LQProblem, box: Box, modify: Modify) -> Damped:
    """Minimizer of the model, modified if it must be."""
    try:
        return solve_with(model, box, 0.0)
    except NotPositiveDefinite:
        return modify(model, convex, box)


def by_multiplier(model: LQProblem, convex: LQProblem, box: Box) -> Damped:
    """Raise the curvature at all stages alike; where that would leave no step, blend."""
    try:
        return damped(model, box, LADDER.first, ladder=LADDER)
    except NotPositiveDefinite:
        return by_blend(model, convex, box)


def by_blend(model: LQProblem, convex: LQProblem, box: Box) -> Damped:
    """Keep the largest share of the curvature that leaves the problem convex."""
    share = 0.5
    while share > LEAST_SHARE:
        parts: dict[str, Any] = {name: _between(getattr(convex, name), getattr(model, name), share) for name in "QRM"}
        try:
            return solve_with(convex._replace(**parts), box, 0.0)
        except NotPositiveDefinite:
            share *= 0.5
    return damped(convex, box, ladder=UNDAMPED)


def by_stage(model: LQProblem, convex: LQProblem, box: Box) -> Damped:
    """Raise the curvature at the stages where it is missing; the multiplier told is the largest raise."""
    weights = np.abs(convex.R).max(axis=(1, 2), initial=0.0)
    floor = FLOOR * np.maximum(weights, 1e-3 * largest_weight(convex))
    while True:
        E = modification(model, floor)
        try:
            return Damped(solve_in_box(model._replace(R=model.R + E), box), 0.0, float(np.abs(E).max()))
        except NotPositiveDefinite:  # rounding took what had been added
            floor = 100.0 * floor
            if not floor.max() < 1e12 * max(1.0, weights.max()):
                raise


def _between(first: Array, second: Array, share: float) -> Array:
    return first + share * (second - first)


MODIFICATIONS: dict[str, Modify] = {"multiplier": by_multiplier, "blend": by_blend, "stage": by_stage}
