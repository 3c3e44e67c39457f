"""What MuJoCo computes from joint positions besides the poses of bodies, at the knots of a motion.

    joint axes      data.xanchor, data.xaxis
    cameras         data.cam_xpos, data.cam_xmat
    tendons         their paths over sites and round geoms, from data.wrap_xpos and data.wrap_obj
    flexes          data.flexvert_xpos

It is computed when first drawn, in one pass over the knots, and kept with the motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjslq.validation import Array
from mjslq.viewer.motion import Frame, Motion

_PULLEY = -2  # in data.wrap_obj: the path is interrupted


@dataclass(frozen=True)
class Details:
    """Of a model, at the n knots of a motion."""

    anchors: Array
    """Where the axes of joints pass. Shape (n, njnt, 3). [m]"""
    axes: Array
    """Directions of the axes of joints. Shape (n, njnt, 3)."""
    camera_positions: Array
    """Shape (n, ncam, 3). [m]"""
    camera_rotations: Array
    """Columns are right, up and backward. Shape (n, ncam, 3, 3)."""
    segments: tuple[Array, ...]
    """Ends of the straight pieces of each spatial tendon; zero length beyond their number. Each (n, k, 2, 3). [m]"""
    wrapped: tuple[NDArray[np.bool_], ...]
    """Which pieces lie on a geom. Each (n, k)."""
    vertices: Array
    """Of all flexes. Shape (n, nflexvert, 3). [m]"""


def details(model: Any, moved: Motion) -> Details:
    """Return what MuJoCo computes at the knots of `moved`, once."""
    return moved.once("details", lambda: _details(model, moved))


def _details(model: Any, moved: Motion) -> Details:
    data, n = mujoco.MjData(model), len(moved.qpos)
    arrays = {
        name: np.empty((n, *np.shape(getattr(data, name))))
        for name in ("xanchor", "xaxis", "cam_xpos", "cam_xmat", "flexvert_xpos")
    }
    paths: list[list[tuple[Array, Array]]] = []
    for i, qpos in enumerate(moved.qpos):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        mujoco.mj_flex(model, data)
        mujoco.mj_tendon(model, data)
        for name, array in arrays.items():
            array[i] = getattr(data, name)
        paths.append([tendon_path(data, tendon) for tendon in range(model.ntendon)])
    padded = [_padded([path[tendon] for path in paths]) for tendon in range(model.ntendon)]
    return Details(
        arrays["xanchor"],
        arrays["xaxis"],
        arrays["cam_xpos"],
        arrays["cam_xmat"].reshape(n, -1, 3, 3),
        tuple(segments for segments, _ in padded),
        tuple(wrapped for _, wrapped in padded),
        arrays["flexvert_xpos"],
    )


def tendon_path(data: Any, tendon: int) -> tuple[Array, Array]:
    """Return the ends of the straight pieces (k, 2, 3) [m] of a tendon, and which of them (k,) lie on a geom."""
    rows = slice(int(data.ten_wrapadr[tendon]), int(data.ten_wrapadr[tendon]) + int(data.ten_wrapnum[tendon]))
    points, objects = data.wrap_xpos.reshape(-1, 3)[rows].copy(), data.wrap_obj.reshape(-1)[rows]
    drawn = (objects[:-1] != _PULLEY) & (objects[1:] != _PULLEY)
    segments = np.stack([points[:-1], points[1:]], axis=1)[drawn]
    return segments, ((objects[:-1] >= 0) & (objects[1:] >= 0))[drawn]


def between(frame: Frame, segments: Array, wrapped: NDArray[np.bool_]) -> Array:
    """Pieces of a tendon (k, 2, 3) at a frame: between two knots where the path is over the same things at both."""
    a, b = frame.before, frame.after
    lengths = np.linalg.norm(segments[[a, b], :, 1] - segments[[a, b], :, 0], axis=2) > 0.0
    if np.array_equal(wrapped[a], wrapped[b]) and np.array_equal(lengths[0], lengths[1]):
        return frame.of(segments)
    return np.asarray(segments[frame.nearest])


def _padded(paths: list[tuple[Array, Array]]) -> tuple[Array, NDArray[np.bool_]]:
    most = max(len(segments) for segments, _ in paths)
    segments = np.zeros((len(paths), most, 2, 3))
    wrapped = np.zeros((len(paths), most), dtype=bool)
    for n, (some, on) in enumerate(paths):
        segments[n, : len(some)], wrapped[n, : len(some)] = some, on
    return segments, wrapped
