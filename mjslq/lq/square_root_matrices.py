"""The matrix recursion of `lq.square_root`, compiled.

Notation is that of `lq.square_root`. Rows are sorted by step, those at N being the terminal ones: rows start[n] to
start[n + 1] belong to step n.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from mjslq.lq import blas
from mjslq.lq.dense import multiply
from mjslq.lq.householder import (
    SINGULAR,
    cholesky_rows,
    eliminate_hard,
    merge,
    pivoted_cholesky_rows,
    reflect_variance,
    shear,
    solve_upper,
)
from mjslq.validation import Array

blas.make_known()

Integers = np.ndarray[Any, np.dtype[np.int64]]

DEPENDENT = 1e-12
"""Norm of what is left of a hard row, which was one, below which it depends on the others."""
UNEVEN = 1e4
"""Ratio of variances of right sides above which rows are weighted by them."""
LEAST_WEIGHT = 1e-4
"""Least weight of such a row."""


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
    """Factors of the hard rows before the reflections, which make their norms one. Shape (N + 1, h)."""
    noise: Array
    """Variances of the offsets of carried rows, the squared rounding of one step being one. Shape (N + 1, e)."""


def empty_factors(start: Integers, N: int, nx: int, nu: int) -> Factors:
    """Arrays for the factors, with room for as many hard rows as can be carried."""
    own, carried, most, tall = np.diff(start), 0, 0, 0
    for n in range(N, -1, -1):
        tall = max(tall, carried + int(own[n]))
        carried = min(nx, carried + int(own[n]))
        most = max(most, carried)
    return Factors(
        K=np.empty((N, nu, nx)), T=np.empty((N, nu, nu)), order=np.empty((N, nu), np.int64),
        W=np.empty((N + 1, nx, nx)), E=np.zeros((N + 1, most, nx)),
        pivots=np.empty(N + 1, np.int64), carried=np.empty(N + 1, np.int64),
        V=np.zeros((N + 1, tall, tall)), h=np.zeros((N + 1, tall)), norm=np.zeros((N + 1, tall)),
        noise=np.zeros((N + 1, most)),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def factorize_stages(lq, hard, weighted, f):
    """Matrix recursion; returns the step without a unique minimizer, or -1."""
    N, nx, nu = lq.B.shape
    tall = 2 * (nx + nu) + (weighted.start[1:] - weighted.start[:-1]).max()
    S, block = np.empty((tall, nu + nx)), np.empty((f.h.shape[1], nu + nx))
    H, F, Z = np.zeros((nu + nx, nu + nx)), np.empty((nu + nx, nu + nx)), np.empty((nu, nu + nx))
    AB, product = np.empty((nx, nu + nx)), np.empty((max(nx, f.E.shape[1]), nu + nx))
    work, size, space = np.empty(nu + nx), np.empty(nu), np.empty((3, nu + nx))
    if not _terminal(lq, hard, weighted, f, H, F, S, block, work):
        return N
    for n in range(N - 1, -1, -1):
        AB[:, :nu] = lq.B[n]
        AB[:, nu:] = lq.A[n]
        order = f.order[n]
        rank = 0
        if f.carried[n + 1] + hard.start[n + 1] - hard.start[n]:
            rank = _hard_stage(hard, f, n, AB, product, block, order, space)
        else:
            f.pivots[n], f.carried[n] = 0, 0
            for i in range(nu):
                order[i] = i
        _weights(lq, n, order, H)
        multiply(f.W[n + 1], AB, S[:nx])
        rows = _add_weighted(weighted, n, S, nx, nu)
        if rank:
            _permute(S, rows, order, work)
        rows = _stage_rows(H, F, S, rows, nu)
        if rows < 0:
            return n
        _column_norms(F, nu, S, rows, size)
        if rank:
            S[rows : rows + rank] = F[:rank]
            rows += rank
            Z[:rank] = block[:rank]
            solve_upper(Z, 0, rank, Z, rank)
            shear(S, rows, Z, rank)
        merge(F, S, rank, 0, rows, work)
        for i in range(rank, nu):
            if not abs(F[i, i]) > SINGULAR * size[i]:
                return n
        _gains(block, F, rank, order, f.T[n], f.K[n], Z)
        _take_upper(F, nu, f.W[n])
    return -1


@njit(cache=True, nogil=True)
def _weights(lq, n, order, H):
    """Upper half of [R M; M' Q] of step n, the controls in the given order."""
    nu, nx = lq.M.shape[1:]
    for i in range(nu):
        a = order[i]
        for j in range(i, nu):
            H[i, j] = lq.R[n, a, order[j]]
        for j in range(nx):
            H[i, nu + j] = lq.M[n, a, j]
    H[nu:, nu:] = lq.Q[n]


@njit(cache=True, nogil=True)
def _terminal(lq, hard, weighted, f, H, F, S, block, work):
    """Cost-to-go at N: rows of Q_N, terminal rows. False when Q_N is not positive semidefinite."""
    N, _nx, nu = lq.B.shape
    H[nu:, nu:] = lq.Q[N]
    rows = _stage_rows(H, F, S, 0, nu)
    if rows < 0:
        return False
    rows = _add_weighted(weighted, N, S, rows, nu)
    merge(F, S, nu, 0, rows, work)
    _take_upper(F, nu, f.W[N])
    f.pivots[N], f.carried[N] = 0, 0
    if hard.start[N + 1] > hard.start[N]:
        none = np.empty((0, 0))
        _hard_stage(hard, f, N, none, none, block, np.empty(nu, np.int64), np.empty((3, H.shape[0])))
    return True


@njit(cache=True, nogil=True)
def _hard_stage(hard, f, n, AB, product, block, order, work):
    """Hard rows of step n into `block`, transformed; returns how many controls they determine.

    Rows with far more rounding behind them than others get less weight, lest they spoil what the others tell: offsets
    that come back through dynamics which forget the state.
    """
    V, h, least = f.V[n], f.h[n], 1.0
    for attempt in range(3):
        rows, noise = _gather(hard, f, n, AB, product, block, least)
        for i in range(order.size):
            order[i] = i
        rank, carried = eliminate_hard(block, rows, order.size, DEPENDENT, order, V, h, work)
        if attempt == 0:
            independent = rank + carried
            if noise[:rows].max() <= UNEVEN * noise[:rows].min():
                break
            least = LEAST_WEIGHT
        elif rank + carried == independent:
            break
        else:
            least = 1.0
    if carried:
        reflect_variance(V, h, rank + carried, rows, noise)
    for i in range(carried):
        f.E[n, i] = block[rank + i, order.size :]
        f.noise[n, i] = noise[rank + i]
    f.pivots[n], f.carried[n] = rank, carried
    return rank


@njit(cache=True, nogil=True)
def _gather(hard, f, n, AB, product, block, least):
    """Write the hard rows of step n, [controls | states] of norm one: those carried back, then its own.

    Returns their number and the variances of their right sides, the squared rounding of one step being one; rows are
    weighted by the inverse root of these, at least by `least`.
    """
    nu, count = hard.C.shape[1], 0
    noise = np.ones(block.shape[0])
    if n + 1 < f.carried.size:
        count = f.carried[n + 1]
        if count:
            largest = _norm(AB.ravel())
            multiply(f.E[n + 1, :count], AB, product[:count])
            for i in range(count):
                block[i] = product[i]
                f.norm[n, i] = _unit(block[i], largest * _norm(f.E[n + 1, i]))
                noise[i] = (1.0 + f.noise[n + 1, i]) * f.norm[n, i] ** 2
    for m in range(hard.start[n], hard.start[n + 1]):
        i = count + m - hard.start[n]
        block[i, :nu] = hard.C[m]
        block[i, nu:] = hard.H[m]
        f.norm[n, i] = _unit(block[i], 0.0)
    rows = count + hard.start[n + 1] - hard.start[n]
    if rows and least < 1.0:
        smallest = noise[:rows].min()
        for i in range(rows):
            weight = max(least, math.sqrt(smallest / noise[i]))
            block[i] *= weight
            f.norm[n, i] *= weight
            noise[i] *= weight * weight
    return rows, noise


@njit(cache=True, nogil=True)
def _norm(x):
    total = 0.0
    for entry in x:
        total += entry * entry
    return math.sqrt(total)


@njit(cache=True, nogil=True)
def _unit(row, size):
    """Scale the row to norm one, or to zero where it vanishes beside `size`; the factor for its right side."""
    norm = _norm(row)
    if norm <= DEPENDENT * size:
        row[:] = 0.0
        return 1.0 / size if size > 0.0 else 1.0
    row /= norm
    return 1.0 / norm


@njit(cache=True, nogil=True)
def _stage_rows(H, F, S, first, nu):
    """Write rows whose squares make up z'H z: upper triangular ones into F, or else others into S, from `first` on.

    The upper half of H is read. Returns the end of the rows in S, -1 when H is not positive semidefinite.
    """
    n = H.shape[0]
    for i in range(n):
        for j in range(i):
            F[i, j] = 0.0
        for j in range(i, n):
            F[i, j] = H[i, j]
    if cholesky_rows(H, F):
        return first
    full = np.triu(H) + np.triu(H, 1).T
    rank = pivoted_cholesky_rows(full, F)
    if rank < 0:
        return -1
    S[first : first + rank] = F[:rank]
    F[:, :] = 0.0
    return first + rank


@njit(cache=True, nogil=True)
def _take_upper(F, nu, W):
    for i in range(W.shape[0]):
        for j in range(i):
            W[i, j] = 0.0
        for j in range(i, W.shape[0]):
            W[i, j] = F[nu + i, nu + j]


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
def _column_norms(F, rows, S, more, size):
    """Norms of the control columns of F[:rows] and S[:more]."""
    size[:] = 0.0
    for i in range(rows):
        for j in range(size.size):
            size[j] += F[i, j] * F[i, j]
    for i in range(more):
        for j in range(size.size):
            size[j] += S[i, j] * S[i, j]
    for j in range(size.size):
        size[j] = math.sqrt(size[j])


@njit(cache=True, nogil=True)
def _gains(block, F, rank, order, T, K, Z):
    """T K = Z from the pivot rows [T Z]: the hard ones, then the weighted ones."""
    nu, nx = K.shape
    for i in range(nu):
        for j in range(i):
            T[i, j] = 0.0
        for j in range(i, nu):
            T[i, j] = block[i, j] if i < rank else F[i, j]
        for j in range(nu, nu + nx):
            Z[i, j] = block[i, j] if i < rank else F[i, j]
    solve_upper(T, 0, nu, Z, nu)
    for i in range(nu):
        for j in range(nx):
            K[order[i], j] = Z[i, nu + j]
