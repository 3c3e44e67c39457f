"""The projection operator: its gradient under feedback, its second derivatives, limits, and gains that are watched."""

import numpy as np
import pytest
from small_problems import pendulum

import mjslq
from mjslq import costs
from mjslq.robots import robot_path
from mjslq.solvers.projection import Curve, CurveIterate, project
from mjslq.solvers.regulator import LOST, Regulator


def train():
    return mjslq.problems.get("cart_train", horizon=150, duration=3.0), None


def legged():
    """Solo12 on its feet, in contact."""
    return mjslq.problems.get("solo12_stand", horizon=25), None


def flying():
    """A floating base in Pinocchio, with a foot's position in the cost."""
    dynamics = mjslq.PinocchioDynamics.from_path(
        robot_path("solo12"), 0.01, floating_base=True, armature=0.02, outputs=("FL_FOOT",)
    )
    x0 = dynamics.initial_state
    terms = [costs.Control(0.1), costs.Sensor("FL_FOOT", [0.3, 0.2, 0.8], 10.0), costs.State(1.0, x0, "terminal")]
    U0 = 0.3 * np.random.default_rng(0).normal(size=(30, 12))
    return mjslq.Problem(dynamics, 30, x0, terms, U0=U0), (1.0, 0.1)


PROBLEMS = {"function": train, "mujoco": legged, "pinocchio": flying}


@pytest.fixture(scope="module", params=PROBLEMS)
def here(request):
    problem, weights = PROBLEMS[request.param]()
    return Regulator("lqr", weights).with_gains(CurveIterate(problem, problem.rollout(problem.U0), None))


def random_change(here, seed=0):
    rng = np.random.default_rng(seed)
    return Curve(rng.normal(size=here.slope.alpha.shape), rng.normal(size=here.slope.mu.shape))


def slope(here, change, e=2e-5):
    """Derivative of the cost of the projected curve, by differences of fourth order."""

    def central(h):
        ahead, behind = project(here, change, [h, -h])
        return (ahead.cost - behind.cost) / (2.0 * h)

    return (4.0 * central(0.5 * e) - central(e)) / 3.0


@pytest.mark.parametrize("seed", range(3))
def test_reduced_gradient_is_the_derivative_under_feedback(here, seed):
    change = random_change(here, seed)
    assert np.abs(here.K).max() > 0.1
    assert here.slope.dot(change) == pytest.approx(slope(here, change), rel=1e-8)
    assert here.slope.dot(change) == pytest.approx(float(np.vdot(here.gradient, here.feedforward(change))), rel=1e-10)


def test_trajectories_are_their_own_projections(here):
    zero = Curve(np.zeros_like(here.slope.alpha), np.zeros_like(here.slope.mu))
    (same,) = project(here, zero, [1.0])
    np.testing.assert_array_equal(same.trajectory.X, here.trajectory.X)
    np.testing.assert_array_equal(same.trajectory.U, here.trajectory.U)


def test_projection_is_the_tracking_controller(here):
    change, dynamics = random_change(here), here.problem.dynamics
    (there,) = project(here, change, [1e-2])
    alpha = dynamics.integrate(here.trajectory.X, 1e-2 * change.alpha)
    mu = here.trajectory.U + 1e-2 * change.mu
    for n in range(here.problem.horizon):
        error = -dynamics.difference(alpha[n], there.trajectory.X[n])
        u = here.problem.box.clip(mu)[n] if here.K is None else mu[n] + here.gains[n] @ error
        u = np.clip(u, here.problem.box.lower[n], here.problem.box.upper[n])
        np.testing.assert_allclose(there.trajectory.U[n], u, rtol=0, atol=1e-9 * max(1.0, np.abs(u).max()))
    replay = dynamics.rollout(here.problem.x0, there.trajectory.U)
    assert np.abs(replay.X[1] - there.trajectory.X[1]).max() < 1e-12


def test_second_derivatives_are_those_of_the_cost_of_the_projected_curve():
    """Along the linearized dynamics, where the trajectory is not stationary: (13)."""
    problem, weights = train()
    plain = CurveIterate(problem, problem.rollout(problem.U0), None)
    upright = Regulator("lqr", weights).with_gains(plain)
    leaning = np.zeros((problem.horizon + 1, 8))
    leaning[:, 1::4] = 0.6
    (here,) = project(upright, Curve(leaning, np.zeros((problem.horizon, 2))), [1.0])
    model = here.hamiltonian(here.costates)
    U = np.random.default_rng(0).normal(size=here.trajectory.U.shape)
    X = np.zeros_like(model.q)
    for n in range(len(U)):  # under feedback, so that states stay small
        U[n] -= here.K[n] @ X[n]
        X[n + 1] = model.A[n] @ X[n] + model.B[n] @ U[n]
    change, e = Curve(X, U), 1e-3
    ahead, behind = project(here, change, [e, -e])
    more, less = project(here, change, [2.0 * e, -2.0 * e])
    second = (16.0 * (ahead.cost + behind.cost) - (more.cost + less.cost) - 30.0 * here.cost) / (12.0 * e * e)
    linear = float(np.vdot(model.q, X) + np.vdot(model.r, U))
    assert 2.0 * (model.value(X, U) - linear) == pytest.approx(second, rel=1e-6)
    convex = here.gauss_newton
    assert abs(2.0 * (convex.value(X, U) - linear) / second - 1.0) > 1e-4  # which would not do


def test_feedback_keeps_costates_small_where_those_of_the_open_loop_grow():
    """Growth under A and under A - B K, over 8 s of an unstable train."""
    problem = mjslq.problems.get("cart_train")
    trajectory = problem.rollout(problem.U0)
    opened = CurveIterate(problem, trajectory, None)
    closed = Regulator("lqr", problem.options["regulator"]).with_gains(opened)
    assert np.abs(opened.costates).max() > 1e15 * np.abs(closed.costates).max()


def test_curves_without_gains_are_the_open_loop():
    problem = pendulum()
    here = CurveIterate(problem, problem.rollout(problem.U0), None)
    np.testing.assert_allclose(here.gradient, problem.gradient(here.trajectory), rtol=1e-12)
    change = random_change(here)
    (there,) = project(here, change, [0.1])
    np.testing.assert_allclose(there.trajectory.U, here.trajectory.U + 0.1 * change.mu, rtol=1e-14)


def test_held_controls_do_not_follow_the_feedback():
    """At a limit the gradient is one-sided: into the limits it is the derivative, against them it is projected."""
    problem = pendulum(bounds=mjslq.Bounds(u=(-6.0, 6.0)))
    U = np.where(np.arange(40)[:, None] % 3 == 0, 6.0, 0.5)
    here = Regulator("lqr", (1.0, 0.1)).with_gains(CurveIterate(problem, problem.rollout(U), None))
    held, at_limit = here.along.held, U == 6.0
    assert held.any() and (at_limit & ~held).any() and not (held & ~at_limit).any()
    assert not here.projected_gradient[held].any() and not here.gains[held].any()
    rng = np.random.default_rng(0)
    mu = rng.normal(size=U.shape)
    mu[held] = 0.0
    mu[at_limit & ~held] = -np.abs(mu[at_limit & ~held]) - 5.0  # inward, whatever the feedback adds
    change, e = Curve(np.zeros((41, 2)), mu), 1e-6
    ahead, more = project(here, change, [e, 2.0 * e])
    one_sided = (4.0 * ahead.cost - more.cost - 3.0 * here.cost) / (2.0 * e)
    assert here.slope.dot(change) == pytest.approx(one_sided, rel=1e-5)


# The regulator


def test_streamed_gains_are_those_of_one_sweep():
    problem, _ = train()
    here = CurveIterate(problem, problem.rollout(problem.U0), None)
    Q, R = np.diag(np.linspace(1.0, 2.0, 8)), 0.5 * np.eye(2)
    regulator = Regulator("lqr", (Q, R, 3.0 * Q))
    K = regulator.with_gains(here).K
    A, B, _, _ = here.linearization
    P = 3.0 * Q
    for n in reversed(range(problem.horizon)):
        G = R + B[n].T @ P @ B[n]
        np.testing.assert_allclose(K[n], np.linalg.solve(G, B[n].T @ P @ A[n]), rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(regulator.G[n], G, rtol=1e-8, atol=1e-10)
        F = A[n] - B[n] @ K[n]
        P = Q + K[n].T @ R @ K[n] + F.T @ P @ F


def test_gains_are_made_anew_when_they_do_not_stabilize():
    """Gains of a train upright do not hold it when their signs are wrong; good ones are kept."""
    problem = mjslq.problems.get("cart_train", horizon=150, duration=3.0)
    regulator = Regulator("lqr", problem.options["regulator"])
    here = regulator.with_gains(CurveIterate(problem, problem.rollout(problem.U0), None))
    assert regulator.watched(here) is here and regulator.made == 1
    assert regulator.renewed(here) is None  # they are of this trajectory
    bad = here.under(-here.K)
    mended = regulator.watched(bad)
    assert regulator.made == 2
    np.testing.assert_allclose(mended.K, here.K)
    assert np.abs(bad.costates).max() > LOST * np.abs(here.costates).max()
