"""Checks of an engine's Jacobians against five-point differences of its plain, slow step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mjslq.dynamics.records import Linearization
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.dynamics.dynamics import Dynamics

TOLERANCE = 1e-3
"""Relative error of a Jacobian from which on a knot counts as off."""


@dataclass(frozen=True)
class DerivativeCheck:
    """How far an engine's Jacobians are from a fine reference, over the knots of a trajectory.

    Where a contact opens or closes the step has a kink, and no reference is right on both its sides: a few knots far
    off are a property of the motion. Derivatives are wrong where many knots are.
    """

    errors: dict[str, float]
    """Largest error of A, B (and C, D), relative to the largest entry of the reference."""
    worst: dict[str, tuple[int, int, int]]
    """Where it occurs: (step, row, column)."""
    typical: dict[str, float]
    """Median over the knots of the largest error at each, relative likewise."""
    share: dict[str, float]
    """Share of the knots where it is above `TOLERANCE`."""

    @property
    def suspects(self) -> list[str]:
        """Jacobians that are off at more than a tenth of the knots."""
        return [name for name, share in self.share.items() if share > 0.1]

    @property
    def worst_error(self) -> float:
        """The largest of the errors."""
        return max(self.errors.values(), default=0.0)


def compare_jacobians(given: Linearization, reference: Linearization) -> DerivativeCheck:
    """Relative errors of each Jacobian: the largest and where, the usual, and how widespread."""
    errors, worst, typical, share = {}, {}, {}, {}
    for name, ours, fine in zip(Linearization._fields, given, reference, strict=True):
        if fine.size == 0:
            continue
        error = np.nan_to_num(np.abs(ours - fine) / max(np.abs(fine).max(), 1e-300), nan=np.inf)
        step, row, column = np.unravel_index(int(np.argmax(error)), error.shape)
        by_knot = error.max(axis=(1, 2))
        errors[name], typical[name] = float(error.max()), float(np.median(by_knot))
        worst[name], share[name] = (int(step), int(row), int(column)), float((by_knot > TOLERANCE).mean())
    return DerivativeCheck(errors, worst, typical, share)


def fine_reference(dynamics: Dynamics, trajectory: Trajectory, eps: float = 1e-5) -> Linearization:
    """Jacobians by five-point differences of single steps: slow, and independent of an engine's own; O(eps^4)."""
    N, nu, ny = trajectory.horizon, dynamics.nu, dynamics.ny
    A, B = np.empty((N, dynamics.ndx, dynamics.ndx)), np.empty((N, dynamics.ndx, nu))
    C, D = np.zeros((N + 1, ny, dynamics.ndx)), np.zeros((N + 1, ny, nu))
    X, U = trajectory.X, np.vstack([trajectory.U, np.zeros(nu)])  # outputs at the last knot are read with zero control

    def step(n: int, x: Array, u: Array) -> list[Array]:
        forward, output = dynamics.step(x, u, min(n, N - 1))
        return [dynamics.difference(X[min(n + 1, N)], forward), output]

    def vary_state(n: int, d: Array) -> list[Array]:
        return step(n, dynamics.integrate(X[n], d), U[n])

    def vary_control(n: int, d: Array) -> list[Array]:
        return step(n, X[n], U[n] + d)

    for n in range(N + 1):
        by_x = _five_point(partial(vary_state, n), dynamics.ndx, eps)
        C[n] = by_x[1]
        if n < N:
            A[n] = by_x[0]
            B[n], D[n] = _five_point(partial(vary_control, n), nu, eps)
    return Linearization(A, B, C, D)


def _five_point(function: Callable[[Array], list[Array]], size: int, eps: float) -> list[Array]:
    """Columns of the derivatives of the arrays that `function` returns, at zero."""
    columns: list[list[Array]] = []
    for i in range(size):
        d = np.zeros(size)
        d[i] = eps
        near, far = zip(function(d), function(-d), strict=True), zip(function(2 * d), function(-2 * d), strict=True)
        columns.append([(8.0 * (p - m) - (pp - mm)) / (12.0 * eps) for (p, m), (pp, mm) in zip(near, far, strict=True)])
    if not columns:
        return [part[:, None][:, :0] for part in function(np.zeros(0))]
    return [np.stack(parts, axis=-1) for parts in zip(*columns, strict=True)]
