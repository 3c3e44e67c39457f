"""Generalized Householder transformations for compiled sweeps: hard rows by pivoting and shears, weighted rows by QR.

Rows W with scale factors D state the problem

    minimize 1/2 sum_i (w_i'z)^2 / d_i over the rows with d_i > 0,  subject to  w_i'z = 0 for the rows with d_i = 0.

A nonsingular T with T D T' diagonal turns W into T W and leaves the problem as it is. With rows scaled so that every
d_i is 0 (hard) or 1 (weighted) such a T is made of three kinds:

    hard with hard          any nonsingular combination; here reflections, with column pivoting   `eliminate_hard`
    weighted minus hard     w_i <- w_i - f w_h, a shear                                            `shear`
    weighted with weighted  orthogonal; here reflections, the largest row as pivot                 `merge`

and no hard row ever takes up a weighted one. Column pivoting among the hard rows keeps the factors f of the shears
small, and the exchange of rows among the weighted ones keeps rows of very different weight apart.

Blocks are row-major, and reflections I - v v'/h run along their rows. Every function writes into arrays given to it.

Sources: Potter's transformation as in the thesis at the head of `lq.square_root`, section 3.5; Powell and Reid 1969,
"On applying Householder transformations to linear least squares problems", for the exchange of rows; Higham 2002,
"Accuracy and Stability of Numerical Algorithms", sections 10.3 (semidefinite factors) and 20.9 (equality rows).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

SEMIDEFINITE = 1e-13
"""Pivot over its diagonal entry below which a weight matrix counts as singular."""
INDEFINITE = 1e-9
"""What may remain of a weight matrix behind its last pivot, relative to the diagonal."""
CANCELLED = 1e-6
"""Share of the squared norms of columns below which their updates are not trusted."""
SINGULAR = 1e-13
"""Pivot over the norm of its column below which a control counts as having no weight."""


@njit(cache=True, nogil=True)
def eliminate_hard(block, rows, nu, tolerance, order, V, h, work):
    """Turn hard rows [controls | states], each of norm one, into pivot rows, carried rows and zero rows.

    Columns are exchanged by the size of what they hold, among the first `nu` with `order` following. Reflection j is
    stored as V[j], h[j]. Returns the number of pivot rows, whose left part is upper triangular, and of the rows after
    them, zero on the left; the rows that remain are zero. `work` has a row each for the columns' norms and places.
    """
    width = block.shape[1]
    norms, places, room = work[0], work[1], work[2]
    rank = _pivot(block, 0, rows, 0, nu, tolerance, V, h, norms, places, room)
    for j in range(nu):
        room[j] = order[int(places[j])]
    for j in range(nu):
        order[j] = int(room[j])
    block[rank:rows, :nu] = 0.0
    used = _pivot(block, rank, rows, nu, width, tolerance, V, h, norms, places, room)
    block[used:rows] = 0.0
    for i in range(used):
        for j in range(nu, width):
            room[int(places[j])] = block[i, j]
        block[i, nu:] = room[nu:width]
    return rank, used - rank


@njit(cache=True, nogil=True, fastmath={"contract"})
def _pivot(block, top, rows, first, last, tolerance, V, h, norms, places, room):
    """Triangularize block[top:rows, first:last], all columns to the right following; returns the end of its rows.

    Norms of columns are updated as rows leave them, and taken anew where that cancels.
    """
    for j in range(first, last):
        places[j] = j
    _squared_norms(block, top, rows, first, last, norms)
    fresh = 0.0
    for j in range(first, last):
        fresh = max(fresh, norms[j])
    for c in range(first, last):
        if top >= rows:
            break
        column = c + np.argmax(norms[c:last])
        if norms[column] <= CANCELLED * fresh:
            _squared_norms(block, top, rows, c, last, norms)
            column = c + np.argmax(norms[c:last])
            fresh = norms[column]
        if math.sqrt(max(norms[column], 0.0)) <= tolerance:
            break
        _exchange_columns(block, rows, c, column)
        norms[c], norms[column] = norms[column], norms[c]
        places[c], places[column] = places[column], places[c]
        lead, inverse = _reflect(block[top], block, top + 1, rows, c, block.shape[1], room)
        v = V[top]
        v[top] = lead
        h[top] = 1.0 / inverse
        for i in range(top + 1, rows):
            v[i] = block[i, c] if lead != 0.0 else 0.0
            block[i, c] = 0.0
        for j in range(c + 1, last):
            norms[j] -= block[top, j] * block[top, j]
        top += 1
    return top


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})  # sums in any order, so that they vectorize
def reflect_vector(V, h, count, rows, y, backward):
    """Apply the stored reflections to y[:rows], or, `backward`, their transposed product."""
    for step in range(count):
        j = count - 1 - step if backward else step
        total = 0.0
        for i in range(j, rows):
            total += V[j, i] * y[i]
        total /= h[j]
        for i in range(j, rows):
            y[i] -= total * V[j, i]


@njit(cache=True, nogil=True)
def reflect_variance(V, h, count, rows, variance):
    """Variances of what `reflect_vector` makes of y[:rows], were its entries independent; their sum stays."""
    for j in range(count):
        total = 0.0
        for i in range(j, rows):
            total += V[j, i] * V[j, i] * variance[i]
        for i in range(j, rows):
            square = V[j, i] * V[j, i]
            own = 1.0 - square / h[j]
            variance[i] = own * own * variance[i] + square * (total - square * variance[i]) / (h[j] * h[j])


@njit(cache=True, nogil=True, fastmath={"contract"})
def shear(S, rows, N, rank):
    """Subtract multiples of the hard rows N = [I | .] from S[:rows], so that its first `rank` columns vanish."""
    width = S.shape[1]
    for i in range(rows):
        for a in range(rank):
            factor = S[i, a]
            if factor != 0.0:
                for j in range(rank, width):
                    S[i, j] -= factor * N[a, j]


@njit(cache=True, nogil=True, fastmath={"contract"})
def merge(T, S, first, top, rows, work):
    """Bring T[first:, first:], upper triangular, and the rows S[top:rows, first:] into T, upper triangular again.

    The sum of squares stays.
    """
    n = T.shape[0]
    for j in range(first, n):
        largest, where = abs(T[j, j]), -1
        for i in range(top, rows):
            if abs(S[i, j]) > largest:
                largest, where = abs(S[i, j]), i
        if where >= 0:
            for k in range(j, n):
                T[j, k], S[where, k] = S[where, k], T[j, k]
        if largest > 0.0:
            _reflect(T[j], S, top, rows, j, n, work)


@njit(cache=True, nogil=True, fastmath={"contract"})
def solve_upper(T, first, last, X, columns):
    """Overwrite X[first:last, columns:] with T^-1 X for the rows and columns first to last of upper triangular T."""
    for i in range(last - 1, first - 1, -1):
        for k in range(i + 1, last):
            factor = T[i, k]
            if factor != 0.0:
                for j in range(columns, X.shape[1]):
                    X[i, j] -= factor * X[k, j]
        inverse = 1.0 / T[i, i]
        for j in range(columns, X.shape[1]):
            X[i, j] *= inverse


@njit(cache=True, nogil=True, fastmath={"contract"})
def cholesky_rows(S, F):
    """Overwrite F, whose upper half is that of S, with upper triangular rows F'F = S, S positive semidefinite.

    Rows of F may be zero. False where a pivot is too small to tell whether it is: `pivoted_cholesky_rows` can.
    """
    n = S.shape[0]
    for j in range(n):
        four = j // 4 * 4  # four rows at a time keep F[j] in registers
        for i in range(0, four, 4):
            a, b, c, d = F[i, j], F[i + 1, j], F[i + 2, j], F[i + 3, j]
            for k in range(j, n):
                F[j, k] -= a * F[i, k] + b * F[i + 1, k] + c * F[i + 2, k] + d * F[i + 3, k]
        for i in range(four, j):
            a = F[i, j]
            for k in range(j, n):
                F[j, k] -= a * F[i, k]
        pivot, given = F[j, j], S[j, j]
        if pivot > SEMIDEFINITE * given:
            inverse = 1.0 / math.sqrt(pivot)
            for k in range(j, n):
                F[j, k] *= inverse
        else:
            if pivot < -INDEFINITE * given or not np.isfinite(pivot):
                return False
            for k in range(j + 1, n):
                if abs(F[j, k]) > SEMIDEFINITE * math.sqrt(max(given, 0.0) * max(S[k, k], 0.0)):
                    return False
            F[j, j:] = 0.0
    return True


@njit(cache=True, nogil=True)
def pivoted_cholesky_rows(S, F):
    """Write rows F with F'F = S, S symmetric, the largest remaining pivot (over its diagonal entry) first.

    S is used up. Returns the number of rows, the others of F being zero; -1 when S is not positive semidefinite.
    """
    n = S.shape[0]
    given = np.empty(n)
    for i in range(n):
        given[i] = S[i, i]
        if not (given[i] >= 0.0 and np.isfinite(given[i])):
            return -1
    F[:, :] = 0.0
    done = np.zeros(n, np.bool_)
    rank = 0
    for j in range(n):
        where, largest = -1, SEMIDEFINITE
        for i in range(n):
            if not done[i] and given[i] > 0.0 and S[i, i] > largest * given[i]:
                where, largest = i, S[i, i] / given[i]
        if where < 0:
            break
        done[where] = True
        inverse = 1.0 / math.sqrt(S[where, where])
        for k in range(n):
            F[j, k] = 0.0 if done[k] and k != where else S[where, k] * inverse
        for i in range(n):
            if not done[i]:
                for k in range(n):
                    S[i, k] -= F[j, i] * F[j, k]
        rank += 1
    for i in range(n):
        for k in range(n):
            if not (done[i] or done[k]) and not abs(S[i, k]) <= INDEFINITE * math.sqrt(given[i] * given[k]):
                return -1
    return rank


@njit(cache=True, nogil=True, fastmath={"contract"})
def _reflect(head, S, first, last, column, end, work):
    """Reflect the row `head` and S[first:last]: column -> multiple of e_1.

    Only columns from `column` to `end` are touched; below the head, `column` is left as it was. Returns the first entry
    of v = (., column) and 2/v'v; zero and one where there is nothing to reflect.
    """
    alpha = head[column]
    square = 0.0
    for i in range(first, last):
        square += S[i, column] * S[i, column]
    if square == 0.0:
        return 0.0, 1.0
    beta = -math.copysign(math.sqrt(square + alpha * alpha), alpha)
    top = alpha - beta
    inverse = 1.0 / (-beta * top)  # 2 / v'v for v = (top, column)
    for j in range(column + 1, end):
        work[j] = top * head[j]
    four = first + (last - first) // 4 * 4  # four rows at a time keep `work` in registers
    for i in range(first, four, 4):
        a, b, c, d = S[i, column], S[i + 1, column], S[i + 2, column], S[i + 3, column]
        for j in range(column + 1, end):
            work[j] += a * S[i, j] + b * S[i + 1, j] + c * S[i + 2, j] + d * S[i + 3, j]
    for i in range(four, last):
        a = S[i, column]
        for j in range(column + 1, end):
            work[j] += a * S[i, j]
    head[column] = beta
    for j in range(column + 1, end):
        work[j] *= inverse
        head[j] -= top * work[j]
    for i in range(first, four, 4):
        a, b, c, d = S[i, column], S[i + 1, column], S[i + 2, column], S[i + 3, column]
        for j in range(column + 1, end):
            S[i, j] -= a * work[j]
            S[i + 1, j] -= b * work[j]
            S[i + 2, j] -= c * work[j]
            S[i + 3, j] -= d * work[j]
    for i in range(four, last):
        a = S[i, column]
        for j in range(column + 1, end):
            S[i, j] -= a * work[j]
    return top, inverse


@njit(cache=True, nogil=True)
def _squared_norms(block, top, rows, first, last, norms):
    """Squares of the norms of the columns first to last of block[top:rows]."""
    norms[first:last] = 0.0
    for i in range(top, rows):
        for j in range(first, last):
            norms[j] += block[i, j] * block[i, j]


@njit(cache=True, nogil=True)
def _exchange_columns(block, rows, a, b):
    if a != b:
        for i in range(rows):
            block[i, a], block[i, b] = block[i, b], block[i, a]
