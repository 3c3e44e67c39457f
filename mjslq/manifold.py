"""State spaces: plain vectors, and states whose positions hold rotations or rigid motions.

Notation
--------
    x, y    states (..., nx): plain numbers, and elements of the groups of `lie_groups`
    dx      tangent direction (..., ndx) that leads from x to y

    dx = difference(x, y)   y - x on plain numbers, log(x^-1 y) on groups
    y = integrate(x, dx)    x + dx on plain numbers, x exp(dx) on groups

MuJoCo's free joint is a plain position and a rotation, since its linear velocity is in the world's frame; Pinocchio's
is a rigid motion, since its linear velocity is in the body's frame. All functions take whole arrays of states.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjslq.lie_groups import Group
from mjslq.validation import Array

Indices = np.ndarray[Any, np.dtype[np.intp]]


@dataclass(frozen=True)
class Part:
    """All elements of one group in a state."""

    group: Group
    x: Indices
    """Entries of the state. Shape (number, group.nx)."""
    dx: Indices
    """Tangent directions. Shape (number, group.ndx)."""


@dataclass(frozen=True)
class StateSpace:
    """Where the elements of groups are in a state, and where its plain numbers."""

    nx: int
    ndx: int
    plain_x: Indices
    """Entries of x that are plain numbers."""
    plain_dx: Indices
    """Their tangent directions, in the same order."""
    parts: tuple[Part, ...] = ()
    """All other entries, by group; empty where states are plain vectors."""

    @classmethod
    def plain(cls, nx: int) -> StateSpace:
        """Plain vectors."""
        return cls(nx, nx, np.arange(nx), np.arange(nx))

    @classmethod
    def of(cls, nx: int, ndx: int, elements: Iterable[tuple[Group, Iterable[int], Iterable[int]]]) -> StateSpace:
        """State space with `elements` (group, entries of x, tangent directions); all other entries are plain numbers.

        The entries of an element are listed in the group's order, whatever the order is in which the state has them.
        """
        by_group: dict[Group, list[tuple[list[int], list[int]]]] = {}
        for group, x, dx in elements:
            by_group.setdefault(group, []).append((list(x), list(dx)))
        parts = tuple(
            Part(group, *(np.array(indices, dtype=np.intp) for indices in zip(*found, strict=True)))
            for group, found in by_group.items()
        )
        plain_x = np.setdiff1d(np.arange(nx), np.concatenate([np.zeros(0, int), *(part.x.ravel() for part in parts)]))
        plain_dx = np.setdiff1d(
            np.arange(ndx), np.concatenate([np.zeros(0, int), *(part.dx.ravel() for part in parts)])
        )
        return cls(nx, ndx, plain_x, plain_dx, parts)

    def difference(self, x: Array, y: Array) -> Array:
        """Tangent direction from `x` to `y`. Shapes (..., nx) -> (..., ndx)."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if not self.parts:
            return y - x
        dx = np.empty((*np.broadcast_shapes(x.shape, y.shape)[:-1], self.ndx))
        dx[..., self.plain_dx] = y[..., self.plain_x] - x[..., self.plain_x]
        for part in self.parts:
            dx[..., part.dx] = part.group.difference(x[..., part.x], y[..., part.x])
        return dx

    def integrate(self, x: Array, dx: Array) -> Array:
        """State reached from `x` along `dx`. Shapes (..., nx), (..., ndx) -> (..., nx)."""
        x, dx = np.asarray(x, dtype=np.float64), np.asarray(dx, dtype=np.float64)
        if not self.parts:
            return x + dx
        y = np.empty((*np.broadcast_shapes(x.shape[:-1], dx.shape[:-1]), self.nx))
        y[..., self.plain_x] = x[..., self.plain_x] + dx[..., self.plain_dx]
        for part in self.parts:
            y[..., part.x] = part.group.integrate(x[..., part.x], dx[..., part.dx])
        return y

    def difference_jacobian(self, x: Array, y: Array) -> Array | None:
        """Differentiate difference(x, y) by y, in tangent directions of y; None when it is the identity.

        Shape (..., ndx, ndx).
        """
        if not self.parts:
            return None
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        jacobian = np.zeros((*np.broadcast_shapes(x.shape, y.shape)[:-1], self.ndx, self.ndx))
        jacobian[..., self.plain_dx, self.plain_dx] = 1.0
        for part in self.parts:
            block = part.group.difference_jacobian(x[..., part.x], y[..., part.x])
            jacobian[..., part.dx[:, :, None], part.dx[:, None, :]] = block
        return jacobian

    def tangent_basis(self, x: Array) -> Array | None:
        """Differentiate integrate(x, dx) by dx at zero; None when it is the identity.

        Shapes (..., nx) -> (..., nx, ndx).
        """
        if not self.parts:
            return None
        x = np.asarray(x, dtype=np.float64)
        basis = np.zeros((*x.shape, self.ndx))
        basis[..., self.plain_x, self.plain_dx] = 1.0
        for part in self.parts:
            basis[..., part.x[:, :, None], part.dx[:, None, :]] = part.group.tangent_basis(x[..., part.x])
        return basis

    def curvature(self, x: Array, g: Array) -> Array | None:
        """Second derivatives of g'integrate(x, dx) by dx at zero; None when they are zero.

        Shapes (..., nx) -> (..., ndx, ndx).
        """
        if not self.parts:
            return None
        x, g = np.asarray(x, dtype=np.float64), np.asarray(g, dtype=np.float64)
        H = np.zeros((*np.broadcast_shapes(x.shape, g.shape)[:-1], self.ndx, self.ndx))
        for part in self.parts:
            H[..., part.dx[:, :, None], part.dx[:, None, :]] = part.group.curvature(x[..., part.x], g[..., part.x])
        return H

    def normalized(self, x: Array) -> Array:
        """`x` with quaternions (cosines and sines) of unit length; one of length zero raises ValueError. (..., nx)."""
        for part in self.parts:
            entries = part.x[:, part.group.unit]
            values = x[..., entries]
            length = np.linalg.norm(values, axis=-1, keepdims=True)
            if (length < 1e-9).any():
                first = entries[int(np.argwhere(length < 1e-9)[0][-2])]
                kind = "quaternion" if len(first) == 4 else "cosine and a sine"
                raise ValueError(
                    f"entries {first.min()} to {first.max()} of the state are a {kind} and must not be all zero"
                )
            x = x.copy()
            x[..., entries] = np.where(np.abs(length - 1.0) > 1e-12, values / length, values)
        return x
