"""The quadruped Solo12 jumps: its base is high in the middle of the horizon, and it stands again at the end.

    J = h sum_n [ 1/2 |x_n - x_stand|^2_W + 1/2 effort |u_n|^2 ] + 1/2 lift (z_mid - z*)^2 + 1/2 |x_N - x_stand|^2_{W_N}

x = (q, v) with a free base, u the twelve joint torques [Nm]. Nothing says when the feet leave the floor and when they
come down: the search finds it through a smooth contact. A stiff one, where the derivatives at a touch-down tell of a
millimetre only, is far harder.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mjslq.bounds import Bounds
from mjslq.costs import Control, State
from mjslq.problem import Problem
from mjslq.problems.legged import standing
from mjslq.problems.solo12_stand import posture, solo12, spring_legs
from mjslq.trajectory import Trajectory
from mjslq.validation import count, nonnegative, positive


def solo12_jump(
    height: float = 0.5,
    horizon: int = 100,
    timestep: float = 0.01,
    stand: float = 0.8,
    lift: float = 3e3,
    effort: float = 1e-2,
    limit: float = 0.0,
    contact: str = "smooth",
) -> Problem:
    """Bring the base to `height` [m] in the middle of `horizon` steps, and stand again, thighs at `stand` [rad].

    `lift` weighs the height [1/m^2], `effort` the torques [1/(Nm)^2 s], which keep within `limit` [Nm] (0: none).
    `contact` is "smooth" or "stiff" (`mjslq.Contact`).
    """
    dynamics = solo12(positive("timestep", timestep), contact)
    N, goal = count("horizon", horizon, 4), standing(dynamics.model, posture(stand))
    nv = dynamics.ndx // 2
    positions = np.concatenate([[1.0, 1.0, 0.0, 10.0, 10.0, 10.0], np.full(nv - 6, 0.1)])
    running = np.concatenate([positions, np.full(nv, 0.01)])
    final = np.concatenate([[1e3] * 6, np.full(nv - 6, 100.0), np.full(nv, 1.0)])
    up = np.array(goal)
    up[2] = positive("height", height)
    at_top = np.zeros(dynamics.ndx)
    at_top[2] = positive("lift", lift)
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=goal,
        costs=[
            State(running, goal),
            Control(positive("effort", effort)),
            State(at_top, up, N // 2),
            State(final, goal, "terminal"),
        ],
        bounds=Bounds(u=(-limit, limit)) if nonnegative("limit", limit) else None,
        U0=spring_legs(dynamics, goal, goal, N),
        options={"tol_direction": 1e-3},
        describe=partial(describe, height=height, end=goal[:3]),
    )


def describe(trajectory: Trajectory, height: float, end: np.ndarray) -> dict[str, str]:
    """How high the base comes, and where it ends."""
    z, top = trajectory.X[:, 2], trajectory.X[trajectory.horizon // 2, 2]
    away = 1e3 * float(np.linalg.norm(trajectory.X[-1, :3] - end))
    return {"base": f"at {top:.3f} of {height:g} m in the middle, highest {z.max():.3f} m, ends {away:.1f} mm away"}
