"""The square-root sweep against the dense first-order conditions, differences, and the thesis's worked example."""

import doctest
import subprocess
import sys

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from square_root_problems import constrained, multipliers, random_lq, random_scale, trajectory, twin, verdict
from test_lq import random_problem, relative

from mjslq.lq import riccati, square_root
from mjslq.lq.problem import LQProblem
from mjslq.lq.square_root import PathRows, StateRows, factorize, solve

seeds = st.integers(0, 2**32 - 1)


def test_sweep_is_dense_first_order_conditions():
    errors, duals = [], []
    for seed in range(1000):
        problem = constrained(np.random.default_rng(seed))
        expected, z, duals_expected, condition = twin(*problem)
        ours, solution = verdict(*problem)
        if expected == "singular":
            continue
        assert ours == expected, seed
        if ours == "solved":
            errors.append(relative(trajectory(solution), z))
            assert solution.violation < 1e-9 * max(1.0, np.abs(trajectory(solution)).max()), seed
            assert errors[-1] < max(1e-8, 1e-16 * condition), seed
            if duals_expected is not None:
                duals.append(relative(multipliers(solution), duals_expected))
                assert duals[-1] < max(1e-8, 1e-16 * condition), seed
    assert len(errors) > 900 and len(duals) > 600
    assert np.median(errors) < 1e-13 and np.median(duals) < 1e-13


@pytest.mark.parametrize("nx, nu, N", [(14, 7, 20), (20, 3, 20), (3, 9, 20), (5, 2, 1), (1, 1, 1)])
@pytest.mark.parametrize("radius", [0.7, 1.3])
def test_sweep_is_dense_first_order_conditions_for_every_shape(nx, nu, N, radius):
    rng = np.random.default_rng(nx + N)
    lq = random_lq(rng, nx, nu, N, radius)
    m = N * min(2, nu)
    path = PathRows(
        rng.permutation(m) // min(2, nu), rng.standard_normal((m, nx)), rng.standard_normal((m, nu)),
        rng.standard_normal(m), random_scale(rng, m, 0.5),
    )  # fmt: skip
    ends = [StateRows(rng.standard_normal((1, nx)), rng.standard_normal(1), np.zeros(1)) for _ in range(2)]
    if nu * N < 3:  # too few controls for both a path row and a terminal row
        path = PathRows(np.zeros(0, int), np.zeros((0, nx)), np.zeros((0, nu)), np.zeros(0), np.zeros(0))
    expected, z, duals, _ = twin(lq, path, *ends)
    assert expected == "solved"
    solution = solve(lq, path, *ends)
    assert relative(trajectory(solution), z) < 1e-9 and relative(multipliers(solution), duals) < 1e-9


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("dt", [1e-1, 1e-2, 1e-3])
def test_rest_to_rest_of_integrator_chains(order, dt):
    """Controls reach the last states with dt^order only, 1e-12 and less; the twin is posed in units where dt is one."""
    N, chain = 100, np.diag(np.ones(order), 1)
    zeros, step, unit = np.zeros, scipy.linalg.expm(dt * chain), scipy.linalg.expm(chain)
    lq = LQProblem(
        A=np.tile(step[:order, :order], (N, 1, 1)), B=np.tile(step[:order, order:], (N, 1, 1)), c=zeros((N, order)),
        Q=zeros((N + 1, order, order)), R=np.full((N, 1, 1), dt), M=zeros((N, 1, order)), q=zeros((N + 1, order)),
        r=zeros((N, 1)),
    )  # fmt: skip
    goal = np.eye(order)[0]
    solution = solve(lq, None, StateRows(np.eye(order), goal))
    reach = np.empty((order, N))
    reach[:, N - 1] = unit[:order, order]
    for n in range(N - 2, -1, -1):
        reach[:, n] = unit[:order, :order] @ reach[:, n + 1]
    size = np.linalg.norm(reach, axis=1)
    Q, upper = np.linalg.qr((reach / size[:, None]).T)
    u = Q @ np.linalg.solve(upper.T, goal * dt**-order / size)
    assert relative(solution.U[:, 0], u) < 1e-10 and solution.violation < 1e-13
    x = np.zeros(order)
    for n in range(N):
        x = lq.A[n] @ x + lq.B[n] @ (solution.k[n] - solution.K[n] @ x)
    np.testing.assert_allclose(x, goal, atol=1e-13)


@pytest.mark.parametrize("seed", range(15))
def test_rows_behind_dynamics_that_forget_do_not_spoil_others(seed):
    """Offsets carried back grow by 50 a step, and so does rounding in them."""
    rng = np.random.default_rng(seed)
    nx, nu, N = 2, 1, 9
    A = 0.02 * np.array([np.linalg.qr(rng.standard_normal((nx, nx)))[0] for _ in range(N)])
    A[1] = 0.0
    lq = random_lq(rng, nx, nu, N, 1.0)._replace(A=A)
    U, H, C = rng.standard_normal((N, nu)), rng.standard_normal((N, nx)), rng.standard_normal((N, nu))
    X, E = lq.states(U), rng.standard_normal((1, nx))
    path = PathRows(np.arange(N), H, C, (H * X[:N]).sum(axis=1) + (C * U).sum(axis=1), np.zeros(N))
    terminal = StateRows(E, E @ X[N], np.zeros(1))
    expected, z, _, _ = twin(lq, path, terminal, np.zeros(nx))
    assert expected == "solved"
    assert relative(trajectory(solve(lq, path, terminal)), z) < 1e-12


# The thesis's example


@pytest.mark.parametrize("a, b, c, d", [(0.0, 0.3, 1.0, 0.2), (-1.0, 2.0, 0.5, 3.0)])
def test_example_of_section_3_6(a, b, c, d):
    lq = LQProblem(
        A=np.tile([[1.0, 1.0], [0.0, 1.0]], (2, 1, 1)), B=np.tile([[0.5], [1.0]], (2, 1, 1)), c=np.zeros((2, 2)),
        Q=np.zeros((3, 2, 2)), R=np.ones((2, 1, 1)), M=np.zeros((2, 1, 2)), q=np.zeros((3, 2)), r=np.zeros((2, 1)),
    )  # fmt: skip
    solution = solve(
        lq,
        PathRows([1, 1], [[1.0, 0.0], [0.0, 0.0]], [[0.0], [1.0]], [b, d]),
        StateRows([[1.0, 0.0]], [c]),
        StateRows([[1.0, 0.0]], [a]),
    )
    u = -(d - 2 * c) - 4 * b + 2 * a  # (3.147)
    x = [0.5 * (d - 2 * c) + 3 * b - 2 * a, -0.5 * (d - 2 * c) - b, -0.5 * (d - 2 * c) - b + d]  # (3.146), (3.148)
    exactly = {"rtol": 1e-14, "atol": 1e-14}
    np.testing.assert_allclose(solution.U.ravel(), [u, d], **exactly)
    np.testing.assert_allclose(solution.X, np.transpose([[a, b, c], x]), **exactly)
    np.testing.assert_allclose(solution.cost, 0.5 * (u**2 + d**2), **exactly)
    np.testing.assert_allclose(solution.mu, [4 * u, u - d], **exactly)
    np.testing.assert_allclose(solution.nu_terminal, [-2 * u], **exactly)
    np.testing.assert_allclose(solution.nu_initial, [-2 * u], **exactly)


def test_docstring_runs():
    result = doctest.testmod(square_root)
    assert result.attempted > 10 and result.failed == 0


def test_public_after_importing_the_package_which_stays_light():
    code = (
        "import sys, mjslq\nassert 'numba' not in sys.modules and 'numpy' not in sys.modules\n"
        "assert callable(mjslq.lq.square_root.solve)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# Without rows, and with weighted ones


@given(st.tuples(st.integers(1, 8), st.integers(1, 6), st.integers(1, 12)), seeds)
def test_without_rows_it_is_the_riccati_sweep(size, seed):
    lq, _ = random_problem(np.random.default_rng(seed), *size)
    expected, ours = riccati.solve(lq, refinements=1), solve(lq)
    assert relative(trajectory(ours), trajectory(expected)) < 1e-9
    assert relative(ours.costates, expected.costates) < 1e-9
    assert relative(ours.K, expected.K) < 1e-7 and relative(ours.k, expected.k) < 1e-7
    P = ours.to_go.W.transpose(0, 2, 1) @ ours.to_go.W
    assert relative(P, expected.P) < 1e-9 and relative(ours.to_go.p, expected.p) < 1e-7
    assert not ours.to_go.E.size
    np.testing.assert_allclose(ours.cost, lq.value(expected.X, expected.U), rtol=1e-8, atol=1e-8)


@given(seeds)
def test_weighted_rows_are_weights(seed):
    rng = np.random.default_rng(seed)
    nx, nu, N = 4, 2, 6
    lq = random_lq(rng, nx, nu, N, 1.1)
    H, C, d, s = (rng.standard_normal(shape) for shape in ((N, nx), (N, nu), (N,), (N,)))
    s = np.exp(s)
    E, e = rng.standard_normal((2, nx)), rng.standard_normal(2)
    Q, R, M, q, r = (array.copy() for array in (lq.Q, lq.R, lq.M, lq.q, lq.r))
    Q[:N] += np.einsum("ni,nj,n->nij", H, H, 1 / s)
    R += np.einsum("ni,nj,n->nij", C, C, 1 / s)
    M += np.einsum("ni,nj,n->nij", C, H, 1 / s)
    q[:N] -= H * (d / s)[:, None]
    r -= C * (d / s)[:, None]
    Q[N] += E.T @ E / 0.1
    q[N] -= E.T @ e / 0.1
    ours = solve(lq, PathRows(np.arange(N), H, C, d, s), StateRows(E, e, [0.1, 0.1]))
    expected = solve(lq._replace(Q=Q, R=R, M=M, q=q, r=r))
    assert relative(trajectory(ours), trajectory(expected)) < 1e-8
    assert relative(ours.K, expected.K) < 1e-7
    constant = 0.5 * (d**2 / s).sum() + 0.5 * e @ e / 0.1
    np.testing.assert_allclose(ours.cost, expected.cost + constant, rtol=1e-8, atol=1e-8)
    rest = (H * ours.X[:N]).sum(axis=1) + (C * ours.U).sum(axis=1) - d
    np.testing.assert_allclose(ours.mu, rest / s, rtol=1e-7, atol=1e-7)


def test_weighted_rows_become_hard_as_the_scale_factor_vanishes():
    rng = np.random.default_rng(3)
    lq = random_lq(rng, 5, 2, 20, 1.2)
    path = PathRows(np.arange(20), rng.standard_normal((20, 5)), rng.standard_normal((20, 2)), rng.standard_normal(20))
    hard = solve(lq, path)
    errors = []
    for scale in (1e-6, 1e-8, 1e-10, 1e-15):
        soft = solve(lq, path._replace(scale=np.full(20, scale)))
        errors.append([relative(trajectory(soft), trajectory(hard)), relative(soft.mu, hard.mu)])
    ratios = np.divide(errors[1:3], errors[:2])
    np.testing.assert_allclose(ratios, 0.01, rtol=0.1)
    assert np.max(errors[3]) < 1e-9


@given(seeds, st.sampled_from([1.0, 1e3, 1e6]))
def test_weights_ten_orders_apart(seed, terminal):
    lq, _ = random_problem(np.random.default_rng(seed), 6, 2, 15, control=1e-4, terminal=terminal)
    path = PathRows(np.zeros(0, int), np.zeros((0, 6)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    none = StateRows(np.zeros((0, 6)), np.zeros(0), np.zeros(0))
    _, z, _, condition = twin(lq, path, none, np.zeros(6))
    assert relative(trajectory(solve(lq)), z) < max(1e-9, 1e-18 * condition)


def test_a_mayer_cost_needs_no_state_weights():
    rng = np.random.default_rng(0)
    nx, nu, N = 4, 2, 10
    lq = random_lq(rng, nx, nu, N, 1.0)._replace(
        Q=np.zeros((N + 1, nx, nx)), R=np.tile(np.eye(nu), (N, 1, 1)), M=np.zeros((N, nu, nx)),
        q=np.concatenate([np.zeros((N, nx)), rng.standard_normal((1, nx))]), r=np.zeros((N, nu)),
    )  # fmt: skip
    costate, solution = lq.q[N], solve(lq)
    for n in range(N - 1, -1, -1):
        np.testing.assert_allclose(solution.U[n], -lq.B[n].T @ costate, atol=1e-12)
        costate = lq.A[n].T @ costate


def test_singular_control_weights_where_later_costs_determine_the_controls():
    """R is singular, with cross terms, so that stage weights take the pivoted factorization."""
    rng = np.random.default_rng(1)
    nx, nu, N = 5, 3, 8
    W = rng.standard_normal((N, 4, nx + nu))
    W[:, :, -1] = W[:, :, -2] - W[:, :, -3]
    H = W.transpose(0, 2, 1) @ W
    lq = random_lq(rng, nx, nu, N, 1.0)._replace(
        Q=np.concatenate([H[:, :nx, :nx], [np.eye(nx)]]), R=H[:, nx:, nx:].copy(), M=H[:, nx:, :nx].copy(),
        q=np.zeros((N + 1, nx)), r=np.zeros((N, nu)),
    )  # fmt: skip
    expected, ours = riccati.solve(lq, refinements=3), solve(lq)
    assert relative(trajectory(ours), trajectory(expected)) < 1e-8


# Feedback


@pytest.mark.parametrize("seed", range(6))
def test_closed_loop_meets_the_terminal_rows_on_unstable_dynamics(seed):
    rng = np.random.default_rng(seed)
    nx, nu, N = 6, 2, 200
    A = np.array([1.3 * np.linalg.qr(rng.standard_normal((nx, nx)))[0] for _ in range(N)])
    zeros = np.zeros
    lq = LQProblem(
        A=A, B=rng.standard_normal((N, nx, nu)), c=0.1 * rng.standard_normal((N, nx)), Q=zeros((N + 1, nx, nx)),
        R=np.tile(np.eye(nu), (N, 1, 1)), M=zeros((N, nu, nx)), q=zeros((N + 1, nx)), r=zeros((N, nu)),
    )  # fmt: skip
    path = None
    if seed % 2:
        m = 40
        path = PathRows(
            np.sort(rng.choice(N - 10, m, replace=False)), rng.standard_normal((m, nx)), rng.standard_normal((m, nu)),
            rng.standard_normal(m),
        )  # fmt: skip
    terminal = StateRows(np.linalg.qr(rng.standard_normal((nx, nx)))[0], rng.standard_normal(nx))
    solution = solve(lq, path, terminal, rng.standard_normal(nx))
    x = solution.X[0]
    for n in range(N):
        x = lq.A[n] @ x + lq.B[n] @ (solution.k[n] - solution.K[n] @ x) + lq.c[n]
    assert np.abs(terminal.H @ x - terminal.d).max() <= 1e-12


def test_feedback_is_optimal_from_every_state():
    """From another initial state the gains give what a new solution gives, and the cost-to-go its cost."""
    rng = np.random.default_rng(7)
    nx, nu, N = 5, 2, 15
    lq = random_lq(rng, nx, nu, N, 1.1)
    path = PathRows(np.arange(2, N), rng.standard_normal((N - 2, nx)), rng.standard_normal((N - 2, nu)), np.ones(N - 2))
    terminal = StateRows(rng.standard_normal((2, nx)), rng.standard_normal(2))
    first, other = solve(lq, path, terminal), solve(lq, path, terminal, rng.standard_normal(nx))
    np.testing.assert_allclose(first.K, other.K, atol=1e-9)
    X, U = [other.X[0]], []
    for n in range(N):
        U.append(first.k[n] - first.K[n] @ X[n])
        X.append(lq.A[n] @ X[n] + lq.B[n] @ U[n] + lq.c[n])
    np.testing.assert_allclose(X, other.X, atol=1e-8)
    W, p, E, v, _ = first.to_go

    def to_go(x):
        return 0.5 * np.sum((W[0] @ x) ** 2) + p[0] @ x

    np.testing.assert_allclose(to_go(other.X[0]) - to_go(first.X[0]), other.cost - first.cost, rtol=1e-9)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", E, other.X) + other.to_go.v, 0.0, atol=1e-9)
    np.testing.assert_allclose(v, other.to_go.v, atol=1e-9)


# Multipliers are sensitivities


def test_multipliers_are_the_derivatives_of_the_cost():
    """J is quadratic in the right-hand sides, so that centred differences are exact but for rounding."""
    rng = np.random.default_rng(11)
    nx, nu, N, m = 5, 3, 10, 14
    lq = random_lq(rng, nx, nu, N, 1.1)
    path = PathRows(
        rng.integers(0, N, m), rng.standard_normal((m, nx)), rng.standard_normal((m, nu)), rng.standard_normal(m),
        np.where(np.arange(m) % 4 == 0, 0.3, 0.0),
    )  # fmt: skip
    terminal, first = (
        StateRows(rng.standard_normal((3, nx)), rng.standard_normal(3), np.array([0.0, 0.0, 0.5])) for _ in range(2)
    )
    factorization = factorize(lq, path, terminal, first)
    solution, start = factorization.solve(), factorize(lq, path, terminal, rng.standard_normal(nx))
    given = start.solve()

    def difference(solve, name, d):
        eye = np.eye(len(d))
        return np.array([solve(**{name: d + e}).cost - solve(**{name: d - e}).cost for e in eye]) / 2

    close = {"rtol": 1e-8, "atol": 1e-8}
    np.testing.assert_allclose(solution.mu, -difference(factorization.solve, "path", path.d), **close)
    np.testing.assert_allclose(solution.nu_terminal, -difference(factorization.solve, "terminal", terminal.d), **close)
    np.testing.assert_allclose(solution.nu_initial, -difference(factorization.solve, "initial", first.d), **close)
    np.testing.assert_allclose(given.costates[0], difference(start.solve, "initial", given.X[0]), **close)
    np.testing.assert_allclose(given.nu_initial, -given.costates[0])
    np.testing.assert_allclose(solution.costates[0], -first.H.T @ solution.nu_initial, **close)  # (2.50)

    def by_gap(n, j):
        c = lq.c.copy()
        costs = []
        for sign in (1.0, -1.0):
            c[n, j] = lq.c[n, j] + sign
            costs.append(factorization.solve(c=c).cost)
        return 0.5 * (costs[0] - costs[1])

    gaps = [[by_gap(n, j) for j in range(nx)] for n in range(N)]
    np.testing.assert_allclose(solution.costates[1:], gaps, **close)  # (3.99)


def test_v_costates_make_up_the_costates():
    """(3.103): lambda_n = W_n'W_n x_n + p_n + E_n'psi_n; at N the carried rows are the terminal ones, transformed."""
    rng = np.random.default_rng(5)
    nx, nu, N = 6, 1, 12
    lq = random_lq(rng, nx, nu, N, 1.1)
    path = PathRows([1, 4, 4], rng.standard_normal((3, nx)), None, rng.standard_normal(3))
    terminal = StateRows(rng.standard_normal((4, nx)), np.ones(4))
    solution = solve(lq, path, terminal)
    W, p, E, v, psi = solution.to_go
    assert [np.count_nonzero(rows.any(axis=1)) for rows in E[8:]] == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(E[N].T @ psi[N], terminal.H.T @ solution.nu_terminal, rtol=1e-8, atol=1e-8)
    again = np.einsum("nki,nkj,nj->ni", W, W, solution.X) + p + np.einsum("nki,nk->ni", E, psi)
    np.testing.assert_allclose(again, solution.costates, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(np.einsum("nki,ni->nk", E, solution.X) + v, 0.0, atol=1e-8)


def test_kernels_from_the_cache_of_another_process_run():
    """BLAS's product is found there, too: large enough stages call it."""
    code = """
import numpy as np
from mjslq.lq.problem import LQProblem
from mjslq.lq.square_root import solve
N, nx, nu = 3, 8, 3
rng = np.random.default_rng(0)
zero = np.zeros
lq = LQProblem(rng.standard_normal((N, nx, nx)), rng.standard_normal((N, nx, nu)), np.tile(np.eye(nx), (N + 1, 1, 1)),
               np.tile(np.eye(nu), (N, 1, 1)), zero((N, nu, nx)), zero((N + 1, nx)), zero((N, nu)), zero((N, nx)))
print(solve(lq, initial=np.ones(nx)).cost)
"""
    outcomes = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True) for _ in range(2)]
    assert [outcome.returncode for outcome in outcomes] == [0, 0], outcomes[-1].stderr
    assert outcomes[0].stdout == outcomes[1].stdout
