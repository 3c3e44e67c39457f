"""Cost terms: what a problem asks for, as sums over the knots of a trajectory.

Every term comes in two steps. What the user writes (`Tracking`, `State`, `Control`, `Sensor`, `Residual`,
`Function`) is a small frozen record. `bind` fits it to a system and a horizon, where sizes are checked and weights are
spread over the knots; the bound term (`terms.py`) then evaluates and expands over the whole horizon at once.

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
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mjslq.dynamics.dynamics import Dynamics
from mjslq.terms import BoundTerm as BoundTerm
from mjslq.terms import ControlTerm, FunctionTerm, ResidualTerm, SensorTerm, StateTerm
from mjslq.terms import Expansion as Expansion
from mjslq.validation import Array, as_array, choose, per_step_matrices, per_step_vectors

When = Literal["running", "terminal", "always"]
_WHEN = ("running", "terminal", "always")


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
        ones = np.ones(N + 1)
        return StateTerm(dynamics, ones, np.concatenate([Q, Q_final]), x_target), ControlTerm(ones[:N], R, u_target)


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
        target = _state_targets("target", self.target, dynamics, N)
        return (StateTerm(dynamics, _scales(self.when, dynamics, N), weight, target),)


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
        return (ControlTerm(dynamics.steps(N), weight, target),)


@dataclass(frozen=True)
class Sensor(CostTerm):
    """1/2 weight |reading - target|^2 on an output of the engine: a MuJoCo sensor, or a frame.

    Readings that are unit quaternions are compared by the rotation vector [rad] between them and the target.
    """

    name: str
    """The sensor's name."""
    target: ArrayLike
    """One reading, or one a knot. Shape () | (m,) | (N + 1, m)."""
    weight: ArrayLike = 1.0
    """A number, a diagonal or a matrix, positive semidefinite. Shape () | (m,) | (m, m); m = 3 for quaternions."""
    when: When = "running"
    """"running", "terminal" or "always" (both)."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        output = dynamics.outputs[choose("sensor", self.name, dynamics.outputs)]
        size = output.columns.stop - output.columns.start
        target = per_step_vectors("target", self.target, N + 1, size)
        if output.quaternion:
            length = np.linalg.norm(target, axis=1, keepdims=True)
            if (length < 1e-9).any():
                raise ValueError(f"target of the orientation {self.name!r} must be a quaternion, not zeros")
            target, size = target / length, 3
        weight = per_step_matrices("weight", self.weight, 1, size, definite=False)
        return (SensorTerm(output.columns, output.quaternion, _scales(self.when, dynamics, N), weight, target),)


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
        value = _at_origin("r(x, u, t)", self.r, dynamics)
        if value.ndim > 1:
            raise ValueError(f"r(x, u, t) must return a number or numbers in a row (m,), got shape {value.shape}")
        weight = per_step_matrices("weight", self.weight, 1, value.size, definite=False)[0]
        return (ResidualTerm(dynamics, self.r, self.jacobian, weight, scales),)


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
        value = _at_origin("l(x, u, t)", self.l, dynamics)
        if value.size != 1:
            raise ValueError(f"l(x, u, t) must return a number, got shape {value.shape}")
        return (FunctionTerm(dynamics, self.l, self.gradient, self.hessian, scales),)


def _at_origin(name: str, function: Callable[..., Any], dynamics: Dynamics) -> Array:
    """What a user's function returns at the origin, where it need not be defined but has its shape."""
    try:
        with np.errstate(all="ignore"):
            return np.asarray(function(np.zeros(dynamics.nx), np.zeros(dynamics.nu), 0.0))
    except (IndexError, ValueError, TypeError) as error:
        raise ValueError(f"{name} fails for x of shape ({dynamics.nx},): {error}") from None


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
