"""`constrained`: an augmented Lagrangian, minimized by the sweeps of `auto` within the limits of the controls.

Notation
--------
    L          cost and losses of the constraints (`solvers.augmented`): the augmented Lagrangian
    s          size of the cost, so that constants do not depend on its unit
    rho        penalty weight; rho / s is the one of a cost of size 1
    e          complementarity, the largest |r - z|: how far constraints are from being met and touched
    t          tolerance of a round

Rounds
------
    1  iterate on L, once at least, until |slope of the direction| < t (s + |L|), or `ROUND` iterations
    2  lambda <- lambda+;  rho <- 10 rho where e has not fallen below a quarter of its last value
    3  t <- max(`LEAST_T`, min(0.3 t, 0.01 e))

from rho = 0.01 s and t = 0.01. Low weights first: where obstacles are in the way, a start that lies beyond one of them
can still be pushed to either side. Where no step descends, kinks of the losses are in the way: then the round goes on
with a tenth of rho, and lambda stays.

Last steps
----------
    4  after a round with e < 0.01 and t <= 1e-4, Newton's method on the constraints in force (`solvers.active_set`),
       from lambda+ to violations below `EXACT`; where it fails, the rounds go on, and 4 waits for a tenth of e and t (a
       hundredth without second derivatives)

The last steps take second derivatives where the rounds have taken them in, or where they are cheap. Without them the
solve ends when all constraints are met within `tol_violation`, e is as small, and L has no slope left by the tests that
all methods share: at such a point the gradient of L is that of the Lagrangian. Where the constraints are met, rounds
end no more.

A solve that starts from a result of the same constraints begins with 4, from its multipliers; where that fails, the
rounds start with these multipliers, and with rho 100 times the largest of them.

Infeasible: e above 0.9 of its least value in `STALLED` rounds, and rho at least 1e4 s. Then the solve starts anew from
its start, twice at most, and then says so; it starts anew, too, where no step descends with any weight. It starts with
a tenth of the first rho, or, from a start that meets the constraints, with a hundred times as much, and of the cost of
the start: there the first round went astray, such as through a wall. This is a local verdict: the iterate is a
stationary point of the violation, and there may be another way. Where the linearized system says that there is one
(`solvers.feasibility`), the constraints are scaled by what is left of them, once, and the solve starts anew.

Each constraint's entry is scaled by the largest gradient that it has along the start. Limits of the controls are no
part of this: the sweeps keep to them exactly.

The result is the last iterate where the solve converged. Where it was cut off, it is the one with the least violation v
(the least cost among those that meet the constraints), or the last one, if that has come down to `CLOSING` of the
largest v and has the lower J + 2 p v: p = sum |lambda+|, the price of one unit of v at all constraints.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mjslq.lq.box import Box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.regularize import damped
from mjslq.options import ConstrainedOptions
from mjslq.solvers.active_set import EXACT, ActiveSet
from mjslq.solvers.augmented import Augmented, scales_of, zero_multipliers
from mjslq.solvers.auto import Auto
from mjslq.solvers.feasibility import beyond, fixed, reducible, verdict
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import in_roundoff
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Duals, Method, Step
from mjslq.status import Status
from mjslq.validation import Array

ROUND = 60
"""Iterations of a round, at most."""
FIRST_T, LEAST_T, TIGHTEN, OF_COMPLEMENTARITY = 1e-2, 1e-10, 0.3, 1e-2
"""Tolerances of the rounds."""
ENOUGH, GROW, LARGEST = 0.25, 10.0, 1e9
"""Share of the complementarity that a round may leave; growth and largest value of rho / s."""
NOT_FALLING, STALLED, HEAVY = 0.9, 4, 1e4
"""What makes a problem infeasible."""
RESTARTS, LIGHTER, HEAVIER = 2, 0.1, 100.0
"""Times that the solve starts anew, and the factors on the first rho."""
LEAST_SHARE = 1e-3
"""Least size of the cost, relative to that of the start."""
NEAR_E, NEAR_T = 1e-2, 1e-4
"""Complementarity and tolerance of a round from which on the last steps are tried."""
WARM, WARMEST = 100.0, 1e7
"""The weight to go on with from given multipliers: so many times the largest of them, scaled. The largest rho / s then,
where the start is near a solution; elsewhere it is `HEAVY`: multipliers of plans that were cut off may be anything."""
CHEAP = 20.0
"""Price of second derivatives, in linearizations, up to which the last steps use them in any case."""
MOVABLE = 0.5
"""Share of the squared violations below which the linearized system says that there is a way."""
CLOSING = 0.1
"""Share of the largest violation of all iterates below which the constraints are being met."""
FAILURES = 4
"""Times in a row that no step descends, at most; each time the weight is divided by `GROW`."""


class Best(NamedTuple):
    """The iterate to fall back on."""

    violation: float
    cost: float
    violations: dict[str, Array]
    iterate: Iterate
    augmented: Augmented | None
    """The round that it is from; None for the last steps."""
    multipliers: tuple[Array, ...]
    """Those of the last steps."""
    tol: float

    @property
    def rank(self) -> tuple[float, float]:
        """Less is better; all that meets the constraints is as good."""
        return max(self.violation, self.tol), self.cost


class Constrained(Method):
    """The method, with its round."""

    def __init__(self, options: ConstrainedOptions) -> None:
        self.options = options
        self._inner = Auto(options, kinks=False)
        self._rounds = self._restarts = self._iterations = self._failures = self._stalled = 0
        self._best: Best | None = None
        self._worst = 0.0
        self._augmented: Augmented | None = None
        self._active: ActiveSet | None = None
        self._before: Iterate | None = None  # where the last steps began, while they are being made
        self._switch, self._lost, self._last_steps, self._rescaled = 1.0, False, 0, False
        self._hopeless = False
        self._given: Mapping[str, Array] = {}
        self._said = ""

    def warm_start(self, multipliers: Mapping[str, Array]) -> None:
        """See `Method.warm_start`."""
        self._given = multipliers

    def begin(self, start: Iterate) -> Iterate:
        """Put the losses of the first round into the cost, or begin with the last steps where multipliers are given."""
        self._start = start
        self._scales = scales_of(start.problem, start)
        self._size = cost_size(start, self._scales)
        self._active = ActiveSet(start.problem, self._scales, self._size)
        self._first_rho = self.options.penalty * self._size
        self._start_is_met = start.problem.violation(start.trajectory) <= self.options.tol_violation
        self._said = fixed(start, self.options.tol_violation)
        self._hopeless = bool(self._said)
        here = self._restart()
        constraints = start.problem.unpenalized.bound_constraints
        given = [self._given.get(constraint.name) for constraint in constraints]
        known = tuple(m for m, c in zip(given, constraints, strict=True) if m is not None and m.shape == c.lower.shape)
        return self._warm(here, known) if known and len(known) == len(constraints) and not self._hopeless else here

    def direction(self, here: Iterate) -> Direction:
        """The direction of `auto` on L, or Newton's on the constraints in force."""
        self._lost = False
        if self._before is not None:
            try:
                return self._newton.direction(here)
            except NotPositiveDefinite:
                self._lost, here = True, self._before
        return self._inner.direction(here)

    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """A step on L, or the next round where this one is over."""
        if self._hopeless:
            return Step(None, status=Status.INFEASIBLE)
        if self._before is not None:
            return self._newton_step(here, direction)
        self._iterations += 1
        slope, accepted = abs(merit.slope(here, direction)), self.accepts(here)
        small = not self._inner.damped and slope < self._t * (self._size + abs(here.cost))
        if (small and not accepted and self._iterations > 1) or self._iterations > ROUND:
            self._failures = 0
            step = self._inner.step(here, direction, merit)
            return self._next_round(here if step.iterate is None else step.iterate, step)
        step = self._inner.step(here, direction, merit)
        if step.iterate is None:
            lost = in_roundoff(slope, here.cost)
            self._failures = 0 if small or lost else self._failures + 1
            if accepted and lost:
                self._said = "The decrease that a step could bring is lost in rounding."
                return Step(None, rollouts=step.rollouts, status=Status.CONVERGED)
            if self._failures > FAILURES:
                return step if accepted or self._restarts == RESTARTS else self._give_up(here, step.rollouts)
            return self._next_round(here, step) if small or lost else self._soften(here, step.rollouts)
        self._failures = 0
        self._keep(step.iterate)
        return step

    def accepts(self, here: Iterate) -> bool:
        """Whether constraints are met and multipliers belong to limits that are touched."""
        tol, augmented = self.options.tol_violation, self._round
        if self._before is not None:
            exact = here.problem.violation(here.trajectory) <= min(EXACT, tol) and not self._lost
            return exact and self._newton.error(here.trajectory, self._newton.multipliers) <= EXACT
        met = augmented.problem.violation(here.trajectory) <= tol
        return met and augmented.complementarity(here.trajectory) <= tol

    def best(self, last: Iterate, status: Status) -> Iterate:
        """The last iterate where the solve converged, or the better of that and the one with the least violation."""
        best = self._best
        if status is Status.CONVERGED or best is None:
            return last
        found = self._seen(last) if np.isfinite(last.cost) and status is not Status.INFEASIBLE else best
        multipliers = (
            found.multipliers if found.augmented is None else found.augmented.next_multipliers(last.trajectory)
        )
        price = 2.0 * sum(float(np.abs(values).sum()) for values in multipliers)
        worth = [entry.cost + price * max(entry.violation - entry.tol, 0.0) for entry in (found, best)]
        closing = found.violation < CLOSING * self._worst
        return last if closing and worth[0] < worth[1] else best.iterate

    def duals(self, here: Iterate) -> Duals:
        """Multipliers lambda+ and violations at `here`."""
        if self._best is None:  # it failed before it began
            return Duals()
        best = self._best if self._best.iterate is here else self._seen(here)
        values = best.multipliers
        if best.augmented is not None:
            values = best.augmented.next_multipliers(here.trajectory)
        named = zip(here.problem.unpenalized.bound_constraints, values, strict=True)
        multipliers = {constraint.name: multiplier for constraint, multiplier in named}
        return Duals(multipliers, best.violations, best.violation)

    def remark(self) -> str:
        """How the rounds went."""
        parts = [f"{self._rounds} {'round' if self._rounds == 1 else 'rounds'}"]
        if self._restarts:
            how = f"with a {'larger' if self._start_is_met else 'smaller'} penalty"
            parts.append(f"{self._restarts} {'restart' if self._restarts == 1 else 'restarts'} {how}")
        if self._last_steps:
            parts.append(f"{self._last_steps} Newton {'step' if self._last_steps == 1 else 'steps'}")
        if self._rescaled:
            parts.append("constraints rescaled")
        said = f"constrained: {', '.join(parts)}."
        return f"{self._said} {said}" if self._said else said

    @property
    def _round(self) -> Augmented:
        assert self._augmented is not None
        return self._augmented

    def _warm(self, here: Iterate, multipliers: tuple[Array, ...]) -> Iterate:
        """The last steps from given multipliers; the rounds start with them where these fail."""
        largest = max(float(np.abs(m / s).max(initial=0.0)) for m, s in zip(multipliers, self._scales, strict=True))
        near = self._newton.error(self._start.trajectory, multipliers) < NEAR_E
        rho = min(max(WARM * largest, self._first_rho), (WARMEST if near else HEAVY) * self._size)
        self._augmented = Augmented.of(self._start.problem, multipliers, self._scales, rho)
        self._t, self._before = NEAR_T, self._round.about(self._start)
        there = self._newton.begin(here, multipliers, rho, self._curved)
        self._keep(there)
        return there

    @property
    def _curved(self) -> bool:
        """Whether the last steps use second derivatives."""
        cheap = self._start.problem.dynamics.curvature_price <= CHEAP
        return self.options.curvature == "always" or self._inner.second or (cheap and self.options.curvature == "auto")

    @property
    def _newton(self) -> ActiveSet:
        assert self._active is not None
        return self._active

    def _newton_step(self, here: Iterate, direction: Direction) -> Step:
        """One of the last steps, or back to where they began."""
        step = Step(None) if self._lost else self._newton.step(here, direction)
        if step.iterate is not None:
            self._last_steps += 1
            self._keep(step.iterate)
            return step
        before, self._before = self._before, None
        self._switch *= 0.1 if self._curved else 0.01
        return Step(before, rollouts=step.rollouts, rejected=True)

    def _restart(self) -> Iterate:
        """The first round from the start."""
        self._augmented = Augmented.of(
            self._start.problem, zero_multipliers(self._start.problem), self._scales, self._first_rho
        )
        self._t, self._last, self._least, self._stalled = FIRST_T, np.inf, np.inf, 0
        self._iterations = self._failures = 0  # of this round; rounds in a row without a step
        self._rounds += 1
        self._inner = Auto(self.options, kinks=False)
        here = self._round.about(self._start)
        self._keep(here)
        return here

    def _next_round(self, here: Iterate, step: Step) -> Step:
        """Rules 2 and 3 at the head of this file, or the end."""
        rollouts = step.rollouts
        e, rho = self._round.complementarity(here.trajectory), self._round.rho
        tol = self.options.tol_violation
        self._stalled = self._stalled + 1 if e > max(NOT_FALLING * self._least, tol) else 0
        if self._stalled >= STALLED and rho >= HEAVY * self._size:
            return self._give_up(here, rollouts)
        self._least = min(self._least, e)
        if e > ENOUGH * self._last and e > 0.1 * tol:
            rho = min(GROW * rho, LARGEST * self._size)
        self._last = e
        self._t = max(LEAST_T, min(TIGHTEN * self._t, OF_COMPLEMENTARITY * e))
        before, multipliers = self._round, self._round.next_multipliers(here.trajectory)
        self._augmented = before.updated(here.trajectory, rho)
        self._iterations, self._rounds = 0, self._rounds + 1
        there = self._augmented.about(here)
        self._keep(there)
        if e < self._switch * NEAR_E and self._t <= self._switch * NEAR_T:
            self._before, there = there, self._newton.begin(there, multipliers, before.rho, self._curved)
        return Step(there, step.alpha, rollouts, rejected=step.iterate is None)

    def _soften(self, here: Iterate, rollouts: int) -> Step:
        """The same round with a smaller weight, where no step descends: kinks of the losses are in the way."""
        augmented = self._round
        multipliers, rho = augmented.multipliers, augmented.rho / GROW
        self._augmented = Augmented.of(augmented.problem, multipliers, augmented.scales, rho)
        self._iterations = 0
        return Step(self._augmented.about(here), rollouts=rollouts, rejected=True)

    def _give_up(self, here: Iterate, rollouts: int) -> Step:
        """Start anew with a smaller penalty, or call the problem infeasible."""
        if self._restarts < RESTARTS:
            left = 1.0 if self._best is None else reducible(self._best.iterate, self._scales)
            if left < MOVABLE and not self._rescaled:
                self._rescale(self._best)
                return Step(self._restart(), rollouts=rollouts, rejected=True)
            self._restarts += 1
            self._first_rho *= HEAVIER if self._start_is_met else LIGHTER
            if self._start_is_met:  # as heavy as it takes to let nothing pass that lowers the cost
                self._first_rho = max(self._first_rho, HEAVIER * abs(self._start.cost))
            return Step(self._restart(), rollouts=rollouts, rejected=True)
        best = here if self._best is None else self._best.iterate
        self._said = verdict(best, self.options.tol_violation)
        if self._said and reducible(best, self._scales) < MOVABLE:
            self._said += " The linearized system could meet them: give constraints units in which they are about 1."
            return Step(None, rollouts=rollouts)
        if self._said:
            return Step(None, rollouts=rollouts, status=Status.INFEASIBLE)
        self._said = "The constraints are met, but a point of least cost that meets them was not found."
        return Step(None, rollouts=rollouts)

    def _rescale(self, best: Best | None) -> None:
        """Scale all constraints so that the largest violation that was left is one."""
        assert best is not None
        self._rescaled = True
        violations = best.iterate.problem.unpenalized.bound_constraints
        c = max(
            float((scale * beyond(constraint, best.iterate)).max(initial=0.0))
            for constraint, scale in zip(violations, self._scales, strict=True)
        )
        self._scales = tuple(scale / c for scale in self._scales)
        self._active = ActiveSet(self._start.problem, self._scales, self._size)

    def _keep(self, iterate: Iterate) -> None:
        """Remember the iterate if it is the best so far."""
        found = self._seen(iterate)
        self._worst = max(self._worst, found.violation)
        if self._best is None or found.rank <= self._best.rank:
            self._best = found

    def _seen(self, iterate: Iterate) -> Best:
        """What an iterate of this round is worth."""
        problem, trajectory = iterate.problem.unpenalized, iterate.trajectory
        violations = problem.violations(trajectory)
        worst = max((float(violation.max()) for violation in violations.values()), default=0.0)
        tol = self.options.tol_violation
        augmented = None if self._before is not None else self._round
        multipliers = () if self._before is None else self._newton.multipliers
        return Best(worst, problem.cost(trajectory), violations, iterate, augmented, multipliers, tol)


def cost_size(start: Iterate, scales: tuple[Array, ...]) -> float:
    """s: what a step towards the constraints costs, at most the cost of the start.

    Where they are met, it is the least cost that the model at the start expects. The step is the one of steepest
    descent, in the metric of the control weights, of half the squared violations. Too small a size takes a few rounds
    more, too large a one may end at the wrong side of an obstacle.
    """
    problem = start.problem
    penalized = Augmented.of(problem, zero_multipliers(problem), scales, 1.0).about(start)
    cost, both = start.gauss_newton, penalized.gauss_newton
    slope = penalized.gradient - start.gradient
    weights = np.einsum("nii->ni", cost.R)
    U = -slope / np.maximum(weights, 1e-6 * weights.max(initial=0.0) + 1e-300)
    X = cost.states(U)
    own = cost.value(X, U) - float(np.vdot(cost.q, X) + np.vdot(cost.r, U))
    violations = both.value(X, U) - float(np.vdot(both.q, X) + np.vdot(both.r, U)) - own
    length = -0.5 * float(np.vdot(slope, U)) / violations if violations > 0.0 else 0.0
    price, at_start = length * length * own, abs(start.cost)
    if not 0.0 < price < np.inf:
        return max(abs(start.cost + _decrease(cost, start.box)), LEAST_SHARE * at_start) or 1.0
    return min(max(price, LEAST_SHARE * at_start), at_start or np.inf)


def _decrease(model: LQProblem, box: Box) -> float:
    """Change of the cost from the start to its model's minimizer."""
    try:
        lq = damped(model, box).found.lq
    except NotPositiveDefinite:
        return 0.0
    return model.value(lq.X, lq.U)
