"""The acrobot: a double pendulum swings up by a motor in its elbow alone."""

from __future__ import annotations

from mjslq.problem import Problem
from mjslq.problems.swing_up import swing_up


def acrobot(
    limit: float = 10.0, horizon: int = 250, duration: float = 5.0, effort: float = 0.1, running: float = 0.0
) -> Problem:
    """Swing up within `duration` [s], the torque within `limit` [Nm] (0: none).

    `effort` weighs the torque [1/(Nm)^2 s], `running` the distance from upright on the way, relative to a
    hundredth of its weight at the end [1/s].
    """
    return swing_up("acrobot", {"elbow": limit}, [100.0, 100.0, 10.0, 10.0], horizon, duration, effort, running)
