"""Unit quaternions q = (w, x, y, z) and rotation vectors phi, for whole arrays of them at once."""

from __future__ import annotations

import numpy as np

from mjslq.validation import Array


def conjugate(q: Array) -> Array:
    """Inverse of a unit quaternion. Shape (..., 4)."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def product(p: Array, q: Array) -> Array:
    """Product of quaternions. Shape (..., 4)."""
    pw, pv, qw, qv = p[..., :1], p[..., 1:], q[..., :1], q[..., 1:]
    scalar = pw * qw - (pv * qv).sum(axis=-1, keepdims=True)
    return np.concatenate([scalar, pw * qv + qw * pv + np.cross(pv, qv)], axis=-1)


def log(q: Array) -> Array:
    """Rotation vector of a quaternion of any length above zero, of angle at most pi. Shape (..., 4) -> (..., 3)."""
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    angle = np.where(angle > np.pi, angle - 2.0 * np.pi, angle)
    return q[..., 1:] * (angle / np.where(sine > 0.0, sine, 1.0))


def exp(phi: Array) -> Array:
    """Quaternion of a rotation vector. Shape (..., 3) -> (..., 4)."""
    half = 0.5 * np.linalg.norm(phi, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * phi], axis=-1)


def inverse_right_jacobian(phi: Array) -> Array:
    """Differentiate log(q exp(w)) by w at zero, where log(q) = phi. Shape (..., 3) -> (..., 3, 3)."""
    square = (phi * phi).sum(axis=-1)
    angle = np.sqrt(square)
    small = angle < 1e-3
    half = np.where(small, 1.0, 0.5 * angle)
    c = np.where(small, 1.0 / 12.0 + square / 720.0, (1.0 - half / np.tan(half)) / np.where(small, 1.0, square))
    skew = np.zeros((*phi.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        skew[..., j, i], skew[..., i, j] = phi[..., k], -phi[..., k]
    return np.eye(3) + 0.5 * skew + c[..., None, None] * (skew @ skew)
