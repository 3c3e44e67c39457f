"""The groups that states are made of beside plain numbers: rotations and rigid motions, in the plane and in space.

Notation
--------
    x, y         elements of a group, arrays (..., nx)        xi    tangent direction at x, an array (..., ndx)
    R, p         rotation and position of a rigid motion      xi = (rho, phi), both in the frame of x
    phi          rotation vector [rad], t = |phi| its angle   [phi] the matrix of the cross product with phi

    integrate(x, xi) = x exp(xi)        difference(x, y) = log(x^-1 y)        integrate(x, difference(x, y)) = y

    Rotation   (w, x, y, z)        exp(phi) = (cos t/2, sin t/2 phi/t)
    Motion     (p, w, x, y, z)     exp(rho, phi) = (V rho, exp(phi)),  V = 1 + a [phi] + b [phi]^2,
                                   a = (1 - cos t) / t^2,  b = (t - sin t) / t^3
                                   V^-1 = 1 - 1/2 [phi] + c [phi]^2,  c = (1 - t/2 cot t/2) / t^2
    Turn       (cos, sin)          the same in the plane, with numbers for phi
    Slide      (p, cos, sin)

Every group works on whole arrays of elements at once. Quaternions have the scalar first; who keeps it elsewhere says
so by the order in which it lists the entries of a state (`manifold.StateSpace`).

Source: Sola, Deray and Atchuthan 2018, "A micro Lie theory for state estimation in robotics", appendices A to D.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from mjslq import rotation
from mjslq.validation import Array


class Group(ABC):
    """Elements of one kind; see the head of this file."""

    nx: int
    """Entries of an element."""
    ndx: int
    """Tangent directions."""
    unit: slice
    """The entries that have length one together."""

    @abstractmethod
    def difference(self, x: Array, y: Array) -> Array:
        """log(x^-1 y). Shapes (..., nx) -> (..., ndx)."""

    @abstractmethod
    def integrate(self, x: Array, xi: Array) -> Array:
        """X exp(xi). Shapes (..., nx), (..., ndx) -> (..., nx)."""

    @abstractmethod
    def difference_jacobian(self, x: Array, y: Array) -> Array:
        """Differentiate difference(x, y exp(xi)) by xi at zero. Shapes (..., nx) -> (..., ndx, ndx)."""

    @abstractmethod
    def tangent_basis(self, x: Array) -> Array:
        """Differentiate integrate(x, xi) by xi at zero. Shapes (..., nx) -> (..., nx, ndx)."""

    @abstractmethod
    def curvature(self, x: Array, g: Array) -> Array:
        """Second derivatives of g'integrate(x, xi) by xi at zero. Shapes (..., nx) -> (..., ndx, ndx)."""


class Rotation(Group):
    """Rotations in space: unit quaternions (w, x, y, z)."""

    nx, ndx, unit = 4, 3, slice(0, 4)

    def difference(self, x: Array, y: Array) -> Array:
        """See `Group`."""
        return rotation.log(rotation.product(rotation.conjugate(x), y))

    def integrate(self, x: Array, xi: Array) -> Array:
        """See `Group`."""
        turned = rotation.product(x, rotation.exp(xi))
        return turned / np.linalg.norm(turned, axis=-1, keepdims=True)

    def difference_jacobian(self, x: Array, y: Array) -> Array:
        """See `Group`: the inverse of the right Jacobian of the rotation group."""
        return rotation.inverse_right_jacobian(self.difference(x, y))

    def tangent_basis(self, x: Array) -> Array:
        """See `Group`: half of x (0, e) for the three axes e."""
        return np.stack([0.5 * rotation.product(x, axis) for axis in np.eye(4)[1:]], axis=-1)

    def curvature(self, x: Array, g: Array) -> Array:
        """See `Group`: x (1 - |xi|^2 / 8, xi/2) to second order."""
        return -0.25 * np.vecdot(g, x)[..., None, None] * np.eye(3)


class Motion(Group):
    """Rigid motions of space: a position and a unit quaternion (w, x, y, z)."""

    nx, ndx, unit = 7, 6, slice(3, 7)

    def difference(self, x: Array, y: Array) -> Array:
        """See `Group`."""
        phi, p = self._relative(x, y)
        c = rotation.cotangent_series(phi)[0][..., None]
        turned = rotation.cross(phi, p)
        return np.concatenate([p - 0.5 * turned + c * rotation.cross(phi, turned), phi], axis=-1)

    def integrate(self, x: Array, xi: Array) -> Array:
        """See `Group`."""
        rho, phi = xi[..., :3], xi[..., 3:]
        t = np.linalg.norm(phi, axis=-1, keepdims=True)
        a = 0.5 * np.sinc(0.5 * t / np.pi) ** 2
        b = np.where(t < 1e-4, 1.0 / 6.0, (1.0 - np.sinc(t / np.pi)) / np.where(t < 1e-4, 1.0, t * t))
        turned = rotation.cross(phi, rho)
        p = x[..., :3] + rotation.rotate(x[..., 3:], rho + a * turned + b * rotation.cross(phi, turned))
        return np.concatenate([p, ROTATION.integrate(x[..., 3:], phi)], axis=-1)

    def difference_jacobian(self, x: Array, y: Array) -> Array:
        """See `Group`.

        With A the inverse right Jacobian of the rotation, rho = V^-1 p changes by A drho + (d(V^-1 p)/dphi) A dphi,
        d(V^-1 p)/dphi = 1/2 [p] + c (phi p' + p.phi - 2 p phi') + c'/t (phi (p.phi) - t^2 p) phi'.
        """
        phi, p = self._relative(x, y)
        A, (c, slope) = rotation.inverse_right_jacobian(phi), rotation.cotangent_series(phi)
        along, square = (p * phi).sum(-1)[..., None], (phi * phi).sum(-1)[..., None]
        c, slope = c[..., None], slope[..., None]
        by_phi = 0.5 * rotation.skew(p) + (c * phi)[..., :, None] * p[..., None, :]
        by_phi += (slope * (along * phi - square * p) - 2.0 * c * p)[..., :, None] * phi[..., None, :]
        by_phi += (c * along)[..., None] * np.eye(3)
        jacobian = np.zeros((*phi.shape[:-1], 6, 6))
        jacobian[..., :3, :3] = jacobian[..., 3:, 3:] = A
        jacobian[..., :3, 3:] = by_phi @ A
        return jacobian

    def tangent_basis(self, x: Array) -> Array:
        """See `Group`."""
        basis = np.zeros((*x.shape, 6))
        basis[..., :3, :3] = np.stack([rotation.rotate(x[..., 3:], axis) for axis in np.eye(3)], axis=-1)
        basis[..., 3:, 3:] = ROTATION.tangent_basis(x[..., 3:])
        return basis

    def curvature(self, x: Array, g: Array) -> Array:
        """See `Group`: p + R (rho + phi x rho / 2) to second order."""
        H = np.zeros((*np.broadcast_shapes(x.shape, g.shape)[:-1], 6, 6))
        H[..., :3, 3:] = 0.5 * rotation.skew(rotation.rotate(rotation.conjugate(x[..., 3:]), g[..., :3]))
        H[..., 3:, :3] = H[..., :3, 3:].swapaxes(-1, -2)
        H[..., 3:, 3:] = ROTATION.curvature(x[..., 3:], g[..., 3:])
        return H

    def _relative(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Rotation vector and position of x^-1 y."""
        p = rotation.rotate(rotation.conjugate(x[..., 3:]), y[..., :3] - x[..., :3])
        phi = ROTATION.difference(x[..., 3:], y[..., 3:])
        return phi, p


class Turn(Group):
    """Rotations in the plane: cosine and sine."""

    nx, ndx, unit = 2, 1, slice(0, 2)

    def difference(self, x: Array, y: Array) -> Array:
        """See `Group`."""
        cosine, sine = x[..., :1], x[..., 1:]
        return np.arctan2(cosine * y[..., 1:] - sine * y[..., :1], cosine * y[..., :1] + sine * y[..., 1:])

    def integrate(self, x: Array, xi: Array) -> Array:
        """See `Group`."""
        turned = _turned(x, np.concatenate([np.cos(xi), np.sin(xi)], axis=-1))
        return turned / np.linalg.norm(turned, axis=-1, keepdims=True)

    def difference_jacobian(self, x: Array, y: Array) -> Array:
        """See `Group`."""
        return np.ones((*np.broadcast_shapes(x.shape, y.shape)[:-1], 1, 1))

    def tangent_basis(self, x: Array) -> Array:
        """See `Group`."""
        return np.stack([-x[..., 1:], x[..., :1]], axis=-2)

    def curvature(self, x: Array, g: Array) -> Array:
        """See `Group`."""
        return -np.vecdot(g, x)[..., None, None]


class Slide(Group):
    """Rigid motions of the plane: a position, and cosine and sine."""

    nx, ndx, unit = 4, 3, slice(2, 4)

    def difference(self, x: Array, y: Array) -> Array:
        """See `Group`."""
        phi, p = self._relative(x, y)
        return np.concatenate([p - 0.5 * phi * _left(p) - self._c(phi) * phi * phi * p, phi], axis=-1)

    def integrate(self, x: Array, xi: Array) -> Array:
        """See `Group`."""
        rho, phi = xi[..., :2], xi[..., 2:]
        whole, half = np.sinc(phi / np.pi), 0.5 * phi * np.sinc(0.5 * phi / np.pi) ** 2
        p = x[..., :2] + _turned(x[..., 2:], whole * rho + half * _left(rho))
        return np.concatenate([p, TURN.integrate(x[..., 2:], phi)], axis=-1)

    def difference_jacobian(self, x: Array, y: Array) -> Array:
        """See `Group`: rho = V^-1 p, V^-1 = (1 - c phi^2) - phi/2 J with J the quarter turn; p moves along R(phi)."""
        phi, p = self._relative(x, y)
        c, slope = (each[..., None] for each in rotation.cotangent_series(phi))
        jacobian = np.zeros((*phi.shape[:-1], 3, 3))
        direction = np.concatenate([np.cos(phi), np.sin(phi)], axis=-1)
        for j, axis in enumerate((direction, _left(direction))):
            jacobian[..., :2, j] = axis - 0.5 * phi * _left(axis) - c * phi * phi * axis
        jacobian[..., :2, 2] = -0.5 * _left(p) - phi * (2.0 * c + slope * phi * phi) * p
        jacobian[..., 2, 2] = 1.0
        return jacobian

    def tangent_basis(self, x: Array) -> Array:
        """See `Group`."""
        basis, direction = np.zeros((*x.shape, 3)), x[..., 2:]
        basis[..., :2, 0], basis[..., :2, 1] = direction, _left(direction)
        basis[..., 2:, 2] = _left(direction)
        return basis

    def curvature(self, x: Array, g: Array) -> Array:
        """See `Group`: p + R (rho + phi J rho / 2) to second order, J the quarter turn."""
        H = np.zeros((*np.broadcast_shapes(x.shape, g.shape)[:-1], 3, 3))
        back = x[..., 2:] * np.array([1.0, -1.0])
        H[..., :2, 2] = H[..., 2, :2] = -0.5 * _left(_turned(back, g[..., :2]))
        H[..., 2:, 2:] = TURN.curvature(x[..., 2:], g[..., 2:])
        return H

    def _relative(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Angle and position of x^-1 y."""
        back = x[..., 2:] * np.array([1.0, -1.0])
        return TURN.difference(x[..., 2:], y[..., 2:]), _turned(back, y[..., :2] - x[..., :2])

    def _c(self, phi: Array) -> Array:
        return rotation.cotangent_series(phi)[0][..., None]


def _left(p: Array) -> Array:
    """A quarter turn of vectors in the plane. Shape (..., 2)."""
    return np.stack([-p[..., 1], p[..., 0]], axis=-1)


def _turned(direction: Array, p: Array) -> Array:
    """Vectors in the plane turned by the angle of (cos, sin). Shape (..., 2)."""
    return direction[..., :1] * p + direction[..., 1:] * _left(p)


ROTATION, MOTION, TURN, SLIDE = Rotation(), Motion(), Turn(), Slide()
