"""Factorization and products of matrices that are mostly zero, in the order in which trees stay sparse.

Matrices of a kinematic tree have entries only between dofs of one branch. Eliminating from the last dof to the first
(leaves before roots) fills in nothing (Featherstone 2005), and skipping zeros makes the dense loops sparse. The
matrices need not be symmetric: A = U L with U unit upper, L lower triangular.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.spatial import compiled, inlined


@compiled
def factorize(A):
    """Overwrite A with its factors; False when a pivot is zero or not a number."""
    fine = True
    for k in range(A.shape[0] - 1, -1, -1):
        pivot = A[k, k]
        fine = fine and abs(pivot) > 1e-300 and abs(pivot) < 1e300
        inverse = 1.0 / pivot
        for i in range(k):
            if A[i, k] != 0.0:
                factor = A[i, k] * inverse
                A[i, k] = factor
                for j in range(k):
                    A[i, j] -= factor * A[k, j]
    return fine


@compiled
def solve(A, X):
    """X = A^-1 X, with the factors in A; the columns of X are solved together."""
    n, columns = X.shape
    for k in range(n - 1, -1, -1):
        for i in range(k):
            factor = A[i, k]
            if factor != 0.0:
                for c in range(columns):
                    X[i, c] -= factor * X[k, c]
    for k in range(n):
        for j in range(k):
            factor = A[k, j]
            if factor != 0.0:
                for c in range(columns):
                    X[k, c] -= factor * X[j, c]
        inverse = 1.0 / A[k, k]
        for c in range(columns):
            X[k, c] *= inverse


@compiled
def add_product(A, X, out):
    """Out += A X."""
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            factor = A[i, k]
            if factor != 0.0:
                for c in range(X.shape[1]):
                    out[i, c] += factor * X[k, c]


@inlined
def fill(A, value):
    """Set all entries."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] = value


@inlined
def assign(A, B):
    """A = B."""
    # not A[:, :] = B, whose check of shapes takes seconds to compile
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] = B[i, j]


@inlined
def add_matrix(A, B):
    """A += B."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] += B[i, j]
