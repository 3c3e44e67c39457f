"""Several results of one problem side by side: relative costs against iterations and against time."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import viser

from mjslq.reports import convergence
from mjslq.result import Result
from mjslq.validation import Array
from mjslq.viewer import panels, series


def add_comparison(gui: viser.GuiApi, results: Sequence[Result]) -> None:
    """Add the two plots and a legend of methods to the current container."""
    logs = [result.log for result in results]
    curves = [np.log10(relative) for relative in convergence.relative_costs(logs)]
    names = [f"{result.method} ({result.status.value})" for result in results]
    y_range = series.value_range(np.concatenate(curves))
    for label, abscissae in (
        ("iteration", [convergence.iterations(log) for log in logs]),
        ("time [s]", [convergence.seconds(log) for log in logs]),
    ):
        x = np.unique(np.concatenate(abscissae))
        values = np.stack([_on(x, *curve) for curve in zip(abscissae, curves, strict=True)], axis=1)
        whole = label == "iteration"
        panels.add_plot(gui, x, values, tuple(names), y_range, label, "log10 (J - best) / |best|", whole=whole)
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
