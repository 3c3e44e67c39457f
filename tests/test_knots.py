"""Knots that `when` names: indices, slices, times, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjslq.knots import knots_of

STEPS = np.array([0.1, 0.2, 0.15, 0.05, 0.3, 0.1])
N = len(STEPS)
GRID = np.concatenate([[0.0], np.cumsum(STEPS)])


@pytest.mark.parametrize(
    "when, indices, scales, label",
    [
        ("running", range(N), STEPS, "running"),
        ("terminal", [N], [1], "terminal"),
        ("always", range(N + 1), [*STEPS, 1], "always"),
        ("initial", [0], [1], "initial"),
        (2, [2], [1], "knot 2"),
        (np.int64(2), [2], [1], "knot 2"),
        (-1, [N], [1], "knot 6"),
        (-N - 1, [0], [1], "knot 0"),
        (slice(1, 4), [1, 2, 3], [1, 1, 1], "knots 1, 2, 3"),
        (slice(None, None, 3), [0, 3, 6], [1, 1, 1], "knots 0, 3, 6"),
        (slice(-5, None), [2, 3, 4, 5, 6], [1] * 5, "5 knots from 2 to 6"),
        ([0, 2, -1], [0, 2, 6], [1, 1, 1], "knots 0, 2, 6"),
        ((1, 2), [1, 2], [1, 1], "knots 1, 2"),
        (range(2, 5, 2), [2, 4], [1, 1], "knots 2, 4"),
        (np.array([4, 5]), [4, 5], [1, 1], "knots 4, 5"),
        (0.0, [0], [1], "knot 0"),
        (0.45, [3], [1], "knot 3"),
        (0.9 - 1e-12, [6], [1], "knot 6"),
        ([0.1, 0.3, 0.9], [1, 2, 6], [1, 1, 1], "knots 1, 2, 6"),
        (GRID, range(N + 1), [1] * (N + 1), "7 knots from 0 to 6"),
    ],
)
def test_knots(when, indices, scales, label):
    knots = knots_of(when, STEPS)
    np.testing.assert_array_equal(knots.indices, list(indices))
    np.testing.assert_array_equal(knots.scales(STEPS), scales)
    assert str(knots) == label and len(knots) == len(list(indices))


@given(st.sets(st.integers(0, N), min_size=1))
def test_arrays_are_indexed_alike_by_knots_and_by_steps(chosen):
    knots, indices = knots_of(sorted(chosen), STEPS), sorted(chosen)
    np.testing.assert_array_equal(GRID[knots.at], GRID[indices])
    np.testing.assert_array_equal(STEPS[knots.at_steps], [STEPS[n] for n in indices if n < N])
    np.testing.assert_array_equal(knots.steps, [n for n in indices if n < N])


@pytest.mark.parametrize(
    "when, sentence",
    [
        ("end", "unknown when 'end'; there are: running, terminal, always, initial"),
        ("Running", "did you mean 'running'?"),
        (7, "when names knot 7, but there are the knots 0 to 6 (or -7 to -1)"),
        ([0, -8], "when names knot -8, but there are the knots 0 to 6"),
        ([3, 1], "when must name knots in ascending order, each of them once, got 3, 1"),
        ([1, 1], "when must name knots in ascending order, each of them once, got 1, 1"),
        ([-1, 2], "when must name knots in ascending order, each of them once, got 6, 2"),
        (slice(None, None, -1), "when must name knots in ascending order, each of them once, got 6, 5"),
        ([], "when must pick at least one of the knots 0 to 6, but [] picks none"),
        (slice(7, 9), "when must pick at least one of the knots 0 to 6"),
        (slice("a", None), "when must be 'running', 'terminal', 'always', 'initial', or knots"),
        (slice(None, None, 0), "when must be 'running', 'terminal', 'always', 'initial', or knots"),
        (0.2, "when names the time 0.2 s, at which there is no knot; the nearest is knot 1 at 0.1 s"),
        ([0.1, 0.7], "when names the time 0.7 s, at which there is no knot; the nearest is knot 5 at 0.8 s"),
        (0.45 + 1e-8, "the nearest is knot 3 at 0.45 s"),
        (-0.1, "when names the time -0.1 s, at which there is no knot; the nearest is knot 0 at 0 s"),
        (float("nan"), "when names the time nan s, at which there is no knot"),
        (float("inf"), "when names the time inf s, at which there is no knot"),
        (True, "when must be 'running', 'terminal', 'always', 'initial', or knots: an index"),
        ([True, False], "or knots: an index, a time [s], a slice, or a list of either, got list"),
        (None, "or knots: an index, a time [s], a slice, or a list of either, got NoneType"),
        ([[1, 2]], "or knots: an index"),
        ([[1], [1, 2]], "or knots: an index"),
        (["terminal", 2], "or knots: an index"),
        (1j, "or knots: an index"),
    ],
)
def test_wrong_knots_are_refused_in_one_sentence(when, sentence):
    with pytest.raises(ValueError) as caught:
        knots_of(when, STEPS)
    assert sentence in str(caught.value) and "\n" not in str(caught.value)
