"""The LQ sweeps against slow, obvious twins: dense least squares, the KKT system, the paper's recursion, numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lq_problems import dense as dense_model
from lq_problems import random_problem, response

from mjslq.lq.adjoint import adjoint
from mjslq.lq.problem import NotPositiveDefinite
from mjslq.lq.riccati import solve

seeds = st.integers(0, 2**32 - 1)
sizes = st.tuples(st.integers(1, 8), st.integers(1, 6), st.integers(1, 12))  # nx, nu, N


def dense_least_squares(lq, rows, multiplier=0.0):
    """Optimal controls from the stacked residual rows, by QR: never squares the condition."""
    N, nx, nu = lq.B.shape
    W, e, W_end, e_end = rows
    S, s = response(lq.A, lq.B, lq.c)
    G, F = [], []
    for n in range(N):
        E = np.zeros((nu, N * nu))
        E[:, n * nu : (n + 1) * nu] = np.eye(nu)
        G.append(W[n] @ np.vstack([S[n], E]))
        F.append(W[n, :, :nx] @ s[n] + e[n])
    G.append(W_end @ S[N])
    F.append(W_end @ s[N] + e_end)
    if multiplier:
        G.append(np.sqrt(multiplier) * np.eye(N * nu))
        F.append(np.zeros(N * nu))
    orthogonal, upper = np.linalg.qr(np.vstack(G))
    return -np.linalg.solve(upper, orthogonal.T @ np.concatenate(F)).reshape(N, nu)


def total_cost(lq, U):
    """Roll out and add up, in plain loops."""
    x, J = np.zeros(lq.A.shape[1]), 0.0
    for n, u in enumerate(U):
        J += 0.5 * x @ lq.Q[n] @ x + lq.q[n] @ x + 0.5 * u @ lq.R[n] @ u + lq.r[n] @ u + u @ lq.M[n] @ x
        x = lq.A[n] @ x + lq.B[n] @ u + lq.c[n]
    return J + 0.5 * x @ lq.Q[-1] @ x + lq.q[-1] @ x


def riccati_twin(lq):
    """The textbook recursion, shortest form: P, p, K, k."""
    N, nx, nu = lq.B.shape
    P, p, K, k = np.empty((N + 1, nx, nx)), np.empty((N + 1, nx)), np.empty((N, nu, nx)), np.empty((N, nu))
    P[N], p[N] = lq.Q[N], lq.q[N]
    for n in range(N - 1, -1, -1):
        A, B, Pc = lq.A[n], lq.B[n], p[n + 1] + P[n + 1] @ lq.c[n]
        G, H = lq.R[n] + B.T @ P[n + 1] @ B, lq.M[n] + B.T @ P[n + 1] @ A
        K[n], k[n] = np.linalg.solve(G, H), -np.linalg.solve(G, lq.r[n] + B.T @ Pc)
        P[n] = lq.Q[n] + A.T @ P[n + 1] @ A - H.T @ K[n]
        p[n] = lq.q[n] + A.T @ Pc + H.T @ k[n]
    return P, p, K, k


def relative(ours, reference):
    return np.linalg.norm(ours - reference) / np.linalg.norm(reference)


# The sweep


@given(sizes, seeds)
def test_sweep_is_dense_least_squares(size, seed):
    lq, rows = random_problem(np.random.default_rng(seed), *size)
    solution = solve(lq)
    assert relative(solution.U, dense_least_squares(lq, rows)) < 1e-9


@pytest.mark.parametrize(
    "nx, nu, N", [(40, 5, 200), (12, 3, 100), (3, 9, 20), (5, 2, 1), (1, 1, 1), (20, 20, 10), (30, 40, 8)]
)
def test_sweep_is_dense_least_squares_for_every_shape(nx, nu, N):
    lq, rows = random_problem(np.random.default_rng(nx + N), nx, nu, N)
    solution = solve(lq)
    assert solution.K.shape == (N, nu, nx) and solution.P.shape == (N + 1, nx, nx)
    assert relative(solution.U, dense_least_squares(lq, rows)) < 1e-9


@pytest.mark.parametrize("terminal", [1e4, 1e5, 1e6])
@pytest.mark.parametrize("control", [1e-4, 1e-2])
def test_sweep_survives_weights_ten_orders_apart(control, terminal):
    rng = np.random.default_rng(5)
    for nx, nu, N in [(4, 1, 50), (6, 2, 30), (14, 7, 60)]:
        lq, rows = random_problem(rng, nx, nu, N, state=1e-2, control=control, terminal=terminal)
        assert relative(solve(lq).U, dense_least_squares(lq, rows)) < 1e-9


def test_refinement_gains_digits_where_weights_are_extreme():
    """Few directions of the terminal weight matter at a time: 1e12 times the control weight."""
    rng = np.random.default_rng(0)
    worst = {0: 0.0, 1: 0.0}
    for _ in range(5):
        lq, rows = random_problem(rng, 4, 1, 40, state=1e-3, control=1e-4, terminal=1e8)
        reference = dense_least_squares(lq, rows)
        for refinements in worst:
            worst[refinements] = max(worst[refinements], relative(solve(lq, refinements=refinements).U, reference))
    assert worst[1] < 1e-9
    assert worst[1] < 1e-2 * worst[0]


@given(sizes, seeds)
def test_sweep_meets_its_own_equations(size, seed):
    """States follow the dynamics, u = k - K x, and P is symmetric to the last bit and positive semidefinite."""
    lq, _ = random_problem(np.random.default_rng(seed), *size, control=1e-3, terminal=1e4)
    K, k, X, U, P, _ = solve(lq)
    step = np.einsum("nij,nj->ni", lq.A, X[:-1]) + np.einsum("nij,nj->ni", lq.B, U) + lq.c
    np.testing.assert_allclose(X[1:], step, rtol=1e-12, atol=1e-12 * np.abs(X).max())
    assert not X[0].any()
    np.testing.assert_allclose(k - np.einsum("nij,nj->ni", K, X[:-1]), U, rtol=1e-12, atol=1e-12 * np.abs(k).max())
    np.testing.assert_array_equal(P, P.transpose(0, 2, 1))
    assert (np.linalg.eigvalsh(P)[:, 0] >= -1e-12 * np.abs(P).max(axis=(1, 2))).all()


@given(sizes, seeds)
def test_sweep_is_the_textbook_recursion(size, seed):
    lq, _ = random_problem(np.random.default_rng(seed), *size)
    solution = solve(lq)
    for ours, twin in zip((solution.P, solution.p, solution.K, solution.k), riccati_twin(lq), strict=True):
        np.testing.assert_allclose(ours, twin, rtol=1e-7, atol=1e-8 * np.abs(twin).max())


@given(sizes, seeds)
def test_sweep_is_the_papers_algorithm_1(size, seed):
    """(23)-(26) and (17), (22) as printed, with targets for linear terms."""
    nx, nu, N = size
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(rng, nx, nu, N, cross=False, gaps=False)
    x_o, u_o = rng.standard_normal((N + 1, nx)), rng.standard_normal((N, nu))
    q, r = -np.einsum("nij,nj->ni", lq.Q, x_o), -np.einsum("nij,nj->ni", lq.R, u_o)
    solution = solve(lq._replace(q=q, r=r))

    P, s, M = [lq.Q[N]], [-lq.Q[N] @ x_o[N]], []
    for n in range(N - 1, -1, -1):
        A, B, BRB = lq.A[n], lq.B[n], lq.B[n] @ np.linalg.solve(lq.R[n], lq.B[n].T)
        M.insert(0, np.linalg.inv(np.eye(nx) + BRB @ P[0]))  # (23)
        PM, P_next, s_next = P[0] @ M[0], P[0], s[0]
        P.insert(0, lq.Q[n] + A.T @ P_next @ M[0] @ A)  # (25)
        s.insert(0, A.T @ (np.eye(nx) - PM @ BRB) @ s_next + A.T @ PM @ B @ u_o[n] - lq.Q[n] @ x_o[n])  # (26)
    x, U = np.zeros(nx), np.empty((N, nu))
    for n in range(N):
        R_inverse_B = np.linalg.solve(lq.R[n], lq.B[n].T)
        x = M[n] @ lq.A[n] @ x + M[n] @ lq.B[n] @ (u_o[n] - R_inverse_B @ s[n + 1])  # (22), (24)
        U[n] = u_o[n] - R_inverse_B @ (P[n + 1] @ x + s[n + 1])  # (17), (20)

    np.testing.assert_allclose(solution.P, P, rtol=1e-7, atol=1e-8 * np.abs(P).max())
    np.testing.assert_allclose(solution.p, s, rtol=1e-7, atol=1e-8 * np.abs(s).max())
    assert relative(solution.U, U) < 1e-7


@given(sizes, seeds)
def test_sweep_solves_the_kkt_system(size, seed):
    """All of x, u and the multipliers at once; the multiplier of step n is the costate P x + p of knot n + 1."""
    nx, nu, N = size
    lq, _ = random_problem(np.random.default_rng(seed), nx, nu, N)
    states, controls = nx * (N + 1), nu * N
    H, h = np.zeros((states + controls,) * 2), np.zeros(states + controls)
    G, g = np.zeros((states, states + controls)), np.zeros(states)
    for n in range(N + 1):
        x, u = slice(n * nx, (n + 1) * nx), slice(states + n * nu, states + (n + 1) * nu)
        H[x, x], h[x], G[x, x] = lq.Q[n], lq.q[n], -np.eye(nx)
        if n < N:
            H[u, u], h[u], H[u, x], H[x, u] = lq.R[n], lq.r[n], lq.M[n], lq.M[n].T
            beyond = slice((n + 1) * nx, (n + 2) * nx)
            G[beyond, x], G[beyond, u], g[beyond] = lq.A[n], lq.B[n], -lq.c[n]
    kkt = np.block([[H, G.T], [G, np.zeros((states, states))]])
    z = np.linalg.solve(kkt, np.concatenate([-h, g]))
    _, _, X, U, P, p = solve(lq)
    assert relative(X.ravel(), z[:states]) < 1e-7
    assert relative(U.ravel(), z[states : states + controls]) < 1e-7
    costates = np.einsum("nij,nj->ni", P, X) + p
    assert relative(costates[1:].ravel(), z[states + controls + nx :]) < 1e-7


@given(sizes, seeds)
def test_no_other_controls_cost_less(size, seed):
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(rng, *size)
    U = solve(lq).U
    J = total_cost(lq, U)
    for scale in (1e-3, 1e-1, 10.0):
        assert total_cost(lq, U + scale * rng.standard_normal(U.shape)) > J


@given(sizes, seeds, st.floats(1e-6, 1e4))
def test_multiplier_is_mu_on_the_diagonal_of_R(size, seed, mu):
    lq, rows = random_problem(np.random.default_rng(seed), *size)
    ours = solve(lq, mu)
    twin = solve(lq._replace(R=lq.R + mu * np.eye(size[1])))
    for name in ("K", "k", "X", "U", "P", "p"):
        a, b = getattr(ours, name), getattr(twin, name)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(b).max(), err_msg=name)
    assert relative(ours.U, dense_least_squares(lq, rows, mu)) < 1e-9


def test_solve_leaves_its_input_alone():
    lq, _ = random_problem(np.random.default_rng(1), 4, 2, 10)
    before = [array.copy() for array in lq[:8]]
    solve(lq, 0.5)
    for array, copy in zip(lq[:8], before, strict=True):
        np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("step", [0, 4, 9])
@pytest.mark.parametrize("spoil", [-1e6, np.nan, np.inf])
def test_step_without_a_minimizer_is_named(step, spoil):
    lq, _ = random_problem(np.random.default_rng(2), 3, 2, 10)
    lq.R[step] = spoil * np.eye(2) if np.isfinite(spoil) else spoil
    with pytest.raises(NotPositiveDefinite, match=f"step {step}$") as caught:
        solve(lq)
    assert caught.value.step == step


def test_a_multiplier_mends_an_indefinite_control_weight():
    lq, _ = random_problem(np.random.default_rng(3), 3, 2, 10)
    lq.R[6] -= 1e3 * np.eye(2)
    with pytest.raises(NotPositiveDefinite):
        solve(lq)
    assert np.isfinite(solve(lq, 1e4).U).all()


@given(sizes, seeds, st.floats(1e-6, 1e4), st.floats(1e-6, 1e4))
def test_shifts_are_on_the_diagonals_of_R_and_Q(size, seed, sigma, tau):
    """Control shifts may differ from one to the next, and refinement solves the shifted problem, not the plain one."""
    nx, nu, N = size
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(rng, *size)
    shift = sigma * rng.uniform(0.0, 1.0, (N, nu))
    whole = lq._replace(R=lq.R + shift[:, :, None] * np.eye(nu), Q=lq.Q + tau * np.eye(nx))
    for refinements in (None, 0, 2):
        ours, twin = solve(lq, shift, tau, refinements=refinements), solve(whole)
        for name in ("K", "k", "X", "U", "P", "p"):
            a, b = getattr(ours, name), getattr(twin, name)
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8 * np.abs(b).max(), err_msg=name)
    H, g = dense_model(whole)
    assert relative(ours.U.ravel(), np.linalg.solve(H, -g)) < 1e-8


@given(sizes, seeds, st.floats(0.0, 1.0))
def test_held_controls_stay_at_zero_and_the_others_minimize(size, seed, share):
    _, nu, N = size
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(rng, *size)
    held = rng.uniform(size=(N, nu)) < share
    ours = solve(lq, held=held)
    assert not ours.U[held].any() and not ours.K[held].any() and not ours.k[held].any()
    H, g = dense_model(lq)
    free = ~held.ravel()
    dense_U = np.zeros(N * nu)
    dense_U[free] = np.linalg.solve(H[np.ix_(free, free)], -g[free])
    np.testing.assert_allclose(ours.U.ravel(), dense_U, rtol=1e-8, atol=1e-9 * max(1.0, np.abs(dense_U).max()))
    plain = solve(lq)
    if not held.any():
        for a, b in zip(ours, plain, strict=True):
            np.testing.assert_array_equal(a, b)


@given(sizes, seeds)
def test_held_controls_leave_a_problem_with_fewer_controls(size, seed):
    """One control held throughout: all of the sweep, cost-to-go included, is that of the problem without it."""
    nx, nu, N = size
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(rng, nx, nu + 1, N)
    held = np.zeros((N, nu + 1), bool)
    out = int(rng.integers(nu + 1))
    held[:, out] = True
    rest = np.delete(np.arange(nu + 1), out)
    smaller = lq._replace(
        B=np.ascontiguousarray(lq.B[:, :, rest]), R=np.ascontiguousarray(lq.R[:, rest][:, :, rest]),
        M=np.ascontiguousarray(lq.M[:, rest]), r=np.ascontiguousarray(lq.r[:, rest]),
    )  # fmt: skip
    ours, twin = solve(lq, held=held), solve(smaller)
    for name in ("X", "P", "p"):
        a, b = getattr(ours, name), getattr(twin, name)
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8 * np.abs(b).max(), err_msg=name)
    for name in ("K", "k", "U"):
        a, b = getattr(ours, name)[:, rest], getattr(twin, name)
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8 * np.abs(b).max(), err_msg=name)


def test_a_control_that_is_held_needs_no_weight():
    lq, _ = random_problem(np.random.default_rng(3), 3, 2, 10)
    lq.R[6, 1, :], lq.R[6, :, 1], lq.R[6, 1, 1] = 0.0, 0.0, -1e6
    with pytest.raises(NotPositiveDefinite):
        solve(lq)
    held = np.zeros((10, 2), bool)
    held[6, 1] = True
    assert np.isfinite(solve(lq, held=held).U).all()


# The problem's own functions


@given(sizes, seeds)
def test_value_and_states_are_a_plain_loop(size, seed):
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(rng, *size)
    U = rng.standard_normal(lq.r.shape)
    x, X = np.zeros(lq.A.shape[1]), [np.zeros(lq.A.shape[1])]
    for n, u in enumerate(U):
        x = lq.A[n] @ x + lq.B[n] @ u + lq.c[n]
        X.append(x)
    np.testing.assert_allclose(lq.states(U), X, rtol=1e-12, atol=1e-12)
    scale = np.abs(np.einsum("ni,nij,nj->n", X, lq.Q, X)).sum() + np.vdot(U, U)
    assert lq.value(lq.states(U), U) == pytest.approx(total_cost(lq, U), rel=1e-10, abs=1e-12 * scale)


@given(sizes, seeds)
def test_a_problem_about_a_point_differs_by_a_constant(size, seed):
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(rng, *size)
    X, U = rng.standard_normal(lq.q.shape), rng.standard_normal(lq.r.shape)
    X[0] = 0.0
    about = lq.about(X, U)
    offsets = []
    for _ in range(3):
        dU = rng.standard_normal(U.shape)
        dX = about.states(dU)
        np.testing.assert_allclose(X + dX, lq.states(U + dU), rtol=1e-10, atol=1e-10 * np.abs(dX).max())
        offsets.append(lq.value(X + dX, U + dU) - about.value(dX, dU))
    assert np.ptp(offsets) <= 1e-10 * max(1.0, *np.abs(offsets), abs(lq.value(X + dX, U + dU)))
    moved, plain = solve(about), solve(lq)
    np.testing.assert_allclose(U + moved.U, plain.U, rtol=1e-7, atol=1e-8 * np.abs(plain.U).max())


# The adjoint


@given(sizes, seeds)
def test_adjoint_is_the_dense_gradient(size, seed):
    nx, nu, N = size
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(rng, nx, nu, N)
    costates, gradient = adjoint(lq.A, lq.B, lq.q, lq.r)
    S, _ = response(lq.A, lq.B, lq.c)
    dense = lq.r + np.einsum("nij,ni->j", S, lq.q).reshape(N, nu)
    np.testing.assert_allclose(gradient, dense, rtol=1e-9, atol=1e-10 * np.abs(dense).max())
    reaching = np.eye(nx)  # of x_0 to x_n, which the first costate adds up
    total = lq.q[0].copy()
    for n in range(N):
        reaching = lq.A[n] @ reaching
        total += reaching.T @ lq.q[n + 1]
    np.testing.assert_allclose(costates[0], total, rtol=1e-9, atol=1e-10 * np.abs(costates).max())


@given(sizes, seeds)
def test_adjoint_is_the_finite_difference_of_the_total_cost(size, seed):
    nx, nu, N = size
    rng = np.random.default_rng(seed)
    lq, _ = random_problem(rng, nx, nu, N)
    U, D = rng.standard_normal((N, nu)), rng.standard_normal((N, nu))
    X = np.zeros((N + 1, nx))
    for n in range(N):
        X[n + 1] = lq.A[n] @ X[n] + lq.B[n] @ U[n] + lq.c[n]
    q = np.einsum("nij,nj->ni", lq.Q, X) + lq.q
    q[:-1] += np.einsum("nij,ni->nj", lq.M, U)
    r = np.einsum("nij,nj->ni", lq.R, U) + lq.r + np.einsum("nij,nj->ni", lq.M, X[:-1])
    _, gradient = adjoint(lq.A, lq.B, q, r)
    slope = (total_cost(lq, U + D) - total_cost(lq, U - D)) / 2.0  # a quadratic: centred differences are exact
    scale = np.linalg.norm(gradient) * np.linalg.norm(D) + abs(total_cost(lq, U + D))
    assert abs(np.vdot(gradient, D) - slope) < 1e-10 * scale


# The dense kernels, below and above the size at which they turn to BLAS
