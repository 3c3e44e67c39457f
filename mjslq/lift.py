"""Residuals and functions of a problem, on the system whose states and controls hold its duration and parameters too.

Notation
--------
    z = (x, p),  v = (u, w)      states and controls of `dynamics.augmented`; p_0 has no effect, w_0 are the values
    T                            the final time, an entry of p, where it is free
    s_n                          time of knot n in parts of the duration: t_n = t_0 + s_n T

A residual r(x, u) has the same values, and Jacobians with columns of zeros. A user's function f(x, u, t) becomes one of
(z, v): with s_0 = 0 the first knot's does not depend on T, so that T is always an entry of z.

    df/dT = s_n df/dt,     d2f/dT2 = s_n^2 d2f/dt2,     d2f/dTd(x, u) = s_n d2f/dtd(x, u)         by differences in t
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mjslq.bound_costs import KnotTerm
from mjslq.dynamics.augmented import Augmented
from mjslq.dynamics.dynamics import Linearization
from mjslq.knots import Knots
from mjslq.quadratic import Expansion
from mjslq.residuals import BoundResidual, Identity, Jacobian, Slopes
from mjslq.time_costs import ScaledTerm
from mjslq.trajectory import Trajectory
from mjslq.user_function import UserFunction
from mjslq.validation import Array

CLOCK, CLOCK_TWICE = 6e-6, 1e-4
"""Steps of first and second differences in t, relative to the time from the start, or to 1 s."""


@dataclass(frozen=True, eq=False)
class Lift:
    """From the engine's states and controls to those of the augmented system."""

    system: Augmented
    shares: Array
    """s_n. Shape (N + 1,)."""

    @property
    def timed(self) -> bool:
        """Whether the final time is free; then it is the first of the values."""
        return self.system.timed

    @property
    def time_of_state(self) -> int:
        """Where T is among the tangent directions of the states."""
        return self.system.inner.ndx

    @property
    def time_of_control(self) -> int:
        """Where T is among the controls of the first step."""
        return self.system.inner.nu

    def duration(self, trajectory: Trajectory) -> float:
        """T of a trajectory of the augmented system. [s]"""
        return float(trajectory.U[0, self.time_of_control])

    def columns_x(self, J: Array) -> Array:
        """Derivatives by states with columns for the values. Shape (k, m, ndx + np)."""
        return np.concatenate([J, np.zeros((*J.shape[:2], len(self.system.names)))], axis=2)

    def columns_u(self, J: Array) -> Array:
        """The same for controls. Shape (k, m, nu + np)."""
        return self.columns_x(J)

    def slopes(self, into: Slopes) -> Slopes:
        """The part of gradients that belongs to the engine, as views."""
        inner = self.system.inner
        return Slopes(into.q[:, : inner.ndx], into.r[:, : inner.nu], into.y)

    def expansion(self, into: Expansion) -> Expansion:
        """The same of an expansion."""
        Q, R, M, q, r = into
        ndx, nu = self.system.inner.ndx, self.system.inner.nu
        return Expansion(Q[:, :ndx, :ndx], R[:, :nu, :nu], M[:, :nu, :ndx], q[:, :ndx], r[:, :nu])

    def padded(self, residual: BoundResidual) -> PaddedResidual:
        """A residual of the engine's states and controls."""
        return PaddedResidual(self, residual)

    def scaled(self, term: KnotTerm) -> ScaledTerm:
        """A padded term whose steps have the length that the final time gives them."""
        return ScaledTerm(self, term)

    def function(self, function: UserFunction, t0: float, times: Array) -> LiftedFunction:
        """A user's function; `times` (k,) are those of its knots where the duration is fixed."""
        return LiftedFunction(self, function, t0, times)

    def clock(self, knots: Knots, ends: bool = False) -> Array:
        """s_n at some knots, or at the ends of steps. Shape (k,)."""
        return self.shares[knots.indices + ends]


class PaddedResidual(BoundResidual):
    """A residual of the engine's states and controls, on the augmented system."""

    def __init__(self, lift: Lift, inner: BoundResidual) -> None:
        self._lift, self._inner = lift, inner
        self.knots, self.size, self.curved = inner.knots, inner.size, inner.curved

    @cached_property
    def constant_jacobian(self) -> Jacobian | None:  # type: ignore[override]
        """See `BoundResidual`."""
        J = self._inner.constant_jacobian
        return None if J is None else self._padded(J)

    def value(self, trajectory: Trajectory) -> Array:
        """See `BoundResidual.value`."""
        return self._inner.value(self._lift.system.stripped(trajectory))

    def jacobian(self, trajectory: Trajectory, linearization: Linearization) -> Jacobian:
        """See `BoundResidual.jacobian`."""
        if self.constant_jacobian is not None:
            return self.constant_jacobian
        return self._padded(self._inner.jacobian(self._lift.system.stripped(trajectory), linearization))

    def pull_back(self, trajectory: Trajectory, weights: Array, into: Slopes) -> None:
        """See `BoundResidual.pull_back`."""
        self._inner.pull_back(self._lift.system.stripped(trajectory), weights, self._lift.slopes(into))

    def curvature(self, trajectory: Trajectory, weights: Array, into: Expansion, output_weights: Array) -> None:
        """See `BoundResidual.curvature`."""
        views = self._lift.expansion(into)
        self._inner.curvature(self._lift.system.stripped(trajectory), weights, views, output_weights)

    def _padded(self, J: Jacobian) -> Jacobian:
        identity = np.broadcast_to(np.eye(self.size), (len(self.knots), self.size, self.size))
        x, u = (identity if isinstance(part, Identity) else part for part in J)
        return Jacobian(None if x is None else self._lift.columns_x(x), None if u is None else self._lift.columns_u(u))


class LiftedFunction(UserFunction):
    """A user's function of (x, u, t) as one of (z, v) and s; see the head of this file."""

    def __init__(self, lift: Lift, inner: UserFunction, t0: float, times: Array) -> None:
        self._lift, self._inner, self._t0, self._fixed = lift, inner, t0, times
        self.name, self.size = inner.name, inner.size

    def values(self, Z: Array, times: Array) -> Array:
        """See `UserFunction.values`; `times` are s."""
        return self._inner.values(self._plain(Z), self._clock(Z, times))

    def jacobians(self, Z: Array, times: Array) -> Array:
        """See `UserFunction.jacobians`."""
        plain, t = self._plain(Z), self._clock(Z, times)
        J = np.zeros((len(Z), self.size, Z.shape[1]))
        J[:, :, self._entries(Z)] = self._inner.jacobians(plain, t)
        if self._lift.timed:
            e = self._step(t, CLOCK)
            rate = (self._inner.values(plain, t + e) - self._inner.values(plain, t - e)) / (2.0 * e)[:, None]
            J[:, :, self._lift.system.inner.nx] = times[:, None] * rate
        return J

    def hessians(self, Z: Array, times: Array, weights: Array) -> Array:
        """See `UserFunction.hessians`."""
        plain, t, entries = self._plain(Z), self._clock(Z, times), self._entries(Z)
        H = np.zeros((len(Z), Z.shape[1], Z.shape[1]))
        H[:, entries[:, None], entries] = self._inner.hessians(plain, t, weights)
        if not self._lift.timed:
            return H
        e, at = self._step(t, CLOCK_TWICE), self._lift.system.inner.nx
        later, sooner, now = (self._inner.values(plain, moment) for moment in (t + e, t - e, t))
        if (later == now).all() and (sooner == now).all():
            return H  # no function of time
        H[:, at, at] = (times / e) ** 2 * np.vecdot(weights, later - 2.0 * now + sooner)
        e = self._step(t, CLOCK)
        rate = (self._inner.jacobians(plain, t + e) - self._inner.jacobians(plain, t - e)) / (2.0 * e)[:, None, None]
        mixed = times[:, None] * np.einsum("km,kmi->ki", weights, rate)
        H[:, at, entries] += mixed
        H[:, entries, at] += mixed
        return H

    def _clock(self, Z: Array, shares: Array) -> Array:
        """Times of the knots. Shape (k,). [s]"""
        if not self._lift.timed:
            return self._fixed
        return self._t0 + shares * Z[:, self._lift.system.inner.nx]

    def _step(self, t: Array, relative: float) -> Array:
        return relative * np.maximum(1.0, np.abs(t))

    def _entries(self, Z: Array) -> Array:
        """Where x and u are in (z, v)."""
        inner, size = self._lift.system.inner, len(self._lift.system.names)
        entries: Array = np.concatenate([np.arange(inner.nx), inner.nx + size + np.arange(inner.nu)])
        return entries

    def _plain(self, Z: Array) -> Array:
        return np.ascontiguousarray(Z[:, self._entries(Z)])
