"""Which controls are at their limits, and when: for summaries, plots and pages.

A control is at a limit over step n when it equals that limit to the last bit (`Result.active_limits`); the step lasts
from t_n to t_{n+1}. Steps in a row make a span.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjslq.reports.units import control_kinds, model_from_mjb
from mjslq.result import Result
from mjslq.validation import Array

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
    active, times = result.active_limits, result.trajectory.times
    names = _names(result)
    found = []
    for control in range(active.shape[1]):
        for side, limits in ((1, result.upper), (-1, result.lower)):
            at = active[:, control] == side
            if not at.any():
                continue
            values = np.unique(limits[at, control])
            limit = float(values[0]) if len(values) == 1 else None
            found.append(AtLimit(control, names[control], side, limit, spans(at, times)))
    return found


def spans(at: NDArray[np.bool_], times: Array) -> tuple[tuple[float, float], ...]:
    """Start and end of each run of true entries of `at` (N,), by the `times` of the knots (N + 1,). [s]"""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]]).astype(np.int8)))
    return tuple((float(times[start]), float(times[end])) for start, end in edges.reshape(-1, 2))


def describe(result: Result, *, brief: bool = False) -> str:
    """One line on which limits are active, such as "hip at +18 Nm during 0.12-0.31 s and 0.8-0.9 s; knee ...".

    `brief` tells how long instead of when. Empty when no limit is active.
    """
    found = at_limits(result)
    if not found:
        return ""
    units, end = _units(result), float(result.trajectory.times[-1])
    shown = sorted(found, key=lambda entry: -entry.seconds)[:MOST_CONTROLS]
    parts = [_sentence(entry, units[entry.control], end, brief) for entry in found if entry in shown]
    more = len(found) - len(shown)
    return "; ".join(parts) + (f"; and {more} more" if more else "")


def _sentence(entry: AtLimit, unit: str, end: float, brief: bool) -> str:
    if entry.limit is None:
        place = f"{entry.name} at its {'upper' if entry.side > 0 else 'lower'} limit"
    else:
        place = f"{entry.name} at {entry.limit:+.4g}{unit and f' {unit}'}"
    if entry.seconds >= end * (1.0 - 1e-9):
        return f"{place} throughout"
    if brief:
        return f"{place} for {entry.seconds:.3g} s"
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
