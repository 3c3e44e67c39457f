"""A double pendulum swings up by two limited motors."""

from __future__ import annotations

from mjslq.problem import Problem
from mjslq.problems.swing_up import swing_up


def double_pendulum(
    shoulder: float = 8.0,
    elbow: float = 4.0,
    horizon: int = 150,
    duration: float = 3.0,
    effort: float = 0.1,
    running: float = 1.0,
) -> Problem:
    """Swing up within `duration` [s], torques within `shoulder` and `elbow` [Nm] (0: none).

    `effort` weighs the torques [1/(Nm)^2 s], `running` the distance from upright on the way, relative to a
    hundredth of its weight at the end [1/s].
    """
    limits = {"shoulder": shoulder, "elbow": elbow}
    return swing_up("double_pendulum", limits, [100.0, 100.0, 10.0, 10.0], horizon, duration, effort, running)
