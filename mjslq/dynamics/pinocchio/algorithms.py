"""Accelerations of a Pinocchio model and their derivatives, without and with joints that mimic others.

Notation
--------
    q, v, a, tau              configuration, velocity, acceleration, joint torques          (nq,), (nv,), (nv,), (nv,)
    a = M^-1 (tau - c)        forward dynamics; c(q, v) the bias forces, tau = ID(q, v, a) the inverse dynamics
    a_q, a_v, M^-1            its derivatives by q, v and tau                               (nv, nv)
    J                         joint Jacobians in the world frame, a row per dof, velocity of the point at the origin
                              first, angular velocity next                                  (nf, 6)

Without mimicking joints both are Pinocchio's: the articulated-body algorithm and its derivatives (Carpentier and
Mansard 2018), nf = nv. These take no joint that mimics another, q_i = m q_j + o. Let `free` be the same robot with all
its joints on their own, of nf dofs:

    q_free = T q + o,   v_free = G v,   tau = G' tau_free                       T, G, o constant
    M = G' M_free G,    c = G' c_free                                           by Pinocchio's crba and nle
    a_q = -M^-1 G' (dID_free/dq) G,    a_v = -M^-1 G' (dID_free/dv) G           at a_free = G a

exactly, by the derivatives of the recursive Newton-Euler algorithm of `free`. A row of G has one entry, so that
armature and damping of the joints on their own, diag(d), stay diagonal: G' diag(d) G = diag((G o G)' d).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import scipy.linalg

from mjslq.validation import Array


@dataclass(frozen=True)
class Ties:
    """How the joints of `free`, all on their own, follow from those of the model."""

    free: Any
    """The pinocchio.Model without mimicking joints."""
    T: Array
    """Shape (nq of free, nq)."""
    o: Array
    """Shape (nq of free,)."""
    G: Array
    """Shape (nf, nv)."""
    followers: Mapping[str, tuple[str, float, float]]
    """Leader, multiplier m and offset of each joint that mimics another."""

    def reduced(self, diagonal: Array) -> Array:
        """(G o G)' d. Shapes (nf,) -> (nv,)."""
        return np.asarray((self.G * self.G).T @ diagonal)


class ForwardDynamics:
    """Pinocchio's articulated-body algorithm, whose results are looked at through views of its own memory."""

    G: Array | None = None
    """Velocities of the joints on their own by those of the model, where they differ. Shape (nf, nv)."""

    def __init__(self, model: Any) -> None:
        self.model, self.data = model, model.createData()
        data = self.data
        pin.computeABADerivatives(model, data, pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv))
        square = (model.nv, model.nv)  # Pinocchio hands out matrices of one row or column as vectors
        self.acceleration: Array = data.ddq
        """a, after `accelerate` and `differentiate`. Shape (nv,)."""
        self.derivatives = tuple(np.reshape(part, square) for part in (data.ddq_dq, data.ddq_dv, data.Minv))
        """a_q, a_v, M^-1, after `differentiate`."""
        self.jacobian = np.reshape(data.J.T, (model.nv, 6))
        """J, after `differentiate` and `find_jacobian`."""

    def accelerate(self, q: Array, v: Array, tau: Array) -> None:
        """Find the acceleration, and the joints' placements."""
        pin.aba(self.model, self.data, q, v, tau, pin.Convention.WORLD)

    def differentiate(self, q: Array, v: Array, tau: Array) -> None:
        """Find the acceleration, its derivatives, the joints' placements and Jacobians."""
        pin.computeABADerivatives(self.model, self.data, q, v, tau)

    def find_jacobian(self, q: Array) -> None:
        """Find the joints' placements and Jacobians."""
        pin.computeJointJacobians(self.model, self.data, q)


class TiedDynamics(ForwardDynamics):
    """The same with joints that mimic others; `model` has them, `ties.free` has not."""

    def __init__(self, model: Any, ties: Ties) -> None:
        self.model, self.data, self.ties, self.G = model, model.createData(), ties, ties.G
        self._free = ties.free.createData()
        nv, nf = ties.G.shape[1], ties.G.shape[0]
        self.acceleration = np.zeros(nv)
        self.derivatives = tuple(np.zeros((3, nv, nv)))
        self.find_jacobian(pin.neutral(model))
        self.jacobian = np.reshape(self._free.J.T, (nf, 6))

    def accelerate(self, q: Array, v: Array, tau: Array) -> None:
        """See `ForwardDynamics.accelerate`."""
        pin.forwardKinematics(self.model, self.data, q)
        self.acceleration[:] = scipy.linalg.cho_solve(self._factor(q), tau - self._bias(q, v), check_finite=False)

    def differentiate(self, q: Array, v: Array, tau: Array) -> None:
        """See `ForwardDynamics.differentiate`."""
        ties, (a_q, a_v, inverse) = self.ties, self.derivatives
        pin.forwardKinematics(self.model, self.data, q)
        inverse[:] = scipy.linalg.cho_solve(self._factor(q), np.eye(len(v)), check_finite=False)
        self.acceleration[:] = inverse @ (tau - self._bias(q, v))
        free_q = ties.T @ q + ties.o
        by_q, by_v, _ = pin.computeRNEADerivatives(
            ties.free, self._free, free_q, ties.G @ v, ties.G @ self.acceleration
        )
        for target, part in ((a_q, by_q), (a_v, by_v)):
            target[:] = -inverse @ (ties.G.T @ part @ ties.G)
        pin.computeJointJacobians(ties.free, self._free, free_q)

    def find_jacobian(self, q: Array) -> None:
        """See `ForwardDynamics.find_jacobian`."""
        pin.forwardKinematics(self.model, self.data, q)
        pin.computeJointJacobians(self.ties.free, self._free, self.ties.T @ q + self.ties.o)

    def _factor(self, q: Array) -> tuple[Array, bool]:
        return scipy.linalg.cho_factor(pin.crba(self.model, self.data, q), check_finite=False)

    def _bias(self, q: Array, v: Array) -> Array:
        return np.asarray(pin.nonLinearEffects(self.model, self.data, q, v))
