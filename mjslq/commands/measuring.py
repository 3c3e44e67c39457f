"""The commands `check`, `reproduce` and `bench`: derivative checks, the papers' numbers, timings."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mjslq.commands.common import MODELS, Json, announce, is_task, model_of, refuse_unwritable

if TYPE_CHECKING:
    from mjslq.dynamics.dynamics import Dynamics
    from mjslq.problem import Problem


def check(
    what: Annotated[
        str,
        typer.Argument(
            help="A model (.xml, .urdf, .mjb), a robot's name, menagerie:NAME, a task file (.toml) or a problem of "
            "`mjslq list`."
        ),
    ],
    steps: Annotated[int, typer.Option(help="Length of the motion along which derivatives are checked.")] = 20,
    seed: Annotated[int, typer.Option(help="Of the random controls that make the motion.")] = 0,
) -> None:
    """Report what serves each part of a model; compare its derivatives with a fine reference along a random motion."""
    announce(quiet=False)
    from mjslq.reports.tables import console, table
    from mjslq.validation import count

    count("steps", steps)
    count("seed", seed, at_least=0)
    dynamics, x0 = _dynamics_of(what)
    screen = console()
    parts = table("part", "served by")
    for part, served in dynamics.support_report():
        parts.add_row(part, served)
    screen.print(parts)
    if faults := dynamics.faults():
        raise ValueError("; ".join(faults))
    trajectory = _random_motion(dynamics, x0, steps, seed)
    found = dynamics.check_derivatives(trajectory)
    titles = ("Jacobian", "median error", "largest", "at step, row, column", "knots off")
    errors = table(*titles, caption="relative to the largest entry")
    for name, error in found.errors.items():
        usual, share = f"{found.typical[name]:.1e}", f"{found.share[name]:.0%}"
        errors.add_row(name, usual, f"{error:.1e}", str(found.worst[name]), share)
    screen.print()
    screen.print(errors)
    print(found.verdict)
    raise typer.Exit(1 if found.suspects else 0)


def reproduce(
    papers: Annotated[
        list[str] | None, typer.Argument(help="Methods whose paper to reproduce; all unless given.")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Draw the papers' figures, too, into this folder or files that begin so (PNG and SVG)."),
    ] = None,
) -> None:
    """Put the papers' numbers beside what comes out here, row by row."""
    announce(quiet=False)
    from mjslq.reports import reproduce
    from mjslq.reports.tables import StreamedTable
    from mjslq.validation import choose

    if plot is not None and not plot.is_dir():
        refuse_unwritable(plot)
    for paper in [choose("paper", paper, reproduce.PAPERS) for paper in papers or reproduce.PAPERS]:
        table, section = StreamedTable((paper, 5), ("paper", 5), ("here", 6), ("verdict", 7)), ""
        for row in reproduce.PAPERS[paper]():
            if row.section != section:
                section = row.section
                table.add_heading(section)
            table.add_row(row.what, row.paper, row.ours, row.verdict)
        for file in [] if plot is None else reproduce.draw(paper, plot):
            print(f"figure: {file}", file=sys.stderr, flush=True)


def bench(
    cases: Annotated[list[str] | None, typer.Argument(help="Cases to measure; all of them unless given.")] = None,
    starts: Annotated[
        int | None, typer.Option(help="Solve swing-ups and reaches from so many perturbed starts instead.")
    ] = None,
    robots: Annotated[
        bool,
        typer.Option("--robots", help="Solve the robots' tasks from perturbed starts: 20, or --starts."),
    ] = False,
    seed: Annotated[
        int, typer.Option(help="First of the seeds that perturb the starts; other seeds, other starts.")
    ] = 0,
    as_json: Json = False,
) -> None:
    """Time an iteration, phase by phase, and compare it with the engine's own calls."""
    announce(quiet=False)
    from mjslq.reports import bench, tables
    from mjslq.validation import choose, count

    count("seed", seed, at_least=0)
    if robots:
        _bench_robots(cases, 20 if starts is None else starts, seed, as_json)
        return
    if starts is not None:
        _bench_starts(cases, starts, seed, as_json)
        return
    if seed:
        raise ValueError("--seed perturbs starts: give it with --robots or --starts")
    rows = []
    for case in [choose("case", case, bench.CASES) for case in cases or bench.CASES]:
        print(f"measuring {case} ...", file=sys.stderr, flush=True)
        rows.append(bench.run(case))
    growth: dict[str, dict[int, float]] = {}
    for name, measure in {} if cases else bench.GROWTH.items():
        print(f"measuring {name} ...", file=sys.stderr, flush=True)
        growth[name] = measure()
    if as_json:
        print(json.dumps({"cases": [row.as_dict() for row in rows], "growth": growth}))
    else:
        tables.benchmark(rows, growth)


def _bench_robots(cases: list[str] | None, number: int, seed: int, as_json: bool) -> None:
    """Solve each robot's task from perturbed starts, by default settings."""
    from mjslq.reports import robots, tables
    from mjslq.validation import choose, count

    count("starts", number)
    rows = []
    for case in [choose("case", case, robots.CASES) for case in cases or robots.CASES]:
        print(f"solving {case} from {number} starts ...", file=sys.stderr, flush=True)
        rows.append(robots.measure(case, number, seed))
    if as_json:
        print(json.dumps({"robots": [row.as_dict() for row in rows]}))
    else:
        tables.console(150).print(robots.summary(rows))


def _bench_starts(cases: list[str] | None, number: int, seed: int, as_json: bool) -> None:
    """Solve each case from perturbed starts, by default settings."""
    from mjslq.reports import starts, tables
    from mjslq.validation import choose, count

    count("starts", number)
    rows = []
    for case in [choose("case", case, starts.CASES) for case in cases or starts.CASES]:
        print(f"solving {case} from {number} starts ...", file=sys.stderr, flush=True)
        rows.append(starts.measure(case, number, first=seed))
    if as_json:
        print(json.dumps({"starts": [row.as_dict() for row in rows]}))
    else:
        tables.many_starts(rows)


def _dynamics_of(what: str) -> tuple[Dynamics, Any]:
    """The engine, and a state to start from, of a model file or a problem's name."""
    from mjslq import problems

    if is_task(what):
        from mjslq.tasks import load_task

        return _solved(load_task(what).problem)
    if what in problems.names():
        return _solved(problems.get(what))
    if os.sep in what and Path(what).suffix.lower() not in MODELS:
        from mjslq.dynamics.mujoco import MujocoDynamics

        dynamics: MujocoDynamics | None = MujocoDynamics.from_path(what)  # which says what models are
    else:
        dynamics = model_of(what)
    if dynamics is not None:
        return dynamics, dynamics.initial_state
    raise ValueError(
        f"{what!r} is neither a model file (.xml, .urdf, .mjb), a task file (.toml), a robot's name nor a problem; "
        f"problems: {', '.join(problems.names())}"
    )


def _solved(problem: Problem) -> tuple[Dynamics, Any]:
    """The engine that methods work with, which has free time and parameters as states, and where it starts."""
    return problem.lifted.dynamics, problem.lifted.x0


def _random_motion(dynamics: Dynamics, x0: Any, steps: int, seed: int) -> Any:
    """A motion under small random controls; halved until it does not blow up."""
    import numpy as np

    from mjslq.dynamics.augmented import Augmented

    U = np.random.default_rng(seed).normal(size=(steps, dynamics.nu))
    for _ in range(20):
        if isinstance(dynamics, Augmented):
            U[:, dynamics.inner.nu :] = dynamics.nominal
        trajectory = dynamics.rollout(x0, U)
        if not trajectory.diverged:
            return trajectory
        U *= 0.5
    raise ValueError("the model blows up whatever the controls; shorten its timestep")
