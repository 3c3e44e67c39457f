"""Body poses of a model along a trajectory, computed once, so that showing a frame costs an interpolation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import mujoco
import numpy as np

from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

Found = TypeVar("Found")


@dataclass(frozen=True)
class Frame:
    """A time of a motion: between which knots it is, and the poses of all bodies."""

    moved: Motion
    """The motion."""
    time: float
    """Time within the motion. [s]"""
    before: int
    """Last knot that is not after it."""
    after: int
    """The knot that follows; the same at the end."""
    share: float
    """How far it is from `before` to `after`, in [0, 1]."""
    positions: Array
    """Origins of the bodies in the world. Shape (nbody, 3). [m]"""
    wxyzs: Array
    """Orientations of the bodies. Shape (nbody, 4)."""

    @property
    def nearest(self) -> int:
        """The nearest knot."""
        return self.after if self.share > 0.5 else self.before

    def of(self, values: Array) -> Array:
        """Interpolate values at the knots (n, ...)."""
        return (1.0 - self.share) * values[self.before] + self.share * values[self.after]


@dataclass(frozen=True)
class Motion:
    """Poses of all bodies at the knots of a trajectory, up to the first one that is not finite."""

    times: Array
    """Time of each knot. Shape (n,). [s]"""
    positions: Array
    """Origins of the bodies in the world. Shape (n, nbody, 3). [m]"""
    wxyzs: Array
    """Orientations of the bodies, with signs that do not jump from knot to knot. Shape (n, nbody, 4)."""
    qpos: Array
    """Joint positions. Shape (n, nq)."""
    states: tuple[Array, Array] | None = None
    """X (n, nx) and U (n, nu), the last control held, where they are the states and controls of the drawn model."""
    _found: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def frame(self, time: float) -> Frame:
        """Return the poses of the bodies at `time`, held beyond the ends."""
        last = len(self.times) - 1
        time = float(np.clip(time, self.times[0], self.times[-1]))
        before = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, max(last - 1, 0)))
        after = min(before + 1, last)
        span = self.times[after] - self.times[before]
        share = float((time - self.times[before]) / span) if span > 0.0 else 0.0
        positions = (1.0 - share) * self.positions[before] + share * self.positions[after]
        wxyzs = (1.0 - share) * self.wxyzs[before] + share * self.wxyzs[after]
        return Frame(self, time, before, after, share, positions, wxyzs / np.linalg.norm(wxyzs, axis=1, keepdims=True))

    def at(self, time: float) -> tuple[Array, Array]:
        """Return positions (nbody, 3) and orientations (nbody, 4) at `time`, held beyond the ends."""
        frame = self.frame(time)
        return frame.positions, frame.wxyzs

    def spread(self, count: int) -> tuple[Array, Array]:
        """Return `count` poses evenly spread over the whole time, both ends included; (count, nbody, 3 and 4)."""
        poses = [self.at(time) for time in np.linspace(self.times[0], self.times[-1], count)]
        return np.stack([p for p, _ in poses]), np.stack([w for _, w in poses])

    def first(self) -> Motion:
        """Return the motion's first knot alone."""
        states = None if self.states is None else (self.states[0][:1], self.states[1][:1])
        return Motion(self.times[:1], self.positions[:1], self.wxyzs[:1], self.qpos[:1], states)

    def once(self, name: str, compute: Callable[[], Found]) -> Found:
        """Return what `compute` finds of this motion, computed when first asked for."""
        if name not in self._found:
            self._found[name] = compute()
        found: Found = self._found[name]
        return found


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
    states = _states(model, scene, trajectory, good)
    return Motion(trajectory.times[: len(qpos)], positions, wxyzs, qpos, states)


def finite_knots(trajectory: Trajectory) -> int:
    """Return the number of leading knots whose states are all finite."""
    bad = np.asarray(~np.isfinite(trajectory.X).all(axis=1))
    return int(np.argmax(bad)) if bad.any() else len(bad)


def rotated(wxyz: Array, vectors: Array) -> Array:
    """Turn vectors (..., 3) by unit quaternions (..., 4)."""
    w, v = wxyz[..., :1], wxyz[..., 1:]
    twice = 2.0 * np.cross(v, vectors)
    return np.asarray(vectors + w * twice + np.cross(v, twice))


def extent(moved: Motion, bodies: Array, boxes: Array) -> tuple[Array, Array]:
    """Return the corners (3,) and (3,) [m] of the box that holds everything over the whole motion.

    `boxes` (n, 2, 3) are the lowest and highest coordinates of each piece in the frame of its body, `bodies` (n,).
    """
    corners = np.stack([boxes[:, (i >> np.arange(3)) & 1, np.arange(3)] for i in range(8)], axis=1)  # (n, 8, 3)
    wxyz = moved.wxyzs[:, bodies, None]
    turned = np.broadcast_to(corners[None], (*wxyz.shape[:2], 8, 3))
    points = rotated(wxyz, turned) + moved.positions[:, bodies][:, :, None]
    return points.min(axis=(0, 1, 2)), points.max(axis=(0, 1, 2))


def _states(model: Any, scene: Scene, trajectory: Trajectory, good: int) -> tuple[Array, Array] | None:
    """States and controls at the knots, where the model that is drawn is the one that moved."""
    X, U = trajectory.X[:good], trajectory.U
    own = scene.columns == tuple(range(model.nq)) and not scene.lines
    if not good or not own or X.shape[1] != model.nq + model.nv + model.na or U.shape[1] != model.nu:
        return None
    rows = np.minimum(np.arange(good), max(len(U) - 1, 0))
    controls = U[rows] if len(U) else np.zeros((good, model.nu))
    return X, np.where(np.isfinite(controls), controls, 0.0)
