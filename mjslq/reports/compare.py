"""`mjslq compare`: every method on one problem, from the same start, in one table and one plot."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjslq.files import atomic_write
from mjslq.optimize import ALIASES, METHODS, solve
from mjslq.problem import Problem
from mjslq.reports import convergence
from mjslq.result import Result
from mjslq.validation import choose

FORMATS = (".png", ".svg", ".pdf")


@dataclass(frozen=True)
class Entry:
    """What a method made of the problem."""

    method: str
    result: Result

    @property
    def evaluations(self) -> int:
        """Rollouts in all, the start's own included."""
        return 1 + sum(entry.evaluations for entry in self.result.log)


def compare(problem: Problem, methods: Sequence[str] = (), **options: Any) -> Iterator[Entry]:
    """Solve `problem` by each of `methods` (all unless given), one after the other.

    `options` are those that all methods know: tol, max_iterations, ...
    """
    for method in [choose("method", ALIASES.get(method, method), METHODS) for method in methods or METHODS]:
        solve(problem, method, **(options | {"max_iterations": 1}))  # so that no method pays for another's compiling
        yield Entry(method, solve(problem, method, **options))


def plot(entries: Sequence[Entry], path: str | os.PathLike[str], title: str = "") -> None:
    """Draw relative costs, J over the best J found less one, against iterations and against time.

    Raises ValueError when the name ends in none of `FORMATS`, or the file cannot be written.
    """
    choose("ending of a picture", Path(path).suffix, FORMATS)
    from matplotlib.figure import Figure

    curves = [entry for entry in entries if entry.result.log]
    if not curves:
        raise ValueError("there is nothing to plot: no method came past its start")
    relative = convergence.relative_costs([entry.result.log for entry in curves])
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for entry, shown in zip(curves, relative, strict=True):
        log = entry.result.log
        end = "" if entry.result.success else f" ({entry.result.status.value})"
        for axis, abscissa in zip(axes, (convergence.iterations(log), convergence.seconds(log)), strict=True):
            axis.semilogy(abscissa, shown, marker=".", label=entry.method + end)
    for axis, label in zip(axes, ("iteration", "time [s]"), strict=True):
        axis.set_xlabel(label)
        axis.grid(True, which="major", alpha=0.3)
    axes[1].set_xscale("log")  # the slowest method would squeeze the others against the axis
    axes[0].set_ylabel(r"$(J - J_\mathrm{best})\, /\, |J_\mathrm{best}|$")
    axes[0].legend(frameon=False)
    figure.suptitle(title)
    with atomic_write(path) as stream:
        figure.savefig(stream, format=Path(path).suffix[1:], dpi=150)
