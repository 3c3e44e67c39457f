"""Costs in which the length of the steps is an unknown: integrals over time, and time itself.

Notation
--------
    T, T_0           the final time, and the one that the steps had when the term was bound
    c_n(z, v)        cost at knot n with the steps of T_0
    J = sum_n (T / T_0) c_n   over knots with a step, c_N at the last one

    dJ/dT = sum_n c_n / T_0

T is an entry of the state at knots n >= 1, and of the control at knot 0 (`dynamics.augmented`). The Hessian has

    d2J/dTd(z, v) = g_n / T_0,    d2J/dT2 = 0,             g_n the gradient of c_n

which is no convex model. For sums of squares `expand` takes that of the residuals times sqrt(T / T_0),

    g_n / (2 T_0),    c_n / (2 T T_0)

which is, and for other terms nothing; `complete` adds the rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjslq.bound_costs import BoundTerm, KnotTerm
from mjslq.dynamics.dynamics import Linearization
from mjslq.quadratic import Expansion
from mjslq.residuals import Slopes
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.lift import Lift

UNUSED = "unused"
"""Label of `UnusedControls`."""


class ScaledTerm(BoundTerm):
    """An integral over time on the augmented system."""

    def __init__(self, lift: Lift, term: KnotTerm) -> None:
        self._lift, self._term, self.label = lift, term, term.label

    def cost(self, trajectory: Trajectory) -> float:
        """See `BoundTerm.cost`."""
        return float(np.vdot(self._ratios(trajectory)[self._term.knots.indices], self._term.values(trajectory)))

    def slopes(self, trajectory: Trajectory, into: Slopes) -> None:
        """See `BoundTerm.slopes`."""
        ratio, part = self._ratios(trajectory), Slopes(*map(np.zeros_like, into))
        self._term.slopes(trajectory, part)
        into.q[:] += ratio[:, None] * part.q
        into.r[:] += ratio[:-1, None] * part.r
        into.y[:] += ratio[:, None] * part.y
        self._add_slope(trajectory, into.q, into.r)

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        """See `BoundTerm.expand`."""
        part = Expansion(*map(np.zeros_like, into))
        self._term.prepare(part)
        self._term.expand(trajectory, linearization, part)
        self._add_scaled(trajectory, part, into)
        self._add_slope(trajectory, into.q, into.r)
        if self._term.squared:
            self._add_mixed(part, 0.5, into)
            self._add_bend(trajectory, 0.5, into)

    def complete(self, trajectory: Trajectory, into: Expansion, weights: Array) -> None:
        """See `BoundTerm.complete`; what is mixed with T needs the outputs' Jacobians and comes in `complete_ends`."""
        part, of_outputs = Expansion(*map(np.zeros_like, into)), np.zeros_like(weights)
        self._term.complete(trajectory, part, of_outputs)
        self._add_scaled(trajectory, part, into)
        weights += self._ratios(trajectory)[:, None] * of_outputs

    def complete_ends(
        self, trajectory: Trajectory, linearization: Linearization, into: Expansion, costates: Array
    ) -> None:
        """See `BoundTerm.complete_ends`: here the rest of what is mixed with T."""
        part = Expansion(*map(np.zeros_like, into))
        self._term.expand(trajectory, linearization, part)
        if self._term.squared:
            self._add_mixed(part, 0.5, into)
            self._add_bend(trajectory, -0.5, into)
        else:
            self._add_mixed(part, 1.0, into)

    def lifted(self, lift: Lift) -> BoundTerm:
        """It is already."""
        return self

    def _ratios(self, trajectory: Trajectory) -> Array:
        """T / T_0 at knots with a step, 1 at the last one. Shape (N + 1,)."""
        ratios = np.full(trajectory.horizon + 1, self._lift.duration(trajectory) / self._lift.system.duration)
        ratios[-1] = 1.0
        return ratios

    def _add_scaled(self, trajectory: Trajectory, part: Expansion, into: Expansion) -> None:
        ratio = self._ratios(trajectory)
        for whole, own in zip(into, part, strict=True):
            whole += ratio[: len(own)].reshape(-1, *[1] * (own.ndim - 1)) * own

    def _add_slope(self, trajectory: Trajectory, q: Array, r: Array) -> None:
        """c_n / T_0, by the state at knots n >= 1, by the control at knot 0."""
        slope = self._per_knot(self._term.values(trajectory), trajectory.horizon) / self._lift.system.duration
        q[1:, self._lift.time_of_state] += slope[1:]
        r[0, self._lift.time_of_control] += slope[0]

    def _add_mixed(self, part: Expansion, share: float, into: Expansion) -> None:
        """A share of g_n / T_0 in the rows and columns of T."""
        x, u, share = self._lift.time_of_state, self._lift.time_of_control, share / self._lift.system.duration
        into.Q[1:-1, x] += share * part.q[1:-1]
        into.Q[1:-1, :, x] += share * part.q[1:-1]
        into.M[1:, :, x] += share * part.r[1:]
        into.M[0, u] += share * part.q[0]
        into.R[0, u] += share * part.r[0]
        into.R[0, :, u] += share * part.r[0]

    def _add_bend(self, trajectory: Trajectory, share: float, into: Expansion) -> None:
        """A share of c_n / (T T_0) on the diagonal of T."""
        scale = share / (self._lift.duration(trajectory) * self._lift.system.duration)
        bend = scale * self._per_knot(self._term.values(trajectory), trajectory.horizon)
        x, u = self._lift.time_of_state, self._lift.time_of_control
        into.Q[1:, x, x] += bend[1:]
        into.R[0, u, u] += bend[0]

    def _per_knot(self, values: Array, N: int) -> Array:
        """Costs of the knots with a step, zero elsewhere. Shape (N + 1,)."""
        found = np.zeros(N + 1)
        found[self._term.knots.indices] = values
        found[-1] = 0.0
        return found


class TimeCost(BoundTerm):
    """The duration times a weight; on a horizon of fixed length a constant."""

    label = "Time"

    def __init__(self, weight: float, lift: Lift | None = None) -> None:
        self._weight, self._lift = weight, lift

    def cost(self, trajectory: Trajectory) -> float:
        """See `BoundTerm.cost`."""
        if self._lift is None:
            return self._weight * float(np.sum(trajectory.dt))
        return self._weight * self._lift.duration(trajectory)

    def slopes(self, trajectory: Trajectory, into: Slopes) -> None:
        """See `BoundTerm.slopes`."""
        if self._lift is not None:
            into.r[0, self._lift.time_of_control] += self._weight

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        """See `BoundTerm.expand`."""
        if self._lift is not None:
            into.r[0, self._lift.time_of_control] += self._weight

    def lifted(self, lift: Lift) -> BoundTerm:
        """See `BoundTerm.lifted`."""
        return TimeCost(self._weight, lift) if lift.timed else self


class UnusedControls(BoundTerm):
    """1/2 |w_n|^2 for n >= 1, controls without effect: their minimizer is zero, where they start and stay."""

    label = UNUSED

    def __init__(self, lift: Lift) -> None:
        self._first = lift.time_of_control

    def cost(self, trajectory: Trajectory) -> float:
        """See `BoundTerm.cost`."""
        unused = trajectory.U[1:, self._first :]
        return 0.5 * float(np.vdot(unused, unused))

    def slopes(self, trajectory: Trajectory, into: Slopes) -> None:
        """See `BoundTerm.slopes`."""
        into.r[1:, self._first :] += trajectory.U[1:, self._first :]

    def prepare(self, into: Expansion) -> None:
        """See `BoundTerm.prepare`."""
        entries = np.arange(self._first, into.r.shape[1])
        into.R[1:, entries, entries] += 1.0

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        """See `BoundTerm.expand`."""
        into.r[1:, self._first :] += trajectory.U[1:, self._first :]

    def lifted(self, lift: Lift) -> BoundTerm:
        """It is already."""
        return self
