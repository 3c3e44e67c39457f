"""Policies: the plan along the plan, feedback beside it, limits, times between knots, files, a plain MuJoCo loop."""

import subprocess
import sys
import textwrap

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from limited_problems import MJCF, function_pendulum, mujoco_pendulum
from small_problems import pendulum

import mjslq
from mjslq import MujocoDynamics, Policy, Problem, Trajectory, costs, solve
from mjslq.lie_groups import ROTATION
from mjslq.manifold import StateSpace

seeds = st.integers(0, 2**32 - 1)
BALL = """
<mujoco><option timestep="0.02"/><worldbody><body><joint name="b" type="ball" damping=".2"/>
<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".05" mass="1"/></body></worldbody>
<actuator><motor joint="b" gear="1 0 0"/><motor joint="b" gear="0 1 0"/><motor joint="b" gear="0 0 1"/></actuator>
</mujoco>"""


def sample(rng, *, dt=None, gains=True, limits=True, N=6, nx=3, nu=2):
    U = rng.standard_normal((N, nu))
    return Policy(
        rng.standard_normal((N + 1, nx)), U, rng.standard_normal((N, nu, nx)) if gains else None,
        rng.uniform(0.05, 0.2, N) if dt is None else dt,
        *((U - rng.uniform(0.0, 1.0, U.shape), U + rng.uniform(0.0, 1.0, U.shape)) if limits else ()),
    )  # fmt: skip


@given(seeds, st.sampled_from([None, 0.1, 1.0 / 3.0, 0.01, 1e-3, 7.0]), st.booleans())
def test_along_the_plan_the_controls_are_the_plans(seed, dt, gains):
    """To the last bit at t = n dt, however that is rounded, and at the knots' own times."""
    policy = sample(np.random.default_rng(seed), dt=dt, gains=gains, N=50)
    for n in range(50):
        times = [policy.times[n]] if dt is None else [policy.times[n], n * dt]
        for t in times:
            np.testing.assert_array_equal(policy(policy.X[n], t), policy.U[n])


def test_products_that_round_down_are_the_knot_all_the_same():
    policy = sample(np.random.default_rng(0), dt=0.1, N=200)
    down = [n for n in range(200) if n * 0.1 < policy.times[n]]
    assert len(down) > 20  # 0.1 n falls below the sum of n times 0.1
    for n in down:
        np.testing.assert_array_equal(policy(policy.X[n], n * 0.1), policy.U[n])


@given(seeds, st.floats(0.0, 1.0))
def test_between_knots_the_reference_lies_on_the_way(seed, share):
    rng = np.random.default_rng(seed)
    policy, x = sample(rng, limits=False), rng.standard_normal(3)
    for n in range(policy.horizon):
        t = policy.times[n] + share * policy.dt[n] * (1.0 - 1e-6)
        reference = policy.X[n] + (t - policy.times[n]) / policy.dt[n] * (policy.X[n + 1] - policy.X[n])
        np.testing.assert_allclose(policy(x, t), policy.U[n] - policy.K[n] @ (x - reference), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(policy(reference, t), policy.U[n], atol=1e-9)


def test_before_the_first_knot_and_after_the_last_step():
    policy = sample(np.random.default_rng(1), limits=False)
    x, T = np.array([0.3, -0.2, 0.1]), policy.times[-1]
    np.testing.assert_array_equal(policy(x, -5.0), policy(x, 0.0))
    for t in (T, T + 1e-9, T + 100.0, np.inf):
        np.testing.assert_allclose(policy(x, t), policy.U[-1] - policy.K[-1] @ (x - policy.X[-1]), rtol=1e-12)


@given(seeds)
def test_limits_hold_in_every_state_and_at_every_time(seed):
    rng = np.random.default_rng(seed)
    policy = sample(rng)
    free = Policy(policy.X, policy.U, policy.K, policy.dt)
    clipped = 0
    for t in rng.uniform(-0.1, policy.times[-1] + 0.1, 20):
        n = int(np.clip(np.searchsorted(policy.times, t, side="right") - 1, 0, policy.horizon - 1))
        x = 3.0 * rng.standard_normal(3)
        u, wanted = policy(x, t), free(x, t)
        np.testing.assert_array_equal(u, np.minimum(np.maximum(wanted, policy.lower[n]), policy.upper[n]))
        clipped += (u != wanted).any()
    assert clipped > 5


def test_limits_may_be_one_a_control_or_none():
    X, U = np.zeros((4, 2)), np.zeros((3, 2))
    K = np.tile(np.eye(2), (3, 1, 1))
    policy = Policy(X, U, K, lower=[-1.0, -np.inf])
    np.testing.assert_array_equal(policy([9.0, 9.0], 0.0), [-1.0, -9.0])
    assert policy.lower.shape == policy.upper.shape == (3, 2) and (policy.upper == np.inf).all()


def test_without_gains_the_state_does_not_matter():
    policy = sample(np.random.default_rng(2), gains=False)
    for n, t in enumerate(policy.times[:-1]):
        np.testing.assert_array_equal(policy(np.full(3, 1e9), t + 1e-3), policy.U[n])
    along = Policy.along(Trajectory(policy.X, policy.U, dt=policy.dt))
    assert along.K is None and along.horizon == 6
    np.testing.assert_array_equal(along.times, policy.times)


@given(seeds, st.integers(0, 8))
def test_shifted_is_the_policy_from_there_on(seed, steps):
    policy = sample(np.random.default_rng(seed))
    shifted = policy.shifted(steps)
    assert shifted.horizon == policy.horizon
    x = np.array([0.5, -1.0, 2.0])
    for n in range(policy.horizon - steps):
        np.testing.assert_array_equal(shifted.X[n], policy.X[n + steps])
        np.testing.assert_array_equal(shifted(x, shifted.times[n]), policy(x, policy.times[n + steps]))
    np.testing.assert_array_equal(shifted.U[-1], policy.U[-1])
    np.testing.assert_array_equal(shifted.X[-1], policy.X[-1])
    np.testing.assert_array_equal(policy.shifted(0).K, policy.K)


def test_shifted_without_gains():
    assert sample(np.random.default_rng(0), gains=False).shifted(2).K is None


@given(seeds)
def test_orientations_are_compared_on_their_sphere(seed):
    """A quaternion and its negative are one orientation, and references between knots stay of unit length."""
    rng = np.random.default_rng(seed)
    space = StateSpace.of(8, 7, [(ROTATION, range(4), range(3))])
    origin = np.array([1.0, 0, 0, 0, 0, 0, 0, 0])
    X = space.integrate(np.tile(origin, (5, 1)), rng.standard_normal((5, 7)))
    U, K = rng.standard_normal((4, 2)), rng.standard_normal((4, 2, 7))
    policy = Policy(X, U, K, 0.1, space=space)
    for n in range(4):
        away = rng.standard_normal(7) * 0.5
        x = space.integrate(X[n], away)
        other = x.copy()
        other[:4] = -x[:4]
        np.testing.assert_allclose(policy(x, n * 0.1), U[n] - K[n] @ away, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(policy(other, n * 0.1), policy(x, n * 0.1), rtol=1e-9, atol=1e-9)
        half = space.integrate(X[n], 0.5 * space.difference(X[n], X[n + 1]))
        np.testing.assert_allclose(policy(half, (n + 0.5) * 0.1), U[n], atol=1e-9)


@pytest.mark.parametrize(
    "fields, sentence",
    [
        ({"X": np.zeros(3)}, r"X must have shape \(N \+ 1, nx\), got \(3,\)"),
        ({"U": np.zeros((4, 1))}, r"U must have shape \(3, nu\), got \(4, 1\)"),
        ({"K": np.zeros((3, 2, 1))}, r"K must have shape \(3, 1, 2\), got \(3, 2, 1\)"),
        ({"U": np.full((3, 1), np.nan)}, r"U must be finite, but U\[0, 0\] is nan"),
        ({"dt": [0.1, 0.2]}, r"dt must be a number or one per step \(3,\), got shape \(2,\)"),
        ({"lower": np.zeros((2, 1))}, r"lower must be a number, .* got shape \(2, 1\)"),
        ({"upper": [1.0, 2.0]}, r"upper must be a number, .* got shape \(2,\)"),
        ({"lower": 1.0, "upper": 0.0}, "lower must not lie above upper"),
        ({"upper": np.nan}, "neither may be NaN"),
        ({"dt": 0.0}, "dt must be positive"),
    ],
)
def test_shapes_that_do_not_belong_together_are_refused_in_one_sentence(fields, sentence):
    whole = {"X": np.zeros((4, 2)), "U": np.zeros((3, 1)), "K": np.zeros((3, 1, 2))}
    with pytest.raises(ValueError, match=sentence) as caught:
        Policy(**(whole | fields))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("x", [[0.0], [0.0, 0.0, 0.0], [np.nan, 0.0], "here"])
def test_wrong_states_are_refused(x):
    policy = Policy(np.zeros((4, 2)), np.zeros((3, 1)), np.zeros((3, 1, 2)))
    with pytest.raises(ValueError, match=r"^x must"):
        policy(x, 0.0)


@pytest.mark.parametrize("steps", [-1, 1.5, "two", True])
def test_wrong_shifts_are_refused(steps):
    with pytest.raises(ValueError, match="steps must be a whole number of at least 0"):
        sample(np.random.default_rng(0)).shifted(steps)


def test_a_policy_stays_as_it_was_made():
    X, U = np.zeros((4, 2)), np.zeros((3, 1))
    policy = Policy(X, U)
    with pytest.raises(ValueError, match="read-only"):
        policy.U[0] = 1.0
    u = policy(np.zeros(2), 0.0)
    assert u.shape == (1,)


# Of a result


@pytest.mark.parametrize("method", ["auto", "slq", "newton", "trust-region", "gradient"])
@pytest.mark.parametrize("make", [function_pendulum, mujoco_pendulum])
def test_a_results_policy_is_its_plan(make, method):
    problem = make()
    result = solve(problem, method, max_iterations=20)
    policy, h = result.policy, float(np.ravel(problem.dynamics.dt)[0])
    for n in range(30):
        np.testing.assert_array_equal(policy(result.trajectory.X[n], n * h), result.trajectory.U[n])
        assert (policy(result.trajectory.X[n] + 10.0, n * h) <= problem.box.upper[n]).all()
    assert (policy.K is None) == (method == "gradient")


def test_a_results_policy_survives_its_file(tmp_path):
    problem = ball_problem()
    before = solve(problem, "slq", max_iterations=5)
    before.save(tmp_path / "ball.npz")
    policy, again = before.policy, mjslq.load(tmp_path / "ball.npz").policy
    rng = np.random.default_rng(0)
    for t in rng.uniform(0.0, 0.6, 20):
        x = problem.dynamics.integrate(problem.x0, rng.standard_normal(6))
        np.testing.assert_array_equal(policy(x, t), again(x, t))
    assert again.space.ndx == 6


def ball_problem():
    dynamics = MujocoDynamics.from_xml(BALL)
    rest = np.array([1.0, 0, 0, 0, 0, 0, 0])
    goal = dynamics.integrate(rest, np.array([0.6, -0.4, 0.3, 0, 0, 0]))
    return Problem(dynamics, 30, rest, [costs.Control(0.1), costs.State([200.0] * 3 + [20.0] * 3, goal, "terminal")])


def test_a_closed_loop_under_the_policy_is_the_engines_own():
    """In steps of the plan the policy does what `rollout_feedback` does, limits included."""
    problem = mujoco_pendulum()
    result = solve(problem, "slq")
    dynamics, policy, h = problem.dynamics, result.policy, 0.05
    x, X = np.array([0.3, -0.5]), [np.array([0.3, -0.5])]
    for n in range(30):
        x = dynamics.step(x, policy(x, n * h), n)[0]
        X.append(x)
    K, k = result.gains, np.zeros((30, 1))
    free = dynamics.rollout_feedback(result.trajectory, K, k, x0=X[0])  # MuJoCo clamps by itself
    np.testing.assert_allclose(free.X, X, rtol=1e-8, atol=1e-9)


# In a plain MuJoCo loop


def run(model, control, T, push=0.0):
    """A loop as a user would write it; `push` is a torque that nobody planned, for the first fifth of the time."""
    data = mujoco.MjData(model)
    while data.time < T - 1e-9:
        data.qfrc_applied[:] = push if data.time < 0.2 * T else 0.0
        data.ctrl[:] = control(np.concatenate([data.qpos, data.qvel]), data.time)
        mujoco.mj_step(model, data)
    return np.concatenate([data.qpos, data.qvel])


@pytest.mark.parametrize("timestep", [0.05, 0.005])
def test_in_a_plain_loop_it_follows_the_plan_under_a_disturbance(timestep):
    """Up to where gravity pulls away; also where the loop is ten times as fast as the plan."""
    limited = mujoco_pendulum("-6 6")
    terms = [costs.Control(0.1), costs.State([1000.0, 100.0], [2.8, 0.0], "terminal")]
    result = solve(Problem(limited.dynamics, 30, [0.0, 0.0], terms), "slq")
    assert result.success, result.message
    model = mujoco.MjModel.from_xml_string(MJCF.format(limits="-6 6"))
    model.opt.timestep = timestep
    T, goal, policy = 1.5, result.trajectory.X[-1], result.policy
    if timestep == 0.05:  # undisturbed, the plan itself
        np.testing.assert_allclose(run(model, policy, T), goal, atol=1e-9)
    open_loop = Policy(policy.X, policy.U, None, policy.dt)
    pushed, lost = (np.abs(run(model, law, T, 0.5) - goal) for law in (policy, open_loop))
    assert pushed[0] < 0.1 * lost[0] and pushed[0] < 0.05


def test_it_needs_neither_solver_nor_engine(tmp_path):
    """Loaded from a file and called, without a solver, a simulator or a compiler imported."""
    program = """
        import sys
        from mjslq.storage import load
        policy = load(sys.argv[1]).policy
        print(repr(float(policy([0.1, 0.2], 0.33)[0])))
        wanted = [name for name in ("mujoco", "pinocchio", "mjslq.optimize") if name in sys.modules]
        assert not wanted, wanted
    """
    result, path = solve(pendulum(), "slq", max_iterations=3), tmp_path / "pendulum.npz"
    result.save(path)
    command = [sys.executable, "-c", textwrap.dedent(program), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == result.policy([0.1, 0.2], 0.33)[0]
