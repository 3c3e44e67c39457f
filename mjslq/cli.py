"""The command line: `mjslq list | solve | view | export | check | compare | reproduce | bench`.

Exit status: 0 converged (or the command did what it was asked), 1 not converged or ended by an error, 2 wrong input,
3 diverged, 130 interrupted. What a command says about its progress goes to standard error; standard output holds
the result, so that `--json` can be piped.
"""

from __future__ import annotations

import ast
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from mjslq.dynamics.dynamics import Dynamics

app = typer.Typer(
    help="Trajectory optimization for MuJoCo models.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit status: 0 converged, 1 not converged or failed, 2 wrong input, 3 diverged, 130 interrupted.",
)

_EXIT = {"converged": 0, "diverged": 3, "interrupted": 130}
WRONG_INPUT = 2

_USAGE_ERROR: type[Exception] = typer.BadParameter.__mro__[1]
"""What the parser raises for options and arguments that it does not know; Typer has no public name for it."""

Port = Annotated[int, typer.Option(help="Port of the viewer; the next free one is taken if it is busy.")]
Host = Annotated[str, typer.Option(help="Address that the viewer listens on.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", "-s", metavar="NAME=VALUE", help="Set a parameter of the problem, or an option."),
]
View = Annotated[bool, typer.Option("--view", help="Show the result in a browser.")]
Json = Annotated[bool, typer.Option("--json", help="Print the numbers as one JSON object.")]


def main() -> None:
    """Run the command line; every wrong input ends in one sentence and status 2."""
    try:
        sys.exit(app(sys.argv[1:] or ["--help"], standalone_mode=False))
    except _USAGE_ERROR as error:
        _refuse(" ".join(error.format_message().split()))  # type: ignore[attr-defined]
    except (KeyboardInterrupt, typer.Abort):
        print("mjslq: interrupted", file=sys.stderr)
        sys.exit(_EXIT["interrupted"])
    except BrokenPipeError:  # the reader of a pipe has gone; that is its right
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (ValueError, OSError, ImportError) as error:
        _refuse(" ".join(str(error).split()))


def _refuse(sentence: str) -> NoReturn:
    print(f"mjslq: {sentence}", file=sys.stderr)
    sys.exit(WRONG_INPUT)


@app.command("list")
def list_problems() -> None:
    """Show the problems that come with mjslq, and what can be set in each."""
    from mjslq import problems
    from mjslq.reports.tables import console, table

    rows = table("problem", "what it is", "--set")
    for name in problems.names():
        defaults = " ".join(f"{key}={value}" for key, value in problems.parameters(name).items())
        rows.add_row(name, problems.summary(name), defaults)
    console().print(rows)


@app.command()
def solve(
    problem: Annotated[str, typer.Argument(help="A problem of `mjslq list`.")],
    method: Annotated[str | None, typer.Option("--method", "-m", help="How to solve it.")] = None,
    preset: Annotated[
        str | None, typer.Option(help="A paper's version of the method, nothing added: sideris-bobrow for slq.")
    ] = None,
    settings: Settings = None,
    save: Annotated[Path | None, typer.Option(help="Write the result to this .npz file.")] = None,
    view: View = False,
    host: Host = "127.0.0.1",
    port: Port = 8080,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
    as_json: Json = False,
) -> None:
    """Solve a problem: a line an iteration while it works, a summary after."""
    if save is not None:
        _refuse_unwritable(save)
    _announce(quiet)
    from mjslq import problems
    from mjslq.optimize import ALIASES, METHODS, settable
    from mjslq.optimize import solve as run
    from mjslq.reports.tables import as_dict, print_summary
    from mjslq.validation import choose

    _refuse_model(problem)
    choose("problem", problem, problems.names())
    method = choose("method", method or _default_method(), [*METHODS, *ALIASES])
    parameters, options = _sort_settings(settings or [], problem, settable(method))
    stated = problems.get(problem, **parameters)
    result = run(stated, method, preset=preset, verbose=0 if quiet else 1, stream=sys.stderr, **options)
    if as_json:
        print(json.dumps(as_dict(result), allow_nan=False))
    elif not quiet:
        print_summary(result, stated)
    if quiet and result.error:
        print(f"mjslq: {result.message}", file=sys.stderr)
    if save is not None:
        result.save(save)
        if not quiet:
            print(f"saved to {save}", file=sys.stderr)
    if view:
        from mjslq.viewer import view as show

        show(result, host, port)
    raise typer.Exit(_EXIT.get(result.status.value, 1))


@app.command()
def view(
    file: Annotated[Path, typer.Argument(help="A result that `solve --save` wrote.")],
    host: Host = "127.0.0.1",
    port: Port = 8080,
) -> None:
    """Show a saved result in a browser."""
    from mjslq.result import load
    from mjslq.viewer import view as show

    show(load(file), host, port)


@app.command()
def export(
    file: Annotated[Path, typer.Argument(help="A result that `solve --save` wrote.")],
    page: Annotated[Path, typer.Argument(help="The HTML file to write.")],
) -> None:
    """Write a saved result as one HTML file that plays in any browser, without a network."""
    from mjslq.result import load
    from mjslq.viewer import export_html

    export_html(load(file), page)
    print(f"{page}: {page.stat().st_size / 1e6:.1f} MB", file=sys.stderr)


@app.command()
def check(
    what: Annotated[str, typer.Argument(help="A model (.xml, .urdf, .mjb) or a problem of `mjslq list`.")],
    steps: Annotated[int, typer.Option(help="Length of the motion along which derivatives are checked.")] = 20,
    seed: Annotated[int, typer.Option(help="Of the random controls that make the motion.")] = 0,
) -> None:
    """Say what serves a model, and compare its derivatives with a fine reference along a random motion."""
    _announce(quiet=False)
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


@app.command()
def compare(
    problem: Annotated[str, typer.Argument(help="A problem of `mjslq list`.")],
    methods: Annotated[
        list[str] | None, typer.Option("--method", "-m", help="Compare these; all unless given.")
    ] = None,
    settings: Settings = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the costs into this .png, .svg or .pdf file.")] = None,
    view: View = False,
    host: Host = "127.0.0.1",
    port: Port = 8080,
) -> None:
    """Solve a problem by every method from the same start: one table, one plot."""
    _announce(quiet=False)
    from mjslq import problems
    from mjslq.options import COMMON
    from mjslq.reports import compare as comparing
    from mjslq.reports import figures
    from mjslq.reports.tables import console, table
    from mjslq.validation import choose

    _refuse_model(problem)
    choose("problem", problem, problems.names())
    if plot is not None:
        choose("ending of a picture", plot.suffix, figures.FORMATS)
        _refuse_unwritable(plot)
    parameters, options = _sort_settings(settings or [], problem, list(COMMON))
    stated = problems.get(problem, **parameters)
    titles = ("method", "status", "iterations", "rollouts", "seconds", "cost", "|gradient|")
    rows = table(*titles)
    entries = []
    for entry in comparing.compare(stated, methods or (), **options):
        result = entry.result
        print(f"{entry.method}: {result.status.value}", file=sys.stderr, flush=True)
        numbers = (str(result.iterations), str(entry.evaluations), f"{result.seconds:.2f}")
        rows.add_row(entry.method, result.status.value, *numbers, f"{result.cost:.10g}", f"{result.gradient_norm:.1e}")
        entries.append(entry)
    console(110).print(rows)
    if plot is not None:
        comparing.plot(entries, plot, problem)
    if view:
        from mjslq.viewer import view as show

        best, *others = sorted((entry.result for entry in entries), key=lambda result: result.cost)
        show(best, host, port, beside=others)


@app.command()
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
    _announce(quiet=False)
    from mjslq.reports import reproduce
    from mjslq.reports.tables import StreamedTable
    from mjslq.validation import choose

    if plot is not None and not plot.is_dir():
        _refuse_unwritable(plot)
    for paper in [choose("paper", paper, reproduce.PAPERS) for paper in papers or reproduce.PAPERS]:
        table, section = StreamedTable((paper, 5), ("paper", 5), ("here", 6), ("verdict", 7)), ""
        for row in reproduce.PAPERS[paper]():
            if row.section != section:
                section = row.section
                table.add_heading(section)
            table.add_row(row.what, row.paper, row.ours, row.verdict)
        for file in [] if plot is None else reproduce.draw(paper, plot):
            print(f"figure: {file}", file=sys.stderr, flush=True)


@app.command()
def bench(
    cases: Annotated[list[str] | None, typer.Argument(help="Cases to measure; all of them unless given.")] = None,
    starts: Annotated[
        int | None, typer.Option(help="Solve swing-ups and reaches from so many perturbed starts instead.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure what an iteration costs here, phase by phase, beside the engine's own calls."""
    _announce(quiet=False)
    from mjslq.reports import bench, tables
    from mjslq.validation import choose

    if starts is not None:
        _bench_starts(cases, starts, as_json)
        return
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


def _bench_starts(cases: list[str] | None, number: int, as_json: bool) -> None:
    """Solve each case from perturbed starts, by default settings."""
    from mjslq.reports import starts, tables
    from mjslq.validation import choose, count

    count("starts", number)
    rows = []
    for case in [choose("case", case, starts.CASES) for case in cases or starts.CASES]:
        print(f"solving {case} from {number} starts ...", file=sys.stderr, flush=True)
        rows.append(starts.measure(case, number))
    if as_json:
        print(json.dumps({"starts": [row.as_dict() for row in rows]}))
    else:
        tables.many_starts(rows)


def _refuse_model(what: str) -> None:
    """Refuse a model where a problem is wanted: a model has no cost, which takes a few lines of Python."""
    if Path(what).suffix.lower() in (".xml", ".urdf", ".mjb"):
        raise ValueError(
            f"{what!r} is a model, and a problem has a cost besides: pose it in Python, as in mjslq.solve("
            f"mjslq.Problem(mjslq.MujocoDynamics.from_path({what!r}), horizon, x0, costs)); "
            f"`mjslq check {what}` says what serves the model, `mjslq list` shows ready problems"
        )


def _refuse_unwritable(file: Path) -> None:
    """Refuse, before hours of work, a file that cannot be written after them."""
    if file.is_dir():
        raise ValueError(f"cannot write {file}: it is a folder")
    if not file.absolute().parent.is_dir():
        raise ValueError(f"cannot write {file}: there is no folder {file.parent}")


def _default_method() -> str:
    """The method of `mjslq.solve` where none is given."""
    import inspect

    from mjslq.optimize import solve as run

    return str(inspect.signature(run).parameters["method"].default)


def _announce(quiet: bool) -> None:
    if not quiet:
        from mjslq.compiling import announce_compilation

        announce_compilation(lambda message: print(message, file=sys.stderr, flush=True))


def _sort_settings(settings: list[str], problem: str, own: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split NAME=VALUE settings into parameters of the problem and options named in `own`."""
    from mjslq import problems
    from mjslq.validation import choose

    parameters, options = {}, {}
    known = problems.parameters(problem)
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise ValueError(
                f"--set takes NAME=VALUE, such as {next(iter(known))}={next(iter(known.values()))}, got {setting!r}"
            )
        if choose(f"setting of {problem} or the method", name, [*known, *own]) in known:
            parameters[name] = _value(text)
        else:
            options[name] = _value(text)
    return parameters, options


def _value(text: str) -> Any:
    """A number, a truth value or a list as Python writes it; anything else is a text."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def _dynamics_of(what: str) -> tuple[Dynamics, Any]:
    """The engine, and a state to start from, of a model file or a problem's name."""
    from mjslq import problems

    if what in problems.names():
        problem = problems.get(what)
        return problem.dynamics, problem.x0
    if Path(what).suffix.lower() in (".xml", ".urdf", ".mjb") or os.sep in what:
        from mjslq.dynamics.mujoco import MujocoDynamics

        dynamics = MujocoDynamics.from_path(what)
        return dynamics, dynamics.initial_state
    raise ValueError(
        f"{what!r} is neither a model file (.xml, .urdf, .mjb) nor a problem; problems: {', '.join(problems.names())}"
    )


def _random_motion(dynamics: Dynamics, x0: Any, steps: int, seed: int) -> Any:
    """A motion under small random controls; halved until it does not blow up."""
    import numpy as np

    U = np.random.default_rng(seed).normal(size=(steps, dynamics.nu))
    for _ in range(20):
        trajectory = dynamics.rollout(x0, U)
        if not trajectory.diverged:
            return trajectory
        U *= 0.5
    raise ValueError("the model blows up whatever the controls; shorten its timestep")


if __name__ == "__main__":
    main()
