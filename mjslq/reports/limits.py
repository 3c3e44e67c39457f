"""Which controls are at their limits, and when: for summaries, plots and pages.

A control counts as at a limit when it is within `NEAR` of it, relative to the range between its limits: steps of less
than full size come ever nearer to a limit without touching it (`Result.active_limits` tells which do). Step n lasts
from t_n to t_{n+1}; steps in a row make a span.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjslq.reports.units import control_kinds, model_from_mjb
from mjslq.result import Result
from mjslq.validation import Array

NEAR = 1e-3
"""Distance from a limit, relative to the range of the control, or to the limit where the other one is infinite."""
MOST_SPANS, MOST_CONTROLS = 3, 4
"""What a line of text can hold; beyond it there are totals."""


@dataclass(frozen=True)
class AtLimit:
    """A control at one of its limits."""

    control: int
    """Index of the control."""
    name: str
    """Name of the control."""
    side: int
    """1 for the upper limit, -1 for the lower one."""
    limit: float | None
    """The limit; None where it is not the same over all of `spans`."""
    spans: tuple[tuple[float, float], ...]
    """When: start and end of each span. [s]"""

    @property
    def seconds(self) -> float:
        """Length of all spans together. [s]"""
        return sum(end - start for start, end in self.spans)


def at_limits(result: Result) -> list[AtLimit]:
    """Controls at their limits, in the order of the controls, upper limits first; empty when there are none."""
    sides, times = reached(result, result.trajectory.U), result.trajectory.times
    names = _names(result)
    found = []
    for control in range(sides.shape[1]):
        for side, limits in ((1, result.upper), (-1, result.lower)):
            at = sides[:, control] == side
            if not at.any():
                continue
            values = np.unique(limits[at, control])
            limit = float(values[0]) if len(values) == 1 else None
            found.append(AtLimit(control, names[control], side, limit, spans(at, times)))
    return found


def reached(result: Result, U: Array) -> NDArray[np.int8]:
    """1 where controls `U` (N, nu) are at their upper limit, -1 at their lower one, 0 between. Shape (N, nu)."""
    lower, upper = result.lower, result.upper
    whole, one = upper - lower, np.where(np.isfinite(upper), upper, np.where(np.isfinite(lower), lower, 0.0))
    room = NEAR * np.where(np.isfinite(whole), whole, np.abs(one))
    above, below = np.isfinite(upper) & (upper - room <= U), np.isfinite(lower) & (lower + room >= U)
    return above.astype(np.int8) - below.astype(np.int8)


def spans(at: NDArray[np.bool_], times: Array) -> tuple[tuple[float, float], ...]:
    """Start and end of each run of true entries of `at` (N,), by the `times` of the knots (N + 1,). [s]"""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]]).astype(np.int8)))
    return tuple((float(times[start]), float(times[end])) for start, end in edges.reshape(-1, 2))


def describe(result: Result, *, brief: bool = False) -> str:
    """One line on which limits are active, such as "hip at +18 Nm during 0.12-0.31 s and 0.8-0.9 s; knee ...".

    `brief` tells only how long each control is at its limits. Empty when none is.
    """
    controls: dict[int, list[AtLimit]] = {}
    for entry in at_limits(result):
        controls.setdefault(entry.control, []).append(entry)
    if not controls:
        return ""
    longest = sorted(controls, key=lambda control: -_seconds(controls[control]))[:MOST_CONTROLS]
    units, end = _units(result), float(result.trajectory.times[-1])
    parts = []
    for control in sorted(longest):
        entries = controls[control]
        if brief:
            parts.append(f"{entries[0].name} {_seconds(entries):.2g} s")
        else:
            parts.append(entries[0].name + ",".join(_sentence(entry, units[control], end) for entry in entries))
    more = [f"{len(controls) - len(longest)} more"] if len(controls) > len(longest) else []
    return (", " if brief else "; ").join(parts + more)


def _seconds(entries: list[AtLimit]) -> float:
    return sum(entry.seconds for entry in entries)


def _sentence(entry: AtLimit, unit: str, end: float) -> str:
    if entry.limit is None:
        place = f" at its {'upper' if entry.side > 0 else 'lower'} limit"
    else:
        place = f" at {entry.limit:+.4g}{unit and f' {unit}'}"
    if entry.seconds >= end * (1.0 - 1e-9):
        return f"{place} throughout"
    if len(entry.spans) > MOST_SPANS:
        first, last = entry.spans[0][0], entry.spans[-1][1]
        return f"{place} for {entry.seconds:.3g} s in {len(entry.spans)} spans within {_span(first, last)}"
    texts = [_span(*span) for span in entry.spans]
    return f"{place} during " + " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def _span(start: float, end: float) -> str:
    return f"{start:.3g}-{end:.3g} s"


def _names(result: Result) -> tuple[str, ...]:
    given, size = result.names.get("controls", ()), result.trajectory.U.shape[1]
    return given if len(given) == size else tuple(f"u[{i}]" for i in range(size))


def _units(result: Result) -> list[str]:
    """Unit of each control, empty where the scene's model does not tell."""
    size = result.trajectory.U.shape[1]
    if result.scene is not None:
        model = model_from_mjb(result.scene.model)
        if model.nu == size:
            return [unit for _, unit in control_kinds(model)]
    return [""] * size
