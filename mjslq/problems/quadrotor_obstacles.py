"""A planar quadrotor flies past two discs, from rest to rest.

    m y'' = -(u_1 + u_2) sin a,   m z'' = (u_1 + u_2) cos a - m g,   I a'' = arm (u_2 - u_1)

    J = 1/2 int |u - hover|^2 dt,    0 <= u <= thrust,    outside of the discs at the knots

m = 0.5 kg, I = 0.005 kg m^2, arm = 0.15 m; Runge-Kutta steps with the controls held. There are several local minima:
above or below each disc.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

from mjslq.constraints import Path, State
from mjslq.costs import Control
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.problems.drawings import discs, scene
from mjslq.problems.obstacles import clearance, outside_of_discs
from mjslq.trajectory import Trajectory
from mjslq.validation import count, positive

OPTIMAL_COST = 0.08850
"""At the best solution known with the default parameters."""
DISCS = (1.0, 0.3, 0.4, 2.0, -0.3, 0.45)
"""Obstacles: y, z, radius [m] of each."""
MASS, GRAVITY = 0.5, 9.81


def quadrotor_obstacles(
    horizon: int = 60, duration: float = 3.0, distance: float = 3.0, thrust: float = 4.5
) -> Problem:
    """Fly `distance` [m] within `duration` [s], each rotor's thrust within 0 and `thrust` [N]."""
    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    dynamics = FunctionDynamics(
        _equations, 6, 2, dt, integrator="rk4", control_limits=(0.0, positive("thrust", thrust)),
        state_names=("y", "z", "tilt", "y.vel", "z.vel", "tilt.vel"), control_names=("right", "left"),
    )  # fmt: skip
    goal = np.array([positive("distance", distance), 0.0, 0.0, 0.0, 0.0, 0.0])
    hover = 0.5 * MASS * GRAVITY
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=np.zeros(6),
        costs=[Control(1.0, hover)],
        constraints=[
            Path(outside_of_discs, when="always", parameters=DISCS, name="discs"),
            State(goal, goal, "terminal", name="goal"),
        ],
        U0=np.full(2, hover),
        describe=partial(describe, goal=goal),
        drawing=scene(
            "quadrotor_obstacles",
            discs(DISCS, upright=True)
            + '<body><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>'
            '<joint type="hinge" axis="0 -1 0"/><geom type="box" size="0.15 0.03 0.012" material="body"/>'
            '<geom type="cylinder" size="0.06 0.006" pos="0.15 0 0.03" material="link"/>'
            '<geom type="cylinder" size="0.06 0.006" pos="-0.15 0 0.03" material="link"/></body>',
            (0, 1, 2), center=f"{0.5 * distance} 0 0", extent=0.8 * distance,
        ),
    )  # fmt: skip


def describe(trajectory: Trajectory, goal: np.ndarray) -> dict[str, str]:
    """How near the discs the flight comes, and how far from its goal it ends."""
    off = float(np.abs(trajectory.X[-1] - goal).max())
    return {"clearance": f"{clearance(trajectory.X[:, :2], DISCS):+.4f} m at the knots", "end": f"{off:.1e} off"}


@njit(cache=True)
def _equations(x, u, t, p):
    m, inertia, arm, g = 0.5, 0.005, 0.15, 9.81
    thrust = (u[0] + u[1]) / m
    out = np.empty_like(x)
    out[0], out[1], out[2] = x[3], x[4], x[5]
    out[3] = -thrust * np.sin(x[2])
    out[4] = thrust * np.cos(x[2]) - g
    out[5] = arm * (u[1] - u[0]) / inertia
    return out
