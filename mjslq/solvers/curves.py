"""What `pronto` and `gopronto` share: gains that are watched, rounds of the barrier, and the best iterate so far.

Notation
--------
    J, J_0     cost of an iterate and of the start, barriers left out
    m, eps     number of limits, and weight of their barriers (`solvers.barrier`)
    c          `barrier`, the share of the cost that may be lost to the barriers at the end

Rounds, from eps = `FIRST` |J_0| / m
------------------------------------
    1  iterate on J and barriers until a few steps in a row (`PATIENCE`) lower it by less than `OVER` eps m each
    2  where the least slack is below delta: delta <- delta/10, and the round goes on
       else eps <- max(eps/10, c |J|/m), delta a twentieth of the least slack

Each round makes gains of its own, since a control near a limit must not follow the feedback as others do. The last
round is the one with eps m <= c |J|; it ends by the tests that all methods share. Where no step descends, gains are
made anew, then delta is divided by 10, a few times.
"""

from __future__ import annotations

from abc import abstractmethod

from mjslq.options import CurveOptions
from mjslq.problem import Problem
from mjslq.solvers.barrier import Barrier
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Duals, Method, Step
from mjslq.solvers.projection import CurveIterate
from mjslq.solvers.regulator import Regulator
from mjslq.status import Status

FIRST, OVER, SHRINK = 0.1, 0.1, 0.1
"""Of the rounds; see the head of this file."""
FIRST_DELTA, LEAST_DELTA, OF_SLACK = 0.1, 1e-12, 0.05
"""Relaxations."""
MET = 1e-9
"""Violation up to which a limit counts as met."""
NEGLIGIBLE = 1e-8
"""Cost, relative to the start's, below which the barriers' share of it does not shrink any further."""


class CurveMethod(Method):
    """A method that goes from curve to curve; subclasses have the direction and the step along it."""

    patience = 1
    """Steps in a row that have to be small for a round to be over."""

    def __init__(self, options: CurveOptions) -> None:
        self.settings = options
        self.regulator = Regulator(options.gains, options.regulator)
        self.barrier: Barrier | None = None
        self._rounds = self._small = 0
        self._final = True
        self._best: tuple[tuple[float, float], CurveIterate, Barrier | None] | None = None
        self._said = ""

    @abstractmethod
    def curve_step(self, here: CurveIterate, direction: Direction, merit: Merit) -> Step:
        """Go along `direction`."""

    @property
    def stale(self) -> bool:
        """Whether the gains' metric has come to mislead."""
        return False

    def restart(self) -> None:
        """Forget what was learnt of the cost: it is another one now, or has other gains."""
        return

    def check(self, problem: Problem) -> None:
        """Refuse gains and weights of other sizes."""
        self.regulator.check(problem)

    def begin(self, start: Iterate) -> Iterate:
        """Put barriers into the cost, and find gains."""
        problem = start.problem
        self._start_cost = abs(start.cost)
        if problem.bound_constraints or (self.barriers_controls and problem.box.bounded):
            barrier = Barrier.of(problem, 1.0, FIRST_DELTA, self.barriers_controls)
            eps = FIRST * (self._start_cost or 1.0) / max(barrier.count, 1)
            self._take(Barrier.of(problem, eps, FIRST_DELTA, self.barriers_controls), start.cost)
        cost = problem if self.barrier is None else self.barrier.problem
        here = CurveIterate(cost, start.trajectory, None, inside=self.barriers_controls)
        here = self.regulator.with_gains(here)
        self._keep(here)
        return here

    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """A step, other gains from the same trajectory, or the next round."""
        assert isinstance(here, CurveIterate)
        step = self.curve_step(here, direction, merit)
        if step.iterate is None:
            return self._without_step(here, step)
        there = step.iterate
        assert isinstance(there, CurveIterate)
        watched = self.regulator.watched(there)
        if watched is there and self.stale:
            watched = self.regulator.renewed(there) or there
        if watched is not there:
            self.restart()
        self._keep(watched)
        if self.barrier is not None and not self._final:
            small = here.cost - there.cost < OVER * self.barrier.eps * self.barrier.count
            self._small = self._small + 1 if small else 0
            if self._small >= self.patience:
                watched = self._next_round(watched)
        return Step(watched, step.alpha, step.rollouts)

    def accepts(self, here: Iterate) -> bool:
        """Whether the barriers' share of the cost is as small as asked for, and all limits are met."""
        return self._final and here.problem.violation(here.trajectory) <= MET

    def best(self, last: Iterate, status: Status) -> Iterate:
        """The last iterate where the solve converged, or the one of least cost among those that meet the limits."""
        if status is Status.CONVERGED or self._best is None:
            return last
        _, found, self.barrier = self._best
        return found

    def duals(self, here: Iterate) -> Duals:
        """Multipliers that the barriers stand for, and violations."""
        problem = here.problem.unpenalized
        multipliers = {} if self.barrier is None else self.barrier.multipliers(here.trajectory)
        violations = problem.violations(here.trajectory)
        worst = max((float(violation.max()) for violation in violations.values()), default=0.0)
        return Duals(multipliers, violations, worst)

    def remark(self) -> str:
        """How often gains were made, and the rounds of the barrier."""
        parts = [f"gains made {self.regulator.made} times"] if self.regulator.made > 1 else []
        if self.barrier is not None:
            share = self.barrier.eps * self.barrier.count
            parts.append(f"{self._rounds} rounds of the barrier, whose share of the cost is about {share:.1e}")
        return " ".join(part for part in (self._said, "; ".join(parts).capitalize() + "." if parts else "") if part)

    @property
    def barriers_controls(self) -> bool:
        """Whether barriers keep the limits of the controls, or clipping does."""
        return self.settings.limits == "barrier"

    def _take(self, barrier: Barrier, cost: float) -> None:
        target = self.settings.barrier * max(abs(cost), NEGLIGIBLE * self._start_cost)
        self.barrier, self._small = barrier, 0
        self.regulator.stiffen = barrier.control_curvature
        self._rounds += 1
        self._final = barrier.eps * barrier.count <= 1.0001 * target

    def _next_round(self, here: CurveIterate) -> CurveIterate:
        """Rule 2 at the head of this file."""
        assert self.barrier is not None
        eps, delta, slack = self.barrier.eps, self.barrier.delta, self.barrier.reach(here.trajectory)
        cost = here.problem.unpenalized.cost(here.trajectory)
        if slack < delta and delta > LEAST_DELTA:
            delta *= SHRINK
        else:
            target = self.settings.barrier * max(abs(cost), NEGLIGIBLE * self._start_cost)
            eps = max(SHRINK * eps, target / max(self.barrier.count, 1))
            delta = max(LEAST_DELTA, min(delta, OF_SLACK * slack))
        return self._changed(here, Barrier.of(here.problem, eps, delta, self.barriers_controls), cost)

    def _changed(self, here: CurveIterate, barrier: Barrier, cost: float) -> CurveIterate:
        self._take(barrier, cost)
        self.restart()
        there = self.regulator.with_gains(here.under(here.K, barrier.problem))
        self._keep(there)
        return there

    def _without_step(self, here: CurveIterate, step: Step) -> Step:
        """Other gains; a smaller relaxation; the next round; or the end."""
        renewed = self.regulator.renewed(here)
        if renewed is not None:
            self.restart()
            return Step(renewed, rollouts=step.rollouts, rejected=True)
        barrier = self.barrier
        if barrier is None:
            return step
        cost = here.problem.unpenalized.cost(here.trajectory)
        if barrier.reach(here.trajectory) < barrier.delta and barrier.delta > LEAST_DELTA:
            smaller = Barrier.of(here.problem, barrier.eps, SHRINK * barrier.delta, self.barriers_controls)
            return Step(self._changed(here, smaller, cost), rollouts=step.rollouts, rejected=True)
        if not self._final:
            return Step(self._next_round(here), rollouts=step.rollouts, rejected=True)
        if here.problem.violation(here.trajectory) > MET:
            violated = [
                f"{name!r} by {worst:.3g}"
                for name, violation in here.problem.unpenalized.violations(here.trajectory).items()
                if (worst := float(violation.max())) > MET
            ]
            self._said = f"Violated: {', '.join(violated)}."
            return Step(None, rollouts=step.rollouts, status=Status.INFEASIBLE)
        return step

    def _keep(self, here: CurveIterate) -> None:
        """Remember the iterate if it is the best so far."""
        plain = here.problem.unpenalized
        cost = here.cost if plain is here.problem else plain.cost(here.trajectory)
        rank = max(plain.violation(here.trajectory) if self.barrier is not None else 0.0, MET), cost
        if self._best is None or rank <= self._best[0]:
            self._best = rank, here, self.barrier
