"""The Runge-Kutta step of fourth order for a Pinocchio model, and its derivative by the chain rule.

Notation
--------
    v' = a(q, v, u), q' = v in the body's own directions; u constant over the step of length h
    q (+) d      a walk along the tangent direction d, q + d where positions are plain vectors

    v_2 = v + h/2 a_1     q_2 = q (+) h/2 v_1                    a_i = a(q_i, v_i, u)
    v_3 = v + h/2 a_2     q_3 = q (+) h/2 v_2
    v_4 = v + h a_3       q_4 = q_2 (+) (h v_3 - h/2 v_1)
    v+  = v + h/6 (a_1 + 2 a_2 + 2 a_3 + a_4)
    q+  = q (+) h/12 (3 v_1 + 2 v_2 + 2 v_3 - v_4) (+) h/12 (-v_1 + 2 v_2 + 2 v_3 + 3 v_4)

With plain vectors this is the classical method. The two walks of the last line keep the fourth order on rotations as
well, where a single walk along the mean velocity has only the second.

Source: Celledoni, Marthinsen and Owren 2003, "Commutator-free Lie group methods", the method of order four.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from mjslq.dynamics.pinocchio import kernels
from mjslq.dynamics.pinocchio.simulator import Recorder, Simulator
from mjslq.validation import Array

Acceleration = Callable[[int, Array, Array], Array]


def runge_kutta(
    model: Any, h: float, q: Array, v: Array, acceleration: Acceleration
) -> tuple[Array, Array, list[tuple[Array, Array]]]:
    """One step: the next q and v, and the five walks (from, along) on the way, in the order of their use.

    `acceleration(i, q_i, v_i)` is called for the stages i = 0 to 3.
    """
    walks: list[tuple[Array, Array]] = []

    def walk(start: Array, along: Array) -> Array:
        walks.append((start, along))
        end: Array = pin.integrate(model, start, along)
        return end

    a1 = acceleration(0, q, v)
    q2, v2 = walk(q, 0.5 * h * v), v + 0.5 * h * a1
    a2 = acceleration(1, q2, v2)
    q3, v3 = walk(q, 0.5 * h * v2), v + 0.5 * h * a2
    a3 = acceleration(2, q3, v3)
    q4, v4 = walk(q2, h * v3 - 0.5 * h * v), v + h * a3
    a4 = acceleration(3, q4, v4)
    middle = walk(q, h / 12.0 * (3.0 * v + 2.0 * (v2 + v3) - v4))
    end = walk(middle, h / 12.0 * (2.0 * (v2 + v3) + 3.0 * v4 - v))
    return end, v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4), walks


class RungeKutta4(Simulator):
    """The step at the head of this file; damping is part of a."""

    def step(self, n: int, X: Array, recorder: Recorder) -> bool:
        """See `Simulator.step`."""
        q, v = self.q.copy(), self.v.copy()

        def acceleration(i: int, q_i: Array, v_i: Array) -> Array:
            torque = self.tau - self.damping * (v_i - v)
            self.body.accelerate(q_i, v_i, torque)
            if i == 0:
                recorder.note(n)
            return self.body.acceleration.copy()

        with np.errstate(over="ignore", invalid="ignore"):
            self.q[:], self.v[:], _ = runge_kutta(self.model, self.h, q, v, acceleration)
        X[n + 1] = np.concatenate([self.q, self.v])
        return bool((np.abs(X[n + 1]) < kernels.ABSURD).all())

    def differentiate(self, X: Array, tau: Array, recorder: Recorder, J: Array) -> tuple[Array, Array]:
        """See `Simulator.differentiate`."""
        N, nv, nq = len(tau), self.model.nv, self.model.nq
        a_q, a_v, a_u = (np.zeros((4, N, nv, nv)) for _ in range(3))
        size = self.curved.stop - self.curved.start
        J0, J1 = np.zeros((2, 5, N, size, size))
        for n in range(N):
            q, v = X[n, :nq].copy(), X[n, nq:].copy()

            def acceleration(i: int, q_i: Array, v_i: Array, n: int = n, v: Array = v) -> Array:
                torque = tau[n] - self.damping * (v_i - v)
                self.body.differentiate(q_i, v_i, torque)
                a_q[i, n], a_v[i, n], a_u[i, n] = self.body.derivatives
                if i == 0:
                    recorder.note(n)
                    J[n] = self.body.jacobian
                return self.body.acceleration.copy()

            walks = runge_kutta(self.model, self.h, q, v, acceleration)[2]
            if not self.plain:
                for i, (start, along) in enumerate(walks):
                    J0[i, n], J1[i, n] = self.walk_jacobians(start, along)
        a_v -= a_u * self.damping
        return self._chain(a_q, a_v, a_u[..., self.actuated], J0, J1)

    def _chain(self, a_q: Array, a_v: Array, a_u: Array, J0: Array, J1: Array) -> tuple[Array, Array]:
        """Chain rule over the stages, for all steps at once: columns are (dq, dv, du)."""
        N, nv, h, curved = a_q.shape[1], self.model.nv, self.h, self.curved
        dq, dv = np.zeros((2, N, nv, 2 * nv + len(self.actuated)))
        dq[:, :, :nv], dv[:, :, nv : 2 * nv] = np.eye(nv), np.eye(nv)

        def acceleration(i: int, dq_i: Array, dv_i: Array) -> Array:
            da = a_q[i] @ dq_i + a_v[i] @ dv_i
            da[:, :, 2 * nv :] += a_u[i]
            return da

        def walk(i: int, start: Array, along: Array) -> Array:
            end = start + along
            if not self.plain:
                end[:, curved] = J0[i] @ start[:, curved] + J1[i] @ along[:, curved]
            return end

        a1 = acceleration(0, dq, dv)
        q2, v2 = walk(0, dq, 0.5 * h * dv), dv + 0.5 * h * a1
        a2 = acceleration(1, q2, v2)
        q3, v3 = walk(1, dq, 0.5 * h * v2), dv + 0.5 * h * a2
        a3 = acceleration(2, q3, v3)
        q4, v4 = walk(2, q2, h * v3 - 0.5 * h * dv), dv + h * a3
        a4 = acceleration(3, q4, v4)
        middle = walk(3, dq, h / 12.0 * (3.0 * dv + 2.0 * (v2 + v3) - v4))
        end = walk(4, middle, h / 12.0 * (2.0 * (v2 + v3) + 3.0 * v4 - dv))
        both = np.concatenate([end, dv + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)], axis=1)
        return np.ascontiguousarray(both[:, :, : 2 * nv]), np.ascontiguousarray(both[:, :, 2 * nv :])
