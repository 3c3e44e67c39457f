"""A seven-joint arm reaches for a point: Franka's Panda, fingers locked, on either engine.

    J = h sum_n [ 0.1 * 1/2 |x_n - x_0|^2 + 1e-3 * 1/2 |u_n|^2 + 1/2 |p(q_n) - p*|^2 ]
        + 0.1 * 1/2 |x_N - x_0|^2 + 1e3 * 1/2 |p(q_N) - p*|^2

x = (q, v), u joint torques [Nm], p(q) the position [m] of the frame between the fingers, h = 0.01 s, N = 200,
semi-implicit Euler; x_0 is the zero configuration clipped to the joint limits, at rest. There are no contacts,
limits, damping or friction, so that both engines integrate the same equations.

The start is the torque that holds the arm up. From zero torques the arm falls for two seconds first, and the search
ends in another, far worse minimum.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mjslq.bounds import Bounds
from mjslq.costs import Control, Sensor, State
from mjslq.dynamics.dynamics import Dynamics
from mjslq.problem import Problem
from mjslq.robots import robot_path
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose, count, positive

if TYPE_CHECKING:
    import mujoco

FRAME = "panda_hand_tcp"
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
OPTIMAL_COST = 0.693630
"""Cost at the solution with the default parameters, by Crocoddyl 3.2.1."""


def panda_reach(
    x: float = 0.4,
    y: float = 0.3,
    z: float = 0.5,
    horizon: int = 200,
    duration: float = 2.0,
    reach: float = 1e3,
    effort: float = 1e-3,
    engine: str = "mujoco",
    limits: bool = False,
) -> Problem:
    """Bring the hand to the point (`x`, `y`, `z`) [m] in `duration` [s], with little torque.

    `reach` weighs the distance at the end [1/m^2], `effort` the torques [1/(Nm)^2 s]. `engine` is "mujoco" or
    "pinocchio". `limits` keeps the torques within the joints' efforts, 87 and 12 Nm.
    """
    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    make = {"mujoco": _mujoco, "pinocchio": _pinocchio}[choose("engine", engine, ("mujoco", "pinocchio"))]
    dynamics, x0, hold = make(dt, bool(limits))
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
        bounds=None if limits else Bounds(u=None),
        name="panda_reach",
        U0=hold,
        # Full and half steps lead to this minimum; the steps that a parabola suggests lead to one 49 % dearer.
        # Gauss-Newton ends by halving the direction; beyond 1e-5 the cost changes in the tenth digit.
        options={"line_search": "armijo", "tol_direction": 1e-5},
        describe=partial(describe, target=target),
        parameters={
            "x": x,
            "y": y,
            "z": z,
            "horizon": N,
            "duration": duration,
            "reach": reach,
            "effort": effort,
            "engine": engine,
            "limits": limits,
        },
    )


def describe(trajectory: Trajectory, target: Array) -> dict[str, str]:
    """How far the hand is from the target at the end."""
    distance = float(np.linalg.norm(trajectory.Y[-1] - target))
    point = ", ".join(f"{coordinate:.4f}" for coordinate in trajectory.Y[-1])
    return {"hand": f"{1e3 * distance:.2f} mm from the target, at ({point}) m"}


def mujoco_spec(limits: bool = False) -> mujoco.MjSpec:
    """The arm as an MJCF model: fingers locked, no limits on motion, no damping, a sensor on the hand.

    With `limits` the motors keep to the joints' efforts.
    """
    import mujoco

    from mjslq.dynamics.locked_joints import lock_spec
    from mjslq.robots import robot_spec

    spec = robot_spec("panda")
    lock_spec(spec, FINGERS)
    for joint in spec.joints:
        joint.damping[:] = 0.0
    for motor in spec.actuators:
        motor.ctrllimited = limits
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    kind, body = mujoco.mjtSensor.mjSENS_FRAMEPOS, mujoco.mjtObj.mjOBJ_XBODY
    spec.add_sensor(name=FRAME, type=kind, objtype=body, objname=FRAME)
    return spec


def _mujoco(dt: float, limits: bool) -> tuple[Dynamics, Array, Array]:
    """Engine, state to start from, and the torque that holds it."""
    import mujoco

    from mjslq.dynamics.mujoco import MujocoDynamics

    dynamics = MujocoDynamics.from_spec(mujoco_spec(limits), timestep=dt)
    model = dynamics.model
    q = np.clip(model.qpos0, *model.jnt_range.T)
    data = mujoco.MjData(model)
    data.qpos = q
    mujoco.mj_forward(model, data)
    return dynamics, np.concatenate([q, np.zeros(model.nv)]), data.qfrc_bias.copy()


def _pinocchio(dt: float, limits: bool) -> tuple[Dynamics, Array, Array]:
    """Engine, state to start from, and the torque that holds it."""
    from mjslq.dynamics.pinocchio import PinocchioDynamics

    dynamics = PinocchioDynamics.from_path(
        robot_path("panda"), dt, locked_joints=FINGERS, outputs=(FRAME,), damping=0.0
    )
    x0, model = dynamics.initial_state, dynamics.model
    x0[: model.nq] = np.clip(x0[: model.nq], model.lowerPositionLimit, model.upperPositionLimit)
    return dynamics, x0, dynamics.holding_controls(x0)
