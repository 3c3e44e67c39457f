"""The problems that come with mjslq: found by name, checked, and the same on both engines."""

import inspect

import numpy as np
import pytest

from mjslq import Problem, problems, solve
from mjslq.problems.drag_particle import BETAS, OPTIMAL_COSTS, PAPER_ITERATIONS
from mjslq.problems.hopper import phases


def test_names_have_a_summary_and_parameters():
    assert {"drag_particle", "hopper"} <= set(problems.names())
    for name in problems.names():
        assert problems.summary(name)
        assert "horizon" in problems.parameters(name)


@pytest.mark.parametrize("name", problems.names())
def test_every_problem_is_made_and_described_with_its_defaults(name):
    problem = problems.get(name)
    assert isinstance(problem, Problem) and problem.name == name
    assert problem.scene() is not None  # there is something to look at
    assert not problem.rollout(problem.U0).diverged
    for key, value in problem.parameters.items():
        assert problems.parameters(name)[key] == value


@pytest.mark.parametrize(
    "name, values",
    [("hopper", {"height": 7.0, "horizon": 50, "duration": 0.8, "r": 2.0, "q": 500.0, "q_final": 10.0, "alpha": 0.2}),
     ("drag_particle", {"beta": 0.3, "target": 5.0, "horizon": 40, "mass": 0.1, "q_final": 1e3, "q": 2.0, "r": 1.0})],
)  # fmt: skip
def test_parameters_are_on_record(name, values):
    """What a problem was made with can be read off it, and makes it again."""
    problem = problems.get(name, **values)
    assert values.items() <= dict(problem.parameters).items()
    again = problems.get(name, **problem.parameters)
    U = np.full((problem.horizon, 1), 3.0)
    np.testing.assert_array_equal(again.rollout(U).X, problem.rollout(U).X)
    assert again.cost(again.rollout(U)) == problem.cost(problem.rollout(U))


@pytest.mark.parametrize(
    "call, sentence",
    [
        (lambda: problems.get("hoper"), r"unknown problem 'hoper'; there are: .*hopper.*; did you mean 'hopper'\?"),
        (lambda: problems.summary("x"), "unknown problem 'x'; there are: .*drag_particle"),
        (lambda: problems.parameters("x"), "unknown problem 'x'; there are: .*drag_particle"),
        (
            lambda: problems.get("hopper", hight=3.0),
            r"unknown parameter of hopper 'hight'; there are: height, horizon, .*engine.*; did you mean 'height'\?",
        ),
        (lambda: problems.get("hopper", height="tall"), "hopper: height must be a number such as 20.0, got 'tall'"),
        (lambda: problems.get("hopper", engine=3), "hopper: engine must be a text such as 'mujoco', got 3"),
        (lambda: problems.get("hopper", engine="bullet"), "unknown engine 'bullet'; there are: mujoco, function"),
        (lambda: problems.get("hopper", horizon=0), "horizon must be a whole number of at least 1, got int 0"),
        (lambda: problems.get("hopper", horizon=10.5), "horizon must be a whole number of at least 1, got float 10.5"),
        (lambda: problems.get("hopper", duration=-1.0), "duration must be positive and finite, got -1.0"),
        (lambda: problems.get("hopper", alpha=0.0), "alpha must be positive and finite, got 0.0"),
        (lambda: problems.get("hopper", stiffness=np.nan), "stiffness must be .*finite, got nan"),
        (lambda: problems.get("hopper", height=np.inf), "height must be .*finite"),
        (lambda: problems.get("hopper", height=None), "height must be a number"),
        (lambda: problems.get("hopper", integrator="rk4"), "unknown integrator 'rk4'; there are: semi-implicit"),
        (lambda: problems.get("hopper", integrator="euler"), "integrator must be 'semi-implicit-euler' with"),
        (lambda: problems.get("drag_particle", beta=-0.1), "beta must be a number of at least 0, got -0.1"),
        (lambda: problems.get("drag_particle", beta=np.nan), "beta must be a number.*, got nan"),
        (lambda: problems.get("drag_particle", mass=0.0), "mass must be positive and finite, got 0.0"),
        (lambda: problems.get("drag_particle", mass=-1.0, engine="mujoco"), "mass must be positive and finite"),
        (lambda: problems.get("drag_particle", r=0.0), "r must be positive and finite, got 0.0"),
        (lambda: problems.get("drag_particle", target=np.nan), "target must be .*finite"),
    ],
)
def test_wrong_values_are_refused_in_one_sentence(call, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_makers_have_a_default_for_everything():
    for name in problems.names():
        assert inspect.Parameter.empty not in problems.parameters(name).values()


# The drag particle


@pytest.mark.parametrize("beta", BETAS)
def test_drag_particle_is_equations_63_to_65(beta):
    problem = problems.get("drag_particle", beta=beta, horizon=50)
    U = 0.1 * np.cos(np.linspace(0, 6, 50))[:, None]
    T, x, v, J = 1.0 / 50, 0.0, 0.0, 0.0
    for n in range(50):
        J += T * (x * x + v * v + 10.0 * U[n, 0] ** 2)
        x, v = x + T * v, v + T * (U[n, 0] - beta * np.sign(v) * v * v) / 0.0259
    assert abs(v) > 1e-3
    trajectory = problem.rollout(U)
    np.testing.assert_allclose(trajectory.X[-1], [x, v], rtol=1e-9)
    assert problem.cost(trajectory) == pytest.approx(J + 1e6 * (x - 10.0) ** 2, rel=1e-9)


def test_table_1_is_complete():
    assert set(BETAS) == set(OPTIMAL_COSTS) == set(PAPER_ITERATIONS)


def test_drag_particle_on_mujoco_costs_nearly_the_same():
    result = solve(problems.get("drag_particle", engine="mujoco"))
    assert result.success, result.message
    assert result.cost == pytest.approx(OPTIMAL_COSTS[0.1], rel=0.01)


# The hopper


def spring(e, k=500.0, alpha=0.1):
    return 0.0 if e < 0 else k / (2 * alpha) * e * e if e < alpha else k * e - k * alpha / 2


@pytest.mark.parametrize("integrator", ["semi-implicit-euler", "euler"])
def test_hopper_is_equation_66(integrator):
    problem = problems.get("hopper", height=30.0, engine="function", integrator=integrator)
    U = 20.0 * np.sin(0.12 * np.arange(100))[:, None]
    h, y, p, v, J = 0.01, 0.0, 0.0, 0.0, 0.0
    for (u,) in U:
        J += 0.5 * h * (1000.0 * p * p + u * u)
        faster = v + h * (spring(p - y) - 386.4)
        y += h * (faster if integrator == "semi-implicit-euler" else v)
        p, v = p + h * u, faster
    trajectory = problem.rollout(U)
    np.testing.assert_allclose(trajectory.X[-1], [y, p, v], rtol=1e-9)
    assert problem.cost(trajectory) == pytest.approx(J + 500.0 * (y - 30.0) ** 2 + v * v, rel=1e-10)


def test_hopper_is_the_same_on_both_engines():
    U = 20.0 * np.sin(0.12 * np.arange(100))[:, None]
    function, mujoco = (problems.get("hopper", engine=engine) for engine in ("function", "mujoco"))
    ours, theirs = function.rollout(U), mujoco.rollout(U)
    np.testing.assert_allclose(theirs.X[:, :3], ours.X, rtol=1e-8, atol=1e-9)
    assert mujoco.cost(theirs) == pytest.approx(function.cost(ours), rel=1e-9)
    np.testing.assert_allclose(mujoco.gradient(theirs), function.gradient(ours), rtol=1e-5, atol=1e-4)


def test_phases_are_told_by_height_and_piston():
    X = np.array([[0.0, 0.0], [-1.0, 0.0], [-1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]])
    assert phases(X) == ["stance", "flight", "stance"]
    assert phases(np.array([[0.0, 0.0], [1.0, 0.0]])) == ["flight"]
