"""SLQ: the paper's theorems, and the methods multiplied by problems."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_problems import DOUBLE_INTEGRATOR, PENDULUM, drag, linear, pendulum

import mjslq
from mjslq import FunctionDynamics, Problem, Status, costs, problems
from mjslq.options import SLQOptions
from mjslq.problems.drag_particle import OPTIMAL_COSTS
from mjslq.problems.hopper import phases
from mjslq.solvers.iterate import Iterate
from mjslq.solvers.linesearch import SEARCHES
from mjslq.solvers.merit import CostAndGaps
from mjslq.solvers.slq import SLQ

seeds = st.integers(0, 2**32 - 1)
solve = functools.partial(mjslq.solve, method="slq")


# Theorems 1 and 3


def random_nonlinear(seed):
    """A random smooth system, random tracking costs with per-step weights, and random controls."""
    rng = np.random.default_rng(seed)
    nx, nu, N = rng.integers(1, 5), rng.integers(1, 4), rng.integers(1, 9)
    A, B, C, D, E = (rng.standard_normal((nx, size)) / np.sqrt(size) for size in (nx, nu, nx, nu, nx))

    def f(x, u):
        return 0.7 * (A @ x) + B @ u + np.sin(C @ x + D @ u) + 0.1 * (E @ x) * x[0]

    root_Q, root_R = rng.standard_normal((N + 1, nx, nx)), rng.standard_normal((N, nu, nu)) + 2.0 * np.eye(nu)
    root_Q[:, :, 0] = 0.0  # semidefinite
    Q, R = root_Q.transpose(0, 2, 1) @ root_Q, root_R.transpose(0, 2, 1) @ root_R
    x_o, u_o = rng.standard_normal((N + 1, nx)), rng.standard_normal((N, nu))
    problem = Problem(
        FunctionDynamics(f, int(nx), int(nu), 1.0, integrator="map"), int(N), 0.5 * rng.standard_normal(nx),
        [costs.Tracking(Q[:N], R, Q[N], x_target=x_o, u_target=u_o)],
    )  # fmt: skip

    def residuals(U):
        """(49): all residuals as a function of the stacked controls, rolled out in a plain loop."""
        x, parts = problem.x0.astype(U.dtype), []
        for n in range(N):
            parts += [root_Q[n] @ (x - x_o[n]), root_R[n] @ (U[n] - u_o[n])]
            x = f(x, U[n])
        return np.concatenate([*parts, root_Q[N] @ (x - x_o[N])])

    return problem, 0.5 * rng.standard_normal((N, nu)), Q, R, residuals


def complex_jacobian(residuals, U):
    columns = []
    for i in range(U.size):
        probe = U.astype(complex)
        probe.flat[i] += 1e-30j
        columns.append(residuals(probe).imag / 1e-30)
    return np.stack(columns, axis=-1)


@given(seeds)
def test_theorem_1_the_direction_descends_by_identity_34(seed):
    problem, U, Q, R, _ = random_nonlinear(seed)
    here = Iterate(problem, problem.rollout(U))
    direction = SLQ(SLQOptions()).direction(here)
    slope = CostAndGaps().slope(here, direction)
    A, B, _, _ = here.linearization
    x, total = np.zeros(A.shape[1]), 0.0
    for n, u in enumerate(direction.U):  # (30)
        total += x @ Q[n] @ x + u @ R[n] @ u
        x = A[n] @ x + B[n] @ u
    total += x @ Q[-1] @ x
    assert slope == pytest.approx(-total, rel=1e-8)
    assert slope < 0.0
    assert direction.expected == pytest.approx(-0.5 * total, rel=1e-8)  # the model's minimum
    assert not direction.held.any() and not direction.limited and direction.multiplier == 0.0
    shorter = [Iterate(problem, problem.rollout(U + a * direction.U)).cost for a in 0.5 ** np.arange(30)]
    assert min(shorter) < here.cost


@given(seeds)
def test_theorem_3_the_direction_is_gauss_newtons(seed):
    problem, U, _, _, residuals = random_nonlinear(seed)
    here = Iterate(problem, problem.rollout(U))
    G, F = complex_jacobian(residuals, U), residuals(U)
    assert here.cost == pytest.approx(0.5 * F @ F, rel=1e-12)
    np.testing.assert_allclose(here.gradient.ravel(), G.T @ F, rtol=1e-9, atol=1e-11 * np.abs(G.T @ F).max())
    dense, ours = np.linalg.lstsq(G, -F)[0], SLQ(SLQOptions()).direction(here).U.ravel()
    np.testing.assert_allclose(ours, dense, rtol=1e-7, atol=1e-9 * np.abs(dense).max())


# Methods times problems


@pytest.mark.parametrize("step", ["open-loop", "closed-loop"])
@pytest.mark.parametrize("line_search", sorted(SEARCHES))
@pytest.mark.parametrize("make", [drag, linear, pendulum])
def test_every_search_converges_on_every_problem(make, line_search, step):
    problem = make()
    result = solve(problem, line_search=line_search, step=step)
    assert result.status is Status.CONVERGED and result.success, result.message
    reference = solve(problem)
    assert result.cost == pytest.approx(reference.cost, rel=1e-7)
    J = np.array([entry.cost for entry in result.log])
    assert (np.diff(J) <= 2e-8 * np.abs(J[:-1])).all()  # what the roundoff rule may let through
    assert np.linalg.norm(problem.gradient(result.trajectory)) == pytest.approx(result.gradient_norm)
    assert result.options["line_search"] == line_search and result.options["step"] == step


@pytest.mark.parametrize("beta, iterations", [(0.01, 9), (0.05, 16), (0.1, 20), (0.5, 27), (1.0, 46)])
def test_drag_particle_of_table_1(beta, iterations):
    result = solve(drag(beta))
    assert result.status is Status.CONVERGED, result.message
    assert result.iterations == iterations
    assert result.gradient_norm < 1e-6
    assert result.cost == pytest.approx(OPTIMAL_COSTS[beta], rel=2e-9)
    assert result.trajectory.X[-1, 0] == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize("engine", ["function", "mujoco"])
@pytest.mark.parametrize("height, most", [(1.0, 30), (5.0, 50), (10.0, 30), (20.0, 60), (30.0, 80), (50.0, 110)])
def test_hopper_reaches_every_height_of_the_paper(height, most, engine):
    result = solve(problems.get("hopper", height=height, engine=engine))
    assert result.status is Status.CONVERGED, result.message
    assert result.iterations <= most  # 3 at height 1 and 166 at height 50 in the paper, which steps open loop
    assert result.trajectory.X[-1, 0] == pytest.approx(height, rel=0.01)
    sequence = phases(result.trajectory.X)
    assert "stance flight stance" in " ".join(sequence) or "flight stance flight" in " ".join(sequence)
    assert sequence[-1] == "flight"
    assert result.gains.shape == (100, 1, result.trajectory.X.shape[1])


@settings(max_examples=10)
@given(seeds)
def test_linear_dynamics_take_one_step_to_the_dense_optimum(seed):
    rng = np.random.default_rng(seed)
    nx, nu, N = 3, 2, 10
    A, B = rng.standard_normal((nx, nx)) / 2.0, rng.standard_normal((nx, nu))
    dynamics = FunctionDynamics(lambda x, u: A @ x + B @ u, nx, nu, 1.0, integrator="map")
    x0, x_o, u_o = rng.standard_normal(nx), rng.standard_normal(nx), rng.standard_normal(nu)
    problem = Problem(dynamics, N, x0, [costs.Tracking(1.0, 0.5, 9.0, x_target=x_o, u_target=u_o)])
    result = solve(problem, U0=rng.standard_normal((N, nu)))
    S, s = np.zeros(((N + 1) * nx, N * nu)), np.concatenate([np.linalg.matrix_power(A, n) @ x0 for n in range(N + 1)])
    for n in range(N):
        for m in range(n + 1, N + 1):
            S[m * nx : (m + 1) * nx, n * nu : (n + 1) * nu] = np.linalg.matrix_power(A, m - n - 1) @ B
    root_Q, root_R = np.repeat([1.0] * N + [3.0], nx), np.sqrt(0.5)
    G = np.vstack([root_Q[:, None] * S, root_R * np.eye(N * nu)])
    F = np.concatenate([root_Q * (s - np.tile(x_o, N + 1)), -root_R * np.tile(u_o, N)])
    dense = np.linalg.lstsq(G, -F)[0]
    assert result.status is Status.CONVERGED and result.iterations == 1
    np.testing.assert_allclose(result.trajectory.U.ravel(), dense, rtol=1e-8, atol=1e-10)
    assert result.cost == pytest.approx(0.5 * np.sum((G @ dense + F) ** 2), rel=1e-12)


@pytest.mark.parametrize("make", [drag, linear, pendulum])
def test_at_an_optimum_there_is_nothing_to_do(make):
    problem = make()
    optimum = solve(problem)
    again = solve(problem, U0=optimum.trajectory.U)
    assert again.status is Status.CONVERGED and again.iterations <= 1
    assert again.cost == pytest.approx(optimum.cost, rel=1e-9)


def test_equal_solves_give_equal_results():
    first, second = solve(pendulum()), solve(pendulum())
    np.testing.assert_array_equal(first.trajectory.X, second.trajectory.X)
    np.testing.assert_array_equal(first.gains, second.gains)


def test_acceleration_only_ever_lowers_the_cost_and_can_be_switched_off():
    problem = problems.get("hopper", height=10.0, engine="function")
    with_it, without = solve(problem), solve(problem, acceleration=False, max_iterations=30)
    for result in (with_it, without):
        J = np.array([entry.cost for entry in result.log])
        assert (np.diff(J) <= 2e-8 * J[:-1]).all()
    assert with_it.options["acceleration"] is True and without.options["acceleration"] is False
    assert without.log[1].cost == with_it.log[1].cost  # nothing to go along before the second step


def test_indefinite_models_get_a_multiplier():
    """Without any cost on one control its Hessian is singular, and a minimizer needs help."""
    dynamics = FunctionDynamics(lambda x, u: np.stack([x[1], u[0] - np.sin(x[0])]), 2, 2, 0.1)
    problem = Problem(dynamics, 10, [0.0, 0.0], [costs.Function(lambda x, u, t: 0.5 * u[0] ** 2 + (x[0] - 1.0) ** 2)])
    result = solve(problem)
    assert result.log[0].multiplier > 0.0
    assert result.status is Status.CONVERGED
    assert not result.trajectory.U[:, 1].any()


# Gains


def test_gains_are_optimal_on_a_linear_system():
    """From another start, the closed loop is the optimum of the problem from there."""
    optimum = solve(linear())
    x0 = [1.4, -0.6]
    followed = DOUBLE_INTEGRATOR.rollout_feedback(optimum.trajectory, optimum.gains, np.zeros((20, 1)), x0=x0)
    problem = Problem(DOUBLE_INTEGRATOR, 20, x0, linear().costs)
    np.testing.assert_allclose(followed.U, solve(problem).trajectory.U, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("push", [(0.2, 0.0), (-0.2, 0.0), (0.0, 0.5), (0.0, -0.5)])
def test_gains_hold_a_pendulum_that_starts_elsewhere(push):
    optimum = solve(pendulum())
    problem = pendulum(x0=push)
    closed = PENDULUM.rollout_feedback(optimum.trajectory, optimum.gains, np.zeros((40, 1)), x0=push)
    best = solve(problem, U0=optimum.trajectory.U).cost
    assert best <= problem.cost(closed) < problem.cost(problem.rollout(optimum.trajectory.U))
    assert problem.cost(closed) < 1.1 * best
