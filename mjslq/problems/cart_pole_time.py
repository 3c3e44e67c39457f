"""A pole on a cart swings up in the least time, the force limited: bang-bang.

    J = T + 1/2 effort int_0^T u^2 dt,    |u| <= limit,    upright at rest in the end, exactly

on the model of `cart_pole`, by MuJoCo or as a function, which is the same step for step (semi-implicit Euler):

    (M + m) x'' + m c (a'' cos a - a'^2 sin a) = u,    (I + m c^2) a'' + m c (x'' cos a - g sin a) = 0,    a = 0 upright
"""

from __future__ import annotations

import mujoco
import numpy as np
from numba import njit

from mjslq.constraints import State
from mjslq.costs import Control, CostTerm, Time
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.function import FunctionDynamics
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.assets import load_asset
from mjslq.trajectory import Trajectory
from mjslq.validation import choose, count, nonnegative, positive

OPTIMAL_TIME = 1.978077
"""At the best solution known with the default parameters. [s]"""


def cart_pole_time(
    horizon: int = 60, limit: float = 5.0, effort: float = 0.0, duration: float = 2.0, engine: str = "mujoco"
) -> Problem:
    """Swing the pole up and stop in the least time, the force within `limit` [N].

    `effort` weighs the force [s/N^2]. The search starts from `duration` [s], a tenth of which is the least time
    allowed, and ten times of which the longest. `engine` is "mujoco" or "function".
    """
    N, start = count("horizon", horizon), positive("duration", duration)
    most, effort = positive("limit", limit), nonnegative("effort", effort)
    spec = load_asset("cart_pole.xml", start / N)
    motor = spec.actuator("force")
    motor.ctrllimited, motor.ctrlrange = True, np.array([-most, most])
    exact = MujocoDynamics.from_spec(spec)
    dynamics: Dynamics = exact
    if choose("engine", engine, ("mujoco", "function")) == "function":
        dynamics = FunctionDynamics(
            _equations, 4, 1, start / N, integrator="semi-implicit-euler", control_limits=(-most, most),
            parameters=_constants(exact.model), state_names=exact.state_names, control_names=exact.control_names,
            scene=exact.scene(),
        )  # fmt: skip
    upright = exact.keyframe("upright")
    terms: list[CostTerm] = [Time()]
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=exact.keyframe("hanging"),
        costs=[*terms, Control(effort)] if effort else terms,
        constraints=[State(upright, upright, "terminal", name="upright")],
        free_time=(0.1 * start, 10.0 * start),
        describe=describe,
    )


def describe(trajectory: Trajectory) -> dict[str, str]:
    """How long it takes, and how the pole ends."""
    x, force = trajectory.X[-1], np.abs(trajectory.U)
    share = float(np.mean(force > 0.999 * force.max(initial=0.0)))
    return {
        "time": f"{float(np.sum(trajectory.dt)):.6f} s, {share:.0%} of it at full force",
        "end": f"{np.abs(x).max():.1e} from upright at rest",
    }


def _constants(model: mujoco.MjModel) -> dict[str, float]:
    """What the equations need of the model."""
    pole = model.body("pole")
    return {
        "cart": float(model.body("cart").mass[0]),
        "pole": float(pole.mass[0]),
        "centre": float(pole.ipos[2]),
        "inertia": float(pole.inertia[0]),
        "gravity": -float(model.opt.gravity[2]),
    }


@njit(cache=True)
def _equations(x, u, t, p):
    cart, pole, centre, inertia, gravity = p[0], p[1], p[2], p[3], p[4]
    sine, cosine, about = np.sin(x[1]), np.cos(x[1]), inertia + pole * centre * centre
    push, lift = u[0] + pole * centre * x[3] * x[3] * sine, pole * centre * gravity * sine
    determinant = (cart + pole) * about - (pole * centre * cosine) ** 2
    out = np.empty_like(x)
    out[0], out[1] = x[2], x[3]
    out[2] = (about * push - pole * centre * cosine * lift) / determinant
    out[3] = ((cart + pole) * lift - pole * centre * cosine * push) / determinant
    return out
