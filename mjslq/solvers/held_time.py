"""Descents with free final time: first with the time held, then free.

A shorter motion that misses its goal by more is often the nearest way down, and ends where it can no longer be told
that there is a goal at all: at a stationary point of the violation, or of a cost that asks for the goal softly. So the
first descent is one of a fixed time, the start's, or, where the constraints cannot be met in that, `STRETCH` times as
long, `TRIES` times at most. It is a start and no more: it ends loosely, and where the cost leaves controls free it has
their effort in its cost besides,

    1/2 sum_n h_n |u_n / limit|^2.

From where it ends, and with its multipliers, the descent with free time begins, which has the cost as it was stated,
what is left of the iterations and of the time, and alone may say that it has converged.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from mjslq.binding import bind_control
from mjslq.bound_costs import BoundTerm, ResidualCost
from mjslq.knots import knots_of
from mjslq.losses import bind_loss
from mjslq.options import Stopping
from mjslq.problem import Problem
from mjslq.solvers.foresight import descend_with_foresight
from mjslq.solvers.interrupts import Interrupts
from mjslq.solvers.iterate import Iterate
from mjslq.solvers.loop import Outcome, descend
from mjslq.solvers.method import Method
from mjslq.solvers.monitor import Monitor
from mjslq.status import Status
from mjslq.unknowns import Unknowns
from mjslq.validation import Array

STRETCH, TRIES = 1.5, 4
"""Factor from one held time to the next, and how many there are."""
LOOSE, MOST = 1e-3, 150
"""Tolerance of the direction and iterations of a descent with held time."""
FREE = 1e-9
"""Curvature of the cost by a control below which it is left free, relative to the largest, or to 1."""

OVER = (Status.INTERRUPTED, Status.STOPPED, Status.OUT_OF_TIME, Status.FAILED)
"""Endings of a descent with held time after which there is no other."""

Make = Callable[[Mapping[str, Array]], Method]


def descend_with_time_held_first(
    start: Iterate,
    unknowns: Unknowns,
    make: Make,
    given: Mapping[str, Array],
    stopping: Stopping,
    monitor: Monitor,
    interrupts: Interrupts,
) -> Outcome:
    """Descend from `start` in two parts; see the head of this file."""
    size, multipliers, remark = len(unknowns.names), given, ""
    time, here = float(start.trajectory.U[0, -size]), start
    try:
        effort = _effort(start, size)
    except Exception:  # whatever keeps the start from being differentiated: the descent will tell
        return descend_with_foresight(start, lambda: make(given), stopping, monitor, interrupts)
    for _ in range(TRIES):
        problem = unknowns.held(start.problem, time).with_terms(effort)
        loose = dataclasses.replace(
            stopping, tol_direction=max(LOOSE, stopping.tol_direction), max_iterations=_left(stopping, monitor, MOST)
        )
        first = descend(_at(problem, start, size, time), make(given), loose, monitor, interrupts)
        if first.status in OVER or (first.status is Status.MAX_ITERATIONS and not _left(stopping, monitor, 1)):
            if first.status is not Status.FAILED:
                first.iterate = Iterate(start.problem, first.iterate.trajectory)
            first.remark = f"The final time was still held, at {time:.6g} s. {first.remark}"
            return first
        met = first.status is not Status.DIVERGED and not problem.bound_constraints
        if first.status is Status.CONVERGED or met:
            here = Iterate(start.problem, first.iterate.trajectory)
            multipliers, remark = first.duals.multipliers, f"The final time was held for {monitor.steps} iterations."
            break
        longer = min(STRETCH * time, float(unknowns.upper[0]))
        if longer == time or first.status is Status.DIVERGED:
            break
        time = longer
    left = dataclasses.replace(stopping, max_iterations=_left(stopping, monitor, stopping.max_iterations))
    second = descend_with_foresight(here, lambda: make(multipliers), left, monitor, interrupts)
    second.remark = " ".join(part for part in (remark, second.remark) if part)
    return second


def _left(stopping: Stopping, monitor: Monitor, most: int) -> int:
    return min(max(stopping.max_iterations - monitor.steps, 0), most)


def _at(problem: Problem, start: Iterate, size: int, time: float) -> Iterate:
    """The start with another final time."""
    U = start.trajectory.U.copy()
    U[0, -size] = time
    return Iterate(problem, problem.dynamics.rollouts(start.trajectory.X[:1], U[None])[0])


def _effort(start: Iterate, size: int) -> list[BoundTerm]:
    """The effort of controls that the cost leaves free, as a term of the cost; none where it leaves none free."""
    dynamics = start.problem.dynamics
    curvature = np.abs(np.einsum("nii->ni", start.expansion.R)).max(axis=0)[:-size]
    free = curvature <= FREE * max(1.0, float(curvature.max(initial=0.0)))
    if not free.any():
        return []
    limits = np.minimum(*np.abs(start.problem.box)[:, :, :-size]).min(axis=0)
    limits = np.where(np.isfinite(limits) & (limits > 0.0), limits, 1.0)
    W = np.zeros((1, dynamics.nu, dynamics.nu))
    at = np.flatnonzero(free)
    W[0, at, at] = 1.0 / limits[at] ** 2
    steps = np.asarray(start.trajectory.dt)
    residual, loss = bind_control(dynamics, 0.0, knots_of("running", steps)), bind_loss("quadratic", None, W, steps)
    return [ResidualCost(residual, loss, "effort")]
