"""A pole on a cart swings up on a short track: a limited force, hard walls, and the end met exactly.

    (1 + 0.1 sin^2 a) c'' = u + 0.1 sin a (0.5 a'^2 + g cos a),    0.5 a'' = -c'' cos a - g sin a,    a = 0 hangs

    J = 1/2 int u^2 dt,    |u| <= force,  |c| <= track,    (c, a, c', a') = (0, pi, 0, 0) at the end

by Runge-Kutta steps with the control held; the walls act at the knots.
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
from mjslq.validation import count, positive

OPTIMAL_COST = 15.31268
"""At the best solution known with the default parameters."""


def cart_pole_track(horizon: int = 75, duration: float = 3.0, force: float = 5.0, track: float = 0.5) -> Problem:
    """Swing the pole up within `duration` [s], the force within `force` [N], the cart within `track` [m]."""
    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    most, wide = positive("force", force), np.array([positive("track", track), np.inf, np.inf, np.inf])
    dynamics = FunctionDynamics(
        _equations, 4, 1, dt, integrator="rk4", control_limits=(-most, most),
        state_names=("cart", "pole", "cart.vel", "pole.vel"), control_names=("force",),
    )  # fmt: skip
    goal = [0.0, np.pi, 0.0, 0.0]
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=np.zeros(4),
        costs=[Control(1.0)],
        constraints=[State(-wide, wide, name="track"), State(goal, goal, "terminal", name="goal")],
        describe=partial(describe, track=track),
        drawing=scene(
            "cart_pole_track",
            f'<geom type="capsule" fromto="{-track - 0.2} 0 0 {track + 0.2} 0 0" size="0.012" material="rail"/>'
            f'<geom type="box" size="0.005 0.08 0.08" pos="{-track - 0.11} 0 0" material="wall"/>'
            f'<geom type="box" size="0.005 0.08 0.08" pos="{track + 0.11} 0 0" material="wall"/>'
            '<body><joint type="slide" axis="1 0 0"/><geom type="box" size="0.1 0.05 0.04" material="body"/>'
            '<body><joint type="hinge" axis="0 -1 0"/>'
            '<geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.015" material="link"/></body></body>',
            (0, 1), extent=1.4,
        ),
    )  # fmt: skip


def describe(trajectory: Trajectory, track: float) -> dict[str, str]:
    """How far the cart goes, and how the pole ends."""
    farthest = float(np.abs(trajectory.X[:, 0]).max())
    off = float(np.abs(trajectory.X[-1] - [0.0, np.pi, 0.0, 0.0]).max())
    return {"cart": f"{farthest:.4f} m of {track:g} m", "end": f"{off:.1e} from upright at rest"}


@njit(cache=True)
def _equations(x, u, t, p):
    mass, pole, length, g = 1.0, 0.1, 0.5, 9.81
    sine, cosine, turn = np.sin(x[1]), np.cos(x[1]), x[3]
    push = u[0] + pole * sine * (length * turn * turn + g * cosine)
    cart = push / (mass + pole * sine * sine)
    out = np.empty_like(x)
    out[0], out[1] = x[2], turn
    out[2] = cart
    out[3] = -(cart * cosine + g * sine) / length
    return out
