"""Knots at which a term acts: what `when=` of costs names.

Notation
--------
    n = 0 ... N     knots of a horizon of N steps; u_n acts over step n, so that knot N has no control
    h_n             length of step n [s]
    s_n             factor of a cost at knot n: h_n for "running" (an integral over time), 1 elsewhere (a value)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mjslq.validation import Array, choose

When = Literal["running", "terminal", "always", "initial"] | int | float | slice | Sequence[int] | Sequence[float]
"""Where a term acts.

"running"   knots 0 ... N-1, as an integral over time: the value at knot n times the length of step n
"terminal"  knot N: the value there
"always"    both of these
"initial"   knot 0: the value there
int         one knot, counted from the end if negative: the value there, times nothing
float       the knot at that time after the start [s], to 1e-9 of the horizon's duration
slice       the knots that it picks among 0 ... N
sequence    knots or times, ascending
"""
NAMES = ("running", "terminal", "always", "initial")
_CHOICES = "'running', 'terminal', 'always', 'initial', or knots: an index, a time [s], a slice, or a list of either"
TIME_TOLERANCE = 1e-9
"""How far a time may be from a knot, in parts of the horizon's duration."""


@dataclass(frozen=True, eq=False)
class Knots:
    """Some of the knots of a horizon, ascending."""

    indices: NDArray[np.int64]
    """Shape (k,)."""
    N: int
    """Steps of the horizon."""
    times: Array
    """Of the knots, after the start of the horizon. Shape (k,). [s]"""
    name: str | None = None
    """"running", "terminal", "always" or "initial"; None where the knots were listed."""
    by_time: bool = False
    """Whether they were listed by their times."""

    def __len__(self) -> int:
        return len(self.indices)

    @cached_property
    def at(self) -> slice | NDArray[np.int64]:
        """The knots, to index arrays of N + 1 rows: a slice, which makes views, where they follow each other."""
        return _compact(self.indices)

    @cached_property
    def steps(self) -> NDArray[np.int64]:
        """Those of the knots that have a control: all but knot N. Shape (k,) or (k - 1,)."""
        return self.indices[self.indices < self.N]

    @cached_property
    def at_steps(self) -> slice | NDArray[np.int64]:
        """`steps`, to index arrays of N rows."""
        return _compact(self.steps)

    @property
    def over_time(self) -> bool:
        """Whether values at knots with a step are integrals over it."""
        return self.name in ("running", "always")

    def scales(self, steps: Array) -> Array:
        """s_n, where the steps have these lengths (N,). Shape (k,)."""
        scales = np.ones(len(self))
        if self.over_time:
            scales[: len(self.steps)] = steps[self.steps]
        return scales

    def __str__(self) -> str:
        if self.name is not None:
            return self.name
        if len(self) > 4:
            return f"{len(self)} knots from {self.indices[0]} to {self.indices[-1]}"
        return ("knot " if len(self) == 1 else "knots ") + ", ".join(str(n) for n in self.indices)


def knots_of(when: When, steps: Array) -> Knots:
    """The knots that `when` names on a horizon of steps of these lengths (N,). [s]  Raises ValueError."""
    N, grid = len(steps), np.concatenate([[0.0], np.cumsum(steps)])
    named = {"running": np.arange(N), "terminal": np.array([N]), "always": np.arange(N + 1), "initial": np.array([0])}
    if isinstance(when, str):
        indices = named[choose("when", when, NAMES)].astype(np.int64)
        return Knots(indices, N, grid[indices], when)
    by_time = False
    if isinstance(when, slice):
        try:
            indices = np.arange(N + 1)[when]
        except (TypeError, ValueError) as error:
            raise ValueError(f"when must be {_CHOICES}, got {when!r}: {error}") from None
    else:
        indices = _listed(when, grid)
        by_time = np.asarray(when).dtype.kind == "f"
    if not len(indices):
        raise ValueError(f"when must pick at least one of the knots 0 to {N}, but {when!r} picks none")
    if (np.diff(indices) <= 0).any():
        raise ValueError(f"when must name knots in ascending order, each of them once, got {_few(indices)}")
    return Knots(indices.astype(np.int64), N, grid[indices], by_time=by_time)


def _listed(when: Any, grid: Array) -> NDArray[np.int64]:
    """Indices from one index or time, or from a sequence of them."""
    try:
        given = np.asarray(when)
    except ValueError:  # rows of unequal length
        given = np.asarray(None)
    if given.ndim > 1 or given.dtype.kind not in "iuf":
        raise ValueError(f"when must be {_CHOICES}, got {type(when).__name__} {when!r}")
    given, N = np.atleast_1d(given), len(grid) - 1
    if given.dtype.kind == "f":
        return _at_times(given, grid) if given.size else np.zeros(0, np.int64)
    for index in given:
        if not -(N + 1) <= index <= N:
            raise ValueError(f"when names knot {index}, but there are the knots 0 to {N} (or -{N + 1} to -1)")
    return np.where(given < 0, given + N + 1, given).astype(np.int64)


def _at_times(times: Array, grid: Array) -> NDArray[np.int64]:
    nearest = np.abs(np.nan_to_num(times, nan=0.0)[:, None] - grid).argmin(axis=1)
    off = ~(np.abs(times - grid[nearest]) <= TIME_TOLERANCE * grid[-1])
    if off.any():
        first = int(np.argmax(off))
        n = nearest[first]
        raise ValueError(
            f"when names the time {times[first]:.12g} s, at which there is no knot; the nearest is knot {n} "
            f"at {grid[n]:.12g} s"
        )
    return nearest.astype(np.int64)


def _compact(indices: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    if not len(indices):
        return slice(0, 0)
    first, last = int(indices[0]), int(indices[-1])
    return slice(first, last + 1) if last - first + 1 == len(indices) else indices


def _few(indices: NDArray[np.int64]) -> str:
    return ", ".join(str(n) for n in indices[:8]) + (", ..." if len(indices) > 8 else "")
