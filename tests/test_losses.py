"""Losses: values against the formulas, slopes and curvatures against differences, convexity, refusals."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mjslq.losses import NAMES, WIDTH, bind_loss

seeds = st.integers(0, 2**32 - 1)
losses = st.sampled_from(NAMES)
widths = st.sampled_from([0.03, 0.1, 1.0, 7.0])
ROBUST = [name for name in NAMES if name != "quadratic"]


def rho(name, s, d):
    """The losses of one length, as they are written in papers."""
    if name == "quadratic":
        return 0.5 * s * s
    if name == "huber":
        return 0.5 * s * s if s <= d else d * (s - 0.5 * d)
    if name == "pseudo-huber":
        return d * d * (math.sqrt(1.0 + (s / d) ** 2) - 1.0)
    return math.sqrt(s * s + d * d) - d


def random_case(seed, name, width, rank=None):
    """A loss of residuals (k, m) with a random weight, of lengths within the width and far beyond it."""
    rng = np.random.default_rng(seed)
    k, m = rng.integers(1, 6), rng.integers(1, 5)
    root = rng.standard_normal((m if rank is None else rank, m))
    W, scales = (root.T @ root)[None], rng.uniform(0.01, 2.0, k)
    assume(np.trace(W[0]) > 1e-3)
    r = rng.standard_normal((k, m)) * rng.choice([0.3, 1.0, 20.0], (k, 1)) * width
    loss = bind_loss(name, None if name == "quadratic" else width, W, scales)
    return loss, W[0], scales, r


def dense(loss, r):
    """Second derivatives by the residual at each knot."""
    s, W, bend = loss.curvature(r)
    p = loss.slope(r)
    H = s[:, None, None] * np.broadcast_to(W, (len(r), *W.shape[1:]))
    return H if bend is None else H + bend[:, None, None] * p[:, :, None] * p[:, None, :]


def lengths(W, r):
    return np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", r, W / np.diag(W).mean(), r), 0.0))


@given(seeds, losses, widths)
def test_value_is_the_formula(seed, name, width):
    loss, W, scales, r = random_case(seed, name, width)
    w = np.diag(W).mean()
    reference = [c * w * rho(name, s, width) for c, s in zip(scales, lengths(W, r), strict=True)]
    np.testing.assert_allclose(loss.value(r), reference, rtol=1e-9, atol=1e-14 * w)
    assert loss.total(r) == pytest.approx(sum(reference), rel=1e-9)


@given(seeds, losses, widths)
def test_slope_and_curvature_against_differences(seed, name, width):
    loss, W, _, r = random_case(seed, name, width)
    s = lengths(W, r)
    assume(name != "huber" or (np.abs(s - width) > 0.02 * width).all())  # its curvature jumps there
    slope, H = loss.slope(r), dense(loss, r)
    e = 1e-4 * width / math.sqrt(np.linalg.eigvalsh(W)[-1] / np.diag(W).mean())
    for i in range(r.shape[1]):
        d = np.zeros_like(r)
        d[:, i] = e

        def difference(f, d=d):
            near, far = f(r + d) - f(r - d), f(r + 2 * d) - f(r - 2 * d)
            return (8.0 * near - far) / (12.0 * e)

        atol = 1e-15 * np.abs(loss.value(r)).max() / e
        np.testing.assert_allclose(slope[:, i], difference(loss.value), rtol=1e-7, atol=100.0 * atol)
        atol = 1e-8 * np.abs(H).max(axis=(1, 2), keepdims=True)[:, 0] + 1e-14 * np.abs(slope).max() / e
        assert (np.abs(H[:, :, i] - difference(loss.slope)) <= atol).all()


@given(seeds, losses, widths, st.sampled_from([None, 1]))
def test_losses_are_convex(seed, name, width, rank):
    loss, _, _, r = random_case(seed, name, width, rank)
    H = dense(loss, r)
    parts, W, _ = loss.curvature(r)  # the first of two parts, whose difference may vanish
    assert (np.linalg.eigvalsh(H)[:, 0] >= -1e-14 * parts * np.linalg.norm(W[0])).all()
    other, t = np.random.default_rng(seed).standard_normal(r.shape) * width, 0.3
    chord = (1.0 - t) * loss.value(r) + t * loss.value(other)
    assert (loss.value((1.0 - t) * r + t * other) <= chord * (1.0 + 1e-12) + 1e-15).all()


@pytest.mark.parametrize("name", NAMES)
def test_at_zero_there_is_no_slope_and_the_curvature_is_the_weight(name):
    """Times 1/width for smooth-abs, whose parabola is that much steeper."""
    W, r = np.diag([1.0, 3.0])[None], np.zeros((2, 2))
    loss = bind_loss(name, None, W, np.array([0.5, 1.0]))
    np.testing.assert_array_equal(loss.value(r), 0.0)
    np.testing.assert_array_equal(loss.slope(r), 0.0)
    expected = W * np.array([0.5, 1.0])[:, None, None] / (WIDTH if name == "smooth-abs" else 1.0)
    np.testing.assert_allclose(dense(loss, r), expected, rtol=1e-13)


@pytest.mark.parametrize("name", ROBUST)
def test_far_out_the_pull_is_bounded(name):
    """w |r| for smooth-abs, w d |r| for the others."""
    weight, width = 3.0, 0.2
    loss = bind_loss(name, width, np.full((1, 1, 1), weight), np.ones(2))
    pull = weight * (1.0 if name == "smooth-abs" else width)
    np.testing.assert_allclose(loss.slope(np.array([[1e6], [-1e7]])), [[pull], [-pull]], rtol=1e-12)
    np.testing.assert_allclose(loss.value(np.array([[1e6], [-1e7]])), pull * np.array([1e6, 1e7]), rtol=1e-6)


@pytest.mark.parametrize("name", ROBUST)
def test_small_residuals_lose_no_digits(name):
    loss = bind_loss(name, 1.0, np.ones((1, 1, 1)), np.ones(1))
    assert loss.value(np.array([[1e-9]]))[0] == pytest.approx(0.5e-18, rel=1e-12)


@pytest.mark.parametrize(
    "name, width, sentence",
    [
        ("square", None, "unknown loss 'square'; there are: quadratic, smooth-abs, huber, pseudo-huber"),
        ("hubber", 1.0, "did you mean 'huber'?"),
        (None, None, "unknown loss None; there are: quadratic"),
        ("quadratic", 1.0, "width is for the losses smooth-abs, huber, pseudo-huber; the quadratic loss, which is"),
        ("huber", 0.0, "width must be positive and finite, got 0"),
        ("smooth-abs", -1.0, "width must be positive and finite, got -1"),
        ("pseudo-huber", math.nan, "width must be positive and finite, got nan"),
        ("pseudo-huber", "wide", "width must be a number, got str 'wide'"),
    ],
)
def test_wrong_losses_are_refused_in_one_sentence(name, width, sentence):
    with pytest.raises(ValueError) as caught:
        bind_loss(name, width, np.ones((1, 1, 1)), np.ones(1))
    assert sentence in str(caught.value) and "\n" not in str(caught.value)
