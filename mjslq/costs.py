"""Cost terms: what a problem asks for, as sums over the knots of a trajectory.

Every term comes in two steps. What the user writes (`Tracking`, `State`, `Control`, `Residual`, `Function`) is a
small frozen record. `bind` fits it to a system and a horizon, where sizes are checked and weights are spread
over the knots; the bound term then evaluates and expands over the whole horizon at once.

Notation
--------
    J = sum_n s_n l_n(x_n, u_n)      s_n = h_n for running terms, which are integrals; 1 at the terminal knot
    q_n, r_n                          gradient of the stage cost by state (tangent directions) and control
    Q_n, R_n, M_n                     its second derivatives xx, uu, ux

    r(x, u) with weight W:  l = 1/2 r'W r,  q = r_x'W r,  Q = r_x'W r_x  (Gauss-Newton: second derivatives of r
    are left out; with Sideris and Bobrow's quadratic costs (3)-(4) nothing is left out)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mjslq._validation import Array, as_array, choose, per_step_matrices, per_step_vectors
from mjslq.dynamics._base import Dynamics, Linearization
from mjslq.trajectory import Trajectory

When = Literal["running", "terminal", "always"]
_WHEN = ("running", "terminal", "always")


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

    @abstractmethod
    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        """Add gradient and (Gauss-Newton) Hessian to `into`."""


class CostTerm(ABC):
    """What a user writes down."""

    @abstractmethod
    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """Fit to a system and a horizon. Raises ValueError where sizes do not belong together."""


@dataclass(frozen=True)
class Tracking(CostTerm):
    """Quadratic tracking cost, literally Sideris and Bobrow's (3)-(4): plain sums, factor 1/2, no dt.

    sum_{n<N} 1/2 [(x_n - x_o)'Q (x_n - x_o) + (u_n - u_o)'R (u_n - u_o)] + 1/2 (x_N - x_o)'Q_final (x_N - x_o)

    Matrices are given as a number, a diagonal, a matrix or one matrix a step; Q and Q_final positive semidefinite,
    R positive definite.
    """

    Q: ArrayLike
    """Running state weight. Shape () | (ndx,) | (ndx, ndx) | (N, ndx, ndx)."""
    R: ArrayLike
    """Control weight. Shape () | (nu,) | (nu, nu) | (N, nu, nu)."""
    Q_final: ArrayLike
    """Terminal state weight. Shape () | (ndx,) | (ndx, ndx)."""
    x_target: ArrayLike | None = None
    """x_o: one state, or one a knot; zero unless given. Shape (nx,) | (N + 1, nx)."""
    u_target: ArrayLike | None = None
    """u_o: one control, or one a step; zero unless given. Shape (nu,) | (N, nu)."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        Q = per_step_matrices("Q", self.Q, N, dynamics.ndx, definite=False)
        Q_final = per_step_matrices("Q_final", self.Q_final, 1, dynamics.ndx, definite=False)
        R = per_step_matrices("R", self.R, N, dynamics.nu, definite=True)
        x_target = _state_targets("x_target", self.x_target, dynamics, N)
        u_target = per_step_vectors("u_target", 0.0 if self.u_target is None else self.u_target, N, dynamics.nu)
        return _StateTerm(dynamics, np.concatenate([Q, Q_final]), x_target), _ControlTerm(R, u_target)


@dataclass(frozen=True)
class State(CostTerm):
    """1/2 weight |x - target|^2, an integral over time, or at the end."""

    weight: ArrayLike
    """A number, a diagonal or a matrix, positive semidefinite. Shape () | (ndx,) | (ndx, ndx)."""
    target: ArrayLike | None = None
    """One state, or one a knot; zero unless given. Shape (nx,) | (N + 1, nx)."""
    when: When = "running"
    """"running", "terminal" or "always" (both)."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        weight = per_step_matrices("weight", self.weight, 1, dynamics.ndx, definite=False)
        scales = _scales(self.when, dynamics, N)
        return (
            _StateTerm(dynamics, scales[:, None, None] * weight, _state_targets("target", self.target, dynamics, N)),
        )


@dataclass(frozen=True)
class Control(CostTerm):
    """1/2 weight |u - target|^2, an integral over time."""

    weight: ArrayLike
    """A number, a diagonal or a matrix, positive definite. Shape () | (nu,) | (nu, nu)."""
    target: ArrayLike = 0.0
    """One control, or one a step. Shape () | (nu,) | (N, nu)."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        weight = per_step_matrices("weight", self.weight, 1, dynamics.nu, definite=True)
        target = per_step_vectors("target", self.target, N, dynamics.nu)
        return (_ControlTerm(dynamics.steps(N)[:, None, None] * weight, target),)


@dataclass(frozen=True)
class Residual(CostTerm):
    """1/2 r'W r for any smooth residual r(x, u, t); expanded by Gauss-Newton."""

    r: Callable[..., Any]
    """r(x, u, t) -> (m,); at the terminal knot u is zero. Analytic in x and u unless `jacobian` is given."""
    weight: ArrayLike = 1.0
    """W: a number, a diagonal or a matrix, positive semidefinite. Shape () | (m,) | (m, m)."""
    when: When = "running"
    """"running", "terminal" or "always" (both)."""
    jacobian: Callable[..., Any] | None = None
    """jacobian(x, u, t) -> (dr/dx (m, nx), dr/du (m, nu)); by complex step unless given."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        scales = _scales(self.when, dynamics, N)
        try:
            value = np.asarray(self.r(np.zeros(dynamics.nx), np.zeros(dynamics.nu), 0.0))
        except (IndexError, ValueError, TypeError) as error:
            raise ValueError(f"r(x, u, t) fails for x of shape ({dynamics.nx},): {error}") from None
        weight = per_step_matrices("weight", self.weight, 1, value.size, definite=False)[0]
        return (_ResidualTerm(dynamics, self.r, self.jacobian, weight, scales),)


@dataclass(frozen=True)
class Function(CostTerm):
    """Any smooth cost l(x, u, t); where its Hessian is indefinite, the part below zero is left out of the model."""

    l: Callable[..., Any]  # noqa: E741  (the field's own name)
    """l(x, u, t) -> number; at the terminal knot u is zero. Analytic in x and u unless both derivatives are given."""
    when: When = "running"
    """"running", "terminal" or "always" (both)."""
    gradient: Callable[..., Any] | None = None
    """gradient(x, u, t) -> (dl/dx (nx,), dl/du (nu,)); by complex step unless given."""
    hessian: Callable[..., Any] | None = None
    """hessian(x, u, t) -> (nx + nu, nx + nu); by differences of the gradient unless given."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        scales = _scales(self.when, dynamics, N)
        try:
            value = np.asarray(self.l(np.zeros(dynamics.nx), np.zeros(dynamics.nu), 0.0))
        except (IndexError, ValueError, TypeError) as error:
            raise ValueError(f"l(x, u, t) fails for x of shape ({dynamics.nx},): {error}") from None
        if value.size != 1:
            raise ValueError(f"l(x, u, t) must return a number, got shape {value.shape}")
        return (_FunctionTerm(dynamics, self, scales),)


class _StateTerm(BoundTerm):
    """1/2 d'W_n d with d = difference(target_n, x_n)."""

    def __init__(self, dynamics: Dynamics, W: Array, target: Array) -> None:
        self._dynamics, self._W, self._target = dynamics, W, target
        # Terms that act on few knots (terminal ones, above all) touch only those.
        active = np.flatnonzero(W.any(axis=(1, 2)))
        self._knots = slice(active[0], active[-1] + 1) if active.size else slice(0, 0)

    def cost(self, trajectory: Trajectory) -> float:
        d, Wd = self._weighted(trajectory)
        return 0.5 * float(np.vdot(d, Wd))

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        _, Wd = self._weighted(trajectory)
        knots, W = self._knots, self._W[self._knots]
        J = self._dynamics.difference_jacobian(self._target[knots], trajectory.X[knots])
        if J is not None:
            W, Wd = _congruence(J, W), _transposed_times(J, Wd)
        into.Q[knots] += W
        into.q[knots] += Wd

    def _weighted(self, trajectory: Trajectory) -> tuple[Array, Array]:
        d = self._dynamics.difference(self._target[self._knots], trajectory.X[self._knots])
        return d, _times(self._W[self._knots], d)


class _ControlTerm(BoundTerm):
    """1/2 d'W_n d with d = u_n - target_n."""

    def __init__(self, W: Array, target: Array) -> None:
        self._W, self._target = W, target

    def cost(self, trajectory: Trajectory) -> float:
        d = trajectory.U - self._target
        return 0.5 * float(np.vdot(d, _times(self._W, d)))

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        into.R[:] += self._W
        into.r[:] += _times(self._W, trajectory.U - self._target)


class _PointwiseTerm(BoundTerm):
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


class _ResidualTerm(_PointwiseTerm):
    def __init__(
        self, dynamics: Dynamics, r: Callable[..., Any], jacobian: Callable[..., Any] | None, W: Array, scales: Array
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
        for n, scale, z, t in self._knots(trajectory):
            if self._jacobian is None:
                J = _complex_step(partial(self._value, t=t), z)
            else:
                J = np.hstack(self._jacobian(z[: self._nx], z[self._nx :], t))
            WJ = scale * self._W @ J
            self._add(n, z[: self._nx], WJ.T @ self._value(z, t), J.T @ WJ, into)

    def _value(self, z: Array, t: float) -> Array:
        return np.atleast_1d(np.asarray(self._r(z[: self._nx], z[self._nx :], t)))


class _FunctionTerm(_PointwiseTerm):
    def __init__(self, dynamics: Dynamics, term: Function, scales: Array) -> None:
        super().__init__(dynamics, scales)
        self._term = term

    def cost(self, trajectory: Trajectory) -> float:
        return float(sum(scale * self._value(z, t)[0] for _, scale, z, t in self._knots(trajectory)))

    def expand(self, trajectory: Trajectory, linearization: Linearization, into: Expansion) -> None:
        for n, scale, z, t in self._knots(trajectory):
            hessian = _positive_part(0.5 * (H := self._hessian(z, t)) + 0.5 * H.T)
            self._add(n, z[: self._nx], scale * self._gradient(z, t), scale * hessian, into)

    def _value(self, z: Array, t: float) -> Array:
        return np.asarray(self._term.l(z[: self._nx], z[self._nx :], t)).reshape(1)

    def _gradient(self, z: Array, t: float) -> Array:
        if self._term.gradient is not None:
            return np.concatenate(self._term.gradient(z[: self._nx], z[self._nx :], t))
        return _complex_step(lambda w: self._value(w, t), z)[0]

    def _hessian(self, z: Array, t: float) -> Array:
        if self._term.hessian is not None:
            return np.asarray(self._term.hessian(z[: self._nx], z[self._nx :], t), dtype=np.float64)
        columns = []
        for i in range(z.size):
            d = np.zeros(z.size)
            d[i] = 6e-6 * max(1.0, abs(z[i]))
            columns.append((self._gradient(z + d, t) - self._gradient(z - d, t)) / (2.0 * d[i]))
        return np.stack(columns, axis=-1)


def _complex_step(function: Callable[[Array], Array], z: Array) -> Array:
    """Jacobian of `function` at z, exact to rounding where it is analytic. Shape (m, len(z))."""
    tiny, columns = 1e-40, []
    for i in range(z.size):
        w = z.astype(np.complex128)
        w[i] += 1j * tiny
        columns.append(function(w).imag / tiny)  # type: ignore[arg-type]  # complex on purpose
    return np.stack(columns, axis=-1)


def _positive_part(H: Array) -> Array:
    """The nearest positive semidefinite matrix to a symmetric one."""
    values, vectors = np.linalg.eigh(H)
    return H if values[0] >= 0.0 else (vectors * np.maximum(values, 0.0)) @ vectors.T


def _times(W: Array, d: Array) -> Array:
    return (W @ d[..., None])[..., 0]


def _transposed_times(J: Array, d: Array) -> Array:
    return (J.swapaxes(-1, -2) @ d[..., None])[..., 0]


def _congruence(J: Array, W: Array) -> Array:
    return J.swapaxes(-1, -2) @ W @ J


def _scales(when: str, dynamics: Dynamics, N: int) -> Array:
    """s_n: step lengths for running terms, 1 at the terminal knot, 0 where the term does not act. Shape (N + 1,)."""
    choose("when", when, _WHEN)
    scales = np.zeros(N + 1)
    if when in ("running", "always"):
        scales[:N] = dynamics.steps(N)
    if when in ("terminal", "always"):
        scales[N] = 1.0
    return scales


def _state_targets(name: str, target: ArrayLike | None, dynamics: Dynamics, N: int) -> Array:
    if target is None:
        if dynamics.nx != dynamics.ndx:
            raise ValueError(f"{name} must be given: a state with quaternions has no zero to default to")
        target = np.zeros(dynamics.nx)
    array = as_array(name, target)
    if array.shape not in ((dynamics.nx,), (N + 1, dynamics.nx)):
        raise ValueError(
            f"{name} must be a state ({dynamics.nx},) or one a knot ({N + 1}, {dynamics.nx}), got shape {array.shape}"
        )
    return np.array(np.broadcast_to(array, (N + 1, dynamics.nx)), order="C")
