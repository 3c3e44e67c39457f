"""Figures by matplotlib: one look for all, and files that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from mjslq.files import atomic_write
from mjslq.validation import choose

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
"""Endings of the files that can be written."""
COLORS = ("#2f6fb3", "#d6592b", "#2b8f6d", "#7a8794")
RAMP = ("#b9cfe8", "#86aedb", "#5089c7", "#2f6fb3")
"""Colors of iterates, the later the darker."""
INK, SOFT = "#1f2933", "#66727f"

P = ParamSpec("P")
T = TypeVar("T")
Draw = Callable[[], "Figure"]
"""Makes a figure."""

_LOOK = {
    "font.size": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "grid.color": "#e6eaee",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.0,
    "legend.frameon": False,
    "figure.titlesize": 11.0,
    "figure.titleweight": "bold",
}


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function that draws, so that what it draws has the look above."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> T:
        import matplotlib
        from cycler import cycler

        with matplotlib.rc_context(_LOOK | {"axes.prop_cycle": cycler(color=COLORS)}):
            return draw(*args, **kwargs)

    return drawn


def subplots(rows: int, columns: int, size: tuple[float, float], **shared: Any) -> tuple[Figure, Any]:
    """Return a figure of `size` [in], and its axes as an array (rows, columns)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure in the format that the name ends in.

    Raises ValueError when that is none of `FORMATS`, or the file cannot be written.
    """
    ending = choose("ending of a picture", Path(path).suffix, FORMATS)
    with atomic_write(path) as stream:
        figure.savefig(stream, format=ending[1:], dpi=150)
