"""Parts that commands share: their options, and what is checked before anything is computed."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

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
    if file.is_dir():
        raise ValueError(f"cannot write {file}: it is a folder")
    if not file.absolute().parent.is_dir():
        raise ValueError(f"cannot write {file}: there is no folder {file.parent}")


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
