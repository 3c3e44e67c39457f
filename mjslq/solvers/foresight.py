"""Descents with foresight: first along derivatives that feel contacts from a distance, then along true ones.

With foresight (`Dynamics.foresight`) derivatives are those of another system than the one that is simulated, so that
neither a small gradient nor a lack of descent means anything about the problem. Such a descent is a start: from where
it ends, another one with true derivatives begins, and only that one may say that it has converged. It has what is left
of the iterations and of the time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from mjslq.options import Stopping
from mjslq.solvers.interrupts import Interrupts
from mjslq.solvers.iterate import Iterate
from mjslq.solvers.loop import Outcome, descend
from mjslq.solvers.method import Method
from mjslq.solvers.monitor import Monitor
from mjslq.status import Status

ENDED = (
    Status.CONVERGED, Status.STEP_TOO_SMALL, Status.INFEASIBLE, Status.AT_LIMITS, Status.NO_CONTACT_GRADIENT,
    Status.AT_KINK,
)  # fmt: skip
"""Endings of the first descent after which there is more to be done."""


def descend_with_foresight(
    start: Iterate, make: Callable[[], Method], stopping: Stopping, monitor: Monitor, interrupts: Interrupts
) -> Outcome:
    """Descend from `start` by methods that `make` makes; in two parts where the engine has foresight."""
    problem = start.problem
    distance = problem.dynamics.foresight
    if not distance:
        return descend(start, make(), stopping, monitor, interrupts)
    first = descend(start, make(), stopping, monitor, interrupts)
    told = f"Derivatives with a foresight of {distance:g} m for {monitor.steps} iterations"
    if first.status not in ENDED:
        first.remark = f"{told}. {first.remark}"
        return first
    true = problem.on(problem.dynamics.foreseeing(0.0))
    left = dataclasses.replace(stopping, max_iterations=max(stopping.max_iterations - monitor.steps, 0))
    before = monitor.steps
    second = descend(Iterate(true, first.iterate.trajectory), make(), left, monitor, interrupts)
    second.remark = f"{told}, then {monitor.steps - before} with true ones. {second.remark}"
    return second
