"""A spacecraft with a flexible boom turns round, from rest to rest.

    (J + e^2) w' + d e'' + 2 e e' w = u,      e'' + d w' + 2 zeta W e' + (W^2 - w^2) e = 0,      w = a'

    minimize  1/2 int u^2 dt,    |u| <= torque,  |e| <= bend,  |w| <= rate,    a = angle, all else zero at the end

a is the angle of the hub, e the amplitude of the boom's first bending mode, scaled to unit modal mass, d how both are
coupled, W and zeta frequency and damping of the mode. Turning stiffens nothing and softens the mode by w^2.

McQuade 1989, chapter 6, names large angle slews of flexible spacecraft as an application to come, without a model or
numbers: all numbers here are ours. J = 1, d = 0.6, W = 1.5 rad/s, zeta = 0.005; limits act at the knots.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

from mjslq.bounds import Bounds
from mjslq.constraints import State
from mjslq.costs import Control
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.problems.drawings import scene
from mjslq.trajectory import Trajectory
from mjslq.validation import count, finite, positive


def spacecraft_slew(
    angle: float = 180.0,
    horizon: int = 150,
    duration: float = 15.0,
    torque: float = 0.12,
    bend: float = 0.025,
    rate: float = 20.0,
) -> Problem:
    """Turn by `angle` [deg] within `duration` [s], with torques up to `torque`, bends up to `bend`, `rate` [deg/s]."""
    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    most = positive("torque", torque)
    dynamics = FunctionDynamics(
        _equations, 4, 1, dt, integrator="rk4", control_limits=(-most, most),
        state_names=("angle", "bend", "rate", "bend.vel"), control_names=("torque",),
    )  # fmt: skip
    goal = np.array([np.radians(finite("angle", angle)), 0.0, 0.0, 0.0])
    within = np.array([np.inf, positive("bend", bend), np.radians(positive("rate", rate)), np.inf])
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=np.zeros(4),
        costs=[Control(1.0)],
        bounds=Bounds(x=(-within, within)),
        constraints=[State(goal, goal, "terminal", name="goal")],
        describe=partial(describe, goal=goal),
        drawing=scene(
            "spacecraft_slew",
            '<body><joint type="hinge" axis="0 0 1"/><geom type="box" size="0.25 0.25 0.25" material="body"/>'
            '<body pos="0.25 0 0"><joint type="hinge" axis="0 0 1"/>'
            '<geom type="box" size="0.75 0.12 0.01" pos="0.75 0 0" material="link"/></body></body>',
            (0, 1), extent=2.2, elevation=-60.0,
        ),
    )  # fmt: skip


def describe(trajectory: Trajectory, goal: np.ndarray) -> dict[str, str]:
    """The largest bend and rate, and the end."""
    X = trajectory.X
    return {
        "bend": f"{np.abs(X[:, 1]).max():.4f} at most",
        "rate": f"{np.degrees(np.abs(X[:, 2]).max()):.2f} deg/s at most",
        "end": f"{np.abs(X[-1] - goal).max():.1e} off",
    }


@njit(cache=True)
def _equations(x, u, t, p):
    inertia, d, W, zeta = 1.0, 0.6, 1.5, 0.005
    e, w, speed = x[1], x[2], x[3]
    turn = u[0] - 2.0 * e * speed * w
    swing = -2.0 * zeta * W * speed - (W * W - w * w) * e
    whole = inertia + e * e
    out = np.empty_like(x)
    out[0], out[1] = w, speed
    out[2] = (turn - d * swing) / (whole - d * d)
    out[3] = swing - d * out[2]
    return out
