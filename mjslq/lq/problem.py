"""The LQ tracking problem that the sweeps of this package solve: time-varying, affine, with cross terms.

    minimize   sum_{n<N} [ 1/2 x'Q_n x + q_n'x + 1/2 u'R_n u + r_n'u + u'M_n x ]  +  1/2 x_N'Q_N x_N + q_N'x_N
    subject to x_{n+1} = A_n x_n + B_n u_n + c_n,   x_0 = 0, but for entries of x_0 that are unknown, too

Targets are linear terms: Q (x - x_o) = Q x + q with q = -Q x_o.

Notation
--------
    A  (N, nx, nx)    B  (N, nx, nu)    c  (N, nx)          dynamics; c holds the gaps of a state guess
    Q  (N+1, nx, nx)  R  (N, nu, nu)    M  (N, nu, nx)      Hessian of the stage costs
    q  (N+1, nx)      r  (N, nu)                            gradient of the stage costs

All arrays are C-contiguous float64.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mjslq.lq.dense import add_product, add_transposed_product, copy, part
from mjslq.native.arrays import array_kernel
from mjslq.validation import Array

Mask = np.ndarray[Any, np.dtype[np.bool_]]
"""One truth value for each control of each step. Shape (N, nu)."""


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
    free: Mask | None = None
    """Entries of x_0 that are unknown; None for none. Shape (nx,)."""

    def states(self, U: Array, x0: Array | None = None) -> Array:
        """States from `x0` (nx,), zero unless given, under the controls `U` (N, nu). Shape (N + 1, nx)."""
        X = np.empty_like(self.q)
        X[0] = 0.0 if x0 is None else x0
        _states(self.A, self.B, self.c, U, X)
        return X

    def value(self, X: Array, U: Array) -> float:
        """Cost of the states `X` (N + 1, nx) and controls `U` (N, nu)."""
        work = np.empty(X.shape[1] + U.shape[1])
        return float(_value(self.Q, self.R, self.M, self.q, self.r, X, U, work))

    def control_gradient(self, X: Array, U: Array, costates: Array) -> Array:
        """Derivative of the Lagrangian by the controls, r + R u + M x + B'lambda_{n+1}. Shape (N, nu)."""
        gradient = np.empty_like(self.r)
        _control_gradient(self.B, self.R, self.M, self.r, X, U, costates, gradient)
        return gradient

    def about(self, X: Array, U: Array) -> LQProblem:
        """The same problem in the differences from (X, U): other linear terms, other gaps."""
        q, r, c = np.empty_like(self.q), np.empty_like(self.r), np.empty_like(self.c)
        linear_terms_about(*self[:8], X, U, q, r, c)
        return self._replace(q=q, r=r, c=c)


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
    """Hessian of the cost-to-go 1/2 x'P x + p'x under the feedback. Shape (N + 1, nx, nx)."""
    p: Array
    """Gradient of the cost-to-go at x = 0. Shape (N + 1, nx)."""

    @property
    def costates(self) -> Array:
        """lambda_n = p_n + P_n x_n, the multipliers of the dynamics. Shape (N + 1, nx)."""
        return self.p + np.einsum("nij,nj->ni", self.P, self.X)


class NotPositiveDefinite(ArithmeticError):
    """R + B'P B is not positive definite at `step`, or P_0 on the free entries: the problem has no minimizer."""

    def __init__(self, step: int, unknown: str = "control") -> None:
        super().__init__(f"the Hessian with respect to the {unknown} is not positive definite at step {step}")
        self.step = step


@array_kernel("lq-states", "void(f8[3], f8[3], f8[2], f8[2], f8[2])")
def _states(A, B, c, U, X):
    for n in range(U.shape[0]):
        copy(c[n], X[n + 1])
        add_product(A[n], X[n], X[n + 1])
        add_product(B[n], U[n], X[n + 1])


@array_kernel("lq-control-gradient", "void(f8[3], f8[3], f8[3], f8[2], f8[2], f8[2], f8[2], f8[2])")
def _control_gradient(B, R, M, r, X, U, costates, gradient):
    for n in range(U.shape[0]):
        copy(r[n], gradient[n])
        add_product(R[n], U[n], gradient[n])
        add_product(M[n], X[n], gradient[n])
        add_transposed_product(B[n], costates[n + 1], gradient[n])


@array_kernel("lq-value", "f8(f8[3], f8[3], f8[3], f8[2], f8[2], f8[2], f8[2], f8[1])")
def _value(Q, R, M, q, r, X, U, work):
    total, nx, nu = 0.0, X.shape[1], U.shape[1]
    gx, gu = part(work, 0, 1, nx)[0], part(work, nx, 1, nu)[0]
    for n in range(X.shape[0]):
        gx[:] = 0.0
        add_product(Q[n], X[n], gx)
        for i in range(nx):
            total += X[n, i] * (q[n, i] + 0.5 * gx[i])
        if n < U.shape[0]:
            gu[:] = 0.0
            add_product(R[n], U[n], gu)
            for i in range(nu):
                gu[i] *= 0.5
            add_product(M[n], X[n], gu)
            for i in range(nu):
                total += U[n, i] * (r[n, i] + gu[i])
    return total


@array_kernel(
    "lq-linear-terms",
    "void(f8[3], f8[3], f8[3], f8[3], f8[3], f8[2], f8[2], f8[2], f8[2], f8[2], f8[2], f8[2], f8[2])",
)
def linear_terms_about(A, B, Q, R, M, q, r, c, X, U, new_q, new_r, new_c):
    """Write the linear terms and gaps of the problem in the differences from (X, U)."""
    N, nx = B.shape[0], B.shape[1]
    for n in range(N + 1):
        copy(q[n], new_q[n])
        add_product(Q[n], X[n], new_q[n])
        if n == N:
            break
        add_transposed_product(M[n], U[n], new_q[n])
        copy(r[n], new_r[n])
        add_product(R[n], U[n], new_r[n])
        add_product(M[n], X[n], new_r[n])
        for i in range(nx):
            new_c[n, i] = c[n, i] - X[n + 1, i]
        add_product(A[n], X[n], new_c[n])
        add_product(B[n], U[n], new_c[n])
