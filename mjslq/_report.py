"""What the command line says about a result: a summary for people, numbers for machines."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from mjslq.problem import Problem
from mjslq.result import Result


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
