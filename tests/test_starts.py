"""Starts: controls that hold a state, a servo towards one, and whatever a user hands in as a guess."""

import dataclasses

import numpy as np
import pytest
from limited_problems import function_pendulum, mujoco_pendulum, pinocchio_pendulum
from small_problems import DOUBLE_INTEGRATOR, pendulum

import mjslq
from mjslq import Bounds, FunctionDynamics, MujocoDynamics, Policy, Problem, Trajectory, costs, problems, solve, starts

ANGLE = 0.7
HOPPER = """
<mujoco><option timestep="0.01"/><worldbody><geom type="plane" size="5 5 1"/>
<body pos="0 0 1"><freejoint/><geom type="box" size=".2 .2 .2" mass="3"/>
<body pos="0 0 -.3"><joint name="leg" type="slide" axis="0 0 1"/><geom type="sphere" size=".05" mass=".5"/></body>
</body></worldbody><actuator><motor joint="leg"/></actuator></mujoco>"""

# Holding a state


def test_hold_is_gravitys_torque():
    problem = pendulum(x0=(ANGLE, 0.0))
    U = starts.hold(problem)
    assert U.shape == (40, 1)
    np.testing.assert_allclose(U, 9.81 * np.sin(ANGLE), rtol=1e-9)
    np.testing.assert_allclose(problem.rollout(U).X, np.tile([ANGLE, 0.0], (41, 1)), atol=1e-8)


def test_hold_takes_another_state():
    problem = pendulum()
    assert not starts.hold(problem).any()
    np.testing.assert_allclose(starts.hold(problem, [-ANGLE, 0.0]), -9.81 * np.sin(ANGLE), rtol=1e-9)


@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_hold_of_an_arm_is_what_its_engine_says(engine):
    """The Panda's own start is the torque that holds it up, from MuJoCo's bias forces or Pinocchio's gravity."""
    problem = problems.get("panda_reach", horizon=20, duration=0.2, engine=engine)
    blind = dataclasses.replace(problem, U0=np.zeros(7))
    U = starts.hold(blind)
    np.testing.assert_allclose(U, problem.U0, atol=1e-7)
    assert np.abs(U).max() > 5.0
    np.testing.assert_allclose(blind.rollout(U).X, np.tile(problem.x0, (21, 1)), atol=1e-6)
    bent = problem.dynamics.integrate(np.array(problem.x0), np.concatenate([0.3 * np.ones(7), np.zeros(7)]))
    there = dataclasses.replace(blind, x0=bent)
    np.testing.assert_allclose(there.rollout(starts.hold(blind, bent)).X, np.tile(bent, (21, 1)), atol=1e-6)


def test_hold_keeps_to_the_limits_and_does_what_it_can_within():
    weak = pendulum(x0=(ANGLE, 0.0), bounds=Bounds(u=(-2.0, 2.0)))
    assert (starts.hold(weak) == 2.0).all()
    lower, upper = np.full((40, 1), -9.0), np.full((40, 1), 9.0)
    upper[10:] = 1.0
    narrowing = pendulum(x0=(ANGLE, 0.0), bounds=Bounds(u=(lower, upper)))
    U = starts.hold(narrowing)
    np.testing.assert_allclose(U[:10], 9.81 * np.sin(ANGLE), rtol=1e-9)
    assert (U[10:] == 1.0).all()


def test_hold_leaves_alone_what_no_control_can_balance():
    """A robot in the air falls, whatever its leg does: no other control changes its state less over a step."""
    dynamics = MujocoDynamics.from_xml(HOPPER)
    x0 = np.zeros(dynamics.nx)
    x0[2], x0[3] = 3.0, 1.0
    U = starts.hold(Problem(dynamics, 10, x0, [costs.Control(1.0)]))
    assert (U[0] == U).all()

    def change(u):
        return np.linalg.norm(dynamics.difference(x0, dynamics.step(x0, u)[0]))

    assert all(change(U[0]) < change(U[0] + du) for du in (-1e-2, 1e-2, -1.0, 1.0))
    assert change(U[0]) > 0.05  # it falls all the same


def test_hold_of_a_state_that_moves_by_itself_and_of_one_that_blows_up():
    drifting = Problem(DOUBLE_INTEGRATOR, 5, [0.0, 1.0], [costs.Control(1.0)])
    assert np.isfinite(starts.hold(drifting)).all()
    dynamics = FunctionDynamics(lambda x, u: np.exp(x * x) + u, 1, 1, 1.0, integrator="map")
    with np.errstate(over="ignore"):
        U = starts.hold(Problem(dynamics, 5, [100.0], [costs.Control(1.0)], U0=[0.25]))
    assert (U == 0.25).all()  # nothing can be told: the problem's own start


@pytest.mark.parametrize("x", [[0.0], [0.0, np.nan], "home"])
def test_hold_refuses_what_is_no_state(x):
    with pytest.raises(ValueError, match=r"^x must"):
        starts.hold(pendulum(), x)


# A servo


def test_servo_pulls_towards_its_target_as_stiffly_as_told():
    """Critically damped where nothing else acts: exp(-w t) (1 + w t)."""
    dynamics = FunctionDynamics(lambda x, u: np.stack([x[1], 3.0 * u[0]]), 2, 1, 0.01)
    problem = Problem(dynamics, 200, [0.8, 0.0], [costs.Control(1.0)])
    policy = starts.servo(problem, [0.3, 0.0], stiffness=25.0)
    assert isinstance(policy, Policy) and policy.horizon == 200
    followed = first_iterate(problem, guess=policy)
    t = followed.times
    distance = (followed.X[:, 0] - 0.3) / 0.5
    np.testing.assert_allclose(distance, np.exp(-5.0 * t) * (1.0 + 5.0 * t), atol=0.03)


def test_servo_has_the_acceleration_that_it_was_told():
    """u = u_hold - M (k (q - q_target) + d v): -k for each unit of distance, -d for each of speed."""
    problem = mujoco_pendulum("-50 50")
    policy = starts.servo(problem, stiffness=30.0, damping=4.0)
    e, h = 1e-5, 0.05
    at_rest = problem.dynamics.step(problem.x0, policy.U[0])[0]
    for direction, rate in ((0, 30.0), (1, 4.0)):
        x = np.array(problem.x0)
        x[direction] += e
        u = policy(x, 0.0) - policy.U[0]
        with_it, without = (problem.dynamics.step(x, policy.U[0] + du)[0] for du in (u, 0.0 * u))
        assert (with_it[1] - without[1]) / (h * e) == pytest.approx(-rate, rel=1e-3)
    np.testing.assert_allclose(at_rest, problem.x0, atol=1e-9)


@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_servo_moves_an_arm_to_another_pose(engine):
    problem = problems.get("panda_reach", horizon=150, duration=1.5, engine=engine)
    blind = dataclasses.replace(problem, U0=np.zeros(7))
    target = problem.dynamics.integrate(np.array(problem.x0), np.concatenate([0.2 * np.ones(7), np.zeros(7)]))
    result = solve(blind, "slq", guess=starts.servo(blind, target, stiffness=400.0), max_iterations=0)
    away = problem.dynamics.difference(target, result.trajectory.X[-1])
    assert np.abs(away).max() < 1e-4


def test_servo_keeps_to_the_limits():
    problem = mujoco_pendulum()
    policy = starts.servo(problem, [2.5, 0.0], stiffness=400.0)
    assert policy([0.0, 0.0], 0.0) == 1.0 and policy([5.0, 0.0], 0.0) == -1.2
    start = solve(problem, "slq", guess=policy, max_iterations=0).trajectory
    assert (start.U >= -1.2).all() and (start.U <= 1.0).all() and (start.U == 1.0).any()


@pytest.mark.parametrize(
    "arguments, sentence",
    [
        ({"stiffness": -1.0}, "stiffness must be positive and finite, got -1.0"),
        ({"stiffness": "hard"}, "stiffness must be a number, got str 'hard'"),
        ({"damping": 0.0}, "damping must be positive and finite, got 0.0"),
        ({"target": [0.0]}, r"target must have shape \(2,\), got \(1,\)"),
    ],
)
def test_wrong_servos_are_refused_in_one_sentence(arguments, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        starts.servo(pendulum(), **arguments)
    assert "\n" not in str(caught.value)


def test_a_servo_needs_velocities():
    dynamics = FunctionDynamics(lambda x, u: x + u[0], 3, 1, 0.1)
    with pytest.raises(ValueError, match="a servo needs a velocity for each position, but of the 3 directions"):
        starts.servo(Problem(dynamics, 5, np.zeros(3), [costs.Control(1.0)]))


# Guesses


def first_iterate(problem, **given):
    return solve(problem, "slq", max_iterations=0, **given).trajectory


def test_guess_of_controls_and_states_is_U0_and_X0():
    problem = pendulum()
    U = np.random.default_rng(0).standard_normal((40, 1))
    np.testing.assert_array_equal(first_iterate(problem, guess=U).U, U)
    np.testing.assert_array_equal(first_iterate(problem, guess=[0.3]).U, np.full((40, 1), 0.3))
    X = np.linspace(0.0, 1.0, 41)[:, None] * np.array([3.0, 0.0])
    by_guess, by_name = (solve(problem, "slq", **{name: X}) for name in ("guess", "X0"))
    assert by_guess.log[0].gap == by_name.log[0].gap > 0.0
    np.testing.assert_array_equal(by_guess.trajectory.U, by_name.trajectory.U)


def test_guess_of_a_trajectory_takes_its_controls():
    problem = pendulum()
    trajectory = problem.rollout([0.4])
    np.testing.assert_array_equal(first_iterate(problem, guess=trajectory).U, trajectory.U)


def test_guess_of_a_result_goes_on_where_it_ended():
    problem = pendulum()
    half = solve(problem, "slq", max_iterations=4)
    again = solve(problem, "slq", guess=half)
    np.testing.assert_array_equal(again.iterates[0].U, half.trajectory.U)
    assert again.log[0].cost == half.cost and again.success
    optimum = solve(problem, "newton")
    assert solve(problem, "newton", guess=optimum).iterations <= 1


def test_guess_of_a_result_without_gains_takes_its_controls():
    problem = pendulum()
    descended = solve(problem, "gradient", max_iterations=5)
    assert descended.gains is None
    np.testing.assert_array_equal(first_iterate(problem, guess=descended).U, descended.trajectory.U)


def test_guess_of_a_result_is_followed_from_another_start():
    """Under its feedback, which ends nearer to the goal than its controls alone."""
    optimum = solve(pendulum(), "slq")
    moved = pendulum(x0=(0.3, 0.4))
    followed = first_iterate(moved, guess=optimum)
    blind = first_iterate(moved, guess=optimum.trajectory)
    assert moved.cost(followed) < 0.5 * moved.cost(blind)
    by_policy = first_iterate(moved, guess=optimum.policy)
    np.testing.assert_array_equal(by_policy.U, followed.U)


def test_a_policy_is_followed_within_the_problems_limits():
    optimum = solve(pendulum(), "slq")
    limited = pendulum(x0=(0.5, 0.0), bounds=Bounds(u=(-2.0, 2.0)))
    start = first_iterate(limited, guess=optimum)
    assert np.abs(start.U).max() == 2.0
    X, policy = [np.array([0.5, 0.0])], dataclasses.replace(optimum.policy, lower=None, upper=None)
    for n in range(40):
        u = np.clip(policy(X[-1], n * 0.05), -2.0, 2.0)
        np.testing.assert_allclose(u, start.U[n], rtol=1e-9, atol=1e-9)
        X.append(limited.dynamics.step(X[-1], u, n)[0])


@pytest.mark.parametrize("N", [15, 40, 60])
@pytest.mark.parametrize("kind", ["result", "policy", "without gains"])
def test_a_policy_of_another_horizon_is_cut_or_goes_on_with_its_last_step(kind, N):
    optimum = solve(pendulum(), "slq")
    guess = {"result": optimum, "policy": optimum.policy, "without gains": Policy.along(optimum.trajectory)}[kind]
    start = first_iterate(pendulum(N=N), guess=guess)
    common = min(N, 40)
    np.testing.assert_allclose(start.U[:common], optimum.trajectory.U[:common], rtol=1e-9, atol=1e-9)
    if N > 40 and kind == "without gains":
        np.testing.assert_array_equal(start.U[40:], np.tile(optimum.trajectory.U[-1], (N - 40, 1)))
    elif N > 40:
        policy, x = optimum.policy, start.X[50]
        np.testing.assert_allclose(start.U[50], policy(x, 40 * 0.05 + 1.0), rtol=1e-9)


def test_a_policy_that_blows_up_is_left_for_its_controls():
    """Gains of the wrong sign in a system that squares its state."""
    dynamics = FunctionDynamics(lambda x, u: x * x + u, 1, 1, 1.0, integrator="map")
    problem = Problem(dynamics, 20, [0.1], [costs.Control(1.0)])
    U, K = np.zeros((20, 1)), np.full((20, 1, 1), -50.0)
    start = first_iterate(problem, guess=Policy(np.zeros((21, 1)), U, K))
    np.testing.assert_array_equal(start.U, U)
    assert np.isfinite(start.X).all()


def test_a_loaded_result_is_a_guess(tmp_path):
    problem = pendulum()
    half = solve(problem, "slq", max_iterations=3)
    half.save(tmp_path / "half.npz")
    again = solve(problem, "slq", guess=mjslq.load(tmp_path / "half.npz"), max_iterations=0)
    np.testing.assert_array_equal(again.trajectory.U, half.trajectory.U)


def test_a_result_of_one_engine_is_a_guess_for_another():
    ours = problems.get("panda_reach", horizon=20, duration=0.2, engine="mujoco")
    theirs = problems.get("panda_reach", horizon=20, duration=0.2, engine="pinocchio")
    result = solve(ours, "slq", max_iterations=3)
    start = first_iterate(theirs, guess=result)
    assert theirs.cost(start) == pytest.approx(result.cost, rel=1e-5)


@pytest.mark.parametrize("make", [function_pendulum, mujoco_pendulum])
def test_a_guess_beyond_the_limits_is_clipped_and_the_message_says_so(make):
    problem = make()
    for guess in (np.full((30, 1), 99.0), Trajectory(np.zeros((31, 2)), np.full((30, 1), 99.0), dt=0.05)):
        result = solve(problem, "slq", guess=guess, max_iterations=1)
        np.testing.assert_array_equal(result.iterates[0].U, problem.box.upper)
        assert "clipped to the limits of the controls at 30 steps" in result.message


@pytest.mark.parametrize(
    "given, sentence",
    [
        (
            {"guess": np.zeros((39, 1))},
            r"guess must be a Result, .*, controls \(40, 1\) or states \(41, 2\), got shape \(39, 1\)",
        ),
        ({"guess": np.zeros((41, 1))}, r"got shape \(41, 1\)"),
        ({"guess": 3.0}, r"got shape \(\)"),
        ({"guess": "best"}, "guess must be a Result, .* or an array of controls or states, got str 'best'"),
        ({"guess": np.full((40, 1), np.nan)}, r"guess must be finite, but guess\[0, 0\] is nan"),
        ({"guess": np.zeros((40, 1)), "U0": [0.0]}, "give either guess or U0 and X0, not both"),
        ({"guess": np.zeros((40, 1)), "X0": np.zeros((41, 2))}, "give either guess or U0 and X0, not both"),
        (
            {"guess": Trajectory(np.zeros((31, 2)), np.zeros((30, 1)))},
            "the guess is a trajectory of 30 steps and 1 controls, but the problem has 40 and 1",
        ),
        (
            {"guess": Policy(np.zeros((41, 3)), np.zeros((40, 1)))},
            "the guess is a policy of 3 states and 1 controls, but the problem has 2 and 1",
        ),
        (
            {"guess": Policy(np.zeros((41, 2)), np.zeros((40, 2)))},
            "the guess is a policy of 2 states and 2 controls, but the problem has 2 and 1",
        ),
        ({"U0": np.zeros((3, 1))}, r"U0 must have shape \(40, 1\) or \(1,\), got \(3, 1\)"),
        ({"X0": np.zeros((40, 2))}, r"X0 must have shape \(41, 2\), got \(40, 2\)"),
    ],
)
def test_wrong_guesses_are_refused_in_one_sentence(given, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        solve(pendulum(), "slq", **given)
    assert "\n" not in str(caught.value)


def test_a_guess_of_states_needs_a_method_that_takes_them():
    with pytest.raises(ValueError, match=r"method 'trust-region' takes no state guess X0; these do: .*slq, newton"):
        solve(pendulum(), "trust-region", guess=np.zeros((41, 2)))


# What they are good for


def test_starts_on_every_engine(tmp_path):
    for problem in (function_pendulum(), mujoco_pendulum(), pinocchio_pendulum(tmp_path)):
        for guess in (starts.hold(problem), starts.servo(problem)):
            result = solve(problem, "slq", guess=guess)
            assert result.success, result.message
