"""What the command line prints: summaries and tables for people, numbers for machines."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mjslq.problem import Problem
from mjslq.reports import errors, in_force
from mjslq.reports.limits import at_limits, describe
from mjslq.result import Result
from mjslq.unknowns import TIME

if TYPE_CHECKING:
    from mjslq.reports.bench import Row
    from mjslq.reports.starts import Row as StartsRow


def table(*titles: str, title: str | None = None, caption: str | None = None) -> Table:
    """Return an empty table in the style that all commands share."""
    look: dict[str, Any] = {"box": None, "pad_edge": False, "header_style": "bold", "title_justify": "left"}
    return Table(*titles, title=title, caption=caption, **look)


class StreamedTable:
    """A table whose rows appear as they come; columns are (title, share of the width)."""

    def __init__(self, *columns: tuple[str, int]) -> None:
        self._screen, self._shares = console(160), [share for _, share in columns]
        self._print([Text(title, style="bold") for title, _ in columns])

    def add_row(self, *cells: str) -> None:
        """Print a row; a cell that is too long goes on in its next line."""
        self._print([Text(cell) for cell in cells])
        self._screen.file.flush()

    def add_heading(self, text: str) -> None:
        """Print a line over the rows that follow."""
        self._screen.print()
        self._screen.print(Text(text, style="italic"))

    def _print(self, cells: list[Text]) -> None:
        grid = Table.grid(padding=(0, 2, 0, 0), expand=True)
        for share in self._shares:
            grid.add_column(ratio=share)
        grid.add_row(*cells)
        self._screen.print(grid)


def console(at_least: int = 0) -> Console:
    """Return a console on standard output that is `at_least` so many characters wide."""
    return Console(width=max(at_least, Console().width), highlight=False)


def print_summary(result: Result, problem: Problem) -> None:
    """Print what came out, in a few aligned lines."""
    lines = Table(box=None, show_header=False, pad_edge=False)
    lines.add_column(style="dim", no_wrap=True)
    lines.add_column()
    color = "green" if result.success else "yellow"
    lines.add_row(result.problem, Text(result.status.value, style=f"bold {color}"))
    if not result.success:
        lines.add_row("", result.message)
    lines.add_row("cost", f"{result.cost:.10g}")
    for name, value in result.unknowns.items():
        lines.add_row(name, f"{value:.8g}" + (" s" if name == TIME else ""))
    lines.add_row("iterations", f"{result.iterations} in {result.seconds:.2f} s")
    if result.compile_seconds > 0.0:
        lines.add_row("compiling", f"{result.compile_seconds:.1f} s, the first time only")
    lines.add_row("|gradient|", f"{result.gradient_norm:.2e}")
    if limits := describe(result):
        lines.add_row("limits", limits)
    if constraints := in_force.describe(result):
        lines.add_row("constraints", constraints)
    if touching := contacts(result):
        lines.add_row("contact", touching)
    for name, text in errors.lines(errors.task_errors(problem, result.trajectory)).items():
        lines.add_row(name, text)
    if problem.describe is not None and not result.trajectory.diverged:
        for name, text in problem.describe(result.trajectory).items():
            lines.add_row(name, text)
    console().print(lines)


def contacts(result: Result) -> str:
    """With which contact it was solved, and how deep bodies sank into each other; empty where nothing touches."""
    if result.contact is None or (result.contact.kind == "model" and not result.penetration):
        return ""
    return f"{result.contact}, largest penetration {1e3 * result.penetration:.1f} mm"


def as_dict(result: Result) -> dict[str, Any]:
    """The numbers of a result in JSON's types, None for what is not finite; arrays belong into the saved file."""
    names = (
        "problem", "method", "success", "message", "cost", "iterations", "gradient_norm", "constraint_violation",
        "seconds", "compile_seconds", "options", "parameters", "unknowns",
    )  # fmt: skip
    found = {"status": result.status.value} | {name: getattr(result, name) for name in names}
    if contacts(result):
        found["contact"], found["penetration"] = str(result.contact), result.penetration
    found["limits"] = [
        {"control": entry.name, "limit": entry.limit, "side": entry.side, "spans": entry.spans}
        for entry in at_limits(result)
    ]
    found["constraints"] = [
        {"name": entry.name, "knots": entry.knots, "multiplier": entry.largest} for entry in in_force.in_force(result)
    ]
    return _plain(found | {"final_state": result.trajectory.X[-1].tolist()})


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def benchmark(rows: list[Row], growth: dict[str, dict[int, float]]) -> None:
    """Print what was measured: a table of the phases, one of the ratios, and how things grow."""
    screen = console(150)
    phases = table(
        "case", "N", "nx", "nu", "rollout", "transition", "ours", "sweep", "iteration", "rollouts each",
        "mj_step", "mj_inverse", "mjd_transitionFD", title="milliseconds over the horizon",
    )  # fmt: skip
    ratios = table(
        "case", "FD / ours", "iteration / (FD + step)", "iteration / (its steps + inverse)", "error of transition",
        "error of ours", title="ratios, and errors of A",
    )  # fmt: skip
    for row in rows:
        ours = min(row.linearize, key=lambda way: row.linearize[way])
        transition = f"{row.linearize['transition']:.2f}" if "transition" in row.linearize else "-"
        bare = [f"{row.bare[name]:.2f}" if row.bare else "-" for name in ("mj_step", "mj_inverse", "mjd_transitionFD")]
        sweep = f"{row.sweep:.2f}" + (f" ({row.free_sweep:.2f} free)" if row.limited else "")
        phases.add_row(
            row.case, str(row.N), str(row.nx), str(row.nu), f"{row.rollout:.2f}", transition,
            f"{row.linearize[ours]:.2f}", sweep, f"{row.iteration:.2f}",
            f"{row.rollouts_per_iteration:.1f}", *bare,
        )  # fmt: skip
        if row.bare:
            numbers = (row.ratio_of_jacobians, row.ratio_to_bare, row.ratio_to_calls)
            errors = (row.errors["transition"], row.errors[ours])
            ratios.add_row(row.case, *[f"{number:.2f}" for number in numbers], *[f"{error:.0e}" for error in errors])
    screen.print(phases, "", ratios)
    for name, found in growth.items():
        if found:
            screen.print(f"\n{name}: " + ", ".join(f"{at}: {value:.3g}" for at, value in found.items()))


def many_starts(rows: list[StartsRow]) -> None:
    """Print from how many starts each case was solved, and how."""
    titles = ("case", "solved", "iterations", "at most", "seconds", "cost from", "to", "endings of the others")
    found = table(*titles, title="perturbed starts, default settings: medians")
    for row in rows:
        found.add_row(
            row.case, f"{row.solved} of {len(row.results)}", f"{np.median(row.iterations):.0f}",
            str(row.iterations.max()), f"{row.seconds:.2f}", f"{row.costs.min():.5g}", f"{row.costs.max():.5g}",
            row.failures or "-",
        )  # fmt: skip
    console(120).print(found)
