"""A mass on a line goes from rest to rest in the least time, its force limited: bang-bang.

    r' = v,  v' = u,  |u| <= limit,    (r, v) = (0, 0) at t = 0 and (distance, 0) at t = T

    J = T + 1/2 effort int_0^T u^2 dt

by N steps of T/N with the control held. Without effort the optimum is full force forth, then back, and
T = 2 sqrt(distance / limit): exactly so for an even number of steps, since the switch is at a knot then.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

from mjslq.constraints import State
from mjslq.costs import Control, CostTerm, Time
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.problems.drawings import scene
from mjslq.trajectory import Trajectory
from mjslq.validation import count, nonnegative, positive


def optimal_time(distance: float = 1.0, limit: float = 1.0) -> float:
    """The least time, by continuous controls. [s]"""
    return 2.0 * float(np.sqrt(distance / limit))


def double_integrator_time(
    horizon: int = 40, distance: float = 1.0, limit: float = 1.0, effort: float = 0.0, duration: float = 3.0
) -> Problem:
    """Go `distance` [m] from rest to rest, the acceleration within `limit` [m/s^2], in the least time.

    `effort` weighs the acceleration [s^3/m^2]. The search starts from `duration` [s], a tenth of which is the least
    time allowed, and ten times of which the longest.
    """
    N, start = count("horizon", horizon), positive("duration", duration)
    far, most, effort = positive("distance", distance), positive("limit", limit), nonnegative("effort", effort)
    dynamics = FunctionDynamics(
        _equations, 2, 1, start / N, integrator="rk4", control_limits=(-most, most),
        state_names=("r", "v"), control_names=("acceleration",),
    )  # fmt: skip
    goal = [far, 0.0]
    terms: list[CostTerm] = [Time()]
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=[0.0, 0.0],
        costs=[*terms, Control(effort)] if effort else terms,
        constraints=[State(goal, goal, "terminal", name="goal")],
        free_time=(0.1 * start, 10.0 * start),
        describe=partial(describe, best=optimal_time(far, most)),
        drawing=scene(
            "double_integrator_time",
            f'<geom type="box" size="{0.6 * far} 0.02 0.002" pos="{0.5 * far} 0 -0.06" material="rail"/>'
            f'<geom type="box" size="0.005 0.05 0.05" pos="{far} 0 0" material="wall"/>'
            '<body><joint type="slide" axis="1 0 0"/><geom type="sphere" size="0.05" material="body"/></body>',
            (0,), extent=1.5 * far,
        ),
    )  # fmt: skip


def describe(trajectory: Trajectory, best: float) -> dict[str, str]:
    """How long it takes, and where the mass ends."""
    r, v = trajectory.X[-1]
    time = float(np.sum(trajectory.dt))
    return {"time": f"{time:.6f} s, {best:.6f} s at best", "end": f"r = {r:.9f} m, v = {v:+.1e} m/s"}


@njit(cache=True)
def _equations(x, u, t, p):
    out = np.empty_like(x)
    out[0] = x[1]
    out[1] = u[0]
    return out
