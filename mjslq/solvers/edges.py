"""Edges: places where a step of the dynamics jumps, as when a contact or a joint's limit is touched at speed.

    f(z) -> f_low on one side, f_high on the other,     z = (x_n, u_n),     |f_high - f_low| not small

A stiff contact gives its force at first touch, and MuJoCo's damping of contacts and limits adds a part in proportion
to the speed of approach: one step of the dynamics is not continuous there, and neither is the cost. The gradient says
nothing of an edge. What tells how to keep to the better side is its normal.

Notation
--------
    low, high    two trajectories that nothing but rounding tells apart, one on each side
    n            the first knot whose step parts them
    a            normal of the edge in z, out of the better side, |a| = 1. Shape (ndx + nu,)
    v            a way that crosses the edge
    s_i          how far to go along v from z + h e_i until the edge is met, by bisection;  a_i = -s_i / h,  a'v = 1

It takes about 40 (ndx + nu) single steps, and no knowledge of what the step is made of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mjslq.dynamics.dynamics import Dynamics
from mjslq.solvers.iterate import Iterate
from mjslq.validation import Array

LEAST_PART = 1e-9
"""Distance of two next states from which on they count as parted."""
JUMP = 1e4
"""Growth of the distance of two trajectories within one step that no derivative explains."""
H = 1e-6
"""Distance of the places where the edge is looked for."""
FAR, NEAR = 1e3, 10.0
"""How far to look for it along the first way and along the normal that comes of it, in units of `H`."""
FINE = 1e-4
"""Where the bisection ends, in units of `H`."""
ROUNDING = 1e-16
"""Least distance of two states that are told apart."""


class Edge(NamedTuple):
    """A place where a step jumps, near an iterate."""

    knot: int
    normal: Array
    """a. Shape (ndx + nu,)."""


def edge_between(low: Iterate, high: Iterate, way: Callable[[int], Array], known: Sequence[Edge]) -> Edge | None:
    """The edge between two trajectories, None where they are not parted by one or it cannot be found.

    `way` gives, for a knot, the direction (ndx + nu,) in which the trajectories lie apart; edges that are `known` at
    the same knot give other ways to cross.
    """
    dynamics = low.problem.dynamics
    n = _parting(dynamics, low, high)
    if n is None:
        return None
    x, u = low.trajectory.X[n], low.trajectory.U[n]
    f_low = dynamics.step(x, u, n)[0]
    f_high = dynamics.step(high.trajectory.X[n], high.trajectory.U[n], n)[0]
    apart = float(np.linalg.norm(dynamics.difference(f_low, f_high))) if np.isfinite(f_high).all() else np.inf

    def stays(change: Array) -> bool:
        f = dynamics.step(dynamics.integrate(x, change[: dynamics.ndx]), u + change[dynamics.ndx :], n)[0]
        return bool(np.isfinite(f).all() and np.linalg.norm(dynamics.difference(f_low, f)) < 0.5 * apart)

    for v in [edge.normal for edge in known if edge.knot == n] + [way(n)]:
        if (normal := _normal(stays, v)) is not None:
            return Edge(n, normal)
    return None


def _parting(dynamics: Dynamics, low: Iterate, high: Iterate) -> int | None:
    """n, the first knot whose step parts the trajectories."""
    apart = np.linalg.norm(dynamics.difference(low.trajectory.X, high.trajectory.X), axis=1)
    before, after = np.maximum(apart[:-1], ROUNDING), apart[1:]
    parted = np.flatnonzero(~(after <= LEAST_PART) & ~(after <= JUMP * before))
    return int(parted[0]) if parted.size else None


def _normal(stays: Callable[[Array], bool], v: Array) -> Array | None:
    """a, from a way that crosses the edge: once along it, and once along the normal so found."""
    for reach in (FAR, NEAR):
        length = float(np.linalg.norm(v))
        if not length > 0.0:
            return None
        v = np.array([_crossing(stays, v / length, i, reach) for i in range(len(v))])
        if reach == FAR:
            v = np.where(np.isfinite(v), v, 0.0)
    length = float(np.linalg.norm(v))
    return v / length if np.isfinite(length) and length > 0.0 else None


def _crossing(stays: Callable[[Array], bool], v: Array, i: int, reach: float) -> float:
    """a_i times 1 / a'v; NaN where the edge is not met."""
    low, high, start = -reach * H, reach * H, np.zeros(len(v))
    start[i] = H
    if not stays(start + low * v) or stays(start + high * v):
        return np.nan
    while high - low > FINE * H:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stays(start + middle * v) else (low, middle)
    return -0.5 * (low + high) / H
