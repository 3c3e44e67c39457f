"""Residuals bound to a system and a horizon: r_n(x_n, u_n, t_n) at some of the knots, all of them at once.

A residual has a role: with a loss it is a cost (`mjslq.bound_costs`); with an interval it can be a constraint. Here
is what both need of it: values, Jacobians, and second derivatives contracted with weights.

Notation
--------
    r_n            residual at knot n. Shape (k, m) over the k knots where it acts
    J_x, J_u       its derivatives by state (tangent directions) and control. Shapes (k, m, ndx), (k, m, nu)
    w_n            weights, such as the slope of a loss or multipliers. Shape (k, m)
    y_n, C_n, D_n  outputs and their Jacobians

    state          r = difference(target, x)
    control        r = u - target
    output         r = y - target, or log(target^-1 y) for unit quaternions, a rotation vector [rad]
    function       r = f(x, u, t)

Left out of `curvature` for good: the curvature of difference() for states and readings that are rotations.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from enum import Enum
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from mjslq.dynamics.dynamics import Dynamics, Linearization
from mjslq.knots import Knots
from mjslq.quadratic import Expansion, transposed_times
from mjslq.rotation import conjugate, inverse_right_jacobian, log, product, skew
from mjslq.targets import Rows
from mjslq.trajectory import Trajectory
from mjslq.user_function import UserFunction
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.lift import Lift


class Identity(Enum):
    """Stands for the identity, where a Jacobian would be one."""

    IDENTITY = 0


IDENTITY: Final = Identity.IDENTITY


class Jacobian(NamedTuple):
    """Derivatives of a residual; None stands for zero. Where one of them is the identity, the other is zero."""

    x: Array | Identity | None
    """By state, in tangent directions. Shape (k, m, ndx)."""
    u: Array | Identity | None
    """By control; what it says at knot N means nothing. Shape (k, m, nu)."""


class Slopes(NamedTuple):
    """Gradients of a cost by states, controls and outputs, each as if the others stayed."""

    q: Array
    """By states, in tangent directions. Shape (N + 1, ndx)."""
    r: Array
    """By controls. Shape (N, nu)."""
    y: Array
    """By outputs. Shape (N + 1, ny)."""

    @staticmethod
    def zeros(N: int, ndx: int, nu: int, ny: int) -> Slopes:
        """Slopes to add to."""
        return Slopes(np.zeros((N + 1, ndx)), np.zeros((N, nu)), np.zeros((N + 1, ny)))


class BoundResidual(ABC):
    """A residual at the knots of a horizon where it acts."""

    knots: Knots
    """The k knots."""
    size: int
    """m."""
    constant_jacobian: Jacobian | None = None
    """The Jacobian, where it is the same along all trajectories."""
    curved: bool = False
    """Whether `curvature` has something to add."""
    of_ends: bool = False
    """Whether `curvature_of_ends` has."""

    @abstractmethod
    def value(self, trajectory: Trajectory) -> Array:
        """r_n. Shape (k, m)."""

    @abstractmethod
    def jacobian(self, trajectory: Trajectory, linearization: Linearization) -> Jacobian:
        """Derivatives of r_n."""

    @abstractmethod
    def pull_back(self, trajectory: Trajectory, weights: Array, into: Slopes) -> None:
        """Add dr/dx'w, dr/du'w and dr/dy'w at each knot to `into`, for weights (k, m).

        For gradients without Jacobians of the steps.
        """

    def curvature(self, trajectory: Trajectory, weights: Array, into: Expansion, output_weights: Array) -> None:
        """Add sum_i w_i d2r_i/d(x, u)2 at each knot: to `into`, or for outputs dr/dy'w to `output_weights` (N + 1, ny).

        Outputs enter with their own second derivatives, which the engine contracts with `output_weights`.
        """
        return

    def curvature_of_ends(
        self, trajectory: Trajectory, linearization: Linearization, weights: Array, into: Expansion, costates: Array
    ) -> None:
        """Add what states at the ends of steps enter by: Hessians to `into`, dr/dx_{n+1}'w to `costates` (N + 1, ndx).

        The engine contracts the second derivatives of the steps with `costates`. Most residuals have nothing to add.
        """
        return

    def at(self, t0: float) -> BoundResidual:
        """The same residual on a horizon that starts at the time `t0` [s]; itself where time does not enter."""
        return self

    def lifted(self, lift: Lift) -> BoundResidual:
        """The same residual on the system whose states and controls hold duration and parameters."""
        return lift.padded(self)


class Targeted(BoundResidual):
    """A residual with a target at each of its knots."""

    _target: Array
    """Shape (k, ...)."""
    _rows: Rows | None
    """The target as a function of time; None where it belongs to the knots."""

    def at(self, t0: float) -> Targeted:
        """See `BoundResidual.at`."""
        if self._rows is None:
            return self
        moved = copy.copy(self)
        moved._target = self._rows(t0)
        return moved


class StateResidual(Targeted):
    """difference(target_n, x_n)."""

    def __init__(self, dynamics: Dynamics, target: Array, knots: Knots, rows: Rows | None = None) -> None:
        self.knots, self.size, self._dynamics, self._target, self._rows = knots, dynamics.ndx, dynamics, target, rows
        if dynamics.difference_jacobian(target[:1], target[:1]) is None:
            self.constant_jacobian = Jacobian(IDENTITY, None)

    def value(self, trajectory: Trajectory) -> Array:
        """See `BoundResidual.value`."""
        return self._dynamics.difference(self._target, trajectory.X[self.knots.at])

    def jacobian(self, trajectory: Trajectory, linearization: Linearization) -> Jacobian:
        """See `BoundResidual.jacobian`."""
        if self.constant_jacobian is not None:
            return self.constant_jacobian
        return Jacobian(self._dynamics.difference_jacobian(self._target, trajectory.X[self.knots.at]), None)

    def pull_back(self, trajectory: Trajectory, weights: Array, into: Slopes) -> None:
        """See `BoundResidual.pull_back`."""
        if self.constant_jacobian is not None:
            into.q[self.knots.at] += weights
            return
        for n, knot in enumerate(self.knots.indices):  # knot by knot: no (N, ndx, ndx) array
            J = self._dynamics.difference_jacobian(self._target[n], trajectory.X[knot])
            assert J is not None
            into.q[knot] += weights[n] @ J


class ControlResidual(Targeted):
    """u_n - target_n."""

    constant_jacobian = Jacobian(None, IDENTITY)

    def __init__(self, target: Array, knots: Knots, rows: Rows | None = None) -> None:
        self.knots, self.size, self._target, self._rows = knots, target.shape[1], target, rows

    def value(self, trajectory: Trajectory) -> Array:
        """See `BoundResidual.value`."""
        difference: Array = trajectory.U[self.knots.at_steps] - self._target
        return difference

    def jacobian(self, trajectory: Trajectory, linearization: Linearization) -> Jacobian:
        """See `BoundResidual.jacobian`."""
        return self.constant_jacobian

    def pull_back(self, trajectory: Trajectory, weights: Array, into: Slopes) -> None:
        """See `BoundResidual.pull_back`."""
        into.r[self.knots.at_steps] += weights


class OutputResidual(Targeted):
    """y_n[columns] - target_n."""

    curved = True

    def __init__(self, columns: slice, target: Array, knots: Knots, rows: Rows | None = None) -> None:
        self.knots, self.size, self._columns, self._target, self._rows = knots, target.shape[1], columns, target, rows

    def value(self, trajectory: Trajectory) -> Array:
        """See `BoundResidual.value`."""
        difference: Array = trajectory.Y[self.knots.at, self._columns] - self._target
        return difference

    def jacobian(self, trajectory: Trajectory, linearization: Linearization) -> Jacobian:
        """See `BoundResidual.jacobian`."""
        return Jacobian(*self._of_outputs(linearization))

    def pull_back(self, trajectory: Trajectory, weights: Array, into: Slopes) -> None:
        """See `BoundResidual.pull_back`."""
        into.y[self.knots.at, self._columns] += weights

    def curvature(self, trajectory: Trajectory, weights: Array, into: Expansion, output_weights: Array) -> None:
        """See `BoundResidual.curvature`."""
        output_weights[self.knots.at, self._columns] += weights

    def lifted(self, lift: Lift) -> BoundResidual:
        """See `BoundResidual.lifted`: outputs stay what they are."""
        return self

    def _of_outputs(self, linearization: Linearization) -> tuple[Array, Array | None]:
        """C and D of the output; D is None where it is zero."""
        C = np.ascontiguousarray(linearization.C[self.knots.at, self._columns])
        if not len(self.knots.steps):
            return C, None
        D = np.ascontiguousarray(linearization.D[self.knots.at, self._columns])
        return C, D if D.any() else None


class OrientationResidual(OutputResidual):
    """log(target_n^-1 y_n[columns]) of unit quaternions."""

    curved = False

    def __init__(self, columns: slice, target: Array, knots: Knots, rows: Rows | None = None) -> None:
        super().__init__(columns, target, knots, rows)
        self.size = 3

    def value(self, trajectory: Trajectory) -> Array:
        """See `BoundResidual.value`."""
        return log(product(conjugate(self._target), trajectory.Y[self.knots.at, self._columns]))

    def jacobian(self, trajectory: Trajectory, linearization: Linearization) -> Jacobian:
        """See `BoundResidual.jacobian`."""
        C, D = self._of_outputs(linearization)
        turn = self._by_reading(trajectory)
        return Jacobian(turn @ C, None if D is None else turn @ D)

    def pull_back(self, trajectory: Trajectory, weights: Array, into: Slopes) -> None:
        """See `BoundResidual.pull_back`."""
        into.y[self.knots.at, self._columns] += transposed_times(self._by_reading(trajectory), weights)

    def curvature(self, trajectory: Trajectory, weights: Array, into: Expansion, output_weights: Array) -> None:
        """Nothing: the curvature of rotations is left out."""

    def _by_reading(self, trajectory: Trajectory) -> Array:
        """dr/dy: the turn that a change of y means, then the inverse right Jacobian. Shape (k, 3, 4)."""
        y = trajectory.Y[self.knots.at, self._columns]
        turn = np.concatenate([-y[:, 1:, None], y[:, :1, None] * np.eye(3) - skew(y[:, 1:])], axis=2)
        return inverse_right_jacobian(self.value(trajectory)) @ (2.0 * turn)


class FunctionResidual(BoundResidual):
    """f(x_n, u_n, t_n) for a user's function f; at knot N, where there is no control, u is zero."""

    curved = True

    def __init__(self, dynamics: Dynamics, function: UserFunction, knots: Knots, clock: Array | None = None) -> None:
        self.knots, self.size, self._dynamics, self._function = knots, function.size, dynamics, function
        self._clock = self._times = knots.times if clock is None else clock

    def value(self, trajectory: Trajectory) -> Array:
        """See `BoundResidual.value`."""
        return self._function.values(self._points(trajectory), self._times)

    def jacobian(self, trajectory: Trajectory, linearization: Linearization) -> Jacobian:
        """See `BoundResidual.jacobian`."""
        J, nx = self._function.jacobians(self._points(trajectory), self._times), self._dynamics.nx
        basis = self._bases(trajectory)
        by_x = np.ascontiguousarray(J[:, :, :nx]) if basis is None else J[:, :, :nx] @ basis
        return Jacobian(by_x, np.ascontiguousarray(J[:, :, nx:]) if len(self.knots.steps) else None)

    def pull_back(self, trajectory: Trajectory, weights: Array, into: Slopes) -> None:
        """See `BoundResidual.pull_back`."""
        g = transposed_times(self._function.jacobians(self._points(trajectory), self._times), weights)
        nx, basis = self._dynamics.nx, self._bases(trajectory)
        by_x = g[:, :nx]
        into.q[self.knots.at] += by_x if basis is None else transposed_times(basis, by_x)
        into.r[self.knots.at_steps] += g[: len(self.knots.steps), nx:]

    def curvature(self, trajectory: Trajectory, weights: Array, into: Expansion, output_weights: Array) -> None:
        """See `BoundResidual.curvature`."""
        self.add_hessians(trajectory, self.hessians(trajectory, weights), into)
        self.add_turning(trajectory, weights, into)

    def hessians(self, trajectory: Trajectory, weights: Array) -> Array:
        """d2(w_n'f)/d(x, u)2 by the entries of x and u. Shape (k, nx + nu, nx + nu)."""
        return self._function.hessians(self._points(trajectory), self._times, weights)

    def add_hessians(self, trajectory: Trajectory, H: Array, into: Expansion) -> None:
        """Add Hessians by the entries of x and u, turned into tangent directions."""
        nx, basis, knots = self._dynamics.nx, self._bases(trajectory), self.knots
        xx, ux, steps = H[:, :nx, :nx], H[:, nx:, :nx], len(knots.steps)
        if basis is not None:
            xx, ux = basis.swapaxes(1, 2) @ xx @ basis, ux @ basis
        into.Q[knots.at] += xx
        into.M[knots.at_steps] += ux[:steps]
        into.R[knots.at_steps] += H[:steps, nx:, nx:]

    def add_turning(self, trajectory: Trajectory, weights: Array, into: Expansion) -> None:
        """Add what the Hessian has in tangent directions since these turn along them, w_n'f_x d2x. (k, m) weights."""
        if self._dynamics.nx == self._dynamics.ndx:
            return
        J = self._function.jacobians(self._points(trajectory), self._times)[:, :, : self._dynamics.nx]
        turning = self._dynamics.space.curvature(trajectory.X[self.knots.at], transposed_times(J, weights))
        if turning is not None:
            into.Q[self.knots.at] += turning

    def at(self, t0: float) -> FunctionResidual:
        """See `BoundResidual.at`."""
        moved = copy.copy(self)
        moved._times = self._clock + t0
        return moved

    def lifted(self, lift: Lift) -> FunctionResidual:
        """See `BoundResidual.lifted`."""
        function = lift.function(self._function, float((self._times - self._clock)[0]), self._times)
        return FunctionResidual(lift.system, function, self.knots, lift.clock(self.knots))

    def _points(self, trajectory: Trajectory) -> Array:
        """(x_n, u_n) in a row. Shape (k, nx + nu)."""
        Z = np.zeros((len(self.knots), self._dynamics.nx + self._dynamics.nu))
        Z[:, : self._dynamics.nx] = trajectory.X[self.knots.at]
        Z[: len(self.knots.steps), self._dynamics.nx :] = trajectory.U[self.knots.at_steps]
        return Z

    def _bases(self, trajectory: Trajectory) -> Array | None:
        """Tangent directions of the states. Shape (k, nx, ndx); None stands for the identity."""
        if self._dynamics.nx == self._dynamics.ndx:
            return None
        bases = [self._dynamics.tangent_basis(x) for x in trajectory.X[self.knots.at]]
        return np.stack([basis for basis in bases if basis is not None])
