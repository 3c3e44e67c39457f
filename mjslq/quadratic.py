"""Second-order expansions over a horizon, and what residuals add to them.

Notation
--------
    q_n, r_n           gradient of the stage cost by state (tangent directions) and control
    Q_n, R_n, M_n      its second derivatives xx, uu, ux
    J, K  (k, m, .)    derivatives of residuals at k knots, with many zeros in the case of states on a manifold
    W     (k, m, m)    symmetric weights, one a knot; or (1, m, m), the same at all of them
    s     (k,)         scales
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mjslq.native.arrays import array_kernel
from mjslq.validation import Array


class Expansion(NamedTuple):
    """Second-order expansion of all stage costs about a trajectory, in tangent directions."""

    Q: Array
    """Shape (N + 1, ndx, ndx)."""
    R: Array
    """Shape (N, nu, nu)."""
    M: Array
    """Shape (N, nu, ndx)."""
    q: Array
    """Shape (N + 1, ndx)."""
    r: Array
    """Shape (N, nu)."""

    @staticmethod
    def zeros(N: int, ndx: int, nu: int) -> Expansion:
        """An expansion to add to."""
        return Expansion(
            np.zeros((N + 1, ndx, ndx)), np.zeros((N, nu, nu)), np.zeros((N, nu, ndx)),
            np.zeros((N + 1, ndx)), np.zeros((N, nu)),
        )  # fmt: skip


def weighted(s: Array, W: Array, d: Array) -> Array:
    """s_n W_n d_n. Shape (k, m)."""
    product: Array = s[:, None] * (d @ W[0] if len(W) == 1 else (W @ d[..., None])[..., 0])
    return product


def transposed_times(J: Array, d: Array) -> Array:
    """J_n'd_n. Shape (k, columns of J)."""
    product: Array = (d[:, None, :] @ J)[:, 0]
    return product


def add_congruence(
    J: Array, s: Array, W: Array, K: Array, knots: np.ndarray[Any, np.dtype[np.int64]], into: Array
) -> None:
    """into[knots_n] += s_n J_n'W_n K_n, skipping zeros of W and J."""
    _add_congruence(J, s, W, K, knots, into, np.empty(K.shape[1:]))


@array_kernel("quadratic-congruence", "void(f8[3], f8[1], f8[3], f8[3], i8[1], f8[3], f8[2])")
def _add_congruence(J, s, W, K, knots, into, WK):
    """into[knots_n] += s_n J_n'W_n K_n, skipping zeros of W and J."""
    m, columns = K.shape[1], K.shape[2]
    for n in range(knots.shape[0]):
        weight = W[n if W.shape[0] > 1 else 0]
        for i in range(m):
            for j in range(columns):
                WK[i, j] = 0.0
            for k in range(m):
                w = s[n] * weight[i, k]
                if w != 0.0:
                    for j in range(columns):
                        WK[i, j] += w * K[n, k, j]
        block = into[knots[n]]
        for k in range(m):
            for i in range(J.shape[2]):
                slope = J[n, k, i]
                if slope != 0.0:
                    for j in range(columns):
                        block[i, j] += slope * WK[k, j]


@array_kernel("quadratic-products", "void(f8[1], f8[2], f8[2], i8[1], f8[3])")
def add_products(s, g, h, knots, into):
    """into[knots_n] += s_n g_n h_n'."""
    for n in range(knots.shape[0]):
        block = into[knots[n]]
        for i in range(g.shape[1]):
            slope = s[n] * g[n, i]
            if slope != 0.0:
                for j in range(h.shape[1]):
                    block[i, j] += slope * h[n, j]
