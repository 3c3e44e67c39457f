"""Newton's method on the constraints in force: the last steps of `constrained`.

Notation
--------
    r, [lower, upper]    an entry of a constraint's residual at a knot, and its interval
    lambda               its multiplier: positive at the upper limit, negative at the lower one
    W, b                 entries in force, each with the limit b that it is held at; equalities always are
    J d                  change of r along a step d of states and controls, by the linearized system
    s                    size of the cost; entries of r are scaled as in `solvers.constrained`
    delta                the proximal term in the dual block, 1 / (`WEIGHT` rho), rho the last round's penalty weight

Step
----
    minimize over d   g'd + 1/2 d'H d  +  sum_W [ lambda (r + J d - b) + (r + J d - b)^2 / (2 delta) ]

within the limits of the controls, by the sweep, with H the exact Hessian of the Lagrangian, whose curvature is weighed
by lambda and by the sweep's costates. Its first-order conditions are those of sequential quadratic programming with
-delta I in the dual block, lambda_new = lambda + (r + J d - b) / delta, so that from step to step the error falls by
a factor of about delta |(J H^-1 J')^-1|, or squares: rows that depend on each other do no harm. The penalty enters
Riccati's recursion as a state or control weight: O(N), but with weights 1e8 apart, which one refinement takes.

W is found within the step: entries that r + J d takes beyond a limit come in, inequalities with a multiplier of the
wrong sign go out, and the sweep is made again, `ROUNDS` times at most.

A step of size 1, 1/2, ... is taken that lowers

    J + sum nu |r - [r]|_1,    nu twice the largest multiplier of the constraint ([.] clips to the interval)

or, at size 1, quarters the error e of constraints and complementarity (the l1 merit function may refuse good steps near
a solution). The method fails, and `constrained` goes on from where it was, where no step will do, after `MOST`, and
where `SLOW` steps do not halve e; without second derivatives two that do not quarter it are too many.

Sources: Nocedal and Wright, Numerical Optimization, chapter 18; Friedlander and Orban 2012, "A primal-dual regularized
interior-point method for convex quadratic programs", for the proximal term.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mjslq.bound_constraints import BoundConstraint
from mjslq.bound_costs import ResidualCost, add_hessian
from mjslq.losses import Loss, LossCurvature
from mjslq.lq.box import BoxSolution, solve_in_box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.problem import Problem
from mjslq.quadratic import Expansion, transposed_times
from mjslq.residuals import Identity, Jacobian
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.method import Step
from mjslq.solvers.steps import candidates
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

WEIGHT, LARGEST = 1e4, 1e12
"""1 / delta relative to the penalty weight of the round before, and at most, for a cost of size 1."""
IN_FORCE, MULTIPLE = 1e-7, 10.0
"""An entry is in force from lambda + `MULTIPLE` c > `IN_FORCE` on, c its violation, scaled."""
BEYOND = 1e-10
"""Violation that the step may leave of an entry that is not in force, scaled."""
ROUNDS = 12
"""Sweeps for one step, at most."""
IN_BOX = 20
"""Sweeps to find the controls at their limits, at most. Weights of constraints are up to 1e8 times those of the
controls: from a poor guess of what is in force, the way along the limits is long, and its end is of no use."""
MOST, SLOW = 15, 4
"""Steps after which the method has failed, and how many of them need not halve the error."""
SHARES = (1.0, 0.5, 0.25, 0.0)
"""Shares of the second derivatives that are tried until there is a minimizer."""
C1, SMALLEST, ENOUGH = 1e-4, 1.0 / 64.0, 0.25
"""Decrease to ask of a step; the least step; share of the error that a full step may leave at any price."""
EXACT = 1e-9
"""Violation that is aimed at, in the constraint's unit."""
ROUNDING = 1e-12
"""Relative rounding of the merit function."""


class LinearLoss(Loss):
    """lambda'r, what a constraint adds to the Lagrangian."""

    constant = True

    def __init__(self, multipliers: Array) -> None:
        self._multipliers = multipliers

    def value(self, r: Array) -> Array:
        """See `Loss.value`."""
        return np.vecdot(self._multipliers, r)

    def slope(self, r: Array) -> Array:
        """See `Loss.slope`."""
        return self._multipliers

    def curvature(self, r: Array) -> LossCurvature:
        """See `Loss.curvature`."""
        k, m = r.shape
        return LossCurvature(np.zeros(k), np.zeros((1, m, m)), None)


def lagrangian(problem: Problem, multipliers: tuple[Array, ...]) -> Problem:
    """The problem with lambda'r in its cost."""
    pairs = zip(problem.unpenalized.bound_constraints, multipliers, strict=True)
    return problem.penalized([ResidualCost(c.residual, LinearLoss(values), c.name) for c, values in pairs])


@dataclass(frozen=True)
class Rows:
    """A constraint at an iterate."""

    constraint: BoundConstraint
    r: Array
    """Shape (k, m)."""
    J: Jacobian
    scale: Array
    """What its entries are multiplied by. Shape (m,)."""
    size: float
    """s."""
    weight: Array
    """1 / delta of its entries, in their own units. Shape (m,)."""

    def along(self, X: Array, U: Array) -> Array:
        """R + J d for changes of the states (N + 1, ndx) and controls (N, nu). Shape (k, m)."""
        knots, r = self.constraint.residual.knots, self.r.copy()
        if isinstance(self.J.x, Identity):
            r += X[knots.at]
        elif self.J.x is not None:
            r += (self.J.x @ X[knots.at][..., None])[..., 0]
        steps = len(knots.steps)
        if isinstance(self.J.u, Identity):
            r[:steps] += U[knots.at_steps]
        elif self.J.u is not None:
            r[:steps] += (self.J.u[:steps] @ U[knots.at_steps][..., None])[..., 0]
        return r

    def add(self, active: Array, multipliers: Array, into: Expansion) -> None:
        """Add the losses of the entries in force, and take lambda'r of the others out. Both of shape (k, m)."""
        knots, (k, m) = self.constraint.residual.knots, self.r.shape
        held = active != 0
        slope = np.where(held, self.weight * (self.r - self.limit(active)), -multipliers)
        W = np.zeros((k, m, m))
        W[:, np.arange(m), np.arange(m)] = np.where(held, self.weight, 0.0)
        add_hessian(knots, self.J, LossCurvature(np.ones(k), W, None), into)
        if self.J.x is not None:
            into.q[knots.at] += slope if isinstance(self.J.x, Identity) else transposed_times(self.J.x, slope)
        if self.J.u is not None:
            by_u = slope if isinstance(self.J.u, Identity) else transposed_times(self.J.u, slope)
            into.r[knots.at_steps] += by_u[: len(knots.steps)]

    def limit(self, active: Array) -> Array:
        """B of the entries in force, what they are of the others. Shape (k, m)."""
        return np.where(active > 0, self.constraint.upper, np.where(active < 0, self.constraint.lower, self.r))

    def first(self, multipliers: Array) -> Array:
        """Entries in force at the start: 1 at the upper limit, -1 at the lower one, 0 for none. Shape (k, m)."""
        c, scaled = self.constraint, multipliers / (self.size * self.scale)
        above = scaled + MULTIPLE * self.scale * (self.r - c.upper) > IN_FORCE
        below = -scaled + MULTIPLE * self.scale * (c.lower - self.r) > IN_FORCE
        return self._equalities(np.where(above, 1.0, np.where(below, -1.0, 0.0)))

    def after(self, active: Array, multipliers: Array, r: Array) -> Array:
        """Entries in force after a sweep that found `multipliers` and residuals `r`. Shape (k, m)."""
        c, slack = self.constraint, BEYOND / self.scale
        kept = np.where(active * multipliers > 0.0, active, 0.0)
        return self._equalities(np.where(r > c.upper + slack, 1.0, np.where(r < c.lower - slack, -1.0, kept)))

    def _equalities(self, active: Array) -> Array:
        return np.where(self.constraint.lower == self.constraint.upper, 1.0, active)

    def beyond(self, r: Array) -> Array:
        """Violation of each entry. Shape (k, m)."""
        return np.maximum(np.maximum(self.constraint.lower - r, r - self.constraint.upper), 0.0)


class Found(NamedTuple):
    """A step, and what it was found with."""

    box: BoxSolution
    multipliers: tuple[Array, ...]
    expected: float
    share: float
    settled: bool
    """Whether the entries in force are those that the step asks for."""


class ActiveSet:
    """Newton's method on the constraints in force; keeps their multipliers from iteration to iteration."""

    def __init__(self, problem: Problem, scales: tuple[Array, ...], size: float) -> None:
        self.problem = problem.unpenalized
        self.multipliers: tuple[Array, ...] = ()
        self._scales, self._size = scales, size
        self._weight, self._second = WEIGHT * size, True
        self._costates: Array | None = None
        self._rows: list[Rows] = []
        self._steps = self._slow = 0

    def begin(self, here: Iterate, multipliers: tuple[Array, ...], rho: float, second: bool) -> Iterate:
        """The same trajectory as an iterate of the Lagrangian with these multipliers.

        `rho` is the penalty weight with which they were found; `second` says whether to use second derivatives.
        """
        self._costates, self._steps, self._slow = None, 0, 0
        self._weight, self._second = min(WEIGHT * rho, LARGEST * self._size), second
        return self._about(here.trajectory, multipliers, here)

    def direction(self, here: Iterate) -> Direction:
        """Solve for the step at the head of this file. Raises NotPositiveDefinite."""
        base = here.gauss_newton
        exact = here.hamiltonian(here.costates if self._costates is None else self._costates) if self._second else base
        self._rows = self._rows_of(here)
        for share in SHARES if self._second else (0.0,):
            try:
                self._found = self._solve(here, base, exact, share)
                break
            except NotPositiveDefinite:
                if share == 0.0:
                    raise
        lq = self._found.box.lq
        return Direction(lq.X, lq.U, lq.k, lq.K, self._found.expected, self._found.box.held, sweep=lq)

    def step(self, here: Iterate, direction: Direction) -> Step:
        """Go along the direction, with new multipliers; no iterate where the method fails."""
        self._steps += 1
        if self._steps > MOST or self._slow > (SLOW if self._second else 1):
            return Step(None)
        start, slope = self._merit(here.trajectory), self._slope(here, direction)
        error, alpha, spent = self.error(here.trajectory, self.multipliers), 1.0, 0
        while alpha >= SMALLEST:
            there, spent = candidates(here, direction, [alpha], "closed-loop")[0].trajectory, spent + 1
            if not there.diverged:
                pairs = zip(self.multipliers, self._found.multipliers, strict=True)
                multipliers = tuple(old + alpha * (new - old) for old, new in pairs)
                falls = self._merit(there) <= start + C1 * alpha * min(slope, 0.0) + ROUNDING * abs(start)
                left = self.error(there, multipliers)
                if falls or (alpha == 1.0 and left <= max(ENOUGH * error, EXACT)):
                    self._slow += left > max((0.5 if self._second else ENOUGH) * error, EXACT)
                    self._costates = direction.costates
                    return Step(self._about(there, multipliers), alpha, spent)
            alpha *= 0.5
        return Step(None, rollouts=spent)

    def error(self, trajectory: Trajectory, multipliers: tuple[Array, ...]) -> float:
        """e, the largest |r - z|, scaled: z is the point of the interval next to r + lambda / weight."""
        worst = 0.0
        for c, scale, values in zip(self.problem.bound_constraints, self._scales, multipliers, strict=True):
            r = c.residual.value(trajectory)
            z = np.clip(r + values / (self._size * scale * scale), c.lower, c.upper)
            worst = max(worst, float(np.abs(scale * (r - z)).max(initial=0.0)))
        return worst

    def _about(self, trajectory: Trajectory, multipliers: tuple[Array, ...], before: Iterate | None = None) -> Iterate:
        self.multipliers = multipliers
        there = Iterate(lagrangian(self.problem, multipliers), trajectory)
        if before is not None and "linearization" in before.__dict__:
            there.__dict__["linearization"] = before.linearization
        return there

    def _rows_of(self, here: Iterate) -> list[Rows]:
        found = []
        for c, scale in zip(self.problem.bound_constraints, self._scales, strict=True):
            r, J = c.residual.value(here.trajectory), c.residual.jacobian(here.trajectory, here.linearization)
            found.append(Rows(c, r, J, scale, self._size, self._weight * scale**2))
        return found

    def _solve(self, here: Iterate, base: LQProblem, exact: LQProblem, share: float) -> Found:
        """The step with a share of the second derivatives, entries in force found by repeated sweeps."""
        Q, R, M = ((1.0 - share) * a + share * b for a, b in zip(base[2:5], exact[2:5], strict=True))
        active = [rows.first(values) for rows, values in zip(self._rows, self.multipliers, strict=True)]
        for _ in range(ROUNDS):
            into = Expansion(Q.copy(), R.copy(), M.copy(), base.q.copy(), base.r.copy())
            for rows, at, values in zip(self._rows, active, self.multipliers, strict=True):
                rows.add(at, values, into)
            model = base._replace(**into._asdict())
            found = solve_in_box(model, here.box, rounds=IN_BOX)
            X, U = found.lq.X, found.lq.U
            along = [rows.along(X, U) for rows in self._rows]
            multipliers = tuple(
                np.where(at != 0.0, values + rows.weight * (r - rows.limit(at)), 0.0)
                for rows, at, values, r in zip(self._rows, active, self.multipliers, along, strict=True)
            )
            wanted = [
                rows.after(at, values, r)
                for rows, at, values, r in zip(self._rows, active, multipliers, along, strict=True)
            ]
            settled = all((a == b).all() for a, b in zip(active, wanted, strict=True))
            if settled:
                break
            active = wanted
        return Found(found, multipliers, model.value(X, U), share, settled)

    def _weights(self) -> list[float]:
        """Nu of each constraint."""
        return [2.0 * float(np.abs(values).max(initial=0.0)) for values in self._found.multipliers]

    def _merit(self, trajectory: Trajectory) -> float:
        total = self.problem.cost(trajectory)
        for rows, weight in zip(self._rows, self._weights(), strict=True):
            total += weight * float(rows.beyond(rows.constraint.residual.value(trajectory)).sum())
        return total

    def _slope(self, here: Iterate, direction: Direction) -> float:
        """Derivative of the merit function along the direction, which leaves nothing of the violations."""
        base = here.gauss_newton
        total = float(np.vdot(base.q, direction.X) + np.vdot(base.r, direction.U))
        for rows, values, weight in zip(self._rows, self.multipliers, self._weights(), strict=True):
            total -= float(np.vdot(values, rows.along(direction.X, direction.U) - rows.r))
            total -= weight * float(rows.beyond(rows.r).sum())
        return total
