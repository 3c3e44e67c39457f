"""How the clip of `g1_clip` was made: a squat, a wave of the right hand, and a step forward, by kinematics alone.

    python -m mjslq.problems.g1_motion assets/clips/g1_squat_wave_step.csv

Notation
--------
    c(t), z(t)     where the centre of mass is over the floor, and how high the pelvis, as smooth pieces of time [m]
    f(t)           where each foot is; soles stay level [m]

At each sample the pelvis is moved until the centre of mass is at c, and the legs are bent by Newton steps of their six
joints until the feet are at f. Nothing of this is dynamics: no forces are known, and none may be possible; what is
recorded is what a motion-capture suit would give.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from mjslq.clips import Clip
from mjslq.problems.g1_reach import STANCE
from mjslq.problems.legged import standing
from mjslq.validation import Array

RATE, DURATION = 25.0, 4.6
"""Of the recording. [1/s], [s]"""
DIGITS = 4
"""Decimals in the file."""
STRIDE, LIFT, SHIFT, DEPTH = 0.18, 0.06, 0.085, 0.13
"""Length of the step, height of a foot on its way, way of the centre of mass to the side, depth of the squat. [m]"""
FEET = {"left": 1.0, "right": -1.0}
ROUNDS = 12
"""Moves of the pelvis for a sample, each with a Newton step of the legs."""


def motion(dynamics: Any, frames: tuple[str, ...]) -> Clip:
    """The clip, of joints and `frames` (positions and orientations), for the robot of `g1_clip`."""
    import mujoco

    from mjslq.dynamics.mujoco.frames import frame_motion

    model, times = dynamics.model, np.arange(round(RATE * DURATION) + 1) / RATE
    X, data = np.tile(standing(model, STANCE), (len(times), 1)), mujoco.MjData(model)
    data.qpos = X[0, : model.nq]
    mujoco.mj_forward(model, data)
    feet = {side: np.array(data.body(f"{side}_ankle_roll_link").xpos) for side in FEET}
    centre, height = np.array(data.subtree_com[0, :2]), float(data.qpos[2])
    for n, t in enumerate(times):
        for joint, angle in _arms(t).items():
            data.qpos[model.joint(joint).qposadr[0]] = angle
        data.qpos[2] = height - _sink(t)
        goals = {side: place + _foot(side, t) for side, place in feet.items()}
        for _ in range(ROUNDS):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            data.qpos[:2] += centre + _centre(t) - data.subtree_com[0, :2]
            for side, goal in goals.items():
                _bend(model, data, side, goal)
        X[n, : model.nq] = data.qpos
    read = frame_motion(model, X, frames)
    poses = {name: {of: found[of] for of in ("position", "orientation")} for name, found in read.items()}
    qpos = {name: X[:, i] for i, name in enumerate(dynamics.state_names[: model.nq])}
    return Clip(times, poses, qpos, name="g1_squat_wave_step")


def _smooth(t: float, begin: float, end: float) -> float:
    """From 0 to 1, at rest at both ends."""
    s = min(max((t - begin) / (end - begin), 0.0), 1.0)
    return s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)


def _sink(t: float) -> float:
    """How far the pelvis is below the stance."""
    squat = DEPTH * (_smooth(t, 0.2, 0.7) - _smooth(t, 0.8, 1.3))
    return squat + 0.03 * (_smooth(t, 1.1, 1.7) - _smooth(t, 3.9, 4.4))


def _centre(t: float) -> Array:
    """Way of the centre of mass: over the left foot, over the right foot, and between them again."""
    forward = 0.5 * (_smooth(t, 1.8, 2.6) + _smooth(t, 2.6, 3.4))
    side = _smooth(t, 1.2, 1.8) - 2.0 * _smooth(t, 2.5, 3.1) + _smooth(t, 3.7, 4.3)
    return np.array([STRIDE * forward, SHIFT * side])


def _foot(side: str, t: float) -> Array:
    begin, end = {"right": (1.85, 2.4), "left": (3.15, 3.7)}[side]
    s = _smooth(t, begin, end)
    return np.array([STRIDE * s, 0.0, 16.0 * LIFT * (s * (1.0 - s)) ** 2])


def _arms(t: float) -> dict[str, float]:
    raised, swing = _smooth(t, 0.3, 1.1) - _smooth(t, 3.6, 4.4), _smooth(t, 0.2, 0.7) - _smooth(t, 0.8, 1.3)
    wave = raised * np.sin(2.0 * np.pi * 1.5 * t)
    return {
        "left_shoulder_pitch_joint": -0.8 * swing,
        "right_shoulder_pitch_joint": -1.9 * raised,
        "right_shoulder_roll_joint": STANCE["right_shoulder_roll_joint"] - 0.3 * raised + 0.35 * wave,
        "right_elbow_joint": STANCE["right_elbow_joint"] + 0.4 * raised,
        "waist_yaw_joint": 0.15 * wave,
    }


def _bend(model: Any, data: Any, side: str, goal: Array) -> None:
    """A Newton step of a leg's joints towards a place of its level foot."""
    import mujoco

    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    foot = data.body(f"{side}_ankle_roll_link")
    moves, turns, turn = np.zeros((3, model.nv)), np.zeros((3, model.nv)), np.empty(3)
    mujoco.mj_jacBody(model, data, moves, turns, foot.id)
    mujoco.mju_quat2Vel(turn, foot.xquat, 1.0)
    joints = [model.joint(f"{side}_{name}_joint") for name in (
        "hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")]  # fmt: skip
    dofs, entries = ([int(getattr(joint, a)[0]) for joint in joints] for a in ("dofadr", "qposadr"))
    away = np.concatenate([goal - foot.xpos, -turn])
    data.qpos[entries] += np.linalg.solve(np.vstack([moves, turns])[:, dofs], away)


def main(path: str) -> None:
    """Write the clip to `path`."""
    from mjslq.problems.g1_clip import BODIES, robot

    motion(robot(0.02, "smooth", "servo"), BODIES).save(path, DIGITS)


if __name__ == "__main__":
    main(sys.argv[1])
