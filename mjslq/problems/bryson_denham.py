"""A particle thrown at a wall (Bryson and Denham 1963; McQuade 1989, section 4.2, Example 1, (4.1)-(4.8)).

    r' = v,  v' = u,    (r, v) = (0, 1) at t = 0 and (0, -1) at t = 1,    r <= limit

    J = 1/2 int_0^1 u^2 dt

by steps of 1/N with the control held; the wall acts at the knots. A state inequality of second order: u enters the
second derivative of r. The exact optimum for limit = 0.1 is 4/(9 limit) = 4.4444; with steps it is a little higher.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

from mjslq.constraints import State
from mjslq.costs import Control
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.problems.drawings import scene
from mjslq.trajectory import Trajectory
from mjslq.validation import count, finite, nonnegative

OPTIMAL_COSTS = {10: 4.5745, 17: 4.4880, 20: 4.4757, 50: 4.4494, 200: 4.44475}
"""Cost at the solution with the default limit, by the number of steps."""
PAPER_COST = 4.49
"""McQuade's, whose number of steps is not told; it is the optimum at 16 to 17 steps."""


def bryson_denham(horizon: int = 50, limit: float = 0.1, force: float = 0.0, start: float = -2.0) -> Problem:
    """Turn round within a second with the least force, never farther than `limit` [m].

    `force` limits |u| [N] (0: none). `start` is the force to start from: -2 is the optimum without a wall.
    """
    N = count("horizon", horizon)
    most = nonnegative("force", force) or np.inf
    dynamics = FunctionDynamics(
        _equations, 2, 1, 1.0 / N, integrator="rk4", control_limits=(-most, most),
        state_names=("r", "v"), control_names=("force",),
    )  # fmt: skip
    goal = [0.0, -1.0]
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=[0.0, 1.0],
        costs=[Control(1.0)],
        constraints=[
            State(None, [finite("limit", limit), np.inf], name="wall"),
            State(goal, goal, "terminal", name="goal"),
        ],
        U0=np.full(1, finite("start", start)),
        describe=partial(describe, limit=limit),
        drawing=scene(
            "bryson_denham",
            f'<geom type="box" size="0.002 0.05 0.05" pos="{limit + 0.012} 0 0" material="wall"/>'
            '<geom type="box" size="0.2 0.02 0.002" pos="0 0 -0.013" material="rail"/>'
            '<body><joint type="slide" axis="1 0 0"/><geom type="sphere" size="0.01" material="body"/></body>',
            (0,), extent=0.25,
        ),
    )  # fmt: skip


def describe(trajectory: Trajectory, limit: float) -> dict[str, str]:
    """How far the particle goes, and where it ends."""
    r, v = trajectory.X[-1]
    return {"reach": f"{trajectory.X[:, 0].max():.6f} m of {limit:g} m", "end": f"r = {r:+.2e} m, v = {v:+.6f} m/s"}


@njit(cache=True)
def _equations(x, u, t, p):
    out = np.empty_like(x)
    out[0] = x[1]
    out[1] = u[0]
    return out
