"""Costs bound to a system and a horizon: what `mjslq.costs` becomes inside a problem.

Notation
--------
    J = sum_n l_n                        cost of a term over its knots
    l_n = rho(r_n)                       residual r_n and loss rho: slope p_n, curvature s_n W_n + b_n p_n p_n'
    q_n = J_x'p, r_n = J_u'p             gradient by state and control; together g_n
    s_n J'W_n J + b_n g_n g_n'           Gauss-Newton Hessian; left out of it, and put in by `complete`: p'd2r

With Sideris and Bobrow's quadratic costs (3)-(4) nothing is left out.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from mjslq.dynamics.dynamics import Linearization
from mjslq.knots import Knots
from mjslq.losses import Loss, LossCurvature
from mjslq.quadratic import Expansion, add_congruence, add_products, transposed_times
from mjslq.residuals import BoundResidual, FunctionResidual, Identity, Jacobian, Slopes
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.lift import Lift


class BoundTerm(ABC):
    """A cost term fitted to a system and a horizon."""

    label: str
    """What it is and where it acts, for reports: "Sensor 'hand', terminal"."""

    @abstractmethod
    def cost(self, trajectory: Trajectory) -> float:
        """Sum of the term over the knots."""

    def residual_sizes(self, trajectory: Trajectory) -> Array | None:
        """Length of the term's residual at each knot, NaN where it does not act; None without one. Shape (N + 1,)."""
        return None

    def prepare(self, into: Expansion) -> None:
        """Add what is the same along every trajectory: often nothing."""
        return

    @abstractmethod
    def slopes(self, trajectory: Trajectory, into: Slopes) -> None:
        """Add the gradients by states, controls and outputs to `into`, for methods that need no more."""

    @abstractmethod
    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        """Add the rest of gradient and (Gauss-Newton) Hessian to `into`."""

    def complete(self, trajectory: Trajectory, into: Expansion, weights: Array) -> None:
        """Add what `expand` leaves out of the Hessian: here to `into`, or for outputs dJ/dy to `weights` (N + 1, ny).

        Left out for good: the curvature of difference() for states and readings that are rotations.
        """
        return

    def complete_ends(
        self, trajectory: Trajectory, linearization: Linearization, into: Expansion, costates: Array
    ) -> None:
        """Add what states at the ends of steps enter by; see `BoundResidual.curvature_of_ends`. Often nothing."""
        return

    def at(self, t0: float) -> BoundTerm:
        """The same term on a horizon that starts at the time `t0` [s]: functions of time get t0 + t_n.

        Not added to an earlier `t0`. Arrays are shared; a term that does not depend on time returns itself.
        """
        return self

    @abstractmethod
    def lifted(self, lift: Lift) -> BoundTerm:
        """The same term on the system whose states and controls hold duration and parameters."""


class KnotTerm(BoundTerm):
    """A term that has a cost at each of its knots."""

    knots: Knots
    over_time: bool
    """Whether costs at knots with a step are integrals, which grow with its length."""
    squared: bool = False
    """Whether it is a sum of squares, whose Gauss-Newton Hessian is that of residuals times a root of the length."""

    @abstractmethod
    def values(self, trajectory: Trajectory) -> Array:
        """Cost at each of the k knots. Shape (k,)."""

    @abstractmethod
    def padded(self, lift: Lift) -> KnotTerm:
        """`lifted`, but with steps of the length that they had when the term was bound."""

    def lifted(self, lift: Lift) -> BoundTerm:
        """See `BoundTerm.lifted`."""
        term = self.padded(lift)
        return lift.scaled(term) if self.over_time and lift.timed else term


class ResidualCost(KnotTerm):
    """A loss of a residual."""

    def __init__(self, residual: BoundResidual, loss: Loss, label: str, over_time: bool = False) -> None:
        self.label, self._residual, self._loss, self.over_time = label, residual, loss, over_time
        self.knots, self.squared = residual.knots, loss.constant
        self._prepared = loss.constant and residual.constant_jacobian is not None

    def cost(self, trajectory: Trajectory) -> float:
        """See `BoundTerm.cost`."""
        return self._loss.total(self._residual.value(trajectory))

    def values(self, trajectory: Trajectory) -> Array:
        """See `KnotTerm.values`."""
        return self._loss.value(self._residual.value(trajectory))

    def residual_sizes(self, trajectory: Trajectory) -> Array | None:
        """See `BoundTerm.residual_sizes`; None for a user's function, which is not called once more for it."""
        if isinstance(self._residual, FunctionResidual):
            return None
        sizes = np.full(trajectory.horizon + 1, np.nan)
        sizes[self._residual.knots.indices] = np.linalg.norm(self._residual.value(trajectory), axis=1)
        return sizes

    def prepare(self, into: Expansion) -> None:
        """See `BoundTerm.prepare`."""
        J, knots = self._residual.constant_jacobian, self._residual.knots
        if self._prepared and J is not None:
            add_hessian(knots, J, self._loss.curvature(np.zeros((len(knots), self._residual.size))), into)

    def slopes(self, trajectory: Trajectory, into: Slopes) -> None:
        """See `BoundTerm.slopes`."""
        self._residual.pull_back(trajectory, self._loss.slope(self._residual.value(trajectory)), into)

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        """See `BoundTerm.expand`."""
        r, knots = self._residual.value(trajectory), self._residual.knots
        J = self._residual.jacobian(trajectory, linearization)
        slope = self._loss.slope(r)
        by_x, by_u = _times_jacobian(slope, J.x), _times_jacobian(slope, J.u)
        if by_x is not None:
            into.q[knots.at] += by_x
        if by_u is not None:
            into.r[knots.at_steps] += by_u[: len(knots.steps)]
        if not self._prepared:
            curvature = self._loss.curvature(r)
            add_hessian(knots, J, curvature, into)
            if curvature.bend is not None:
                _add_bend(knots, curvature.bend, by_x, by_u, into)

    def complete(self, trajectory: Trajectory, into: Expansion, weights: Array) -> None:
        """See `BoundTerm.complete`."""
        if self._residual.curved:
            slope = self._loss.slope(self._residual.value(trajectory))
            self._residual.curvature(trajectory, slope, into, weights)

    def complete_ends(
        self, trajectory: Trajectory, linearization: Linearization, into: Expansion, costates: Array
    ) -> None:
        """See `BoundTerm.complete_ends`."""
        if self._residual.of_ends:
            slope = self._loss.slope(self._residual.value(trajectory))
            self._residual.curvature_of_ends(trajectory, linearization, slope, into, costates)

    def at(self, t0: float) -> BoundTerm:
        """See `BoundTerm.at`."""
        residual = self._residual.at(t0)
        return self if residual is self._residual else ResidualCost(residual, self._loss, self.label, self.over_time)

    def padded(self, lift: Lift) -> ResidualCost:
        """See `KnotTerm.padded`."""
        return ResidualCost(self._residual.lifted(lift), self._loss, self.label, self.over_time)


class FunctionCost(KnotTerm):
    """s_n l(x_n, u_n, t_n); the part of its Hessian below zero is left out of `expand`."""

    def __init__(self, residual: FunctionResidual, scales: Array, label: str, over_time: bool = False) -> None:
        self.label, self._residual, self._scales, self.over_time = label, residual, scales[:, None], over_time
        self.knots = residual.knots

    def cost(self, trajectory: Trajectory) -> float:
        """See `BoundTerm.cost`."""
        return float(np.vdot(self._scales, self._residual.value(trajectory)))

    def values(self, trajectory: Trajectory) -> Array:
        """See `KnotTerm.values`."""
        found: Array = (self._scales * self._residual.value(trajectory))[:, 0]
        return found

    def slopes(self, trajectory: Trajectory, into: Slopes) -> None:
        """See `BoundTerm.slopes`."""
        self._residual.pull_back(trajectory, self._scales, into)

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        """See `BoundTerm.expand`."""
        J, knots = self._residual.jacobian(trajectory, linearization), self._residual.knots
        by_x, by_u = _times_jacobian(self._scales, J.x), _times_jacobian(self._scales, J.u)
        if by_x is not None:
            into.q[knots.at] += by_x
        if by_u is not None:
            into.r[knots.at_steps] += by_u[: len(knots.steps)]
        H = self._residual.hessians(trajectory, self._scales)
        self._residual.add_hessians(trajectory, positive_parts(H), into)

    def complete(self, trajectory: Trajectory, into: Expansion, weights: Array) -> None:
        """See `BoundTerm.complete`."""
        H = self._residual.hessians(trajectory, self._scales)
        self._residual.add_hessians(trajectory, H - positive_parts(H), into)
        self._residual.add_turning(trajectory, self._scales, into)

    def at(self, t0: float) -> BoundTerm:
        """See `BoundTerm.at`."""
        return FunctionCost(self._residual.at(t0), self._scales[:, 0], self.label, self.over_time)

    def padded(self, lift: Lift) -> FunctionCost:
        """See `KnotTerm.padded`."""
        return FunctionCost(self._residual.lifted(lift), self._scales[:, 0], self.label, self.over_time)


def add_hessian(knots: Knots, J: Jacobian, curvature: LossCurvature, into: Expansion) -> None:
    """Add s_n J_n'W_n J_n to the Hessian blocks at the knots."""
    s, W = curvature.scales, curvature.W
    steps = len(knots.steps)
    if isinstance(J.x, Identity):
        into.Q[knots.at] += s[:, None, None] * W
    elif J.x is not None:
        add_congruence(J.x, s, W, J.x, knots.indices, into.Q)
    if isinstance(J.u, Identity):
        into.R[knots.at_steps] += s[:steps, None, None] * W[:steps]
    elif J.u is not None:
        add_congruence(J.u, s, W, J.u, knots.steps, into.R)
        if J.x is not None and not isinstance(J.x, Identity):
            add_congruence(J.u, s, W, J.x, knots.steps, into.M)


def positive_parts(H: Array) -> Array:
    """The nearest positive semidefinite matrix to each of some symmetric ones. Shape (k, n, n)."""
    values, vectors = np.linalg.eigh(H)
    nearest: Array = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.swapaxes(1, 2)
    return np.where((values[:, :1] >= 0.0)[:, :, None], H, nearest)


def _add_bend(knots: Knots, bend: Array, by_x: Array | None, by_u: Array | None, into: Expansion) -> None:
    """Add b_n g_n g_n' to the Hessian blocks at the knots."""
    if by_x is not None:
        add_products(bend, by_x, by_x, knots.indices, into.Q)
    if by_u is not None:
        add_products(bend, by_u, by_u, knots.steps, into.R)
        if by_x is not None:
            add_products(bend, by_u, by_x, knots.steps, into.M)


def _times_jacobian(slope: Array, J: Array | Identity | None) -> Array | None:
    """J_n'p_n. Shape (k, columns of J)."""
    if J is None:
        return None
    return slope if isinstance(J, Identity) else transposed_times(J, slope)
