"""Whole horizons of a Pinocchio model: a loop over Pinocchio's own calls, and all the rest for all knots at once.

Notation
--------
    x = (q, v)                                          h = dt
    a(q, v, u) = FD(q, v, S u - D v)                    S picks the actuated dofs, D is the joints' damping;
                                                        FD: see `algorithms`
    v_{n+1} = v_n + h a(q_n, v_n, u_n)                  semi-implicit Euler
    q_{n+1} = q_n (+) h v_{n+1}
    J0, J1                                              derivatives of q (+) d by q and by d

    dv_{n+1} = h a_q dq + (1 + h a_v) dv + h a_u du     rows of A and B
    dq_{n+1} = J0 dq + h J1 dv_{n+1}

Damping is implicit, as in MuJoCo's Euler: v_{n+1} = v_n + h (M + h D)^-1 (S u - D v_n - c). That is the line above
with h D added to the armature, so it takes no other algorithm.

Pinocchio's results are looked at through views of its own memory, made once: a call to ABA and what belongs to it
cost a few microseconds a step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mjslq.dynamics.dynamics import Feedback, Linearization
from mjslq.dynamics.pinocchio import kernels
from mjslq.dynamics.pinocchio.algorithms import ForwardDynamics
from mjslq.dynamics.pinocchio.outputs import Readings
from mjslq.trajectory import Trajectory
from mjslq.validation import Array


class Recorder:
    """Placements of joints along a horizon, noted from Pinocchio's memory knot by knot."""

    def __init__(self, memory: dict[int, tuple[Array, Array]], knots: int) -> None:
        self.placements = {j: (np.zeros((knots, 3, 3)), np.zeros((knots, 3))) for j in memory}
        """R and t of each joint. Shapes (knots, 3, 3), (knots, 3)."""
        self._pairs = [pair for j in memory for pair in zip(self.placements[j], memory[j], strict=True)]

    def note(self, n: int) -> None:
        """Take the placements that are in the memory now for those of knot n."""
        for target, source in self._pairs:
            target[n] = source


class Law(NamedTuple):
    """Feedback as the kernels take it; see there."""

    X_ref: Array
    K: Array
    limits: Array

    @classmethod
    def of(cls, feedback: Feedback) -> Law:
        """The same law, in arrays that may be written to."""
        X_ref, K, lower, upper = feedback.contiguous()
        return cls(_writable(X_ref), _writable(K), np.stack([lower, upper]))


class Simulator(ABC):
    """A model with its memory. Not for several callers at once."""

    def __init__(self, body: ForwardDynamics, h: float, damping: Array, actuated: Array, readings: Readings) -> None:
        self.body, self.h, self.damping, self.actuated, self.readings = body, h, damping, actuated, readings
        self.model = model = body.model
        self.plain = model.nq == model.nv
        """Whether positions are plain vectors."""
        curved = [i for j in range(1, model.njoints) if model.nqs[j] != model.nvs[j]
                  for i in (model.idx_vs[j], model.idx_vs[j] + model.nvs[j])]  # fmt: skip
        self.curved = slice(min(curved, default=0), max(curved, default=0))
        """The dofs outside of which J0 and J1 are the identity."""
        data = body.data
        self._memory = {j: (data.oMi[j].rotation, data.oMi[j].translation) for j in readings.joints}
        self.q, self.v = np.zeros(model.nq), np.zeros(model.nv)
        self.tau, self.dq = np.zeros(model.nv), np.zeros(model.nv)

    @abstractmethod
    def step(self, n: int, X: Array, recorder: Recorder) -> bool:
        """Step from (q, v) under tau, and write X[n + 1]; False when it blew up. Notes the placements of knot n."""

    @abstractmethod
    def differentiate(self, X: Array, tau: Array, recorder: Recorder, J: Array) -> tuple[Array, Array]:
        """A and B of all steps; `tau` (N, nv) are the torques at their beginning. Notes placements and Jacobians J."""

    def walk_jacobians(self, q: Array, d: Array) -> tuple[Array, Array]:
        """J0 and J1 of q (+) d among the curved dofs."""
        square = (self.model.nv, self.model.nv)
        J0, J1 = (np.reshape(part, square) for part in pin.dIntegrate(self.model, q, d))
        return J0[self.curved, self.curved], J1[self.curved, self.curved]

    def simulate(self, x0: Array, U: Array, feedback: Feedback | None) -> Trajectory:
        """Simulate from `x0` under `U` (N, nu), or under the law; see `Dynamics.rollouts`."""
        N, nq, nv = len(U), self.model.nq, self.model.nv
        X = np.empty((N + 1, nq + nv))
        X[0], self.q[:], self.v[:] = x0, x0[:nq], x0[nq:]
        given, law = U, None if feedback is None else Law.of(feedback)
        U = _writable(np.ascontiguousarray(U)) if law is None else U.copy(order="C")
        recorder = Recorder(self._memory, N + 1)
        good = self.run(X, U, law, recorder)
        if good == N:
            pin.forwardKinematics(self.model, self.body.data, self.q)
            recorder.note(N)
        Y = self.readings.read(recorder.placements, N + 1)
        if good == N:
            return Trajectory.unchecked(X, U, Y, self.h)
        bad = good + 1
        X[bad:], Y[bad:] = np.nan, np.nan
        if law is not None:
            U[bad:] = given[bad:]
        return Trajectory.unchecked(X, U, Y, self.h, bad)

    def step_each(self, X: Array, U: Array) -> tuple[Array, Array]:
        """One step from each knot; see `Dynamics.step_each`."""
        N, nq = len(U), self.model.nq
        ends, recorder = np.empty((N + 1, X.shape[1])), Recorder(self._memory, N + 1)
        for n in range(N):
            self.q[:], self.v[:] = X[n, :nq], X[n, nq:]
            kernels.control(n, X, U, self.damping, self.actuated, self.tau)
            if not self.step(n, ends, recorder):
                ends[n + 1] = np.nan
        pin.forwardKinematics(self.model, self.body.data, X[N, :nq].copy())
        recorder.note(N)
        return ends[1:], self.readings.read(recorder.placements, N + 1)

    def run(self, X: Array, U: Array, law: Law | None, recorder: Recorder) -> int:
        """Simulate step by step; return how many steps went well."""
        for n in range(len(U)):
            if law is not None:
                if not self.plain:
                    self.dq[:] = pin.difference(self.model, law.X_ref[n, : self.q.size], self.q)
                kernels.follow(n, self.plain, X, U, self.dq, *law)
            kernels.control(n, X, U, self.damping, self.actuated, self.tau)
            if not self.step(n, X, recorder):
                return n
        return len(U)

    def linearize(self, trajectory: Trajectory) -> Linearization:
        """Jacobians of all steps and outputs."""
        N, nq, nv = trajectory.horizon, self.model.nq, self.model.nv
        X, tau, J = trajectory.X, np.zeros((N, nv)), np.zeros((N + 1, *self.body.jacobian.shape))
        tau[:, self.actuated] = trajectory.U
        tau -= self.damping * X[:-1, nq:]
        recorder = Recorder(self._memory, N + 1)
        A, B = self.differentiate(X, tau, recorder, J)
        C, D = np.zeros((N + 1, self.readings.ny, 2 * nv)), np.zeros((N + 1, self.readings.ny, len(self.actuated)))
        if self.readings.ny:
            self.body.find_jacobian(np.array(X[N, :nq]))
            recorder.note(N)
            J[N] = self.body.jacobian
            by_joints = self.readings.jacobian(recorder.placements, J)
            C[..., :nv] = by_joints if self.body.G is None else by_joints @ self.body.G
        return Linearization(A, B, C, D)


class SemiImplicitEuler(Simulator):
    """The step at the head of this file. `model` has h D in its armature already."""

    def run(self, X: Array, U: Array, law: Law | None, recorder: Recorder) -> int:
        """See `Simulator.run`; with plain positions a step is one call of Pinocchio's and one of ours."""
        if not self.plain or not len(U):
            return super().run(X, U, law, recorder)
        accelerate, q, v, tau = self.body.accelerate, self.q, self.v, self.tau
        rest: tuple[Any, ...] = (self.body.acceleration, q, v, self.dq, X, U)
        torques, euler = (self.damping, self.actuated, tau), kernels.euler_and_control
        if law is not None:
            kernels.follow(0, True, X, U, self.dq, *law)
            rest, euler = (*rest, *law), kernels.euler_and_follow
        kernels.control(0, X, U, *torques)
        rest += torques
        for n in range(len(U)):
            accelerate(q, v, tau)
            recorder.note(n)
            if not euler(n, self.h, *rest):
                return n
        return len(U)

    def step(self, n: int, X: Array, recorder: Recorder) -> bool:
        """See `Simulator.step`."""
        self.body.accelerate(self.q, self.v, self.tau)
        recorder.note(n)
        good = kernels.euler(n, self.h, self.plain, self.body.acceleration, self.q, self.v, self.dq, X)
        if not self.plain and good:
            self.q[:] = X[n + 1, : self.q.size] = pin.integrate(self.model, self.q, self.dq)
            good = bool(np.abs(self.q).max() < kernels.ABSURD)
        return good

    def differentiate(self, X: Array, tau: Array, recorder: Recorder, J: Array) -> tuple[Array, Array]:
        """See `Simulator.differentiate`."""
        N, nv, nq, h = len(tau), self.model.nv, self.model.nq, self.h
        A, B = np.zeros((N, 2 * nv, 2 * nv)), np.zeros((N, 2 * nv, len(self.actuated)))
        Q, V = X[:-1, :nq].copy(), X[:-1, nq:].copy()
        curved = self.curved
        size = curved.stop - curved.start
        J0, J1 = np.zeros((2, N, size, size))
        for n, (q, v, torque) in enumerate(zip(Q, V, tau, strict=True)):
            self.body.differentiate(q, v, torque)
            kernels.gather(n, h, *self.body.derivatives, self.body.jacobian, self.damping, self.actuated, A, B, J)
            recorder.note(n)
            if not self.plain:
                J0[n], J1[n] = self.walk_jacobians(q, h * (v + h * self.body.acceleration))
        A[:, :nv], B[:, :nv] = h * A[:, nv:], h * B[:, nv:]
        A[:, np.arange(nv), np.arange(nv)] += 1.0
        if not self.plain:
            A[:, curved], B[:, curved] = h * J1 @ A[:, nv:][:, curved], h * J1 @ B[:, nv:][:, curved]
            A[:, curved, curved] += J0
        return A, B


def _writable(array: Array) -> Array:
    """The array, or a copy of one that is read-only: calls of a kernel with such take longer than that, every step."""
    return array if array.flags.writeable else array.copy()
