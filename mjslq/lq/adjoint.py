"""Costates and the gradient of the total cost with respect to the controls (Sideris and Bobrow 2005, (8)-(10)).

    lambda_N = q_N,   lambda_n = q_n + A_n' lambda_{n+1},   dJ/du_n = r_n + B_n' lambda_{n+1}

with q_n, r_n the gradients of the stage costs by state and control. Under feedback u_n = v_n - K_n dx_n the gradient by
the feedforward v is w, and the costates run backward under A - B K in place of A (Sforni et al., GoPRONTO, (16)):

    lambda_N = q_N,   w_n = r_n + B_n' lambda_{n+1},   lambda_n = q_n + A_n' lambda_{n+1} - K_n' w_n

A control that a limit holds does not follow the feedback: its row of K is left out of the last sum.
"""

from __future__ import annotations

import numpy as np

from mjslq.lq.dense import add_transposed_product, copy
from mjslq.native.arrays import array_kernel
from mjslq.native.declare import helper
from mjslq.validation import Array

FREE, LOWER, UPPER, FIXED = 0, -1, 1, 2
"""Where a control is: between its limits, at one of them, or between limits that are the same."""


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


@array_kernel("lq-closed-loop-adjoint", "void(f8[3], f8[3], f8[3], i1[2], f8[2], f8[2], b1[2])")
def closed_loop_adjoint(A, B, K, sides, costates, gradient, held):
    """Costates and gradient of some steps under feedback, in place.

    `costates` (N + 1, nx) and `gradient` (N, nu) come in with q and r; the last of the costates is complete. K has no
    rows without feedback, `sides` (N, nu) none where no control is at a limit; `held` (N, nu) is filled in with the
    controls that the descent direction -w would push beyond theirs.
    """
    for n in range(B.shape[0] - 1, -1, -1):
        add_transposed_product(B[n], costates[n + 1], gradient[n])
        add_transposed_product(A[n], costates[n + 1], costates[n])
        subtract_feedback(n, K, sides, gradient, held, costates[n])


@helper(fastmath={"contract", "reassoc"})
def subtract_feedback(n, K, sides, gradient, held, costate):
    """Costate -= K_n'w_n, the controls that a limit holds left out."""
    for i in range(gradient.shape[1]):
        w = gradient[n, i]
        if sides.shape[0] > 0:
            side = sides[n, i]
            held[n, i] = side == FIXED or (side == LOWER and w > 0.0) or (side == UPPER and w < 0.0)
            if held[n, i]:
                continue
        if K.shape[0] > 0:
            for j in range(costate.shape[0]):
                costate[j] -= w * K[n, i, j]
