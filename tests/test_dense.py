"""Products and factorizations of small matrices, which the sweeps are made of."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjslq.lq import dense

seeds = st.integers(0, 2**32 - 1)


edge = round(dense.SMALL ** (1 / 3))
shapes = [(1, 1, 1), (3, 2, 5), (edge, edge, edge), (edge, edge, edge + 1), (7, 14, 14), (40, 40, 6), (30, 40, 20)]


def test_shapes_lie_on_both_sides_of_the_threshold():
    below = [np.prod(shape) <= dense.SMALL for shape in shapes]
    assert any(below) and not all(below)


@pytest.mark.parametrize("rows, inner, columns", shapes)
def test_products_are_numpys(rows, inner, columns):
    rng = np.random.default_rng(rows * inner)
    A, B = rng.standard_normal((rows, inner)), rng.standard_normal((inner, columns))
    out = np.full((rows, columns), np.nan)  # whatever stands in it is overwritten
    dense.multiply(A, B, out)
    np.testing.assert_allclose(out, A @ B, rtol=1e-13, atol=1e-13)
    out[:] = np.nan
    dense.multiply_transposed(np.ascontiguousarray(A.T), B, out)
    np.testing.assert_allclose(out, A @ B, rtol=1e-13, atol=1e-13)
    x, start = rng.standard_normal(inner), rng.standard_normal(rows)
    for product, matrix in ((dense.add_product, A), (dense.add_transposed_product, np.ascontiguousarray(A.T))):
        total = start.copy()
        product(matrix, x, total)
        np.testing.assert_allclose(total, start + A @ x, rtol=1e-13, atol=1e-13)


@given(st.integers(1, 30), st.integers(1, 12), seeds)
def test_cholesky_is_numpys(n, columns, seed):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n + 3))
    A, B = root @ root.T, rng.standard_normal((n, columns))
    L = np.zeros((n, n))
    assert dense.cholesky(np.tril(A) + np.triu(np.full((n, n), np.nan), 1), L)  # only the lower half is read
    np.testing.assert_allclose(L, np.linalg.cholesky(A), rtol=1e-9, atol=1e-11)
    X = B.copy()
    dense.cholesky_solve(L, X)
    np.testing.assert_allclose(A @ X, B, rtol=1e-8, atol=1e-9 * np.abs(A).max() * np.abs(X).max())


@pytest.mark.parametrize("corner", [0.0, -1.0, np.nan, np.inf, -np.inf])
def test_cholesky_refuses_what_is_not_positive_definite(corner):
    for where in range(3):
        A = np.eye(3)
        A[where, where] = corner
        assert not dense.cholesky(A, np.zeros((3, 3)))
    assert not dense.cholesky(np.array([[1.0, 2.0], [2.0, 1.0]]), np.zeros((2, 2)))


@settings(max_examples=5)
@given(seeds)
def test_kernels_are_the_same_compiled_or_not(seed):
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((4, 4)), rng.standard_normal((4, 5))  # small enough for the loops
    compiled, plain = np.empty((4, 5)), np.empty((4, 5))
    dense.multiply(A, B, compiled)
    dense.multiply.function(A, B, plain)
    np.testing.assert_allclose(compiled, plain, rtol=1e-15, atol=1e-15)
