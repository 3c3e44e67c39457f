"""The command line `mjslq`: list, solve and view problems and results; see `mjslq --help`.

Exit status: 0 converged (or the command did what it was asked), 1 not converged or ended by an error, 2 wrong input,
3 diverged, 130 interrupted. What a command says about its progress goes to standard error; standard output holds
the result, so that `--json` can be piped.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from mjslq.commands import explaining, exporting, measuring, sweeping, tasks
from mjslq.commands.common import (
    Dark,
    Host,
    Json,
    Port,
    Settings,
    View,
    announce,
    is_model,
    keep,
    model_of,
    refuse_address,
    refuse_model,
    refuse_names,
    refuse_unwritable,
    sort_settings,
)

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


def main() -> None:
    """Run the command line; every wrong input ends in one sentence and status 2."""
    try:
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()  # here, where a full disk and a reader that has gone are told
        if code == _EXIT["interrupted"]:
            print("mjslq: interrupted", file=sys.stderr)
        sys.exit(code)
    except _USAGE_ERROR as error:
        _refuse(" ".join(error.format_message().split()))  # type: ignore[attr-defined]
    except (KeyboardInterrupt, typer.Abort):
        print("mjslq: interrupted", file=sys.stderr)
        sys.exit(_EXIT["interrupted"])
    except BrokenPipeError:  # the reader of a pipe has gone; that is its right
        _write_no_more()
    except MemoryError as error:
        _refuse(f"there is not enough memory: {' '.join(str(error).split())}")
    except OSError as error:
        where = f"{error.filename}: " if error.filename else "the output cannot be written: "
        _refuse(f"{where}{error.strerror}" if error.strerror else " ".join(str(error).split()))
    except (ValueError, ImportError) as error:
        _refuse(" ".join(str(error).split()))


def _refuse(sentence: str) -> NoReturn:
    with contextlib.suppress(OSError):  # nobody reads it
        print(f"mjslq: {sentence}", file=sys.stderr)
    if sys.stdout is not None:
        try:
            sys.stdout.flush()
        except OSError:
            _write_no_more()
    sys.exit(WRONG_INPUT)


def _write_no_more() -> None:
    """Let what is left for standard output go nowhere, which Python would complain of at its end."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


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
    problem: Annotated[str, typer.Argument(help="A problem of `mjslq list`, or a task file (.toml).")],
    method: Annotated[str | None, typer.Option("--method", "-m", help="How to solve it.")] = None,
    preset: Annotated[
        str | None, typer.Option(help="A paper's version of the method, nothing added: sideris-bobrow for slq.")
    ] = None,
    settings: Settings = None,
    save: Annotated[Path | None, typer.Option(help="Write the result to this .npz file.")] = None,
    view: View = False,
    watch: Annotated[bool, typer.Option("--watch", help="Show the solve in a browser while it runs.")] = False,
    host: Host = "127.0.0.1",
    port: Port = 8080,
    dark: Dark = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
    as_json: Json = False,
) -> None:
    """Solve a problem: a line an iteration while it works, a summary after."""
    if save is not None:
        refuse_unwritable(save)
    if view or watch:
        refuse_address(host, port)
    announce(quiet)
    from mjslq.optimize import solve as run
    from mjslq.reports.tables import as_dict, print_summary

    stated, method, options = tasks.posed(problem, method, settings or [])
    if preset is not None:
        options["preset"] = preset
    options |= {"verbose": 0 if quiet else 1, "stream": sys.stderr}
    window = None
    if watch:
        from mjslq.viewer import watch as watching

        with contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
            window = watching(stated, method, host, port, block=False, dark=dark, **options)
    result = run(stated, method, **options) if window is None else window.result
    if save is not None:
        keep(result, save)  # before anything is printed, which may fail
    if as_json:
        print(json.dumps(as_dict(result), allow_nan=False))
    elif not quiet:
        print_summary(result, stated)
    if quiet and result.error:
        print(f"mjslq: {result.message}", file=sys.stderr)
    if save is not None and not quiet:
        print(f"saved to {save}", file=sys.stderr)
    if window is not None and window.player is not None:
        from mjslq.viewer.serving import stay

        stay(window, "the solve has ended; Ctrl-C closes the viewer")
    elif view and window is None:
        from mjslq.viewer import view as show

        show(result, host, port, dark=dark)
    raise typer.Exit(_EXIT.get(result.status.value, 1))


@app.command()
def view(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE...",
            help="Results that `solve --save` wrote; or a model (.xml, .urdf, .mjb), a robot's name or menagerie:NAME.",
        ),
    ],
    host: Host = "127.0.0.1",
    port: Port = 8080,
    dark: Dark = False,
) -> None:
    """Show a saved result in a browser, or several to compare; or a model, with its keyframes and joint sliders."""
    models = [what for what in files if is_model(what)]
    if models and len(files) > 1:
        raise ValueError(f"a model is viewed alone, and {models[0]} is one; results can be compared, up to eight")
    if models:
        model = model_of(models[0])
        assert model is not None
        from mjslq.viewer.model_view import view_model

        view_model(model, host, port, dark=dark)
        return
    refuse_names(files)
    from mjslq.result import load
    from mjslq.viewer import view as show

    show([load(file) for file in files], host, port, dark=dark)


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
    dark: Dark = False,
) -> None:
    """Solve a problem by every method from the same start: one table, one plot."""
    if view:
        refuse_address(host, port)
    announce(quiet=False)
    from mjslq import problems
    from mjslq.options import COMMON
    from mjslq.reports import compare as comparing
    from mjslq.reports import figures
    from mjslq.reports.tables import console, table
    from mjslq.validation import choose

    refuse_model(problem)
    choose("problem", problem, problems.names())
    if plot is not None:
        choose("ending of a picture", plot.suffix, figures.FORMATS)
        refuse_unwritable(plot)
    parameters, options = sort_settings(settings or [], problem, list(COMMON))
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

        show([entry.result for entry in entries], host, port, dark=dark)


for _command in (
    tasks.new,
    tasks.schema,
    explaining.explain,
    exporting.export,
    measuring.check,
    measuring.reproduce,
    measuring.bench,
    sweeping.sweep,
):
    app.command()(_command)


if __name__ == "__main__":
    main()
