"""Parts of the problems with legged robots: feet on a floor, a stance to start from, servos or motors on the joints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjslq.robots import robot_spec
from mjslq.validation import Array

if TYPE_CHECKING:
    import mujoco


def on_floor(
    robot: str, feet: tuple[str, ...], timestep: float, armature: float, foot_radius: float | None = None
) -> mujoco.MjSpec:
    """Read `robot` with a free base above a floor that only its `feet` (bodies) touch.

    With `foot_radius` [m] each foot is a ball about its body's origin; without it the robot's own shapes stay.
    """
    import mujoco

    spec = robot_spec(robot, floating=True, motors=False, floor=True, armature=armature)
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for body in spec.bodies[1:]:
        touches = body.name in feet and foot_radius is None
        for geom in body.geoms:
            if not (touches and geom.contype):
                geom.contype = geom.conaffinity = 0
            elif touches:
                geom.contype, geom.conaffinity = 0, 1  # the floor, not each other
        if body.name in feet and foot_radius is not None:
            ball = body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[foot_radius, 0.0, 0.0], mass=0.0)
            ball.contype, ball.conaffinity, ball.group = 0, 1, 3
    return spec


def standing(model: mujoco.MjModel, posture: dict[str, float]) -> Array:
    """State of the robot at rest in `posture` (joint -> angle [rad], zero elsewhere), its lowest foot on the floor."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    for joint, angle in posture.items():
        data.qpos[model.joint(joint).qposadr[0]] = angle
    data.qpos[2] = 2.0
    mujoco.mj_kinematics(model, data)
    touching = np.flatnonzero((model.geom_conaffinity > 0) & (model.geom_bodyid > 0))
    lowest = min(data.geom_xpos[g, 2] - model.geom_rbound[g] for g in touching)
    data.qpos[2] -= lowest
    return np.concatenate([data.qpos, np.zeros(model.nv)])
