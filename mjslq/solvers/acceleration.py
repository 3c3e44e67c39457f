"""Parallel tangents: a second, cheap line search along the previous change of the controls.

In a long curved valley (contacts that have to move in time make one) steps along the Gauss-Newton direction zigzag
from wall to wall, while the change from one iterate to the next points down the valley. After a step that had to be
shortened, the cost is therefore also searched along

    U_k + beta (U_k - U_{k-1}),    beta = 1, 2, 4, ... while the cost falls, or -1, or a small fraction,

by rollouts alone: no derivative is needed, so that an iteration costs a few rollouts more. The cost only ever
falls further, which leaves Theorem 2 (convergence) of Sideris and Bobrow 2005 as it is.

Source: Shah, Buehler and Kempthorne 1964, "Some algorithms for minimizing a function of several variables".
"""

from __future__ import annotations

from mjslq.solvers.iterate import Iterate
from mjslq.validation import Array

SMALL = 0.3
"""Fraction tried where the whole previous change does not help."""
LONGEST = 1024.0
"""Multiple of the previous change beyond which no step goes."""


def accelerate(here: Iterate, change: Array) -> tuple[Iterate, int]:
    """Search from `here` along `change` (N, nu); return the best iterate found and the rollouts spent."""
    spent = 0

    def phi(beta: float) -> Iterate:
        nonlocal spent
        spent += 1
        U = here.problem.box.clip(here.trajectory.U + beta * change)
        x0 = here.trajectory.X[:1]
        return Iterate(here.problem, here.problem.dynamics.rollouts(x0, U[None])[0])

    for sign in (1.0, -1.0):
        best, beta = here, sign
        while abs(beta) <= LONGEST and (there := phi(beta)).cost < best.cost:
            best, beta = there, 2.0 * beta
        if best is here and (there := phi(sign * SMALL)).cost < here.cost:
            best = there
        if best is not here:
            return best, spent
    return here, spent
