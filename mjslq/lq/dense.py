"""Small dense products and factorizations for compiled sweeps: plain loops when small, BLAS when large.

Every function writes into an array given to it, so that a sweep allocates nothing per step. Up to about 4 x 4 the
loops beat BLAS, whose call overhead they avoid; at 14 x 14 BLAS is four times as fast.
"""

from __future__ import annotations

import numpy as np

from mjslq.lq.blas import gemm
from mjslq.native.declare import helper
from mjslq.native.memory import carray, pointer

SMALL = 100
"""Multiply-adds below which the plain loops are used."""


@helper()  # not kept by numba, which would not make BLAS known when it finds it
def multiply(A, B, out):
    """Out = A B."""
    rows, inner, columns = A.shape[0], A.shape[1], B.shape[1]
    if rows * inner * columns > SMALL:
        gemm(0, columns, rows, inner, B.ctypes.data, A.ctypes.data, inner, out.ctypes.data)  # out' = B'A'
        return
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0.0
        for k in range(inner):
            a = A[i, k]
            for j in range(columns):
                out[i, j] += a * B[k, j]


@helper()  # not kept by numba, which would not make BLAS known when it finds it
def multiply_transposed(A, B, out):
    """Out = A' B."""
    inner, rows, columns = A.shape[0], A.shape[1], B.shape[1]
    if rows * inner * columns > SMALL:
        gemm(1, columns, rows, inner, B.ctypes.data, A.ctypes.data, rows, out.ctypes.data)  # out' = B'(A')'
        return
    out[:, :] = 0.0
    for k in range(inner):
        for i in range(rows):
            a = A[k, i]
            for j in range(columns):
                out[i, j] += a * B[k, j]


@helper(cache=True, fastmath={"contract", "reassoc"})
def add_transposed_product(A, x, out):
    """Out += A' x."""
    for k in range(A.shape[0]):
        for i in range(A.shape[1]):
            out[i] += A[k, i] * x[k]


@helper(cache=True, fastmath={"contract", "reassoc"})  # sums in any order, so that they vectorize
def add_product(A, x, out):
    """Out += A x."""
    for i in range(A.shape[0]):
        total = 0.0
        for k in range(A.shape[1]):
            total += A[i, k] * x[k]
        out[i] += total


@helper(cache=True)
def cholesky(A, L):
    """Write the lower factor of symmetric A into L; False when A is not positive definite (or not finite)."""
    n = A.shape[0]
    for j in range(n):
        diagonal = A[j, j]
        for k in range(j):
            diagonal -= L[j, k] * L[j, k]
        if not diagonal > 0.0 or not np.isfinite(diagonal):
            return False
        L[j, j] = np.sqrt(diagonal)
        for i in range(j + 1, n):
            entry = A[i, j]
            for k in range(j):
                entry -= L[i, k] * L[j, k]
            L[i, j] = entry / L[j, j]
    return True


@helper(cache=True)
def cholesky_solve(L, B):
    """Overwrite B with the solution of L L' X = B, all columns at once."""
    n, columns = B.shape
    for i in range(n):
        for k in range(i):
            factor = L[i, k]
            for j in range(columns):
                B[i, j] -= factor * B[k, j]
        for j in range(columns):
            B[i, j] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            factor = L[k, i]
            for j in range(columns):
                B[i, j] -= factor * B[k, j]
        for j in range(columns):
            B[i, j] /= L[i, i]


@helper(cache=True)
def copy(x, out):
    """Out = x, for rows of numbers: as a statement it would compare the lengths, and raise an exception."""
    for i in range(out.shape[0]):
        out[i] = x[i]


@helper(cache=True)
def copy_matrix(A, out):
    """Out = A."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = A[i, j]


@helper(forceinline=True)
def part(work, first, rows, columns):
    """The matrix that lies in the numbers of `work` from `first` on."""
    return carray(pointer(work.ctypes.data + 8 * first), (rows, columns), np.float64)
