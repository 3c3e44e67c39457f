"""Random LQ problems and their dense twins, for tests of the sweeps."""

import numpy as np

from mjslq.lq.problem import LQProblem


def random_problem(rng, nx, nu, N, *, state=1.0, control=1.0, terminal=1.0, radius=1.0, cross=True, gaps=True):
    """An LQ problem, and the residual rows W (x, u) + e behind its stage costs 1/2 |W (x, u) + e|^2."""
    A = rng.standard_normal((N, nx, nx))
    A *= radius / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    B = rng.standard_normal((N, nx, nu))
    c = rng.standard_normal((N, nx)) if gaps else np.zeros((N, nx))
    W = np.zeros((N, nx + nu, nx + nu))
    W[:, :nx, :nx] = np.sqrt(state) * rng.standard_normal((N, nx, nx))
    W[:, nx:, nx:] = np.sqrt(control) * (np.eye(nu) + 0.3 * rng.standard_normal((N, nu, nu)) / np.sqrt(nu))
    if cross:
        W[:, nx:, :nx] = np.sqrt(min(state, control)) * rng.standard_normal((N, nu, nx))
    e = rng.standard_normal((N, nx + nu))
    W_end, e_end = np.sqrt(terminal) * rng.standard_normal((nx, nx)), np.sqrt(terminal) * rng.standard_normal(nx)
    H = W.transpose(0, 2, 1) @ W
    h = (W.transpose(0, 2, 1) @ e[..., None])[..., 0]
    lq = LQProblem(
        A=A, B=B, c=c,
        Q=np.ascontiguousarray(np.concatenate([H[:, :nx, :nx], [W_end.T @ W_end]])),
        R=np.ascontiguousarray(H[:, nx:, nx:]), M=np.ascontiguousarray(H[:, nx:, :nx]),
        q=np.concatenate([h[:, :nx], [W_end.T @ e_end]]), r=np.ascontiguousarray(h[:, nx:]),
    )  # fmt: skip
    return lq, (W, e, W_end, e_end)


def response(A, B, c):
    """X = S U + s for x_0 = 0: S of shape (N + 1, nx, N nu), s of shape (N + 1, nx)."""
    N, nx, nu = B.shape
    S, s = np.zeros((N + 1, nx, N * nu)), np.zeros((N + 1, nx))
    for n in range(N):
        S[n + 1] = A[n] @ S[n]
        S[n + 1, :, n * nu : (n + 1) * nu] += B[n]
        s[n + 1] = A[n] @ s[n] + c[n]
    return S, s


def random_lq(seed):
    """A random LQ problem, most often not convex."""
    rng = np.random.default_rng(seed)
    N, nx, nu = rng.integers(1, 7), rng.integers(1, 4), rng.integers(1, 4)
    Q, R = rng.standard_normal((N + 1, nx, nx)), rng.standard_normal((N, nu, nu))
    return LQProblem(
        rng.standard_normal((N, nx, nx)), rng.standard_normal((N, nx, nu)), Q + Q.swapaxes(1, 2),
        R + R.swapaxes(1, 2) + rng.uniform(0, 6) * np.eye(nu), rng.standard_normal((N, nu, nx)),
        rng.standard_normal((N + 1, nx)), rng.standard_normal((N, nu)), np.zeros((N, nx)),
    )  # fmt: skip


def dense(problem):
    """Hessian and gradient by the controls, states eliminated."""
    A, B, Q, R, M, q, r, c, _ = problem
    N, nu = r.shape
    S, s = response(A, B, c)
    H, g = np.zeros((N * nu, N * nu)), r.ravel().copy()
    for n in range(N + 1):
        H += S[n].T @ Q[n] @ S[n]
        g += S[n].T @ (q[n] + Q[n] @ s[n])
        if n < N:
            rows = slice(n * nu, (n + 1) * nu)
            H[rows, rows] += R[n]
            H[rows] += M[n] @ S[n]
            H[:, rows] += S[n].T @ M[n].T
            g[rows] += M[n] @ s[n]
    return H, g
