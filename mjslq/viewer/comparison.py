"""Several results in one viewer: how they stand in the scene, and plots of their costs against iterations and time."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import viser

from mjslq.reports import convergence
from mjslq.result import Result
from mjslq.validation import Array
from mjslq.viewer import plots, series
from mjslq.viewer.controls import LAYOUTS
from mjslq.viewer.result_view import ResultView

MOST = len(series.COLORS)
"""Results that can be told apart."""
_BETWEEN, _LEAST = 1.25, 0.3
"""Distance of results side by side: relative to their width, and at least, relative to their size."""


def views_of(results: Sequence[Result]) -> list[ResultView]:
    """Return a view of each result, coloured and labelled where there are several.

    Raises ValueError for what is no result, none at all, and more than `MOST`.
    """
    for result in results:
        if not isinstance(result, Result):
            raise ValueError(f"a viewer shows a Result of mjslq.solve or mjslq.load, got {type(result).__name__}")
    if not results:
        raise ValueError("there is nothing to show: give one result, or several to compare")
    if len(results) > MOST:
        raise ValueError(f"at most {MOST} results can be told apart in one window, got {len(results)}")
    if len(results) == 1:
        return [ResultView(results[0])]
    return [ResultView(*entry) for entry in zip(results, labels(results), series.COLORS, strict=False)]


def labels(results: Sequence[Result]) -> list[str]:
    """What tells the results apart: method, problem and parameters as far as they differ, or else a number."""
    methods, problems = [r.method or "result" for r in results], [r.problem for r in results]
    found = methods if len(set(methods)) > 1 or len(set(problems)) == 1 else ["" for _ in results]
    if len(set(problems)) > 1:
        found = [f"{problem} {label}".strip() for problem, label in zip(problems, found, strict=True)]
    names = dict.fromkeys(name for result in results for name in result.parameters)
    for name in names:
        values = [str(result.parameters.get(name, "-")) for result in results]
        if len(set(values)) > 1 and max(len(value) for value in values) <= 12:
            found = [f"{label}, {name} {value}" for label, value in zip(found, values, strict=True)]
    if len(set(found)) < len(found):
        found = [f"{label} ({i + 1})" if found.count(label) > 1 else label for i, label in enumerate(found)]
    return found


def layouts(views: Sequence[ResultView]) -> tuple[str, ...]:
    """How these results can stand: over each other only where all have the same model."""
    models = {view.result.scene.model for view in views if view.result.scene is not None}
    return LAYOUTS if len(models) <= 1 else LAYOUTS[1:]


def offsets(views: Sequence[ResultView], layout: str) -> list[Array]:
    """Where each result stands: all in one place, or in lanes beside the first one, across their motion. (3,) [m]."""
    places = [np.zeros(3) for _ in views]
    boxes = [view.extent() for view in views]
    there = [box for box in boxes if box is not None]
    if layout == LAYOUTS[0] or len(there) < 2:
        return places
    sizes = np.array([high - low for low, high in there])
    across = int(np.argmin(sizes[:, :2].max(axis=0)))
    lane = max(_BETWEEN * float(sizes[:, across].max()), _LEAST * float(np.linalg.norm(sizes.max(axis=0))))
    lanes = iter(range(len(there)))
    for place, box in zip(places, boxes, strict=True):
        if box is not None:
            place[across] = lane * next(lanes)
    return places


def box(views: Sequence[ResultView], layout: str) -> tuple[Array, Array] | None:
    """Corners (3,) and (3,) [m] of the box that all results fill over their motions; None where nothing moves."""
    boxes = zip([view.extent() for view in views], offsets(views, layout), strict=True)
    corners = [corner + place for extent, place in boxes if extent is not None for corner in extent]
    return (np.min(corners, axis=0), np.max(corners, axis=0)) if corners else None


def add_comparison(gui: viser.GuiApi, results: Sequence[Result], names: Sequence[str] = ()) -> None:
    """Add the plots of costs and a legend to the current container."""
    logs = [result.log for result in results]
    if not any(logs):
        return
    curves = [np.log10(relative) for relative in convergence.relative_costs(logs)]
    names = names or [f"{result.method} ({result.status.value})" for result in results]
    y_range = series.value_range(np.concatenate(curves))
    for label, abscissae in (
        ("iteration", [convergence.iterations(log) for log in logs]),
        ("time [s]", [convergence.seconds(log) for log in logs]),
    ):
        x = np.unique(np.concatenate(abscissae))
        values = np.stack([_on(x, *curve) for curve in zip(abscissae, curves, strict=True)], axis=1)
        whole = label == "iteration"
        plots.add_plot(gui, x, values, tuple(names), y_range, label, "log10 (J - best) / |best|", whole=whole)
    entries = "".join(
        f'<div><span style="display:inline-block;width:9px;height:3px;background:{color};margin-right:6px"></span>'
        f"{html.escape(name)}</div>"
        for name, color in zip(names, series.COLORS, strict=False)
    )
    gui.add_html(f'<div style="font:11px/1.5 system-ui,sans-serif;padding:0 12px 6px">{entries}</div>')


def _on(x: Array, at: Array, values: Array) -> Array:
    """Values of one curve on the abscissae of all: interpolated within it, NaN beyond its ends and in its gaps."""
    good = np.isfinite(values)
    if not good.any():
        return np.full(len(x), np.nan)
    return np.interp(x, at[good], values[good], left=np.nan, right=np.nan)
