"""Making an LQ problem convex: by one multiplier, or by the least change of the control Hessians, stage by stage.

In the backward sweep the Hessian of the total cost by the controls appears factorized, one block a stage:

    H = L diag(G_0, ..., G_{N-1}) L',    G_n = R_n + B_n'P_{n+1} B_n

so that it is positive definite exactly if every G_n is. Where one is not, its eigenvalues below a floor are
replaced by their absolute values, or by the floor where these are smaller,

    E_n = V (max(|lambda|, floor) - lambda) V'  for  G_n = V lambda V',  lambda < floor,

and the sweep goes on with R_n + E_n. Directions of negative curvature are then descended with their curvature
taken as positive. This is the modified Cholesky factorization by blocks (Gill and Murray 1974).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mjslq.lq.riccati import LQProblem, LQSolution, NotPositiveDefinite, solve
from mjslq.validation import Array


def modification(problem: LQProblem, floor: Array) -> Array:
    """E_n for every stage. Shape (N, nu, nu). `floor` holds the least eigenvalue allowed of each G_n. Shape (N,)."""
    E = np.zeros_like(problem.R)
    _modify(problem.A, problem.B, problem.Q, problem.R, problem.M, floor, E)
    return E


def convexified(problem: LQProblem) -> tuple[LQSolution, float]:
    """Solve a problem that is convex but for a lack of control weights: with the least multiplier that will do."""
    scale, multiplier = max(1.0, float(np.abs(problem.R).max())), 0.0
    while True:
        try:
            return solve(problem, multiplier), multiplier
        except NotPositiveDefinite:
            multiplier = max(10.0 * multiplier, 1e-6 * scale)
            if multiplier > 1e12 * scale:
                raise


@njit(cache=True, nogil=True)
def _modify(A, B, Q, R, M, floor, E):
    P = Q[-1].copy()
    for n in range(B.shape[0] - 1, -1, -1):
        PB = np.dot(P, B[n])
        G = R[n] + np.dot(B[n].T, PB)
        values, V = np.linalg.eigh(0.5 * (G + G.T))
        wanted = values.copy()
        for i in range(values.size):
            if not values[i] >= floor[n]:
                wanted[i] = max(abs(values[i]), floor[n])
                E[n] += (wanted[i] - values[i]) * np.outer(V[:, i], V[:, i])
        W = np.dot(np.ascontiguousarray(V.T), M[n] + np.dot(np.ascontiguousarray(PB.T), A[n]))
        scaled = W.copy()
        for i in range(values.size):
            scaled[i] /= wanted[i]
        P = Q[n] + np.dot(A[n].T, np.dot(P, A[n])) - np.dot(W.T, scaled)
        P = 0.5 * (P + P.T)
