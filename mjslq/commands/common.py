"""Parts that commands share: their options, and what is checked before anything is computed."""

from __future__ import annotations

import ast
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from mjslq.dynamics.mujoco import MujocoDynamics
    from mjslq.result import Result

Port = Annotated[int, typer.Option(help="Port of the viewer; the next free one is taken if it is busy.")]
Host = Annotated[str, typer.Option(help="Address that the viewer listens on.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", "-s", metavar="NAME=VALUE", help="Set a parameter of the problem, or an option."),
]
MODELS = (".xml", ".urdf", ".mjb")
"""Endings of model files."""
View = Annotated[bool, typer.Option("--view", help="Show the result in a browser.")]
Dark = Annotated[bool, typer.Option("--dark", help="Make the viewer's page dark.")]
Json = Annotated[bool, typer.Option("--json", help="Print the numbers as one JSON object.")]


def is_task(what: str) -> bool:
    """Whether a command was given a task file."""
    return Path(what).suffix.lower() == ".toml"


def is_model(what: str) -> bool:
    """Whether `model_of` finds a model, if it can be read: a file named so, or a name that no file here has."""
    from mjslq.tasks.engines import MENAGERIE

    if what.startswith(MENAGERIE) or Path(what).suffix.lower() in MODELS:
        return True
    from mjslq.robots import robot_names

    return what in robot_names() and not Path(what).exists()


def model_of(what: str) -> MujocoDynamics | None:
    """The model of a file, a robot's name or `menagerie:NAME`; None for what is none of these.

    Raises ValueError for models that cannot be read, and `menagerie:` with another name.
    """
    if not is_model(what):
        return None
    from mjslq.dynamics.mujoco import MujocoDynamics
    from mjslq.robots import robot_names, robot_spec
    from mjslq.tasks.engines import file_of

    if what in robot_names():
        return MujocoDynamics.from_spec(robot_spec(what), name=what)
    return MujocoDynamics.from_path(file_of(what, Path()))


def refuse_names(files: list[str]) -> None:
    """Refuse names where files of results are wanted, and say what else can be looked at."""
    from mjslq import problems
    from mjslq.robots import robot_names
    from mjslq.validation import choose

    for what in files:
        if Path(what).suffix or os.sep in what or Path(what).exists():
            continue
        if what in problems.names():
            raise ValueError(f"{what!r} is a problem; solve it and look at it with `mjslq solve {what} --view`")
        choose("file or robot", what, robot_names())


def refuse_model(what: str) -> None:
    """Refuse a model where a problem is wanted: a model has no cost, which takes a few lines of Python."""
    if Path(what).suffix.lower() in MODELS:
        raise ValueError(
            f"{what!r} is a model, and a problem has a cost besides: `mjslq new {what}` writes a task file to begin "
            f"with; or pose it in Python, as in mjslq.solve(mjslq.Problem(mjslq.MujocoDynamics.from_path({what!r}), "
            f"horizon, x0, costs)); `mjslq check {what}` says what serves the model, `mjslq list` shows ready problems"
        )


def refuse_unwritable(file: Path) -> None:
    """Refuse, before hours of work, a file that cannot be written after them."""
    import tempfile

    from mjslq.files import writable

    try:
        with tempfile.TemporaryFile(dir=writable(file).parent):
            pass
    except OSError as error:
        raise ValueError(f"cannot write {file}: {error.strerror or error}") from None


def refuse_address(host: str, port: int) -> None:
    """Refuse, before anything is solved, an address that its viewer cannot listen at."""
    from mjslq.addresses import check_host, check_port

    check_port(port)
    check_host(host)


def keep(result: Result, file: Path) -> None:
    """Save a result; Ctrl-C waits for it, and where it fails after all it is saved among temporary files.

    Raises ValueError, which says where it is then, and KeyboardInterrupt once it is saved.
    """
    import tempfile

    from mjslq.solvers.interrupts import Interrupts

    with Interrupts() as interrupts:
        interrupts.hold()
        try:
            result.save(file)
        except ValueError as error:
            spare = Path(tempfile.mkdtemp(prefix="mjslq-")) / "result.npz"
            result.save(spare)
            raise ValueError(f"{error}; the result is in {spare}") from None
    if interrupts.count:
        raise KeyboardInterrupt


def default_method() -> str:
    """The method of `mjslq.solve` where none is given."""
    import inspect

    from mjslq.optimize import solve as run

    return str(inspect.signature(run).parameters["method"].default)


def announce(quiet: bool) -> None:
    """Tell on standard error when kernels are being compiled."""
    if not quiet:
        from mjslq.compiling import announce_compilation

        announce_compilation(lambda message: print(message, file=sys.stderr, flush=True))


def sort_settings(settings: list[str], problem: str, own: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split NAME=VALUE settings into parameters of the problem and options named in `own`."""
    from mjslq import problems
    from mjslq.validation import choose

    parameters, options = {}, {}
    known = problems.parameters(problem)
    for name, text in pairs_of(settings, f"{next(iter(known))}={next(iter(known.values()))}"):
        if choose(f"setting of {problem} or the method", name, [*known, *own]) in known:
            parameters[name] = read_value(text)
        else:
            options[name] = read_value(text)
    return parameters, options


def pairs_of(settings: list[str], example: str) -> list[tuple[str, str]]:
    """NAME=VALUE settings as names and texts."""
    pairs = []
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise ValueError(f"--set takes NAME=VALUE, such as {example}, got {setting!r}")
        pairs.append((name, text))
    return pairs


def read_value(text: str) -> Any:
    """A number, a truth value or a list as Python writes it; anything else is a text."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text
