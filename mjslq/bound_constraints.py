"""Constraints bound to a system and a horizon: what `mjslq.constraints` becomes inside a problem.

Notation
--------
    r_n                     residual at one of the k knots where the constraint acts. Shape (m,)
    lower_n <= r_n <= upper_n, entry by entry: equal for an equality, infinite where there is no limit
    v_n = max(lower_n - r_n, r_n - upper_n, 0)      violation, an entry's; a knot's is the largest of its entries'
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mjslq.dynamics.dynamics import Dynamics, Linearization
from mjslq.intervals import Interval
from mjslq.knots import Knots
from mjslq.quadratic import Expansion, transposed_times
from mjslq.residuals import BoundResidual, Jacobian, Slopes
from mjslq.trajectory import Trajectory
from mjslq.user_function import UserFunction
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.lift import Lift


@dataclass(frozen=True, eq=False)
class BoundConstraint:
    """A residual that has to stay within an interval."""

    name: str
    """What messages and results call it."""
    residual: BoundResidual
    """r_n."""
    lower: Array
    """-inf where there is none. Shape (k, m)."""
    upper: Array
    """inf where there is none. Shape (k, m)."""
    interval: Interval | None = None
    """Where the limits come from, if they depend on time."""

    @property
    def seen_at(self) -> NDArray[np.int64]:
        """Knots whose states the k residuals are about: one later for w(x_{n+1}, u_n). Shape (k,)."""
        indices = self.residual.knots.indices
        return indices + 1 if isinstance(self.residual, EndResidual) else indices

    def violation(self, trajectory: Trajectory) -> Array:
        """The largest violation of an entry at each of the k knots. Shape (k,)."""
        r = self.residual.value(trajectory)
        return np.maximum(np.maximum(self.lower - r, r - self.upper), 0.0).max(axis=1, initial=0.0)

    def over_knots(self, violation: Array) -> Array:
        """Violations at the k knots as one at every knot of the horizon, zero elsewhere. Shape (N + 1,)."""
        everywhere = np.zeros(self.residual.knots.N + 1)
        everywhere[self.seen_at] = violation
        return everywhere

    def at(self, t0: float) -> BoundConstraint:
        """The same constraint on a horizon that starts at the time `t0` [s]. Raises ValueError."""
        residual = self.residual.at(t0)
        if self.interval is None:
            return self if residual is self.residual else replace(self, residual=residual)
        try:
            lower, upper = self.interval(t0)
        except ValueError as error:
            raise ValueError(f"constraint {self.name!r} from t = {t0:g} s on: {error}") from None
        return replace(self, residual=residual, lower=lower, upper=upper)

    def lifted(self, lift: Lift) -> BoundConstraint:
        """The same constraint on the system whose states and controls hold duration and parameters."""
        return replace(self, residual=self.residual.lifted(lift))


class EntriesResidual(BoundResidual):
    """Some entries of the state as they are, x_n[columns]."""

    def __init__(self, dynamics: Dynamics, columns: NDArray[Any], knots: Knots) -> None:
        self.knots, self.size, self._dynamics, self._columns = knots, len(columns), dynamics, columns
        self.curved = dynamics.nx != dynamics.ndx

    @cached_property
    def constant_jacobian(self) -> Jacobian | None:  # type: ignore[override]
        """See `BoundResidual`; made when asked for, since it is large."""
        if self._dynamics.nx != self._dynamics.ndx:
            return None
        J = np.zeros((len(self.knots), self.size, self._dynamics.nx))
        J[:, np.arange(self.size), self._columns] = 1.0
        return Jacobian(J, None)

    def value(self, trajectory: Trajectory) -> Array:
        """See `BoundResidual.value`."""
        entries: Array = trajectory.X[self.knots.at][:, self._columns]
        return entries

    def jacobian(self, trajectory: Trajectory, linearization: Linearization) -> Jacobian:
        """See `BoundResidual.jacobian`."""
        if self.constant_jacobian is not None:
            return self.constant_jacobian
        bases = [self._dynamics.tangent_basis(x) for x in trajectory.X[self.knots.at]]
        return Jacobian(np.stack([basis[self._columns] for basis in bases if basis is not None]), None)

    def pull_back(self, trajectory: Trajectory, weights: Array, into: Slopes) -> None:
        """See `BoundResidual.pull_back`."""
        by_x = np.zeros((len(self.knots), self._dynamics.nx))
        by_x[:, self._columns] = weights
        for n, knot in enumerate(self.knots.indices):
            basis = self._dynamics.tangent_basis(trajectory.X[knot])
            into.q[knot] += by_x[n] if basis is None else by_x[n] @ basis

    def curvature(self, trajectory: Trajectory, weights: Array, into: Expansion, output_weights: Array) -> None:
        """See `BoundResidual.curvature`: quaternions turn along tangent directions."""
        X = trajectory.X[self.knots.at]
        by_entries = np.zeros_like(X)
        by_entries[:, self._columns] = weights
        turning = self._dynamics.space.curvature(X, by_entries)
        if turning is not None:
            into.Q[self.knots.at] += turning


class EndResidual(BoundResidual):
    """w(x_{n+1}, u_n, t_{n+1}) for a user's function w: a step's end with the control that led there.

        dw = w_x dx_{n+1} + w_u du_n = w_x A_n dx_n + (w_x B_n + w_u) du_n

    Second derivatives are those of w along (A dx + B du, du), and those of the step, weighed by w_x'lambda as by a
    costate of its end.
    """

    of_ends = True

    def __init__(self, dynamics: Dynamics, function: UserFunction, knots: Knots, grid: Array) -> None:
        self.knots, self.size, self._dynamics, self._function = knots, function.size, dynamics, function
        self._grid = self._times = grid

    def value(self, trajectory: Trajectory) -> Array:
        """See `BoundResidual.value`."""
        return self._function.values(self._points(trajectory), self._times)

    def jacobian(self, trajectory: Trajectory, linearization: Linearization) -> Jacobian:
        """See `BoundResidual.jacobian`."""
        Z, nx, at = self._points(trajectory), self._dynamics.nx, self.knots.at
        J = self._function.jacobians(Z, self._times)
        by_end = J[:, :, :nx]
        if nx != self._dynamics.ndx:
            bases = [self._dynamics.tangent_basis(x) for x in Z[:, :nx]]
            by_end = by_end @ np.stack([basis for basis in bases if basis is not None])
        by_x, by_u = by_end @ linearization.A[at], by_end @ linearization.B[at] + J[:, :, nx:]
        return Jacobian(np.ascontiguousarray(by_x), np.ascontiguousarray(by_u))

    def pull_back(self, trajectory: Trajectory, weights: Array, into: Slopes) -> None:
        """See `BoundResidual.pull_back`: by the state at the step's end, whose knot is the next one."""
        Z, nx = self._points(trajectory), self._dynamics.nx
        g = transposed_times(self._function.jacobians(Z, self._times), weights)
        for n, knot in enumerate(self.knots.indices):
            basis = self._dynamics.tangent_basis(Z[n, :nx])
            into.q[knot + 1] += g[n, :nx] if basis is None else g[n, :nx] @ basis
        into.r[self.knots.at_steps] += g[:, nx:]

    def curvature_of_ends(
        self, trajectory: Trajectory, linearization: Linearization, weights: Array, into: Expansion, costates: Array
    ) -> None:
        """See `BoundResidual.curvature_of_ends`."""
        Z, nx, knots = self._points(trajectory), self._dynamics.nx, self.knots
        H, J = self._function.hessians(Z, self._times, weights), self._function.jacobians(Z, self._times)
        xx, ux, by_end = H[:, :nx, :nx], H[:, nx:, :nx], J[:, :, :nx]
        if nx != self._dynamics.ndx:
            bases = [self._dynamics.tangent_basis(x) for x in Z[:, :nx]]
            basis = np.stack([basis for basis in bases if basis is not None])
            turning = self._dynamics.space.curvature(Z[:, :nx], transposed_times(by_end, weights))
            assert turning is not None
            xx, ux, by_end = basis.swapaxes(1, 2) @ xx @ basis + turning, ux @ basis, by_end @ basis
        A, B = linearization.A[knots.at], linearization.B[knots.at]
        by_B = B.swapaxes(1, 2) @ xx
        into.Q[knots.at] += A.swapaxes(1, 2) @ xx @ A
        into.M[knots.at] += (by_B + ux) @ A
        into.R[knots.at] += by_B @ B + ux @ B + (ux @ B).swapaxes(1, 2) + H[:, nx:, nx:]
        costates[knots.indices + 1] += transposed_times(by_end, weights)

    def at(self, t0: float) -> EndResidual:
        """See `BoundResidual.at`."""
        moved = EndResidual(self._dynamics, self._function, self.knots, self._grid)
        moved._times = self._grid + t0
        return moved

    def lifted(self, lift: Lift) -> EndResidual:
        """See `BoundResidual.lifted`."""
        function = lift.function(self._function, float((self._times - self._grid)[0]), self._times)
        return EndResidual(lift.system, function, self.knots, lift.clock(self.knots, ends=True))

    def _points(self, trajectory: Trajectory) -> Array:
        """(x_{n+1}, u_n) in a row. Shape (k, nx + nu)."""
        at = self.knots.indices
        return np.hstack([trajectory.X[at + 1], trajectory.U[at]])
