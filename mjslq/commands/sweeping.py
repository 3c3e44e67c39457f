"""`mjslq sweep`: a problem over ranges of its parameters and perturbed starts, side by side, on any executor."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from mjslq.commands.common import announce, default_method, read_value, refuse_model

Ranges = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-s",
        metavar="NAME=VALUES",
        help="Values of a parameter (3 or 1,2,5 or first:last:step), or an option.",
    ),
]


def sweep(
    problem: Annotated[str, typer.Argument(help="A problem of `mjslq list`.")],
    settings: Ranges = None,
    seeds: Annotated[int, typer.Option(help="Perturbed starts for each combination; 0: as it is.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder for results, table and plot; a run that was killed goes on from there.")
    ] = None,
    method: Annotated[str | None, typer.Option("--method", "-m", help="How to solve.")] = None,
    executor: Annotated[str, typer.Option(help="processes, threads, dask or ray.")] = "processes",
    workers: Annotated[int | None, typer.Option(help="How many solve side by side; one per core unless given.")] = None,
    address: Annotated[str | None, typer.Option(help="Of a running Dask or Ray cluster.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")] = False,
) -> None:
    """Solve a problem for all combinations of parameters, from perturbed starts: a table, a plot, every result."""
    announce(quiet)
    from mjslq import problems
    from mjslq.batch import solve_many
    from mjslq.executors import open_executor
    from mjslq.method_table import ALIASES, METHODS, option_names
    from mjslq.reports import sweep as sweeping
    from mjslq.reports.tables import console
    from mjslq.validation import choose, count

    refuse_model(problem)
    choose("problem", problem, problems.names())
    count("seeds", seeds, at_least=0)
    if workers is not None:
        count("workers", workers)
    method = choose("method", method or default_method(), [*METHODS, *ALIASES])
    parameters, options = _ranges(settings or [], problem, option_names(method))
    grid = sweeping.points(parameters)
    total = len(grid) * max(seeds, 1)
    with open_executor(executor, workers, address) as opened:
        own: dict[str, Any] = {"workers": workers} if opened is None else {}
        stated = _Sized(sweeping.stated(problem, grid, seeds), total)
        found = solve_many(stated, opened, method=method, out=out, progress=not quiet, **own, **options)
        sweeping.gather(grid, found, seeds)
    title = f"{problem}: {total} problems"
    console(100).print(sweeping.summary(grid, title))
    if out is not None:
        sweeping.write_csv(grid, out / "sweep.csv")
        sweeping.plot(grid, out / "sweep.png", title)
        print(f"results, sweep.csv and sweep.png: {out}", file=sys.stderr)
    raise typer.Exit(0 if all(solved.success for point in grid for solved in point.solved) else 1)


class _Sized:
    """Problems that are made as they are asked for, and whose number is known, for the progress bar."""

    def __init__(self, made: Any, number: int) -> None:
        self._made, self._number = made, number

    def __iter__(self) -> Any:
        return iter(self._made)

    def __len__(self) -> int:
        return self._number


def _ranges(settings: list[str], problem: str, own: list[str]) -> tuple[dict[str, list[Any]], dict[str, Any]]:
    """Values of the problem's parameters, and options of the method named in `own`."""
    from mjslq import problems
    from mjslq.reports.sweep import values
    from mjslq.validation import choose

    known = problems.parameters(problem)
    parameters: dict[str, list[Any]] = {}
    options: dict[str, Any] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise ValueError(f"--set takes NAME=VALUES, such as {next(iter(known))}=1:50:5, got {setting!r}")
        if choose(f"setting of {problem} or the method", name, [*known, *own]) in known:
            parameters[name] = values(name, text, read_value)
        else:
            options[name] = read_value(text)
    return parameters, options
