"""The Panda reach on both engines: one problem, one solution."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest

import mjslq
from mjslq.problems.panda_reach import OPTIMAL_COST

ENGINES = ("mujoco", "pinocchio")


@pytest.fixture(scope="module", params=ENGINES)
def problem(request):
    return mjslq.problems.get("panda_reach", engine=request.param)


def test_start_holds_the_arm_up(problem):
    trajectory = problem.rollout(problem.U0)
    np.testing.assert_allclose(trajectory.X, np.tile(problem.x0, (201, 1)), atol=1e-6)
    # at rest: torques, the distance over two seconds, and 500 times its square at the end
    square = float(((trajectory.Y[0] - [0.4, 0.3, 0.5]) ** 2).sum())
    effort = 1e-3 * 0.01 * float((problem.U0**2).sum())
    assert problem.cost(trajectory) == pytest.approx(0.5 * (effort + 2.0 * square + 1e3 * square), rel=1e-6)


def test_solution(problem):
    result = mjslq.solve(problem, "slq")
    assert result.success and result.iterations == 24, result.message
    assert result.cost == pytest.approx(OPTIMAL_COST, rel=1e-6)
    assert np.linalg.norm(result.trajectory.Y[-1] - [0.4, 0.3, 0.5]) < 2e-3
    assert "mm from the target" in problem.describe(result.trajectory)["hand"]


def test_engines_pose_the_same_problem():
    first, second = (mjslq.problems.get("panda_reach", engine=engine) for engine in ENGINES)
    np.testing.assert_allclose(first.U0, second.U0, atol=1e-8)
    U = first.U0 + np.sin(np.arange(200) / 30.0)[:, None] * 0.05
    one, other = first.rollout(U), second.rollout(U)
    assert first.dynamics.state_names == second.dynamics.state_names
    assert not first.box.bounded and not second.box.bounded
    np.testing.assert_allclose(one.X[:20], other.X[:20], atol=1e-7)
    np.testing.assert_allclose(one.Y[:20], other.Y[:20], atol=1e-8)


def test_parameters_are_on_record():
    values = {"x": 0.5, "y": 0.1, "z": 0.6, "horizon": 50, "duration": 0.6, "reach": 2e3, "effort": 2e-3}
    problem = mjslq.problems.get("panda_reach", engine="pinocchio", **values)
    assert problem.parameters == values | {"engine": "pinocchio", "limits": False}
    again = mjslq.problems.get("panda_reach", **problem.parameters)
    assert again.cost(again.rollout(again.U0)) == problem.cost(problem.rollout(problem.U0))


def test_gradient(problem):
    rng, e = np.random.default_rng(0), 1e-4
    direction = np.sin(np.arange(200) / 40.0)[:, None] * rng.normal(size=7)
    short = mjslq.problems.get("panda_reach", horizon=30, duration=0.3, engine=problem.parameters["engine"])
    U, direction = np.array(short.U0), direction[:30]
    costs = [short.cost(short.rollout(U + s * e * direction)) for s in (1.0, -1.0)]
    slope = np.vdot(short.gradient(short.rollout(U)), direction)
    np.testing.assert_allclose(slope, (costs[0] - costs[1]) / (2.0 * e), rtol=1e-4)


def test_saved_results_can_be_looked_at(problem, tmp_path):
    result = mjslq.solve(problem, max_iterations=1)
    result.save(tmp_path / "reach.npz")
    loaded = mjslq.load(tmp_path / "reach.npz")
    assert loaded.scene is not None and loaded.scene.poses(loaded.trajectory.X).shape == (201, 7)


@pytest.mark.parametrize(
    "values, said",
    [({"engine": "bullet"}, "unknown engine 'bullet'"), ({"reach": 0.0}, "reach must be positive"),
     ({"duration": -1.0}, "duration must be positive"), ({"horizon": 0}, "horizon must be a whole number")],
)  # fmt: skip
def test_refusals(values, said):
    with pytest.raises(ValueError, match=said):
        mjslq.problems.get("panda_reach", **values)


def test_the_mujoco_engine_needs_no_pinocchio():
    code = """
        import sys
        from mjslq import problems
        problem = problems.get("panda_reach", horizon=3)
        problem.dynamics.rollout(problem.x0, problem.U0)
        sys.exit("pinocchio" in sys.modules)
    """
    assert subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=False).returncode == 0
