"""A closed loop in the browser: what the widgets do to planner, plant and problem. No browser is needed here."""

import time

import numpy as np
import pytest

import mjslq
from mjslq.viewer.live_view import Live


def cart_pole(target=0.0, effort=0.01):
    made = mjslq.problems.get("cart_pole", horizon=25, duration=1.0)
    weights = [20.0, 50.0, 2.0, 5.0]
    costs = [mjslq.costs.Control(effort), mjslq.costs.State(weights, [target, 0.0, 0.0, 0.0], "always")]
    return mjslq.Problem(made.dynamics, 25, [0.0, 0.1, 0.0, 0.0], costs, name="cart_pole")


def pose(target, weights):
    return cart_pole(target[0], weights["effort"])


def steps(live, number):
    for _ in range(number):
        live.advance()
    return live.state


def test_it_balances_and_recovers_from_a_push():
    live = Live(mjslq.MPC(cart_pole()))
    assert np.abs(steps(live, 60)[:2]).max() < 0.02 and live.time == pytest.approx(60 * 0.04)
    live.push("pole", [2.0, 0.0, 0.0])
    assert np.abs(steps(live, 4)[3]) > 0.1
    assert np.abs(steps(live, 80)[1]) < 0.02


def test_planner_and_plant_stop_apart():
    live = Live(mjslq.MPC(cart_pole()))
    steps(live, 5)
    live.planning = False
    steps(live, 5)
    assert live.time == pytest.approx(0.4)
    assert live._mpc.statistics.plans == 5  # the feedback of the last plan goes on
    live.planning = True
    steps(live, 1)
    assert live._mpc.statistics.plans == 6
    live.restart()
    assert live.time == 0.0 and np.array_equal(live.state, cart_pole().x0) and live._mpc.statistics.plans == 0


def test_target_and_weights_pose_the_problem_anew():
    live = Live(mjslq.MPC(cart_pole()), pose=pose, target=[0.0, 0.0, 0.0], weights={"effort": 0.01})
    steps(live, 20)
    live.aim([0.4, 0.0, 0.0])
    assert steps(live, 120)[0] == pytest.approx(0.4, abs=0.03)
    live.aim(effort=1.0)
    assert live._mpc.problem.costs[0].weight == 1.0 and live._mpc.problem.costs[1].target[0] == 0.4


def test_a_plant_that_blows_up_stops_and_says_so():
    live = Live(mjslq.MPC(cart_pole()))
    steps(live, 1)
    live._plant.x = np.full(4, 1e12)
    steps(live, 1)
    assert not live.running and live.message


def test_it_runs_by_itself_in_real_time_and_sends_what_it_shows():
    with Live(mjslq.MPC(cart_pole()), port=8231, pose=pose, target=[0.0, 0.0, 0.0], weights={"effort": 0.01}) as live:
        assert live.url.startswith("http://127.0.0.1:")
        until = time.monotonic() + 20.0
        while live.time < 0.4 and time.monotonic() < until:
            time.sleep(0.05)
        assert live.time >= 0.4
        live.running = False
        time.sleep(0.2)
        stood = live.time
        time.sleep(0.2)
        assert live.time == stood
        live.show()
        assert "plans" in live._told.content
    with pytest.raises(RuntimeError, match="start it first"):
        live.url  # noqa: B018


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: Live(cart_pole()), "mpc must be a mjslq.MPC, got Problem"),
        (lambda: Live(mjslq.MPC(cart_pole()), target=[0.0, 0.0, 0.0]), "need pose"),
        (lambda: Live(mjslq.MPC(cart_pole()), pose=pose, target=[0.0]), r"target must have shape \(3,\)"),
        (lambda: Live(mjslq.MPC(cart_pole()), push=0.0), "push must be positive"),
        (lambda: Live(mjslq.MPC(cart_pole())).aim([0.0, 0.0, 0.0]), "made without pose"),
        (
            lambda: Live(mjslq.MPC(cart_pole())).push("arm", [0.0, 0.0, 0.0]),
            "unknown body 'arm'; there are",
        ),
        (lambda: mjslq.MPC(cart_pole()).pose(1.0), "problem must be a mjslq.Problem"),
        (lambda: mjslq.MPC(cart_pole()).pose(mjslq.problems.get("cart_pole")), "the problem has 150 steps, 4 states"),
    ],
)
def test_wrong_input_is_answered_in_a_sentence(make, said):
    with pytest.raises(ValueError, match=said):
        make()
