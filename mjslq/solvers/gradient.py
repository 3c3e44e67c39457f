"""`gradient`: steepest descent with a line search, exact unless told otherwise: the yardstick of the papers.

    U <- [ U - t dJ/dU ],    t > 0 the minimizer of the cost along the ray, clipped to the limits of the controls

The gradient comes from the adjoint recursion (Sideris and Bobrow 2005, (8)-(10)). The search is over (0, 1] of a
direction that is four times as long as the step before, and over four times as much while the minimum lies at the
border; the first direction is as long as the controls, or one. Steps are open loop: there is no feedback to go with
a gradient, and the result has no gains.
"""

from __future__ import annotations

import numpy as np

from mjslq.options import GradientOptions, Search
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Method, Step
from mjslq.solvers.steps import LineSearch

GROWTH = 4.0
"""Length offered to the search, relative to the step taken before."""
BORDER = 0.99
"""Step of a search whose minimum lies at its border, or beyond."""
LONGEST = 1e6
"""Multiple of the first length offered beyond which no step goes."""


class Gradient(Method):
    """Steepest descent; keeps the step length that the next search begins with."""

    tests_direction = False  # its length says nothing here

    def __init__(self, options: GradientOptions) -> None:
        self.search = LineSearch(Search(line_search=options.line_search, step="open-loop", acceleration=False))
        self._length: float | None = None

    def direction(self, here: Iterate) -> Direction:
        """The projected gradient, as long as the search is to reach."""
        if self._length is None:
            self._length = max(1.0, float(np.linalg.norm(here.trajectory.U)))
        change = -self._length / max(here.gradient_norm, 1e-300) * here.projected_gradient
        expected = float(np.vdot(here.gradient, change))
        held = here.box.pushed(np.zeros_like(change), here.gradient)
        return Direction(here.gauss_newton.states(change), change, change, None, expected, held)

    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """Search, further out while the minimum lies at the border."""
        best, spent, reach = Step(None), 0, 1.0
        while reach < LONGEST:
            found = self.search(here, direction._replace(U=reach * direction.U), merit)
            spent += found.rollouts
            if found.iterate is None or (best.iterate is not None and found.iterate.cost >= best.iterate.cost):
                break
            best = Step(found.iterate, reach * found.alpha)
            if found.alpha < BORDER:
                break
            reach *= GROWTH
        if best.iterate is not None and self._length is not None:
            self._length *= GROWTH * best.alpha
        return Step(best.iterate, best.alpha, spent)
