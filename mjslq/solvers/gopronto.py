"""`gopronto`: first-order methods on the cost of a projected curve (Sforni et al.); no LQ problem in an iteration.

    1  lambda, w <- costates and gradient under feedback, from the last step to the first                   (16)
    2  (alpha, mu) <- (alpha, mu) + gamma d,  d from (K'w, w) by a rule of `solvers.first_order`            (17), (22)
    3  x, u <- P(alpha, mu): a rollout under the tracking controller                                         (18)

gamma by `step_rule`:

    armijo         gamma, gamma/2, ... until J falls by c1 of what the slope promises, from twice the step before
    interpolated   the same, then the minimum of the parabola through J, its slope and the step, if that is lower
    fixed          `step_size`
    diminishing    `step_size` / (k + 1)^0.6                                                             (Remark III.3)

Fixed and diminishing steps need not descend; the result is the best iterate. The gains are made before the first
iteration, and anew when they do not stabilize (`solvers.regulator`); for the quasi-Newton rule, which uses their
metric, also after `PATIENCE` short steps in a row. An iteration costs a rollout or two and an adjoint pass: Jacobians
of a few steps at a time, or N nx nu where the engine has a pullback; no array (N, nx, nx) is made.

Source: Sforni, Spedicato, Notarnicola and Notarstefano, "GoPRONTO: a feedback-based framework for nonlinear optimal
control", Algorithms 2 to 4.
"""

from __future__ import annotations

import numpy as np

from mjslq.options import GoprontoOptions
from mjslq.solvers.curves import CurveMethod
from mjslq.solvers.first_order import RULES, Gradient, HeavyBall, Nesterov, QuasiNewton
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import C1, Trial, armijo, by_gradient_norm
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Step
from mjslq.solvers.projection import Curve, CurveIterate, project
from mjslq.status import Status
from mjslq.validation import Array

DIMINISHING = 0.6
"""Power of diminishing steps: their sum is infinite, that of their squares is not."""
GROW = 2.0
"""Step offered to the search, relative to the one before."""
FARTHEST = 10.0
"""Of the parabola's minimum, relative to the step through which it goes."""
FIRST = 0.1
"""Length of the first step offered, as a change of the controls, relative to their own, or to 1."""
SHORT, PATIENCE = 0.1, 5
"""Quasi-Newton steps, relative to the whole one, that are short, and how many in a row make the metric stale."""
SMALLEST = 1e-12
"""Share of the step offered, below which the search gives up."""


class Gopronto(CurveMethod):
    """The method GoPRONTO; see the head of this file."""

    tests_direction = False
    patience = 3

    def __init__(self, options: GoprontoOptions) -> None:
        super().__init__(options)
        self.options = options
        kind = RULES[options.variant]
        self.rule: Gradient = (
            HeavyBall(options.restarts, options.momentum) if kind is HeavyBall else kind(options.restarts)
        )
        self._metric: Array | None = None
        self._gamma: float | None = None
        self._latest: tuple[CurveIterate, Curve] | None = None
        self._taken = self._short = 0

    def direction(self, here: Iterate) -> Direction:
        """Steps 1 and 2, without gamma."""
        assert isinstance(here, CurveIterate)
        if isinstance(self.rule, QuasiNewton) and self._metric is not self.regulator.G:
            self._metric = self.regulator.G
            self.rule.restart()
            self.rule.use(self._metric)
        if self._latest is None or self._latest[0] is not here:
            self._latest = here, self.rule.change(here)
        change = self._latest[1]
        k = here.feedforward(change)
        return Direction(change.alpha, change.mu, k, here.gains, float(np.vdot(here.gradient, k)), here.along.held)

    def curve_step(self, here: CurveIterate, direction: Direction, merit: Merit) -> Step:
        """Step 3 for one gamma after another."""
        if self._latest is None or self._latest[0] is not here:
            self.direction(here)
        assert self._latest is not None
        change = self._latest[1]
        if self.options.step_rule in ("fixed", "diminishing"):
            step = self._without_search(here, change)
        elif isinstance(self.rule, HeavyBall) and not isinstance(self.rule, Nesterov) and self.rule.last is not None:
            step = self._with_momentum(here, change, merit)
        else:
            step = self._search(here, change, merit, self._offer(here, change))
        self._taken += step.iterate is not None
        self._short = self._short + 1 if step.alpha < SHORT else 0
        return step

    @property
    def stale(self) -> bool:
        """See `CurveMethod.stale`."""
        return self.rule.natural and self._short >= PATIENCE

    def restart(self) -> None:
        """See `CurveMethod.restart`."""
        self.rule.restart()
        self._latest, self._short = None, 0

    def _offer(self, here: CurveIterate, change: Curve) -> float:
        """The first gamma to try."""
        if self.rule.natural and (self.regulator.G is not None or self._gamma is not None):
            return 1.0
        if self._gamma is not None:
            return GROW * self._gamma
        length = float(np.linalg.norm(here.feedforward(change)))
        return FIRST * max(1.0, float(np.linalg.norm(here.trajectory.U))) / max(length, 1e-300)

    def _search(self, here: CurveIterate, change: Curve, merit: Merit, gamma: float) -> Step:
        """Armijo's rule along a change, from a step `gamma`."""
        slope = gamma * float(np.vdot(here.gradient, here.feedforward(change)))
        trial = Trial(
            merit, here, slope, slope, lambda sizes: project(here, change, [gamma * size for size in sizes]),
            smallest=SMALLEST,
        )  # fmt: skip
        size = by_gradient_norm(trial) if trial.in_roundoff else None
        if size is None:
            size = armijo(trial)
            if size is not None and self.options.step_rule == "interpolated":
                size = _parabola(trial, size)
        if size is None:
            return Step(None, rollouts=trial.evaluations)
        there, step = trial(size), change.scaled(gamma * size)
        assert isinstance(there, CurveIterate)
        self._gamma = gamma * size
        return self._arrive(here, step, there, gamma * size, trial.evaluations)

    def _with_momentum(self, here: CurveIterate, change: Curve, merit: Merit) -> Step:
        """Heavy-ball: Armijo's rule along -gamma g and a share of the last step; or without it."""
        assert isinstance(self.rule, HeavyBall) and self.rule.last is not None and self._gamma is not None
        both = change.scaled(self._gamma).plus(self.rule.last, self.rule.momentum)
        if np.vdot(here.gradient, here.feedforward(both)) < 0.0:
            gamma = self._gamma
            step = self._search(here, both, merit, 1.0)
            self._gamma = GROW * gamma if step.alpha >= 1.0 else gamma * max(step.alpha, 0.1)
            if step.iterate is not None:
                return step
        self.rule.restart()
        self.rule.number += 1
        return self._search(here, change, merit, self._offer(here, change))

    def _without_search(self, here: CurveIterate, change: Curve) -> Step:
        """A step of a length known beforehand."""
        gamma = self.options.step_size
        if self.options.step_rule == "diminishing":
            gamma /= (self._taken + 1.0) ** DIMINISHING
        step = change.scaled(gamma)
        if isinstance(self.rule, HeavyBall) and not isinstance(self.rule, Nesterov) and self.rule.last is not None:
            step = step.plus(self.rule.last, self.rule.momentum)
        return self._arrive(here, step, None, gamma, 0)

    def _arrive(self, here: CurveIterate, step: Curve, there: CurveIterate | None, gamma: float, spent: int) -> Step:
        """The iterate at the end of a step: known already, or to be rolled out; extrapolated where the rule does."""
        if isinstance(self.rule, Nesterov):
            ahead = self.rule.ahead(step)
            beyond, spent = project(here, ahead, [1.0])[0], spent + 1
            if beyond.cost <= here.cost or not self.rule.restarts:
                step, there = ahead, beyond
            else:
                self.rule.restart()
                self.rule.number += 1
        if there is None:
            there, spent = project(here, step, [1.0])[0], spent + 1
        if not np.isfinite(there.cost):
            return Step(None, gamma, spent, status=Status.DIVERGED)
        self.rule.took(here, step, there)
        return Step(there, gamma, spent)


def _parabola(trial: Trial, size: float) -> float:
    """The lower of a step that descends and the minimum of the parabola through it."""
    gap = trial.cost(size) - trial.start - trial.slope * size
    best = -0.5 * trial.slope * size * size / gap if gap > 0.0 else GROW * size
    best = min(max(best, 0.1 * size), FARTHEST * size)
    if abs(best - size) > 0.1 * size and trial.descends(best, C1) and trial.cost(best) < trial.cost(size):
        return best
    return size
