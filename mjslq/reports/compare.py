"""`mjslq compare`: every method on one problem, from the same start, in one table and one plot."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjslq.method_table import ALIASES, METHODS
from mjslq.optimize import solve
from mjslq.problem import Problem
from mjslq.reports import convergence, figures
from mjslq.result import Result
from mjslq.validation import choose


@dataclass(frozen=True)
class Entry:
    """Result of one method, and what it took."""

    method: str
    result: Result

    @property
    def evaluations(self) -> int:
        """Rollouts in all, the start's own included."""
        return 1 + sum(entry.evaluations for entry in self.result.log)


def compare(problem: Problem, methods: Sequence[str] = (), **options: Any) -> Iterator[Entry]:
    """Solve `problem` by each of `methods`, one after the other: all that are made for it unless given.

    `options` are those that all methods know: tol, max_iterations, ...
    """
    constrained = bool(problem.bound_constraints)
    equalities = any((constraint.lower == constraint.upper).any() for constraint in problem.bound_constraints)
    made_for_it = [
        name
        for name, entry in METHODS.items()
        if (entry.takes_constraints is constrained or entry.takes_both)
        and (entry.takes_equalities or not equalities)
        and (entry.takes_free_start or problem.free_start is None)
        and (entry.takes_unknowns or problem.unknowns is None)
    ]
    for method in [choose("method", ALIASES.get(method, method), METHODS) for method in methods or made_for_it]:
        solve(problem, method, **(options | {"max_iterations": 1}))  # so that no method pays for another's compiling
        yield Entry(method, solve(problem, method, **options))


@figures.styled
def plot(entries: Sequence[Entry], path: str | os.PathLike[str], title: str = "") -> None:
    """Draw relative costs, J over the best J found less one, against iterations and against time.

    Raises ValueError when the name ends in none of `figures.FORMATS`, or the file cannot be written.
    """
    choose("ending of a picture", Path(path).suffix, figures.FORMATS)
    curves = [entry for entry in entries if entry.result.log]
    if not curves:
        raise ValueError("there is nothing to plot: no method came past its start")
    relative = convergence.relative_costs([entry.result.log for entry in curves])
    figure, axes = figures.subplots(1, 2, (10.0, 4.2), sharey=True)
    by_iteration, by_time = axes[0]
    for entry, shown in zip(curves, relative, strict=True):
        log = entry.result.log
        end = "" if entry.result.success else f" ({entry.result.status.value})"
        marker = "." if len(log) < 60 else ""
        by_iteration.semilogy(convergence.iterations(log), shown, marker=marker, label=entry.method + end)
        by_time.semilogy(convergence.seconds(log), shown, marker=marker)
    by_iteration.set(xlabel="iteration", ylabel=r"$(J - J_\mathrm{best})\, /\, |J_\mathrm{best}|$")
    by_iteration.legend()
    by_time.set(xlabel="time [s]", xscale="log")  # the slowest method would squeeze the others against the axis
    figure.suptitle(title)
    figures.save(figure, path)
