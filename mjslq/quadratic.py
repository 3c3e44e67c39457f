"""Quadratic forms of residuals over a horizon: scale_n/2 d_n'W_n d_n, with W_n often the same matrix at all knots.

Notation
--------
    d  (k, m)             residuals at k knots
    W  (k, m, m)          symmetric weights, one a knot; or (1, m, m), the same at all of them
    s  (k,)               scales
    J, K                  (k, m, .) derivatives of residuals, with many zeros in the case of states on a manifold
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mjslq.validation import Array


def weighted(s: Array, W: Array, d: Array) -> Array:
    """s_n W_n d_n. Shape (k, m)."""
    product: Array = s[:, None] * (d @ W[0] if len(W) == 1 else (W @ d[..., None])[..., 0])
    return product


def transposed_times(J: Array, d: Array) -> Array:
    """J_n'd_n. Shape (k, columns of J)."""
    product: Array = (d[:, None, :] @ J)[:, 0]
    return product


@njit(cache=True, nogil=True)
def add_congruence(J, s, W, K, into):
    """into_n += s_n J_n'W_n K_n, skipping zeros of W and J."""
    m, columns = K.shape[1], K.shape[2]
    WK = np.empty((m, columns))
    for n in range(J.shape[0]):
        weight = W[n if W.shape[0] > 1 else 0]
        for i in range(m):
            for j in range(columns):
                WK[i, j] = 0.0
            for k in range(m):
                w = s[n] * weight[i, k]
                if w != 0.0:
                    for j in range(columns):
                        WK[i, j] += w * K[n, k, j]
        for k in range(m):
            for i in range(J.shape[2]):
                slope = J[n, k, i]
                if slope != 0.0:
                    for j in range(columns):
                        into[n, i, j] += slope * WK[k, j]
