"""Limits by relaxed logarithmic barriers, whose weight decreases from round to round.

Notation
--------
    r, [lower, upper]   an entry of a constraint's residual, or a control, and its interval
    s                   half the interval's width; where one side is open, max(1, |limit|)
    z                   slack over s:  (r - lower)/s  and  (upper - r)/s
    eps, delta          weight, in the cost's unit, and relaxation

    beta(z) = -log z                                            for z > delta
              1/2 [ ((z - 2 delta)/delta)^2 - 1 ] - log delta   else:  the parabola that goes on smoothly

The cost gets eps beta for each finite limit of each entry at each knot. Below delta, and beyond the limit, beta stays
finite, so that a start that violates limits can be drawn within; limits that an iterate meets are never violated again,
since steps that would are not taken. For z > delta the minimizer lies within, its multipliers are eps/(s z), and with m
limits its cost is at most eps m above the least one, to first order: eps m relative to the cost is what `barrier` says.

Sources: Hauser and Saccon 2006, "A barrier function method for the optimization of trajectory functionals with
constraints"; Boyd and Vandenberghe, Convex Optimization, section 11.2, for the gap eps m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjslq.binding import bind_control
from mjslq.bound_constraints import BoundConstraint
from mjslq.bound_costs import ResidualCost
from mjslq.knots import knots_of
from mjslq.losses import Loss, LossCurvature
from mjslq.problem import Problem
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

CONTROLS = "controls"
"""What results call the limits of the controls."""


class BarrierLoss(Loss):
    """Relaxed logarithmic barrier of a residual in an interval; see the head of this file."""

    def __init__(self, lower: Array, upper: Array, eps: float, delta: float) -> None:
        both = np.isfinite(lower) & np.isfinite(upper)
        one = np.maximum(1.0, np.abs(np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, 0.0))))
        with np.errstate(invalid="ignore"):
            self._s = np.where(both, 0.5 * (upper - lower), one)
        self._lower, self._upper, self._eps, self._delta = lower, upper, eps, delta
        self._has = np.isfinite(lower), np.isfinite(upper)
        self.count = int(self._has[0].sum() + self._has[1].sum())
        """Number of limits m."""

    def value(self, r: Array) -> Array:
        """See `Loss.value`."""
        total = _sum([np.where(has, self._beta(z), 0.0) for has, z, _ in self.sides(r)])
        values: Array = self._eps * total.sum(axis=1)
        return values

    def slope(self, r: Array) -> Array:
        """See `Loss.slope`."""
        total = _sum([np.where(has, sign * self._first(z), 0.0) for has, z, sign in self.sides(r)])
        return self._eps / self._s * total

    def curvature(self, r: Array) -> LossCurvature:
        """See `Loss.curvature`."""
        k, m = r.shape
        W = np.zeros((k, m, m))
        W[:, np.arange(m), np.arange(m)] = self.diagonal(r)
        return LossCurvature(np.ones(k), W, None)

    def diagonal(self, r: Array) -> Array:
        """Second derivatives by each entry. Shape (k, m)."""
        total = _sum([np.where(has, self._second(z), 0.0) for has, z, _ in self.sides(r)])
        return self._eps / (self._s * self._s) * total

    def sides(self, r: Array) -> tuple[tuple[Array, Array, float], ...]:
        """Of each side: where there is a limit, the slacks z, and the sign of dz/dr."""
        (low, up), s = self._has, self._s
        below = np.where(low, r - np.where(low, self._lower, 0.0), 1.0) / s
        above = np.where(up, np.where(up, self._upper, 0.0) - r, 1.0) / s
        return (low, below, 1.0), (up, above, -1.0)

    def _beta(self, z: Array) -> Array:
        d = self._delta
        inside = -np.log(np.maximum(z, d))
        return np.where(z > d, inside, 0.5 * (((z - 2.0 * d) / d) ** 2 - 1.0) - np.log(d))

    def _first(self, z: Array) -> Array:
        d = self._delta
        return np.where(z > d, -1.0 / np.maximum(z, d), (z - 2.0 * d) / (d * d))

    def _second(self, z: Array) -> Array:
        return 1.0 / np.maximum(z, self._delta) ** 2


@dataclass(frozen=True)
class Barrier:
    """A problem with barriers in its cost, for a round."""

    problem: Problem
    """With the losses."""
    constraints: tuple[BoundConstraint, ...]
    """What they belong to, the limits of the controls among them."""
    losses: tuple[BarrierLoss, ...]
    eps: float
    delta: float

    @staticmethod
    def of(problem: Problem, eps: float, delta: float, controls: bool) -> Barrier:
        """Put barriers of this weight into the problem's cost; with those of the controls, or not."""
        plain = problem.unpenalized
        constraints = plain.bound_constraints
        if controls and plain.box.bounded:
            constraints = (*constraints, _of_controls(plain))
        losses = tuple(BarrierLoss(c.lower, c.upper, eps, delta) for c in constraints)
        terms = [ResidualCost(c.residual, loss, c.name) for c, loss in zip(constraints, losses, strict=True)]
        return Barrier(plain.penalized(terms), constraints, losses, eps, delta)

    @property
    def count(self) -> int:
        """Limits in all, m."""
        return sum(loss.count for loss in self.losses)

    def multipliers(self, trajectory: Trajectory) -> dict[str, Array]:
        """Slopes of the losses: the multipliers that the barrier stands for. Shape (k, m)."""
        pairs = zip(self.constraints, self.losses, strict=True)
        return {c.name: loss.slope(c.residual.value(trajectory)) for c, loss in pairs}

    def control_curvature(self, trajectory: Trajectory) -> Array | None:
        """Second derivatives by the controls of their barriers; None without such. Shape (N, nu)."""
        for constraint, loss in zip(self.constraints, self.losses, strict=True):
            if constraint.name == CONTROLS:
                return loss.diagonal(constraint.residual.value(trajectory))
        return None

    def reach(self, trajectory: Trajectory) -> float:
        """The least slack of all, over s: infinite without limits."""
        least = np.inf
        for constraint, loss in zip(self.constraints, self.losses, strict=True):
            for has, z, _ in loss.sides(constraint.residual.value(trajectory)):
                least = min(least, float(z[has].min(initial=np.inf)))
        return least


def _sum(parts: list[Array]) -> Array:
    below, above = parts
    return below + above


def _of_controls(problem: Problem) -> BoundConstraint:
    """The limits of the controls as a constraint; controls that are fixed need none."""
    box, knots = problem.box, knots_of("running", problem.dynamics.steps(problem.horizon))
    fixed = box.lower == box.upper
    residual = bind_control(problem.dynamics, 0.0, knots)
    return BoundConstraint(
        CONTROLS, residual, np.where(fixed, -np.inf, box.lower), np.where(fixed, np.inf, box.upper)
    )  # fmt: skip
