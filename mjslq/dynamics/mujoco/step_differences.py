"""Jacobians by differences of whole steps that see a kink coming, and such of steps that mjd_transitionFD refuses.

Notation
--------
    f, g              a step of the horizon, all its substeps included, and the outputs at its start
    e                 size of the differences
    x (+) d           a walk along the tangent direction d
    J_+, J_-          one-sided differences, (f(x (+) e_i, u) (-) f(x, u)) / e for +e and -e; J = (J_+ + J_-) / 2

Where the sides of a column differ by more than curvature explains, a kink lies within e: a contact that opens a
micrometre away changes the acceleration by any factor. Such columns are taken again with e / 100, and kept so if their
sides are closer then. If they are not, the kink is at the knot itself, and the mean of both sides stands. They are few
even in contact, and taken one by one, each by a step to either side.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from mjslq.dynamics.mujoco.inverse.table.continuous import is_runge_kutta
from mjslq.dynamics.mujoco.simulator import Simulator
from mjslq.dynamics.records import Linearization
from mjslq.manifold import Indices, StateSpace
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

_JUMP = 1e-3
"""Difference of the two sides, relative to the largest entry of the column, from which on there is a kink."""
_FINER = 0.01
"""Size of the second differences, relative to the first."""
OneSided = Callable[[Array, Array, float], Linearization]
"""one_sided(X, U, e) -> A, B, C, D at each of the states X (M, nx) under U (M, nu)."""
Along = Callable[[Indices, Indices, float], tuple[Array, Array]]
"""along(knots, columns, e) -> columns of (A, B) and of (C, D), see `step_columns`."""
Flags = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


def linearize_by_differences(
    simulator: Simulator, space: StateSpace, limits: Array, trajectory: Trajectory, eps: float, centered: bool
) -> Linearization:
    """Jacobians of the steps of a trajectory, by mjd_transitionFD or, where that refuses, by plain steps."""
    X, U = trajectory.X, trajectory.U
    if is_runge_kutta(simulator.model):
        one_sided = partial(step_differences, simulator, space, limits)
        along = partial(step_columns, simulator, space, limits, X, U)
        return centred_differences(one_sided, X, U, eps, simulator.model.nsensordata > 0, along)
    S = simulator.known_substates(trajectory)
    if centered:
        return centred_transition(simulator, space, limits, X, U, S, eps)
    return simulator.transition(X, U, eps, S)


def centred_differences(
    one_sided: OneSided, X: Array, U: Array, eps: float, outputs: bool, along: Along | None = None
) -> Linearization:
    """Differences to both sides at the knots X (N + 1, nx), at the last one of the outputs alone, without control.

    `along` takes single columns again; without it all columns of a knot with a kink are.
    """
    N = len(U)
    knots = np.arange(N + 1 if outputs else N)
    U = np.vstack([U, np.zeros((1, U.shape[1]))])

    def both(knots: Indices, eps: float) -> tuple[Linearization, Linearization]:
        return one_sided(X[knots], U[knots], eps), one_sided(X[knots], U[knots], -eps)

    sides = both(knots, eps)
    kinked = [_kinked_columns(ahead, behind) for ahead, behind in zip(*sides, strict=True)]
    if along is not None:
        _take_columns_closer(sides, kinked, along, _FINER * eps)
    elif len(rows := np.flatnonzero(np.logical_or.reduce([columns.any(axis=1) for columns in kinked]))):
        _take_closer(sides, both(rows, _FINER * eps), rows)
    A, B, C, D = (0.5 * (ahead + behind) for ahead, behind in zip(*sides, strict=True))
    if not outputs:
        C, D = np.zeros((N + 1, *C.shape[1:])), np.zeros((N + 1, *D.shape[1:]))
    D[N] = 0.0
    return Linearization(A[:N], B[:N], C, D)


def centred_transition(
    simulator: Simulator, space: StateSpace, limits: Array, X: Array, U: Array, S: Array, eps: float
) -> Linearization:
    """Differences by mjd_transitionFD to both sides of each simulator step, those of a held control chained.

    Knots X (N + 1, nx), controls U (N, nu), states between S (N, k - 1, nx).
    """
    N, between, nx = S.shape
    outputs = simulator.model.nsensordata > 0
    along = None if between else partial(step_columns, simulator, space, limits, X, U)
    A, B, C, D = centred_differences(simulator.transition, X, U, eps, outputs, along)
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


def _kinked_columns(ahead: Array, behind: Array) -> Flags:
    """Tell for each column of each knot whether its sides differ. Shape (M, columns)."""
    gap, size = _gaps(ahead, behind)
    return np.asarray(gap > _JUMP * size)


def _take_columns_closer(
    sides: tuple[Linearization, Linearization], kinked: list[Flags], along: Along, eps: float
) -> None:
    """Take the columns with kinks again, with differences of size `eps`, and keep those whose sides are closer.

    Columns of A and C are of one simulation, and so are those of B and D.
    """
    ndx = kinked[0].shape[1]
    of_steps, of_outputs = (np.concatenate(pair, axis=1) for pair in (kinked[:2], kinked[2:]))
    knots, columns = np.nonzero(of_steps | of_outputs)
    if not len(knots):
        return
    ahead, behind = along(knots, columns, eps), along(knots, columns, -eps)
    for part, (finer_ahead, finer_behind) in enumerate(zip(ahead, behind, strict=True)):
        for by_control in (False, True):
            old_ahead, old_behind = (side[2 * part + by_control] for side in sides)
            chosen = np.flatnonzero((columns >= ndx) == by_control)
            n, c = knots[chosen], columns[chosen] - (ndx if by_control else 0)
            if not old_ahead.size or not len(chosen):
                continue
            gap = np.abs(old_ahead[n, :, c] - old_behind[n, :, c]).max(axis=1, initial=0.0)
            closer = np.abs(finer_ahead[chosen] - finer_behind[chosen]).max(axis=1, initial=0.0) < 0.5 * gap
            closer &= kinked[2 * part + by_control][n, c]
            for old, new in ((old_ahead, finer_ahead), (old_behind, finer_behind)):
                old[n[closer], :, c[closer]] = new[chosen][closer]


def _take_closer(
    sides: tuple[Linearization, Linearization], finer: tuple[Linearization, Linearization], knots: Indices
) -> None:
    """Replace the columns with kinks whose sides are less than half as far apart in `finer`."""
    for ahead, behind, ahead_finer, behind_finer in zip(*sides, *finer, strict=True):
        (gap, size), (gap_finer, _) = _gaps(ahead[knots], behind[knots]), _gaps(ahead_finer, behind_finer)
        closer = (gap > _JUMP * size) & (gap_finer < 0.5 * gap)
        for old, new in ((ahead, ahead_finer), (behind, behind_finer)):
            old[knots] = np.where(closer[:, None, :], new, old[knots])


def step_columns(
    simulator: Simulator,
    space: StateSpace,
    limits: Array,
    X: Array,
    U: Array,
    knots: Indices,
    columns: Indices,
    eps: float,
) -> tuple[Array, Array]:
    """Columns of (A, B) and of (C, D) by one-sided differences of plain steps, each at its knot.

    Column i of the states is a tangent direction, column ndx + i a control. Shapes (P, ndx) and (P, ny). From the last
    state of X (N + 1, nx), under U (N, nu), a step is taken without control.
    """
    ndx, nu = space.ndx, U.shape[1]
    U = np.vstack([U, np.zeros((1, nu))])
    here, place = np.unique(knots, return_inverse=True)
    of_state, pairs = columns < ndx, np.arange(len(knots))
    moves, moved, sizes = np.zeros((len(knots), ndx)), U[knots], np.full(len(knots), eps)
    moves[pairs[of_state], columns[of_state]] = eps
    for i in np.unique(columns[~of_state]) - ndx:
        rows = columns == ndx + i
        sizes[rows] = _inward(moved[rows, i], limits[i], eps)
        moved[rows, i] += sizes[rows]
    starts = np.concatenate([X[here], space.integrate(X[knots], moves)])
    F, _, Y = simulator.step_each(np.vstack([starts, starts[-1:]]), np.concatenate([U[here], moved]))
    base_F, base_Y, F, Y = F[: len(here)][place], Y[: len(here)][place], F[len(here) :], Y[len(here) : -1]
    return space.difference(base_F, F) / sizes[:, None], (Y - base_Y) / sizes[:, None]


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
