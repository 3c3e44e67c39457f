"""Results as files for other programs: pages, films, pictures, tables and policies, by the file's ending."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjslq.validation import choose

if TYPE_CHECKING:
    from mjslq.result import Result

__all__ = ["OPTIONS", "export"]

OPTIONS: dict[str, tuple[str, ...]] = {
    ".html": ("dark",),
    ".mp4": ("size", "camera", "fps", "speed"),
    ".gif": ("size", "camera", "fps", "speed"),
    ".png": ("size", "camera", "at", "poses"),
    ".csv": (),
    ".npz": (),
}
"""Endings of the files that can be written, and the options that each has."""


def export(
    result: Result,
    path: str | os.PathLike[str],
    *,
    size: tuple[int, int] | None = None,
    camera: str | None = None,
    fps: float | None = None,
    speed: float | None = None,
    at: float | None = None,
    poses: int | None = None,
    dark: bool | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write a result to a file for other programs, whole or not at all.

    ======== ============================================================================================
    ending   what is written
    ======== ============================================================================================
    `.html`  a page that plays in any browser, from disk and without a network
    `.mp4`   a film in H.264, which needs the package `av` (`pip install "mjslq[video]"`)
    `.gif`   a film that repeats
    `.png`   a picture: one moment, or several poses in one
    `.csv`   times, states, controls and outputs, a row a knot; see `mjslq.exports.table`
    `.npz`   the policy alone, for use without mjslq; see `Policy.save`
    ======== ============================================================================================

    Films and pictures are drawn by MuJoCo through OpenGL, by the way that the environment variable MUJOCO_GL names
    (egl, osmesa, glfw); where it is not set, a machine without a display takes EGL.

    Parameters
    ----------
    result : Result
        Of `mjslq.solve` or `mjslq.load`.
    path : path
        The file; its ending says what is written.
    size : (int, int), optional
        Width and height of films and pictures, even for `.mp4`. (1280, 720) unless given, (640, 360) for `.gif`. [px]
    camera : str, optional
        A camera of the model by its name. Unless given, one that sees the whole motion.
    fps : float, optional
        Pictures of a film a second: 50 unless given, 20 for `.gif`. [1/s]
    speed : float, optional
        Seconds of motion in a second of a film; 1 unless given.
    at : float, optional
        The moment of a picture; the end unless given. [s]
    poses : int, optional
        Poses in one picture, evenly spread over the motion, all but the one at `at` pale. 6 unless `at` is
        given, else 1.
    dark : bool, optional
        Whether a page is dark; it is not unless given.
    progress : callable, optional
        Called with the share that is done, from 0 to 1, after each picture of a film.

    Raises
    ------
    ValueError
        For other endings, options that a file of that kind has no use for, results without a model where one is to be
        drawn, files that cannot be written, and machines without OpenGL.
    ImportError
        When a film is to be written as `.mp4` and `av` is not installed.

    Examples
    --------
    >>> import mjslq, tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> result = mjslq.solve(mjslq.problems.get("hopper", height=1.0))
    >>> mjslq.export(result, folder / "hopper.csv")
    >>> print((folder / "hopper.csv").read_text().splitlines()[0][:21])
    time [s],y [in],pisto
    """
    from mjslq.result import Result

    if not isinstance(result, Result):
        raise ValueError(f"only a Result of mjslq.solve or mjslq.load can be exported, got {type(result).__name__}")
    ending = choose("ending of an exported file", Path(path).suffix.lower(), OPTIONS)
    given = {"size": size, "camera": camera, "fps": fps, "speed": speed, "at": at, "poses": poses, "dark": dark}
    options = {name: value for name, value in given.items() if value is not None}
    for name in options:
        if name not in OPTIONS[ending]:
            others = [other for other, known in OPTIONS.items() if name in known]
            raise ValueError(f"{name} is an option of {' and '.join(others)} files, not of {ending} files")
    _WRITERS[ending](result, path, options, progress)


def _page(result: Result, path: Any, options: dict[str, Any], progress: Any) -> None:
    from mjslq.viewer import export_html

    export_html(result, path, **options)


def _table(result: Result, path: Any, options: dict[str, Any], progress: Any) -> None:
    from mjslq.exports.table import write_table

    write_table(result, path)


def _policy(result: Result, path: Any, options: dict[str, Any], progress: Any) -> None:
    result.policy.save(path)


def _film(result: Result, path: Any, options: dict[str, Any], progress: Any) -> None:
    from mjslq.exports.films import write_film

    write_film(result, path, progress=progress, **options)


def _picture(result: Result, path: Any, options: dict[str, Any], progress: Any) -> None:
    from mjslq.exports.films import write_picture

    write_picture(result, path, **options)


_WRITERS: dict[str, Callable[[Result, Any, dict[str, Any], Any], None]] = {
    ".html": _page, ".mp4": _film, ".gif": _film, ".png": _picture, ".csv": _table, ".npz": _policy,
}  # fmt: skip
