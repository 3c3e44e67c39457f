"""The constraints of a problem at an iterate, entry by entry, as rows of an LQ problem.

Notation
--------
    w_i                     an entry of a constraint's residual at a knot, or a control that has limits
    [lower_i, upper_i]      its interval; equal for an equality
    H_i dx_n + C_i du_n     its change to first order, n its step; n = N for rows on the final state
    J + sum_i mu_i w_i      the Lagrangian: mu_i >= 0 at an upper limit, <= 0 at a lower one
    Z                       changes of the controls, and of free entries of x_0, that leave the rows in force as they
                            are, to first order

The *projected gradient* is the part of dJ/dU that lies in Z. It comes from one square-root sweep,

    minimize  sum_n g'dz_n + 1/2 |du_n|^2 + 1/2 |dx_0|^2   subject to   H_i dx_n + C_i du_n = 0    for the rows in force

with dx_0 = 0 where the initial state is given. The minimizer (du, dx_0) is minus the projected gradient, and the
multipliers are mu. Rows in force are the equalities and
the limits that are touched; those with multipliers of the wrong sign are left out, and the sweep is made again. Where
constraints are met and the projected gradient is zero, the first-order conditions of the problem hold.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjslq.constraints import RESERVED
from mjslq.lq import square_root
from mjslq.lq.problem import LQProblem
from mjslq.lq.square_root import PathRows, StateRows
from mjslq.problem import Problem
from mjslq.residuals import IDENTITY, Identity
from mjslq.solvers.iterate import Iterate
from mjslq.solvers.method import Duals
from mjslq.validation import Array

TOUCHED = 1e-6
"""Distance from a limit, relative to the limit's size, up to which it counts as touched."""
WRONG = 1e-9
"""Multiplier of the wrong sign, relative to the largest one, that is taken for rounding."""


class Rows(NamedTuple):
    """All entries that have a limit, in the order of the problem's constraints; controls are last."""

    value: Array
    """w_i. Shape (m,)."""
    lower: Array
    """Shape (m,)."""
    upper: Array
    """Shape (m,)."""
    step: NDArray[np.int64]
    """n, or N. Shape (m,)."""
    H: Array
    """Shape (m, ndx)."""
    C: Array
    """Shape (m, nu)."""
    owner: NDArray[np.int64]
    """Number of the constraint; that of constraints in all for limits of the controls. Shape (m,)."""
    place: NDArray[np.int64]
    """Place of the entry in the constraint's array (k, m) or among the controls (N, nu), flattened. Shape (m,)."""
    movable: NDArray[np.bool_]
    """Which depend on unknowns: what an initial state that is given decides does not. Shape (m,)."""

    @property
    def equality(self) -> NDArray[np.bool_]:
        """Which are equalities. Shape (m,)."""
        return self.lower == self.upper

    @property
    def violation(self) -> Array:
        """Shape (m,)."""
        return np.maximum(np.maximum(self.lower - self.value, self.value - self.upper), 0.0)

    @property
    def nearest(self) -> Array:
        """The limit that is violated, or that w_i is nearer to. Shape (m,)."""
        high = np.abs(self.value - self.upper) <= np.abs(self.value - self.lower)
        return np.where(high, self.upper, self.lower)

    @property
    def size(self) -> Array:
        """Size of the nearest limit; 1 where it is zero. Shape (m,)."""
        size = np.abs(self.nearest)
        return np.where(size > 0.0, size, 1.0)

    def taken(self, chosen: NDArray[np.bool_]) -> Rows:
        """Some of the rows."""
        columns: Any = [column[chosen] for column in self]
        return Rows(*columns)


def rows_of(here: Iterate) -> Rows:
    """The rows at an iterate, limits of the controls included."""
    problem, trajectory = here.problem, here.trajectory
    (N, nu), ndx = trajectory.U.shape, problem.dynamics.ndx
    free = free_start(problem)
    parts = [_control_rows(here, len(problem.bound_constraints))]
    for owner, constraint in reversed(list(enumerate(problem.bound_constraints))):
        residual = constraint.residual
        k, m = constraint.lower.shape
        J = residual.jacobian(trajectory, here.linearization)
        step = np.repeat(residual.knots.indices, m).astype(np.int64)
        C = _dense(J.u, k, m, nu)
        C[step == N] = 0.0
        lower, upper = constraint.lower.ravel(), constraint.upper.ravel()
        H = _dense(J.x, k, m, ndx)
        movable = (step > 0) | (C != 0.0).any(axis=1) | (H[:, free] != 0.0).any(axis=1)
        rows = Rows(
            residual.value(trajectory).ravel(), lower, upper, step, H, C, np.full(k * m, owner), np.arange(k * m),
            movable,
        )  # fmt: skip
        parts.insert(0, rows.taken(np.isfinite(lower) | np.isfinite(upper)))
    columns: Any = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Rows(*columns)


def _control_rows(here: Iterate, owner: int) -> Rows:
    U, box = here.trajectory.U, here.problem.box
    (N, nu), ndx = U.shape, here.problem.dynamics.ndx
    lower, upper = box.lower.ravel(), box.upper.ravel()
    step, size = np.repeat(np.arange(N), nu), N * nu
    C = np.tile(np.eye(nu), (N, 1))
    owners, movable = np.full(size, owner), np.ones(size, np.bool_)
    rows = Rows(U.ravel(), lower, upper, step, np.zeros((size, ndx)), C, owners, np.arange(size), movable)
    return rows.taken(np.isfinite(lower) | np.isfinite(upper))


def _dense(J: Array | Identity | None, k: int, m: int, n: int) -> Array:
    """A Jacobian as an array of its own. Shape (k * m, n)."""
    if J is None:
        return np.zeros((k * m, n))
    if J is IDENTITY:
        return np.tile(np.eye(n), (k, 1))
    assert isinstance(J, np.ndarray)
    return np.array(np.broadcast_to(J, (k, m, n)), dtype=np.float64).reshape(k * m, n)


def free_start(problem: Problem) -> NDArray[np.bool_]:
    """Which tangent directions of the initial state are unknown. Shape (ndx,)."""
    none = np.zeros(problem.dynamics.ndx, np.bool_)
    return none if problem.free_start is None else np.asarray(problem.free_start)


def split(rows: Rows, d: Array, N: int) -> tuple[PathRows, StateRows]:
    """Rows with the right-hand sides `d` (m,), as path rows and terminal rows; the order is kept among each."""
    end = rows.step == N
    on_path = PathRows(rows.step[~end], rows.H[~end], rows.C[~end], d[~end])
    return on_path, StateRows(rows.H[end], d[end])


class ConstrainedIterate(Iterate):
    """An iterate whose gradient is projected as the head of this file says."""

    @cached_property
    def rows(self) -> Rows:
        """All rows."""
        return rows_of(self)

    @property
    def violation(self) -> float:
        """The largest violation, limits of the controls included."""
        return float(self.rows.violation.max(initial=0.0))

    @cached_property
    def _projection(self) -> tuple[Array, Array, Array]:
        """The projected gradient by the controls (N, nu) and by the initial state (ndx,), and mu of all rows (m,)."""
        rows, model = self.rows, self.gauss_newton
        high = np.abs(rows.value - rows.upper) <= TOUCHED * rows.size
        low = np.abs(rows.value - rows.lower) <= TOUCHED * rows.size
        in_force = (rows.equality | high | low) & rows.movable
        sign = np.where(rows.equality, 0, np.where(high, 1, -1))
        flat, free = _metric(model), free_start(self.problem)
        initial = StateRows(np.eye(len(free)), np.zeros(len(free)), free.astype(np.float64))
        while True:  # ends, since each time there are fewer rows
            chosen = rows.taken(in_force)
            path, terminal = split(chosen, np.zeros(len(chosen.value)), len(model.B))
            found = square_root.solve(flat, path, terminal, initial if free.any() else None)
            mu, end = np.zeros(len(chosen.value)), chosen.step == len(model.B)
            mu[end], mu[~end] = found.nu_terminal, found.mu
            wrong = sign[in_force] * mu < -WRONG * np.abs(mu).max(initial=0.0)
            if not wrong.any():
                break
            in_force[np.flatnonzero(in_force)[wrong]] = False
        multipliers = np.zeros(len(rows.value))
        multipliers[in_force] = mu
        return -found.U, np.where(free, -found.X[0], 0.0), multipliers

    @cached_property
    def projected_gradient(self) -> Array:
        """dJ/dU without what constraints in force take of it. Shape (N, nu)."""
        return self._projection[0]

    @property
    def start_gradient(self) -> Array:
        """dJ/dx_0 by the entries that are free, without what constraints in force take of it. Shape (ndx,)."""
        return self._projection[1]

    @property
    def duals(self) -> Duals:
        """Multipliers and violations by the constraint's name."""
        problem, mu, rows = self.problem, self._projection[2], self.rows
        multipliers = {}
        shapes = {constraint.name: constraint.lower.shape for constraint in problem.bound_constraints}
        for owner, (name, shape) in enumerate((shapes | {RESERVED: self.trajectory.U.shape}).items()):
            if name == RESERVED and not problem.box.bounded:
                continue
            flat, own = np.zeros(shape), rows.owner == owner
            flat.flat[rows.place[own]] = mu[own]
            multipliers[name] = flat
        return Duals(multipliers, problem.violations(self.trajectory), problem.violation(self.trajectory))


def _metric(model: LQProblem) -> LQProblem:
    """The gradient of a cost with the identity for its Hessian by the controls."""
    R = np.tile(np.eye(model.B.shape[2]), (len(model.B), 1, 1))
    zero = np.zeros_like
    return LQProblem(model.A, model.B, zero(model.Q), R, zero(model.M), model.q, model.r, zero(model.c))
