"""Levenberg-Marquardt: a multiplier that shortens and turns the direction where the model does not hold.

    "control"   minimize  model + mu/2 sum_n u_bar_n'u_bar_n        keeps to the controls of the iterate
    "state"     minimize  model + mu/2 sum_n x_bar_n'x_bar_n        keeps to its states, which suits closed-loop steps

Schedule: a step of at least 1/2 divides mu by 3, one of at most 1/4 multiplies it by 4; below `SMALLEST` it is zero.
When the line search finds no step, full steps are tried with mu growing by 2, 4, 8, ... until one descends; this
happens without the option, too, where "control" is the multiplier and the line search's failure its start.

mu is told in units of the largest weight of the model, of the controls or of the states.

Sources: Levenberg 1944, Marquardt 1963; Tassa, Erez and Todorov 2012, "Synthesis and stabilization of complex
behaviors through online trajectory optimization", for penalizing states.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mjslq.lq.riccati import LQProblem, LQSolution, NotPositiveDefinite, solve
from mjslq.solvers.advance import Advance, kind_of_step, take
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import C1, in_roundoff
from mjslq.solvers.loop import Accepted
from mjslq.validation import choose, positive

KINDS = ("control", "state")
START = 1e-3
SMALLEST, LARGEST = 1e-7, 1e12
SHRINK, GROW, SHORT, LONG = 3.0, 4.0, 0.25, 0.5


class Damping:
    """The multiplier mu of a solve, and what raises and lowers it."""

    def __init__(self, start: Iterate, step: str, kind: str | None, first: float = START) -> None:
        if kind is not None:
            choose("multiplier", kind, KINDS)
        first = positive("damping", first)
        self._by_state = kind == "state"
        self._step = kind_of_step(start, step)
        self.mu = 0.0 if kind is None else first

    def direction(self, model: LQProblem) -> Direction:
        """Direction with the present multiplier, or the next larger one with which there is a direction."""
        while True:
            try:
                lq = self._solve(model)
            except NotPositiveDefinite:
                if self.mu > LARGEST:
                    raise
                self.mu = max(GROW * self.mu, START)
                continue
            return Direction(lq.U, lq.k, lq.K, self.mu * self._scale(model), limited=self.mu > 0.0)

    def guard(self, advance: Advance, model: Callable[[Iterate], LQProblem]) -> Advance:
        """The step rule `advance`, with the schedule around it and the remedy behind it."""

        def damped(here: Iterate, ahead: Direction) -> tuple[Accepted | None, int]:
            accepted, spent = advance(here, ahead)
            if accepted is None:
                accepted, more = self._remedy(here, model(here))
                return accepted, spent + more
            if accepted.alpha <= SHORT and self.mu > 0.0:
                self.mu *= GROW
            elif accepted.alpha >= LONG:
                self.mu = self.mu / SHRINK if self.mu > SHRINK * SMALLEST else 0.0
            return accepted, spent

        return damped

    def _remedy(self, here: Iterate, model: LQProblem) -> tuple[Accepted | None, int]:
        factor, spent = 2.0, 0
        self.mu = max(self.mu, 0.1 * START)
        while self.mu <= LARGEST:
            self.mu *= factor
            factor *= 2.0
            try:
                ahead = self.direction(model)
            except NotPositiveDefinite:
                break
            slope = here.slope(ahead)
            if in_roundoff(slope, here.cost):
                break
            there, spent = take(here, ahead, [1.0], self._step)[0], spent + 1
            if there.cost < here.cost + C1 * slope:
                return Accepted(1.0, there), spent
        return None, spent

    def _solve(self, model: LQProblem) -> LQSolution:
        mu = self.mu * self._scale(model)
        if not self._by_state:
            return solve(model, mu)
        return solve(model._replace(Q=model.Q + mu * np.eye(model.Q.shape[1])))

    def _scale(self, model: LQProblem) -> float:
        weights = model.Q if self._by_state else model.R
        return max(1e-12, float(np.abs(weights).max(initial=0.0)))
