"""The curves of a result, in groups that fit a plot: states, controls, outputs, multipliers, ..., named, with units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjslq.log import IterationLog
from mjslq.reports import in_force
from mjslq.reports.limits import NEAR, reached
from mjslq.reports.units import control_kinds, position_limits, sensor_kinds, state_kinds
from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.validation import Array
from mjslq.viewer.motion import finite_knots

PER_PLOT = 8
"""Curves in one plot at most."""

KINDS = (("States", "states"), ("Controls", "controls"), ("Outputs", "outputs"), ("Constraints", "constraints"))
"""What is plotted over time: title and kind."""
MORE_KINDS = (
    ("Residuals of the cost", "residuals"),
    ("Multipliers of control limits", "limit multipliers"),
    ("Costates", "costates"),
    ("Gradient", "gradient"),
)
"""What else can be plotted when it is asked for."""
HELD = ("controls", "limit multipliers", "gradient")
"""Kinds with one value a step, held over it; others have one a knot."""
COLORS = ("#2f6fb3", "#d6592b", "#2b8f6d", "#b04a8c", "#c29a1c", "#5b5fc7", "#7a8794", "#8c5a3c")
"""One a curve, told apart by lightness too. Length `PER_PLOT`."""


@dataclass(frozen=True)
class Group:
    """Curves that share a unit and a plot."""

    title: str
    """What the choice is called, unit included."""
    kind: str
    """One of `KINDS` or `MORE_KINDS`."""
    columns: tuple[int, ...]
    """Columns of the trajectory's X, U or Y, or of `data`."""
    labels: tuple[str, ...]
    """Name of each column."""
    unit: str
    """Unit of all of them; empty when unknown."""
    data: Array | None = field(default=None, compare=False)
    """Values that belong to the result, whichever iterate is shown. Shape (N + 1, columns) | (N, columns)."""
    ends: tuple[Array, Array] | None = field(default=None, compare=False)
    """Lower and upper limits of states, infinite where there are none. Shapes (k,)."""

    @property
    def held(self) -> bool:
        """Whether there is one value a step, and not one a knot."""
        return self.kind in HELD


def groups(result: Result, kind: str, model: Any = None) -> list[Group]:
    """Return the plots of a kind, one of `KINDS` or `MORE_KINDS`.

    `model` gives the units of its coordinates and sensors, and the ranges of its joints. Constraints have their
    multipliers, the largest at each knot, and their violations.
    """
    if kind in ("constraints", "residuals"):
        named = {"residuals": _acting_along(result.residuals)}
        if kind == "constraints":
            named = {"multipliers": in_force.multipliers(result), "violations": result.violations}
        return [group for title, columns in named.items() if columns for group in _by_name(title, kind, columns)]
    data = _of_result(result, kind)
    if data is None and kind not in ("states", "controls", "outputs"):
        return []
    size = (_array(result.trajectory, kind) if data is None else data).shape[1]
    labels = _labels(result, kind, size)
    kinds, ends = [(kind, "")] * size, None
    if model is not None:
        kinds = _units(result, kind, model, size) or kinds
        if kind == "states" and result.scene is not None and not result.scene.lines:
            low, high = position_limits(model, result.scene.columns, size)
            ends = (np.array(low), np.array(high))
    found = []
    for name, unit in dict.fromkeys(kinds):
        members = [i for i in range(size) if kinds[i] == (name, unit)]
        for start in range(0, len(members), PER_PLOT):
            columns = members[start : start + PER_PLOT]
            title = f"{name} [{unit}]" if unit else name
            if len(members) > PER_PLOT:
                title += f", {start + 1} to {start + len(columns)} of {len(members)}"
            own = None if ends is None else (ends[0][columns], ends[1][columns])
            found.append(Group(title, kind, tuple(columns), tuple(labels[i] for i in columns), unit, data, own))
    return found


def _of_result(result: Result, kind: str) -> Array | None:
    """Values of a kind that belong to the result and not to the iterate shown."""
    of_kind = {
        "costates": result.costates,
        "gradient": result.gradient,
        "limit multipliers": result.multipliers.get("controls"),
    }
    return of_kind.get(kind)


def _labels(result: Result, kind: str, size: int) -> tuple[str, ...]:
    """Names of the entries of a kind; letters with numbers where the result has none."""
    letter, names = {
        "states": ("x", "states"),
        "outputs": ("y", "outputs"),
        "costates": ("dx", "states"),
    }.get(kind, ("u", "controls"))
    given = tuple(result.names.get(names, ()))
    if kind == "costates" and len(given) != size and result.space is not None and len(given) == result.space.nx:
        given = _tangent_names(result, given)
    return given if len(given) == size else tuple(f"{letter}[{i}]" for i in range(size))


def _tangent_names(result: Result, names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the tangent directions of a state: its own, and the turns of its rotations by their first entry."""
    assert result.space is not None
    found = [""] * result.space.ndx
    grouped = {int(i) for part in result.space.parts for i in part.x.ravel()}
    for part in result.space.parts:
        for x, dx in zip(part.x, part.dx, strict=True):
            for place, direction in enumerate(dx):
                found[int(direction)] = f"{names[int(x[0])]}, direction {place + 1}"
    plain = iter(name for i, name in enumerate(names) if i not in grouped)
    return tuple(name or next(plain, "") for name in found)


def _units(result: Result, kind: str, model: Any, size: int) -> list[tuple[str, str]] | None:
    """Kind and unit of each entry, as far as the model tells."""
    if kind == "states" and result.scene is not None:
        return state_kinds(model, result.scene.columns, size)
    if kind == "controls" and model.nu == size:
        return control_kinds(model)
    if kind == "outputs" and model.nsensordata == size:
        return sensor_kinds(model)
    return None


def curves(trajectory: Trajectory, group: Group) -> tuple[Array, Array]:
    """Return times (n,) [s] and values (n, k) of a group, as far as they are finite.

    Controls are held over their step, so each is given at both its ends: n = 2 N.
    """
    good = max(finite_knots(trajectory), 1)
    values = _values(trajectory, group)
    if group.held:
        steps = min(max(good - 1, 1), len(values))
        times = np.stack([trajectory.times[:steps], trajectory.times[1 : steps + 1]], axis=1).ravel()
        return times, np.repeat(values[:steps], 2, axis=0)
    finite = np.isfinite(values[:good]).all(axis=1)
    return trajectory.times[:good][finite], values[:good][finite]


@dataclass(frozen=True)
class Limits:
    """Limits of a group's curves, at the times that `curves` gives these at; constraints have no lines."""

    lower: Array
    """-inf where there is none. Shape (n, k)."""
    upper: Array
    """Shape (n, k)."""
    active: NDArray[np.bool_]
    """Whether a control or a state is at one of its limits, or a constraint in force. Shape (n, k)."""

    def lines(self) -> list[tuple[Array, int | None]]:
        """The finite limits, each once: values (n,), and the curve whose limit it is, None where several share it."""
        shared: dict[bytes, list[int]] = {}
        columns = [limit[:, i] for limit in (self.upper, self.lower) for i in range(limit.shape[1])]
        for place, column in enumerate(columns):
            if np.isfinite(column).all():
                shared.setdefault(column.tobytes(), []).append(place)
        count = self.lower.shape[1]
        return [(columns[m[0]], m[0] % count if len({i % count for i in m}) == 1 else None) for m in shared.values()]


def limits(result: Result, trajectory: Trajectory, group: Group) -> Limits | None:
    """Return the limits of a group along one of the result's iterates; None where nothing in it has any."""
    columns = list(group.columns)
    if group.kind == "constraints":
        touching = in_force.touching(result)
        none = np.zeros(len(trajectory.X), np.bool_)
        active = np.stack([touching.get(label, none) for label in group.labels], axis=1)
        count = len(curves(trajectory, group)[0])
        unlimited = np.full((count, len(columns)), np.inf)
        return Limits(-unlimited, unlimited, active[:count])
    if group.kind == "states" and group.ends is not None:
        return _of_states(trajectory, group)
    if group.kind != "controls":
        return None
    lower, upper = result.lower[:, columns], result.upper[:, columns]
    if not (np.isfinite(lower).any() or np.isfinite(upper).any()):
        return None
    active = reached(result, trajectory.U)[:, columns] != 0
    steps = len(curves(trajectory, group)[0]) // 2
    lower, upper, active = (np.repeat(part[:steps], 2, axis=0) for part in (lower, upper, active))
    return Limits(lower, upper, active)


def _of_states(trajectory: Trajectory, group: Group) -> Limits | None:
    assert group.ends is not None
    lower, upper = group.ends
    if not np.isfinite([lower, upper]).any():
        return None
    values = curves(trajectory, group)[1]
    room = NEAR * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    active = (values <= lower + room) | (values >= upper - room)
    return Limits(np.broadcast_to(lower, values.shape), np.broadcast_to(upper, values.shape), active)


def range_with_limits(values: Array, lines: Sequence[Array], room: float = 0.08) -> tuple[float, float]:
    """Return limits of an axis for `values`, and for those `lines` that do not more than double it."""
    low, high = value_range(values, room)
    near = [line for line in lines if low - (high - low) <= line.min() and line.max() <= high + (high - low)]
    return value_range(np.concatenate([values.ravel(), *near]), room) if near else (low, high)


def values_at(trajectory: Trajectory, group: Group, time: float) -> Array:
    """Return the values (k,) of a group at `time` [s]; NaN where the trajectory holds none."""
    times = trajectory.times
    values = _values(trajectory, group)
    if group.held:
        step = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(values) - 1))
        return np.asarray(values[step])
    return np.array([np.interp(time, times, column) for column in values.T])


def value_range(values: Array, room: float = 0.08) -> tuple[float, float]:
    """Return limits for an axis that hold all finite `values` with some room; never empty."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    span = high - low
    if span <= 1e-9 * max(abs(low), abs(high), 1e-9):
        span = abs(low) or 1.0
    return low - room * span, high + room * span


def thinning(values: Array, most: int, switches: NDArray[np.bool_] | None = None) -> NDArray[np.intp]:
    """Return indices of at most about `most` points (n, k) that keep the extremes of every stretch that is dropped.

    Points where a column of `switches` (n, m) changes are kept as well, with those before them.
    """
    if len(values) <= most:
        return np.arange(len(values))
    keep = {0, len(values) - 1}
    for stretch in np.array_split(np.arange(len(values)), max(most // (2 * values.shape[1]), 2)):
        keep.update(stretch[np.argmin(values[stretch], axis=0)])
        keep.update(stretch[np.argmax(values[stretch], axis=0)])
    if switches is not None:
        after = np.flatnonzero((switches[1:] != switches[:-1]).any(axis=1)) + 1
        keep.update(after, after - 1)
    return np.array(sorted(keep), dtype=np.intp)


def violations(log: Sequence[IterationLog]) -> tuple[Array, Array]:
    """Return iterations and the largest violations of a log, where they are finite. Shapes (n,)."""
    entries = [(entry.iteration, entry.violation) for entry in log if np.isfinite(entry.violation)]
    return np.array([i for i, _ in entries], dtype=float), np.array([v for _, v in entries], dtype=float)


def costs(log: Sequence[IterationLog]) -> tuple[Array, Array]:
    """Return iterations and costs of a log, where the cost is finite. Shapes (n,)."""
    entries = [(entry.iteration, entry.cost) for entry in log if np.isfinite(entry.cost)]
    return np.array([i for i, _ in entries], dtype=float), np.array([c for _, c in entries], dtype=float)


def _acting_along(residuals: dict[str, Array]) -> dict[str, Array]:
    """Those that act at more knots than one, which make a curve."""
    return {name: sizes for name, sizes in residuals.items() if np.isfinite(sizes).sum() > 1}


def _by_name(title: str, kind: str, named: dict[str, Array]) -> list[Group]:
    """Plots of curves over the knots, by the name of what they belong to."""
    names, found = list(named), []
    for start in range(0, len(names), PER_PLOT):
        labels = tuple(names[start : start + PER_PLOT])
        told = title if len(names) <= PER_PLOT else f"{title}, {start + 1} to {start + len(labels)} of {len(names)}"
        data = np.stack([named[name] for name in labels], axis=1)
        found.append(Group(told, kind, tuple(range(len(labels))), labels, "", data))
    return found


def _values(trajectory: Trajectory, group: Group) -> Array:
    """The values of a group at all knots or steps. Shape (N + 1, k) | (N, k)."""
    whole = _array(trajectory, group.kind) if group.data is None else group.data
    return whole[:, list(group.columns)]


def _array(trajectory: Trajectory, kind: str) -> Array:
    return {"states": trajectory.X, "controls": trajectory.U, "outputs": trajectory.Y}[kind]
