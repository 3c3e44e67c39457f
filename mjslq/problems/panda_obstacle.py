"""Franka's Panda reaches round a ball, within the limits of its joints and motors.

    J = h sum_n [ 0.1 * 1/2 |x_n - x_0|^2 + 1e-3 * 1/2 |u_n|^2 + 1/2 |p(q_n) - p*|^2 ]
        + 0.1 * 1/2 |x_N - x_0|^2 + 1e3 * 1/2 |p(q_N) - p*|^2

as in `panda_reach`, with |u| <= 87 and 12 Nm, the joints within their ranges, and the ball `gap` away from two
capsules, about the hand and about the forearm, at the knots. Distances are MuJoCo's `distance` sensors. The straight
way of `panda_reach` leads through the ball.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mjslq.constraints import Sensor as Reading
from mjslq.constraints import State as Within
from mjslq.costs import Control, Sensor, State
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.panda_reach import FRAME, mujoco_spec
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, count, nonnegative, positive

BALL = (0.27, 0.2, 0.74)
"""Center of the ball. [m]"""
CAPSULES = {
    "hand": ("panda_hand", (0.0, 0.0, 0.0, 0.0, 0.0, 0.1034), 0.05),
    "forearm": ("panda_link5", (0.0, 0.0, -0.26, 0.0, 0.0, -0.02), 0.06),
}
"""Shapes that have to keep away: body, ends [m] and radius [m]."""


def panda_obstacle(
    x: float = 0.4,
    y: float = 0.3,
    z: float = 0.5,
    radius: float = 0.08,
    gap: float = 0.01,
    horizon: int = 100,
    duration: float = 2.0,
    reach: float = 1e3,
    effort: float = 1e-3,
) -> Problem:
    """Bring the hand to (`x`, `y`, `z`) [m] in `duration` [s], `gap` [m] away from a ball of `radius` [m] at least.

    `reach` weighs the distance at the end [1/m^2], `effort` the torques [1/(Nm)^2 s].
    """
    import mujoco

    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    least = nonnegative("gap", gap)
    dynamics = _dynamics(positive("radius", radius), dt)
    model = dynamics.model
    q = np.clip(model.qpos0, *model.jnt_range.T)
    data = mujoco.MjData(model)
    data.qpos = q
    mujoco.mj_forward(model, data)
    x0, free = np.concatenate([q, np.zeros(model.nv)]), np.full(model.nv, np.inf)
    target = np.array([x, y, z])
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=x0,
        costs=[
            State(0.1, target=x0, when="always"),
            Control(positive("effort", effort)),
            Sensor(FRAME, target, 1.0),
            Sensor(FRAME, target, positive("reach", reach), when="terminal"),
        ],
        constraints=[
            *[Reading(f"{name}_gap", lower=least) for name in CAPSULES],
            Within(np.r_[model.jnt_range[:, 0], -free], np.r_[model.jnt_range[:, 1], free], name="joints"),
        ],
        U0=data.qfrc_bias.copy(),
        options={"tol_direction": 1e-5, "curvature": "never"},  # second derivatives of distances are dear
        describe=partial(describe, target=target, outputs={name: i for i, name in enumerate(dynamics.output_names)}),
    )


def describe(trajectory: Trajectory, target: Array, outputs: dict[str, int]) -> dict[str, str]:
    """How far the hand is from the target at the end, and how near the ball it came."""
    Y = trajectory.Y
    place = [i for name, i in outputs.items() if name.startswith(FRAME)]
    nearest = min(Y[:, outputs[f"{name}_gap"]].min() for name in CAPSULES)
    distance = float(np.linalg.norm(Y[-1, place] - target))
    return {"hand": f"{1e3 * distance:.2f} mm from the target", "ball": f"{1e3 * nearest:.2f} mm away at the nearest"}


def _dynamics(radius: float, dt: float) -> MujocoDynamics:
    import mujoco

    spec = mujoco_spec(limits=True)
    seen = {"contype": 0, "conaffinity": 0, "mass": 0.0}
    ball = spec.worldbody.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0.0, 0.0], **seen)
    ball.pos, ball.rgba = BALL, [0.8, 0.25, 0.25, 0.6]
    for name, (body, ends, thick) in CAPSULES.items():
        geom = spec.body(body).add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CAPSULE, **seen)
        geom.fromto, geom.size, geom.group = ends, [thick, 0.0, 0.0], 3
        sensor = spec.add_sensor(name=f"{name}_gap", type=mujoco.mjtSensor.mjSENS_GEOMDIST, cutoff=2.0)
        sensor.objtype = sensor.reftype = mujoco.mjtObj.mjOBJ_GEOM
        sensor.objname, sensor.refname = name, "ball"
    return MujocoDynamics.from_spec(spec, timestep=dt)
