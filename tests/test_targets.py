"""Targets and limits that are functions of time: held against arrays by knot, on horizons that begin later, in MPC."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mjslq
from mjslq import constraints, costs
from mjslq.reports.errors import task_errors
from mjslq.targets import Signal

N, H = 12, 0.1
MASS = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0]]), 2, 1, H, integrator="rk4")
BALL = """
<mujoco><option timestep="0.1" gravity="0 0 0"/>
  <worldbody><body name="ball"><joint name="turn" type="ball"/>
    <geom type="box" size=".1 .2 .3" mass="1"/><site name="tip" pos=".3 0 0"/></body></worldbody>
  <actuator><motor joint="turn" gear="1 0 0"/></actuator>
  <sensor><framepos name="tip" objtype="site" objname="tip"/>
    <framequat name="way" objtype="site" objname="tip"/></sensor>
</mujoco>
"""
TIMES = np.arange(N + 1) * H
WINDOWS = ["running", "always", "terminal", "initial", slice(2, 9, 3), [1, 4, -1], [0.2, 0.7], 3, 0.5]


def sine(t):
    return np.array([np.sin(t), np.cos(t)])


def force(t):
    return 0.3 * t


def attitude(t):
    return [2.0 * np.cos(t), 2.0 * np.sin(t), 0.0, 0.0]  # of any length


class Sines(Signal):
    def over(self, times):
        return np.stack([np.sin(times), np.cos(times)], axis=1)


def trajectory(dynamics, seed):
    rng = np.random.default_rng(seed)
    x0 = dynamics.integrate(dynamics.checked_start(getattr(dynamics, "initial_state", np.zeros(dynamics.nx))),
                            rng.standard_normal(dynamics.ndx))  # fmt: skip
    return dynamics.rollout(x0, rng.standard_normal((N, dynamics.nu)))


def rows(function, t0, steps=N + 1):
    return np.stack([np.atleast_1d(function(t)) for t in TIMES[:steps] + t0])


def same(dynamics, by_time, by_knot, t0, x0, **options):
    """The problem with functions of time, begun at t0, is the one with arrays by knot: cost, slopes and Hessian."""
    moved = mjslq.Problem(dynamics, N, x0, by_time, **options).at(x0, t0)
    twin = mjslq.Problem(dynamics, N, x0, by_knot)
    along = trajectory(dynamics, 1)
    assert moved.cost(along) == pytest.approx(twin.cost(along), rel=1e-13) and moved.t0 == t0
    for ours, theirs in zip(moved.expand(along), twin.expand(along), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-13)
    return moved


@pytest.mark.parametrize("t0", [0.0, 0.73])
@pytest.mark.parametrize("when", WINDOWS, ids=str)
def test_functions_of_time_are_arrays_by_knot(when, t0):
    ends = {"terminal_weight": 3.0} if when == "always" else {}
    terminal = when in ("always", "terminal") or when == [1, 4, -1]
    by_time = [costs.State([1.0, 2.0], sine, when, loss="huber", width=0.3, **ends)]
    by_knot = [costs.State([1.0, 2.0], rows(sine, t0), when, loss="huber", width=0.3, **ends)]
    if not terminal:
        by_time.append(costs.Control(0.2, force, when))
        by_knot.append(costs.Control(0.2, rows(force, t0, N), when))
    same(MASS, by_time, by_knot, t0, np.zeros(2))


@pytest.mark.parametrize("when", WINDOWS, ids=str)
def test_sensors_and_orientations_follow_functions_of_time(when):
    ball, t0 = mjslq.MujocoDynamics.from_xml(BALL), 0.4
    x0 = ball.initial_state
    place = lambda t: 0.3 * np.array([np.cos(t), np.sin(t), 0.0])  # noqa: E731
    by_time = [costs.Sensor("tip", place, 2.0, when), costs.Sensor("way", attitude, 1.0, when)]
    by_knot = [costs.Sensor("tip", rows(place, t0), 2.0, when), costs.Sensor("way", rows(attitude, t0), 1.0, when)]
    moved = same(ball, by_time, by_knot, t0, x0)
    errors = {error.sensor: error.last for error in task_errors(moved, trajectory(ball, 1))}
    twin = mjslq.Problem(ball, N, x0, by_knot)
    assert errors == pytest.approx({error.sensor: error.last for error in task_errors(twin, trajectory(ball, 1))})


def test_tracking_takes_functions_of_time():
    t0 = 1.3
    by_time = [costs.Tracking(2.0, 0.1, 5.0, sine, force)]
    by_knot = [costs.Tracking(2.0, 0.1, 5.0, rows(sine, t0), rows(force, t0, N))]
    same(MASS, by_time, by_knot, t0, np.zeros(2))


@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
@settings(max_examples=25)
def test_the_time_of_a_problem_is_the_last_one_it_was_moved_to(first, second):
    problem = mjslq.Problem(MASS, N, np.zeros(2), [costs.State(1.0, sine, "always"), costs.Control(1.0, force)])
    along = trajectory(MASS, 2)
    there = problem.at(np.zeros(2), second)
    assert problem.at(np.ones(2), first).at(np.zeros(2), second).cost(along) == there.cost(along)
    assert there.at(np.zeros(2)).cost(along) == problem.cost(along)


def test_signals_are_evaluated_at_all_knots_in_one_call():
    assert np.array_equal(Sines()(0.7), sine(0.7))
    calls = []

    class Counted(Sines):
        def over(self, times):
            calls.append(len(times))
            return super().over(times)

    signal = Counted()
    problem = mjslq.Problem(MASS, N, np.zeros(2), [costs.State(1.0, signal, "always"), costs.Control(1.0)])
    problem.cost(trajectory(MASS, 1))
    problem.at(np.zeros(2), 1.0)
    assert calls == [N + 1, N + 1]
    same(MASS, [costs.State(1.0, Sines(), "always")], [costs.State(1.0, rows(sine, 0.2), "always")], 0.2, np.zeros(2))


def test_limits_that_are_functions_of_time():
    t0, x0 = 0.35, np.zeros(2)
    lower, upper = (lambda t: [-np.inf, -1.0 - t]), (lambda t: 2.0 + t)
    names = {"by state": constraints.State(lower, upper, slice(2, 8))}
    twins = {"by state": constraints.State(rows(lower, t0)[2:8], np.repeat(rows(upper, t0)[2:8], 2, 1), slice(2, 8))}
    problem = mjslq.Problem(
        MASS, N, x0, [costs.Control(1.0)], constraints=[*names.values(), constraints.Control(lambda t: -3.0 + t, 5.0)],
        bounds=mjslq.Bounds(u=(-2.8, 4.0), x=(None, lambda t: [np.inf, 1.5 + t])),
    )  # fmt: skip
    twin = mjslq.Problem(
        MASS, N, x0, [costs.Control(1.0)], constraints=list(twins.values()),
        bounds=mjslq.Bounds(x=(None, np.stack([np.full(N + 1, np.inf), 1.5 + TIMES + t0], axis=1))),
    )  # fmt: skip
    moved, along = problem.at(x0, t0), MASS.rollout([3.0, -4.0], np.full((N, 1), 8.0))
    for name, values in twin.violations(along).items():
        np.testing.assert_allclose(moved.violations(along)[name], values, rtol=1e-13)
        assert values.any()
    np.testing.assert_allclose(moved.box.lower[:, 0], np.maximum(-2.8, -3.0 + TIMES[:-1] + t0), rtol=1e-13)
    assert np.array_equal(problem.box.lower[0], [-2.8]) and (moved.box.upper == 4.0).all()
    assert moved.at(x0).box.lower[2, 0] == problem.box.lower[2, 0]


def test_a_sensor_keeps_below_a_ceiling_that_sinks():
    ball = mjslq.MujocoDynamics.from_xml(BALL)
    ceiling = constraints.Sensor("tip", None, lambda t: [np.inf, np.inf, 0.1 - t], slice(0, 3))
    problem = mjslq.Problem(ball, N, ball.initial_state, [costs.Control(1.0)], constraints=[ceiling])
    along = problem.rollout(np.zeros((N, 1)))
    assert problem.violations(along)["tip"][:4] == pytest.approx([0.0, 0.0, 0.1, 0.0])
    assert problem.at(problem.x0, 0.5).violations(along)["tip"][:4] == pytest.approx([0.4, 0.5, 0.6, 0.0])


def test_a_receding_horizon_follows_a_target_and_keeps_to_limits_of_the_plants_time():
    target = lambda t: [np.sin(t), np.cos(t)]  # noqa: E731
    limit = lambda t: 0.8 + 0.05 * t  # noqa: E731
    problem = mjslq.Problem(
        MASS, 20, [0.0, 1.0], [costs.State(100.0, target, "always"), costs.Control(1e-4)],
        constraints=[constraints.Control(lambda t: -limit(t), limit)],
    )  # fmt: skip
    loop = mjslq.MPC(problem, iterations=3).run(duration=6.0)
    times, U = loop.trajectory.times, loop.trajectory.U[:, 0]
    error = np.abs(loop.trajectory.X - np.stack([target(t) for t in times]))
    assert (np.abs(U) <= limit(times[:-1]) + 1e-12).all()
    assert (np.abs(U) > limit(times[:-1]) - 1e-9).sum() > 3  # in force for a while, where |sin t| is near 1
    assert error[45:].max() < 0.05


def test_problems_with_functions_of_time_pickle():
    problem = mjslq.Problem(MASS_OF_MODULE, N, np.zeros(2), [costs.State(1.0, sine, "always"), costs.Control(1.0)])
    along = trajectory(MASS_OF_MODULE, 1)
    again = pickle.loads(pickle.dumps(problem))
    assert again.at(np.zeros(2), 0.4).cost(along) == problem.at(np.zeros(2), 0.4).cost(along)


def free_mass(x, u):
    return np.array([x[1], u[0]])


MASS_OF_MODULE = mjslq.FunctionDynamics(free_mass, 2, 1, H, integrator="rk4")


def boom(t):
    raise ZeroDivisionError("no luck")


@pytest.mark.parametrize(
    "make, told",
    [
        (lambda: costs.State(1.0, lambda t: [t, t, t]), r"shape \(2,\), got shape \(3,\) at t = 0 s"),
        (lambda: costs.State(1.0, lambda t: [0.0, np.nan if t > 0.25 else t]),
         r"target\(t\) must give finite, got nan in entry 1 at t = 0.3 s"),
        (lambda: costs.State(1.0, boom), r"target\(t\) raised ZeroDivisionError at t = 0 s: no luck"),
        (lambda: costs.Control(1.0, lambda t: "far"), r"value of target\(t\) at t = 0 s must be an array of numbers"),
        (lambda: costs.Tracking(1.0, 1.0, 1.0, u_target=lambda t: [t, t]), r"u_target\(t\) must give a number"),
        (lambda: costs.State(1.0, lambda: 0.0), r"target\(t\) raised TypeError at t = 0 s"),
    ],
)  # fmt: skip
def test_one_sentence_for_each_wrong_function(make, told):
    with pytest.raises(ValueError, match=told) as caught:
        mjslq.Problem(MASS, N, np.zeros(2), [make()])
    assert "\n" not in str(caught.value) and str(caught.value).startswith("costs[0]")


def test_one_sentence_for_wrong_limits_and_orientations():
    ball = mjslq.MujocoDynamics.from_xml(BALL)
    with pytest.raises(ValueError, match="must be a quaternion, not zeros"):
        mjslq.Problem(ball, N, ball.initial_state, [costs.Sensor("way", lambda t: 0.0), costs.Control(1.0)])
    for side, told in (((lambda t: np.nan), "numbers, -inf or inf"), ((lambda t: 1.0 + t), "nothing would be left")):
        with pytest.raises(ValueError, match=told):
            mjslq.Problem(MASS, N, np.zeros(2), [costs.Control(1.0)], constraints=[constraints.State(side, 1.5)])
    crossing = constraints.State(lambda t: t, 3.0, name="rising")
    problem = mjslq.Problem(MASS, N, np.zeros(2), [costs.Control(1.0)], constraints=[crossing])
    with pytest.raises(ValueError, match=r"constraint 'rising' from t = 2 s on: lower must not lie above upper"):
        problem.at(np.zeros(2), 2.0)
