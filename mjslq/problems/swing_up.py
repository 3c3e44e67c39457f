"""Parts of the swing-ups: a model of the assets whose motors get limits, hanging first and upright in the end.

    J = h sum_n [ 1/2 running |x_n|^2_W/100 + 1/2 effort |u_n|^2 ] + 1/2 |x_N|^2_W,    x = 0 upright at rest

The motors are too weak to lift the links at once: they have to be swung.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mjslq.costs import Control, State
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.assets import load_asset
from mjslq.trajectory import Trajectory
from mjslq.validation import count, nonnegative, positive


def swing_up(
    name: str,
    limits: dict[str, float],
    weights: list[float],
    horizon: int,
    duration: float,
    effort: float,
    running: float,
) -> Problem:
    """The swing-up of assets/`name`.xml; `limits` by the motor's name, 0 for none."""
    N = count("horizon", horizon)
    spec = load_asset(f"{name}.xml", positive("duration", duration) / N)
    for motor, limit in limits.items():
        actuator = spec.actuator(motor)
        actuator.ctrllimited = bool(limit)
        if limit:
            actuator.ctrlrange = np.array([-1.0, 1.0]) * positive("limit", limit)
    dynamics = MujocoDynamics.from_spec(spec)
    upright = dynamics.keyframe("upright")
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=dynamics.keyframe("hanging"),
        costs=[
            Control(positive("effort", effort)),
            State(nonnegative("running", running) * np.array(weights) / 100.0, upright),
            State(weights, upright, when="terminal"),
        ],
        name=name,
        describe=partial(describe, nv=dynamics.nv),
    )


def describe(trajectory: Trajectory, nv: int) -> dict[str, str]:
    """How far from upright and at rest the motion ends."""
    x = trajectory.X[-1]
    return {"end": f"{np.abs(x[:nv]).max():.3f} rad or m from upright, speed {np.abs(x[nv:]).max():.3f} rad/s or m/s"}
