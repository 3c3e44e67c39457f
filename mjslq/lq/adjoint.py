"""Costates and the gradient of the total cost with respect to the controls (Sideris and Bobrow 2005, (8)-(10)).

    lambda_N = q_N,   lambda_n = q_n + A_n' lambda_{n+1},   dJ/du_n = r_n + B_n' lambda_{n+1}

with q_n, r_n the gradients of the stage costs by state and control.
"""

from __future__ import annotations

import numpy as np

from mjslq.lq.dense import add_transposed_product, copy
from mjslq.native.arrays import array_kernel
from mjslq.validation import Array


def adjoint(A: Array, B: Array, q: Array, r: Array) -> tuple[Array, Array]:
    """Return the costates (N + 1, nx) and the gradient dJ/dU (N, nu).

    A (N, nx, nx) and B (N, nx, nu) are the Jacobians of the steps, q (N + 1, nx) and r (N, nu) the gradients
    of the stage costs.
    """
    costates, gradient = np.empty_like(q), np.empty_like(r)
    _adjoint(A, B, q, r, costates, gradient)
    return costates, gradient


@array_kernel("lq-adjoint", "void(f8[3], f8[3], f8[2], f8[2], f8[2], f8[2])")
def _adjoint(A, B, q, r, costates, gradient):
    N = B.shape[0]
    copy(q[N], costates[N])
    for n in range(N - 1, -1, -1):
        copy(r[n], gradient[n])
        add_transposed_product(B[n], costates[n + 1], gradient[n])
        copy(q[n], costates[n])
        add_transposed_product(A[n], costates[n + 1], costates[n])
