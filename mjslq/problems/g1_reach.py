"""The humanoid G1 (29 joints) reaches for a point with its right hand, standing on both feet, driven by servos.

    J = h sum_n [ 1/2 |x_n - x_0|^2_W + 1/2 r |u_n - u_0|^2 ] + 1/2 |x_N - x_0|^2_W_final + 1/2 reach |p(x_N) - p*|^2

x = (q, v) with a free base, u the angles [rad] that the joints' position servos are told, u_0 those of the stance, p
the position [m] of the hand. Servos under MuJoCo's implicitfast integrator make a humanoid an easy problem: holding
the stance is a good start.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from mjslq.costs import Control, Sensor, State
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.legged import on_floor, standing
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, count, finite, positive

FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
HAND = "right_wrist_yaw_link"
STANCE = {
    "left_hip_pitch_joint": -0.3, "left_knee_joint": 0.6, "left_ankle_pitch_joint": -0.3,
    "right_hip_pitch_joint": -0.3, "right_knee_joint": 0.6, "right_ankle_pitch_joint": -0.3,
    "left_shoulder_roll_joint": 0.2, "left_elbow_joint": 0.6,
    "right_shoulder_roll_joint": -0.2, "right_elbow_joint": 0.6,
}  # fmt: skip
STIFFNESS, DAMPING = 200.0, 5.0
"""Of the servos. [Nm/rad], [Nms/rad]"""


def g1_reach(
    x: float = 0.35,
    y: float = -0.2,
    z: float = 1.0,
    horizon: int = 100,
    timestep: float = 0.01,
    reach: float = 1e4,
    effort: float = 1.0,
    contact: str = "smooth",
) -> Problem:
    """Bring the right hand to (`x`, `y`, `z`) [m], with x forward and y to the left, in `horizon` steps.

    `reach` weighs the distance at the end [1/m^2], `effort` the departure of the servos from the stance [1/rad^2 s].
    `contact` is "smooth" or "stiff" (`mjslq.Contact`).
    """
    dynamics = g1(positive("timestep", timestep), contact)
    stance = standing(dynamics.model, STANCE)
    hold, target = stance[7 : 7 + dynamics.nu], np.array([finite(n, v) for n, v in zip("xyz", (x, y, z), strict=True)])
    nv = dynamics.ndx // 2
    weight = np.concatenate([np.full(6, 10.0), np.full(nv - 6, 0.1), np.full(nv, 0.01)])
    return Problem(
        dynamics=dynamics,
        horizon=count("horizon", horizon),
        x0=stance,
        costs=[
            State(weight, stance, "always"),
            Control(positive("effort", effort), hold),
            Sensor("hand", target, positive("reach", reach), "terminal"),
        ],
        U0=hold,
        # Contacts that open and close leave kinks in the cost; near its end the search only shuffles them.
        options={"tol_direction": 1e-3},
        describe=partial(describe, target=target),
    )


def describe(trajectory: Trajectory, target: Array) -> dict[str, str]:
    """How far the hand is from the target at the end."""
    distance = float(np.linalg.norm(trajectory.Y[-1, :3] - target))
    return {"hand": f"{1e3 * distance:.1f} mm from the target"}


def g1(timestep: float, contact: str) -> MujocoDynamics:
    """The robot on a floor, a position servo on each joint, a sensor on the right hand."""
    return MujocoDynamics.from_spec(g1_spec(timestep), name="g1", contact=contact)


def g1_spec(timestep: float) -> Any:
    """The same as a specification (mujoco.MjSpec)."""
    import mujoco

    spec: Any = on_floor("g1", FEET, timestep, 0.03)
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            servo = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=STIFFNESS, kv=DAMPING)
            joint.actfrclimited = joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    spec.body(HAND).add_site(name="hand", pos=[0.1, 0.0, 0.0])
    spec.add_sensor(
        name="hand", type=mujoco.mjtSensor.mjSENS_FRAMEPOS, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="hand"
    )
    return spec
