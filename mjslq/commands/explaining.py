"""`mjslq explain`: why a solve ended as it did."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from mjslq.commands.common import is_task


def explain(
    file: Annotated[Path, typer.Argument(help="A result that `solve --save` wrote.")],
    problem: Annotated[
        str | None,
        typer.Option(
            help="Its problem or task file, for a check of the derivatives; problems of `mjslq list` are found."
        ),
    ] = None,
    check: Annotated[bool, typer.Option(help="Check the derivatives along the trajectory.")] = True,
) -> None:
    """Say why a solve ended as it did: cost, gradient, limits, contacts, progress, and what to try next."""
    from mjslq import problems
    from mjslq.reports.explain import explain as explained
    from mjslq.result import load
    from mjslq.validation import choose

    result, posed = load(file), None
    if check and problem is not None and is_task(problem):
        from mjslq.tasks import load_task

        posed = load_task(problem).problem
    elif (check and (problem or result.problem) in problems.names()) or problem is not None:
        name = choose("problem", problem or result.problem, problems.names())
        posed = problems.get(name, **result.parameters)
    elif check:
        print("no check of the derivatives: name the task file with --problem", file=sys.stderr)
    print(explained(result, posed))
