"""Panels beside the robot: a summary, and plots with a mark at the time shown.

A plot of controls shows their limits as dashed lines, and as bars on the time axis when each is at one of them. Plots
of constraints have bars where each is in force.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.reports import in_force, limits
from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.unknowns import TIME
from mjslq.validation import Array
from mjslq.viewer import series

if TYPE_CHECKING:
    import viser

_POINTS = 800  # more than pixels, so that nothing shows of the thinning
_HEIGHT, _TALL = 190, 280  # of a plot; beside a robot, and alone [px]
_MARK = "#1f2933"
_SHARED, _DASH = "#9aa5b1", (5, 4)
"""Of the lines at limits."""
_BAR = 0.035
"""Height of the bar that marks when a control is at a limit, relative to the axis."""
_LEAST_VIOLATION = 1e-12
"""What is plotted for a violation of zero."""
_BAR_HEIGHT = 5
"""What a plot is higher by for each of them. [px]"""
_LIMITS_NOTE = "dashed: limits; bars on the time axis: at a limit"
_IN_FORCE_NOTE = "of the result; bars on the time axis: in force"
_FONT = "font-size:12px;line-height:1.55"
_GOOD, _FAIR = ("#1d7a4f", "#e3f4ea"), ("#94600b", "#fdf1dc")


def short(number: float) -> str:
    """Return a number with four digits."""
    return f"{number:.4g}" if np.isfinite(number) else "not finite"


def _counted(array: Array, what: str) -> str:
    return f"{array.shape[1]} {what}" + ("" if array.shape[1] == 1 else "s")


def facts(result: Result) -> list[tuple[str, str]]:
    """Return what a summary tells of a result: (label, value)."""
    told = [
        ("method", result.method or "not recorded"),
        ("cost", short(result.cost)),
        ("iterations", str(result.iterations)),
        ("gradient norm", short(result.gradient_norm)),
        ("solve time", f"{short(result.seconds)} s"),
        *([("compiling", f"{short(result.compile_seconds)} s")] if result.compile_seconds > 0.0 else []),
        ("horizon", f"{result.trajectory.horizon} steps, {short(float(result.trajectory.times[-1]))} s"),
        ("size", f"{_counted(result.trajectory.X, 'state')}, {_counted(result.trajectory.U, 'control')}"),
    ]
    told[2:2] = [(name, short(value) + (" s" if name == TIME else "")) for name, value in result.unknowns.items()]
    if result.constraint_violation > 0.0:
        told.insert(4, ("violation", short(result.constraint_violation)))
    if at := limits.describe(result, brief=True):
        told.append(("at limits", at))
    if held := in_force.in_force(result):
        told.append(("in force", "; ".join(str(entry) for entry in held)))
    return told


def summary(result: Result) -> str:
    """Return the summary as HTML."""
    ink, paper = _GOOD if result.success else _FAIR
    status = result.status.value.replace("_", " ")
    rows = "".join(
        f'<div style="opacity:.62">{label}</div><div style="text-align:right;font-variant-numeric:tabular-nums">'
        f"{html.escape(value)}</div>"
        for label, value in facts(result)
    )
    note = "" if result.success else f'<div style="margin-top:8px;opacity:.75">{html.escape(result.message)}</div>'
    return (
        f'<div style="{_FONT};padding:10px 12px 4px">'
        '<div style="display:flex;justify-content:space-between;align-items:center;gap:8px;margin-bottom:6px">'
        f'<span style="font-size:15px;font-weight:650">{html.escape(result.problem or "result")}</span>'
        f'<span style="font-size:11px;font-weight:600;padding:1px 8px;border-radius:9px;white-space:nowrap;color:{ink};'
        f'background:{paper}">{status}</span></div>'
        f'<div style="display:grid;grid-template-columns:auto 1fr;gap:1px 10px">{rows}</div>{note}</div>'
    )


@dataclass(frozen=True)
class Curves:
    """The columns of a plot over time."""

    times: Array
    """Shape (n,). [s]"""
    values: Array
    """Shape (n, k)."""
    y_range: tuple[float, float]
    """Ends of the vertical axis."""
    limits: Array = field(default_factory=lambda: np.zeros((2, 0)))
    """Further columns: the limits of the controls, and the tops of bars that mark when they are reached. (n, m)."""
    styles: tuple[dict[str, Any], ...] = ()
    """How Viser's plots draw each of `limits`."""
    bars: int = 0
    """Number of controls with bars."""

    @staticmethod
    def of(result: Result, trajectory: Trajectory, group: series.Group) -> Curves:
        """The curves of a group along one of the result's iterates."""
        times, values = series.curves(trajectory, group)
        found = series.limits(result, trajectory, group)
        active = None if found is None else found.active
        keep = series.thinning(values, _POINTS, active)
        times, values = times[keep], values[keep]
        if found is None or active is None:
            return Curves(times, values, series.value_range(values), np.zeros((len(times), 0)))
        lines = [(line[keep], curve) for line, curve in found.lines()]
        low, high = series.range_with_limits(values, [line for line, _ in lines])
        columns: list[Array] = [line for line, _ in lines]
        styles: list[dict[str, Any]] = [
            {"stroke": _SHARED if curve is None else series.COLORS[curve], "width": 1, "dash": _DASH}
            for _, curve in lines
        ]
        reached = np.flatnonzero(active.any(axis=0))
        bar = _BAR * (high - low)
        low -= bar * len(reached)
        for place, curve in enumerate(reached):
            foot = low + bar * place
            columns.append(foot + 0.8 * bar * active[keep, curve])
            styles.append({"fill": series.COLORS[curve], "fillTo": foot or 1e-300, "width": 0})
        more = np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))
        return Curves(times, values, (low, high), more, tuple(styles), len(reached))


class SignalPlot:
    """One plot of states, controls or outputs over time, with a choice of group and a legend of values."""

    def __init__(
        self,
        gui: viser.GuiApi,
        title: str,
        result: Result,
        groups: list[series.Group],
        changed: Callable[[], None],
        tall: bool = False,
    ) -> None:
        """Add the elements to the current container; `changed` is called when the reader chooses another group."""
        self._result = result
        self._height = _TALL if tall else _HEIGHT
        self._gui = gui
        self._groups = {group.title: group for group in groups}
        self._group = groups[0]
        self._trajectory: Trajectory | None = None
        self._curves = Curves(np.zeros(2), np.zeros((2, 1)), (-1.0, 1.0))
        self._plot: viser.GuiUplotHandle | None = None
        self._legend: viser.GuiHtmlHandle | None = None
        self._changed = changed
        self._holder = gui.add_folder(None)
        with self._holder:
            self._choice = gui.add_dropdown(title, tuple(self._groups), initial_value=self._group.title)
        self._choice.on_update(lambda _: self._choose())

    def set_trajectory(self, trajectory: Trajectory) -> None:
        """Draw the curves of `trajectory`."""
        self._trajectory = trajectory
        self._curves = Curves.of(self._result, trajectory, self._group)
        for element in (self._plot, self._legend):
            if element is not None:
                element.remove()
        with self._holder:
            self._plot = _uplot(
                self._gui,
                self._data(0.0),
                [*_strokes(self._group.labels), *self._curves.styles],
                (0.0, float(trajectory.times[-1])),
                self._curves.y_range,
                x_label="time [s]",
                y_label=self._group.unit and f"[{self._group.unit}]",
                height=self._height + round(_BAR_HEIGHT * self._curves.bars),
            )
            self._legend = self._gui.add_html(self._legend_html(0.0))

    def mark(self, time: float) -> None:
        """Move the mark to `time` [s]."""
        if self._plot is not None and self._legend is not None:
            self._plot.data = self._data(time)
            self._legend.content = self._legend_html(time)

    def _choose(self) -> None:
        self._group = self._groups[self._choice.value]
        self._changed()

    def _data(self, time: float) -> tuple[Array, ...]:
        curves = self._curves
        return with_mark(curves.times, np.hstack([curves.values, curves.limits]), time, curves.y_range)

    def _legend_html(self, time: float) -> str:
        assert self._trajectory is not None
        now = series.values_at(self._trajectory, self._group, time)
        entries = "".join(
            '<div style="display:flex;align-items:center;gap:5px;min-width:0">'
            f'<span style="flex:none;width:9px;height:3px;border-radius:2px;background:{color}"></span>'
            '<span style="overflow:hidden;text-overflow:ellipsis;white-space:nowrap;flex:1">'
            f"{html.escape(label)}</span>"
            f'<span style="opacity:.65;font-variant-numeric:tabular-nums">{value:.3g}</span></div>'
            for label, value, color in zip(self._group.labels, now, series.COLORS, strict=False)
        )
        said = _IN_FORCE_NOTE if self._group.kind == "constraints" else _LIMITS_NOTE if self._curves.styles else ""
        note = said and f'<div style="grid-column:1/-1;opacity:.65">{said}</div>'
        return (
            f'<div style="{_FONT};font-size:11px;display:grid;grid-template-columns:repeat(2,minmax(0,1fr));'
            f'gap:0 18px;padding:2px 14px 6px 12px">{entries}{note}</div>'
        )


class CostPlot:
    """Cost of each iteration, as its logarithm when it is positive and spans decades, with a mark at the one shown.

    Below it the largest violation, where there are constraints.
    """

    def __init__(self, gui: viser.GuiApi, result: Result) -> None:
        """Add the plot to the current container."""
        iterations, costs = series.costs(result)
        logarithmic = bool((costs > 0.0).all()) and costs.max() > 10.0 * costs.min()
        values = np.log10(costs) if logarithmic else costs
        self._plots = [_OverIterations(gui, iterations, values, "log10 cost" if logarithmic else "cost")]
        iterations, violations = series.violations(result)
        if result.violations and (violations > 0.0).any():
            values = np.log10(np.maximum(violations, _LEAST_VIOLATION))
            self._plots.append(_OverIterations(gui, iterations, values, "log10 violation"))

    def mark(self, iteration: float) -> None:
        """Move the mark to `iteration`."""
        for plot in self._plots:
            plot.mark(iteration)


class _OverIterations:
    """A curve over the iterations, with a mark."""

    def __init__(self, gui: viser.GuiApi, iterations: Array, values: Array, label: str) -> None:
        self._curves = (iterations, values[:, None])
        self._range = series.value_range(values)
        self._plot = _uplot(
            gui,
            with_mark(*self._curves, float(iterations[-1]), self._range),
            _strokes((label,), len(iterations) <= 40),
            (0.0, max(float(iterations[-1]), 1.0)),
            self._range,
            x_label="iteration",
            y_label=label,
            whole=True,
        )

    def mark(self, iteration: float) -> None:
        """Move the mark to `iteration`."""
        self._plot.data = with_mark(*self._curves, iteration, self._range)


def add_plot(
    gui: viser.GuiApi,
    x: Array,
    values: Array,
    labels: tuple[str, ...],
    y_range: tuple[float, float],
    x_label: str,
    y_label: str,
    *,
    whole: bool = False,
) -> None:
    """Add a plot of columns `values` (n, k) over `x` (n,) that stays as it is; its mark lies at the foot."""
    data = (x, *values.T, np.full(len(x), y_range[0]))
    x_range = (float(x[0]), max(float(x[-1]), float(x[0]) + 1e-9))
    _uplot(gui, data, _strokes(labels), x_range, y_range, x_label=x_label, y_label=y_label, whole=whole)


def with_mark(x: Array, values: Array, at: float, y_range: tuple[float, float]) -> tuple[Array, ...]:
    """Return x, every column of `values`, and a last curve that runs along the foot of the plot and rises at `at`.

    The curves get three more points at `at`, interpolated, so that all share one x as the plot demands.
    """
    here = int(np.searchsorted(x, at))
    now = [np.interp(at, x, column) if len(x) else np.nan for column in values.T]
    columns = [np.insert(column, here, np.full(3, value)) for column, value in zip(values.T, now, strict=True)]
    mark = np.full(len(x) + 3, y_range[0])
    mark[here + 1] = y_range[1]
    return (np.insert(x, here, np.full(3, at)), *columns, mark)


def _strokes(labels: Sequence[str], points: bool = False) -> list[dict[str, Any]]:
    """How the curves with these labels are drawn."""
    return [
        {"label": label, "stroke": color, "width": 1.5, "points": {"show": points, "size": 5, "fill": color}}
        for label, color in zip(labels, series.COLORS, strict=False)
    ]


def _uplot(
    gui: viser.GuiApi,
    data: tuple[Array, ...],
    styles: Sequence[dict[str, Any]],
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    *,
    x_label: str,
    y_label: str,
    height: int = _HEIGHT,
    whole: bool = False,
) -> viser.GuiUplotHandle:
    """Add a plot with a style for each curve but the last, the mark; `whole` keeps the ticks of x on whole numbers."""
    from viser import uplot

    lines: list[Any] = [uplot.Series(label=x_label)]
    plain: Any = {"label": "", "points": {"show": False}, "scale": "y"}
    lines += [plain | style for style in styles]
    lines.append(uplot.Series(label="", stroke=_MARK, width=1, points=uplot.Series_Points(show=False), scale="y"))
    axis: dict[str, Any] = {"labelSize": 18, "font": "11px system-ui", "labelFont": "11px system-ui", "labelGap": 0}
    x_axis: Any = axis | {"label": x_label, "size": 26}
    if whole:
        x_axis["incrs"] = tuple(step * 10**power for power in range(6) for step in (1, 2, 5))
    digits = max(len(f"{end:,.0f}") for end in y_range)
    y_axis: Any = axis | {"scale": "y", "size": 22 + 7 * max(digits, 4)} | ({"label": y_label} if y_label else {})
    return gui.add_uplot(
        data,
        tuple(lines),
        scales={"x": uplot.Scale(time=False, range=x_range), "y": uplot.Scale(range=y_range)},
        axes=(x_axis, y_axis),
        legend=uplot.Legend(show=False),
        cursor=uplot.Cursor(show=True, points=uplot.Cursor_Points(show=False)),
        height=height,
        padding=(10, 14, 0, 0),
    )
