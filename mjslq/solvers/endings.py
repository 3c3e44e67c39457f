"""Endings told apart that look alike: a stationary point from which nothing is felt, a search that only limits end.

No contact gradient
-------------------
    r_0 = 0,   r_{n+1} = A_n r_n  or  B_n       (patterns: which directions of the state any control can move)

Directions outside of r at every knot belong to bodies that nothing driven touches. If the quadratic model says that the
cost would fall by a good share of itself if these could be moved,

    sum_n 1/2 q_b' Q_bb^+ q_b  >  `WORTH` J            b: the directions that nothing moves

then a zero gradient means that nothing is felt, not that nothing is to be gained.
"""

from __future__ import annotations

import numpy as np

from mjslq.solvers.iterate import Iterate
from mjslq.status import Status

WORTH = 0.1
"""Share of the cost."""
MOSTLY = 0.9
"""Share of the controls at their limits from which on these are what ends a search."""


def told_apart(status: Status, here: Iterate) -> Status:
    """The ending of a descent at `here`, as the head of this file says."""
    if status is Status.CONVERGED and feels_nothing(here):
        return Status.NO_CONTACT_GRADIENT
    if status is Status.STEP_TOO_SMALL and at_limits(here) >= MOSTLY:
        return Status.AT_LIMITS
    return status


def at_limits(here: Iterate) -> float:
    """Share of the controls, of those that have limits, that are at one of them."""
    box, U = here.problem.box, here.trajectory.U
    limited = np.isfinite(box.lower) | np.isfinite(box.upper)
    return float(((box.lower >= U) | (box.upper <= U))[limited].mean()) if limited.any() else 0.0


def feels_nothing(here: Iterate) -> bool:
    """Whether much of the cost is about bodies that nothing driven touches."""
    if here.problem.dynamics.contact is None or here.gaps is not None or not here.cost > 0.0:
        return False
    A, B = here.linearization.A, here.linearization.B
    reached = np.zeros(A.shape[1], bool)
    for step, driven in zip(A != 0.0, (B != 0.0).any(axis=2), strict=True):
        reached = reached | (step @ reached) | driven
        if reached.all():
            return False
    apart = ~reached
    q, Q = here.expansion.q[:, apart], here.expansion.Q[:, apart][:, :, apart]
    gain = 0.5 * np.einsum("ni,nij,nj->", q, np.linalg.pinv(Q, hermitian=True), q)
    return bool(gain > WORTH * here.cost)
