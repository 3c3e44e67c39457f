"""A car parks past three discs.

    x' = v cos h,   y' = v sin h,   h' = v tan(steer) / 0.5,   v' = accelerate

    J = 1/2 int |u|^2 dt,    |accelerate| <= 1 m/s^2,  |steer| <= 0.5 rad,  |v| <= speed,    outside of the discs

by Runge-Kutta steps with the controls held; limits of the state and discs act at the knots. At rest the steering wheel
moves nothing: the linearized car cannot turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numba import njit

from mjslq.bounds import Bounds
from mjslq.constraints import Path, State
from mjslq.costs import Control
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.problems.drawings import discs as drawn
from mjslq.problems.drawings import scene
from mjslq.problems.obstacles import clearance, outside_of_discs
from mjslq.trajectory import Trajectory
from mjslq.validation import as_array, count, positive

OPTIMAL_COST = 0.52033
"""At the best solution known with the default parameters."""
DISCS = (1.0, 0.5, 0.35, 2.0, 1.3, 0.4, 1.3, 1.8, 0.4)
"""Obstacles: x, y, radius [m] of each."""
GOAL = (2.5, 2.2, np.pi / 2.0, 0.0)
"""Where the car is to stand: x, y [m], heading [rad], speed [m/s]."""


def car_obstacles(
    horizon: int = 60, duration: float = 6.0, speed: float = 1.2, discs: Sequence[float] = DISCS
) -> Problem:
    """Park within `duration` [s], not faster than `speed` [m/s], outside of the `discs`: x, y, radius [m] of each."""
    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    obstacles = as_array("discs", discs, ("3 a disc",))
    if len(obstacles) == 0 or len(obstacles) % 3:
        raise ValueError(f"discs must hold x, y and radius of each obstacle, got {len(obstacles)} numbers")
    dynamics = FunctionDynamics(
        _equations, 4, 2, dt, integrator="rk4", control_limits=([-1.0, -0.5], [1.0, 0.5]),
        state_names=("x", "y", "heading", "speed"), control_names=("accelerate", "steer"),
    )  # fmt: skip
    fast = np.array([np.inf, np.inf, np.inf, positive("speed", speed)])
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=np.zeros(4),
        costs=[Control(1.0)],
        bounds=Bounds(x=(-fast, fast)),
        constraints=[
            Path(outside_of_discs, when="always", parameters=obstacles, name="discs"),
            State(GOAL, GOAL, "terminal", name="goal"),
        ],
        describe=partial(describe, discs=tuple(obstacles)),
        drawing=scene(
            "car_obstacles",
            drawn(tuple(obstacles), upright=False)
            + f'<geom type="box" size="0.15 0.3 0.002" pos="{GOAL[0]} {GOAL[1]} 0" material="goal"/>'
            '<body pos="0 0 0.06"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
            '<joint type="hinge" axis="0 0 1"/><geom type="box" size="0.25 0.11 0.05" material="body"/>'
            '<geom type="box" size="0.1 0.09 0.04" pos="-0.05 0 0.08" material="link"/></body>',
            (0, 1, 2), center="1.2 1.1 0", extent=2.6, elevation=-60.0,
        ),
    )  # fmt: skip


def describe(trajectory: Trajectory, discs: tuple[float, ...]) -> dict[str, str]:
    """How near the discs the car comes, and how far from its place it ends."""
    off = float(np.abs(trajectory.X[-1] - GOAL).max())
    return {"clearance": f"{clearance(trajectory.X[:, :2], discs):+.4f} m at the knots", "end": f"{off:.1e} off"}


@njit(cache=True)
def _equations(x, u, t, p):
    out = np.empty_like(x)
    out[0] = x[3] * np.cos(x[2])
    out[1] = x[3] * np.sin(x[2])
    out[2] = x[3] * np.tan(u[1]) / 0.5
    out[3] = u[0]
    return out
