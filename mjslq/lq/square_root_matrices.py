"""The matrix recursion of `lq.square_root`, compiled.

Notation is that of `lq.square_root`. Rows are sorted by step, those at N being the terminal ones: rows start[n] to
start[n + 1] belong to step n.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from mjslq.lq.dense import multiply
from mjslq.lq.householder import (
    cholesky_rows,
    eliminate,
    eliminate_hard,
    merge,
    pivoted_cholesky_rows,
    shear,
    solve_upper,
)
from mjslq.validation import Array

Integers = np.ndarray[Any, np.dtype[np.int64]]

DEPENDENT = 1e-12
"""Norm of what is left of a hard row, which was one, below which it depends on the others."""


class SortedRows(NamedTuple):
    """Rows H x + C u = d by step; with scale factors all zero (hard) or all positive (weighted)."""

    H: Array
    """Shape (m, nx)."""
    C: Array
    """Shape (m, nu)."""
    scale: Array
    """Shape (m,)."""
    start: Integers
    """Shape (N + 2,)."""


class Factors(NamedTuple):
    """What the matrix recursion leaves for any right-hand side."""

    K: Array
    """Gains. Shape (N, nu, nx)."""
    T: Array
    """Upper triangular factor of what determines the controls, hard pivots first. Shape (N, nu, nu)."""
    order: Integers
    """Controls in the order of the columns of T. Shape (N, nu)."""
    W: Array
    """Weighted rows of the cost-to-go, upper triangular. Shape (N + 1, nx, nx)."""
    E: Array
    """Hard rows of the cost-to-go. Shape (N + 1, e, nx)."""
    pivots: Integers
    """Controls that hard rows determine. Shape (N + 1,)."""
    carried: Integers
    """Rows in use of E. Shape (N + 1,)."""
    V: Array
    """Reflections of the hard rows of each step. Shape (N + 1, h, h)."""
    h: Array
    """Half of their squared norms. Shape (N + 1, h)."""
    norm: Array
    """Reciprocal norms of the hard rows before the reflections. Shape (N + 1, h)."""


@njit(cache=True, nogil=True)
def factorize_stages(lq, hard, weighted, f):
    """Matrix recursion; returns the step without a unique minimizer, or -1."""
    N, nx, nu = lq.B.shape
    tall = 2 * (nx + nu) + (weighted.start[1:] - weighted.start[:-1]).max()
    S, block = np.empty((tall, nu + nx)), np.empty((f.h.shape[1], nu + nx))
    pivot_rows, weights = np.empty((nu, nu + nx)), np.empty((2, nu + nx, nu + nx))
    work, size, AB = np.empty(nu + nx), np.empty(nu), np.empty((nx, nu + nx))
    product, carried_rows = np.empty((nx, nu + nx)), np.empty((f.E.shape[1], nu + nx))
    f.carried[N] = 0
    f.W[N] = 0.0
    if not _terminal(lq, hard, weighted, f, S, block, weights, work):
        return N
    for n in range(N - 1, -1, -1):
        AB[:, :nu] = lq.B[n]
        AB[:, nu:] = lq.A[n]
        order, rank = f.order[n], 0
        for i in range(nu):
            order[i] = i
        rows = f.carried[n + 1] + hard.start[n + 1] - hard.start[n]
        if rows:
            _gather(hard, f, n, AB, carried_rows, block)
            rank, f.carried[n] = eliminate_hard(block, rows, nu, DEPENDENT, order, f.V[n], f.h[n])
            for i in range(f.carried[n]):
                f.E[n, i] = block[rank + i, nu:]
        else:
            f.carried[n] = 0
        f.pivots[n] = rank
        multiply(f.W[n + 1], AB, product)
        S[:nx] = product
        dense = _stage_rows(lq.Q[n], lq.R[n], lq.M[n], S, nx, nu, weights, f.W[n])
        if dense < 0:
            return n
        dense = _add_weighted(weighted, n, S, dense, nu)
        if rank:
            _permute(S, dense, order, work)
        _column_norms(S, dense, nu, size)
        if rank:
            pivot_rows[:rank] = block[:rank]
            solve_upper(pivot_rows, 0, rank, pivot_rows, rank)
            shear(S, dense, pivot_rows, rank)
        if not eliminate(S, dense, rank, nu, size, work):
            return n
        merge(f.W[n], S, nu - rank, dense, nu, work)
        _gains(block, S, rank, order, f.T[n], f.K[n], pivot_rows)
    return -1


@njit(cache=True, nogil=True)
def _terminal(lq, hard, weighted, f, S, block, weights, work):
    """Cost-to-go at N: rows of Q_N, terminal rows."""
    N, nx, nu = lq.B.shape
    zeros_R, zeros_M = np.zeros((nu, nu)), np.zeros((nu, nx))
    dense = _stage_rows(lq.Q[N], zeros_R, zeros_M, S, 0, nu, weights, f.W[N])
    if dense < 0:
        return False
    dense = _add_weighted(weighted, N, S, dense, nu)
    merge(f.W[N], S, 0, dense, nu, work)
    rows = hard.start[N + 1] - hard.start[N]
    if rows:
        none = np.empty(nu, np.int64)
        _gather(hard, f, N, np.empty((0, 0)), np.empty((0, 0)), block)
        f.pivots[N], f.carried[N] = eliminate_hard(block, rows, nu, DEPENDENT, none, f.V[N], f.h[N])
        for i in range(f.carried[N]):
            f.E[N, i] = block[i, nu:]
    else:
        f.pivots[N] = 0
    return True


@njit(cache=True, nogil=True)
def _gather(hard, f, n, AB, carried_rows, block):
    """Write the hard rows of step n, [controls | states] of norm one: those carried back, then its own."""
    nu, count = hard.C.shape[1], 0
    if n + 1 < f.carried.size:
        count = f.carried[n + 1]
        if count:
            largest = math.sqrt((AB * AB).sum())
            multiply(f.E[n + 1, :count], AB, carried_rows[:count])
            for i in range(count):
                row = f.E[n + 1, i]
                block[i] = carried_rows[i]
                f.norm[n, i] = _unit(block[i], largest * math.sqrt((row * row).sum()))
    for m in range(hard.start[n], hard.start[n + 1]):
        i = count + m - hard.start[n]
        block[i, :nu] = hard.C[m]
        block[i, nu:] = hard.H[m]
        f.norm[n, i] = _unit(block[i], 0.0)


@njit(cache=True, nogil=True)
def _unit(row, size):
    """Scale the row to norm one, or to zero where it vanishes beside `size`; the factor for its right side."""
    norm = math.sqrt((row * row).sum())
    if norm <= DEPENDENT * size:
        row[:] = 0.0
        return 1.0 / size if size > 0.0 else 1.0
    row /= norm
    return 1.0 / norm


@njit(cache=True, nogil=True)
def _stage_rows(Q, R, M, S, first, nu, weights, W):
    """Write rows whose squares make up the stage cost: into S from row `first` on, and upper triangular ones into W.

    Returns the end of the rows in S, -1 when the weights are not positive semidefinite.
    """
    nx = W.shape[0]
    copy, F = weights[0], weights[1]
    for attempt in range(2):
        copy[:nu, :nu] = R
        copy[:nu, nu:] = M
        copy[nu:, nu:] = Q
        if attempt == 0 and cholesky_rows(copy, F):
            for i in range(nu):
                for j in range(i):
                    S[first + i, j] = 0.0
                for j in range(i, nu + nx):
                    S[first + i, j] = F[i, j]
            for i in range(nx):
                for j in range(i):
                    W[i, j] = 0.0
                for j in range(i, nx):
                    W[i, j] = F[nu + i, nu + j]
            return first + nu
    copy[nu:, :nu] = M.T
    rank = pivoted_cholesky_rows(copy, F)
    if rank < 0:
        return -1
    S[first : first + rank] = F[:rank]
    W[:, :] = 0.0
    return first + rank


@njit(cache=True, nogil=True)
def _add_weighted(weighted, n, S, row, nu):
    """Append the weighted rows of step n, scaled to the scale factor one; the end of the rows."""
    for m in range(weighted.start[n], weighted.start[n + 1]):
        factor = 1.0 / math.sqrt(weighted.scale[m])
        S[row, :nu] = factor * weighted.C[m]
        S[row, nu:] = factor * weighted.H[m]
        row += 1
    return row


@njit(cache=True, nogil=True)
def _permute(S, rows, order, work):
    nu = order.size
    for i in range(rows):
        for j in range(nu):
            work[j] = S[i, order[j]]
        S[i, :nu] = work[:nu]


@njit(cache=True, nogil=True)
def _column_norms(S, rows, nu, size):
    size[:] = 0.0
    for i in range(rows):
        for j in range(nu):
            size[j] += S[i, j] * S[i, j]
    for j in range(nu):
        size[j] = math.sqrt(size[j])


@njit(cache=True, nogil=True)
def _gains(block, S, rank, order, T, K, Z):
    """T K = Z from the pivot rows [T Z]: the hard ones, then the weighted ones."""
    nu, nx = K.shape
    for i in range(nu):
        for j in range(i):
            T[i, j] = 0.0
        for j in range(i, nu):
            T[i, j] = block[i, j] if i < rank else S[i - rank, j]
        for j in range(nu, nu + nx):
            Z[i, j] = block[i, j] if i < rank else S[i - rank, j]
    solve_upper(T, 0, nu, Z, nu)
    for i in range(nu):
        for j in range(nx):
            K[order[i], j] = Z[i, nu + j]
