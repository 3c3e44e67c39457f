"""Residuals from what users give: names of outputs, and targets that are numbers, rows a knot, or functions of time."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjslq.dynamics.dynamics import Dynamics
from mjslq.knots import Knots
from mjslq.residuals import ControlResidual, OrientationResidual, OutputResidual, StateResidual
from mjslq.targets import Rows, Timed, unit_quaternions
from mjslq.validation import Array, as_array, choose, per_step_vectors


def bind_state(
    dynamics: Dynamics, target: ArrayLike | Timed | None, knots: Knots, name: str = "target"
) -> StateResidual:
    """Distance of states from `target`: a state, one a knot, one for each of listed knots, or t -> state; zero if None.

    Raises ValueError, which calls the target `name`.
    """
    size, all_knots = dynamics.nx, knots.N + 1
    if callable(target):
        rows = Rows(name, target, knots.times, size)
        return StateResidual(dynamics, rows(), knots, rows)
    if target is None:
        if dynamics.nx != dynamics.ndx:
            raise ValueError(f"{name} must be given: a state with quaternions has no zero to default to")
        target = np.zeros(dynamics.nx)
    array = as_array(name, target)
    count = _count(array, knots, all_knots)
    if array.shape not in ((size,), (count, size)):
        raise ValueError(
            f"{name} must be a state ({size},) or one a knot ({all_knots}, {size}), got shape {array.shape}"
        )
    return StateResidual(dynamics, _at_knots(np.broadcast_to(array, (count, size)), knots.at, len(knots)), knots)


def bind_control(dynamics: Dynamics, target: ArrayLike | Timed, knots: Knots, name: str = "target") -> ControlResidual:
    """Distance of controls from `target`: a number, a control, one a step, one for each listed knot, or t -> u."""
    if len(knots.steps) < len(knots):
        raise ValueError(
            f"when must name steps for controls, 0 to {knots.N - 1}: at the terminal knot {knots.N} there is none"
        )
    return ControlResidual(*_vectors(name, target, knots, knots.N, dynamics.nu))


def bind_output(
    dynamics: Dynamics, output: str, target: ArrayLike | Timed, knots: Knots, name: str = "target"
) -> OutputResidual:
    """Distance of readings from `target`: one, one a knot, one for each of listed knots, or t -> reading."""
    columns, quaternion = dynamics.outputs[choose("sensor", output, dynamics.outputs)]
    kind = OrientationResidual if quaternion else OutputResidual
    return kind(columns, *_vectors(name, target, knots, knots.N + 1, columns.stop - columns.start, quaternion))


def _vectors(
    name: str, target: ArrayLike | Timed, knots: Knots, every: int, size: int, unit: bool = False
) -> tuple[Array, Knots, Rows | None]:
    """A target at each of the knots (k, size), those knots, and the function of time that it comes from."""
    if callable(target):
        rows = Rows(name, target, knots.times, size, unit)
        return rows(), knots, rows
    array = as_array(name, target)
    targets = per_step_vectors(name, array, _count(array, knots, every), size)
    return _at_knots(unit_quaternions(name, targets) if unit else targets, knots.at, len(knots)), knots, None


def _count(target: Array, knots: Knots, every: int) -> int:
    """How many rows a target with one a knot has: one for `every` knot, or one for each of the knots listed."""
    listed = knots.name is None and target.ndim == 2 and len(target) == len(knots)
    return len(knots) if listed else every


def _at_knots(targets: Array, at: slice | NDArray[np.int64], count: int) -> Array:
    return np.array(targets if len(targets) == count else targets[at], order="C")
