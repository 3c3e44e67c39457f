"""Sweeps: a problem of the catalogue over values of its parameters and perturbed starts, as table, plot and CSV.

height=1:50:5     first:last:step, the last value included where the steps meet it:  1, 6, ..., 46
height=1,2,10     these values
engine=mujoco     a single one
"""

from __future__ import annotations

import csv
import io
import itertools
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.table import Table

from mjslq import problems
from mjslq.batch import Solved
from mjslq.files import atomic_write
from mjslq.problem import Problem
from mjslq.reports import figures
from mjslq.reports.starts import Case, perturbed
from mjslq.reports.tables import table

MOST = 100_000
"""Values of a range, at most."""


@dataclass(frozen=True)
class Point:
    """Values of the parameters, and what came of the problems that have them."""

    values: dict[str, Any]
    """Of the parameters that were set."""
    solved: list[Solved] = field(default_factory=list)
    """One for each start."""

    def numbers(self, name: str) -> list[float]:
        """An attribute of the results of this point that have converged."""
        return [float(getattr(s.result, name)) for s in self.solved if s.success]

    @property
    def endings(self) -> str:
        """How the others ended."""
        found = Counter("error" if s.result is None else s.result.status.value for s in self.solved if not s.success)
        return ", ".join(f"{count} {ending}" for ending, count in found.items())


def values(name: str, text: str, read: Callable[[str], Any]) -> list[Any]:
    """The values that a setting names; see the head of this file. `read` makes a value of a text.

    Raises ValueError for ranges that are no numbers, have no step or no values.
    """
    if not text.strip():
        raise ValueError(f"{name} takes a value, values with commas or a range, such as 1:50:5, got nothing")
    parts = text.split(":")
    if len(parts) in (2, 3) and all(_is_number(part) for part in parts):
        first, last, *rest = (read(part) for part in parts)
        step = rest[0] if rest else 1
        if step == 0 or (last - first) / step < 0 or (last - first) / step > MOST:
            raise ValueError(f"{name}={text} has no values: first:last:step, such as 1:50:5")
        return [first + i * step for i in range(int(np.floor((last - first) / step + 1e-9)) + 1)]
    if len(parts) > 1 and any(_is_number(part) for part in parts):
        raise ValueError(f"{name} takes a range of numbers, first:last:step, such as 1:50:5, got {text!r}")
    if "," in text and not text.startswith(("[", "(")):
        return [read(part.strip()) for part in text.split(",")]
    return [read(text)]


def points(parameters: Mapping[str, Sequence[Any]]) -> list[Point]:
    """All combinations of the values."""
    return [Point(dict(zip(parameters, chosen, strict=True))) for chosen in itertools.product(*parameters.values())]


def stated(name: str, grid: Sequence[Point], seeds: int) -> Iterator[Problem]:
    """The problems of a sweep, point by point, seed by seed; as they are with no seeds."""
    for point in grid:
        problem = problems.get(name, **point.values)
        if not seeds:
            yield problem
        for seed in range(seeds):
            yield perturbed(problem, seed, Case(name))


def gather(grid: Sequence[Point], found: Iterator[Solved], seeds: int) -> None:
    """Add each outcome to the point of the grid that it belongs to."""
    for solved in found:
        grid[solved.index // max(seeds, 1)].solved.append(solved)


def summary(grid: Sequence[Point], title: str) -> Table:
    """Table of a sweep, with a row for each point."""
    swept = list(grid[0].values) if grid else []
    rows = table(*swept, "solved", "iterations", "seconds", "cost from", "to", "endings of the others", title=title)
    for point in grid:
        costs = point.numbers("cost")
        middles = [np.median(point.numbers(name)) if costs else np.nan for name in ("iterations", "seconds")]
        rows.add_row(
            *[_short(value) for value in point.values.values()], f"{len(costs)} of {len(point.solved)}",
            f"{middles[0]:.0f}", f"{middles[1]:.3f}", f"{min(costs, default=np.nan):.6g}",
            f"{max(costs, default=np.nan):.6g}", point.endings or "-",
        )  # fmt: skip
    return rows


def write_csv(grid: Sequence[Point], path: str | os.PathLike[str]) -> None:
    """Write a line for each problem: its parameters, ending, numbers and file."""
    names = ["status", "cost", "iterations", "gradient_norm", "constraint_violation", "seconds"]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["index", *(grid[0].values if grid else ()), *names, "file", "error"])
    for point in grid:
        for solved in sorted(point.solved, key=lambda solved: solved.index):
            result = solved.result
            numbers = [""] * 6 if result is None else [result.status.value, *(getattr(result, n) for n in names[1:])]
            file, error = solved.file.name if solved.file else "", solved.error.strip().rpartition("\n")[2]
            writer.writerow([solved.index, *point.values.values(), *numbers, file, error])
    with atomic_write(path) as stream:
        stream.write(text.getvalue().encode())


@figures.styled
def plot(grid: Sequence[Point], path: str | os.PathLike[str], title: str) -> None:
    """Cost and iterations of every converged solve, and the share that converged, over the first swept parameter."""
    name = next((n for n in (grid[0].values if grid else ()) if len({str(p.values[n]) for p in grid}) > 1), None)
    at = [p.values[name] if name is not None else i for i, p in enumerate(grid)]
    if not all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in at):
        at = [str(value) for value in at]
    figure, axes = figures.subplots(1, 3, (11.0, 3.6))
    for axis, quantity in zip(axes[0], ("cost", "iterations"), strict=False):
        found = [(place, number) for place, point in zip(at, grid, strict=True) for number in point.numbers(quantity)]
        axis.plot(*zip(*found, strict=True), ".", alpha=0.6) if found else None
        axis.set(xlabel=name or "problem", ylabel=quantity)
    shares = [np.mean([s.success for s in point.solved]) if point.solved else np.nan for point in grid]
    axes[0][2].plot(at, shares, ".")
    axes[0][2].set(xlabel=name or "problem", ylabel="share converged", ylim=(-0.05, 1.05))
    figure.suptitle(title)
    figures.save(figure, path)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
