"""A quadrotor flies to a waypoint, turned about the vertical, its thrusts limited.

    J = h sum_n [ 1/2 |x_n - x*|^2_W + 1/2 effort |u_n - u_hover|^2 ] + 1/2 |x_N - x*|^2_{W_N}

x = (q, v) with a free base, x* at rest at the waypoint; u the thrusts [N] of the four rotors. It has six directions of
motion and four controls: to go sideways it has to tilt.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mjslq.costs import Control, State
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.assets import load_asset
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, count, finite, positive


def quadrotor(
    x: float = 2.0,
    y: float = 0.0,
    z: float = 1.0,
    yaw: float = 90.0,
    roll: float = 0.0,
    horizon: int = 100,
    duration: float = 2.0,
    limit: float = 8.0,
    effort: float = 0.01,
) -> Problem:
    """Fly from (0, 0, 1) to (`x`, `y`, `z`) [m] and turn by `yaw` [deg] within `duration` [s].

    `roll` tilts it at the start [deg]: 180 is upside down. Thrusts lie between 0 and `limit` [N], `effort` weighs
    their departure from hovering [1/N^2 s].
    """
    N = count("horizon", horizon)
    spec = load_asset("quadrotor.xml", positive("duration", duration) / N)
    place, turn = np.array([finite(n, v) for n, v in zip("xyz", (x, y, z), strict=True)]), _turn(finite("yaw", yaw), 2)
    spec.body("target").pos, spec.body("target").quat = place, turn
    for rotor in spec.actuators:
        rotor.ctrlrange = np.array([0.0, positive("limit", limit)])
    dynamics = MujocoDynamics.from_spec(spec)
    x0 = dynamics.initial_state
    x0[3:7] = _turn(finite("roll", roll), 0)
    goal = np.concatenate([place, turn, np.zeros(6)])
    hover = np.full(4, float(dynamics.model.body_mass.sum() * -dynamics.model.opt.gravity[2] / 4.0))
    weights = np.concatenate([np.full(3, 10.0), np.full(3, 10.0), np.full(6, 1.0)])
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=x0,
        costs=[
            State(0.01 * weights, goal),
            Control(positive("effort", effort), hover),
            State(100.0 * weights, goal, "terminal"),
        ],
        U0=hover,
        describe=partial(describe, goal=goal, dynamics=dynamics),
    )


def errors(dynamics: MujocoDynamics, trajectory: Trajectory, goal: Array) -> tuple[float, float]:
    """Distance [m] and angle [rad] from the waypoint at the end."""
    away = dynamics.difference(goal, trajectory.X[-1])
    return float(np.linalg.norm(away[:3])), float(np.linalg.norm(away[3:6]))


def describe(trajectory: Trajectory, goal: Array, dynamics: MujocoDynamics) -> dict[str, str]:
    """How far from the waypoint the flight ends."""
    distance, angle = errors(dynamics, trajectory, goal)
    speed = float(np.linalg.norm(trajectory.X[-1, 7:10]))
    return {"end": f"{1e3 * distance:.1f} mm and {np.degrees(angle):.2f} deg from the waypoint, speed {speed:.3f} m/s"}


def _turn(degrees: float, axis: int) -> Array:
    """Quaternion of a turn about an axis of the body."""
    half, turn = 0.5 * np.radians(degrees), np.zeros(4)
    turn[0], turn[1 + axis] = np.cos(half), np.sin(half)
    return turn
