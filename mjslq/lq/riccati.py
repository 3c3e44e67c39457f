"""The LQ tracking sweep (Sideris and Bobrow 2005, Algorithm 1) for the problem at the head of `lq.problem`.

Notation
--------
    P  (N+1, nx, nx)  p  (N+1, nx)      cost-to-go 1/2 x'P x + p'x
    K  (N, nu, nx)    k  (N, nu)        the minimizer u_n = k_n - K_n x_n
    sigma  (N, nu)    tau               shifts: Levenberg-Marquardt multipliers on controls and states
    held                                controls that stay at zero: their rows of K and k vanish

Recursion, from P_N = Q_N + tau I, p_N = q_N down
-------------------------------------------------
    G = R_sigma + B'P B,   K = G^-1 (M + B'P A),   k = -G^-1 (r + B'(p + P c)),   R_sigma = R_n + diag(sigma_n)
    F = A - B K
    P <- Q + tau I - K'M - M'K + K'R_sigma K + F'P F       (Joseph's form)
    p <- q - K'r + F'(p + P c)

Entries of x_0 that are free follow from what is left of the cost, 1/2 x_0'P_0 x_0 + p_0'x_0: x_0 = -P_0^-1 p_0 on
these; directions that the cost does not tell apart stay zero.

For held controls the rows and columns of G are those of the identity, and the right sides zero: all that follows is
the recursion of the problem without them.

The paper's (23)-(26) give the same P and s = p through an inverse that is not symmetric. Joseph's form adds squares
only, so that P stays symmetric and positive semidefinite under rounding, and an error in K enters P in second order;
it costs nx^2 nu multiplications more than the shortest form, which is little. `solve` then repeats the two vector
recursions on the residual of the first-order conditions (iterative refinement) where the pivots of G tell that it
matters: with terminal weights 1e12 times the control weights that takes the error of the controls from 1e-5 to 1e-10.
"""

from __future__ import annotations

import numpy as np

from mjslq.lq.dense import (
    add_product,
    add_transposed_product,
    cholesky,
    cholesky_solve,
    copy,
    copy_matrix,
    multiply,
    multiply_transposed,
    part,
)
from mjslq.lq.problem import LQProblem, LQSolution, Mask, NotPositiveDefinite, linear_terms_about
from mjslq.native.arrays import array_kernel
from mjslq.native.declare import helper
from mjslq.validation import Array

LEAST_CURVATURE = 1e-9
"""Curvature of the cost along x_0 that is taken for none, relative to the largest."""
WIDE = 1e4
"""Spread of the pivots of G up to which rounding stays below 1e-11 without refinement."""


def solve(
    problem: LQProblem,
    control_shift: float | Array = 0.0,
    state_shift: float = 0.0,
    held: Mask | None = None,
    refinements: int | None = None,
) -> LQSolution:
    """Minimize by one sweep back and one forth.

    Parameters
    ----------
    problem : LQProblem
        Arrays must be C-contiguous float64.
    control_shift : float or array
        sigma >= 0, added to the diagonal of the control Hessians. Shape () | (N, 1) | (nu,) | (N, nu).
    state_shift : float
        tau >= 0, added to the diagonal of the state Hessians.
    held : array of bool
        Controls that stay at zero. Shape (N, nu).
    refinements : int
        Rounds of iterative refinement. Unless given, one where the pivots of G spread over more than `WIDE`, none
        elsewhere; one is enough but for extreme weights.

    Raises
    ------
    NotPositiveDefinite
        Naming the step; step 0 where the cost has no minimum over the free entries of x_0.
    """
    A, B, Q, R, M, q, r, c, free = problem
    N, nx, nu = B.shape
    shift = np.full((N, nu), control_shift, dtype=np.float64)
    mask = np.zeros((N, nu), np.bool_) if held is None else held
    K, L, F = np.empty((N, nu, nx)), np.zeros((N, nu, nu)), np.empty((N, nx, nx))
    P, work = np.empty((N + 1, nx, nx)), np.empty(3 * nx * nx + 2 * nx * nu + nu * nu + nx + nu)
    failed = _factorize(A, B, Q, R, M, shift, state_shift, mask, K, L, F, P, work)
    if failed >= 0:
        raise NotPositiveDefinite(failed)
    k, p = np.empty((N, nu)), np.empty((N + 1, nx))
    X, U = np.empty((N + 1, nx)), np.empty((N, nu))
    _vectors(A, B, q, r, c, mask, K, L, F, P, k, p, work)
    X[0] = 0.0
    if free is not None:
        X[0, free] = _start(P[0][np.ix_(free, free)], p[0, free])
    _follow(A, B, c, K, k, X, U)
    if refinements is None:
        refinements = int(_spread(L, mask) > WIDE)
    if refinements:
        correction = tuple(np.empty_like(array) for array in (k, p, X, U))
        residual_q, residual_r, residual_c = np.empty_like(q), np.empty_like(r), np.empty_like(c)
        for _ in range(refinements):
            linear_terms_about(A, B, Q, R, M, q, r, c, X, U, residual_q, residual_r, residual_c)
            residual_r += shift * U
            residual_q += state_shift * X
            more_k, more_p, more_X, more_U = correction
            _vectors(A, B, residual_q, residual_r, residual_c, mask, K, L, F, P, more_k, more_p, work)
            more_X[0] = 0.0
            if free is not None:
                more_X[0, free] = _start(P[0][np.ix_(free, free)], more_p[0, free])
            _follow(A, B, residual_c, K, more_k, more_X, more_U)
            X += more_X
            U += more_U
        k = U + np.einsum("nij,nj->ni", K, X[:-1])
    return LQSolution(K, k, X, U, P, p)


def _start(P: Array, p: Array) -> Array:
    """Minimizer of 1/2 x'P x + p'x. Raises NotPositiveDefinite."""
    values, V = np.linalg.eigh(P) if np.isfinite(P).all() else (np.array([-np.inf]), P)
    least = LEAST_CURVATURE * float(np.abs(values).max(initial=0.0))
    if not (values >= -least).all():
        raise NotPositiveDefinite(0, "initial state")
    slope = V.T @ p
    undetermined = (values <= least) & (np.abs(slope) <= LEAST_CURVATURE * np.abs(p).max(initial=0.0))
    x: Array = -V @ np.where(undetermined, 0.0, slope / np.maximum(values, least or 1.0))
    return x


def _spread(L: Array, held: Mask) -> float:
    """Largest pivot of all G over the least; pivots of held controls do not count."""
    pivots = L.diagonal(axis1=1, axis2=2)
    if held.any():
        pivots = pivots[~held]
    return float((pivots.max() / pivots.min()) ** 2) if pivots.size else 1.0


@array_kernel(
    "lq-factorize",
    "i8(f8[3], f8[3], f8[3], f8[3], f8[3], f8[2], f8, b1[2], f8[3], f8[3], f8[3], f8[3], f8[1])",
)
def _factorize(A, B, Q, R, M, shift, state_shift, held, K, L, F, P, work):
    """Matrix recursion: K, the Cholesky factor L of G, F = A - B K and P. Returns the failing step, or -1."""
    N, nx, nu = B.shape
    PF, BK, KRK = part(work, 0, nx, nx), part(work, nx * nx, nx, nx), part(work, 2 * nx * nx, nx, nx)
    rest = 3 * nx * nx
    PB, RK, G = part(work, rest, nx, nu), part(work, rest + nx * nu, nu, nx), part(work, rest + 2 * nx * nu, nu, nu)
    copy_matrix(Q[N], P[N])
    for i in range(nx):
        P[N, i, i] += state_shift
    for n in range(N - 1, -1, -1):
        multiply(P[n + 1], B[n], PB)
        multiply_transposed(PB, B[n], G)
        for i in range(nu):
            for j in range(i + 1):
                G[i, j] = 0.5 * (G[i, j] + G[j, i]) + R[n, i, j]
            G[i, i] += shift[n, i]
        multiply_transposed(PB, A[n], K[n])
        for i in range(nu):
            for j in range(nx):
                K[n, i, j] += M[n, i, j]
        for i in range(nu):
            if held[n, i]:
                _hold(i, G, K[n])
        if not cholesky(G, L[n]):
            return n
        cholesky_solve(L[n], K[n])
        multiply(B[n], K[n], BK)
        for i in range(nx):
            for j in range(nx):
                F[n, i, j] = A[n, i, j] - BK[i, j]
        # K'(R_sigma K / 2 - M) plus its transpose is K'R_sigma K - K'M - M'K
        multiply(R[n], K[n], RK)
        for i in range(nu):
            for j in range(nx):
                RK[i, j] = 0.5 * (RK[i, j] + shift[n, i] * K[n, i, j]) - M[n, i, j]
        multiply_transposed(K[n], RK, KRK)
        multiply(P[n + 1], F[n], PF)
        multiply_transposed(F[n], PF, P[n])
        for i in range(nx):
            for j in range(i + 1):
                entry = 0.5 * (P[n, i, j] + P[n, j, i]) + KRK[i, j] + KRK[j, i] + Q[n, i, j]
                P[n, i, j] = entry
                P[n, j, i] = entry
            P[n, i, i] += state_shift
    return -1


@helper(cache=True)
def _hold(i, G, K):
    """Take control i out: its row and column of G (lower half) become those of the identity, its row of K zero."""
    for j in range(G.shape[0]):
        if j < i:
            G[i, j] = 0.0
        elif j > i:
            G[j, i] = 0.0
    G[i, i] = 1.0
    K[i, :] = 0.0


@array_kernel(
    "lq-vectors",
    "void(f8[3], f8[3], f8[2], f8[2], f8[2], b1[2], f8[3], f8[3], f8[3], f8[3], f8[2], f8[2], f8[1])",
)
def _vectors(A, B, q, r, c, held, K, L, F, P, k, p, work):
    """Vector recursion with a factorization at hand: feedforward k and p back."""
    N, nx, nu = B.shape
    beyond, column, gaps = part(work, 0, 1, nx)[0], part(work, nx, nu, 1), False
    for n in range(N):
        for i in range(nx):
            gaps = gaps or c[n, i] != 0.0
    copy(q[N], p[N])
    for n in range(N - 1, -1, -1):
        copy(p[n + 1], beyond)
        if gaps:
            add_product(P[n + 1], c[n], beyond)  # p + P c
        copy(r[n], column[:, 0])
        add_transposed_product(B[n], beyond, column[:, 0])
        for i in range(nu):
            if held[n, i]:
                column[i, 0] = 0.0
        cholesky_solve(L[n], column)
        copy(q[n], p[n])
        add_transposed_product(F[n], beyond, p[n])
        for i in range(nu):
            k[n, i] = -column[i, 0]
            for j in range(nx):
                p[n, j] -= K[n, i, j] * r[n, i]


@array_kernel("lq-closed-loop", "void(f8[3], f8[3], f8[2], f8[3], f8[2], f8[2], f8[2])")
def _follow(A, B, c, K, k, X, U):
    """States X from X[0] on and controls U under the feedback."""
    N, nx, nu = B.shape
    for n in range(N):
        for i in range(nu):
            total = k[n, i]
            for j in range(nx):
                total -= K[n, i, j] * X[n, j]
            U[n, i] = total
        copy(c[n], X[n + 1])
        add_product(A[n], X[n], X[n + 1])
        add_product(B[n], U[n], X[n + 1])
