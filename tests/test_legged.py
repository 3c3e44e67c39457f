"""Legged robots in contact: the problems of the catalogue converge from their own starts."""

import numpy as np
import pytest

import mjslq


@pytest.fixture(scope="module")
def solo12():
    problem = mjslq.problems.get("solo12_stand")
    return problem, mjslq.solve(problem, "slq")


def test_solo12_rises_and_stands(solo12):
    problem, result = solo12
    assert result.success, result.message
    start, goal, end = problem.x0[2], problem.costs[1].target[2], result.trajectory.X[-1, 2]
    assert start < 0.15 < 0.2 < goal
    assert abs(end - goal) < 0.003
    assert np.abs(result.trajectory.X[-1, 19:]).max() < 0.1  # at rest


def test_solo12_stays_on_its_feet(solo12):
    """Its base stays level and above the floor at every knot, which falling legs would not keep."""
    _, result = solo12
    X = result.trajectory.X
    assert X[:, 2].min() > 0.1
    assert np.abs(X[:, 4:7]).max() < 0.05


def test_solo12_feedback_rejects_a_push(solo12):
    problem, result = solo12
    plan, dynamics = result.trajectory, problem.dynamics
    pushed = np.array(problem.x0)
    pushed[19:22] = 0.1, 0.0, 0.1  # [m/s]
    ends = {}
    for name, K in (("open", 0.0 * result.gains), ("closed", result.gains)):
        trajectory = dynamics.rollout_feedback(plan, K, 0.0 * plan.U, x0=pushed)
        ends[name] = np.inf if trajectory.diverged else np.abs(dynamics.difference(plan.X[-1], trajectory.X[-1])).max()
    assert ends["closed"] < 0.2 * ends["open"]


@pytest.mark.parametrize("target", [(0.35, -0.2, 1.0), (0.4, 0.0, 0.9)])
def test_g1_reaches_with_both_feet_on_the_ground(target):
    problem = mjslq.problems.get("g1_reach", **dict(zip("xyz", target, strict=True)))
    result = mjslq.solve(problem, "slq")
    assert result.success, result.message
    assert np.linalg.norm(result.trajectory.Y[-1, :3] - target) < 3e-3
    assert result.trajectory.X[:, 2].min() > 0.7
