"""The humanoid G1 (29 joints) tracks a recorded motion: twelve bodies' places, attitudes and velocities.

    J = h sum_n [ sum_b w_p rho(p_b - p_b*) + w_R/2 |log(R_b*' R_b)|^2 + w_v/2 |v_b - v_b*|^2 + w_w/2 |w_b - w_b*|^2
                  + 1/2 effort |u_n - q*_n|^2 ] + the same, but for u, at n = N

b goes over the bodies, starred quantities are those of the clip at the knot, rho is the pseudo-Huber loss of width
0.1 m. u are the angles [rad] that the joints' servos are told, within the joints' ranges; each is held over two
simulator steps. The clip is made here: a squat, the arms waving, the feet where they are; its bodies are those of the
model in the postures of the clip.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from mjslq.costs import Control, CostTerm, Sensor
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.g1_reach import STANCE, g1_spec
from mjslq.problems.legged import standing
from mjslq.trajectory import Trajectory
from mjslq.validation import count, positive

BODIES = (
    "pelvis", "torso_link", "left_hip_roll_link", "left_knee_link", "left_ankle_roll_link", "right_hip_roll_link",
    "right_knee_link", "right_ankle_roll_link", "left_elbow_link", "left_wrist_yaw_link", "right_elbow_link",
    "right_wrist_yaw_link",
)  # fmt: skip
QUANTITIES = ("place", "attitude", "velocity", "turning")
WEIGHTS = {"place": 100.0, "attitude": 10.0, "velocity": 1.0, "turning": 0.1}
"""w_p [1/m], w_R, w_v, w_w; of the losses per second."""
DEEP = {
    "left_hip_pitch_joint": -0.9, "left_knee_joint": 1.6, "left_ankle_pitch_joint": -0.7,
    "right_hip_pitch_joint": -0.9, "right_knee_joint": 1.6, "right_ankle_pitch_joint": -0.7,
}  # fmt: skip
"""The squat at its deepest. [rad]"""


def g1_clip(horizon: int = 50, timestep: float = 0.02, effort: float = 1.0, contact: str = "smooth") -> Problem:
    """Track a squat with waving arms over `horizon` steps of `timestep` [s], two simulator steps each.

    `effort` weighs the departure of the servos from the clip [1/rad^2 s]. `contact` is "smooth" or "stiff".
    """
    N, h = count("horizon", horizon), positive("timestep", timestep)
    dynamics = _dynamics(h, contact)
    clip = _clip(dynamics, N, h)
    joints = clip.X[:, 7 : 7 + dynamics.nu]
    terms: list[CostTerm] = [Control(positive("effort", effort), joints[:-1])]
    for body in BODIES:
        for quantity in QUANTITIES:
            columns = dynamics.outputs[f"{body}/{quantity}"].columns
            loss: Any = {"loss": "pseudo-huber", "width": 0.1} if quantity == "place" else {}
            terms.append(
                Sensor(f"{body}/{quantity}", clip.Y[:, columns], WEIGHTS[quantity] / len(BODIES), "always", **loss)
            )
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=clip.X[0],
        costs=terms,
        U0=joints[:-1],
        # Gauss-Newton is quick here, and second derivatives over several simulator steps a knot are dear.
        options={"tol_direction": 1e-3, "curvature": "never"},
        describe=partial(describe, clip=clip, outputs=dynamics.outputs),
    )


def describe(trajectory: Trajectory, clip: Trajectory, outputs: dict[str, Any]) -> dict[str, str]:
    """How far the bodies are from those of the clip."""
    columns = np.concatenate([np.r_[outputs[f"{body}/place"].columns] for body in BODIES])
    away = (trajectory.Y[:, columns] - clip.Y[:, columns]).reshape(len(clip.X), len(BODIES), 3)
    distance = np.linalg.norm(away, axis=2)
    return {"bodies": f"{1e3 * distance.mean():.1f} mm from the clip's on average, {1e3 * distance.max():.1f} at most"}


def _dynamics(h: float, contact: str) -> MujocoDynamics:
    import mujoco

    spec = g1_spec(h / 2.0)
    for servo in spec.actuators:
        servo.ctrlrange, servo.ctrllimited = spec.joint(servo.target).range, mujoco.mjtLimited.mjLIMITED_TRUE
    kinds = {
        "place": mujoco.mjtSensor.mjSENS_FRAMEPOS, "attitude": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
        "velocity": mujoco.mjtSensor.mjSENS_FRAMELINVEL, "turning": mujoco.mjtSensor.mjSENS_FRAMEANGVEL,
    }  # fmt: skip
    for body in BODIES:
        for quantity in QUANTITIES:
            kind, name = kinds[quantity], f"{body}/{quantity}"
            spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname=body)
    return MujocoDynamics.from_spec(spec, substeps=2, name="g1", contact=contact)


def _clip(dynamics: MujocoDynamics, N: int, h: float) -> Trajectory:
    """The motion: states, and what the sensors read of each."""
    import mujoco

    model, t = dynamics.model, np.linspace(0.0, 1.0, N + 1)
    depth, wave = 0.5 * (1.0 - np.cos(2.0 * np.pi * t)), np.sin(4.0 * np.pi * t) * np.sin(np.pi * t)
    X, data, foot = np.zeros((N + 1, dynamics.nx)), mujoco.MjData(model), model.body(BODIES[4]).id
    for n in range(N + 1):
        posture = {joint: angle + depth[n] * (DEEP.get(joint, angle) - angle) for joint, angle in STANCE.items()}
        posture["left_shoulder_pitch_joint"], posture["right_shoulder_pitch_joint"] = 0.6 * wave[n], -0.6 * wave[n]
        X[n] = standing(model, posture)
        data.qpos = X[n, : model.nq]
        mujoco.mj_kinematics(model, data)
        X[n, 0] -= data.xpos[foot, 0]  # the feet stay where they are, the body moves
    X[:, 0] -= X[0, 0]
    positions = X[:, : model.nq]
    for n in range(1, N):
        mujoco.mj_differentiatePos(model, X[n, model.nq :], 2.0 * h, positions[n - 1], positions[n + 1])
    Y = np.empty((N + 1, dynamics.ny))
    for n in range(N + 1):
        data.qpos, data.qvel = positions[n], X[n, model.nq :]
        mujoco.mj_forward(model, data)
        Y[n] = data.sensordata
    return Trajectory(X, np.zeros((N, dynamics.nu)), Y, h)
