"""Problem: what it refuses, what it computes, and that it stays as it was made."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjslq import FunctionDynamics, Problem, Trajectory, costs
from mjslq.scene import Scene


def pendulum(x, u):
    return np.stack([x[1], u[0] - np.sin(x[0]) - 0.1 * x[1]])


dynamics = FunctionDynamics(pendulum, 2, 1, 0.1)
ok = {"dynamics": dynamics, "horizon": 5, "x0": [0.3, 0.0], "costs": [costs.Control(1.0), costs.State(2.0)]}


def make(**change):
    return Problem(**(ok | change))


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"dynamics": None}, r"dynamics must be an engine .*got NoneType"),
        ({"dynamics": pendulum}, r"dynamics must be an engine .*got function"),
        ({"dynamics": FunctionDynamics}, r"dynamics must be an engine .*got (ABCMeta|type)"),
        ({"horizon": 0}, "horizon must be a whole number of at least 1, got int 0"),
        ({"horizon": 5.0}, "horizon must be a whole number of at least 1, got float 5.0"),
        ({"horizon": None}, "horizon must be a whole number"),
        ({"x0": [0.0]}, r"x0 must have shape \(2,\), got \(1,\)"),
        ({"x0": [0.0, math.nan]}, r"x0 must be finite, but x0\[1\] is nan"),
        ({"x0": "home"}, "x0 must be an array of numbers, got str 'home'"),
        ({"U0": np.zeros((4, 1))}, r"U0 must have shape \(1,\) or \(5, 1\), got \(4, 1\)"),
        ({"U0": np.full((5, 1), math.inf)}, r"U0 must be finite, but U0\[0, 0\] is inf"),
        ({"costs": []}, "costs must name at least one term, or there is nothing to minimize"),
        ({"costs": [costs.Control(1.0), "fuel"]}, r"costs\[1\] must be a term of mjslq.costs, got str"),
        ({"costs": [costs.Control]}, r"costs\[0\] must be a term of mjslq.costs, got"),
        ({"costs": 3.0}, "costs must be"),
        (
            {"costs": [costs.Control(1.0), costs.State(-1.0)]},
            r"costs\[1\] \(State\): weight must be positive semidefin",
        ),
    ],
)
def test_wrong_arguments_are_refused_in_one_sentence(change, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        make(**change)
    assert "\n" not in str(caught.value)


def test_steps_of_given_length_fix_the_horizon():
    uneven = FunctionDynamics(pendulum, 2, 1, [0.1, 0.2, 0.1])
    assert Problem(uneven, 3, np.zeros(2), [costs.Control(1.0)]).horizon == 3
    with pytest.raises(ValueError, match="these dynamics have 3 steps of given length, but the horizon is 4"):
        Problem(uneven, 4, np.zeros(2), [costs.Control(1.0)])


def test_start_controls_are_zero_a_constant_or_one_a_step():
    np.testing.assert_array_equal(make().U0, np.zeros((5, 1)))
    np.testing.assert_array_equal(make(U0=[3.0]).U0, np.full((5, 1), 3.0))
    np.testing.assert_array_equal(make(U0=np.arange(5.0)[:, None]).U0[:, 0], np.arange(5.0))


def test_one_term_need_not_stand_in_a_list():
    problem = make(costs=costs.Control(1.0))
    assert len(problem.costs) == 1 and problem.cost(problem.rollout([2.0])) == pytest.approx(0.5 * 5 * 0.1 * 4.0)


def test_rollout_starts_at_x0_and_holds_one_control():
    problem = make()
    trajectory = problem.rollout([0.5])
    np.testing.assert_array_equal(trajectory.X, dynamics.rollout([0.3, 0.0], np.full((5, 1), 0.5)).X)
    with pytest.raises(ValueError, match=r"U0? must have shape \(5, 1\) or \(1,\), got \(6, 1\)"):
        problem.rollout(np.zeros((6, 1)))


def test_a_problem_stays_as_it_was_made():
    x0, U0 = np.array([0.3, 0.0]), np.ones((5, 1))
    problem = make(x0=x0, U0=U0)
    x0[:], U0[:] = 9.0, 9.0
    np.testing.assert_array_equal(problem.x0, [0.3, 0.0])
    np.testing.assert_array_equal(problem.U0, np.ones((5, 1)))
    with pytest.raises(ValueError, match="read-only"):
        problem.x0[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.horizon = 7


def test_cost_of_what_diverged_is_infinite():
    problem = make()
    X = np.full((6, 2), np.nan)
    X[:3] = 0.0
    assert problem.cost(Trajectory(X, np.zeros((5, 1)), dt=0.1, diverged_at=3)) == math.inf


def test_cost_that_overflows_is_infinite_in_silence():
    problem = make(costs=[costs.Function(lambda x, u, t: np.exp(x[0] * x[0]) - np.exp(x[0] * x[0]))])
    X = np.full((6, 2), 1e3)
    assert problem.cost(Trajectory(X, np.zeros((5, 1)), dt=0.1)) == math.inf
    assert make().cost(Trajectory(np.full((6, 2), 1e200), np.zeros((5, 1)), dt=0.1)) == math.inf


def test_expansion_finds_its_own_linearization():
    problem = make()
    trajectory = problem.rollout([0.5])
    for ours, given_one in zip(
        problem.expand(trajectory), problem.expand(trajectory, dynamics.linearize(trajectory)), strict=True
    ):
        np.testing.assert_array_equal(ours, given_one)


def test_scene_is_the_engines_unless_given():
    scene = Scene(b"model", (0,))
    assert make().scene() is None
    assert make(drawing=scene).scene() is scene
    assert make(dynamics=FunctionDynamics(pendulum, 2, 1, 0.1, scene=scene)).scene() is scene


def as_map(x, u, h):
    return pendulum(x, u)


def euler(x, u, h):
    return x + h * pendulum(x, u)


def semi_implicit_euler(x, u, h):
    v = x[1] + h * pendulum(x, u)[1]
    return np.stack([x[0] + h * v, v])


def rk4(x, u, h):
    k1 = pendulum(x, u)
    k2 = pendulum(x + h / 2 * k1, u)
    k3 = pendulum(x + h / 2 * k2, u)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + pendulum(x + h * k3, u))


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["map", "euler", "semi-implicit-euler", "rk4"]))
def test_gradient_is_the_complex_step_of_the_total_cost(seed, integrator):
    """The whole cost, rolled out in a plain loop, differentiated exactly."""
    rng = np.random.default_rng(seed)
    N, steps = 8, rng.uniform(0.05, 0.15, 8)
    engine = FunctionDynamics(pendulum, 2, 1, steps, integrator=integrator)
    one_step = {"map": as_map, "euler": euler, "semi-implicit-euler": semi_implicit_euler, "rk4": rk4}[integrator]
    times = np.concatenate([[0.0], np.cumsum(steps)])
    problem = Problem(
        engine, N, rng.standard_normal(2),
        [costs.Tracking(0.3, 0.7, 5.0, x_target=[1.0, 0.0]),
         costs.Residual(lambda x, u, t: x[0] * u[0] + t, 2.0),
         costs.Function(lambda x, u, t: np.cos(x[0]) * x[1] ** 2, "always")],
    )  # fmt: skip

    def total(U):
        x, J = problem.x0.astype(complex), 0.0
        for n, u in enumerate(U):
            d, h, t = x - np.array([1.0, 0.0]), steps[n], times[n]
            J += 0.15 * d @ d + 0.35 * u @ u + h * (x[0] * u[0] + t) ** 2 + h * np.cos(x[0]) * x[1] ** 2
            x = one_step(x, u, h)
        d = x - np.array([1.0, 0.0])
        return J + 2.5 * d @ d + np.cos(x[0]) * x[1] ** 2

    U = rng.standard_normal((N, 1))
    trajectory = problem.rollout(U)
    assert problem.cost(trajectory) == pytest.approx(total(U).real, rel=1e-12)
    gradient = np.empty((N, 1))
    for n in range(N):
        probe = U.astype(complex)
        probe[n, 0] += 1e-30j
        gradient[n, 0] = total(probe).imag / 1e-30
    ours = problem.gradient(trajectory)
    np.testing.assert_allclose(ours, gradient, rtol=1e-10, atol=1e-12 * np.abs(gradient).max())
    direction, e = rng.standard_normal((N, 1)), 1e-6
    slope = (problem.cost(problem.rollout(U + e * direction)) - problem.cost(problem.rollout(U - e * direction))) / (
        2 * e
    )
    assert np.vdot(ours, direction) == pytest.approx(slope, rel=1e-6, abs=1e-7)
