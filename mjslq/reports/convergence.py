"""Convergence curves of logs, as `compare`, `reproduce` and the viewer draw them.

(J_k - J_best) / |J_best|,     J_best the least cost of all the logs, or the optimum where it is known
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjslq.log import IterationLog
from mjslq.validation import Array

ROUNDING = 1e-16
"""Relative costs of at most this are rounding."""

Log = Sequence[IterationLog]


def costs(log: Log) -> Array:
    """Cost of each entry. Shape (entries,)."""
    return np.array([entry.cost for entry in log], dtype=np.float64)


def iterations(log: Log) -> Array:
    """Steps taken before each entry; a rejected trial has the number of the next one. Shape (entries,)."""
    return np.array([entry.iteration for entry in log], dtype=np.float64)


def seconds(log: Log) -> Array:
    """Wall time at the end of each entry. Shape (entries,). [s]"""
    return np.array([entry.seconds for entry in log], dtype=np.float64)


def relative_costs(logs: Sequence[Log], best: float | None = None) -> list[Array]:
    """Relative costs of each entry of each log; NaN where nothing is left but rounding. Shapes (entries,).

    `best` is the optimal cost; the least cost in the logs unless given.
    """
    columns = [costs(log) for log in logs]
    if best is None:
        finite = np.concatenate([column[np.isfinite(column)] for column in columns] or [np.zeros(0)])
        best = float(finite.min()) if finite.size else 0.0
    found = []
    for column in columns:
        relative = (column - best) / max(abs(best), 1e-300)
        found.append(np.where(np.isfinite(relative) & (relative > ROUNDING), relative, np.nan))
    return found
