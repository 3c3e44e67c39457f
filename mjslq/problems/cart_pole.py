"""A pole on a cart swings up: one limited force, two directions of motion."""

from __future__ import annotations

from mjslq.problem import Problem
from mjslq.problems.swing_up import swing_up


def cart_pole(
    limit: float = 5.0, horizon: int = 150, duration: float = 3.0, effort: float = 0.01, running: float = 0.0
) -> Problem:
    """Swing the pole up and stop at the middle within `duration` [s], the force within `limit` [N] (0: none).

    `effort` weighs the force [1/N^2 s], `running` the distance from upright on the way, relative to a
    hundredth of its weight at the end [1/s].
    """
    return swing_up("cart_pole", {"force": limit}, [50.0, 100.0, 5.0, 10.0], horizon, duration, effort, running)
