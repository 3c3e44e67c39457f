"""Kernels that add to expansions, against plain loops."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mjslq.quadratic import add_congruence, add_products, transposed_times, weighted

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.booleans())
def test_congruence(seed, per_knot):
    rng = np.random.default_rng(seed)
    k, m, a, b, N = *rng.integers(1, 5, 4), 7
    knots = np.sort(rng.choice(N, k, replace=False))
    J, K = (rng.standard_normal((k, m, size)) * rng.integers(0, 2, (k, m, size)) for size in (a, b))
    W, s = rng.standard_normal((k if per_knot else 1, m, m)), rng.standard_normal(k)
    W[..., 0] = 0.0
    into = rng.standard_normal((N, a, b))
    expected = into.copy()
    for i, n in enumerate(knots):
        expected[n] += s[i] * J[i].T @ W[i if per_knot else 0] @ K[i]
    add_congruence(J, s, W, K, knots, into)
    np.testing.assert_allclose(into, expected, rtol=1e-12, atol=1e-13)


@given(seeds)
def test_products(seed):
    rng = np.random.default_rng(seed)
    k, a, b, N = *rng.integers(1, 5, 3), 7
    knots = np.sort(rng.choice(N, k, replace=False))
    g, h, s = rng.standard_normal((k, a)), rng.standard_normal((k, b)), rng.standard_normal(k)
    into = rng.standard_normal((N, a, b))
    expected = into.copy()
    for i, n in enumerate(knots):
        expected[n] += s[i] * np.outer(g[i], h[i])
    add_products(s, g, h, knots, into)
    np.testing.assert_allclose(into, expected, rtol=1e-12, atol=1e-13)


@given(seeds, st.booleans())
def test_weighted_and_transposed_times(seed, per_knot):
    rng = np.random.default_rng(seed)
    k, m, a = rng.integers(1, 5, 3)
    s, d, J = rng.standard_normal(k), rng.standard_normal((k, m)), rng.standard_normal((k, m, a))
    W = rng.standard_normal((k if per_knot else 1, m, m))
    W = W + W.swapaxes(1, 2)
    reference = [s[n] * W[n if per_knot else 0] @ d[n] for n in range(k)]
    np.testing.assert_allclose(weighted(s, W, d), reference, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(transposed_times(J, d), [J[n].T @ d[n] for n in range(k)], rtol=1e-12, atol=1e-13)
