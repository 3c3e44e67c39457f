"""Problems of commands, by name or from a task file, and the commands about task files: `new` and `schema`."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from mjslq.commands.common import default_method, is_task, pairs_of, read_value, refuse_model, sort_settings


def posed(what: str, method: str | None, settings: list[str]) -> tuple[Any, str, dict[str, Any]]:
    """The problem of a name or a task file, the method to solve it by, and its options."""
    from mjslq import problems
    from mjslq.method_table import ALIASES, METHODS, settable
    from mjslq.validation import choose

    if method is not None:
        choose("method", method, [*METHODS, *ALIASES])
    if is_task(what):
        from mjslq.tasks import load_task

        task = load_task(what)
        known = dict.fromkeys([*settable(method or task.method), *task.options])
        asked = {name: read_value(text) for name, text in pairs_of(settings, "max_iterations=100")}
        for name in asked:
            choose("option", name, known)
        return task.problem, method or task.method, {"guess": task.guess} | task.options | asked
    refuse_model(what)
    if what not in problems.names():
        _refuse_robot(what)
    choose("problem", what, problems.names())
    method = method or default_method()
    parameters, options = sort_settings(settings, what, settable(method))
    return problems.get(what, **parameters), method, options


def _refuse_robot(what: str) -> None:
    """Refuse a robot's name where a problem is wanted, and say what makes one of it."""
    from mjslq.robots import robot_names

    if what in robot_names():
        raise ValueError(
            f"{what!r} is a robot, and a problem has a cost besides: `mjslq new {what}` writes a task for it"
        )


def new(
    model: Annotated[str, typer.Argument(help="A model (.xml, .urdf, .mjb), a robot's name, or menagerie:NAME.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The file to write; MODEL.toml here unless given.")
    ] = None,
) -> None:
    """Write a task file to begin with: it solves as it is, and lists the model's names in comments."""
    from mjslq.files import atomic_write
    from mjslq.tasks.engines import names_a_file
    from mjslq.tasks.writing import text_for

    stem = Path(model).stem if names_a_file(model) else model.rpartition(":")[2].partition("/")[0]
    file = Path(f"{stem}.toml") if output is None else output
    if file.suffix.lower() != ".toml":
        raise ValueError(f"a task file ends in .toml, got {str(file)!r}")
    if file.exists():
        raise ValueError(f"{file} exists already; name another file with --output")
    folder = file.absolute().parent
    if not folder.is_dir():
        raise ValueError(f"cannot write {file}: there is no folder {file.parent}")
    if names_a_file(model):
        model = Path(os.path.relpath(Path(model).expanduser(), folder)).as_posix()
    text = text_for(model, folder)
    with atomic_write(file) as stream:
        stream.write(text.encode())
    result = file.with_suffix(".npz").name
    print(f"{file}: written; solve it and look at it with", file=sys.stderr)
    print(f"    mjslq solve {file} --save {result} --view", file=sys.stderr)


def schema() -> None:
    """Print the JSON schema of task files, for editors."""
    from mjslq.tasks.schema import TaskFile

    print(
        json.dumps({"$schema": "https://json-schema.org/draft/2020-12/schema"} | TaskFile.model_json_schema(), indent=2)
    )
