"""Jacobians of MuJoCo's Runge-Kutta step of fourth order: the chain rule over its stages.

Notation
--------
    x = (q, v, s)             position, velocity, activation; z = (x, u)
    a, w                      continuous acceleration and rate of activation at a stage, u constant over the step
    d                         a tangent direction at x, q (+) d a walk along it, as mj_integratePos
    J0, J1                    derivatives of q (+) d by q and d: the identity, but for rotations

    r_i = (G(d_i) v_i, a_i, w_i)                    rates at the stage x_i = x (+) d_i
    d_1 = 0,  d_{i+1} = h/2 r_1, h/2 r_2, h r_3
    x+  = x (+) h/6 (r_1 + 2 r_2 + 2 r_3 + r_4)     activations clipped to their ranges

G is the identity, but for rotations: there d' = G(d) v with the inverse right Jacobian of the rotation group,

    G(d) = 1 + [d]/2 + c [d]^2,
    d(G(d) v)/dd = -[v]/2 - c ([d x v] + [d] [v]) + c'/t (d x (d x v)) d',    t = |d|.

The derivatives of a and w at a stage are those of an Euler step that starts there and takes nothing implicitly
(`table.continuous`), A_e = 1 + h d(v, a, w)/dx: exact where the inverse Jacobians are. A walk d from q to y has

    J1 = (d(y (-) q)/dy)^-1,   J0 = J1 d(q (-) y)/dq.

Source: MuJoCo's documentation, "Numerical integration"; for rotations Munthe-Kaas 1999, "High order Runge-Kutta
methods on manifolds".
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjslq import rotation
from mjslq.dynamics.mujoco.inverse.jacobians import InverseJacobians
from mjslq.dynamics.mujoco.inverse.table.continuous import activation_ranges, continuous_model
from mjslq.dynamics.mujoco.simulator import Simulator
from mjslq.dynamics.mujoco.step_differences import chain
from mjslq.dynamics.records import Linearization
from mjslq.manifold import StateSpace
from mjslq.validation import Array

_FRACTIONS = (0.5, 0.5, 1.0, 0.0)
_WEIGHTS = (1.0 / 6.0, 2.0 / 6.0, 2.0 / 6.0, 1.0 / 6.0)


class RungeKuttaJacobians:
    """Linearizes trajectories of a model with the integrator RK4, on threads and mjData of its own."""

    def __init__(self, model: mujoco.MjModel, space: StateSpace, threads: int, eps: float, centered: bool):
        self._space, self._nv, self._h = space, model.nv, float(model.opt.timestep)
        self._euler = Simulator(continuous_model(model), threads)
        self._inverse = InverseJacobians(self._euler, eps, centered)
        self._ranges = activation_ranges(model)

    def linearize(self, X: Array, U: Array, substates: Array) -> Linearization:
        """Jacobians of the steps from X (N + 1, nx) under U (N, nu), through substates (N, k - 1, nx)."""
        N, k, ndx, nu = len(U), substates.shape[1] + 1, self._space.ndx, U.shape[1]
        starts = np.concatenate([X[:-1, None], substates], axis=1).reshape(N * k, -1)
        A, B, C, D = self._single_steps(np.vstack([starts, X[-1:]]), np.repeat(U, k, axis=0))
        A, B = chain(A.reshape(N, k, ndx, ndx), B.reshape(N, k, ndx, nu))
        return Linearization(A, B, np.concatenate([C[:-1:k], C[-1:]]), np.concatenate([D[:-1:k], D[-1:]]))

    def _single_steps(self, X: Array, U: Array) -> Linearization:
        """The same for single steps, N of them."""
        N, ndx = len(U), self._space.ndx
        start = X[:-1]
        Z0 = np.concatenate([np.broadcast_to(np.eye(ndx), (N, ndx, ndx)), np.zeros((N, ndx, U.shape[1]))], axis=2)
        x, Z, d, dd = start, Z0, np.zeros((N, ndx)), np.zeros(Z0.shape)
        mean, dmean, outputs = np.zeros((N, ndx)), np.zeros(Z0.shape), []
        for fraction, weight in zip(_FRACTIONS, _WEIGHTS, strict=True):
            rate, drate, C, D = self._rates(np.vstack([x, X[-1:]]), U, Z)
            outputs.append((C, D))
            self._turn_rates(rate, drate, d, dd)
            mean, dmean = mean + weight * rate, dmean + weight * drate
            if fraction:
                d, dd = fraction * self._h * rate, fraction * self._h * drate
                x, Z = self._walk(start, Z0, d, dd)
        end, Z = self._walk(start, Z0, self._h * mean, self._h * dmean)
        self._clip_activations(end, Z)
        return Linearization(np.ascontiguousarray(Z[:, :, :ndx]), np.ascontiguousarray(Z[:, :, ndx:]), *outputs[0])

    def _rates(self, X: Array, U: Array, Z: Array) -> tuple[Array, Array, Array, Array]:
        """(v, a, w) at the states X[:-1], their derivatives, and C and D of the outputs at all states X."""
        x, nv, ndx, nx = X[:-1], self._nv, self._space.ndx, X.shape[1]
        plain = slice(nx - (ndx - nv), nx)  # velocities and activations
        F = self._euler.step_each(X, U)[0]
        A, B, C, D = self._inverse.linearize(X, U, np.zeros((len(U), 0, nx)), F)
        rate = np.concatenate([x[:, plain][:, :nv], (F - x)[:, plain] / self._h], axis=1)
        drate = np.empty(Z.shape)
        drate[:, :nv] = Z[:, nv : 2 * nv]
        drate[:, nv:] = (A[:, nv:] @ Z - Z[:, nv:]) / self._h
        drate[:, nv:, ndx:] += B[:, nv:] / self._h
        return rate, drate, C, D

    def _turn_rates(self, rate: Array, drate: Array, d: Array, dd: Array) -> None:
        """Replace the angular velocities v in the rates by G(d) v."""
        for part in self._space.parts:
            for k in part.dx:
                v, along = rate[:, k], d[:, k]
                G, c, slope = rotation.inverse_right_jacobian(along), *rotation.cotangent_series(along)
                c, slope = c[:, None, None], slope[:, None, None]
                once, skew_v = rotation.cross(along, v), rotation.skew(v)
                by_d = -0.5 * skew_v - c * (rotation.skew(once) + rotation.skew(along) @ skew_v)
                by_d += slope * rotation.cross(along, once)[:, :, None] * along[:, None, :]
                drate[:, k] = G @ drate[:, k] + by_d @ dd[:, k]
                rate[:, k] = (G @ v[:, :, None])[:, :, 0]

    def _walk(self, x: Array, Z: Array, d: Array, dd: Array) -> tuple[Array, Array]:
        """Where x (+) d ends, and its derivative."""
        y, dy = self._space.integrate(x, d), Z + dd
        for part in self._space.parts:
            for at, k in zip(part.x, part.dx, strict=True):
                forth = part.group.difference_jacobian(y[:, at], x[:, at])
                back = part.group.difference_jacobian(x[:, at], y[:, at])
                dy[:, k] = np.linalg.solve(back, forth @ Z[:, k] + dd[:, k])
        return y, dy

    def _clip_activations(self, end: Array, Z: Array) -> None:
        """Clear the rows of activations that end beyond their range."""
        na = len(self._ranges)
        if na:
            s = end[:, -na:]
            Z[:, -na:] *= ((s >= self._ranges[:, 0]) & (s <= self._ranges[:, 1]))[:, :, None]
