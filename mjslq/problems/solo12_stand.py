"""The quadruped Solo12 rises from a crouch and stands, pushing against the floor with torque-driven legs.

    J = h sum_n [ 1/2 |x_n - x_stand|^2_W + 1/2 r |u_n|^2 ] + 1/2 |x_N - x_stand|^2_{W_final}

x = (q, v) with a free base, u the twelve joint torques [Nm]. The feet touch the floor through a smooth contact.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from mjslq.constraints import Sensor
from mjslq.costs import Control, State
from mjslq.dynamics.dynamics import Feedback
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.legged import on_floor, standing
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, count, nonnegative, positive

LEGS = ("FL", "FR", "HL", "HR")
FOOT_RADIUS = 0.0155
"""Of the ball under each leg. [m]"""
SPRING, DAMPER = 5.0, 0.1
"""Of the legs at the start of the search. [Nm/rad], [Nms/rad]"""


def solo12_stand(
    horizon: int = 100,
    timestep: float = 0.01,
    crouch: float = 1.2,
    stand: float = 0.8,
    effort: float = 1e-2,
    contact: str = "smooth",
    torque: float = 0.0,
    slip: float = 0.0,
) -> Problem:
    """Rise from thighs at the angle `crouch` to `stand` [rad], knees at twice as much, in `horizon` steps [s].

    `contact` is "smooth" or "stiff" (`mjslq.Contact`). `torque` limits the motors [Nm], `slip` how far a foot may
    slide from where it stands, along x and along y [m]: so torques are limited to what friction holds. 0 for none.
    """
    limit, feet = nonnegative("torque", torque), nonnegative("slip", slip) > 0.0
    dynamics = solo12(positive("timestep", timestep), contact, limit, feet)
    start, goal = (standing(dynamics.model, posture(angle)) for angle in (crouch, stand))
    nv = dynamics.ndx // 2
    positions = np.concatenate([[10.0, 10.0, 10.0, 10.0, 10.0, 10.0], np.full(nv - 6, 1.0)])
    running = np.concatenate([positions, np.full(nv, 0.01)])
    final = np.concatenate([100.0 * positions, np.full(nv, 1.0)])
    return Problem(
        dynamics=dynamics,
        horizon=count("horizon", horizon),
        x0=start,
        costs=[State(running, goal), State(final, goal, "terminal"), Control(positive("effort", effort))],
        constraints=_on_their_spots(dynamics, start, slip) if slip else [],
        U0=spring_legs(dynamics, start, goal, horizon),
        # Contacts that open and close leave kinks in the cost; near its end the search only shuffles them.
        options={"tol_direction": 1e-3},
        describe=partial(describe, height=goal[2]),
    )


def describe(trajectory: Trajectory, height: float) -> dict[str, str]:
    """How high the base has come."""
    z, speed = trajectory.X[-1, 2], float(np.linalg.norm(trajectory.X[-1, 19:22]))
    torque = float(np.abs(trajectory.U).max())
    said = {"torque": f"{torque:.3f} Nm at most"}
    if trajectory.Y.shape[1]:
        slid = np.abs(trajectory.Y - trajectory.Y[0]).reshape(-1, 4, 3)[:, :, :2].max()
        said["feet"] = f"slide {1e3 * slid:.2f} mm at most"
    return said | {"base": f"at {z:.4f} m, {1e3 * (z - height):+.1f} mm from where it is to be, speed {speed:.3f} m/s"}


def _on_their_spots(dynamics: MujocoDynamics, start: Array, slip: float) -> list[Sensor]:
    """Limits of the feet's places on the floor, about those at the start."""
    Y, feet = dynamics.rollout(start, np.zeros((1, dynamics.nu))).Y[0].reshape(-1, 3), []
    for leg, place in zip(LEGS, Y, strict=True):
        reach = np.array([slip, slip, np.inf])
        feet.append(Sensor(f"{leg}_foot", place - reach, place + reach))
    return feet


def spring_legs(dynamics: MujocoDynamics, start: Array, goal: Array, N: int) -> Array:
    """Torques of legs that springs and dampers pull into the posture of `goal`: a start that stays on its feet."""
    nv, joints = dynamics.ndx // 2, np.arange(dynamics.nu)
    K = np.zeros((N, dynamics.nu, dynamics.ndx))
    K[:, joints, 6 + joints], K[:, joints, nv + 6 + joints] = SPRING, DAMPER
    law = Feedback.unlimited(np.tile(goal, (N + 1, 1)), K)
    return dynamics.rollouts(start[None], np.zeros((1, N, dynamics.nu)), law)[0].U


def posture(angle: float) -> dict[str, float]:
    """Angles of the joints with thighs at `angle` [rad], knees bent by twice as much, hind legs mirrored."""
    front = {f"{leg}_HFE": angle for leg in LEGS[:2]} | {f"{leg}_KFE": -2.0 * angle for leg in LEGS[:2]}
    hind = {f"{leg}_HFE": -angle for leg in LEGS[2:]} | {f"{leg}_KFE": 2.0 * angle for leg in LEGS[2:]}
    return front | hind


def solo12(timestep: float, contact: str, torque: float = 0.0, feet: bool = False) -> MujocoDynamics:
    """The robot on a floor, a motor of at most `torque` on each joint (0: any), with sensors of its `feet` if asked."""
    import mujoco

    spec: Any = on_floor("solo12", tuple(f"{leg}_FOOT" for leg in LEGS), timestep, 0.01, FOOT_RADIUS)
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            motor = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.gainprm[0] = 1.0
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
            if torque:
                motor.ctrllimited, motor.ctrlrange = True, [-torque, torque]
    for leg in LEGS if feet else ():
        kind, body = mujoco.mjtSensor.mjSENS_FRAMEPOS, mujoco.mjtObj.mjOBJ_XBODY
        spec.add_sensor(name=f"{leg}_foot", type=kind, objtype=body, objname=f"{leg}_FOOT")
    return MujocoDynamics.from_spec(spec, name="solo12", contact=contact)
