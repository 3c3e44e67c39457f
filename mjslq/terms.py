"""Cost terms fitted to a system and a horizon: what `mjslq.costs` becomes inside a problem.

Each evaluates and expands over the whole horizon at once; the notation is that of `mjslq.costs`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mjslq.complex_step import complex_step, refused_complex
from mjslq.dynamics.dynamics import Dynamics, Linearization
from mjslq.quadratic import add_congruence, transposed_times, weighted
from mjslq.rotation import conjugate, inverse_right_jacobian, log, product
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

Derivative = Callable[..., Any] | None
"""A user's derivative, where one is given."""


class Expansion(NamedTuple):
    """Second-order expansion of all stage costs about a trajectory, in tangent directions."""

    Q: Array
    """Shape (N + 1, ndx, ndx)."""
    R: Array
    """Shape (N, nu, nu)."""
    M: Array
    """Shape (N, nu, ndx)."""
    q: Array
    """Shape (N + 1, ndx)."""
    r: Array
    """Shape (N, nu)."""

    @staticmethod
    def zeros(N: int, ndx: int, nu: int) -> Expansion:
        """An expansion to add to."""
        return Expansion(
            np.zeros((N + 1, ndx, ndx)), np.zeros((N, nu, nu)), np.zeros((N, nu, ndx)),
            np.zeros((N + 1, ndx)), np.zeros((N, nu)),
        )  # fmt: skip


class BoundTerm(ABC):
    """A cost term fitted to a system and a horizon."""

    @abstractmethod
    def cost(self, trajectory: Trajectory) -> float:
        """Sum of the term over the knots."""

    def prepare(self, into: Expansion) -> None:
        """Add what is the same along every trajectory: often nothing."""
        return

    @abstractmethod
    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        """Add the rest of gradient and (Gauss-Newton) Hessian to `into`."""

    def complete(self, trajectory: Trajectory, into: Expansion, weights: Array) -> None:
        """Add what `expand` leaves out of the Hessian: here to `into`, or for outputs dJ/dy to `weights` (N + 1, ny).

        Left out for good: the curvature of difference() for states and readings that are rotations.
        """
        return


class StateTerm(BoundTerm):
    """s_n/2 d'W_n d with d = difference(target_n, x_n)."""

    def __init__(self, dynamics: Dynamics, scales: Array, W: Array, target: Array) -> None:
        self._dynamics = dynamics
        # terms that act on few knots (terminal ones, above all) touch only those
        active = np.flatnonzero(scales) if W.any() else np.zeros(0, np.int64)
        self._knots = knots = slice(active[0], active[-1] + 1) if active.size else slice(0, 0)
        self._scales, self._target, self._W = scales[knots], target[knots], W if len(W) == 1 else W[knots]
        self._flat = dynamics.difference_jacobian(target[:1], target[:1]) is None

    def cost(self, trajectory: Trajectory) -> float:
        d = self._difference(trajectory)
        return 0.5 * float(np.vdot(d, weighted(self._scales, self._W, d)))

    def prepare(self, into: Expansion) -> None:
        if self._flat:
            into.Q[self._knots] += self._scales[:, None, None] * self._W

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        gradient = weighted(self._scales, self._W, self._difference(trajectory))
        if not self._flat:
            J = self._dynamics.difference_jacobian(self._target, trajectory.X[self._knots])
            assert J is not None
            add_congruence(J, self._scales, self._W, J, into.Q[self._knots])
            gradient = transposed_times(J, gradient)
        into.q[self._knots] += gradient

    def _difference(self, trajectory: Trajectory) -> Array:
        return self._dynamics.difference(self._target, trajectory.X[self._knots])


class ControlTerm(BoundTerm):
    """s_n/2 d'W_n d with d = u_n - target_n."""

    def __init__(self, scales: Array, W: Array, target: Array) -> None:
        self._scales, self._W, self._target = scales, W, target

    def cost(self, trajectory: Trajectory) -> float:
        d = trajectory.U - self._target
        return 0.5 * float(np.vdot(d, weighted(self._scales, self._W, d)))

    def prepare(self, into: Expansion) -> None:
        into.R[:] += self._scales[:, None, None] * self._W

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        into.r[:] += weighted(self._scales, self._W, trajectory.U - self._target)


class SensorTerm(BoundTerm):
    """s_n/2 d'W d with d the difference of a reading y_n[columns] from its target."""

    def __init__(self, columns: slice, quaternion: bool, scales: Array, W: Array, target: Array) -> None:
        self._columns, self._quaternion = columns, quaternion
        active = np.flatnonzero(scales)
        self._knots = slice(active[0], active[-1] + 1)
        self._target, self._W, self._scales = target[self._knots], W, scales[self._knots]

    def cost(self, trajectory: Trajectory) -> float:
        d = self._difference(trajectory)
        return 0.5 * float(np.vdot(d, weighted(self._scales, self._W, d)))

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        d, knots = self._difference(trajectory), self._knots
        C, D = (np.ascontiguousarray(part[knots, self._columns]) for part in linearization[2:])
        if self._quaternion:
            J = self._rotation_jacobian(trajectory.Y[knots, self._columns], d)
            C, D = J @ C, J @ D
        gradient = weighted(self._scales, self._W, d)
        add_congruence(C, self._scales, self._W, C, into.Q[knots])
        into.q[knots] += transposed_times(C, gradient)
        N = len(into.r)
        steps, running = slice(knots.start, min(knots.stop, N)), slice(0, min(knots.stop, N) - knots.start)
        D = D[running]
        if D.any():
            add_congruence(D, self._scales[running], self._W, D, into.R[steps])
            add_congruence(D, self._scales[running], self._W, C[running], into.M[steps])
            into.r[steps] += transposed_times(D, gradient[running])

    def complete(self, trajectory: Trajectory, into: Expansion, weights: Array) -> None:
        if not self._quaternion:
            gradient = weighted(self._scales, self._W, self._difference(trajectory))
            weights[self._knots, self._columns] += gradient

    def _difference(self, trajectory: Trajectory) -> Array:
        y = trajectory.Y[self._knots, self._columns]
        return log(product(conjugate(self._target), y)) if self._quaternion else y - self._target

    @staticmethod
    def _rotation_jacobian(y: Array, d: Array) -> Array:
        """d(log(target^-1 y))/dy: the turn that a change of y means, then the inverse right Jacobian. (..., 3, 4)."""
        turn = np.stack([2.0 * product(conjugate(y), np.broadcast_to(e, y.shape))[:, 1:] for e in np.eye(4)], axis=-1)
        return inverse_right_jacobian(d) @ turn


class PointwiseTerm(BoundTerm):
    """A term from a Python function of (x, u, t), called knot by knot."""

    def __init__(self, dynamics: Dynamics, scales: Array) -> None:
        self._dynamics, self._scales, self._nx = dynamics, scales, dynamics.nx

    def _knots(self, trajectory: Trajectory) -> list[tuple[int, float, Array, float]]:
        """(n, s_n, (x_n, u_n) as one vector, t_n) of the knots where the term acts."""
        U = np.vstack([trajectory.U, np.zeros(trajectory.U.shape[1])])
        Z, times = np.hstack([trajectory.X, U]), trajectory.times
        return [(int(n), float(self._scales[n]), Z[n], float(times[n])) for n in np.flatnonzero(self._scales)]

    def _add(self, n: int, x: Array, gradient: Array, hessian: Array, into: Expansion) -> None:
        """Add a gradient and a Hessian by (x, u) entries, turned into tangent directions."""
        nx, basis = self._nx, self._dynamics.tangent_basis(x)
        T = np.eye(nx) if basis is None else basis
        into.q[n] += T.T @ gradient[:nx]
        into.Q[n] += T.T @ hessian[:nx, :nx] @ T
        if n < len(into.r):
            into.r[n] += gradient[nx:]
            into.R[n] += hessian[nx:, nx:]
            into.M[n] += hessian[nx:, :nx] @ T


class ResidualTerm(PointwiseTerm):
    """s_n/2 r'W r with r(x_n, u_n, t_n)."""

    def __init__(
        self, dynamics: Dynamics, r: Callable[..., Any], jacobian: Derivative, W: Array, scales: Array
    ) -> None:
        super().__init__(dynamics, scales)
        self._r, self._jacobian, self._W = r, jacobian, W

    def cost(self, trajectory: Trajectory) -> float:
        total = 0.0
        for _, scale, z, t in self._knots(trajectory):
            r = self._value(z, t)
            total += 0.5 * scale * float(r @ self._W @ r)
        return total

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        with refused_complex("r(x, u, t)", "jacobian="):
            for n, scale, z, t in self._knots(trajectory):
                J = self._derivative(z, t)
                WJ = scale * self._W @ J
                self._add(n, z[: self._nx], WJ.T @ self._value(z, t), J.T @ WJ, into)

    def complete(self, trajectory: Trajectory, into: Expansion, weights: Array) -> None:
        with refused_complex("r(x, u, t)", "jacobian="):
            for n, scale, z, t in self._knots(trajectory):
                Wr = scale * self._W @ self._value(z, t)
                H = _differences(partial(self._weighted_derivative, t=t, weights=Wr), z)
                self._add(n, z[: self._nx], np.zeros(z.size), 0.5 * (H + H.T), into)

    def _value(self, z: Array, t: float) -> Array:
        return np.atleast_1d(np.asarray(self._r(z[: self._nx], z[self._nx :], t)))

    def _weighted_derivative(self, z: Array, t: float, weights: Array) -> Array:
        product: Array = weights @ self._derivative(z, t)
        return product

    def _derivative(self, z: Array, t: float) -> Array:
        """dr/d(x, u). Shape (m, nx + nu)."""
        if self._jacobian is None:
            return complex_step(partial(self._value, t=t), z)
        parts, m = self._jacobian(z[: self._nx], z[self._nx :], t), len(self._W)
        return np.hstack(_checked("jacobian", parts, [(m, self._nx), (m, z.size - self._nx)]))


class FunctionTerm(PointwiseTerm):
    """s_n l(x_n, u_n, t_n)."""

    def __init__(
        self, dynamics: Dynamics, cost: Callable[..., Any], gradient: Derivative, hessian: Derivative, scales: Array
    ) -> None:
        super().__init__(dynamics, scales)
        self._l, self._given_gradient, self._given_hessian = cost, gradient, hessian

    def cost(self, trajectory: Trajectory) -> float:
        return float(sum(scale * self._value(z, t)[0] for _, scale, z, t in self._knots(trajectory)))

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        with refused_complex("l(x, u, t)", "gradient= and hessian="):
            for n, scale, z, t in self._knots(trajectory):
                H = self._hessian(z, t)
                hessian = _positive_part(0.5 * (H + H.T))
                self._add(n, z[: self._nx], scale * self._gradient(z, t), scale * hessian, into)

    def complete(self, trajectory: Trajectory, into: Expansion, weights: Array) -> None:
        with refused_complex("l(x, u, t)", "gradient= and hessian="):
            for n, scale, z, t in self._knots(trajectory):
                H = self._hessian(z, t)
                H = 0.5 * (H + H.T)
                self._add(n, z[: self._nx], np.zeros(z.size), scale * (H - _positive_part(H)), into)

    def _value(self, z: Array, t: float) -> Array:
        return np.asarray(self._l(z[: self._nx], z[self._nx :], t)).reshape(1)

    def _gradient(self, z: Array, t: float) -> Array:
        """dl/d(x, u). Shape (nx + nu,)."""
        if self._given_gradient is None:
            return complex_step(partial(self._value, t=t), z)[0]
        parts = self._given_gradient(z[: self._nx], z[self._nx :], t)
        return np.concatenate(_checked("gradient", parts, [(self._nx,), (z.size - self._nx,)]))

    def _hessian(self, z: Array, t: float) -> Array:
        """Second derivatives by (x, u). Shape (nx + nu, nx + nu)."""
        if self._given_hessian is not None:
            value = self._given_hessian(z[: self._nx], z[self._nx :], t)
            return _checked("hessian", (value,), [(z.size, z.size)])[0]
        return _differences(lambda y: self._gradient(y, t), z)


def _differences(gradient: Callable[[Array], Array], z: Array) -> Array:
    """Jacobian of a gradient by central differences. Shape (len(z), len(z))."""
    columns = []
    for i in range(z.size):
        d = np.zeros(z.size)
        d[i] = 6e-6 * max(1.0, abs(z[i]))
        columns.append((gradient(z + d) - gradient(z - d)) / (2.0 * d[i]))
    return np.stack(columns, axis=-1)


def _checked(name: str, parts: Sequence[Any], shapes: list[tuple[int, ...]]) -> list[Array]:
    """Return what a user's derivative gave, as arrays of the right shapes."""
    arrays = [np.asarray(part, dtype=np.float64) for part in parts]
    given = [array.shape for array in arrays]
    if given != shapes:
        raise ValueError(
            f"{name} must return shape {' and '.join(map(str, shapes))}, got {' and '.join(map(str, given))}"
        )
    return arrays


def _positive_part(H: Array) -> Array:
    """The nearest positive semidefinite matrix to a symmetric one."""
    values, vectors = np.linalg.eigh(H)
    return H if values[0] >= 0.0 else (vectors * np.maximum(values, 0.0)) @ vectors.T
