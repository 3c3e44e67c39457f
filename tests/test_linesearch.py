"""Line searches on one-dimensional costs whose minima and slopes are known."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mjslq.solvers import linesearch as linesearch
from mjslq.solvers.linesearch import C1, C1_GOLDSTEIN, C2, ROUNDOFF, SEARCHES, Trial, search
from mjslq.solvers.merit import CostAndGaps

NAMES = sorted(SEARCHES)


def trial_of(phi, slope, *, derivative=None, gradient_norm=lambda alpha: abs(alpha - 1.0), at_once=1, expected=None):
    """A step along which the cost is phi(alpha); the model expects of a full one half of what its slope promises."""
    calls = []

    def step(alphas):
        calls.extend(alphas)
        return [SimpleNamespace(cost=phi(alpha), gaps=None, gradient_norm=gradient_norm(alpha)) for alpha in alphas]

    here = SimpleNamespace(cost=phi(0.0), gaps=None, gradient_norm=gradient_norm(0.0))
    slope_at = None if derivative is None else lambda there, alpha: derivative(alpha)
    expected = 0.5 * slope if expected is None else expected
    trial = Trial(CostAndGaps(), here, slope, expected, step, slope_at, at_once)
    trial.calls = calls
    return trial


def wavy(steepness, curvature, height, frequency, base):
    """A smooth cost with phi'(0) < 0, wells of its own and no bound on how far ahead the first lies."""

    def phi(a):
        return base - steepness * a + curvature * a * a + height * (1.0 - math.cos(frequency * a))

    def derivative(a):
        return -steepness + 2 * curvature * a + height * frequency * math.sin(frequency * a)

    return phi, derivative


def wall(where, stiffness):
    """A straight way down that ends at a wall: too long a step fails, half of it may be too short."""

    def phi(a):
        return -a + stiffness * max(a - where, 0.0) ** 2

    def derivative(a):
        return -1.0 + 2.0 * stiffness * max(a - where, 0.0)

    return phi, derivative


waves = st.one_of(
    st.builds(
        wavy,
        st.floats(0.1, 10.0), st.floats(-1.0, 1e4), st.floats(0.0, 2.0), st.floats(0.1, 30.0), st.floats(-5.0, 5.0),
    ),
    st.builds(wall, st.floats(0.01, 0.99), st.floats(1.0, 1e5)),
)  # fmt: skip


@given(waves)
def test_armijo_takes_the_longest_half_that_descends_enough(wave):
    phi, derivative = wave
    slope = derivative(0.0)
    assume(abs(slope) > 1e-6 * abs(phi(0.0)))
    trial = trial_of(phi, slope)
    alpha = search("armijo", trial).alpha
    assert phi(alpha) <= phi(0.0) + C1 * alpha * slope
    longer = 2.0 * alpha
    while longer <= 1.0:
        assert phi(longer) > phi(0.0) + C1 * longer * slope
        longer *= 2.0
    assert trial.evaluations == len(trial.calls) == 1 - math.log2(alpha)


@given(waves)
def test_goldstein_is_neither_too_long_nor_too_short(wave):
    phi, derivative = wave
    slope = derivative(0.0)
    assume(abs(slope) > 1e-6 * abs(phi(0.0)))
    alpha = search("goldstein", trial_of(phi, slope)).alpha
    change = phi(alpha) - phi(0.0)
    assert 0.0 < alpha <= 1.0
    assert change <= C1_GOLDSTEIN * alpha * slope
    if alpha < 1.0:
        assert change >= (1.0 - C1_GOLDSTEIN) * alpha * slope


@given(waves, st.booleans())
def test_strong_wolfe_conditions_hold(wave, with_derivative):
    phi, derivative = wave
    slope = derivative(0.0)
    assume(abs(slope) > 1e-6 * abs(phi(0.0)))
    alpha = search("wolfe", trial_of(phi, slope, derivative=derivative if with_derivative else None)).alpha
    assert 0.0 < alpha <= 1.0
    assert phi(alpha) <= phi(0.0) + C1 * alpha * slope
    assert derivative(alpha) <= (C2 + 1e-3) * abs(slope)
    if alpha < 1.0:  # at 1 there is no going further
        assert abs(derivative(alpha)) <= (C2 + 1e-3) * abs(slope)


@pytest.mark.parametrize(
    "phi, slope, minimum",
    [
        (lambda a: (a - 0.3) ** 2, -0.6, 0.3),
        (lambda a: (a - 0.01) ** 2, -0.02, 0.01),
        (lambda a: math.cosh(4 * (a - 0.6)), 4 * math.sinh(-2.4), 0.6),
        (lambda a: (a - 0.7) ** 4 + 0.1 * (a - 0.7) ** 2, -4 * 0.343 - 0.14, 0.7),
        (lambda a: -a, -1.0, 1.0),
        (lambda a: a * a - 2.5 * a, -2.5, 1.0),
    ],
)
def test_exact_finds_the_minimum(phi, slope, minimum):
    trial = trial_of(phi, slope)
    step = search("exact", trial)
    assert step.alpha == pytest.approx(minimum, rel=1e-4)
    assert step.iterate.cost == phi(step.alpha)


def test_exact_finds_the_deeper_of_two_wells():
    def phi(a):
        return -math.exp(-200 * (a - 0.1) ** 2) - 2.0 * math.exp(-200 * (a - 0.5) ** 2)

    assert search("exact", trial_of(phi, -1e-0)).alpha == pytest.approx(0.5, rel=1e-3)


@given(st.floats(0.06, 0.9), st.floats(1e-3, 1e3), st.floats(-10.0, 10.0))
def test_quadratic_fit_is_exact_on_a_parabola(minimum, curvature, base):
    slope = -2.0 * curvature * minimum
    assume(abs(slope) > 1e-3 * abs(base + curvature * minimum**2))
    trial = trial_of(lambda a: base + curvature * (a - minimum) ** 2, slope)
    assert search("quadratic-fit", trial).alpha == pytest.approx(minimum, rel=1e-6)
    assert trial.evaluations <= 7  # three points a quarter, and the vertex


@pytest.mark.parametrize("minimum", [0.92, 1.0, 1.08])
def test_quadratic_fit_takes_a_full_step_that_keeps_its_promise(minimum):
    trial = trial_of(lambda a: (a - minimum) ** 2, -2.0 * minimum)
    assert search("quadratic-fit", trial).alpha == 1.0
    assert trial.evaluations == 1


def test_quadratic_fit_asks_the_model_what_to_expect():
    """A damped direction's model expects more or less than half of the slope; the full step is held against that."""
    phi, slope = (lambda a: -a + 0.2 * a * a), -1.0
    told = trial_of(phi, slope, expected=-0.8)
    assert search("quadratic-fit", told).alpha == 1.0 and told.evaluations == 1
    untold = trial_of(phi, slope)
    assert search("quadratic-fit", untold).alpha == 1.0 and untold.evaluations > 1


def test_quadratic_fit_goes_no_further_than_1():
    assert search("quadratic-fit", trial_of(lambda a: (a - 5.0) ** 2, -10.0)).alpha == 1.0
    assert search("quadratic-fit", trial_of(lambda a: -a - a * a, -1.0)).alpha == 1.0  # no minimum at all


def test_quadratic_fit_never_ends_above_the_points_it_tried():
    trial = trial_of(lambda a: (a - 0.4) ** 2 * (1.0 + 3.0 * math.sin(20 * a) ** 2), -0.8)
    step = search("quadratic-fit", trial)
    assert step.iterate.cost == min(trial(a).cost for a in trial.calls) < trial.here.cost


@pytest.mark.parametrize("name", NAMES)
def test_no_step_will_do(name):
    """A direction that is said to descend and does not."""
    trial = trial_of(lambda a: 1.0 + a, -1.0)
    assert search(name, trial) is None
    assert trial.evaluations < 200


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("cliff", [0.9, 0.3, 1e-3])
def test_rollouts_that_diverge_are_stepped_back_from(name, cliff):
    def phi(a):
        return 2.0 - a if a < cliff else math.inf

    step = search(name, trial_of(phi, -1.0))
    assert 0.0 < step.alpha < cliff
    assert step.iterate.cost < 2.0


@pytest.mark.parametrize("name", NAMES)
def test_full_step_is_kept_where_it_is_right(name):
    assert search(name, trial_of(lambda a: 1.0 + (a - 1.0) ** 2, -2.0)).alpha == pytest.approx(1.0)


@pytest.mark.parametrize("name", NAMES)
def test_every_step_tried_is_counted_once(name):
    trial = trial_of(lambda a: (a - 0.2) ** 2, -0.4)
    search(name, trial)
    assert trial.evaluations == len(trial.calls) == len(set(trial.calls))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("at_once", [2, 4, 16])
def test_candidates_tried_side_by_side_change_neither_step_nor_count(name, at_once):
    """Looking ahead on several threads finds the step that one thread finds, and counts what one thread counts."""
    for phi, slope in ((lambda a: (a - 0.2) ** 2, -0.4), (lambda a: 1.0 + (a - 1.0) ** 2, -2.0), (lambda a: -a, -1.0)):
        first, second = (trial_of(phi, slope, at_once=k) for k in (1, at_once))
        alone, together = search(name, first), search(name, second)
        assert together.alpha == alone.alpha
        assert second.evaluations == first.evaluations


# The roundoff rule


@pytest.mark.parametrize("name", NAMES)
def test_near_an_optimum_the_gradient_decides(name):
    """The cost is 1 up to noise; only the gradient's norm tells that the full step is right."""
    trial = trial_of(lambda a: 1.0 + 1e-13 * (a > 0.0), -1e-12)
    assert search(name, trial).alpha == 1.0
    assert trial.evaluations == 1


def test_away_from_it_the_cost_decides():
    trial = trial_of(lambda a: 1.0 + 1e-13 * (a > 0.0), -1e-6)  # a step that promises more than rounding
    assert search("armijo", trial) is None


def test_roundoff_rule_halves_until_the_gradient_falls():
    trial = trial_of(lambda a: 1.0, -1e-12, gradient_norm=lambda a: 1.0 if a > 0.3 or a == 0.0 else 0.5)
    assert search("armijo", trial).alpha == 0.25


def test_roundoff_rule_lets_the_cost_rise_by_rounding_only():
    alpha = search("armijo", trial_of(lambda a: 1.0 + 1e-3 * (a > 0.6), -1e-12)).alpha
    assert alpha == 0.5


@pytest.mark.parametrize("name", NAMES)
def test_where_no_gradient_falls_the_cost_is_asked(name):
    flat = trial_of(lambda a: 1.0 + 1e-11 * (a - 1.0) ** 2, -2e-11, gradient_norm=lambda a: 1.0)
    assert search(name, flat).alpha > 0.0
    rising = trial_of(lambda a: 1.0 + 1e-11 * a, -2e-11, gradient_norm=lambda a: 1.0)
    assert search(name, rising) is None


@pytest.mark.parametrize("cost", [1.0, -1.0, 1e6])
def test_roundoff_is_relative_to_the_cost(cost):
    assert linesearch.in_roundoff(-0.5 * ROUNDOFF * abs(cost), cost)
    assert not linesearch.in_roundoff(-2.0 * ROUNDOFF * abs(cost), cost)
    assert not linesearch.in_roundoff(-1e-30, 0.0)


def test_slope_by_difference_is_the_slope():
    trial = trial_of(lambda a: math.exp(-3 * a), -3.0)
    for alpha in (1e-3, 0.2, 1.0):
        assert trial.slope_at(alpha) == pytest.approx(-3 * math.exp(-3 * alpha), rel=1e-4)


def test_names_are_those_documented():
    assert np.all([name in linesearch.__doc__ for name in NAMES])
