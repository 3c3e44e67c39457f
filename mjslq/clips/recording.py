"""Samples of a motion: what a clip of it holds."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.records import QUANTITIES
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose

Samples = dict[str, Array]


def record(
    motion: Any, dynamics: Dynamics, frames: tuple[str, ...]
) -> tuple[Array, dict[str, Samples], Samples, Samples]:
    """Times, frames, joint positions and velocities of a motion at its knots. Raises ValueError."""
    trajectory = getattr(motion, "trajectory", motion)
    if not isinstance(trajectory, Trajectory):
        raise ValueError(f"motion must be a Trajectory, or have one as a Result does, got {type(motion).__name__}")
    dynamics.check_trajectory(trajectory)
    names, nv = dynamics.state_names, dynamics.nv
    nq, X = dynamics.nx - dynamics.ndx + nv, trajectory.X
    qpos = {name: X[:, i] for i, name in enumerate(names[:nq])} if nv else {}
    qvel = {name.removesuffix(".vel"): X[:, nq + i] for i, name in enumerate(names[nq : nq + nv])} if nv else {}
    return trajectory.times, _frames(trajectory, dynamics, frames), qpos, qvel


def _frames(trajectory: Trajectory, dynamics: Dynamics, frames: tuple[str, ...]) -> dict[str, Samples]:
    if not frames:
        return {}
    model = getattr(dynamics, "model", None)
    if hasattr(model, "sensor_type"):
        from mjslq.dynamics.mujoco.frames import frame_motion

        return frame_motion(model, trajectory.X, frames)
    Y = trajectory.Y if trajectory.Y.size else dynamics.rollout(trajectory.X[0], trajectory.U).Y
    found: dict[str, Samples] = {}
    for frame in frames:
        outputs = {}
        for of in QUANTITIES:
            try:
                outputs[of] = dynamics.outputs[dynamics.frame_output(frame, of)].columns
            except ValueError as error:
                if of == "position":
                    raise error
        found[frame] = {of: np.array(Y[:, columns]) for of, columns in outputs.items()}
    return found


def velocity_entry(name: str, velocities: list[str]) -> int:
    """Index of a velocity that a clip calls `name` among the names of a robot's. Raises ValueError."""
    if f"{name}.vel" in velocities:
        return velocities.index(f"{name}.vel")
    return velocities.index(choose("velocity of the robot", name, [v.removesuffix(".vel") for v in velocities]))
