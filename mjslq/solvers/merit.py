"""Merit functions, which a step has to lower: the cost, and weighted gaps of a state guess beside it.

    phi = J + nu sum_n |c_n|_1,     nu at least twice the largest costate, so that phi falls along the sweep's step:
    phi' = q'x_bar + r'u_bar - nu sum_n |c_n|_1

Without gaps phi is the cost, and phi' = (dJ/dU)'u_bar + (dJ/dx_0)'x_bar_0.

Source: Nocedal and Wright, Numerical Optimization, section 18.3 (the l1 merit function).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from mjslq.solvers.iterate import Direction, Iterate


class Merit(Protocol):
    """A function of iterates that the steps of a method lower."""

    def value(self, iterate: Iterate) -> float:
        """phi; infinite for an iterate that diverged."""

    def slope(self, here: Iterate, direction: Direction) -> float:
        """phi', its derivative along a direction."""

    def update(self, here: Iterate, direction: Direction) -> None:
        """Take in what a new direction tells, such as the size of the costates."""


class CostAndGaps:
    """The merit function at the head of this file."""

    def __init__(self) -> None:
        self.weight = 0.0
        """nu."""

    def value(self, iterate: Iterate) -> float:
        """See `Merit`."""
        if iterate.gaps is None or not np.isfinite(iterate.cost):
            return iterate.cost
        return iterate.cost + self.weight * float(np.abs(iterate.gaps).sum())

    def slope(self, here: Iterate, direction: Direction) -> float:
        """See `Merit`."""
        if here.gaps is None:
            return here.slope_along(direction)
        model = here.gauss_newton
        along = float(np.vdot(model.q, direction.X) + np.vdot(model.r, direction.U))
        return along - self.weight * float(np.abs(here.gaps).sum())

    def update(self, here: Iterate, direction: Direction) -> None:
        """See `Merit`."""
        if here.gaps is not None:
            self.weight = max(self.weight, 2.0 * float(np.abs(direction.costates).max()))
