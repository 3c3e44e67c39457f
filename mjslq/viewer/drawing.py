"""What a plot of signals draws: curves of one or several results on one time axis, and their limits.

Notation
--------
    x   times that all curves of a plot share, ascending; with controls each knot comes twice, since they jump there
    y   one axis a unit, at most two of them: left and right

Each limit is a dashed line. A bar at the foot of the plot, in the curve's colour, marks when a control or a joint is at
one of its limits, or a constraint in force. A result that is shorter than others ends where it ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.validation import Array
from mjslq.viewer import series
from mjslq.viewer.signals import Registry, Signal

AXES = 2
"""Units in one plot at most."""
_POINTS = 800  # more than pixels, so that nothing shows of the thinning
_SHARED, _DASH = "#9aa5b1", (5, 4)
"""Of the lines at limits."""
_DASHES: tuple[tuple[int, ...], ...] = ((), (7, 3), (2, 3), (9, 3, 2, 3), (4, 2), (1, 2), (12, 4), (6, 2, 1, 2))
"""By signal, where colours tell the results apart."""
_BAR = 0.035
"""Height of a bar, relative to the axis."""
SCALES = ("y", "y2")
"""Names of the axes in Viser's plots."""


@dataclass(frozen=True)
class Shown:
    """A result as it is shown: one of its iterates, in a colour."""

    result: Result
    trajectory: Trajectory
    registry: Registry
    color: str = ""
    """Of all its curves; each has its own where it is empty."""
    label: str = ""
    """What legends call it."""


@dataclass(frozen=True)
class Line:
    """A curve in a plot."""

    shown: Shown
    signal: Signal
    color: str
    dash: tuple[int, ...]
    axis: int
    """0 for the left axis, 1 for the right one."""


@dataclass(frozen=True)
class Drawing:
    """The columns of a plot and how each is drawn."""

    x: Array
    """Times. Shape (n,). [s]"""
    columns: Array
    """The curves, then the lines of limits, then the tops of bars. Shape (n, c)."""
    styles: tuple[dict[str, Any], ...]
    """How Viser's plots draw each of the columns. Length c."""
    ranges: tuple[tuple[float, float], ...]
    """Ends of each vertical axis."""
    units: tuple[str, ...]
    """Unit of each axis."""
    lines: tuple[Line, ...]
    """The curves, in the order of the columns."""
    bars: int
    """Number of bars."""


def units_of(shown: Sequence[Shown], names: Sequence[str]) -> tuple[str, ...]:
    """Units of the signals with these names, each once."""
    found = [one.registry.signals[name].unit for name in names for one in shown if name in one.registry.signals]
    return tuple(dict.fromkeys(found))


def lines_of(shown: Sequence[Shown], names: Sequence[str]) -> tuple[Line, ...]:
    """One line for each signal of each result that has it."""
    units = units_of(shown, names)
    found = []
    for place, name in enumerate(names):
        for one in shown:
            signal = one.registry.signals.get(name)
            if signal is not None:
                color = one.color or series.COLORS[place % len(series.COLORS)]
                dash = _DASHES[place % len(_DASHES)] if one.color else ()
                found.append(Line(one, signal, color, dash, min(units.index(signal.unit), AXES - 1)))
    return tuple(found)


def draw(shown: Sequence[Shown], names: Sequence[str]) -> Drawing:
    """Draw the signals with these names along the trajectories that are shown."""
    lines = lines_of(shown, names)
    if not lines:
        return Drawing(np.zeros(2), np.zeros((2, 0)), (), ((-1.0, 1.0),), ("",), (), 0)
    curves = [series.curves(line.shown.trajectory, line.signal.group) for line in lines]
    limits = [series.limits(line.shown.result, line.shown.trajectory, line.signal.group) for line in lines]
    axis = _Axis([times for times, _ in curves], any(line.signal.group.held for line in lines))
    values = _stacked([axis.values(times, y[:, 0], line) for (times, y), line in zip(curves, lines, strict=True)])
    active = np.zeros(values.shape, np.bool_)
    for place, (line, (times, _), found) in enumerate(zip(lines, curves, limits, strict=True)):
        if found is not None:
            active[:, place] = axis.values(times, found.active[:, 0].astype(float), line) >= 0.5
    keep = series.thinning(np.nan_to_num(values), _POINTS, active)
    x, values, active = axis.x[keep], values[keep], active[keep]
    edges = _edges(lines, curves, limits, axis, keep)
    ranges = [
        _range(values, [edge for edge in edges if edge.axis == a], lines, a) for a in sorted({e.axis for e in lines})
    ]
    styles = [{"stroke": line.color, "width": 1.5, "scale": SCALES[line.axis]} | _dashed(line) for line in lines]
    styles += [{"stroke": e.color, "width": 1, "dash": _DASH, "scale": SCALES[e.axis]} for e in edges]
    columns = [*values.T, *(edge.values for edge in edges)]
    reached = np.flatnonzero(active.any(axis=0))
    low, high = ranges[0]
    bar = _BAR * (high - low)
    low -= bar * len(reached)
    ranges[0] = (low, high)
    for row, curve in enumerate(reached):
        foot = low + bar * row
        columns.append(foot + 0.8 * bar * active[:, curve])
        styles.append({"fill": lines[curve].color, "fillTo": foot or 1e-300, "width": 0, "scale": SCALES[0]})
    units = tuple(next(line.signal.unit for line in lines if line.axis == a) for a in range(len(ranges)))
    return Drawing(x, _stacked(columns), tuple(styles), tuple(ranges), units, lines, len(reached))


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


@dataclass(frozen=True)
class _Edge:
    """The line of a limit."""

    values: Array
    color: str
    axis: int


def _edges(
    lines: Sequence[Line],
    curves: Sequence[tuple[Array, Array]],
    limits: Sequence[series.Limits | None],
    axis: _Axis,
    keep: NDArray[np.intp],
) -> list[_Edge]:
    """Lines at the limits, those that several curves share once and in a neutral colour."""
    shared: dict[tuple[bytes, int], _Edge] = {}
    for line, (times, _), found in zip(lines, curves, limits, strict=True):
        for limit in () if found is None else (found.upper[:, 0], found.lower[:, 0]):
            if not np.isfinite(limit).all():
                continue
            values = axis.values(times, limit, line)[keep]
            key = (np.nan_to_num(values, nan=np.inf).tobytes(), line.axis)
            color = line.color if shared.get(key, line).color == line.color else _SHARED
            shared[key] = _Edge(values, color, line.axis)
    return list(shared.values())


def _range(values: Array, edges: list[_Edge], lines: Sequence[Line], axis: int) -> tuple[float, float]:
    own = values[:, [place for place, line in enumerate(lines) if line.axis == axis]]
    own_edges = [edge.values[np.isfinite(edge.values)] for edge in edges if edge.axis == axis]
    return series.range_with_limits(own, own_edges)


class _Axis:
    """The times that the curves of a plot share."""

    def __init__(self, times: Sequence[Array], held: bool) -> None:
        self._knots = np.unique(np.concatenate([np.zeros(1), *times]))
        self._twice = held and len(self._knots) > 1
        self.x = np.repeat(self._knots, 2)[1:-1] if self._twice else self._knots

    def values(self, times: Array, values: Array, line: Line) -> Array:
        """One curve at the times of the axis; NaN beyond its end. Shape (n,)."""
        if not len(times):
            return np.full(len(self.x), np.nan)
        if not line.signal.group.held or len(times) < 2:
            return np.interp(self.x, times, values, right=np.nan)
        starts, of_steps, end = times[::2], values[::2], times[-1]
        from_right, from_left = self.x[::2], self.x[1::2]  # the value of the step that begins there, and that ends
        found = np.empty(len(self.x))
        found[::2] = of_steps[np.maximum(np.searchsorted(starts, from_right, side="right") - 1, 0)]
        found[1::2] = of_steps[np.maximum(np.searchsorted(starts, from_left, side="left") - 1, 0)]
        found[::2][from_right >= end] = np.nan
        found[1::2][from_left > end] = np.nan
        return found


def _stacked(columns: Sequence[Array]) -> Array:
    return np.stack(columns, axis=1)


def _dashed(line: Line) -> dict[str, Any]:
    return {"dash": line.dash} if line.dash else {}
