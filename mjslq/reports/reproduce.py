"""`mjslq reproduce`: what the papers report, beside what comes out here, row by row.

A verdict says how the two compare and hides nothing: "reproduced" needs the paper's number or a better one by the
paper's own method; where the paper reports a failure and ours converges, it says so; where a number differs, both
stand in the row, with the reason where it is known.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

from mjslq.reports import fukushima_yamamoto, mcquade, sforni, sideris_bobrow
from mjslq.reports.figures import FORMATS, Draw, save
from mjslq.reports.rows import Row

PAPERS: dict[str, Callable[[], Iterator[Row]]] = {
    "slq": sideris_bobrow.rows,
    "trust-region": fukushima_yamamoto.rows,
    "square-root-sweep": mcquade.rows,
    "gopronto": sforni.rows,
}
"""Papers by the name of their method."""
FIGURES: dict[str, dict[str, Draw]] = {
    "slq": sideris_bobrow.FIGURES,
    "trust-region": fukushima_yamamoto.FIGURES,
    "square-root-sweep": mcquade.FIGURES,
    "gopronto": sforni.FIGURES,
}
"""Figures that can be drawn again, by paper: name -> what makes a matplotlib figure."""


def draw(paper: str, where: str | os.PathLike[str]) -> Iterator[Path]:
    """Draw the figures of a paper as PNG and SVG, one after the other, and tell the files.

    `where` is a folder, or the beginning of the files' names; with an ending (.png, .svg, .pdf) only that format is
    written. Raises ValueError when a file cannot be written.
    """
    place = Path(where)
    endings = [".png", ".svg"]
    if place.suffix in FORMATS and not place.is_dir():
        place, endings = place.with_suffix(""), [place.suffix]
    start = f"{place}{os.sep}" if place.is_dir() else f"{place}-"
    for name, make in FIGURES[paper].items():
        figure = make()
        for ending in endings:
            save(figure, f"{start}{paper}-{name}{ending}")
            yield Path(f"{start}{paper}-{name}{ending}")
