"""Receding horizon: what `MPC` does with plans, time, failures and delays, and that loops closed by it are stable."""

import math

import numpy as np
import pytest

import mjslq
from mjslq.mpc import moved
from mjslq.simulation import Kick, Push
from mjslq.status import Status

H = 0.05


def double_integrator(horizon=30, **options):
    """A unit mass [kg] pushed by a force within 2 N to x = 1 m."""
    dynamics = mjslq.FunctionDynamics(
        lambda x, u: np.array([x[1], u[0]]), 2, 1, H, integrator="rk4", control_limits=(-2.0, 2.0)
    )
    costs = [mjslq.costs.Control(0.01), mjslq.costs.State([10.0, 1.0], [1.0, 0.0], "always", terminal_weight=100.0)]
    return mjslq.Problem(dynamics, horizon, [0.0, 0.0], costs, **options)


def cart_pole(horizon=50):
    return mjslq.problems.get("cart_pole", horizon=horizon, duration=2.0, running=10.0)


def test_it_is_the_optimal_feedback_where_the_problem_is_linear_and_quadratic():
    """Far from limits, the first control of each plan is the optimal one: that of a solve to the end."""
    problem = double_integrator(bounds=mjslq.Bounds(u=None))
    mpc = mjslq.MPC(problem)
    x = np.array([0.9, 0.1])
    for k in range(5):
        u = mpc.step(x, k * H)
        assert u == pytest.approx(mjslq.solve(problem.at(x)).trajectory.U[0], rel=1e-9)
        x = problem.dynamics.step(x, u)[0]


def test_plan_policy_and_time_belong_together():
    mpc = mjslq.MPC(double_integrator(), first_iterations=20, replan_every=3)
    for attribute in ("plan", "policy"):
        with pytest.raises(ValueError, match="call step first"):
            getattr(mpc, attribute)
    x = np.zeros(2)
    times = []
    for k in range(7):
        u = mpc.step(x, 10.0 + k * H)
        times.append(mpc.plan_time)
        assert u == pytest.approx(mpc.policy(x, 10.0 + k * H - mpc.plan_time), abs=1e-12)
        x = mpc.problem.dynamics.step(x, u)[0]
    assert times == pytest.approx(10.0 + H * np.array([0, 0, 0, 3, 3, 3, 6]))
    assert mpc.statistics.plans == 3 and mpc.plan.trajectory.X[0] == pytest.approx(mpc.policy.X[0])
    assert abs(mpc.step(x, 10.0 + 7 * H)) <= 2.0


def test_costs_that_depend_on_time_get_the_time_of_the_plan():
    """The mass follows a target that moves as sin t, known to the cost as a function of time."""
    dynamics = double_integrator().dynamics
    follow = mjslq.costs.Residual(lambda x, u, t: np.array([x[0] - np.sin(t)]), 100.0, "running")
    problem = mjslq.Problem(dynamics, 30, [0.0, 1.0], [mjslq.costs.Control(1e-4), follow])
    loop = mjslq.MPC(problem, iterations=2).run(duration=6.0)
    error = loop.trajectory.X[:, 0] - np.sin(loop.trajectory.times)
    assert np.abs(error[20:]).max() < 0.02


def test_constraints_hold_along_the_loop():
    """The speed keeps to its limit on the way, and the mass arrives."""
    problem = double_integrator(horizon=12, bounds=mjslq.Bounds(x=([-np.inf, -0.5], [np.inf, 0.5])))
    loop = mjslq.MPC(problem, iterations=20).run(duration=3.0)
    assert loop.trajectory.X[:, 1].max() < 0.5 + 1e-3
    assert loop.trajectory.X[:, 1].max() > 0.45
    assert loop.trajectory.X[-1] == pytest.approx([1.0, 0.0], abs=5e-2)


def test_one_iteration_a_plan_does_with_constraints_too():
    """The multipliers of the last plan serve the next: the loop is that of plans which are solved to the end."""
    problem = double_integrator(bounds=mjslq.Bounds(x=([-np.inf, -0.5], [np.inf, 0.5])))
    once, whole = (mjslq.MPC(problem, iterations=k).run(duration=3.0).trajectory for k in (1, 30))
    assert once.X[:, 1].max() == pytest.approx(0.5, abs=1e-6)
    assert pytest.approx(whole.X, abs=1e-3) == once.X


@pytest.mark.parametrize("iterations", [1, 3])
def test_a_disc_is_passed_by_short_plans(iterations):
    """A mass in the plane on its way to (2, 0), a disc almost in the middle of it."""
    dynamics = mjslq.FunctionDynamics(
        lambda x, u: np.array([x[2], x[3], u[0], u[1]]), 4, 2, H, integrator="rk4", control_limits=(-2.0, 2.0)
    )
    disc = mjslq.constraints.Path(
        lambda x, u, t: 0.3**2 - (x[0] - 1.0) ** 2 - (x[1] + 0.1) ** 2, when="always", name="disc"
    )
    goal = np.array([2.0, 0.0, 0.0, 0.0])
    costs = [
        mjslq.costs.Control(0.1),
        mjslq.costs.State([3.0, 3.0, 0.3, 0.3], goal, "always", terminal_weight=[30.0, 30.0, 10.0, 10.0]),
    ]
    problem = mjslq.Problem(dynamics, 40, np.zeros(4), costs, constraints=[disc])
    mpc = mjslq.MPC(problem, iterations=iterations, first_iterations=60)
    passed = mpc.run(duration=4.0).trajectory
    along = mjslq.Problem(dynamics, passed.horizon, np.zeros(4), costs, constraints=[disc])
    assert passed.X[-1] == pytest.approx(goal, abs=2e-2)
    assert along.violation(passed) < 1e-3


def test_a_state_beyond_a_limit_is_led_back():
    """A kick takes the mass beyond its speed limit: the plans after it are feasible, and lead back at once."""
    problem = double_integrator(bounds=mjslq.Bounds(x=([-np.inf, -0.5], [np.inf, 0.5])))
    mpc = mjslq.MPC(problem, iterations=20)
    x = np.zeros(2)
    for k in range(20):
        if k == 10:
            x = x + np.array([0.0, 0.08])
        x = problem.dynamics.step(x, mpc.step(x, k * H))[0]
        if k == 10:
            assert mpc.plan.status is Status.CONVERGED
            assert x[1] == pytest.approx(0.5, abs=1e-6)
    assert x[1] <= 0.5 + 1e-6 and mpc.statistics.endings["infeasible"] == 0


def test_moving_a_plan_by_steps_and_by_parts_of_steps():
    plan = mjslq.solve(double_integrator())
    by_two, by_half = moved(plan, 2 * H), moved(plan, 0.5 * H)
    X, U, K = plan.trajectory.X, plan.trajectory.U, plan.gains
    assert np.array_equal(by_two.trajectory.X[:-2], X[2:]) and np.array_equal(by_two.trajectory.X[-2:], X[[-1, -1]])
    assert np.array_equal(by_two.trajectory.U, plan.policy.shifted(2).U)
    assert np.array_equal(by_two.gains, plan.policy.shifted(2).K)
    assert by_half.trajectory.X[:-1] == pytest.approx(0.5 * (X[:-1] + X[1:]))
    assert by_half.trajectory.U[:-1] == pytest.approx(0.5 * (U[:-1] + U[1:]))
    assert by_half.gains[:-1] == pytest.approx(0.5 * (K[:-1] + K[1:]))
    beyond = moved(plan, 100.0)
    assert (X[-1] == beyond.trajectory.X).all() and (U[-1] == beyond.trajectory.U).all()


def test_moved_multipliers_stay_with_their_knots():
    problem = double_integrator(bounds=mjslq.Bounds(x=([-np.inf, -0.5], [np.inf, 0.5])))
    plan = mjslq.solve(problem)
    later = moved(plan, 3 * H)
    assert plan.multipliers["bounds"].any()
    for name, rows in plan.multipliers.items():
        assert np.array_equal(later.multipliers[name][:-3], rows[3:]), name


def test_a_plan_that_fails_leaves_the_last_one_in_force():
    """From beyond |x| = 5 the cost is not finite: no plan can be made there."""
    dynamics = double_integrator().dynamics
    wall = mjslq.costs.Function(lambda x, u, t: (x[0] - 1.0) ** 2 + 0.1 * x[1] ** 2 + 1e-3 * u[0] ** 2 + (
        0.0 if abs(x[0]) < 5.0 else np.inf), "running")  # fmt: skip
    mpc = mjslq.MPC(mjslq.Problem(dynamics, 10, [0.0, 0.0], [mjslq.costs.Control(1e-2), wall]))
    mpc.step([0.0, 0.0], 0.0)
    before, began = mpc.plan, mpc.plan_time
    u = mpc.step([6.0, 0.0], H)
    assert mpc.plan is before and mpc.plan_time == began
    assert u == pytest.approx(before.policy([6.0, 0.0], H))
    assert (mpc.statistics.plans, mpc.statistics.failed) == (2, 1)
    assert "not finite" in mpc.statistics.last_failure
    mpc.step([0.1, 0.0], 2 * H)
    assert mpc.plan is not before
    mpc.reset()
    with pytest.raises(ValueError, match="the first plan failed"):
        mpc.step([6.0, 0.0], 0.0)


@pytest.mark.parametrize("iterations", [1, 3])
def test_lean_solves_end_with_their_last_step(iterations):
    problem = cart_pole()
    lean = mjslq.solve(problem, max_iterations=iterations, lean=True)
    whole = mjslq.solve(problem, max_iterations=iterations)
    before = mjslq.solve(problem, max_iterations=iterations - 1)
    assert np.array_equal(lean.trajectory.X, whole.trajectory.X) and lean.cost == whole.cost
    assert np.array_equal(lean.gains, before.gains) and not np.array_equal(lean.gains, whole.gains)
    assert (lean.iterations, lean.status, lean.gradient_norm) == (iterations, mjslq.Status.MAX_ITERATIONS, np.inf)
    assert mjslq.solve(problem, lean=True).success


def test_plans_linearize_once_unless_their_gains_are_needed(monkeypatch):
    """With a plan for each state one linearization an iteration; with feedback between plans one more."""
    calls = []
    linearize = mjslq.MujocoDynamics.linearize
    monkeypatch.setattr(mjslq.MujocoDynamics, "linearize", lambda *args: (calls.append(1), linearize(*args))[1])
    for options, number in (({}, 1), ({"replan_every": 2}, 2), ({"iterations": 2}, 2), ({"lean": False}, 2)):
        calls.clear()
        mjslq.MPC(cart_pole(), **options).step([0.0, 3.0, 0.0, 0.0], 0.0)
        assert len(calls) == number, options


def test_statistics_count_plans_and_missed_deadlines():
    slow = mjslq.MPC(double_integrator(), deadline=1e-9)
    slow.step([0.0, 0.0], 0.0)
    slow.step([0.0, 0.0], H)
    assert slow.statistics.missed == 2 and slow.statistics.endings["out_of_time"] >= 1
    easy = mjslq.MPC(double_integrator(), deadline=60.0)
    easy.step([0.0, 0.0], 0.0)
    statistics = easy.statistics
    assert (statistics.plans, statistics.missed, statistics.failed) == (1, 0, 0)
    assert statistics.worst == statistics.seconds == statistics.recent[0] == statistics.quantile(0.5) > 0.0
    assert "1 plans" in str(statistics) and "0 missed the deadline of 60000.00 ms" in str(statistics)


@pytest.mark.parametrize(
    "call, said",
    [
        (lambda mpc: mpc.step([math.nan, 0.0], 0.0), r"x must be finite, but x\[0\] is nan"),
        (lambda mpc: mpc.step([0.0], 0.0), r"x must have shape \(2,\)"),
        (lambda mpc: mpc.step([0.0, 0.0], math.inf), "t must be finite"),
        (lambda mpc: (mpc.step([0.0, 0.0], 1.0), mpc.step([0.0, 0.0], 0.5)), "t must not go back, got 0.5 s after 1 s"),
        (lambda mpc: mjslq.MPC(mpc.problem, iterations=0), "iterations must be a whole number of at least 1"),
        (lambda mpc: mjslq.MPC(mpc.problem, replan_every=0.5), "replan_every must be a whole number"),
        (lambda mpc: mjslq.MPC(mpc.problem, delay=-1.0), "delay must be at least 0"),
        (lambda mpc: mjslq.MPC(mpc.problem, period=0.0), "period must be positive"),
        (lambda mpc: mjslq.MPC(mpc.problem, curvatur="never"), "did you mean 'curvature'"),
        (lambda mpc: mjslq.MPC(mpc.problem, "ddp"), "unknown method 'ddp'"),
        (lambda mpc: mjslq.MPC(1.0), "problem must be a mjslq.Problem, got float"),
        (lambda mpc: mpc.run(3.0), "plant must be a mujoco.MjModel or an engine, got float"),
        (lambda mpc: mpc.run(cart_pole().dynamics), "the plant has 4 states and 1 controls, but the problem has 2"),
        (lambda mpc: mpc.run(duration=0.12), "the duration, 0.12 s, must be a whole number of steps of 0.05 s"),
        (lambda mpc: mpc.run(delay=0.01), "the delay, 0.01 s, must be a whole number"),
        (lambda mpc: mpc.run(disturbances=[Push("cart", [1.0, 0.0, 0.0], 0.0)]), "only MuJoCo plants have"),
        (lambda mpc: mpc.run(disturbances=[1.0]), "must be a Push or a Kick, got float"),
        (lambda mpc: mpc.run(disturbances=[Kick([1.0], 0.0)]), r"disturbances\[0\].dx must have shape \(2,\)"),
    ],
)
def test_wrong_input_is_answered_in_a_sentence(call, said):
    with pytest.raises(ValueError, match=said):
        call(mjslq.MPC(double_integrator()))


def test_steps_of_unequal_length_are_refused():
    dynamics = mjslq.FunctionDynamics(lambda x, u: u, 1, 1, np.array([0.1, 0.2]), integrator="euler")
    problem = mjslq.Problem(dynamics, 2, [0.0], mjslq.costs.Control(1.0))
    with pytest.raises(ValueError, match=r"steps of equal length, got 0\.1 to 0\.2 s"):
        mjslq.MPC(problem)


def test_the_predicted_state_is_the_one_that_comes():
    """With the model as plant, a delay that is compensated is met by the very states that were planned from."""
    problem = double_integrator()
    mpc, dynamics = mjslq.MPC(problem, delay=3 * H), problem.dynamics
    x, issued, starts = np.zeros(2), [np.asarray(problem.U0)[0]] * 3, []
    states = [x]
    for k in range(20):
        issued.append(mpc.step(x, k * H))
        starts.append(mpc.plan.trajectory.X[0])
        x = dynamics.step(x, issued[k])[0]  # the control that was issued three periods before
        states.append(x)
    assert np.allclose(starts[:17], states[3:20], atol=1e-12)


@pytest.mark.parametrize("steps", [0.5, 1.0, 2.5])
def test_a_delay_may_be_a_part_of_a_step(steps):
    mpc = mjslq.MPC(double_integrator(), delay=steps * H)
    mpc.step([0.0, 1.0], 0.0)
    assert mpc.plan.trajectory.X[0] == pytest.approx([steps * H, 1.0])  # no force was issued before
    assert mpc.plan_time == pytest.approx(steps * H)


def test_compensating_a_delay_pays():
    """A delay of three periods: the loop that predicts settles, the one that does not swings more."""
    swing = {}
    for compensated in (True, False):
        mpc = mjslq.MPC(double_integrator(), iterations=3, delay=3 * H if compensated else 0.0)
        loop = mpc.run(duration=4.0, delay=3 * H)
        swing[compensated] = np.abs(loop.trajectory.X[50:, 0] - 1.0).max()
    assert swing[True] < 0.02 < swing[False]
