"""Engines whose step lengths and parameters are set anew from call to call, and derivatives by these.

Notation
--------
    s                  stretch: step n takes s h_n, where h_n is the engine's own step length
    p                  parameters, by name
    f(x, u; s, p)      a step, y(x, u; s, p) the outputs

    derivatives        df/ds by the engine itself where it has a way (`Dynamics.by_stretch`); all others by
                       differences of the step of second order, of all knots at once: to both sides, or to one
                       where a value is next to a limit, beyond which a parameter may mean nothing
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.dynamics.dynamics import Dynamics

SHARE = 1e-5
"""Step of differences, relative to a value's size."""


class Variation(ABC):
    """An engine's copy, made for one problem: nobody else sees its step length and parameters change."""

    names: tuple[str, ...] = ()
    """The parameters that change."""
    nominal: Array
    """Their values in the engine as it was given. Shape (size,)."""

    @abstractmethod
    def at(self, stretch: float, values: Array) -> Dynamics:
        """The engine with its steps stretched and parameters set, valid until the next call. For one caller at a time.

        Raises ValueError where the engine cannot be set so.
        """


class Place(NamedTuple):
    """Values at which the step is taken, and the weights that make a derivative of the results."""

    offsets: tuple[float, ...]
    weights: tuple[float, ...]


def places(value: float, step: float, lower: float, upper: float) -> Place:
    """Where to take a first derivative, within the limits as far as these leave room."""
    if value - step >= lower and value + step <= upper:
        return Place((-step, step), (-0.5 / step, 0.5 / step))
    towards = step if value - step < lower else -step
    return Place((0.0, towards, 2.0 * towards), (-1.5 / towards, 2.0 / towards, -0.5 / towards))


def size_of(value: float, lower: float, upper: float) -> float:
    """What steps of differences are relative to: the value itself, or for a small one its range, 1 at most."""
    return max(abs(value), 1e-2 * min(upper - lower, 1.0), 1e-12)


def derivative(function: Callable[[float], Sequence[Array]], place: Place) -> list[Array]:
    """Weighted sums of what `function` returns at the offsets."""
    total: list[Any] = []
    for offset, weight in zip(*place, strict=True):
        parts = function(offset)
        total = [weight * part for part in parts] if not total else [
            whole + weight * part for whole, part in zip(total, parts, strict=True)
        ]  # fmt: skip
    return total
