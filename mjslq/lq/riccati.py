"""The LQ tracking sweep (Sideris and Bobrow 2005, Algorithm 1) for time-varying, affine problems with cross terms.

Problem
-------
    minimize   sum_{n<N} [ 1/2 x'Q_n x + q_n'x + 1/2 u'R_n u + r_n'u + u'M_n x ]  +  1/2 x_N'Q_N x_N + q_N'x_N
    subject to x_{n+1} = A_n x_n + B_n u_n + c_n,   x_0 = 0

Targets are linear terms: Q (x - x_o) = Q x + q with q = -Q x_o.

Notation
--------
    A  (N, nx, nx)    B  (N, nx, nu)    c  (N, nx)          dynamics; c holds the gaps of a state guess
    Q  (N+1, nx, nx)  R  (N, nu, nu)    M  (N, nu, nx)      Hessian of the stage costs
    q  (N+1, nx)      r  (N, nu)                            gradient of the stage costs
    P  (N+1, nx, nx)  p  (N+1, nx)                          cost-to-go 1/2 x'P x + p'x
    K  (N, nu, nx)    k  (N, nu)                            the minimizer u_n = k_n - K_n x_n

Recursion, from P_N = Q_N, p_N = q_N down
-----------------------------------------
    G = R_mu + B'P B,   K = G^-1 (M + B'P A),   k = -G^-1 (r + B'(p + P c)),   R_mu = R + mu I
    F = A - B K
    P <- Q - K'M - M'K + K'R_mu K + F'P F       (Joseph's form)
    p <- q - K'r + F'(p + P c)

The paper's (23)-(26) give the same P and s = p through an inverse that is not symmetric. Joseph's form adds squares
only, so that P stays symmetric and positive semidefinite under rounding, and an error in K enters P in second order;
it costs nx^2 nu multiplications more than the shortest form, which is little. `solve` then repeats the two vector
recursions on the residual of the first-order conditions (iterative refinement) where the pivots of G tell that it
matters: with terminal weights 1e12 times the control weights that takes the error of the controls from 1e-5 to 1e-10.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from mjslq.lq.dense import (
    add_product,
    add_transposed_product,
    cholesky,
    cholesky_solve,
    multiply,
    multiply_transposed,
)
from mjslq.validation import Array

WIDE = 1e4
"""Spread of the pivots of G up to which rounding stays below 1e-11 without refinement."""


class LQProblem(NamedTuple):
    """Coefficients of an LQ tracking problem; see the notation at the head of this file."""

    A: Array
    B: Array
    Q: Array
    R: Array
    M: Array
    q: Array
    r: Array
    c: Array


class LQSolution(NamedTuple):
    """Minimizer of an LQ tracking problem."""

    K: Array
    """Feedback gains of u_n = k_n - K_n x_n. Shape (N, nu, nx)."""
    k: Array
    """Feedforward. Shape (N, nu)."""
    X: Array
    """Optimal states. Shape (N + 1, nx)."""
    U: Array
    """Optimal controls. Shape (N, nu)."""
    P: Array
    """Hessian of the cost-to-go. Shape (N + 1, nx, nx)."""
    p: Array
    """Gradient of the cost-to-go at x = 0. Shape (N + 1, nx)."""


class NotPositiveDefinite(ArithmeticError):
    """R + B'P B + mu I is not positive definite at `step`: the problem has no minimizer."""

    def __init__(self, step: int) -> None:
        super().__init__(f"the Hessian with respect to the control is not positive definite at step {step}")
        self.step = step


def solve(problem: LQProblem, multiplier: float = 0.0, refinements: int | None = None) -> LQSolution:
    """Minimize by one sweep back and one forth.

    Parameters
    ----------
    problem : LQProblem
        Arrays must be C-contiguous float64.
    multiplier : float
        mu >= 0, added to the diagonal of the control Hessian.
    refinements : int
        Rounds of iterative refinement. Unless given, one where the pivots of G spread over more than `WIDE`, none
        elsewhere; one is enough but for extreme weights.

    Raises
    ------
    NotPositiveDefinite
        Naming the step.
    """
    A, B, Q, R, M, q, r, c = problem
    N, nx, nu = B.shape
    K, L, F = np.empty((N, nu, nx)), np.zeros((N, nu, nu)), np.empty((N, nx, nx))
    P = np.empty((N + 1, nx, nx))
    failed = _factorize(A, B, Q, R, M, multiplier, K, L, F, P)
    if failed >= 0:
        raise NotPositiveDefinite(failed)
    k, p = np.empty((N, nu)), np.empty((N + 1, nx))
    X, U = np.empty((N + 1, nx)), np.empty((N, nu))
    _vectors(A, B, q, r, c, K, L, F, P, k, p, X, U)
    if refinements is None:
        pivots = L.diagonal(axis1=1, axis2=2)
        refinements = int(pivots.max(initial=0.0) ** 2 > WIDE * pivots.min(initial=np.inf) ** 2)
    if refinements:
        correction = tuple(np.empty_like(array) for array in (k, p, X, U))
        residual_q, residual_r, residual_c = np.empty_like(q), np.empty_like(r), np.empty_like(c)
        for _ in range(refinements):
            _residual(A, B, Q, R, M, q, r, c, multiplier, X, U, residual_q, residual_r, residual_c)
            _vectors(A, B, residual_q, residual_r, residual_c, K, L, F, P, *correction)
            X += correction[2]
            U += correction[3]
        k = U + np.einsum("nij,nj->ni", K, X[:-1])
    return LQSolution(K, k, X, U, P, p)


@njit(cache=True, nogil=True)
def _factorize(A, B, Q, R, M, mu, K, L, F, P):
    """Matrix recursion: K, the Cholesky factor L of G, F = A - B K and P. Returns the failing step, or -1."""
    N, nx, nu = B.shape
    PB, PF = np.empty((nx, nu)), np.empty((nx, nx))
    G, BK, RK, KRK = np.empty((nu, nu)), np.empty((nx, nx)), np.empty((nu, nx)), np.empty((nx, nx))
    P[N] = Q[N]
    for n in range(N - 1, -1, -1):
        multiply(P[n + 1], B[n], PB)
        multiply_transposed(PB, B[n], G)
        for i in range(nu):
            for j in range(i + 1):
                G[i, j] = 0.5 * (G[i, j] + G[j, i]) + R[n, i, j]
            G[i, i] += mu
        if not cholesky(G, L[n]):
            return n
        multiply_transposed(PB, A[n], K[n])
        for i in range(nu):
            for j in range(nx):
                K[n, i, j] += M[n, i, j]
        cholesky_solve(L[n], K[n])
        multiply(B[n], K[n], BK)
        for i in range(nx):
            for j in range(nx):
                F[n, i, j] = A[n, i, j] - BK[i, j]
        # K'((R + mu I) K / 2 - M) plus its transpose is K'(R + mu I) K - K'M - M'K
        multiply(R[n], K[n], RK)
        for i in range(nu):
            for j in range(nx):
                RK[i, j] = 0.5 * (RK[i, j] + mu * K[n, i, j]) - M[n, i, j]
        multiply_transposed(K[n], RK, KRK)
        multiply(P[n + 1], F[n], PF)
        multiply_transposed(F[n], PF, P[n])
        for i in range(nx):
            for j in range(i + 1):
                entry = 0.5 * (P[n, i, j] + P[n, j, i]) + KRK[i, j] + KRK[j, i] + Q[n, i, j]
                P[n, i, j] = entry
                P[n, j, i] = entry
    return -1


@njit(cache=True, nogil=True)
def _vectors(A, B, q, r, c, K, L, F, P, k, p, X, U):
    """Vector recursion with a factorization at hand: feedforward k and p back, states X and controls U forth."""
    N, nx, nu = B.shape
    beyond, column, gaps = np.empty(nx), np.empty((nu, 1)), c.any()
    p[N] = q[N]
    for n in range(N - 1, -1, -1):
        beyond[:] = p[n + 1]
        if gaps:
            add_product(P[n + 1], c[n], beyond)  # p + P c
        column[:, 0] = r[n]
        add_transposed_product(B[n], beyond, column[:, 0])
        cholesky_solve(L[n], column)
        p[n] = q[n]
        add_transposed_product(F[n], beyond, p[n])
        for i in range(nu):
            k[n, i] = -column[i, 0]
            for j in range(nx):
                p[n, j] -= K[n, i, j] * r[n, i]
    X[0] = 0.0
    for n in range(N):
        for i in range(nu):
            total = k[n, i]
            for j in range(nx):
                total -= K[n, i, j] * X[n, j]
            U[n, i] = total
        X[n + 1] = c[n]
        add_product(A[n], X[n], X[n + 1])
        add_product(B[n], U[n], X[n + 1])


@njit(cache=True, nogil=True)
def _residual(A, B, Q, R, M, q, r, c, mu, X, U, residual_q, residual_r, residual_c):
    """Linear terms of the same problem written about (X, U): what a correction has to remove."""
    N, nx, nu = B.shape
    for n in range(N + 1):
        residual_q[n] = q[n]
        add_product(Q[n], X[n], residual_q[n])
        if n == N:
            break
        add_transposed_product(M[n], U[n], residual_q[n])
        for i in range(nu):
            residual_r[n, i] = r[n, i] + mu * U[n, i]
        add_product(R[n], U[n], residual_r[n])
        add_product(M[n], X[n], residual_r[n])
        for i in range(nx):
            residual_c[n, i] = c[n, i] - X[n + 1, i]
        add_product(A[n], X[n], residual_c[n])
        add_product(B[n], U[n], residual_c[n])
