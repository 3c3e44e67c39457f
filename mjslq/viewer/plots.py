"""Plots in the browser: signals over time, chosen from lists, and costs over iterations; each has a mark.

A plot is changed in place where its curves keep their number and their look, and made anew otherwise.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.log import IterationLog
from mjslq.validation import Array
from mjslq.viewer import drawing, series
from mjslq.viewer.drawing import Drawing, Shown, with_mark

if TYPE_CHECKING:
    import viser

HEIGHT, TALL = 190, 280
"""Of a plot; beside a robot, and alone. [px]"""
MARK = "#6b7785"
"""Of the mark: seen on white as on black."""
_LEAST_VIOLATION = 1e-12
"""What is plotted for a violation of zero."""
_BAR_HEIGHT = 5
"""What a plot is higher by for each bar. [px]"""
_LIMITS_NOTE = "dashed: limits; bars on the time axis: at a limit"
_IN_FORCE_NOTE = "of the result; bars on the time axis: in force"
_OF_RESULT_NOTE = "of the result, whichever iterate is shown"
_ITERATIONS = 600
"""Points of a curve over iterations, at most about."""
_PULSE = "pulse"
"""Scale of a column that is not seen; see `UPlot`."""
_TURNS = 1000
"""Values that the column takes in turn: several changes that reach the page at once must not add up to none."""
_REMOVE = "(remove this plot)"
_OWN = "(own choice)"


class PlotCard:
    """A plot of signals over time: a menu of groups, a menu of signals to add or take away, a legend of values."""

    def __init__(
        self,
        gui: viser.GuiApi,
        groups: dict[str, list[str]],
        first: str,
        changed: Callable[[], None],
        removed: Callable[[PlotCard], None],
        tall: bool = False,
    ) -> None:
        """Add the elements to the current container, with the group `first` in the plot.

        `groups` has the names of the signals of each group. `changed` is called when the reader chooses another, and
        `removed` when the plot is to go.
        """
        self.names: list[str] = list(groups[first])
        """Names of the signals in the plot."""
        self._gui, self._groups, self._height = gui, groups, TALL if tall else HEIGHT
        self._drawn: Drawing | None = None
        self._shown: Sequence[Shown] = ()
        self._plot: UPlot | None = None
        self._legend: viser.GuiHtmlHandle | None = None
        self._changed, self._removed = changed, removed
        self._holder = gui.add_folder(None)
        with self._holder:
            self._menu = gui.add_dropdown("Plot", (*groups, _OWN, _REMOVE), initial_value=first)
            self._signals = gui.add_dropdown("Signals", self._offered())
        self._menu.on_update(lambda event: self._choose_group(event))
        self._signals.on_update(lambda event: self._choose_signal(event))

    def show(self, shown: Sequence[Shown], time: float = 0.0) -> None:
        """Draw the curves of what is shown."""
        self._shown, self._drawn = shown, drawing.draw(shown, self.names)
        drawn = self._drawn
        look = {
            "styles": drawn.styles,
            "y_labels": tuple(f"[{unit}]" if unit else "" for unit in drawn.units),
            "height": self._height + round(_BAR_HEIGHT * drawn.bars),
        }
        x_range = (0.0, max(float(one.trajectory.times[-1]) for one in shown))
        if self._plot is None or not self._plot.change(self._data(time), x_range, drawn.ranges, look):
            for element in (self._plot, self._legend):
                if element is not None:
                    element.remove()
            with self._holder:
                self._plot = UPlot(self._gui, self._data(time), x_range, drawn.ranges, "time [s]", look)
                self._legend = self._gui.add_html(self._legend_html(time))
        assert self._legend is not None
        self._legend.content = self._legend_html(time)

    def mark(self, time: float) -> None:
        """Move the mark to `time` [s]."""
        if self._plot is not None and self._legend is not None:
            self._plot.set_data(self._data(time))
            self._legend.content = self._legend_html(time)

    def choose(self, names: Sequence[str]) -> None:
        """Plot the signals with these names, in one or two units. Raises ValueError for unknown names and more units.

        Call `show` afterwards.
        """
        known = [name for group in self._groups.values() for name in group]
        for name in names:
            if name not in known:
                raise ValueError(f"unknown signal {name!r}; there are: {', '.join(known)}")
        if len(units := drawing.units_of(self._shown, names)) > drawing.AXES:
            said = ", ".join(f"[{unit}]" if unit else "no unit" for unit in units)
            raise ValueError(f"a plot has two axes, but these signals have {said}; add another plot")
        self.names = list(names)
        self._follow()

    def remove(self) -> None:
        """Take it from the page."""
        self._holder.remove()

    def _choose_group(self, event: Any) -> None:
        if event.client_id is None:  # set from Python
            return
        if event.target.value == _REMOVE:
            self._removed(self)
        elif event.target.value in self._groups:
            self.names = list(self._groups[event.target.value])
            self._follow()
            self._changed()

    def _choose_signal(self, event: Any) -> None:
        if event.client_id is None or event.target.value == self._heading():
            return
        name = event.target.value[len(_mark(True)) :]
        names = [one for one in self.names if one != name] if name in self.names else [*self.names, name]
        try:
            self.choose(names)
        except ValueError as error:
            self._follow()
            if event.client is not None:
                event.client.add_notification("Not in this plot", str(error), auto_close_seconds=6.0)
            return
        self._changed()

    def _follow(self) -> None:
        """Set the menus to what is plotted."""
        group = next((title for title, names in self._groups.items() if names == self.names), _OWN)
        menu: Any = self._menu
        if menu.value != group:
            menu.value = group
        self._signals.options = self._offered()
        choice: Any = self._signals
        choice.value = self._heading()

    def _heading(self) -> str:
        total = sum(len(names) for names in self._groups.values())
        return f"{len(self.names)} of {total}: add or take away"

    def _offered(self) -> tuple[str, ...]:
        known = dict.fromkeys(name for names in self._groups.values() for name in names)
        return (self._heading(), *(_mark(name in self.names) + name for name in known))

    def _data(self, time: float) -> tuple[Array, ...]:
        assert self._drawn is not None
        return with_mark(self._drawn.x, self._drawn.columns, time, self._drawn.ranges[0])

    def _legend_html(self, time: float) -> str:
        assert self._drawn is not None
        several = any(one.label for one in self._shown)
        entries = []
        for line in self._drawn.lines:
            value = series.values_at(line.shown.trajectory, line.signal.group, time)[0]
            label = f"{line.signal.label}, {line.shown.label}" if several else line.signal.label
            unit = f" {line.signal.unit}" if len(self._drawn.units) > 1 and line.signal.unit else ""
            entries.append(_entry(line.color, bool(line.dash), label, f"{value:.3g}{unit}"))
        note = self._note()
        told = note and f'<div style="grid-column:1/-1;opacity:.65">{note}</div>'
        columns = 1 if several or len(self._drawn.units) > 1 else 2
        return (
            f'<div style="font-size:11px;line-height:1.55;display:grid;gap:0 18px;padding:2px 14px 6px 12px;'
            f'grid-template-columns:repeat({columns},minmax(0,1fr))">{"".join(entries)}{told}</div>'
        )

    def _note(self) -> str:
        assert self._drawn is not None
        kinds = {line.signal.group.kind for line in self._drawn.lines}
        if not kinds:
            return "no signal is chosen"
        if kinds == {"constraints"}:
            return _IN_FORCE_NOTE
        if all(line.signal.group.data is not None for line in self._drawn.lines):
            return _OF_RESULT_NOTE
        return _LIMITS_NOTE if len(self._drawn.styles) > len(self._drawn.lines) else ""


class CostPlot:
    """Cost of each iteration, as its logarithm when it is positive and spans decades, with a mark at the one shown.

    Below it the largest violation, where there are constraints.
    """

    def __init__(
        self, gui: viser.GuiApi, log: Sequence[IterationLog], constrained: bool, growing: bool = False
    ) -> None:
        """Add the plots to the current container; a `growing` log gets axes with room, which change seldom."""
        self._gui, self._constrained, self._growing = gui, constrained, growing
        self._room: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {}
        self._holder = gui.add_folder(None)
        self._plots: dict[str, UPlot] = {}
        self._curves: dict[str, tuple[Array, Array, tuple[float, float]]] = {}
        self.update(log)

    def update(self, log: Sequence[IterationLog]) -> None:
        """Draw the curves of a log, that of a solve at work for one."""
        iterations, costs = series.costs(log)
        if len(costs):
            logarithmic = bool((costs > 0.0).all()) and costs.max() > 10.0 * costs.min()
            self._draw(
                "cost", iterations, np.log10(costs) if logarithmic else costs, "log10 cost" if logarithmic else "cost"
            )
        iterations, violations = series.violations(log)
        if self._constrained and (violations > 0.0).any():
            self._draw("violation", iterations, np.log10(np.maximum(violations, _LEAST_VIOLATION)), "log10 violation")

    def mark(self, iteration: float) -> None:
        """Move the mark to `iteration`."""
        for what, plot in self._plots.items():
            iterations, values, y_range = self._curves[what]
            plot.set_data(with_mark(iterations, values, iteration, y_range))

    def _roomy(
        self, what: str, x_range: tuple[float, float], y_range: tuple[float, float]
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """The axes that a plot has, if they hold these ranges and are not much larger; else axes with room ahead."""
        (_, end), (low, high) = self._room.get(what, ((0.0, 0.0), (0.0, 0.0)))
        if end < x_range[1]:
            end = max(1.5 * x_range[1], 10.0)
        if low > y_range[0] or high < y_range[1] or high - low > 3.0 * (y_range[1] - y_range[0]):
            room = 0.25 * (y_range[1] - y_range[0])
            low, high = y_range[0] - room, y_range[1] + room
        self._room[what] = ((0.0, end), (low, high))
        return self._room[what]

    def _draw(self, what: str, iterations: Array, values: Array, label: str) -> None:
        keep = series.thinning(values[:, None], _ITERATIONS)
        iterations, values = iterations[keep], values[keep]
        x_range, y_range = (0.0, max(float(iterations[-1]), 1.0)), series.value_range(values)
        if self._growing:
            x_range, y_range = self._roomy(what, x_range, y_range)
        self._curves[what] = (iterations, values[:, None], y_range)
        data = with_mark(iterations, values[:, None], float(iterations[-1]), y_range)
        points = {"show": len(iterations) <= 40, "size": 5, "fill": series.COLORS[0]}
        style = {"label": label, "stroke": series.COLORS[0], "width": 1.5, "points": points}
        look = {"styles": (style,), "y_labels": (label,), "whole": True}
        plot = self._plots.get(what)
        if plot is None or not plot.change(data, x_range, (y_range,), look):
            if plot is not None:
                plot.remove()
            with self._holder:
                self._plots[what] = UPlot(self._gui, data, x_range, (y_range,), "iteration", look)


class UPlot:
    """One of Viser's plots, with a style for each curve but the last, the mark."""

    def __init__(
        self,
        gui: viser.GuiApi,
        data: tuple[Array, ...],
        x_range: tuple[float, float],
        ranges: Sequence[tuple[float, float]],
        x_label: str,
        look: dict[str, Any],
    ) -> None:
        """Add it to the current container.

        `data` is x, the curves and the mark; `ranges` are those of one or two vertical axes. `look` has the `styles`
        of the curves and the `y_labels` of the axes; `height` [px] if not 190, and `whole` where the ticks of x are
        whole numbers.
        """
        from viser import uplot

        self._look, self._ranges, self._turn = look, (x_range, *ranges), 1
        lines: list[Any] = [uplot.Series(label=x_label)]
        plain: Any = {"label": "", "points": {"show": False}, "scale": "y"}
        lines += [plain | style for style in look["styles"]]
        lines.append(plain | {"stroke": MARK, "width": 1})
        lines.append(plain | {"width": 0, "scale": _PULSE})
        axis: dict[str, Any] = {"labelSize": 18, "font": "11px system-ui", "labelFont": "11px system-ui", "labelGap": 0}
        powers = range(0 if look.get("whole") else -6, 6)
        steps = tuple(step * 10.0**power for power in powers for step in (1, 2, 5))
        x_axis: Any = axis | {"label": x_label, "size": 26, "incrs": steps}
        axes = [x_axis]
        for place, (label, ends) in enumerate(zip(look["y_labels"], ranges, strict=False)):
            digits = max(len(f"{end:,.0f}") for end in ends)
            y_axis: Any = axis | {"scale": drawing.SCALES[place], "size": 22 + 7 * max(digits, 4)}
            y_axis |= {"label": label} if label else {}
            axes.append(y_axis | ({"side": 1, "grid": {"show": False}} if place else {}))
        self._handle = gui.add_uplot(
            self._with_pulse(data),
            tuple(lines),
            scales=_scales(x_range, ranges),
            axes=tuple(axes),
            legend=uplot.Legend(show=False),
            cursor=uplot.Cursor(show=True, points=uplot.Cursor_Points(show=False)),
            height=look.get("height", HEIGHT),
            padding=(10, 14 if len(ranges) == 1 else 0, 0, 0),
        )

    def change(
        self,
        data: tuple[Array, ...],
        x_range: tuple[float, float],
        ranges: Sequence[tuple[float, float]],
        look: dict[str, Any],
    ) -> bool:
        """Show other data in the same look; False where the look is another one, and nothing was done."""
        if look != self._look:
            return False
        if self._ranges != (x_range, *ranges):
            self._ranges = (x_range, *ranges)
            self._handle.scales = _scales(x_range, ranges)
        self.set_data(data)
        return True

    def set_data(self, data: tuple[Array, ...]) -> None:
        """Show other data on the same axes."""
        self._turn = self._turn % _TURNS + 1
        self._handle.data = self._with_pulse(data)

    def _with_pulse(self, data: tuple[Array, ...]) -> tuple[Array, ...]:
        """Data with one more column, not seen, whose scale is another one each time.

        Else uPlot (1.6) may show no numbers along x: data that come while a plot finds its place on the page make it
        forget to lay out the axes, until the scale of one of its curves changes.
        """
        pulse = np.zeros(len(data[0]))
        pulse[-1:] = self._turn
        return (*data, pulse)

    def remove(self) -> None:
        """Take it from the page."""
        self._handle.remove()


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
    styles = tuple(
        {"label": label, "stroke": color, "width": 1.5} for label, color in zip(labels, series.COLORS, strict=False)
    )
    x_range = (float(x[0]), max(float(x[-1]), float(x[0]) + 1e-9))
    UPlot(gui, data, x_range, (y_range,), x_label, {"styles": styles, "y_labels": (y_label,), "whole": whole})


def _scales(x_range: tuple[float, float], ranges: Sequence[tuple[float, float]]) -> Any:
    from viser import uplot

    scales: dict[str, Any] = {"x": uplot.Scale(time=False, range=x_range), _PULSE: uplot.Scale(auto=True)}
    return scales | {name: uplot.Scale(range=ends) for name, ends in zip(drawing.SCALES, ranges, strict=False)}


def _mark(chosen: bool) -> str:
    """What stands before a signal's name in the menu. Always of the same length."""
    return "\u2713 " if chosen else "+ "


def _entry(color: str, dashed: bool, label: str, value: str) -> str:
    line = f"border-top:2px {'dashed' if dashed else 'solid'} {color}"
    return (
        '<div style="display:flex;align-items:center;gap:5px;min-width:0">'
        f'<span style="flex:none;width:14px;{line}"></span>'
        '<span style="overflow:hidden;text-overflow:ellipsis;white-space:nowrap;flex:1">'
        f"{html.escape(label)}</span>"
        f'<span style="opacity:.65;font-variant-numeric:tabular-nums">{value}</span></div>'
    )
