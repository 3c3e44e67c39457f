"""`gradient`: steepest descent with exact line search, the yardstick of the papers.

    U <- U - t dJ/dU,    t > 0 the minimizer of the cost along the ray

The gradient comes from the adjoint recursion (Sideris and Bobrow 2005, (8)-(10)). The search is over (0, 1] of a
direction that is four times as long as the step before, and over four times as much while the minimum lies at the
border; the first direction is as long as the controls, or one. Steps are open-loop: there is no feedback to go with
a gradient, and the gains of the result are zero.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from mjslq.solvers.advance import line_searching
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.loop import Accepted, Monitor, Outcome, Stopping, descend

GROWTH = 4.0
"""Length offered to the search, relative to the step taken before."""
BORDER = 0.99
"""Step of a search whose minimum lies at its border, or beyond."""
LONGEST = 1e6
"""Multiple of the first length offered beyond which no step goes."""


def gradient(start: Iterate, stopping: Stopping, monitor: Monitor) -> Outcome:
    """Minimize from `start`. The direction's length says nothing here: only the gradient's ends the search."""
    search = line_searching(start, "exact", "open-loop", False)
    length = max(1.0, float(np.linalg.norm(start.trajectory.U)))

    def direction(here: Iterate) -> Direction:
        N, nu = here.trajectory.U.shape
        change = -length / max(here.gradient_norm, 1e-300) * here.gradient
        return Direction(change, change, np.zeros((N, nu, here.problem.dynamics.ndx)))

    def advance(here: Iterate, ahead: Direction) -> tuple[Accepted | None, int]:
        nonlocal length
        accepted, total, reach = None, 0, 1.0
        while reach < LONGEST:
            found, spent = search(here, ahead._replace(U=reach * ahead.U))
            total += spent
            if found is None or (accepted is not None and found.iterate.cost >= accepted.iterate.cost):
                break
            accepted = Accepted(reach * found.alpha, found.iterate)
            if found.alpha < BORDER:
                break
            reach *= GROWTH  # the minimum is further out
        if accepted is not None:
            length *= GROWTH * accepted.alpha
        return accepted, total

    return descend(start, direction, advance, dataclasses.replace(stopping, tol_direction=0.0), monitor)
