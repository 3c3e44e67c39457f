"""Augmented Lagrangian: constraints as losses of the same residuals that costs are made of.

Notation
--------
    r, [lower, upper]    an entry of a constraint's residual at a knot, and its interval
    lambda               its multiplier: positive at the upper limit, negative at the lower one, zero between
    rho                  its penalty weight
    z                    the point of the interval next to r + lambda / rho

    loss        rho/2 (r + lambda/rho - z)^2 - lambda^2 / (2 rho)
    slope       lambda+ = rho (r + lambda/rho - z)                 the multiplier after the round
    curvature   rho where lambda+ is not zero, else 0

For r <= 0 this is max(0, lambda + rho r)^2 / (2 rho) - lambda^2 / (2 rho), for an equality lambda r + rho r^2 / 2. A
point is a solution where the cost and these losses have zero gradient and r = z, which says at once that the interval
is kept and that a multiplier belongs to a limit that is touched.

Source: Powell 1969, Hestenes 1969, Rockafellar 1973; Nocedal and Wright, Numerical Optimization, section 17.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjslq.bound_constraints import BoundConstraint
from mjslq.bound_costs import ResidualCost
from mjslq.losses import Loss, LossCurvature
from mjslq.problem import Problem
from mjslq.solvers.iterate import Iterate
from mjslq.trajectory import Trajectory
from mjslq.validation import Array


class IntervalLoss(Loss):
    """Augmented-Lagrangian loss of a residual in an interval; see the head of this file."""

    def __init__(self, lower: Array, upper: Array, multipliers: Array, weights: Array) -> None:
        self._lower, self._upper, self._multipliers, self._weights = lower, upper, multipliers, weights
        self._offset = multipliers / weights
        self._constant = 0.5 * np.vecdot(multipliers, self._offset)

    def value(self, r: Array) -> Array:
        """See `Loss.value`."""
        beyond = self._beyond(r)
        return 0.5 * np.vecdot(beyond, self._weights * beyond) - self._constant

    def slope(self, r: Array) -> Array:
        """See `Loss.slope`."""
        return self._weights * self._beyond(r)

    def curvature(self, r: Array) -> LossCurvature:
        """See `Loss.curvature`."""
        k, m = r.shape
        W = np.zeros((k, m, m))
        W[:, np.arange(m), np.arange(m)] = np.where(self._beyond(r) != 0.0, self._weights, 0.0)
        return LossCurvature(np.ones(k), W, None)

    def distance(self, r: Array) -> Array:
        """R - z: zero where the interval is kept and multipliers belong to limits that are touched. Shape (k, m)."""
        shifted = r + self._offset
        return r - np.clip(shifted, self._lower, self._upper)

    def _beyond(self, r: Array) -> Array:
        shifted = r + self._offset
        beyond: Array = shifted - np.clip(shifted, self._lower, self._upper)
        return beyond


@dataclass(frozen=True)
class Augmented:
    """A problem's constraints with their multipliers and penalty weights, for a round of the method."""

    problem: Problem
    """The problem with the losses in its cost."""
    constraints: tuple[BoundConstraint, ...]
    losses: tuple[IntervalLoss, ...]
    multipliers: tuple[Array, ...]
    """lambda of each constraint. Shape (k, m)."""
    scales: tuple[Array, ...]
    """What each entry of a constraint is multiplied by. Shape (m,)."""
    rho: float
    """Penalty weight of the scaled constraints, in the cost's unit."""

    @staticmethod
    def of(problem: Problem, multipliers: tuple[Array, ...], scales: tuple[Array, ...], rho: float) -> Augmented:
        """Put losses with these multipliers and weights into the problem's cost."""
        constraints, losses, terms = problem.unpenalized.bound_constraints, [], []
        for constraint, multiplier, scale in zip(constraints, multipliers, scales, strict=True):
            losses.append(IntervalLoss(constraint.lower, constraint.upper, multiplier, rho * scale * scale))
            terms.append(ResidualCost(constraint.residual, losses[-1], constraint.name))
        return Augmented(problem.penalized(terms), constraints, tuple(losses), multipliers, scales, rho)

    def updated(self, trajectory: Trajectory, rho: float) -> Augmented:
        """The next round: multipliers lambda+, another penalty weight."""
        return Augmented.of(self.problem, self.next_multipliers(trajectory), self.scales, rho)

    def next_multipliers(self, trajectory: Trajectory) -> tuple[Array, ...]:
        """lambda+ of each constraint. Shape (k, m)."""
        pairs = zip(self.constraints, self.losses, strict=True)
        return tuple(loss.slope(constraint.residual.value(trajectory)) for constraint, loss in pairs)

    def complementarity(self, trajectory: Trajectory) -> float:
        """The largest |r - z|, scaled."""
        worst = 0.0
        for constraint, loss, scale in zip(self.constraints, self.losses, self.scales, strict=True):
            distance = scale * loss.distance(constraint.residual.value(trajectory))
            worst = max(worst, float(np.abs(distance).max(initial=0.0)))
        return worst

    def about(self, here: Iterate) -> Iterate:
        """The same trajectory as an iterate of this problem; its linearization is kept."""
        there = Iterate(self.problem, here.trajectory)
        if "linearization" in here.__dict__:
            there.__dict__["linearization"] = here.linearization
        return there


def scales_of(problem: Problem, here: Iterate) -> tuple[Array, ...]:
    """min(1, 1/max|gradient|) for each entry of each constraint, gradients along the trajectory. Shape (m,)."""
    found = []
    for constraint in problem.unpenalized.bound_constraints:
        J = constraint.residual.jacobian(here.trajectory, here.linearization)
        largest = np.zeros(constraint.residual.size)
        for part in (J.x, J.u):
            if isinstance(part, np.ndarray):
                largest = np.maximum(largest, np.abs(part).max(axis=(0, 2), initial=0.0))
        largest = np.where(np.isfinite(largest), largest, 1.0)
        found.append(1.0 / np.maximum(largest, 1.0))
    return tuple(found)


def zero_multipliers(problem: Problem) -> tuple[Array, ...]:
    """Zero multipliers. Shape (k, m) each."""
    return tuple(np.zeros_like(constraint.lower) for constraint in problem.unpenalized.bound_constraints)
