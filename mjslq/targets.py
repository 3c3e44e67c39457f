"""Targets and limits that depend on time: functions t -> numbers, evaluated at the knots of a horizon at once.

Notation
--------
    t_n      time of knot n after the start of the horizon [s]
    t0       time at which the horizon begins: 0 where a problem is stated, the present time in `mjslq.MPC`
    f        the function; row n of a target is f(t0 + t_n)

A target given as an array with a row for each knot belongs to the knots: when the horizon moves (`Problem.at`), its
rows move along. A function belongs to the clock: it sees the time t0 + t_n, as the functions of `costs.Residual` do. It
is called once for each knot when a problem is made, and again when it is moved to another t0; never in between.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjslq.validation import Array, as_array

Timed = Callable[[float], ArrayLike]
"""A function of time [s] that gives numbers."""


class Signal(ABC):
    """A function of time that can be evaluated at many times in one call."""

    @abstractmethod
    def over(self, times: Array) -> Array:
        """Values at `times` (k,). Shape (k, m). [s]"""

    def __call__(self, t: float) -> Array:
        """The value at the time `t`. Shape (m,). [s]"""
        value: Array = self.over(np.array([float(t)]))[0]
        return value


@dataclass(frozen=True)
class Rows:
    """A function of time at the times of some knots."""

    name: str
    """What messages call the function: "target"."""
    function: Timed
    times: Array
    """Of the knots, after the start of the horizon. Shape (k,). [s]"""
    size: int
    """m."""
    unit: bool = False
    """Whether the rows are quaternions, to be scaled to unit length."""
    finite: bool = True
    """Whether infinite values are refused."""

    def __call__(self, t0: float = 0.0) -> Array:
        """Rows on a horizon that begins at `t0`. Shape (k, m). [s]

        Raises ValueError, which names the time, where the function raises an error of its own, gives another shape than
        () or (m,), NaN, or zeros for a quaternion. What a `Signal` raises is passed on.
        """
        times = self.times + t0
        if isinstance(self.function, Signal):
            rows = as_array(f"the values of {self.name}(t)", self.function.over(times), finite=False)
            if rows.shape != (len(times), self.size):
                raise ValueError(self._wrong_shape(times[0], rows.shape[1:]))
        else:
            rows = np.empty((len(times), self.size))
            for n, t in enumerate(times.tolist()):
                value = self._values(lambda t=t: self.function(t), t)  # type: ignore[misc]
                if value.shape not in ((), (self.size,)):
                    raise ValueError(self._wrong_shape(t, value.shape))
                rows[n] = value
        self._refuse_numbers(rows, times)
        return unit_quaternions(self.name, rows) if self.unit else rows

    def _values(self, call: Callable[[], Any], t: float) -> Array:
        try:
            value = call()
        except Exception as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"{self.name}(t) raised {type(error).__name__} at t = {t:g} s: {reason}") from error
        return as_array(f"the value of {self.name}(t) at t = {t:g} s", value, finite=False)

    def _wrong_shape(self, t: float, shape: tuple[int, ...]) -> str:
        return f"{self.name}(t) must give a number or shape ({self.size},), got shape {shape} at t = {t:g} s"

    def _refuse_numbers(self, rows: Array, times: Array) -> None:
        wrong = ~np.isfinite(rows) if self.finite else np.isnan(rows)
        if wrong.any():
            n, i = np.argwhere(wrong)[0]
            what = "finite" if self.finite else "numbers, -inf or inf"
            raise ValueError(f"{self.name}(t) must give {what}, got {rows[n, i]} in entry {i} at t = {times[n]:g} s")


def unit_quaternions(name: str, rows: Array) -> Array:
    """Quaternions (k, 4) scaled to unit length. Raises ValueError for zeros."""
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    if (length < 1e-9).any():
        raise ValueError(f"{name} of an orientation must be a quaternion, not zeros")
    return rows / length
