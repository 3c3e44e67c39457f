"""The humanoid G1 (29 joints) tracks a recorded motion: twelve bodies' places, attitudes and velocities.

    J = h sum_n [ sum_b w_p rho(p_b - p_b*) + w_R rho(log(R_b*' R_b)) + w_v rho(v_b - v_b*) + w_w rho(w_b - w_b*)
                  + 1/2 effort |u_n - u_n*|^2 ] + a tenth of the same, but for u, at n = N

b goes over the bodies, starred quantities are those of the clip at the knot's time, rho is the pseudo-Huber loss. Each
control is held over two simulator steps. u are

    drive="servo"   the angles [rad] that the joints' position servos are told, within the joints' ranges; u* those of
                    the clip
    drive="motor"   the joints' torques [Nm], within the efforts of the robot's description; u* = 0

The clip, `g1_squat_wave_step.csv`, is our own: a squat, a wave of the right hand, a step with either foot
(`mjslq.problems.g1_motion`). Its velocities are differences of its poses, and nobody has checked that it is possible.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mjslq.clips import Clip, load
from mjslq.costs import Control, Frame
from mjslq.dynamics.dynamics import Feedback
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.assets import asset_path
from mjslq.problems.g1_reach import g1_spec
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose, count, nonnegative, positive

BODIES = (
    "pelvis", "torso_link", "left_hip_roll_link", "left_knee_link", "left_ankle_roll_link", "right_hip_roll_link",
    "right_knee_link", "right_ankle_roll_link", "left_elbow_link", "left_wrist_yaw_link", "right_elbow_link",
    "right_wrist_yaw_link",
)  # fmt: skip
WEIGHTS = {"position": 100.0, "orientation": 10.0, "linear-velocity": 1.0, "angular-velocity": 0.1}
"""w_p [1/m], w_R, w_v, w_w over the number of bodies; of the losses per second."""
EFFORT = {"servo": 1.0, "motor": 1e-5}
"""Weight of u where none is given. [1/rad^2 s], [1/(Nm)^2 s]"""
TERMINAL = 0.1
"""Factor of the weights at n = N: small, as feedback is strong near an end, and plans that move on repeat it."""

STIFFNESS, DAMPING = 300.0, 1.5
"""Of the servos whose torques are the motors' start; held over a step, more damping would shake light joints.
[Nm/rad], [Nms/rad]"""


def g1_clip(
    horizon: int = 50,
    timestep: float = 0.02,
    start: float = 0.0,
    effort: float = 0.0,
    contact: str = "smooth",
    drive: str = "servo",
) -> Problem:
    """Track the clip from its time `start` [s] on, over `horizon` steps of `timestep` [s], two simulator steps each.

    `effort` weighs the controls, 1 [1/rad^2 s] for servos and 1e-5 [1/(Nm)^2 s] for motors where it is 0. `contact` is
    "smooth" or "stiff", `drive` "servo" or "motor". The search begins with the clip's own angles as the servos', and
    for motors with the torques of such servos along the way that these take.
    """
    N, h = count("horizon", horizon), positive("timestep", timestep)
    weight = nonnegative("effort", effort) or EFFORT[choose("drive", drive, EFFORT)]
    offset, dynamics, clip = nonnegative("start", start), robot(h, contact, drive), recorded()
    x0, targets = clip.states(dynamics, 0.0, offset), clip.joint_signal(dynamics.control_names, offset)
    scaled = {of: weight / len(BODIES) for of, weight in WEIGHTS.items()}
    terms = clip.costs(dynamics, scaled, terminal=TERMINAL, offset=offset)
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=x0,
        costs=[Control(weight, targets if drive == "servo" else 0.0), *terms],
        U0=targets.over(np.arange(0.0, N) * h) if drive == "servo" else _torques(dynamics, clip, x0, offset, N),
        # Gauss-Newton is quick here, and second derivatives over several simulator steps a knot are dear.
        options={"tol_direction": 1e-3, "curvature": "never"},
        describe=partial(describe, terms=terms, dynamics=dynamics),
    )


def recorded() -> Clip:
    """The clip."""
    return load(asset_path("clips/g1_squat_wave_step.csv"))


def describe(trajectory: Trajectory, terms: list[Frame], dynamics: MujocoDynamics) -> dict[str, str]:
    """How far the bodies are from those of the clip."""
    distance = distances(trajectory, terms, dynamics)
    return {"bodies": f"{1e3 * distance.mean():.1f} mm from the clip's on average, {1e3 * distance.max():.1f} at most"}


def distances(trajectory: Trajectory, terms: list[Frame], dynamics: MujocoDynamics) -> Array:
    """Distance of each body from that of the clip at each knot. Shape (N + 1, bodies). [m]"""
    placed = [term for term in terms if isinstance(term, Frame) and term.of == "position"]
    away = [
        trajectory.Y[:, dynamics.outputs[term.output(dynamics)].columns] - term.target.over(trajectory.times)  # type: ignore[union-attr]
        for term in placed
    ]
    return np.linalg.norm(np.stack(away, axis=1), axis=2)


def robot(h: float, contact: str, drive: str) -> MujocoDynamics:
    """The robot on a floor with servos or motors, and sensors of the bodies; a step of the horizon takes `h` [s]."""
    import mujoco

    spec = g1_spec(h / 2.0)
    for actuator in spec.actuators:
        joint = spec.joint(actuator.target)
        if drive == "motor":
            actuator.set_to_motor()
        actuator.ctrlrange = joint.range if drive == "servo" else joint.actfrcrange
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
    return MujocoDynamics.from_spec(spec, substeps=2, frames=BODIES, name="g1", contact=contact)


def _torques(dynamics: MujocoDynamics, clip: Clip, x0: Array, offset: float, N: int) -> Array:
    """Torques of servos that are told the clip's angles, along the motion that they make. Shape (N, nu)."""
    nu, nv = dynamics.nu, dynamics.nv
    X = clip.states(dynamics, dynamics.dt * np.arange(N + 1), offset)
    K = np.zeros((N, nu, dynamics.ndx))
    K[:, :, nv - nu : nv], K[:, :, -nu:] = STIFFNESS * np.eye(nu), DAMPING * np.eye(nu)
    law = Feedback(X, K, *(np.tile(limit, (N, 1)) for limit in dynamics.control_limits.T))
    return np.array(dynamics.rollouts(x0[None], np.zeros((1, N, nu)), law)[0].U)
