"""Body poses of a model along a trajectory, computed once, so that showing a frame costs an interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import Array


@dataclass(frozen=True)
class Motion:
    """Poses of all bodies at the knots of a trajectory, up to the first one that is not finite."""

    times: Array
    """Time of each knot. Shape (n,). [s]"""
    positions: Array
    """Origins of the bodies in the world. Shape (n, nbody, 3). [m]"""
    wxyzs: Array
    """Orientations of the bodies, with signs that do not jump from knot to knot. Shape (n, nbody, 4)."""

    def at(self, time: float) -> tuple[Array, Array]:
        """Return positions (nbody, 3) and orientations (nbody, 4) at `time`, held beyond the ends."""
        last = len(self.times) - 1
        time = float(np.clip(time, self.times[0], self.times[-1]))
        before = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, max(last - 1, 0)))
        after = min(before + 1, last)
        span = self.times[after] - self.times[before]
        share = (time - self.times[before]) / span if span > 0.0 else 0.0
        positions = (1.0 - share) * self.positions[before] + share * self.positions[after]
        wxyzs = (1.0 - share) * self.wxyzs[before] + share * self.wxyzs[after]
        return positions, wxyzs / np.linalg.norm(wxyzs, axis=1, keepdims=True)

    def spread(self, count: int) -> tuple[Array, Array]:
        """Return `count` poses evenly spread over the whole time, both ends included; (count, nbody, 3 and 4)."""
        poses = [self.at(time) for time in np.linspace(self.times[0], self.times[-1], count)]
        return np.stack([p for p, _ in poses]), np.stack([w for _, w in poses])


def motion(model: Any, scene: Scene, trajectory: Trajectory) -> Motion:
    """Return the poses of the bodies of `model` along `trajectory`; the model's own pose when no knot is finite."""
    qpos = scene.poses(trajectory.X)
    if qpos.shape[1] != model.nq:
        raise ValueError(f"the scene names {qpos.shape[1]} entries of the state as qpos, but its model has {model.nq}")
    good = finite_knots(trajectory)
    qpos = qpos[:good] if good else model.qpos0[None]
    data = mujoco.MjData(model)
    positions, wxyzs = np.empty((len(qpos), model.nbody, 3)), np.empty((len(qpos), model.nbody, 4))
    for n, q in enumerate(qpos):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        positions[n], wxyzs[n] = data.xpos, data.xquat
    flips = np.sign(np.einsum("nbi,nbi->nb", wxyzs[1:], wxyzs[:-1]))
    wxyzs[1:] *= np.cumprod(np.where(flips == 0.0, 1.0, flips), axis=0)[:, :, None]
    return Motion(trajectory.times[: len(qpos)], positions, wxyzs)


def finite_knots(trajectory: Trajectory) -> int:
    """Return the number of leading knots whose states are all finite."""
    bad = np.asarray(~np.isfinite(trajectory.X).all(axis=1))
    return int(np.argmax(bad)) if bad.any() else len(bad)


def extent(moved: Motion, bodies: Array, boxes: Array) -> tuple[Array, Array]:
    """Return the corners (3,) and (3,) [m] of the box that holds everything over the whole motion.

    `boxes` (n, 2, 3) are the lowest and highest coordinates of each piece in the frame of its body, `bodies` (n,).
    """
    corners = np.stack([boxes[:, (i >> np.arange(3)) & 1, np.arange(3)] for i in range(8)], axis=1)  # (n, 8, 3)
    wxyz = moved.wxyzs[:, bodies]
    w, v = wxyz[:, :, None, :1], wxyz[:, :, None, 1:]
    turned = np.broadcast_to(corners[None], (*wxyz.shape[:2], 8, 3))
    twice = 2.0 * np.cross(v, turned)
    points = turned + w * twice + np.cross(v, twice) + moved.positions[:, bodies][:, :, None]
    return points.min(axis=(0, 1, 2)), points.max(axis=(0, 1, 2))
