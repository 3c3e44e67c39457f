"""Users' functions at many knots: compiled loops against plain Python, sizes, parameters, refusals."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from mjslq import FunctionDynamics, Problem, costs
from mjslq.user_function import UserCost, UserFunction

seeds = st.integers(0, 2**32 - 1)
NX, NU = 3, 2
dynamics = FunctionDynamics(lambda x, u: -x, NX, NU, 0.1)


def row(x, u, t):
    out = np.empty(3, x.dtype)
    out[0], out[1], out[2] = x[0] * x[1] * u[0] - t, np.sin(x[2]) + u[1] * u[1], np.exp(0.3 * x[0]) * x[2]
    return out


def number(x, u, t):
    return np.cos(x[0]) * u[0] + np.square(x[1] * x[1]) + t * u[1] ** 2 + np.exp(0.3 * x[2]) * x[0]


def row_of(x, u, t, p):
    return np.sin(p[0] * x) * u[0] + p[1] * t


def number_of(x, u, t, p):
    return p[0] * x[0] * u[0] * u[0] + p[1] * np.sin(x[2])


CASES = {
    "row": (UserFunction, row, {}),
    "number": (UserCost, number, {}),
    "row, parameters": (UserFunction, row_of, {"parameters": [0.7, -1.0]}),
    "number, parameters": (UserCost, number_of, {"parameters": [0.7, -1.0]}),
    "residual of one number": (UserFunction, number, {}),
}


@pytest.mark.parametrize("kind", CASES)
@settings(max_examples=5)
@given(seeds)
def test_compiled_loops_are_the_plain_ones(kind, seed):
    made, f, given = CASES[kind]
    plain, fast = made("r", f, NX, NU, **given), made("r", njit(f), NX, NU, **given)
    assert fast.compiled and not plain.compiled and fast.size == plain.size
    rng = np.random.default_rng(seed)
    Z, times = rng.standard_normal((4, NX + NU)), rng.uniform(0.0, 9.0, 4)
    weights = rng.standard_normal((4, plain.size))
    np.testing.assert_allclose(fast.values(Z, times), plain.values(Z, times), rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(fast.jacobians(Z, times), plain.jacobians(Z, times), rtol=1e-12, atol=1e-13)
    ours, theirs = fast.hessians(Z, times, weights), plain.hessians(Z, times, weights)
    np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8)
    np.testing.assert_array_equal(ours, ours.swapaxes(1, 2))


def test_parameters_reach_derivatives_too():
    def jacobian(x, u, t, p):
        return np.diag(p[0] * np.cos(p[0] * x) * u[0]), np.stack([np.sin(p[0] * x), np.zeros(3)], axis=-1)

    Z, times, p = np.random.default_rng(0).standard_normal((4, NX + NU)), np.arange(4.0), [0.7, -1.0]
    given, steps = UserFunction("r", row_of, NX, NU, jacobian, p), UserFunction("r", row_of, NX, NU, parameters=p)
    np.testing.assert_allclose(given.jacobians(Z, times), steps.jacobians(Z, times), rtol=1e-12, atol=1e-13)
    term = costs.Residual(njit(row_of), parameters=p)
    reference = costs.Residual(lambda x, u, t: row_of(x, u, t, p))
    trajectory = dynamics.rollout(np.ones(NX), np.ones((5, NU)))
    ours, theirs = (Problem(dynamics, 5, np.ones(NX), [t]).cost(trajectory) for t in (term, reference))
    assert ours == pytest.approx(theirs, rel=1e-13)


def test_a_changed_parameter_array_does_not_change_the_term():
    p = np.array([2.0, 0.0])
    function = UserCost("l", number_of, NX, NU, parameters=p)
    p[:] = 9.0
    assert function.values(np.ones((1, 5)), np.zeros(1))[0, 0] == 2.0


@pytest.mark.parametrize("f", [lambda x, u, t: (x[0], u[0]), lambda x, u, t: [x[0], u[0]]])
def test_compiled_functions_that_return_tuples_are_called_one_by_one(f):
    function = UserFunction("r", njit(f) if isinstance(f(np.ones(3), np.ones(2), 0.0), tuple) else f, NX, NU)
    assert not function.compiled
    np.testing.assert_allclose(function.jacobians(np.ones((1, 5)), np.zeros(1))[0], np.eye(5)[[0, 3]], atol=1e-15)


def test_compiled_for_real_numbers_only():
    """An explicit signature leaves no complex steps; values work, derivatives say what to do."""
    function = UserFunction("r", njit("float64[::1](float64[::1], float64[::1], float64)")(row_real), NX, NU)
    Z, times = np.ones((2, 5)), np.zeros(2)
    np.testing.assert_array_equal(function.values(Z, times), np.ones((2, 3)))
    with pytest.raises(ValueError, match=r"r\(x, u, t\) cannot be differentiated by complex steps.* use jacobian="):
        function.jacobians(Z, times)


def row_real(x, u, t):
    return x * u[0]


@pytest.mark.parametrize("f", [lambda x, u, t: np.abs(x), lambda x, u, t: np.array([max(x[0], u[0])])])
def test_compiled_functions_that_are_not_analytic_are_refused(f):
    """They would lose the derivative in silence."""
    function = UserFunction("r", njit(f), NX, NU)
    assert function.values(np.ones((2, 5)), np.zeros(2)).shape[0] == 2
    with pytest.raises(ValueError, match=r"r\(x, u, t\) cannot be differentiated by complex steps: .*jacobian=$"):
        function.jacobians(np.ones((2, 5)), np.zeros(2))


@pytest.mark.parametrize("f", [lambda x, u, t: x[:2] ** 3, lambda x, u, t: x[0] ** -1 + u[0]])
def test_powers_that_numba_takes_through_logarithms_are_differenced(f):
    """Of negative numbers they have an imaginary part of 1e-16, which a complex step takes for a slope of 1e24."""
    function, Z = UserFunction("r", njit(f), NX, NU), np.random.default_rng(0).standard_normal((4, NX + NU))
    plain = UserFunction("r", f, NX, NU).jacobians(Z, np.zeros(4))  # numpy multiplies
    positive = function.jacobians(np.abs(Z), np.zeros(4))
    np.testing.assert_allclose(positive, UserFunction("r", f, NX, NU).jacobians(np.abs(Z), np.zeros(4)), rtol=1e-12)
    assert np.abs(plain).max() < 1e4
    with pytest.warns(UserWarning, match=r"r\(x, u, t\) \('<lambda>'\) is not .* at t = 0.*use jacobian=") as caught:
        found = function.jacobians(Z, np.zeros(4))
    assert len(caught) == 1 and "\n" not in str(caught[0].message)
    np.testing.assert_allclose(found, plain, rtol=1e-6, atol=1e-8)
    np.testing.assert_array_equal(function.jacobians(Z, np.zeros(4)), found)  # no second warning


@pytest.mark.parametrize("power", [3, 4, 5])
def test_second_derivatives_of_powers_beside_zero(power):
    """Differences there reach below zero: numba's x**3 gave 1e12 instead of 6e-6."""
    function, Z = UserCost("l", njit(lambda x, u, t: x[0] ** power + u[0] * u[0]), NX, NU), np.zeros((1, NX + NU))
    Z[0, :4] = 1e-6, 0.3, -0.2, 0.5
    H = function.hessians(Z, np.zeros(1), np.ones((1, 1)))
    exact = power * (power - 1) * 1e-6 ** (power - 2)
    np.testing.assert_allclose(H[0], np.diag([exact, 0.0, 0.0, 2.0, 0.0]), atol=1e-6)


def test_roots_of_negative_numbers_are_refused():
    with pytest.raises(ValueError, match=r"entry 1 of r\(x, u, t\) cannot be differentiated .* at t = 3"):
        UserFunction("r", lambda x, u, t: np.stack([x[0], np.sqrt(x[1])]), NX, NU).jacobians(
            -np.ones((1, 5)), 3 * np.ones(1)
        )


def test_functions_that_divide_by_zero_at_the_origin():
    """Plain numbers raise there, numpy's do not; compiled functions raise."""
    for f in (njit(lambda x, u, t: 1.0 / x[0]), lambda x, u, t: 1.0 / float(x[0]), lambda x, u, t: math.log(x[0])):
        assert UserCost("l", f, NX, NU).values(np.ones((1, 5)), np.zeros(1)).shape == (1, 1)


def jumps(x, u, t):
    return x[: 2 if t > 0.05 else 3] * 1.0


@pytest.mark.parametrize("f", [jumps, njit(jumps)], ids=["plain", "compiled"])
def test_sizes_that_change_are_refused(f):
    problem = Problem(dynamics, 3, np.zeros(NX), [costs.Residual(f)])
    with pytest.raises(ValueError, match="must return as many numbers at every knot as at the origin"):
        problem.cost(dynamics.rollout(np.zeros(NX), np.zeros((3, NU))))


@pytest.mark.parametrize(
    "term, sentence",
    [
        (costs.Residual(3.0), r"r\(x, u, t\) must be a function, got float"),
        (costs.Function("x", parameters=[1.0]), r"l\(x, u, t, p\) must be a function, got str"),
        (costs.Residual(njit(lambda x, u, t: x[9])), r"r\(x, u, t\) fails for x of shape \(3,\): index 9 is out"),
        (costs.Residual(row, parameters=[1.0]), r"r\(x, u, t, p\) fails for x of shape \(3,\): .*positional argument"),
        (costs.Residual(row_of, parameters=[np.nan]), r"parameters must be finite, but parameters\[0\] is nan"),
        (costs.Residual(row_of, parameters=1.0), r"parameters must have shape \(size,\), got \(\)"),
        (costs.Residual(njit(lambda x, u, t: eval("x"))), r"r\(x, u, t\) cannot be compiled by numba: \S.*"),
    ],
)
def test_wrong_functions_are_refused_in_one_sentence(term, sentence):
    with pytest.raises(ValueError, match=r"^costs\[0\] \(\w+\): " + sentence) as caught:
        Problem(dynamics, 3, np.zeros(NX), [term])
    assert "\n" not in str(caught.value)
