"""The vector recursions of `lq.square_root`, compiled: feedforward back, trajectory and multipliers forth, residuals.

Notation is that of `lq.square_root` and `lq.square_root_matrices`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mjslq.lq.dense import add_product, add_transposed_product
from mjslq.lq.householder import reflect_variance, reflect_vector

CONSISTENT = 1e-9
"""Right side left of a dependent row, relative to the others, up to which it is taken for rounding."""
ROUNDING = 2e-13
"""Relative standard deviation, on the safe side, of what a step adds to the right side of a row."""


@njit(cache=True, nogil=True)
def backward(lq, hard, weighted, d_hard, d_weighted, slack, f, k, p, v):
    """Vector recursion: k, p and v.

    Returns the step at which a dependent row is not met, or -1; the offsets of the hard rows of that step, reflected;
    and the variances of rounding of those carried to x_0.
    """
    N, nx, nu = lq.B.shape
    y = np.zeros(f.h.shape[1])
    shift, gap, beta, WB = np.empty(nu), np.empty(nx), np.empty(nx), np.empty(nx)
    g, ordered = np.empty(nu), np.empty(nu)
    p[N] = lq.q[N]
    _weighted_gradient(weighted, d_weighted, N, shift, p[N], g)
    noise, variance = np.empty(y.size), np.zeros(f.E.shape[1])
    if not _hard_offsets(hard, d_hard, f, N, y, gap, v, slack, noise, variance):
        return N, y, variance
    for n in range(N - 1, -1, -1):
        gap[:] = lq.c[n]
        g[:] = lq.r[n]
        p[n] = lq.q[n]
        shift[:] = 0.0
        T, order, rank = f.T[n], f.order[n], f.pivots[n]
        rows = f.carried[n + 1] + hard.start[n + 1] - hard.start[n]
        if rows and not _hard_offsets(hard, d_hard, f, n, y, gap, v, slack, noise, variance):
            return n, y, variance
        if rank:
            for i in range(rank - 1, -1, -1):
                for j in range(i + 1, rank):
                    y[i] -= T[i, j] * y[j]
                y[i] /= T[i, i]
                shift[order[i]] = -y[i]
            add_product(lq.B[n], shift, gap)
            add_product(lq.R[n], shift, g)
            add_transposed_product(lq.M[n], shift, p[n])
        if weighted.start[n + 1] > weighted.start[n]:
            _weighted_gradient(weighted, d_weighted, n, shift, p[n], g)
        beta[:] = p[n + 1]
        WB[:] = 0.0
        _add_upper(f.W[n + 1], gap, WB)
        _add_upper_transposed(f.W[n + 1], WB, beta)
        add_transposed_product(lq.B[n], beta, g)
        add_transposed_product(lq.A[n], beta, p[n])
        for i in range(nu):
            ordered[i] = g[order[i]]
        _normal_equations(T, rank, ordered)
        for i in range(nu):
            k[n, order[i]] = shift[order[i]] - ordered[i]
            for j in range(nx):
                p[n, j] -= f.K[n, i, j] * g[i]
    return -1, y, variance


@njit(cache=True, nogil=True)
def _hard_offsets(hard, d, f, n, y, gap, v, slack, noise, variance):
    """Offsets of the hard rows of step n into y, reflected, those of the carried ones into v_n.

    Returns whether every dependent row is met but for rounding, of which `variance` (those of the carried rows, from
    step to step) is an estimate, and `noise` room for that of y.
    """
    count, N, largest = 0, f.carried.size - 1, 0.0
    if n < N:
        count = f.carried[n + 1]
        for i in range(count):
            total, size = v[n + 1, i], abs(v[n + 1, i])
            for j in range(gap.size):
                total += f.E[n + 1, i, j] * gap[j]
                size += abs(f.E[n + 1, i, j] * gap[j])
            y[i] = total * f.norm[n, i]
            noise[i] = (variance[i] + (ROUNDING * size) ** 2) * f.norm[n, i] ** 2
            largest = max(largest, size * f.norm[n, i])
    for m in range(hard.start[n], hard.start[n + 1]):
        i = count + m - hard.start[n]
        y[i] = -d[m] * f.norm[n, i]
        noise[i] = (ROUNDING * y[i]) ** 2
        largest = max(largest, abs(y[i]))
    rows = count + hard.start[n + 1] - hard.start[n]
    used = f.pivots[n] + f.carried[n]
    reflect_vector(f.V[n], f.h[n], used, rows, y, False)
    if f.carried[n] or used < rows:
        reflect_variance(f.V[n], f.h[n], used, rows, noise)
    for i in range(f.carried[n]):
        v[n, i] = y[f.pivots[n] + i]
        variance[i] = noise[f.pivots[n] + i]
    met = True
    for i in range(used, rows):
        met = met and abs(y[i]) <= CONSISTENT * largest + math.sqrt(noise[i]) + slack
    return met


@njit(cache=True, nogil=True)
def _weighted_gradient(weighted, d, n, shift, q, r):
    """Add what the weighted rows of step n contribute to the gradient at x = 0, u = shift."""
    for m in range(weighted.start[n], weighted.start[n + 1]):
        total = -d[m]
        if n < weighted.start.size - 2:
            for j in range(r.size):
                total += weighted.C[m, j] * shift[j]
        total /= weighted.scale[m]
        for j in range(q.size):
            q[j] += weighted.H[m, j] * total
        for j in range(r.size):
            r[j] += weighted.C[m, j] * total


@njit(cache=True, nogil=True)
def _normal_equations(T, rank, g):
    """Overwrite g with the minimizer of -g'u + 1/2 |T_2 u|^2 over T_1 u = 0, T_1 being the first `rank` rows of T."""
    nu = g.size
    for i in range(nu):
        for j in range(i):
            g[i] -= T[j, i] * g[j]
        g[i] /= T[i, i]
    g[:rank] = 0.0
    for i in range(nu - 1, -1, -1):
        for j in range(i + 1, nu):
            g[i] -= T[i, j] * g[j]
        g[i] /= T[i, i]


@njit(cache=True, fastmath={"contract", "reassoc"})  # sums in any order, so that they vectorize
def _add_upper(W, x, out):
    """Out += W x, W upper triangular."""
    for i in range(x.size):
        total = 0.0
        for j in range(i, x.size):
            total += W[i, j] * x[j]
        out[i] += total


@njit(cache=True, nogil=True)
def _add_upper_transposed(W, x, out):
    """Out += W'x, W upper triangular."""
    for i in range(x.size):
        for j in range(i, x.size):
            out[j] += W[i, j] * x[i]


@njit(cache=True, nogil=True)
def forward(lq, hard, weighted, d_weighted, f, k, p, X, U, costates, psi, mu_hard, mu_weighted):
    """Trajectory from X[0] under the feedback, and multipliers from psi[0]."""
    N, nx, nu = lq.B.shape
    w, rho, Wx = np.zeros(f.h.shape[1]), np.empty(nu), np.empty(nx)
    _costate(f.W[0], p[0], X[0], Wx, costates[0])
    add_transposed_product(f.E[0], psi[0], costates[0])
    for n in range(N):
        for i in range(nu):
            total = k[n, i]
            for j in range(nx):
                total -= f.K[n, i, j] * X[n, j]
            U[n, i] = total
        X[n + 1] = lq.c[n]
        add_product(lq.A[n], X[n], X[n + 1])
        add_product(lq.B[n], U[n], X[n + 1])
        _costate(f.W[n + 1], p[n + 1], X[n + 1], Wx, costates[n + 1])
        if weighted.start[n + 1] > weighted.start[n]:
            _weighted_multipliers(weighted, d_weighted, n, X[n], U[n], mu_weighted)
        if f.carried[n + 1] + hard.start[n + 1] - hard.start[n]:
            if f.pivots[n]:
                rho[:] = lq.r[n]
                add_product(lq.R[n], U[n], rho)
                add_product(lq.M[n], X[n], rho)
                add_transposed_product(lq.B[n], costates[n + 1], rho)
                for m in range(weighted.start[n], weighted.start[n + 1]):
                    for j in range(nu):
                        rho[j] += weighted.C[m, j] * mu_weighted[m]
            _hard_multipliers(hard, f, n, rho, w, psi, mu_hard)
            if f.carried[n + 1]:
                add_transposed_product(f.E[n + 1], psi[n + 1], costates[n + 1])
    _weighted_multipliers(weighted, d_weighted, N, X[N], U[N - 1], mu_weighted)
    _hard_multipliers(hard, f, N, rho, w, psi, mu_hard)


@njit(cache=True, nogil=True)
def _costate(W, p, x, Wx, out):
    """W'W x + p, which is the costate but for what the hard rows bring."""
    out[:] = p
    Wx[:] = 0.0
    _add_upper(W, x, Wx)
    _add_upper_transposed(W, Wx, out)


@njit(cache=True, nogil=True)
def _weighted_multipliers(weighted, d, n, x, u, mu):
    """The rows' residuals over their scale factors."""
    for m in range(weighted.start[n], weighted.start[n + 1]):
        total = -d[m]
        for j in range(x.size):
            total += weighted.H[m, j] * x[j]
        for j in range(u.size):
            total += weighted.C[m, j] * u[j]
        mu[m] = total / weighted.scale[m]


@njit(cache=True, nogil=True)
def _hard_multipliers(hard, f, n, rho, w, psi, mu):
    """Multipliers of the hard rows of step n, from psi_n and the gradient rho by the controls without these rows."""
    N = f.carried.size - 1
    count = f.carried[n + 1] if n < N else 0
    rows, rank, used = count + hard.start[n + 1] - hard.start[n], f.pivots[n], f.pivots[n] + f.carried[n]
    for i in range(rank):
        total = -rho[f.order[n, i]]
        for j in range(i):
            total -= f.T[n, j, i] * w[j]
        w[i] = total / f.T[n, i, i]
    for i in range(rank, used):
        w[i] = psi[n, i - rank]
    w[used:rows] = 0.0
    reflect_vector(f.V[n], f.h[n], used, rows, w, True)
    for i in range(count):
        psi[n + 1, i] = w[i] * f.norm[n, i]
    for i in range(count, rows):
        mu[hard.start[n] + i - count] = w[i] * f.norm[n, i]


@njit(cache=True, nogil=True)
def residual(lq, hard, weighted, d_hard, d_weighted, X, U, costates, mu_hard, mu_weighted, rest, r_hard, r_weighted):
    """First-order conditions at a solution, as the right-hand side of the problem of its correction."""
    N = lq.B.shape[0]
    for n in range(N + 1):
        gap = rest.q[n]
        gap[:] = lq.q[n] - costates[n]
        add_product(lq.Q[n], X[n], gap)
        if n < N:
            add_transposed_product(lq.M[n], U[n], gap)
            add_transposed_product(lq.A[n], costates[n + 1], gap)
            rest.r[n] = lq.r[n]
            add_product(lq.R[n], U[n], rest.r[n])
            add_product(lq.M[n], X[n], rest.r[n])
            add_transposed_product(lq.B[n], costates[n + 1], rest.r[n])
            rest.c[n] = lq.c[n] - X[n + 1]
            add_product(lq.A[n], X[n], rest.c[n])
            add_product(lq.B[n], U[n], rest.c[n])
        last = min(n, N - 1)
        if hard.start[n + 1] > hard.start[n]:
            _rows_residual(hard, d_hard, n, X[n], U[last], mu_hard, gap, rest.r[last], r_hard)
        if weighted.start[n + 1] > weighted.start[n]:
            _rows_residual(weighted, d_weighted, n, X[n], U[last], mu_weighted, gap, rest.r[last], r_weighted)


@njit(cache=True, nogil=True)
def _rows_residual(rows, d, n, x, u, mu, q, r, out):
    for m in range(rows.start[n], rows.start[n + 1]):
        total = d[m] + rows.scale[m] * mu[m]
        for j in range(x.size):
            total -= rows.H[m, j] * x[j]
            q[j] += rows.H[m, j] * mu[m]
        for j in range(u.size):
            total -= rows.C[m, j] * u[j]
            r[j] += rows.C[m, j] * mu[m]
        out[m] = total
