"""Steps along a direction: candidates by rollouts, the line search among them, and the closing of gaps.

    open-loop       u_n = [ u_ref,n + alpha u_bar,n ]                         the change of the controls as it is
    closed-loop     u_n = [ u_ref,n + alpha k_n - K_n (x_n - x_ref,n) ]       under the sweep's feedback, which
                                                                              unstable systems need

[.] clips to the limits of the controls; free entries of the initial state move by alpha x_bar_0. Steps that had to be
shortened are followed by a search along the previous change of the controls (`acceleration`).

A guess of the states moves as a whole, X <- X + t x_bar, U <- U + t u_bar, with t halved until the merit falls; a full
step closes the gaps to first order. Once they are nearly closed, or steps become short while a rollout has the lower
merit, the states are rolled out under the sweep's feedback, so that rounding does not grow: the result obeys the
dynamics to rounding. (Bock and Plitt 1984, "A multiple shooting algorithm for direct solution of optimal control
problems".)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjslq.dynamics.dynamics import Feedback
from mjslq.options import Search
from mjslq.solvers.acceleration import accelerate
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import C1, Trial, in_roundoff, search
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Step
from mjslq.validation import Array

SHORT = 0.5
"""Steps below this are followed by the search along the previous change: there the model is poor."""
SHORT_OF_GUESS = 0.05
"""Step of a state guess below which a rollout of lower merit is taken instead."""
SMALLEST_OF_GUESS = 2.0**-20
"""Step of a state guess below which the search for a lower merit gives up."""


class LineSearch:
    """The step rule of the line-search methods."""

    def __init__(self, options: Search) -> None:
        self.options = options
        self._change: Array | None = None  # of the controls, by the step before

    def __call__(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """Search along `direction`; for a guess of the states, on the way to closing its gaps."""
        if here.gaps is not None:
            return close_gaps(here, direction, merit)
        slope = merit.slope(here, direction)

        def simulate(alphas: Sequence[float]) -> list[Iterate]:
            return candidates(here, direction, alphas, self.options.step)

        trial = Trial(merit, here, slope, direction.expected, simulate, at_once=here.problem.dynamics.threads)
        found = search(self.options.line_search, trial)
        if found is None:
            return Step(None, rollouts=trial.evaluations)
        there, spent = found.iterate, trial.evaluations
        poor = found.alpha < SHORT and not in_roundoff(slope, here.cost)
        if self.options.acceleration and self._change is not None and poor:
            there, more = accelerate(there, self._change)
            spent += more
        self._change = there.trajectory.U - here.trajectory.U
        return Step(there, found.alpha, spent)


def candidates(here: Iterate, direction: Direction, alphas: Sequence[float], step: str) -> list[Iterate]:
    """Iterates after steps of the sizes `alphas`, "closed-loop" or "open-loop"."""
    problem, reference = here.problem, here.trajectory
    closed = step == "closed-loop" and direction.K is not None
    change = direction.k if closed else direction.U
    U = reference.U + np.multiply.outer(np.asarray(alphas, dtype=np.float64), change)
    x0s = None
    if problem.free_start is not None:
        x0s = problem.dynamics.integrate(reference.X[0], np.multiply.outer(alphas, direction.X[0]))
    if closed:
        assert direction.K is not None
        feedback = Feedback(reference.X, direction.K, problem.box.lower, problem.box.upper)
        return simulated(here, U, feedback, x0s)
    return simulated(here, problem.box.clip(U), None, x0s)


def simulated(here: Iterate, U: Array, feedback: Feedback | None = None, x0s: Array | None = None) -> list[Iterate]:
    """Iterates by rollouts under each of the controls `U` (m, N, nu), from `x0s` (m, nx) or where `here` starts."""
    if x0s is None:
        x0s = np.tile(here.trajectory.X[0], (len(U), 1))
    return [Iterate(here.problem, trajectory) for trajectory in here.problem.dynamics.rollouts(x0s, U, feedback)]


def close_gaps(here: Iterate, direction: Direction, merit: Merit) -> Step:
    """Move a guess of the states until the merit falls; roll it out when its gaps are nearly closed."""
    problem, t, spent = here.problem, 1.0, 0
    start, slope = merit.value(here), merit.slope(here, direction)
    there = None
    while t > SMALLEST_OF_GUESS:
        X = problem.dynamics.integrate(here.trajectory.X, t * direction.X)
        U = problem.box.clip(here.trajectory.U + t * direction.U)
        trial, spent = Iterate.guess(problem, X, U), spent + 1
        if merit.value(trial) <= start + C1 * t * slope:
            there = trial
            break
        t *= 0.5
    if there is None:
        rolled = rolled_out(here, direction.K)
        return Step(rolled if np.isfinite(rolled.cost) else None, t, spent + 1)
    if there.closed:
        return Step(rolled_out(there, direction.K), t, spent + 1)
    if t < SHORT_OF_GUESS:
        rolled, spent = rolled_out(there, direction.K), spent + 1
        if rolled.cost <= merit.value(there):
            there = rolled
    return Step(there, t, spent)


def rolled_out(here: Iterate, K: Array | None) -> Iterate:
    """A guess of the states as a trajectory that obeys the dynamics; closed loop, or open loop where that diverges."""
    problem, reference = here.problem, here.trajectory
    U = reference.U[None]
    if K is not None:
        feedback = Feedback(reference.X, K, problem.box.lower, problem.box.upper)
        found = simulated(here, U, feedback)[0]
        if np.isfinite(found.cost):
            return found
    return simulated(here, U)[0]
