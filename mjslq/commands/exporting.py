"""The command `export`: a result as a file for other programs."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from mjslq.commands.common import refuse_unwritable

_FILM, _PICTURE = "Films (.mp4, .gif)", "Pictures (.png)"


def export(
    file: Annotated[Path, typer.Argument(help="A result that `solve --save` wrote.")],
    output: Annotated[Path, typer.Argument(help="The file to write; its ending says what: see above.")],
    size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Of films and pictures, such as 1280x720. [px]")
    ] = None,
    camera: Annotated[
        str | None, typer.Option(help="A camera of the model, for films and pictures; one that sees all unless given.")
    ] = None,
    fps: Annotated[float | None, typer.Option(help=f"{_FILM}: pictures a second.")] = None,
    speed: Annotated[float | None, typer.Option(help=f"{_FILM}: seconds of motion in a second of film.")] = None,
    at: Annotated[float | None, typer.Option(help=f"{_PICTURE}: the moment. [s]")] = None,
    poses: Annotated[int | None, typer.Option(help=f"{_PICTURE}: so many poses in one; 6 without --at.")] = None,
    dark: Annotated[bool, typer.Option("--dark", help="Pages (.html): a dark one.")] = False,
) -> None:
    """Write a saved result to a file: a page, a film, a picture, a table or its policy.

    .html plays in any browser without a network; .mp4 and .gif are films; .png is one moment (--at) or several poses
    in one; .csv has times, states, controls and sensors; .npz is the policy alone, for use without mjslq.

    Films and pictures need OpenGL; MUJOCO_GL names the way to it (egl, osmesa, glfw) where the first choice fails.
    """
    from mjslq.exports import OPTIONS
    from mjslq.exports import export as write
    from mjslq.result import load
    from mjslq.validation import choose

    choose("ending of an exported file", output.suffix.lower(), OPTIONS)
    refuse_unwritable(output)
    given = {
        "size": _size(size),
        "camera": camera,
        "fps": fps,
        "speed": speed,
        "at": at,
        "poses": poses,
        "dark": dark or None,
    }
    result = load(file)
    _import_mujoco()
    with _bar(output, output.suffix.lower() in (".mp4", ".gif")) as progress:
        write(result, output, progress=progress, **given)  # type: ignore[arg-type]
    print(f"{output}: {output.stat().st_size / 1e6:.2f} MB", file=sys.stderr)


def _import_mujoco() -> None:
    """Import MuJoCo, which opens what MUJOCO_GL names and fails in many ways where that is not there."""
    try:
        import mujoco  # noqa: F401
    except Exception as error:
        asked = os.environ.get("MUJOCO_GL", "")
        raise ValueError(f"MuJoCo does not start with MUJOCO_GL={asked!r} ({error}); unset it, or try egl") from None


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise ValueError(f"--size takes WIDTHxHEIGHT, such as 1280x720, got {text!r}")
    return int(width), int(height)


@contextmanager
def _bar(output: Path, wanted: bool) -> Iterator[Callable[[float], None] | None]:
    """A bar on standard error, where that is a terminal."""
    if not wanted or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task: Any = bar.add_task(output.name, total=1.0)
        yield lambda share: bar.update(task, completed=share)
