"""Random constrained LQ problems, and their dense first-order conditions: the slow twin of the square-root sweep."""

import numpy as np
import scipy.linalg
from hypothesis import strategies as st

from mjslq.lq.problem import LQProblem
from mjslq.lq.square_root import Infeasible, PathRows, StateRows, Unbounded, solve

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
