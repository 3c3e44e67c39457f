"""Jacobians by differences of whole steps that see a kink coming, and such of steps that mjd_transitionFD refuses.

Notation
--------
    f, g              a step of the horizon, all its substeps included, and the outputs at its start
    e                 size of the differences
    x (+) d           a walk along the tangent direction d
    J_+, J_-          one-sided differences, (f(x (+) e_i, u) (-) f(x, u)) / e for +e and -e; J = (J_+ + J_-) / 2

Where the sides of a column differ by more than curvature explains, a kink lies within e: a contact that opens a
micrometre away changes the acceleration by any factor. Such columns are taken again with e / 100, and kept so if their
sides are closer then. If they are not, the kink is at the knot itself, and the mean of both sides stands.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from mjslq.dynamics.mujoco.simulator import Simulator
from mjslq.dynamics.records import Linearization
from mjslq.manifold import Indices, StateSpace
from mjslq.validation import Array

_JUMP = 1e-3
"""Difference of the two sides, relative to the largest entry of the column, from which on there is a kink."""
_FINER = 0.01
"""Size of the second differences, relative to the first."""
OneSided = Callable[[Array, Array, float], Linearization]
"""one_sided(X, U, e) -> A, B, C, D at each of the states X (M, nx) under U (M, nu)."""


def centred_differences(one_sided: OneSided, X: Array, U: Array, eps: float, outputs: bool) -> Linearization:
    """Differences to both sides at the knots X (N + 1, nx), at the last one of the outputs alone, without control."""
    N = len(U)
    knots = np.arange(N + 1 if outputs else N)
    U = np.vstack([U, np.zeros((1, U.shape[1]))])

    def both(knots: Indices, eps: float) -> tuple[Linearization, Linearization]:
        return one_sided(X[knots], U[knots], eps), one_sided(X[knots], U[knots], -eps)

    sides = both(knots, eps)
    kinked = np.flatnonzero(_have_kinks(sides))
    if len(kinked):
        _take_closer(sides, both(kinked, _FINER * eps), kinked)
    A, B, C, D = (0.5 * (ahead + behind) for ahead, behind in zip(*sides, strict=True))
    if not outputs:
        C, D = np.zeros((N + 1, *C.shape[1:])), np.zeros((N + 1, *D.shape[1:]))
    D[N] = 0.0
    return Linearization(A[:N], B[:N], C, D)


def centred_transition(simulator: Simulator, X: Array, U: Array, S: Array, eps: float) -> Linearization:
    """Differences by mjd_transitionFD to both sides of each simulator step, those of a held control chained.

    Knots X (N + 1, nx), controls U (N, nu), states between S (N, k - 1, nx).
    """
    N, between, nx = S.shape
    A, B, C, D = centred_differences(simulator.transition, X, U, eps, outputs=simulator.model.nsensordata > 0)
    if between:
        one_sided = partial(simulator.transition, outputs=False)
        states = np.vstack([S.reshape(-1, nx), X[-1:]])
        A_s, B_s, _, _ = centred_differences(one_sided, states, np.repeat(U, between, axis=0), eps, outputs=False)
        each = (part.reshape(N, between, *part.shape[1:]) for part in (A_s, B_s))
        A, B = chain(*(np.concatenate([first[:, None], rest], 1) for first, rest in zip((A, B), each, strict=True)))
    return Linearization(A, B, C, D)


def chain(A: Array, B: Array) -> tuple[Array, Array]:
    """A_k ... A_1 and B_k + A_k (B_{k-1} + ... B_1) of k steps in a row. Shapes (N, k, ...) -> (N, ...)."""
    whole_A, whole_B = A[:, 0], B[:, 0]
    for s in range(1, A.shape[1]):
        whole_A, whole_B = A[:, s] @ whole_A, A[:, s] @ whole_B + B[:, s]
    return np.ascontiguousarray(whole_A), np.ascontiguousarray(whole_B)


def _gaps(ahead: Array, behind: Array) -> tuple[Array, Array]:
    """How far the sides of each column are apart, and its largest entry. Shapes (M, columns)."""
    size = np.maximum(np.abs(ahead), np.abs(behind)).max(axis=1, initial=0.0)
    return np.abs(ahead - behind).max(axis=1, initial=0.0), size


def _have_kinks(sides: tuple[Linearization, Linearization]) -> Indices:
    """Tell for each knot whether it has a column whose sides differ."""
    found = np.zeros(len(sides[0].A), bool)
    for ahead, behind in zip(*sides, strict=True):
        gap, size = _gaps(ahead, behind)
        found |= (gap > _JUMP * size).any(axis=1)
    return found


def _take_closer(
    sides: tuple[Linearization, Linearization], finer: tuple[Linearization, Linearization], knots: Indices
) -> None:
    """Replace the columns with kinks whose sides are less than half as far apart in `finer`."""
    for ahead, behind, ahead_finer, behind_finer in zip(*sides, *finer, strict=True):
        (gap, size), (gap_finer, _) = _gaps(ahead[knots], behind[knots]), _gaps(ahead_finer, behind_finer)
        closer = (gap > _JUMP * size) & (gap_finer < 0.5 * gap)
        for old, new in ((ahead, ahead_finer), (behind, behind_finer)):
            old[knots] = np.where(closer[:, None, :], new, old[knots])


def step_differences(
    simulator: Simulator, space: StateSpace, limits: Array, X: Array, U: Array, eps: float
) -> Linearization:
    """One-sided differences of plain steps from the knots X (M, nx) under U (M, nu), to the side that eps's sign says.

    Each column is one simulation of a step from every knot, on all threads, and each step starts from a clean mjData,
    so that a knot's Jacobians do not depend on its neighbours. Controls do not leave their limits (nu, 2).
    """
    M, nu, ndx = len(U), U.shape[1], space.ndx

    def ends(X: Array, U: Array) -> tuple[Array, Array]:
        F, _, Y = simulator.step_each(np.vstack([X, X[-1:]]), U)
        return F, Y[:M]

    F0, Y0 = ends(X, U)
    ny = Y0.shape[1]
    A, B, C, D = np.empty((M, ndx, ndx)), np.empty((M, ndx, nu)), np.empty((M, ny, ndx)), np.empty((M, ny, nu))
    for i in range(ndx):
        move = np.zeros(ndx)
        move[i] = eps
        F, Y = ends(space.integrate(X, move), U)
        A[:, :, i], C[:, :, i] = space.difference(F0, F) / eps, (Y - Y0) / eps
    for i in range(nu):
        e = _inward(U[:, i], limits[i], eps)
        moved = U.copy()
        moved[:, i] += e
        F, Y = ends(X, moved)
        B[:, :, i], D[:, :, i] = space.difference(F0, F) / e[:, None], (Y - Y0) / e[:, None]
    return Linearization(A, B, C, D)


def _inward(u: Array, limits: Array, eps: float) -> Array:
    """How far each control is moved: by eps, or by -eps where only that stays within the limits. Shape (M,)."""
    stays, returns = ((limits[0] <= v) & (v <= limits[1]) for v in (u + eps, u - eps))
    return np.where(returns & ~stays, -eps, eps)
