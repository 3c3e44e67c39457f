"""Intervals: lower and upper limits of something with entries, at some of the knots of a horizon.

    lower_n <= r_n <= upper_n,  entry by entry; -inf and inf where there is no limit

A side is a number, one an entry, one a knot and entry, or a function of time (`mjslq.targets`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjslq.knots import Knots
from mjslq.targets import Rows, Timed
from mjslq.validation import Array, as_array


@dataclass(frozen=True)
class Interval:
    """What a user gives as limits."""

    lower: ArrayLike | Timed | None
    """None for no limit at all."""
    upper: ArrayLike | Timed | None
    size: int
    """Entries m."""
    knots: Knots
    """The k knots."""
    every: int
    """How many knots there are in all: rows of limits with one a knot."""
    names: Sequence[str]
    """Of the entries, for messages."""

    @property
    def moves(self) -> bool:
        """Whether a side is a function of time."""
        return callable(self.lower) or callable(self.upper)

    def __call__(self, t0: float = 0.0) -> tuple[Array, Array]:
        """Limits at each of the knots (k, m), on a horizon that begins at `t0` [s].

        Raises ValueError for wrong shapes, NaN, limits that leave nothing between them, and where no limit is finite.
        """
        low = self._side("lower", self.lower, -np.inf, t0)
        high = self._side("upper", self.upper, np.inf, t0)
        wrong = np.argwhere(~((low <= high) & (low < np.inf) & (high > -np.inf)))
        if wrong.size:
            n, i = wrong[0]
            raise ValueError(
                f"lower must not lie above upper, nothing would be left between them: got {low[n, i]:g} and "
                f"{high[n, i]:g} for {self.names[i]!r} at knot {self.knots.indices[n]}"
            )
        if not self.moves and not (np.isfinite(low) | np.isfinite(high)).any():
            raise ValueError("there is no finite limit; give lower, upper or both")
        return low, high

    def _side(self, name: str, given: ArrayLike | Timed | None, none: float, t0: float) -> Array:
        knots, size, every = self.knots, self.size, self.every
        if callable(given):
            return Rows(name, given, knots.times, size, finite=False)(t0)
        limit = as_array(name, none if given is None else given, finite=False)
        listed = limit.ndim == 2 and len(limit) == len(knots)
        rows = len(knots) if listed else every
        if limit.shape not in ((), (size,), (rows, size)):
            raise ValueError(
                f"{name} must be a number, one an entry ({size},) or one a knot and entry ({every}, {size}), "
                f"got shape {limit.shape}"
            )
        if np.isnan(limit).any():
            raise ValueError(f"{name} must not be NaN; write {none} where there is no limit")
        spread = np.broadcast_to(limit, (rows, size))
        return np.array(spread if rows == len(knots) else spread[knots.at], order="C")
