"""Jacobians of MuJoCo's Runge-Kutta step of fourth order: the chain rule over its stages.

Notation
--------
    x = (q, v, s)             position, velocity, activation; z = (x, u)
    a, w                      continuous acceleration and rate of activation at a stage, u constant over the step
    q (+) d                   a walk along the tangent direction d, as mj_integratePos
    J0, J1                    derivatives of q (+) d by q and d: the identity, but for rotations

    x_1 = x,   q_i = q (+) c_i h v_{i-1},   v_i = v + c_i h a_{i-1},   s_i = s + c_i h w_{i-1}      c = 1/2, 1/2, 1
    q+ = q (+) h/6 (v_1 + 2 v_2 + 2 v_3 + v_4),   v+ and s+ likewise, s+ clipped to the activation's range

The derivatives of a and w at a stage are those of an Euler step that starts there and takes nothing implicitly
(`table.continuous`), A_e = 1 + h d(v, a, w)/dx: exact where the inverse Jacobians are. A walk d from q to y has

    J1 = (d(y (-) q)/dy)^-1,   J0 = J1 d(q (-) y)/dq.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.jacobians import InverseJacobians
from mjslq.dynamics.mujoco.inverse.table.continuous import activation_ranges, continuous_model
from mjslq.dynamics.mujoco.simulator import Simulator
from mjslq.dynamics.records import Linearization
from mjslq.manifold import StateSpace
from mjslq.validation import Array

_FRACTIONS = (0.5, 0.5, 1.0)
_WEIGHTS = (1.0 / 6.0, 2.0 / 6.0, 2.0 / 6.0, 1.0 / 6.0)


class RungeKuttaJacobians:
    """Linearizes trajectories of a model with the integrator RK4, on threads and mjData of its own."""

    def __init__(self, model: mujoco.MjModel, space: StateSpace, threads: int, eps: float, centered: bool):
        self._space, self._nv, self._h = space, model.nv, float(model.opt.timestep)
        self._euler = Simulator(continuous_model(model), threads)
        self._inverse = InverseJacobians(self._euler, eps, centered)
        self._ranges = activation_ranges(model)

    def linearize(self, X: Array, U: Array, substates: Array) -> Linearization:
        """Jacobians of the steps from X (N + 1, nx) under U (N, nu) through substates (N, k - 1, nx), and of outputs."""
        N, k, ndx, nu = len(U), substates.shape[1] + 1, self._space.ndx, U.shape[1]
        starts = np.concatenate([X[:-1, None], substates], axis=1).reshape(N * k, -1)
        A, B, C, D = self._single_steps(np.vstack([starts, X[-1:]]), np.repeat(U, k, axis=0))
        A, B = A.reshape(N, k, ndx, ndx), B.reshape(N, k, ndx, nu)
        whole_A, whole_B = A[:, 0], B[:, 0]
        for s in range(1, k):
            whole_A, whole_B = A[:, s] @ whole_A, A[:, s] @ whole_B + B[:, s]
        return Linearization(
            np.ascontiguousarray(whole_A), np.ascontiguousarray(whole_B),
            np.concatenate([C[:-1:k], C[-1:]]), np.concatenate([D[:-1:k], D[-1:]]),
        )  # fmt: skip

    def _single_steps(self, X: Array, U: Array) -> Linearization:
        """The same for single steps, N of them."""
        N, nv, ndx, h = len(U), self._nv, self._space.ndx, self._h
        start, first = X[:-1], X.shape[1] - (ndx - nv)
        Z0 = np.concatenate([np.broadcast_to(np.eye(ndx), (N, ndx, ndx)), np.zeros((N, ndx, U.shape[1]))], axis=2)
        x, Z = start, Z0
        mean, dmean, C, D = np.zeros((N, ndx)), np.zeros(Z0.shape), None, None
        for stage, weight in enumerate(_WEIGHTS):
            x_stage = np.vstack([x, X[-1:]])
            F = self._euler.step_each(x_stage, U)[0]
            A_e, B_e, C_e, D_e = self._inverse.linearize(x_stage, U, np.zeros((N, 0, X.shape[1])), F)
            if stage == 0:
                C, D = C_e, D_e
            rate, drate = np.empty((N, ndx)), np.empty(Z0.shape)
            velocity = x[:, first : first + nv]  # it and the activations behind it are plain numbers
            rate[:, :nv], rate[:, nv:] = velocity, (F - x)[:, first:] / h
            drate[:, :nv] = Z[:, nv : 2 * nv]
            drate[:, nv:] = (A_e[:, nv:] @ Z - Z[:, nv:]) / h
            drate[:, nv:, ndx:] += B_e[:, nv:] / h
            mean, dmean = mean + weight * rate, dmean + weight * drate
            if stage < 3:
                along = _FRACTIONS[stage] * h
                x, Z = self._walk(start, Z0, along * rate, along * drate)
        end, Z = self._walk(start, Z0, h * mean, h * dmean)
        self._clip_activations(end, Z)
        assert C is not None and D is not None
        return Linearization(np.ascontiguousarray(Z[:, :, :ndx]), np.ascontiguousarray(Z[:, :, ndx:]), C, D)

    def _walk(self, x: Array, Z: Array, d: Array, dd: Array) -> tuple[Array, Array]:
        """Where x (+) d ends, and its derivative."""
        y = self._space.integrate(x, d)
        back = self._space.difference_jacobian(x, y)
        if back is None:
            return y, Z + dd
        forth = self._space.difference_jacobian(y, x)
        return y, np.linalg.solve(back, forth @ Z + dd)

    def _clip_activations(self, end: Array, Z: Array) -> None:
        """Clear the rows of activations that end beyond their range."""
        na = len(self._ranges)
        if na:
            s = end[:, -na:]
            Z[:, -na:] *= ((s >= self._ranges[:, 0]) & (s <= self._ranges[:, 1]))[:, :, None]
