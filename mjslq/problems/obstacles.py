"""Discs as obstacles, for constraints: p = (x_1, y_1, r_1, x_2, ...), and w_i = r_i^2 - |(x_0, x_1) - (x_i, y_i)|^2."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from mjslq.validation import Array


@njit(cache=True)
def outside_of_discs(x, u, t, p):
    """W <= 0 where the first two entries of the state are outside of all discs. Shape (discs,)."""
    out = np.empty(p.size // 3, dtype=x.dtype)
    for i in range(out.size):
        dx, dy, r = x[0] - p[3 * i], x[1] - p[3 * i + 1], p[3 * i + 2]
        out[i] = r * r - dx * dx - dy * dy
    return out


def clearance(points: Array, discs: Sequence[float]) -> float:
    """The least distance of `points` (n, 2) from the discs; negative inside. [m]"""
    each = np.reshape(discs, (-1, 3))
    apart = np.linalg.norm(points[:, None] - each[:, :2], axis=2) - each[:, 2]
    return float(apart.min())
