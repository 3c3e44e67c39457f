"""Receding horizon on robots: MuJoCo as the plant, of other masses than the model, with delay and pushes."""

import dataclasses
import resource
from copy import copy

import mujoco
import numpy as np
import pytest

import mjslq
from mjslq.simulation import Kick, Push


def cart_pole():
    return mjslq.problems.get("cart_pole", horizon=50, duration=2.0, running=10.0)


def panda():
    """The arm reaches as in the catalogue, but wants to be there all the time: no end comes nearer."""
    made = mjslq.problems.get("panda_reach", horizon=50, duration=0.5, limits=True)
    costs = [
        mjslq.costs.State(np.r_[np.zeros(7), np.full(7, 0.1)], made.x0),
        mjslq.costs.Control(1e-4),
        mjslq.costs.Sensor("panda_hand_tcp", [0.4, 0.3, 0.5], 1e3, "always"),
    ]
    return mjslq.Problem(made.dynamics, 50, made.x0, costs, U0=made.U0)


def heavier(problem, body, factor):
    """The problem's model with one body of another mass."""
    model = copy(problem.dynamics.model)
    model.body(body).mass *= factor
    model.body(body).inertia *= factor
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def hand(problem, x):
    return problem.dynamics.step(x, np.zeros(problem.dynamics.nu))[1]


def test_cart_pole_swings_up_and_recovers_from_a_kick():
    """The pole of the plant is a tenth heavier than the model's, and is struck when it stands."""
    problem = cart_pole()
    plant = heavier(problem, "pole", 1.1)
    loop = mjslq.MPC(problem, iterations=3).run(plant, 6.0, disturbances=[Kick([0.0, 0.0, 0.0, 0.8], 4.0)])
    X = loop.trajectory.X
    assert np.abs(loop.trajectory.U).max() <= 5.0
    assert np.abs(X[98, 1]) < 0.1  # it stands before it is struck ...
    assert X[101, 3] - X[100, 3] > 0.5 and X[101:110, 1].max() > 0.05  # ... turns and leans after ...
    assert X[-1] == pytest.approx(np.zeros(4), abs=0.2)  # ... and stands again
    assert loop.statistics.failed == 0


def test_panda_reaches_holds_and_recovers_from_a_push():
    problem = panda()
    push = Push("panda_link5", [0.0, 60.0, 0.0], 1.0, 0.1)
    loop = mjslq.MPC(problem, replan_every=2, delay=0.01).run(None, 2.0, disturbances=[push], delay=0.01)
    distance = [np.linalg.norm(hand(problem, x) - [0.4, 0.3, 0.5]) for x in loop.trajectory.X]
    assert distance[99] < 0.002 and distance[-1] < 0.002
    assert max(distance[100:130]) > 0.01
    assert (np.abs(loop.trajectory.U) <= problem.dynamics.control_limits[:, 1]).all()
    assert (loop.statistics.plans, loop.statistics.failed) == (100, 0)


def test_solo_stands_up_and_recovers_from_a_push():
    """15 N for a tenth of a second on a robot of 2.5 kg, whose plant has a heavier base and a more slippery floor."""
    made = mjslq.problems.get("solo12_stand", horizon=50)
    problem = dataclasses.replace(made, bounds=mjslq.Bounds(u=(-2.7, 2.7)))
    plant = heavier(problem, "base_link", 1.1)
    plant.geom_friction[:, 0] *= 0.8
    push = Push("base_link", [15.0, 7.0, 0.0], 1.0, 0.1)
    loop = mjslq.MPC(problem, first_iterations=30).run(plant, 1.8, disturbances=[push])
    X = loop.trajectory.X
    assert np.abs(loop.trajectory.U).max() <= 2.7
    assert X[0, 2] < 0.14 and X[20:100, 2].min() > 0.19  # it has risen
    assert np.linalg.norm(X[101:112, 19:21], axis=1).max() > 0.2  # it is pushed
    assert X[20:, 2].min() > 0.15 and X[-1, 2] > 0.19  # it does not fall
    assert np.abs(X[-1, :2]).max() < 0.05 and np.abs(X[-1, 4:7]).max() < 0.1  # it is back, and upright
    assert loop.statistics.failed == 0


@pytest.mark.slow
def test_memory_does_not_grow_over_1500_plans():
    problem = cart_pole()
    mpc, x, sizes = mjslq.MPC(problem), np.asarray(problem.x0), []
    for k in range(1500):
        x = problem.dynamics.step(x, mpc.step(x, 0.04 * k))[0]
        if k in (499, 1499):
            sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    assert mpc.statistics.plans == 1500 and len(mpc.statistics.recent) <= 1000
    assert sizes[1] - sizes[0] < 4096  # [kB]
