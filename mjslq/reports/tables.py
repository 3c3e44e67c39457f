"""What the command line says about a result: a summary for people, numbers for machines."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from mjslq.problem import Problem
from mjslq.result import Result

if TYPE_CHECKING:
    from mjslq.reports.bench import Row


def print_summary(result: Result, problem: Problem) -> None:
    """Print what came out, in a few aligned lines."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()
    color = "green" if result.success else "yellow"
    table.add_row(result.problem, Text(result.status.value, style=f"bold {color}"))
    if not result.success:
        table.add_row("", result.message)
    table.add_row("cost", f"{result.cost:.10g}")
    table.add_row("iterations", f"{result.iterations} in {result.seconds:.2f} s")
    table.add_row("|gradient|", f"{result.gradient_norm:.2e}")
    if problem.describe is not None and not result.trajectory.diverged:
        for name, text in problem.describe(result.trajectory).items():
            table.add_row(name, text)
    Console(highlight=False).print(table)


def as_dict(result: Result) -> dict[str, Any]:
    """The numbers of a result; arrays belong into the saved file."""
    names = (
        "problem",
        "method",
        "success",
        "message",
        "cost",
        "iterations",
        "gradient_norm",
        "constraint_violation",
        "seconds",
        "options",
    )
    final = result.trajectory.X[-1].tolist()
    return {"status": result.status.value} | {name: getattr(result, name) for name in names} | {"final_state": final}


def benchmark(rows: list[Row], growth: dict[str, dict[int, float]]) -> None:
    """Print what was measured: a table of the phases, one of the ratios, and how things grow."""
    console = Console(width=max(132, Console().width), highlight=False)
    phases = Table(
        "case", "N", "nx", "nu", "rollout", "transition", "ours", "sweep", "iteration", "rollouts each",
        "mj_step", "mj_inverse", "mjd_transitionFD", title="milliseconds over the horizon", **_PLAIN,
    )  # fmt: skip
    ratios = Table(
        "case", "FD / ours", "iteration / (FD + step)", "iteration / (its steps + inverse)", "error of transition",
        "error of ours", title="ratios, and errors of A", **_PLAIN,
    )  # fmt: skip
    for row in rows:
        ours = min(row.linearize, key=lambda way: row.linearize[way])
        transition = f"{row.linearize['transition']:.2f}" if "transition" in row.linearize else "-"
        bare = [f"{row.bare[name]:.2f}" if row.bare else "-" for name in ("mj_step", "mj_inverse", "mjd_transitionFD")]
        phases.add_row(
            row.case, str(row.N), str(row.nx), str(row.nu), f"{row.rollout:.2f}", transition,
            f"{row.linearize[ours]:.2f}", f"{row.sweep:.2f}", f"{row.iteration:.2f}",
            f"{row.rollouts_per_iteration:.1f}", *bare,
        )  # fmt: skip
        if row.bare:
            numbers = (row.ratio_of_jacobians, row.ratio_to_bare, row.ratio_to_calls)
            errors = (row.errors["transition"], row.errors[ours])
            ratios.add_row(row.case, *[f"{number:.2f}" for number in numbers], *[f"{error:.0e}" for error in errors])
    console.print(phases, "", ratios)
    for name, found in growth.items():
        if found:
            console.print(f"\n{name}: " + ", ".join(f"{at}: {value:.3g}" for at, value in found.items()))


_PLAIN: dict[str, Any] = {"box": None, "pad_edge": False, "header_style": "bold", "title_justify": "left"}
