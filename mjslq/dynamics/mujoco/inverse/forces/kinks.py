"""Derivatives of piecewise laws at the points where their pieces meet.

Notation
--------
    f'(x+), f'(x-)    the two one-sided derivatives; they differ at a kink
    f'(x)             the mean of the two, which is what a centred difference gives as well

So a spring at the edge of its dead band has half its stiffness, and a spring whose dead band has no width has all of
it, since there the two sides agree. Two kinds of piece keep one side: a clamp (of a control, an activation, a force)
has on its border the derivative towards its inside, where the control can still go, and a constraint row is either
active or not.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.spatial import inlined


@inlined
def sign(x):
    """Derivative of abs: 1, -1, or 0 at zero."""
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0)


@inlined
def displacement(length, lower, upper):
    """How far a length is outside of the band [lower, upper], negative below it, and the derivative of that."""
    right = 1.0 if length >= upper or length < lower else 0.0
    left = 1.0 if length > upper or length <= lower else 0.0
    return max(length - upper, 0.0) + min(length - lower, 0.0), 0.5 * (right + left)
