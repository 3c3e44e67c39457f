"""Differences of MuJoCo states: joint positions that hold quaternions, velocities, activations.

Notation
--------
    q1, q2   unit quaternions (w, x, y, z), the orientation part of two states
    phi      log(q1^-1 q2), a rotation vector in the frame of q1. [rad]
    difference(x, y) = phi and integrate(x, phi) = q1 exp(phi) on quaternions, y - x and x + dx on everything else

These are mj_differentiatePos and mj_integratePos with unit time, for whole arrays of states at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mjslq.rotation import conjugate, exp, inverse_right_jacobian, log, product
from mjslq.validation import Array


@dataclass(frozen=True)
class StateSpace:
    """Where the quaternions of a state are, and where its plain numbers."""

    nx: int
    ndx: int
    plain_x: np.ndarray[Any, np.dtype[np.intp]]
    """Entries of x that are plain numbers."""
    plain_dx: np.ndarray[Any, np.dtype[np.intp]]
    """Their tangent directions, in the same order."""
    quat_x: np.ndarray[Any, np.dtype[np.intp]]
    """Entries of x that hold a quaternion. Shape (nquat, 4)."""
    quat_dx: np.ndarray[Any, np.dtype[np.intp]]
    """Their tangent directions. Shape (nquat, 3)."""

    @classmethod
    def of_model(cls, model: Any) -> StateSpace:
        """State space of an MjModel: x = (qpos, qvel, act)."""
        nx, ndx = model.nq + model.nv + model.na, 2 * model.nv + model.na
        free = np.asarray(model.jnt_type) == 0  # mjJNT_FREE: three positions before the quaternion
        turns = free | (np.asarray(model.jnt_type) == 1)  # mjJNT_BALL
        first_x = (np.asarray(model.jnt_qposadr) + 3 * free)[turns]
        first_dx = (np.asarray(model.jnt_dofadr) + 3 * free)[turns]
        quat_x = (first_x[:, None] + np.arange(4)).astype(np.intp)
        quat_dx = (first_dx[:, None] + np.arange(3)).astype(np.intp)
        plain_x = np.setdiff1d(np.arange(nx), quat_x)
        plain_dx = np.setdiff1d(np.arange(ndx), quat_dx)
        return cls(nx, ndx, plain_x, plain_dx, quat_x, quat_dx)

    def difference(self, x: Array, y: Array) -> Array:
        """Tangent direction from `x` to `y`. Shapes (..., nx) -> (..., ndx)."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if not len(self.quat_x):
            return y - x
        dx = np.empty((*np.broadcast_shapes(x.shape, y.shape)[:-1], self.ndx))
        dx[..., self.plain_dx] = y[..., self.plain_x] - x[..., self.plain_x]
        dx[..., self.quat_dx] = log(product(conjugate(x[..., self.quat_x]), y[..., self.quat_x]))
        return dx

    def integrate(self, x: Array, dx: Array) -> Array:
        """State reached from `x` along `dx`. Shapes (..., nx), (..., ndx) -> (..., nx)."""
        x, dx = np.asarray(x, dtype=np.float64), np.asarray(dx, dtype=np.float64)
        if not len(self.quat_x):
            return x + dx
        y = np.empty((*np.broadcast_shapes(x.shape[:-1], dx.shape[:-1]), self.nx))
        y[..., self.plain_x] = x[..., self.plain_x] + dx[..., self.plain_dx]
        turned = product(x[..., self.quat_x], exp(dx[..., self.quat_dx]))
        y[..., self.quat_x] = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
        return y

    def difference_jacobian(self, x: Array, y: Array) -> Array | None:
        """Differentiate difference(x, y) by y, in tangent directions of y; None when it is the identity.

        Shape (..., ndx, ndx). On a quaternion it is the inverse of the right Jacobian of the rotation group,
        1 + 1/2 [phi] + c [phi]^2 with c = (1 - (t/2) cot(t/2)) / t^2 and t = |phi|.
        """
        if not len(self.quat_x):
            return None
        phi = self.difference(x, y)[..., self.quat_dx]  # (..., nquat, 3)
        jacobian = np.zeros((*phi.shape[:-2], self.ndx, self.ndx))
        jacobian[..., np.arange(self.ndx), np.arange(self.ndx)] = 1.0
        jacobian[..., self.quat_dx[:, :, None], self.quat_dx[:, None, :]] = inverse_right_jacobian(phi)
        return jacobian

    def tangent_basis(self, x: Array) -> Array | None:
        """Differentiate integrate(x, dx) by dx at zero: half of q (0, w) on a quaternion; None when it is the identity.

        Shapes (..., nx) -> (..., nx, ndx).
        """
        if not len(self.quat_x):
            return None
        x = np.asarray(x, dtype=np.float64)
        basis = np.zeros((*x.shape, self.ndx))
        basis[..., self.plain_x, self.plain_dx] = 1.0
        for j, unit in enumerate(np.eye(4)[1:]):
            basis[..., self.quat_x, self.quat_dx[:, j, None]] = 0.5 * product(x[..., self.quat_x], unit)
        return basis

    def normalized(self, x: Array) -> Array:
        """`x` with quaternions of unit length; one of length zero raises ValueError. Shape (..., nx)."""
        if not len(self.quat_x):
            return x
        quats = x[..., self.quat_x]
        length = np.linalg.norm(quats, axis=-1, keepdims=True)
        if (length < 1e-9).any():
            first = self.quat_x[int(np.argwhere(length < 1e-9)[0][-2])][0]
            raise ValueError(f"entries {first} to {first + 3} of the state are a quaternion and must not be all zero")
        x = x.copy()
        x[..., self.quat_x] = np.where(np.abs(length - 1.0) > 1e-12, quats / length, quats)
        return x
