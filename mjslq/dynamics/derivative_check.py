"""Checks of an engine's Jacobians against differences of its plain, slow step.

Notation
--------
    J                 a Jacobian of the step or of the outputs; j one of its entries
    j_0               five-point difference, O(eps^4)
    j_-, j_+          one-sided differences to either side, O(eps^2)

An entry is off where |j - j_0| > `TOLERANCE` max|J_0|. There the one-sided differences decide: at a kink, as where a
contact opens, a joint stands at its limit or a control at its own, they differ, and j is one of the two or lies
between them; a wrong derivative does not, whatever the side. They are taken with several eps, since a kink may be close
by, and the step of a constraint solver is not smooth to the last digit: one that agrees is enough.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
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
ONE_SIDED = (1e-5, 1e-6, 1e-7)
"""Steps of the one-sided differences."""

Sides = Callable[[str, int, int], "list[tuple[Array, Array]]"]
"""sides(name, step, column) -> the column (j_-, j_+) of a Jacobian, for each step size."""


@dataclass(frozen=True)
class DerivativeCheck:
    """How far an engine's Jacobians are from a fine reference, over the knots of a trajectory.

    A knot that is off is either at a kink of the step, where two one-sided derivatives differ and the Jacobian agrees
    with one of them or lies between, or its Jacobian is wrong.
    """

    errors: dict[str, float]
    """Largest error of A, B (and C, D), relative to the largest entry of the reference; of a Jacobian that is wrong,
    the largest among the wrong entries."""
    worst: dict[str, tuple[int, int, int]]
    """Where it occurs: (step, row, column)."""
    typical: dict[str, float]
    """Median over the knots of the largest error at each, relative likewise."""
    share: dict[str, float]
    """Share of the knots where it is above `TOLERANCE`."""
    kinks: dict[str, tuple[int, ...]] = field(default_factory=dict)
    """Knots where it is above `TOLERANCE`, and only because of a kink."""
    wrong: dict[str, tuple[int, ...]] = field(default_factory=dict)
    """Knots where it is above `TOLERANCE` and agrees with neither one-sided difference."""
    knots: dict[str, int] = field(default_factory=dict)
    """How many knots it has."""

    @property
    def suspects(self) -> list[str]:
        """Jacobians that are wrong at some knot."""
        return [name for name, knots in self.wrong.items() if knots]

    @property
    def worst_error(self) -> float:
        """The largest of the errors."""
        return max(self.errors.values(), default=0.0)

    @property
    def verdict(self) -> str:
        """What the check found, in a sentence."""
        if self.suspects:
            found = ", ".join(
                f"{name} at {len(self.wrong[name])} of {self.knots[name]} knots" for name in self.suspects
            )
            return f"wrong derivatives: {found} agrees with neither one-sided difference of the step"
        kinks = sorted(set().union(*self.kinks.values()))
        if kinks:
            names = ", ".join(name for name, knots in self.kinks.items() if knots)
            return (
                f"a kink at {len(kinks)} of {max(self.knots.values())} knots: there the one-sided differences of the "
                f"step differ, as at joint limits, control limits and contacts that open or close, and {names} agrees "
                "with one of them or lies between"
            )
        return "the Jacobians agree with the differences at all knots"


def check_jacobians(dynamics: Dynamics, trajectory: Trajectory) -> DerivativeCheck:
    """Compare `linearize` with a fine reference, and with one-sided differences where these disagree."""
    given, reference = dynamics.linearize(trajectory), fine_reference(dynamics, trajectory)
    return compare_jacobians(given, reference, partial(_sides, dynamics, trajectory))


def compare_jacobians(given: Linearization, reference: Linearization, sides: Sides | None = None) -> DerivativeCheck:
    """Relative errors of each Jacobian: the largest and where, the usual, and how widespread.

    Without `sides` every knot that is off counts as wrong.
    """
    errors, worst, typical, share, kinks, wrong, knots = {}, {}, {}, {}, {}, {}, {}
    for name, ours, fine in zip(Linearization._fields, given, reference, strict=True):
        if fine.size == 0:
            continue
        scale = max(np.abs(fine).max(), 1e-300)
        error = np.nan_to_num(np.abs(ours - fine) / scale, nan=np.inf)
        off = error > TOLERANCE
        bad = off.copy()
        if sides is not None:
            for step, column in np.argwhere(off.any(axis=1)):
                pairs = sides(name, int(step), int(column))
                bad[step, :, column] &= ~_explained(ours[step, :, column], pairs, TOLERANCE * scale)
        counted = np.where(bad, error, 0.0) if bad.any() else error
        place = np.unravel_index(int(np.argmax(counted)), error.shape)
        by_knot, off_knots, bad_knots = error.max(axis=(1, 2)), off.any(axis=(1, 2)), bad.any(axis=(1, 2))
        errors[name], typical[name] = float(error[place]), float(np.median(by_knot))
        worst[name], share[name] = (int(place[0]), int(place[1]), int(place[2])), float(off_knots.mean())
        kinks[name] = tuple(np.flatnonzero(off_knots & ~bad_knots).tolist())
        wrong[name] = tuple(np.flatnonzero(bad_knots).tolist())
        knots[name] = len(fine)
    return DerivativeCheck(errors, worst, typical, share, kinks, wrong, knots)


def _explained(
    ours: Array, pairs: list[tuple[Array, Array]], tolerance: float
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which entries of a column agree with a one-sided difference, or lie between the two, for some step size."""
    found = np.zeros(len(ours), bool)
    for left, right in pairs:
        found |= (ours >= np.minimum(left, right) - tolerance) & (ours <= np.maximum(left, right) + tolerance)
    return found


def fine_reference(dynamics: Dynamics, trajectory: Trajectory, eps: float = 1e-5) -> Linearization:
    """Jacobians by five-point differences of single steps: slow, and independent of an engine's own; O(eps^4)."""
    N, nu, ny = trajectory.horizon, dynamics.nu, dynamics.ny
    A, B = np.empty((N, dynamics.ndx, dynamics.ndx)), np.empty((N, dynamics.ndx, nu))
    C, D = np.zeros((N + 1, ny, dynamics.ndx)), np.zeros((N + 1, ny, nu))
    for n in range(N + 1):
        by_x = _five_point(partial(_step_beside, dynamics, trajectory, "x", n), dynamics.ndx, eps)
        C[n] = by_x[1]
        if n < N:
            A[n] = by_x[0]
            B[n], D[n] = _five_point(partial(_step_beside, dynamics, trajectory, "u", n), nu, eps)
    return Linearization(A, B, C, D)


def _step_beside(dynamics: Dynamics, trajectory: Trajectory, varied: str, n: int, d: Array) -> list[Array]:
    """Next state, as a direction from the trajectory's, and outputs, of knot n whose state or control is moved by d.

    Outputs at the last knot are read with zero control.
    """
    N, X = trajectory.horizon, trajectory.X
    x, u = X[n], trajectory.U[n] if n < N else np.zeros(dynamics.nu)
    if varied == "x":
        x = dynamics.integrate(x, d)
    else:
        u = u + d
    forward, output = dynamics.step(x, u, min(n, N - 1))
    return [dynamics.difference(X[min(n + 1, N)], forward), output]


def _sides(dynamics: Dynamics, trajectory: Trajectory, name: str, n: int, column: int) -> list[tuple[Array, Array]]:
    """Column of a Jacobian by one-sided differences, second order, to either side, for each of `ONE_SIDED`."""
    varied, part = ("x", "AC".index(name)) if name in "AC" else ("u", "BD".index(name))
    d, pairs = np.zeros(dynamics.ndx if varied == "x" else dynamics.nu), []

    def value(size: float) -> Array:
        d[column] = size
        return _step_beside(dynamics, trajectory, varied, n, d)[part]

    here = value(0.0)
    for eps in ONE_SIDED:
        left, right = ((4.0 * value(e) - value(2.0 * e) - 3.0 * here) / (2.0 * e) for e in (-eps, eps))
        pairs.append((left, right))
    return pairs


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
