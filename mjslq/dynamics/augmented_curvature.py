"""Second derivatives of an augmented system (`dynamics.augmented`): the engine's own, those by the values besides.

Notation
--------
    L = sum_n lambda_{n+1}'f_n(x, u; p) + w_n'y_n(x, u; p)          p the values of a knot
    L_pj(x, u)     differences of the gradients f_x'lambda + y_x'w and f_u'lambda + y_u'w, along p_j
    L_pjpk         second differences of L itself; steps as directions from where they end

Where a value is next to a limit the differences are taken about a point that far inside.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjslq.dynamics.records import Curvature
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.dynamics.augmented import Augmented

SECOND = 1e-4
"""Step of the differences, relative to a value's size."""


def augmented_hessian(
    system: Augmented, trajectory: Trajectory, costates: Array, weights: Array | None, ends: Array | None
) -> Curvature:
    """Second derivatives by states and controls of `system`, contracted; the caller holds its lock."""
    inner, size, N = system.inner, len(system.names), trajectory.horizon
    X, U = (np.ascontiguousarray(part) for part in (trajectory.X[:, : inner.nx], trajectory.U[:, : inner.nu]))
    values = system.values_at(trajectory.X, trajectory.U)[0]
    costates = np.ascontiguousarray(costates[:, : inner.ndx])
    ends = X[1:] if ends is None else np.ascontiguousarray(ends[:, : inner.nx])
    plain = Trajectory.unchecked(X, U, trajectory.Y, np.asarray(trajectory.dt))
    xx, ux, uu = system.at(values).hessian(plain, costates, weights, None, ends)
    ndx, nu = inner.ndx, inner.nu
    Q, M, R = np.zeros((N + 1, system.ndx, system.ndx)), np.zeros((N, system.nu, system.ndx)), None
    R = np.zeros((N, system.nu, system.nu))
    Q[:, :ndx, :ndx], M[:, :nu, :ndx], R[:, :nu, :nu] = xx, ux, uu
    steps = np.array([SECOND * system.scale(values, j) for j in range(size)])
    limits = np.array([system.limits(j) for j in range(size)]).reshape(size, 2)
    centre = np.clip(values, limits[:, 0] + steps, np.maximum(limits[:, 1] - steps, limits[:, 0] + steps))
    for j in range(size):
        by_x, by_u = _mixed(system, centre, j, steps[j], (X, U, ends), costates, weights)
        Q[1:, :ndx, ndx + j] += by_x[1:]
        Q[1:, ndx + j, :ndx] += by_x[1:]
        M[1:, :nu, ndx + j] += by_u[1:]
        M[0, nu + j, :ndx] += by_x[0]
        R[0, :nu, nu + j] += by_u[0]
        R[0, nu + j, :nu] += by_u[0]
        for k in range(j + 1):
            both = _twice(system, centre, (j, k), steps, (X, U, ends), costates, weights)
            for a, b in {(j, k), (k, j)}:
                Q[1:, ndx + a, ndx + b] += both[1:]
                R[0, nu + a, nu + b] += both[0]
    return Curvature(Q, M, R)


def _mixed(
    system: Augmented,
    centre: Array,
    j: int,
    step: float,
    along: tuple[Array, Array, Array],
    costates: Array,
    weights: Array | None,
) -> tuple[Array, Array]:
    """Second derivatives by the value j and (x, u). Shapes (N + 1, ndx), (N, nu)."""
    X, U, _ = along
    by_x, by_u = np.zeros((len(X), system.inner.ndx)), np.zeros((len(U), system.inner.nu))
    for sign in (1.0, -1.0):
        moved = centre.copy()
        moved[j] += sign * step
        engine, share = system.at(moved), sign / (2.0 * step)
        A, B, C, D = engine.linearize_steps(X, U, engine.step_each(X, U)[0])
        by_x[:-1] += share * np.einsum("nij,ni->nj", A, costates[1:])
        by_u += share * np.einsum("nij,ni->nj", B, costates[1:])
        if weights is not None:
            by_x += share * np.einsum("nij,ni->nj", C, weights)
            by_u += share * np.einsum("nij,ni->nj", D[:-1], weights[:-1])
    return by_x, by_u


def _twice(
    system: Augmented,
    centre: Array,
    pair: tuple[int, int],
    steps: Array,
    along: tuple[Array, Array, Array],
    costates: Array,
    weights: Array | None,
) -> Array:
    """Second derivative by two values at every knot. Shape (N + 1,)."""
    X, U, ends = along

    def value(*moves: tuple[int, float]) -> Array:
        moved = centre.copy()
        for j, sign in moves:
            moved[j] += sign * steps[j]
        F, Y = system.at(moved).step_each(X, U)
        total = np.zeros(len(X))
        total[:-1] = np.vecdot(system.inner.difference(ends, F), costates[1:])
        return total if weights is None else total + np.vecdot(Y, weights)

    j, k = pair
    if j == k:
        return (value((j, 1.0)) - 2.0 * value() + value((j, -1.0))) / steps[j] ** 2
    corners = [(a * b) * value((j, a), (k, b)) for a in (1.0, -1.0) for b in (1.0, -1.0)]
    total: Array = np.sum(corners, axis=0) / (4.0 * steps[j] * steps[k])
    return total
