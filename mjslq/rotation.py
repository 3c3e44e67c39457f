"""Unit quaternions q = (w, x, y, z) and rotation vectors phi, for whole arrays of them at once."""

from __future__ import annotations

import math

import numpy as np

from mjslq.validation import Array


def conjugate(q: Array) -> Array:
    """Inverse of a unit quaternion. Shape (..., 4)."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


def cross(a: Array, b: Array) -> Array:
    """Cross product of vectors; numpy's own takes several times as long. Shape (..., 3)."""
    product: Array = a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]
    return product


def product(p: Array, q: Array) -> Array:
    """Product of quaternions. Shape (..., 4)."""
    pw, pv, qw, qv = p[..., :1], p[..., 1:], q[..., :1], q[..., 1:]
    scalar = pw * qw - (pv * qv).sum(axis=-1, keepdims=True)
    return np.concatenate([scalar, pw * qv + qw * pv + cross(pv, qv)], axis=-1)


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


def rotate(q: Array, v: Array) -> Array:
    """Vectors turned by unit quaternions. Shapes (..., 4), (..., 3) -> (..., 3)."""
    twice = 2.0 * cross(q[..., 1:], v)
    turned: Array = v + q[..., :1] * twice + cross(q[..., 1:], twice)
    return turned


def skew(v: Array) -> Array:
    """Matrix of the cross product with v. Shape (..., 3) -> (..., 3, 3)."""
    matrix = np.zeros((*v.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., j, i], matrix[..., i, j] = v[..., k], -v[..., k]
    return matrix


def inverse_right_jacobian(phi: Array) -> Array:
    """Differentiate log(q exp(w)) by w at zero, where log(q) = phi: 1 + 1/2 [phi] + c [phi]^2, c as in the next one.

    Shape (..., 3) -> (..., 3, 3).
    """
    matrix, square = skew(phi), (phi * phi).sum(axis=-1)[..., None, None]
    twice = phi[..., :, None] * phi[..., None, :] - square * np.eye(3)  # [phi]^2
    return np.eye(3) + 0.5 * matrix + cotangent_series(phi)[0][..., None, None] * twice


_SERIES = np.array([1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600])
"""Of c in powers of t^2: absolute Bernoulli numbers B_2, B_4, ... over (2 k)!."""


def cotangent_series(phi: Array) -> tuple[Array, Array]:
    """C = (1 - t/2 cot t/2) / t^2 and its derivative by t over t, with t = |phi|. Shape (..., k) -> (...), (...).

    The formulas lose digits where t is small; there a series in t^2 stands in.
    """
    square = (phi * phi).sum(axis=-1)
    small = square < 0.25
    s = np.where(small, 1.0, square)
    half = 0.5 * np.sqrt(s)
    cot = half / np.tan(half)
    c = np.where(small, np.polynomial.polynomial.polyval(square, _SERIES), (1.0 - cot) / s)
    slopes = 2.0 * np.arange(1, len(_SERIES)) * _SERIES[1:]
    # c' = -g'/t^2 - 2 (1 - g)/t^3 with g = h cot h, h = t/2, and g' = (cot h - h / sin^2 h) / 2
    slope = ((half / np.sin(half)) ** 2 + cot - 2.0) / (s * s)
    return c, np.where(small, np.polynomial.polynomial.polyval(square, slopes), slope)


def _series(x: Array) -> tuple[Array, Array, Array, Array]:
    """B = (1 - cos t) / t^2, c = (t - sin t) / t^3 and their derivatives by t over t, t = |x|. Shapes (..., 1, 1)."""
    square = (x * x).sum(axis=-1)[..., None, None]
    small = square < 0.25
    s = np.where(small, 1.0, square)
    t = np.sqrt(s)
    sine, cosine = np.sin(t), np.cos(t)
    closed = (
        (1.0 - cosine) / s, (t - sine) / (s * t),
        (t * sine - 2.0 * (1.0 - cosine)) / (s * s), (3.0 * sine - 2.0 * t - t * cosine) / (s * s * t),
    )  # fmt: skip
    series = (np.polynomial.polynomial.polyval(square, terms) for terms in _TERMS)
    return tuple(np.where(small, near, far) for near, far in zip(series, closed, strict=True))


def _terms(first: int) -> Array:
    """Terms of sum (-s)^k / (2 k + first)!, that is 1 / first! - s / (first + 2)! + ..."""
    return np.array([(-1.0) ** k / math.factorial(2 * k + first) for k in range(9)])


def _slopes(terms: Array) -> Array:
    """Terms of twice the derivative by s = t^2, which is the derivative by t over t."""
    return 2.0 * np.arange(1, len(terms)) * terms[1:]


_TERMS = (_terms(2), _terms(3), _slopes(_terms(2)), _slopes(_terms(3)))


def right_jacobian(phi: Array) -> Array:
    """Differentiate log(exp(-phi) exp(phi + w)) by w at zero: 1 - b [phi] + c [phi]^2, b and c as in `_series`.

    Shape (..., 3) -> (..., 3, 3).
    """
    b, c, _, _ = _series(phi)
    matrix = skew(phi)
    return np.eye(3) - b * matrix + c * matrix @ matrix


def right_jacobian_slope(phi: Array, p: Array) -> Array:
    """Symmetric part of the derivative by phi of J' p = p + b phi x p + c phi x (phi x p), J the right Jacobian.

    Shapes (..., 3), (..., 3) -> (..., 3, 3).
    """
    _, c, b_slope, c_slope = _series(phi)
    turned = cross(phi, p)
    along = (phi * p).sum(axis=-1)[..., None, None]
    slopes = b_slope[..., 0] * turned + c_slope[..., 0] * cross(phi, turned)
    rate = slopes[..., :, None] * phi[..., None, :] + c * (along * np.eye(3) - phi[..., :, None] * p[..., None, :])
    return 0.5 * (rate + rate.swapaxes(-1, -2))
