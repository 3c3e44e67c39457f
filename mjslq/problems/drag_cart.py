"""A cart with drag under a limit of dynamic pressure (McQuade 1989, section 4.3, Example 2, (4.21)-(4.28)).

    r' = v,  v' = u - v^2/2,    (r, v) = (0, 0) at t = 0 and (1, 0) at t = 1,    v^2/2 <= pressure

    J = 1/2 int_0^1 u^2 dt

by Runge-Kutta steps of 1/N with the control held; the limit acts at the knots. The start is bang-bang, as in Fig. 4.6:
it misses the end and exceeds the limit. (4.35) is to be read |v| <= sqrt 2.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

from mjslq.constraints import Path, State
from mjslq.costs import Control
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.problems.drawings import scene
from mjslq.trajectory import Trajectory
from mjslq.validation import count, finite, positive

OPTIMAL_COSTS = {20: 6.32933, 50: 6.31171, 100: 6.30927, 400: 6.30851}
"""Cost at the solution with the default limit, by the number of steps."""
FREE_COST = 6.25782
"""The same without the limit, 50 steps."""


def drag_cart(horizon: int = 50, pressure: float = 1.0, start: float = 5.0) -> Problem:
    """Go a metre from rest to rest within a second, v^2/2 within `pressure` [m^2/s^2].

    `start` is the force to start from: so much forward for half a second, then backward.
    """
    N = count("horizon", horizon)
    dynamics = FunctionDynamics(
        _equations, 2, 1, 1.0 / N, integrator="rk4", state_names=("r", "v"), control_names=("force",)
    )
    goal = [1.0, 0.0]
    force = finite("start", start) * np.where(np.arange(N) < 0.5 * N, 1.0, -1.0)
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=np.zeros(2),
        costs=[Control(1.0)],
        constraints=[
            Path(_pressure, when="always", parameters=[positive("pressure", pressure)], name="pressure"),
            State(goal, goal, "terminal", name="goal"),
        ],
        U0=force[:, None],
        describe=partial(describe, pressure=pressure),
        drawing=scene(
            "drag_cart",
            '<geom type="box" size="0.7 0.03 0.01" pos="0.5 0 -0.06" material="rail"/>'
            '<geom type="box" size="0.005 0.03 0.06" pos="1 0 0" material="goal"/>'
            '<body><joint type="slide" axis="1 0 0"/><geom type="box" size="0.06 0.04 0.04" material="body"/></body>',
            (0,), center="0.5 0 0", extent=1.0,
        ),
    )  # fmt: skip


def describe(trajectory: Trajectory, pressure: float) -> dict[str, str]:
    """The largest dynamic pressure, and where the cart ends."""
    r, v = trajectory.X[-1]
    highest = 0.5 * float((trajectory.X[:, 1] ** 2).max())
    return {"pressure": f"{highest:.6f} of {pressure:g} m^2/s^2", "end": f"r = {r:.6f} m, v = {v:+.2e} m/s"}


@njit(cache=True)
def _equations(x, u, t, p):
    out = np.empty_like(x)
    out[0] = x[1]
    out[1] = u[0] - 0.5 * x[1] * x[1]
    return out


@njit(cache=True)
def _pressure(x, u, t, p):
    out = np.empty(1, dtype=x.dtype)
    out[0] = 0.5 * x[1] * x[1] - p[0]
    return out
