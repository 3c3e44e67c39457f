"""Functions that complex steps cannot differentiate: found out, differenced, with one warning."""

import contextlib
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from mjslq import FunctionDynamics, Problem, costs, solve
from mjslq.complex_step import central_differences, second_differences, wrong_slopes
from mjslq.user_function import UserFunction

TARGET = np.array([0.4, 0.0])
WRONG = {
    "abs": lambda x, u, t: 10 * abs(x[0] - 0.4),
    "numpy's abs": lambda x, u, t: 10 * np.abs(x[0] - 0.4),
    "norm": lambda x, u, t: 10 * np.linalg.norm(x - TARGET),
    "square of abs": lambda x, u, t: 10 * abs(x[0] - 0.4) ** 2,
    "square of norm": lambda x, u, t: 10 * np.linalg.norm(x - TARGET) ** 2,
    "vdot": lambda x, u, t: 10 * np.vdot(x - TARGET, x - TARGET),
    "branch": lambda x, u, t: 5 * (x[0] - 0.4) ** 2 if abs(x[0] - 0.4) < 0.1 else abs(x[0] - 0.4) - 0.05,
    "real": lambda x, u, t: 10 * (x.real[0] - 0.4) ** 2,
    "conj": lambda x, u, t: 10 * (np.conj(x[0]) - 0.4) ** 2,
    "sign": lambda x, u, t: 10 * np.sign(x[0] - 0.4) * (x[0] - 0.4),
    "angle": lambda x, u, t: 10 * np.angle(np.exp(1j * (x[0] - 0.4))) ** 2,
}
RIGHT = {
    "root": lambda x, u, t: 10 * np.sqrt((x[0] - 0.4) ** 2 + 1e-12),
    "maximum": lambda x, u, t: 10 * np.maximum(0.0, 0.4 - x[0]) ** 2,
    "where": lambda x, u, t: 10 * np.where(x[0] < 0.4, 0.4 - x[0], 0.0),
    "clip": lambda x, u, t: 10 * np.clip(0.4 - x[0], 0, 1) ** 2,
    "steep": lambda x, u, t: np.tanh(1e4 * (x[0] - 0.3)),
    "cubic": lambda x, u, t: 1e6 * x[0] ** 3 + u[0] ** 3,
    "cancelling": lambda x, u, t: 1e8 * (1.0 - np.cos(x[0])) + (1e6 + u[0]) ** 2,
}
REFUSED = {
    "arctan2": lambda x, u, t: np.arctan2(np.sin(x[0]), np.cos(x[0])),
    "remainder": lambda x, u, t: x[0] % 2.0,
    "real array": lambda x, u, t: np.add(np.zeros(1), x[:1], out=np.zeros(1))[0],
}
seeds = st.integers(0, 2**32 - 1)
dynamics = FunctionDynamics(lambda x, u: np.array([x[1], u[0] - 0.5 * x[1] - np.sin(x[0])]), 2, 1, 0.05)


def slope_by_differences(problem, U):
    e = np.zeros_like(U)
    e[3] = 1e-5
    return (problem.cost(problem.rollout(U + e)) - problem.cost(problem.rollout(U - e))) / 2e-5


@pytest.mark.parametrize("kind", [costs.Function, costs.Residual])
@pytest.mark.parametrize("name", WRONG)
def test_costs_that_are_not_analytic_are_differenced_with_one_warning(name, kind):
    """They had a gradient of zero, or of twice its size, and the solver called it converged."""
    remedy = "gradient= and hessian=" if kind is costs.Function else "jacobian="
    with pytest.warns(UserWarning, match=rf"<lambda>'\) is not analytic in x and u.*use {remedy}") as caught:
        problem = Problem(dynamics, 30, [0.1, 0.2], [costs.Control(0.01), kind(WRONG[name])])
        U = np.full((30, 1), 0.3)
        gradient = problem.gradient(problem.rollout(U))[3, 0]
        solve(problem, max_iterations=2)
    assert len(caught) == 1 and "\n" not in str(caught[0].message)
    assert gradient == pytest.approx(slope_by_differences(problem, U), rel=1e-4, abs=1e-7)


@pytest.mark.parametrize("name", RIGHT)
@settings(max_examples=20, deadline=None)
@given(seeds)
def test_analytic_functions_keep_their_complex_steps(name, seed):
    """No false alarm, at kinks, steep places and stationary points either."""
    rng = np.random.default_rng(seed)
    Z = rng.choice([0.0, 0.3, 0.4, 0.3 + 1e-7, 0.4 - 1e-7, -2.0, 1.0], (6, 3)) + rng.choice([0.0, 1.0]) * rng.normal(
        size=(6, 3)
    )
    function = UserFunction("r", RIGHT[name], 2, 1)
    function.jacobians(Z, np.zeros(6))
    assert not function.by_differences


@pytest.mark.parametrize("name", REFUSED)
def test_functions_that_take_no_complex_numbers_are_refused_by_name(name):
    problem = Problem(dynamics, 5, [0.1, 0.2], [costs.Control(0.01), costs.Function(REFUSED[name])])
    with pytest.raises(ValueError, match=r"l\(x, u, t\) cannot be differentiated by complex steps"):
        problem.gradient(problem.rollout(np.zeros((5, 1))))


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_differences_are_the_derivatives_of_a_polynomial(seed):
    rng = np.random.default_rng(seed)
    a, Z, weights = rng.normal(size=(2, 3, 3)), rng.normal(size=(4, 3)), rng.normal(size=(4, 2))

    def values(at, Z):
        return np.einsum("mij,ki,kj->km", a, Z, Z)

    symmetric = a + a.swapaxes(1, 2)
    J = np.einsum("mij,kj->kmi", symmetric, Z)
    np.testing.assert_allclose(central_differences(values, Z), J, atol=1e-8)
    np.testing.assert_allclose(
        second_differences(values, Z, weights), np.einsum("km,mij->kij", weights, symmetric), atol=1e-5
    )
    assert not wrong_slopes(values, Z, J).any()
    J[2, 1, 0] += 1e-3
    assert np.argwhere(wrong_slopes(values, Z, J)).tolist() == [[2, 1]]


def test_compiled_functions_are_found_out_when_they_are_linearized():
    function = UserFunction("r", njit(lambda x, u, t: x * np.conj(x) + u[0]), 2, 1)
    Z = np.array([[0.3, -0.2, 0.5]])
    with pytest.warns(UserWarning, match=r"r\(x, u, t\) .* at t = 7"):
        J = function.jacobians(Z, np.array([7.0]))
    np.testing.assert_allclose(J[0], [[0.6, 0.0, 1.0], [0.0, -0.4, 1.0]], atol=1e-9)
    H = function.hessians(Z, np.zeros(1), np.array([[1.0, 2.0]]))
    np.testing.assert_allclose(H[0], np.diag([2.0, 4.0, 0.0]), atol=1e-6)


# FunctionDynamics


STEPS = {
    "compiled cube": (njit(lambda x, u: -(x**3) + u), "at knot 0"),
    "compiled conj": (njit(lambda x, u: -x * np.conj(x) + u), "at knot 0"),
    "abs": (lambda x, u: -np.abs(x) + u, "near the origin"),
    "norm": (lambda x, u: u - x * np.linalg.norm(x), "near the origin"),
    "branch": (lambda x, u: u - x if abs(x[0]) < 0.1 else u - x * x.real, "near the origin"),
}


@pytest.mark.parametrize("integrator", ["map", "rk4"])
@pytest.mark.parametrize("name", STEPS)
def test_steps_that_are_not_analytic_are_differenced_with_one_warning(name, integrator):
    """From x = -1 the compiled cube had A = -1.7e22, the others a part of their slope."""
    f, where = STEPS[name]
    with pytest.warns(UserWarning, match=rf"f \('<lambda>'\) is not .* {where}.*finite-difference") as caught:
        system = FunctionDynamics(f, 1, 1, 0.1, integrator=integrator)
        trajectory = system.rollout([-0.9], np.full((4, 1), 0.2))
        A, B, _, _ = system.linearize(trajectory)
        system.linearize(trajectory)
        xx = system.hessian(trajectory, np.ones((5, 1))).xx
    assert len(caught) == 1 and system.jacobian == "finite-difference"
    same = FunctionDynamics(f, 1, 1, 0.1, integrator=integrator, jacobian="finite-difference")
    reference = same.linearize(trajectory)
    np.testing.assert_array_equal(A, reference.A)
    np.testing.assert_array_equal(B, reference.B)
    assert same.check_derivatives(trajectory).worst_error < 1e-6 and np.abs(xx).max() < 10.0


@pytest.mark.parametrize("compiled", [False, True])
def test_outputs_that_are_not_analytic_are_differenced(compiled):
    wrap = njit if compiled else lambda f: f
    with pytest.warns(UserWarning, match=r"outputs \('<lambda>'\) is not analytic"):
        system = FunctionDynamics(wrap(lambda x, u: u - x), 2, 2, 0.1, outputs=wrap(lambda x, u: x * np.conj(x)))
        trajectory = system.rollout([-0.9, 0.4], np.full((4, 2), 0.2))
        C = system.linearize(trajectory).C
    assert system.jacobian == "complex-step"  # f is as it should be
    np.testing.assert_allclose(C[0], np.diag([-1.8, 0.8]), atol=1e-9)


def test_second_derivatives_of_steps_that_powers_make():
    """Beside zero differences reach below it; at -0.5 complex steps do not serve, which `hessian` finds out itself."""
    for x0, expected in ((1e-6, 6e-6), (-0.5, -3.0)):
        system = FunctionDynamics(njit(lambda x, u: x**3 + u), 1, 1, 0.1, integrator="map")
        trajectory = system.rollout([x0], np.full((1, 1), 0.2))
        with pytest.warns(UserWarning, match="at knot 0") if x0 < 0.0 else contextlib.nullcontext():
            xx = system.hessian(trajectory, np.ones((2, 1))).xx
        assert xx[0, 0, 0] == pytest.approx(expected, abs=1e-6)


def test_a_small_step_does_not_hide_a_wrong_slope():
    with pytest.warns(UserWarning, match="is not analytic"):
        FunctionDynamics(lambda x, u: u - 1e-2 * np.abs(x), 1, 1, 1e-4)


def test_functions_without_a_value_at_generic_points_are_taken():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FunctionDynamics(lambda x, u: np.sqrt(x - 5.0) + u, 1, 1, 0.1)
        UserFunction("r", lambda x, u, t: {0.0: x}[t], 1, 1)
