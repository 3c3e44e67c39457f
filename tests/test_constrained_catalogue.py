"""The catalogue's problems with constraints: equations, known optima, and every limit checked anew."""

import dataclasses
import runpy
from pathlib import Path

import mujoco
import numpy as np
import pytest

import mjslq
from mjslq import problems, solve
from mjslq.problems import arm_obstacle, bryson_denham, drag_cart, reentry
from mjslq.problems.obstacles import clearance

ROOT = Path(__file__).parent.parent


def rk4(f, x, u, dt):
    k1 = f(x, u)
    k2 = f(x + 0.5 * dt * k1, u)
    k3 = f(x + 0.5 * dt * k2, u)
    return x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + f(x + dt * k3, u))


def arm(x, u):
    """By Lagrange's equations for the rods in joint angles, the inertia by sums of Jacobians."""
    q, v = x[:3], x[3:]

    def places(q):
        """Centers of the rods, and their angles. Shape (3, 3)."""
        f = np.cumsum(q)
        ends = np.cumsum(np.stack([np.cos(f), np.sin(f)]) * arm_obstacle.LENGTHS, axis=1)
        return np.vstack([ends - 0.5 * np.stack([np.cos(f), np.sin(f)]) * arm_obstacle.LENGTHS, f])

    def inertia(q):
        J = np.stack([(places(q + 1e-20j * e)).imag / 1e-20 for e in np.eye(3)], axis=2)
        m, length = np.array(arm_obstacle.MASSES), np.array(arm_obstacle.LENGTHS)
        weights = np.stack([m, m, m * length**2 / 12.0])
        return np.einsum("ki,kia,kib->ab", weights, J, J), 9.81 * np.einsum("i,ia->a", m, J[1])

    M, gravity = inertia(q)
    e = 1e-6
    D = np.stack([(inertia(q + e * d)[0] - inertia(q - e * d)[0]) / (2.0 * e) for d in np.eye(3)], axis=2)
    coriolis = np.einsum("abc,b,c->a", D, v, v) - 0.5 * np.einsum("bca,b,c->a", D, v, v)
    return np.concatenate([v, np.linalg.solve(M, u - coriolis - gravity)])


def slew(x, u):
    """Momentum and energy: (J + e^2) w + d e' changes by u, and so on, by a dense solve."""
    _, e, w, s = x
    M = np.array([[1.0 + e * e, 0.6], [0.6, 1.0]])
    rest = [u[0] - 2.0 * e * s * w, -2.0 * 0.005 * 1.5 * s - (1.5**2 - w * w) * e]
    return np.concatenate([[w, s], np.linalg.solve(M, rest)])


@pytest.mark.parametrize("name, f", [("arm_obstacle", arm), ("spacecraft_slew", slew)])
def test_equations(name, f):
    problem = problems.get(name)
    rng = np.random.default_rng(0)
    nx, nu, dt = problem.dynamics.nx, problem.dynamics.nu, float(np.min(problem.dynamics.dt))
    for _ in range(3):
        x, u = rng.standard_normal(nx), rng.standard_normal(nu)
        np.testing.assert_allclose(problem.dynamics.step(x, u)[0], rk4(f, x, u, dt), rtol=1e-8, atol=1e-9)


def test_the_arm_is_held_at_its_start():
    problem = problems.get("arm_obstacle")
    held = problem.rollout(problem.U0).X
    np.testing.assert_allclose(held, np.tile(problem.x0, (61, 1)), atol=1e-9)


@pytest.mark.parametrize("N", [17, 50, 200])
def test_example_1_to_all_digits(N):
    """Bryson and Denham's problem from u = -2; the wall is kept to 1e-9."""
    problem = problems.get("bryson_denham", horizon=N)
    result = solve(problem, tol_violation=1e-9)
    assert result.success and result.constraint_violation <= 1e-9
    assert result.cost == pytest.approx(bryson_denham.OPTIMAL_COSTS[N], abs=6e-6 if N == 200 else 6e-5)
    assert problem.violation(problem.rollout(result.trajectory.U)) <= 1e-9


@pytest.mark.parametrize("N", [20, 50, 100])
def test_example_2_to_all_digits(N):
    problem = problems.get("drag_cart", horizon=N)
    result = solve(problem)
    assert result.success and result.cost == pytest.approx(drag_cart.OPTIMAL_COSTS[N], abs=6e-6)
    if N == 50:
        touched = result.trajectory.times[np.flatnonzero(result.multipliers["pressure"][:, 0] > 1e-6)]
        assert 0.42 < touched[0] < 0.46 and 0.54 < touched[-1] < 0.58  # [0.445, 0.555], by steps of 0.02
        free = dataclasses.replace(problem, constraints=[problem.constraints[1]])
        assert solve(free, tol_violation=1e-9).cost == pytest.approx(drag_cart.FREE_COST, abs=6e-6)


def test_reentry_starts_where_the_thesis_does():
    problem = problems.get("reentry", limits="row")
    trajectory = problem.rollout(problem.U0)
    load = reentry.loads(trajectory)
    assert np.degrees(trajectory.X[-1, 1]) == pytest.approx(reentry.PAPER["final angle"], abs=2e-3)
    assert load.max() == pytest.approx(reentry.PAPER["peak load"], abs=0.01)
    assert trajectory.times[load.argmax() + 1] == reentry.PAPER["peak time"]


@pytest.mark.parametrize("variant", ["thesis", "tracking"])
@pytest.mark.parametrize("start", ["nominal", "second"])
def test_reentry_from_both_starts(variant, start):
    problem = problems.get("reentry", variant=variant, start=start)
    first = problem.rollout(problem.U0)
    if start == "second":
        assert np.degrees(first.X[:, 1].min()) < -45.0 and first.X[-1, 2] < 0.5  # it plunges
    result = solve(problem)
    check_reentry(problem, result, variant)


def check_reentry(problem, result, variant):
    assert result.success, result.message
    again = problem.rollout(result.trajectory.U)
    assert np.degrees(again.U.max()) <= 22.5 + 1e-9 and abs(again.X[-1, 1]) <= 1e-6
    assert reentry.loads(again, at_end=variant == "thesis").max() <= 5.0 + 1e-6
    if variant == "tracking":
        assert result.cost == pytest.approx(reentry.TRACKING_COST, abs=1e-5)


def random_angles(rng):
    """A polynomial of degree 4 that spans a range within -20 to 40 degrees. [rad]"""
    y = np.polynomial.chebyshev.chebval(np.linspace(-1.0, 1.0, 300), rng.uniform(-1.0, 1.0, 5))
    low, high = np.sort(rng.uniform(-20.0, 40.0, 2))
    return np.radians(low + (high - low) * (y - y.min()) / (y.max() - y.min()))[:, None]


@pytest.mark.parametrize("count", [2, pytest.param(22, marks=pytest.mark.slow)])
def test_reentry_from_random_starts(count):
    rng, problem = np.random.default_rng(0), problems.get("reentry", variant="tracking")
    for _ in range(count):
        check_reentry(problem, solve(problem, U0=random_angles(rng)), "tracking")


def test_the_spacecraft_turns_without_bending_too_far():
    problem = problems.get("spacecraft_slew")
    result = solve(problem)
    X = problem.rollout(result.trajectory.U).X
    assert result.success
    np.testing.assert_allclose(X[-1], [np.pi, 0.0, 0.0, 0.0], atol=1e-6)
    assert np.abs(X[:, 1]).max() == pytest.approx(0.025, abs=1e-6) and np.abs(X[:, 2]).max() <= np.radians(20.0)


def test_the_hand_ends_at_its_point_outside_of_the_disc():
    problem = problems.get("arm_obstacle")
    result = solve(problem)
    X = problem.rollout(result.trajectory.U).X
    points = arm_obstacle.hand(X)
    assert result.success and result.cost < arm_obstacle.OPTIMAL_COST * 1.01
    np.testing.assert_allclose(points[-1], [0.35, 0.75], atol=1e-6)
    assert (
        clearance(points, arm_obstacle.DISC) >= -1e-6 and (np.abs(X[:, :3]) <= np.add(arm_obstacle.RANGES, 1e-6)).all()
    )


def test_clearance_is_the_least_distance():
    points = np.array([[0.0, 0.0], [3.0, 4.0]])
    assert clearance(points, (0.0, 1.0, 0.25, 3.0, 4.0, 1.0)) == -1.0
    assert clearance(points[:1], (0.0, 1.0, 0.25, 3.0, 4.0, 1.0)) == 0.75


@pytest.mark.parametrize(
    "name, values, said",
    [
        ("car_obstacles", {"discs": (1.0, 2.0)}, "discs must hold x, y and radius of each obstacle, got 2 numbers"),
        ("reentry", {"variant": "thesys"}, "unknown variant 'thesys'; there are: thesis, tracking"),
        ("reentry", {"start": "third"}, "unknown start 'third'; there are: nominal, second"),
        ("bryson_denham", {"force": -1.0}, "force must"),
        ("hopper", {"stroke": -1.0}, "stroke must"),
    ],
)
def test_values_that_make_no_problem(name, values, said):
    with pytest.raises(ValueError, match=said):
        problems.get(name, **values)


# Robots, on MuJoCo


def recheck(problem, result):
    """States and sensor readings of a plain MuJoCo rollout of the result's policy, and its controls."""
    model, policy = problem.dynamics.model, result.policy
    data, dt = mujoco.MjData(model), float(np.min(problem.dynamics.dt))
    data.qpos[:], data.qvel[:] = problem.x0[: model.nq], problem.x0[model.nq :]
    X, Y, U = [], [], []
    for n in range(problem.horizon + 1):
        x = np.concatenate([data.qpos, data.qvel])
        if n < problem.horizon:
            data.ctrl[:] = policy(x, n * dt)
            U.append(data.ctrl.copy())
        mujoco.mj_forward(model, data)
        X.append(x)
        Y.append(data.sensordata.copy())
        if n < problem.horizon:
            mujoco.mj_step(model, data)
    return np.array(X), np.array(Y), np.array(U)


def check_panda(problem, result):
    assert result.success, result.message
    X, Y, U = recheck(problem, result)
    limits = problem.dynamics.model.jnt_range
    gaps = [problem.dynamics.output_names.index(f"{name}_gap") for name in ("hand", "forearm")]
    assert Y[:, gaps].min() >= 0.01 - 1e-6
    assert (X[:, :7] >= limits[:, 0] - 1e-6).all() and (X[:, :7] <= limits[:, 1] + 1e-6).all()
    assert (np.abs(U) <= problem.dynamics.control_limits[:, 1] + 1e-6).all()
    assert np.linalg.norm(Y[-1, :3] - [0.4, 0.3, 0.5]) < 0.005


@pytest.mark.parametrize("count", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_panda_round_the_ball_from_perturbed_starts(count):
    problem = problems.get("panda_obstacle")
    straight = solve(problems.get("panda_reach", horizon=100))
    Y = recheck(problem, straight)[1]
    assert Y[:, problem.dynamics.output_names.index("hand_gap")].min() < -0.01  # the ball is in the way
    rng, (low, high) = np.random.default_rng(0), problem.dynamics.model.jnt_range.T
    for _ in range(count):
        x0 = np.array(problem.x0)
        x0[:7] = np.clip(x0[:7] + rng.uniform(-0.15, 0.15, 7), low, high)
        moved = problem.at(x0)
        check_panda(moved, solve(moved, U0=mjslq.starts.hold(moved)))


@pytest.mark.parametrize("engine", ["mujoco", "function"])
def test_the_hopper_keeps_to_its_stroke_and_flow(engine):
    problem = problems.get("hopper", stroke=1.2, flow=30.0, engine=engine)
    result = solve(problem)
    again = problem.rollout(result.trajectory.U)
    assert result.success and 357.299 < result.cost < 400.0  # the best minimum known, among several
    assert np.abs(again.X[:, 1]).max() == pytest.approx(1.2, abs=1e-6) and np.abs(again.U).max() <= 30.0


def test_solo12_stands_up_with_weak_motors_and_does_not_slip():
    problem = problems.get("solo12_stand", torque=2.7, slip=0.004)
    result = solve(problem)
    X, Y, U = recheck(problem, result)
    assert result.success and np.abs(U).max() <= 2.7
    feet = Y.reshape(-1, 4, 3)[:, :, :2]
    assert np.abs(feet - feet[0]).max() == pytest.approx(0.004, abs=2e-6)
    assert abs(X[-1, 2] - 0.2384) < 0.01
    free = solve(problems.get("solo12_stand"))
    assert np.abs(free.trajectory.U).max() > 5.0  # both limits matter


# The comparison with other solvers


def test_the_peers_run_where_casadi_is_installed(capsys):
    names = runpy.run_path(str(ROOT / "demos" / "peers_constrained.py"))
    names["main"](1, ("bryson_denham",))
    said = capsys.readouterr().out
    if names["casadi"] is None:
        assert said == 'This comparison needs CasADi: pip install "mjslq[peers]".\n'
    else:
        assert said.count("1 of 1") == 3 and said.count("4.4493") == 6


def test_a_solve_that_is_cut_off_gives_its_latest_iterate_where_the_constraints_are_nearly_met():
    problem = problems.get("panda_obstacle")
    start = problem.rollout(problem.U0)
    result = mjslq.solve(problem, max_iterations=60)
    assert result.status.value == "max_iterations" and problem.violation(start) == 0.0
    seen = [problem.violation(iterate) for iterate in result.iterates]
    assert result.cost < 0.02 * problem.cost(start) and result.constraint_violation < 0.1 * max(seen)
    early = mjslq.solve(problem, max_iterations=5)  # far from meeting them: the start is better than that
    assert early.constraint_violation == 0.0
