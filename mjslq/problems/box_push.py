"""A finger pushes a box to a place and turns it, over a floor with friction.

    J = h sum_n [ 1/2 effort |u_n|^2 + 1/2 |v_n|^2_W ] + 1/2 |x_N - x*|^2_W

The finger stands away from the box. Its servos may be told to stay ("still"): then nothing touches, no derivative of
the box by the controls differs from zero, and only an engine with foresight feels that there is something to push. Or
they are told to go along a straight line towards the target ("line").
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mjslq.costs import Control, State
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.assets import load_asset
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose, count, finite, nonnegative, positive

REACH = 0.07
"""Distance from the finger's place to the face of the box. [m]"""


def box_push(
    x: float = 0.3,
    y: float = 0.1,
    yaw: float = 0.5,
    horizon: int = 100,
    duration: float = 2.0,
    effort: float = 1.0,
    contact: str = "smooth",
    foresight: float = 0.0,
    start: str = "line",
) -> Problem:
    """Push the box by (`x`, `y`) [m] and turn it by `yaw` [rad] within `duration` [s].

    `effort` weighs the servos' departure from the finger's first place [1/m^2 s]. `contact` is "smooth", "stiff" or
    "model"; `foresight` the distance [m] from which on derivatives feel contacts. `start` is "line" or "still".
    """
    N = count("horizon", horizon)
    spec = load_asset("box_push.xml", positive("duration", duration) / N)
    yaw = finite("yaw", yaw)
    turn = np.array([np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)])
    place = np.array([finite("x", x), finite("y", y), 0.05])
    target = spec.body("target")
    target.pos, target.quat = place, turn
    dynamics = MujocoDynamics.from_spec(spec, contact=contact, foresight=nonnegative("foresight", foresight))
    x0 = dynamics.initial_state
    goal = np.concatenate([np.zeros(2), place, turn, np.zeros(8)])
    at_end = np.concatenate([np.zeros(2), [1e3, 1e3, 0.0, 10.0, 10.0, 100.0], [0.1, 0.1], np.full(6, 1.0)])
    on_the_way = np.concatenate([np.zeros(8), [0.1, 0.1], np.full(6, 0.01)])
    end = x0[:2] if choose("start", start, ("line", "still")) == "still" else [REACH + place[0], 0.3 * place[1]]
    ramp = np.linspace(0.0, 1.0, N)[:, None]
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=x0,
        costs=[Control(positive("effort", effort)), State(on_the_way, goal), State(at_end, goal, "terminal")],
        U0=(1.0 - ramp) * x0[:2] + ramp * np.asarray(end),
        options={"tol_direction": 1e-3},
        describe=partial(describe, place=place, yaw=yaw),
    )


def errors(trajectory: Trajectory, place: Array, yaw: float) -> tuple[float, float]:
    """Distance [m] and angle [rad] between the box and its target at the end."""
    x = trajectory.X[-1]
    turned = 2.0 * np.arctan2(x[8], x[5])
    return float(np.linalg.norm(x[2:4] - place[:2])), float(abs((turned - yaw + np.pi) % (2.0 * np.pi) - np.pi))


def describe(trajectory: Trajectory, place: Array, yaw: float) -> dict[str, str]:
    """How far the box is from its target at the end."""
    distance, angle = errors(trajectory, place, yaw)
    return {"box": f"{1e3 * distance:.1f} mm and {angle:.3f} rad from its target"}
