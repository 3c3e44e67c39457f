"""The square-root sweep against the dense first-order conditions, differences, and the thesis's worked example."""

import doctest
import subprocess
import sys

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from test_lq import random_problem, relative

from mjslq.lq import householder, riccati, square_root
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.square_root import Infeasible, PathRows, StateRows, Unbounded, factorize, solve

seeds = st.integers(0, 2**32 - 1)


def random_lq(rng, nx, nu, N, radius):
    """Dynamics of a spectral radius, singular now and then; weights of any rank, those of the controls definite."""
    A = rng.standard_normal((N, nx, nx))
    A *= radius / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    if rng.random() < 0.2:
        A[:, :, 0] = 0.0
    if rng.random() < 0.1:
        A[rng.integers(N)] = 0.0
    rank = int(rng.integers(0, nx + nu)) if rng.random() < 0.3 else nx + nu
    W = rng.standard_normal((N, rank, nx + nu))
    H = W.transpose(0, 2, 1) @ W
    H[:, nx:, nx:] += rng.choice([0.1, 1.0]) * np.eye(nu)
    W_end = rng.standard_normal((rng.integers(0, nx + 1), nx))
    return LQProblem(
        A=A, B=rng.standard_normal((N, nx, nu)), c=rng.standard_normal((N, nx)),
        Q=np.concatenate([H[:, :nx, :nx], [W_end.T @ W_end]]), R=H[:, nx:, nx:].copy(), M=H[:, nx:, :nx].copy(),
        q=rng.standard_normal((N + 1, nx)), r=rng.standard_normal((N, nu)),
    )  # fmt: skip


def random_scale(rng, m, share):
    return np.where(rng.random(m) < share, 10.0 ** rng.uniform(-4, 1, m), 0.0)


def constrained(rng, nx=None, nu=None, N=None, radius=None):
    """An LQ problem with rows of all kinds, some depending on others, some contradicting."""
    nx, nu, N = nx or int(rng.integers(1, 7)), nu or int(rng.integers(1, 5)), N or int(rng.integers(1, 13))
    lq = random_lq(rng, nx, nu, N, radius or rng.uniform(0.3, 1.3))
    X, U = np.empty((N + 1, nx)), rng.standard_normal((N, nu))
    X[0] = rng.standard_normal(nx)
    for n in range(N):
        X[n + 1] = lq.A[n] @ X[n] + lq.B[n] @ U[n] + lq.c[n]
    m = int(rng.integers(0, 2 + N * max(1, nu // 2 + rng.integers(0, 2)))) if rng.random() < 0.8 else 0
    step, kind = rng.integers(0, N, m), rng.random(m)
    H, C = rng.standard_normal((m, nx)), rng.standard_normal((m, nu))
    C[kind < 0.2], H[(kind > 0.2) & (kind < 0.4)] = 0.0, 0.0
    if m > 1 and rng.random() < 0.3:
        step[1], H[1], C[1] = step[0], -2.0 * H[0], -2.0 * C[0]
    E = rng.standard_normal((int(rng.integers(0, nx + 1)), nx))
    if len(E) > 1 and rng.random() < 0.2:
        E[1] = 0.5 * E[0]
    d, d_end = (H * X[step]).sum(axis=1) + (C * U[step]).sum(axis=1), E @ X[N]
    if rng.random() < 0.3:
        d = d + (rng.random(m) < 0.3) * rng.standard_normal(m)
        d_end = d_end + (rng.random(len(E)) < 0.3) * rng.standard_normal(len(E))
    E_0 = rng.standard_normal((int(rng.integers(1, nx + 1)), nx))
    initial = [X[0], "free", StateRows(E_0, E_0 @ X[0], random_scale(rng, len(E_0), 0.15))][rng.integers(3)]
    path = PathRows(step, H, C, d, random_scale(rng, m, 0.2))
    return lq, path, StateRows(E, d_end, random_scale(rng, len(E), 0.15)), initial


# The slow twin


def initial_rows(initial, nx):
    if isinstance(initial, StateRows):
        return initial.H, initial.d, np.zeros(len(initial.d)) if initial.scale is None else initial.scale
    free = isinstance(initial, str)
    return np.eye(nx)[: 0 if free else nx], np.zeros(0) if free else initial, np.zeros(0 if free else nx)


def dense(lq, path, terminal, initial):
    """H, h of the cost in z = (x_0, ..., x_N, u_0, ...), and J z = b with scale factors s: dynamics, path, ends."""
    (N, nx, nu), n_x = lq.B.shape, lq.q.size
    H, h = np.zeros((n_x + N * nu, n_x + N * nu)), np.concatenate([lq.q.ravel(), lq.r.ravel()])
    at_x = [slice(n * nx, (n + 1) * nx) for n in range(N + 1)]
    at_u = [slice(n_x + n * nu, n_x + (n + 1) * nu) for n in range(N)]
    J, b = [], [*(-lq.c.ravel())]
    for n in range(N):
        H[at_u[n], at_u[n]], H[at_u[n], at_x[n]], H[at_x[n], at_u[n]] = lq.R[n], lq.M[n], lq.M[n].T
        block = np.zeros((nx, len(h)))
        block[:, at_x[n]], block[:, at_u[n]], block[:, at_x[n + 1]] = lq.A[n], lq.B[n], -np.eye(nx)
        J += [*block]
    for n in range(N + 1):
        H[at_x[n], at_x[n]] = lq.Q[n]

    def add(rows, n, C=None):
        block = np.zeros((len(rows), len(h)))
        block[:, at_x[n]] = rows
        if C is not None:
            block[:, at_u[n]] = C
        J.extend(block)

    for i, n in enumerate(path.step):
        add(path.H[[i]], n, path.C[[i]])
    E_0, d_0, s_0 = initial_rows(initial, nx)
    add(terminal.H, N)
    add(E_0, 0)
    s = np.concatenate([np.zeros(N * nx), path.scale, terminal.scale, s_0])
    return H, h, np.array(J), np.concatenate([b, path.d, terminal.d, d_0]), s


def twin(lq, path, terminal, initial):
    """Verdict, z, multipliers (None where rows are dependent) and condition, refined in extended precision."""
    H, h, J, b, s = dense(lq, path, terminal, initial)
    hard = s == 0.0
    z, _, rank, _ = np.linalg.lstsq(J[hard], b[hard], rcond=1e-11)
    if np.abs(J[hard] @ z - b[hard]).max(initial=0.0) > 1e-7:
        return "infeasible", None, None, np.inf
    independent = np.sort(scipy.linalg.qr(J[hard].T, pivoting=True, mode="r")[1][:rank])
    keep = np.sort(np.concatenate([np.flatnonzero(hard)[independent], np.flatnonzero(~hard)]))
    K, side = np.block([[H, J[keep].T], [J[keep], -np.diag(s[keep])]]), np.concatenate([-h, b[keep]])
    condition = np.linalg.cond(K)
    if not condition < 1e13:
        return "singular", None, None, condition
    factors, found, extended = scipy.linalg.lu_factor(K), np.zeros(len(side)), K.astype(np.longdouble)
    for _ in range(4):
        found = found + scipy.linalg.lu_solve(factors, (side - extended @ found).astype(float))
    return "solved", found[: len(h)], found[len(h) :] if len(keep) == len(b) else None, condition


def verdict(lq, path, terminal, initial):
    try:
        return "solved", solve(lq, path, terminal, initial)
    except Infeasible as error:
        return "infeasible", error
    except Unbounded as error:
        return "singular", error


def trajectory(solution):
    return np.concatenate([solution.X.ravel(), solution.U.ravel()])


def multipliers(solution):
    """In the order of the rows of the twin."""
    return np.concatenate([solution.costates[1:].ravel(), solution.mu, solution.nu_terminal, solution.nu_initial])


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


# Other right-hand sides


@given(seeds)
@settings(max_examples=30)
def test_solving_again_is_solving_anew(seed):
    rng = np.random.default_rng(seed)
    nx, nu, N, m = 4, 3, 9, 12
    lq = random_lq(rng, nx, nu, N, 1.0)
    H, C, step = rng.standard_normal((m, nx)), rng.standard_normal((m, nu)), rng.integers(0, N // 2, m) * 2
    step = np.minimum(np.arange(m) * N // m, N - 1)
    scale = random_scale(rng, m, 0.3)
    E, E_0 = rng.standard_normal((2, 2, nx))
    old, new = rng.standard_normal((2, m)), rng.standard_normal((2, m))
    first = factorize(lq, PathRows(step, H, C, old[0], scale), StateRows(E, old[1][:2]), StateRows(E_0, old[1][2:4]))
    other = lq._replace(q=2.0 * lq.q, r=lq.r + 1.0, c=-lq.c)
    again = first.solve(
        path=new[0], terminal=new[1][:2], initial=new[1][2:4], q=other.q, r=other.r, c=other.c, refinements=1
    )
    anew = solve(
        other, PathRows(step, H, C, new[0], scale), StateRows(E, new[1][:2]), StateRows(E_0, new[1][2:4]), refinements=1
    )
    for one, two in zip(again._replace(to_go=()), anew._replace(to_go=()), strict=True):
        np.testing.assert_array_equal(one, two)


def test_smaller_percentages_of_all_right_sides_scale_the_solution():
    """(2.41): with no linear terms the solution is proportional to Delta."""
    rng = np.random.default_rng(2)
    lq = random_lq(rng, 4, 2, 12, 1.1)
    lq = lq._replace(q=0.0 * lq.q, r=0.0 * lq.r, c=0.0 * lq.c)
    path = PathRows([2, 5, 7], rng.standard_normal((3, 4)), rng.standard_normal((3, 2)), [1.0, -2.0, 0.5])
    factorization = factorize(lq, path, StateRows(np.eye(4)[:2], [1.0, 2.0]))
    whole = factorization.solve()
    half = factorization.solve(path=np.multiply(0.5, path.d), terminal=[0.5, 1.0])
    np.testing.assert_allclose(half.U, 0.5 * whole.U, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(half.cost, 0.25 * whole.cost, rtol=1e-10)


# Dependent rows and contradictions


def combination(problem, error):
    """Left and right side of the combination that `error` names, the dynamics taken out by least squares."""
    lq, path, terminal, _ = problem
    _, _, J, b, _ = dense(*problem)
    dynamics, m = lq.c.size, len(path.d)
    place = {"path": dynamics, "terminal": dynamics + m, "initial": dynamics + m + len(terminal.d)}
    rows = [place[row.kind] + row.number for row in error.rows]
    left, right = error.multipliers @ J[rows], error.multipliers @ b[rows]
    y = np.linalg.lstsq(J[:dynamics].T, -left, rcond=None)[0]
    return left + J[:dynamics].T @ y, right + b[:dynamics] @ y, np.abs(error.multipliers).max()


def test_contradictions_are_proved():
    """The rows named add up to zero on the left and to something else on the right."""
    proved = 0
    for seed in range(1000):
        problem = constrained(np.random.default_rng(seed))
        ours, error = verdict(*problem)
        if ours == "infeasible":
            left, right, size = combination(problem, error)
            assert np.abs(left).max() < 1e-5 * size and abs(right) > 1e-7 * size, seed
            proved += 1
    assert proved > 30


def double_integrator(N):
    zeros = np.zeros
    return LQProblem(
        A=np.tile([[1.0, 1.0], [0.0, 1.0]], (N, 1, 1)), B=np.tile([[0.5], [1.0]], (N, 1, 1)), c=zeros((N, 2)),
        Q=zeros((N + 1, 2, 2)), R=np.ones((N, 1, 1)), M=zeros((N, 1, 2)), q=zeros((N + 1, 2)), r=zeros((N, 1)),
    )  # fmt: skip


def names(error):
    return {(row.kind, row.number, row.step) for row in error.value.rows}


def test_contradicting_rows_are_named():
    lq, position = double_integrator(6), [1.0, 0.0]
    # another row (step 1) and the terminal row do not take part
    path = PathRows([4, 1, 4], [position, position, position], None, [1.0, 5.0, 2.0])
    with pytest.raises(Infeasible, match=r"from step 4 on.*path row 0 \(step 4\), path row 2 \(step 4\)$") as error:
        solve(lq, path, StateRows([position], [0.0]), "free")
    assert error.value.step == 4 and names(error) == {("path", 0, 4), ("path", 2, 4)}
    # x_0 = 0 fixes x_1 in position by u_0 = 0
    path = PathRows([0, 1], [[0.0, 0.0], position], [[1.0], [0.0]], [0.0, 1.0])
    with pytest.raises(Infeasible) as error:
        solve(lq, path)
    taking_part = {("path", 0, 0), ("path", 1, 1), ("initial", 0, 0), ("initial", 1, 0)}
    assert names(error) == taking_part
    # the same on a manifold, and terminal rows against each other
    with pytest.raises(Infeasible) as error:
        solve(lq, path, None, StateRows(np.eye(2), [0.0, 0.0]))
    assert names(error) == taking_part
    with pytest.raises(Infeasible) as error:
        solve(lq, None, StateRows([[1.0, 1.0], [2.0, 2.0]], [1.0, 1.0]))
    assert error.value.step == 6 and names(error) == {("terminal", 0, 6), ("terminal", 1, 6)}


def test_a_row_without_coefficients():
    lq = double_integrator(3)
    nothing = PathRows([1], [[0.0, 0.0]], [[0.0]], [0.0])
    np.testing.assert_array_equal(solve(lq, nothing).U, 0.0)
    with pytest.raises(Infeasible) as error:
        solve(lq, nothing._replace(d=[1e-3]))
    assert names(error) == {("path", 0, 1)}


def test_dependent_rows_that_agree_are_dropped():
    rng = np.random.default_rng(4)
    lq = random_lq(rng, 4, 2, 10, 1.2)
    H, C, d = rng.standard_normal((3, 4)), rng.standard_normal((3, 2)), rng.standard_normal(3)
    once = solve(lq, PathRows([2, 4, 6], H, C, d))
    twice = solve(lq, PathRows([2, 4, 6, 6, 2], [*H, 3 * H[2], -H[0]], [*C, 3 * C[2], -C[0]], [*d, 3 * d[2], -d[0]]))
    np.testing.assert_allclose(twice.X, once.X, atol=1e-10)
    np.testing.assert_allclose(twice.costates, once.costates, atol=1e-9)
    np.testing.assert_allclose(twice.mu[2] + 3 * twice.mu[3], once.mu[2], atol=1e-9)
    np.testing.assert_allclose(twice.mu[0] - twice.mu[4], once.mu[0], atol=1e-9)


def test_rounding_in_repeated_rows_is_no_contradiction():
    lq, position = double_integrator(5), [1.0, 0.0]
    rows = PathRows([3, 3], [position, position], None, [1e-15, -1e-15])
    assert np.abs(solve(lq, rows).X).max() < 1e-12
    with pytest.raises(Infeasible):
        solve(lq, rows, slack=0.0)
    with pytest.raises(Infeasible):
        solve(lq, rows._replace(d=[1e-8, -1e-8]))


def test_dynamics_that_forget():
    """A = 0: what a row asks of the next state, controls alone must bring."""
    lq = double_integrator(4)._replace(A=np.zeros((4, 2, 2)))
    solution = solve(lq, None, StateRows([[1.0, 0.0]], [1.0]), [3.0, 4.0])
    np.testing.assert_allclose(solution.U.ravel(), [0.0, 0.0, 0.0, 2.0], atol=1e-15)
    with pytest.raises(Infeasible) as error:
        solve(lq, None, StateRows(np.eye(2), [1.0, 1.0]), [3.0, 4.0])
    assert error.value.step == 3 and names(error) == {("terminal", 0, 4), ("terminal", 1, 4)}


# Initial states


def test_what_nothing_determines_of_the_initial_state_is_least():
    lq = double_integrator(4)
    solution = solve(lq, None, StateRows([[1.0, 1.0]], [10.0]), "free")  # position + speed = p + 5 s at the end
    np.testing.assert_allclose(solution.X[0], np.array([1.0, 5.0]) * 10.0 / 26.0, rtol=1e-12)
    np.testing.assert_allclose(solution.U, 0.0, atol=1e-14)


def test_a_cost_without_end():
    lq = double_integrator(4)
    with pytest.raises(Unbounded, match="no minimum over the initial states"):
        solve(lq._replace(q=np.ones((5, 2))), None, None, "free")


# Weights without a minimizer


def test_the_step_without_a_minimizer_is_named():
    lq = double_integrator(5)._replace(Q=np.tile(np.eye(2), (6, 1, 1)))
    R, Q, M = lq.R.copy(), lq.Q.copy(), lq.M.copy()
    R[3] = -1.0
    with pytest.raises(NotPositiveDefinite) as error:
        solve(lq._replace(R=R))
    assert error.value.step == 3
    Q[2] = [[1.0, 2.0], [2.0, 1.0]]
    with pytest.raises(NotPositiveDefinite) as error:
        solve(lq._replace(Q=Q))
    assert error.value.step == 2
    Q[2], Q[5] = np.eye(2), -np.eye(2)
    with pytest.raises(NotPositiveDefinite) as error:
        solve(lq._replace(Q=Q))
    assert error.value.step == 5
    M[1] = [[2.0, 0.0]]
    with pytest.raises(NotPositiveDefinite) as error:
        solve(lq._replace(M=M))
    assert error.value.step == 1
    with pytest.raises(NotPositiveDefinite) as error:  # nothing weighs the last control
        solve(lq._replace(R=0.0 * lq.R, Q=0.0 * lq.Q))
    assert error.value.step == 4


def test_a_hard_row_stands_in_for_a_weight():
    lq = double_integrator(5)
    R = lq.R.copy()
    R[3] = 0.0
    solution = solve(lq._replace(R=R), PathRows([3], None, [[1.0]], [0.7]))
    np.testing.assert_allclose(solution.U[3], 0.7)


# Refusals


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"path": PathRows([5], None, [[1.0]], [0.0])}, "path.step must lie between 0 and 4, got 5; rows on x_5"),
        ({"path": PathRows([-1], None, [[1.0]], [0.0])}, "path.step must lie between 0 and 4, got -1"),
        ({"path": PathRows([0.5], None, [[1.0]], [0.0])}, "path.step must be whole numbers"),
        ({"path": PathRows([0], [[1.0]], None, [0.0])}, r"path.H must have shape \(1, 2\), got \(1, 1\)"),
        ({"path": PathRows([0], None, [[1.0]], [np.nan])}, "path.d must be finite"),
        ({"path": PathRows([0], None, [[1.0]], [0.0], [-1.0])}, "path.scale must not be negative, got -1"),
        ({"terminal": StateRows([1.0, 0.0], [0.0])}, r"terminal.H must have shape \(m, 2\), got \(2,\)"),
        ({"initial": StateRows(np.eye(2), [0.0])}, r"initial.d must have shape \(2,\), got \(1,\)"),
        ({"initial": [1.0]}, r"initial must have shape \(2,\), got \(1,\)"),
        ({"initial": "fre"}, r"initial must be 'free', a state \(2,\), StateRows or None, got 'fre'"),
        ({"refinements": -1}, "refinements must be a whole number of at least 0"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ValueError, match=message):
        solve(double_integrator(5), **arguments)


def test_refusals_of_problems_and_right_sides():
    lq = double_integrator(5)
    with pytest.raises(ValueError, match=r"q must have shape \(6, 2\), got \(5, 2\)"):
        solve(lq._replace(q=np.zeros((5, 2))))
    with pytest.raises(ValueError, match=r"B must hold at least one step, state and control, got shape \(0, 2, 1\)"):
        solve(lq._replace(B=np.zeros((0, 2, 1))))
    factorization = factorize(lq, PathRows([1], None, [[1.0]], [0.0]), StateRows([[1.0, 0.0]], [0.0]))
    with pytest.raises(ValueError, match=r"path must have shape \(1,\), got \(2,\)"):
        factorization.solve(path=[0.0, 0.0])
    with pytest.raises(ValueError, match=r"terminal must have shape \(1,\), got \(2,\)"):
        factorization.solve(terminal=[0.0, 0.0])
    with pytest.raises(ValueError, match=r"c must have shape \(5, 2\), got \(4, 2\)"):
        factorization.solve(c=np.zeros((4, 2)))


def test_what_is_given_stays_as_it_is():
    rng = np.random.default_rng(0)
    lq, path, terminal, initial = constrained(rng, 4, 2, 8, 1.0)
    arrays = [*lq, *path, *terminal, *[part for part in (initial,) if isinstance(part, np.ndarray)]]
    copies = [np.copy(array) for array in arrays]
    verdict(lq, path, terminal, initial)
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    for array in lq:
        array.flags.writeable = False
    verdict(lq, path, terminal, initial)


# The transformations


@given(st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 9)), seeds)
def test_hard_rows_keep_their_row_space(size, seed):
    rng = np.random.default_rng(seed)
    nu, nx, rows = size
    given_rows = rng.standard_normal((rows, nu + nx))
    if rows > 2:
        given_rows[2] = given_rows[0] - given_rows[1]
    given_rows /= np.linalg.norm(given_rows, axis=1)[:, None]
    block, order = given_rows.copy(), np.arange(nu)
    V, h = np.zeros((rows, rows)), np.zeros(rows)
    rank, carried = householder.eliminate_hard(block, rows, nu, 1e-12, order, V, h, np.empty((3, nu + nx)))
    assert rank + carried == np.linalg.matrix_rank(given_rows)
    assert rank == np.linalg.matrix_rank(given_rows[:, :nu])
    np.testing.assert_array_equal(block[rank:, :nu], 0.0)
    np.testing.assert_array_equal(block[rank + carried :], 0.0)
    np.testing.assert_array_equal(np.tril(block[:rank, :rank], -1), 0.0)
    again = np.hstack([given_rows[:, order], given_rows[:, nu:]])
    for column in range(nu + nx):
        y = again[:, column].copy()
        householder.reflect_vector(V, h, rank + carried, rows, y, False)
        np.testing.assert_allclose(y, block[:, column], atol=1e-13)
        householder.reflect_vector(V, h, rank + carried, rows, y, True)
        np.testing.assert_allclose(y, again[:, column], atol=1e-13)
    variance = rng.random(rows)
    total = variance.sum()
    Q = np.eye(rows)
    for row in Q:
        householder.reflect_vector(V, h, rank + carried, rows, row, False)
    expected = variance if rank + carried == 0 else (Q.T**2) @ variance if rank + carried == 1 else None
    householder.reflect_variance(V, h, rank + carried, rows, variance)
    np.testing.assert_allclose(variance.sum(), total)
    if expected is not None:
        np.testing.assert_allclose(variance, expected, atol=1e-14)


@given(st.integers(1, 8), st.integers(0, 9), seeds, st.floats(0.0, 6.0))
def test_merging_keeps_the_sum_of_squares(n, rows, seed, orders):
    rng = np.random.default_rng(seed)
    T, S = np.triu(rng.standard_normal((n, n))), rng.standard_normal((rows, n + 2)) * 10.0 ** rng.uniform(0, orders)
    if n > 2:
        T[1] = 0.0
    expected = T.T @ T + S[:, 2:].T @ S[:, 2:]
    householder.merge(T, S.copy(), 0, rows, 2, np.empty(n + 2))
    np.testing.assert_array_equal(np.tril(T, -1), 0.0)
    np.testing.assert_allclose(T.T @ T, expected, atol=1e-12 * np.abs(expected).max())


@given(st.integers(1, 7), st.integers(0, 7), seeds)
def test_semidefinite_factors(n, rank, seed):
    rng = np.random.default_rng(seed)
    G = rng.standard_normal((rank, n)) * 10.0 ** rng.uniform(-3, 3, n)
    S = G.T @ G
    F = np.zeros((n, n))
    found = householder.pivoted_cholesky_rows(S.copy(), F)
    assert found == min(n, rank) and not F[found:].any()
    size = np.sqrt(np.outer(np.diag(S), np.diag(S))) + 1e-300
    assert (np.abs(F.T @ F - S) < 1e-11 * size).all()
    upper = np.triu(S)
    if householder.cholesky_rows(S, upper):
        assert (np.abs(upper.T @ upper - S) < 1e-11 * size).all() and not np.tril(upper, -1).any()
    else:
        assert rank < n
    indefinite = np.diag(np.append(np.ones(n), -1.0))
    assert householder.pivoted_cholesky_rows(indefinite.copy(), np.zeros((n + 1, n + 1))) == -1
    assert not householder.cholesky_rows(indefinite, np.triu(indefinite))
