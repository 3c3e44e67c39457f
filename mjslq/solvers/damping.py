"""Levenberg-Marquardt: when the multiplier of a solve grows and when it shrinks (`lq.regularize` has what it does).

step at least 1/2       mu <- mu/3, zero below `SMALLEST`
step at most 1/4        mu <- 4 mu, where there is one
no step found           full steps with mu growing by 2, 4, 8, ... until one descends
"""

from __future__ import annotations

from mjslq.lq.box import Box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.regularize import By, Ladder, damped
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import C1, in_roundoff
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Step
from mjslq.solvers.steps import candidates

START = 1e-3
SMALLEST, LARGEST = 1e-7, 1e12
SHRINK, GROW, SHORT, LONG = 3.0, 4.0, 0.25, 0.5
UNDAMPED = Ladder()
"""For models that lack control weights: the least multiplier that will do."""
DAMPED = Ladder(START, GROW, LARGEST)


class Damping:
    """The multiplier mu of a solve, relative to the largest weight of the model."""

    def __init__(self, by: By = "control", mu: float = 0.0) -> None:
        self.by, self.mu = by, mu

    def direction(self, model: LQProblem, box: Box) -> Direction:
        """Direction with the present multiplier, or the next larger one with which there is a direction."""
        found = damped(model, box, self.mu, self.by, DAMPED if self.mu > 0.0 else UNDAMPED)
        if self.mu > 0.0:
            self.mu = found.mu
        return Direction.to(model, found, self.by)

    def adapt(self, step: Step) -> None:
        """Learn from a step that was taken."""
        if step.alpha <= SHORT and self.mu > 0.0:
            self.mu *= GROW
        elif step.alpha >= LONG:
            self.mu = self.mu / SHRINK if self.mu > SHRINK * SMALLEST else 0.0

    def rescue(self, here: Iterate, model: LQProblem, kind: str, merit: Merit) -> Step:
        """Full steps of a `kind` with a growing multiplier, where a search found none."""
        factor, spent = 2.0, 0
        self.mu = max(self.mu, 0.1 * START)
        while self.mu <= LARGEST:
            self.mu *= factor
            factor *= 2.0
            try:
                ahead = self.direction(model, here.box)
            except NotPositiveDefinite:
                break
            slope = merit.slope(here, ahead)
            if in_roundoff(slope, here.cost):
                break
            there, spent = candidates(here, ahead, [1.0], kind)[0], spent + 1
            if merit.value(there) < merit.value(here) + C1 * slope:
                return Step(there, 1.0, spent)
        return Step(None, rollouts=spent)
