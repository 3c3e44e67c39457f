"""Constraints in force: which, where, and their multipliers; for summaries, plots and pages.

A constraint is in force at the knots where a multiplier of it is not zero: the cost would be less without it there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjslq.result import Result
from mjslq.validation import Array

MOST_SPANS = 4
"""Runs of knots that a line of text names; beyond it there is the total."""


@dataclass(frozen=True)
class InForce:
    """A constraint in force."""

    name: str
    """The constraint's name."""
    knots: tuple[int, ...]
    """Where it is in force, ascending."""
    largest: float
    """The multiplier of largest size: positive at an upper limit. [unit of the cost / unit of the constraint]"""

    def __str__(self) -> str:
        runs = np.split(np.array(self.knots), np.flatnonzero(np.diff(self.knots) > 1) + 1)
        spans = [str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs]
        where = ", ".join(spans)
        if len(spans) > MOST_SPANS:
            where = f"{len(self.knots)} knots from {self.knots[0]} to {self.knots[-1]}"
        elif len(self.knots) == 1:
            where = f"knot {where}"
        else:
            where = f"knots {where}"
        return f"{self.name} at {where} (multiplier {self.largest:.3g})"


def in_force(result: Result) -> list[InForce]:
    """The constraints in force, in the order of the problem; limits of the controls are not among them."""
    found = []
    for name, values in multipliers(result).items():
        knots = np.flatnonzero(values)
        if knots.size:
            largest = float(values[np.abs(values).argmax()])
            found.append(InForce(name, tuple(int(n) for n in knots), largest))
    return found


def multipliers(result: Result) -> dict[str, Array]:
    """The multiplier of largest size at each knot, by the constraint's name; zero where none acts. Shape (N + 1,)."""
    found = {}
    for name, knots in result.knots.items():
        values = result.multipliers.get(name)
        if values is not None and values.size:
            everywhere = np.zeros(result.trajectory.horizon + 1)
            everywhere[knots] = np.take_along_axis(values, np.abs(values).argmax(axis=1)[:, None], axis=1)[:, 0]
            found[name] = everywhere
    return found


def touching(result: Result) -> dict[str, NDArray[np.bool_]]:
    """Whether a constraint is in force at each knot, by its name. Shape (N + 1,)."""
    return {name: values != 0.0 for name, values in multipliers(result).items()}


def describe(result: Result) -> str:
    """One line on the constraints in force, and the largest violation; empty where there are no constraints."""
    if not result.violations:
        return ""
    found = "; ".join(str(entry) for entry in in_force(result))
    return f"{found or 'none in force'}; largest violation {result.constraint_violation:.1e}"
