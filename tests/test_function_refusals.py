"""FunctionDynamics: what is refused, and how; nothing handed in is written to."""

import math

import numpy as np
import pytest

from mjslq.dynamics.function import FunctionDynamics

ok = {"f": lambda x, u: -x, "nx": 2, "nu": 1, "dt": 0.1}


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"nx": 0}, "nx must be a whole number of at least 1, got int 0"),
        ({"nu": 1.5}, "nu must be a whole number of at least 1, got float 1.5"),
        ({"dt": 0.0}, "dt must be a positive number, or one per step"),
        ({"dt": [0.1, -0.1]}, "dt must be a positive number, or one per step"),
        ({"dt": np.nan}, "dt must be finite"),
        ({"dt": [[0.1]]}, "dt must be a positive number, or one per step"),
        ({"dt": "fast"}, "dt must be an array of numbers"),
        ({"integrator": "rk5"}, "unknown integrator 'rk5'; there are: map, euler, semi-implicit-euler, rk4; did you"),
        ({"jacobian": "auto"}, "unknown jacobian 'auto'; there are: complex-step, finite-difference"),
        ({"parameters": [1.0, np.nan]}, r"parameters must be finite, but parameters\[1\] is nan"),
        ({"nv": 3}, "nv must be at most nx = 2, got 3"),
        ({"state_names": ("a",)}, "state_names must have 2 entries, got 1"),
        ({"control_names": ("a", "b")}, "control_names must have 1 entries, got 2"),
        ({"output_names": ("a",)}, "output_names must have 0 entries, got 1"),
        ({"f": lambda x, u: x[:1]}, r"f must return shape \(2,\), got \(1,\)"),
        ({"f": lambda x, u: 0.0}, r"f must return shape \(2,\), got \(\)"),
        ({"f": lambda x, u: x[5]}, r"f fails for x of shape \(2,\) and u of shape \(1,\): index 5"),
        ({"f": lambda x, u: x @ np.eye(3)}, r"f fails for x of shape \(2,\)"),
        ({"f": lambda x: x}, r"f must take \(x, u\), \(x, u, t\) or \(x, u, t, p\), but takes 1 arguments"),
        ({"f": lambda x, u, t, p, q: x}, "but takes 5 arguments"),
        ({"f": "x' = -x"}, "f must be a function"),
        ({"outputs": lambda x, u: np.zeros((2, 2))}, r"outputs must return .*\(2, 2\)"),
        ({"outputs": lambda x, u: x[7]}, r"outputs? fails? for x of shape \(2,\)"),
        ({"outputs": lambda x: x}, r"outputs must take \(x, u\), .* but takes 1 arguments"),
    ],
)
def test_wrong_arguments_are_refused_in_one_sentence(change, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        FunctionDynamics(**(ok | change))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "x0, U, sentence",
    [
        (np.zeros(3), np.zeros((5, 1)), r"x0 must have shape \(2,\), got \(3,\)"),
        ([0.0, np.nan], np.zeros((5, 1)), r"x0 must be finite, but x0\[1\] is nan"),
        (np.zeros(2), np.zeros((5, 2)), r"U must have shape \(N, 1\), got \(5, 2\)"),
        (np.zeros(2), np.zeros(5), r"U must have shape \(N, 1\), got \(5,\)"),
        (np.zeros(2), np.full((5, 1), np.inf), r"U must be finite, but U\[0, 0\] is inf"),
    ],
)
def test_rollout_refuses_wrong_shapes(x0, U, sentence):
    with pytest.raises(ValueError, match=sentence):
        FunctionDynamics(**ok).rollout(x0, U)


def test_horizon_and_uneven_steps_must_agree():
    dynamics = FunctionDynamics(**(ok | {"dt": [0.1, 0.2, 0.3]}))
    with pytest.raises(ValueError, match="these dynamics have 3 steps of given length, but the horizon is 4"):
        dynamics.rollout(np.zeros(2), np.zeros((4, 1)))


@pytest.mark.parametrize("A, B", [(np.eye(3), np.zeros((2, 1))), (np.eye(2), np.zeros(2)), (1.0, np.zeros((2, 1)))])
def test_a_given_jacobian_of_the_wrong_shape_is_refused(A, B):
    """Not broadcast in silence, and not with numpy's words."""
    dynamics = FunctionDynamics(**ok, jacobian=lambda x, u, t: (A, B))
    with pytest.raises(ValueError, match=r"jacobian must return .*\(2, 2\) and \(2, 1\)"):
        dynamics.linearize(dynamics.rollout(np.zeros(2), np.zeros((3, 1))))


def test_a_function_that_takes_no_complex_numbers_is_told_what_to_do():
    """The default differentiates by complex steps, which math.sin refuses."""
    dynamics = FunctionDynamics(lambda x, u: [x[1], u[0] - math.sin(x[0])], 2, 1, 0.1)
    trajectory = dynamics.rollout([0.5, 0.0], np.zeros((3, 1)))
    with pytest.raises(ValueError, match="finite-difference"):
        dynamics.linearize(trajectory)


# Ownership


def test_trajectories_do_not_alias_what_they_came_from():
    dynamics = FunctionDynamics(**ok)
    x0, U = np.ones(2), np.ones((4, 1))
    trajectory = dynamics.rollout(x0, U)
    K, k = np.zeros((4, 1, 2)), np.zeros((4, 1))
    again = dynamics.rollout_feedback(trajectory, K, k)
    x0[:], U[:] = 7.0, 7.0
    for one in (trajectory, again):
        np.testing.assert_array_equal(one.X[0], [1.0, 1.0])
        np.testing.assert_array_equal(one.U, np.ones((4, 1)))
        with pytest.raises(ValueError, match="read-only"):
            one.U[0] = 3.0


def test_dynamics_do_not_alias_their_parameters():
    dt, parameters = np.full(4, 0.1), np.ones(1)
    dynamics = FunctionDynamics(lambda x, u, t, p: p[0] * u, 1, 1, dt, parameters=parameters)
    before = dynamics.rollout([0.0], np.ones((4, 1)))
    dt[:], parameters[:] = 5.0, 5.0
    np.testing.assert_array_equal(dynamics.rollout([0.0], np.ones((4, 1))).X, before.X)
    np.testing.assert_array_equal(before.dt, np.full(4, 0.1))


def test_a_trajectory_of_another_system_is_refused():
    one, two = FunctionDynamics(lambda x, u: x + u, 1, 1, 0.1), FunctionDynamics(lambda x, u: x + u[0], 2, 1, 0.1)
    other = two.rollout(np.zeros(2), np.zeros((3, 1)))
    with pytest.raises(ValueError, match="2 states and 1 controls, but these dynamics have 1 and 1"):
        one.linearize(other)
    with pytest.raises(ValueError, match="K must have shape"):
        two.rollout_feedback(other, np.zeros((3, 1, 1)), np.zeros((3, 1)))
