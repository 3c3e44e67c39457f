"""Checks of an engine's Jacobians against differences of its plain, slow step.

Notation
--------
    J                 a Jacobian of the step or of the outputs; j one of its entries
    j_0               five-point difference, O(eps^4)
    j_-, j_+          one-sided differences to either side, O(eps^2)

An entry is off where |j - j_0| > `TOLERANCE` max|J_0|. There the one-sided differences decide, taken with several eps:

    kink        they differ, as where a contact opens, a joint stands at its limit or a control at its own, and j is one
                of the two or lies between them, for some eps: a kink may be close by
    jump        on a side they have no limit, and grow with 1/eps, since the step itself jumps there, or within eps: two
                capsules that lie parallel, whose contacts come and go, or a collision found by iteration. From each eps
                to the next they change by more than a third of what j is off, and once they grow threefold
    unsolved    they are those of a constraint solver that stops at its tolerance before its solution is there, and j
                is the derivative of the solution itself (`Dynamics.fully_solved`)
    wrong       else: j agrees with neither side
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

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
_NOTHING = 1e-9
"""Largest entry of a Jacobian from which on it counts as more than the rounding of its differences."""
_REACH = 3.0
_REASONS = ("kinks", "jumps", "unsolved")

Flags = np.ndarray[tuple[int], np.dtype[np.bool_]]
Sides = Callable[[str, int, int], "list[tuple[Array, Array]]"]
"""sides(name, step, column) -> the column (j_-, j_+) of a Jacobian, for each step size."""


@dataclass(frozen=True)
class DerivativeCheck:
    """How far an engine's Jacobians are from a fine reference, over the knots of a trajectory.

    A knot that is off is at a kink of the step, where two one-sided derivatives differ and the Jacobian agrees with one
    of them or lies between; or at a jump, where the step has no derivative; or its constraint solver stops short of the
    solution; or its Jacobian is wrong.

    Examples
    --------
    >>> system = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0]]), nx=2, nu=1, dt=0.1)
    >>> check = system.check_derivatives(system.rollout([0.0, 1.0], np.zeros((10, 1))))
    >>> check.suspects, check.verdict
    ([], 'the Jacobians agree with the differences at all knots')
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
    jumps: dict[str, tuple[int, ...]] = field(default_factory=dict)
    """Knots where it is above `TOLERANCE`, and one-sided differences grow as they get smaller: the step jumps."""
    unsolved: dict[str, tuple[int, ...]] = field(default_factory=dict)
    """Knots where it is above `TOLERANCE`, but right for a constraint solver that converges."""
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
        sentences = [sentence for reason in _REASONS if (sentence := self._told(reason))]
        return "; ".join(sentences) or "the Jacobians agree with the differences at all knots"

    def _told(self, reason: str) -> str:
        """Sentence on the knots that are off for a reason; empty where there are none."""
        by_name: dict[str, tuple[int, ...]] = getattr(self, reason)
        knots, names = set().union(*by_name.values()), ", ".join(name for name, found in by_name.items() if found)
        many = f"at {len(knots)} of {max(self.knots.values(), default=0)} knots"
        sentences = {
            "kinks": f"a kink {many}: there the one-sided differences of the step differ, as at joint limits, control "
            f"limits and contacts that open or close, and {names} agrees with one of them or lies between",
            "jumps": f"a jump {many}: there the step has no derivative, as where parallel geoms gain a contact, and "
            f"the differences that {names} is compared with grow as their step shrinks",
            "unsolved": f"a constraint solver cut short {many}: there it stops at its tolerance before it has "
            f"converged, and {names} is the derivative of the converged step; a smaller tolerance in <option> helps",
        }
        return sentences[reason] if knots else ""


def check_jacobians(dynamics: Dynamics, trajectory: Trajectory) -> DerivativeCheck:
    """Compare `linearize` with a fine reference, and with one-sided differences where these disagree."""
    given, reference = dynamics.linearize(trajectory), fine_reference(dynamics, trajectory)
    solved = dynamics.fully_solved()
    solved_sides = None if solved is None else partial(_sides, solved, trajectory)
    return compare_jacobians(given, reference, partial(_sides, dynamics, trajectory), solved_sides)


def compare_jacobians(
    given: Linearization, reference: Linearization, sides: Sides | None = None, solved_sides: Sides | None = None
) -> DerivativeCheck:
    """Relative errors of each Jacobian: the largest and where, the usual, and how widespread.

    Without `sides` every knot that is off counts as wrong; `solved_sides` are those of a converged constraint solver.
    """
    names = ("errors", "worst", "typical", "share", *_REASONS, "wrong", "knots")
    found: dict[str, dict[str, Any]] = {name: {} for name in names}
    for name, ours, fine in zip(Linearization._fields, given, reference, strict=True):
        if fine.size == 0:
            continue
        scale = max(np.abs(fine).max(), _NOTHING)
        error = np.nan_to_num(np.abs(ours - fine) / scale, nan=np.inf)
        off = error > TOLERANCE
        excused = {reason: np.zeros_like(off) for reason in _REASONS}
        if sides is not None:
            for step, column in np.argwhere(off.any(axis=1)):
                here = off[step, :, column]
                verdicts = _reasons(name, step, column, ours[step, :, column], here, scale, sides, solved_sides)
                for reason, verdict in zip(_REASONS, verdicts, strict=True):
                    excused[reason][step, :, column] = here & verdict
        bad = off & ~np.logical_or.reduce(list(excused.values()))
        counted = np.where(bad, error, 0.0) if bad.any() else error
        place = np.unravel_index(int(np.argmax(counted)), error.shape)
        found["errors"][name], found["typical"][name] = float(error[place]), float(np.median(error.max(axis=(1, 2))))
        found["worst"][name] = tuple(map(int, place))
        found["share"][name], found["knots"][name] = float(off.any(axis=(1, 2)).mean()), len(fine)
        wrong_knots = bad.any(axis=(1, 2))
        found["wrong"][name] = tuple(np.flatnonzero(wrong_knots).tolist())
        for reason, entries in excused.items():
            found[reason][name] = tuple(np.flatnonzero(entries.any(axis=(1, 2)) & ~wrong_knots).tolist())
    return DerivativeCheck(**found)


def _reasons(
    name: str,
    step: int,
    column: int,
    ours: Array,
    off: Flags,
    scale: float,
    sides: Sides,
    solved_sides: Sides | None,
) -> tuple[Flags, Flags, Flags]:
    """Which entries of a column are at a kink, at a jump, or right for a converged constraint solver."""
    pairs = sides(name, step, column)
    kinks = _explained(ours, pairs, TOLERANCE * scale)
    jumps = ~kinks & _in_a_jump(ours, pairs)
    unsolved = np.zeros_like(kinks)
    if solved_sides is not None and (off & ~kinks & ~jumps).any():
        unsolved = ~kinks & ~jumps & _explained(ours, solved_sides(name, step, column), TOLERANCE * scale)
    return kinks, jumps, unsolved


def _explained(ours: Array, pairs: list[tuple[Array, Array]], tolerance: float) -> Flags:
    """Which entries of a column agree with a one-sided difference, or lie between the two, for some step size."""
    found = np.zeros(len(ours), bool)
    for left, right in pairs:
        found |= (ours >= np.minimum(left, right) - tolerance) & (ours <= np.maximum(left, right) + tolerance)
    return found


def _in_a_jump(ours: Array, pairs: list[tuple[Array, Array]]) -> Flags:
    """Which entries have differences, on either side, that change too much with their size to be told from.

    From each size to the next by a third or more of what the entry is off, and once they grow threefold or more.
    """
    found = np.zeros(len(ours), bool)
    for side in (0, 1):
        rough, grown = np.ones(len(ours), bool), np.zeros(len(ours), bool)
        for wide, narrow in itertools.pairwise(pair[side] for pair in pairs):
            rough &= np.abs(ours - wide) < _REACH * np.abs(wide - narrow)
            grown |= np.abs(narrow) > _REACH * np.abs(wide)
        found |= rough & grown
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

    At the last knot there are outputs alone, read at its own time and with zero control.
    """
    N, X = trajectory.horizon, trajectory.X
    if n == N:
        return [np.zeros(dynamics.ndx), _last_outputs(dynamics, trajectory, d)]
    x, u = X[n], trajectory.U[n]
    if varied == "x":
        x = dynamics.integrate(x, d)
    else:
        u = u + d
    forward, output = dynamics.step(x, u, n)
    return [dynamics.difference(X[n + 1], forward), output]


def _last_outputs(dynamics: Dynamics, trajectory: Trajectory, d: Array) -> Array:
    """Outputs at the last knot, whose state is moved by d: `step` has none at its time, and `step_each` reads all."""
    if not dynamics.ny:
        return np.zeros(0)
    X = trajectory.X.copy()
    X[-1] = dynamics.integrate(X[-1], d)
    return dynamics.step_each(X, trajectory.U)[1][-1]


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
