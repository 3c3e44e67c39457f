"""Outputs of a Pinocchio model: where its frames are, and how they are turned.

Notation
--------
    R_n, t_n   rotation and position of a joint in the world at knot n      (M, 3, 3), (M, 3)
    F, f       placement of a frame on its joint                            (3, 3), (3,)
    J          joint Jacobians in the world frame, data.J: a row per dof, velocity of the point at the origin first,
               angular velocity next                                        (M, nv, 6)

    "name"               position     p = R f + t             dp/dq = J_v + J_w x p             (3,) [m]
    "name.orientation"   quaternion   (w, x, y, z) of R F     1/2 quaternion o (0, (R F)' J_w)  (4,)

Columns of joints that do not move the frame are zero. The quaternions have w >= 0.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from mjslq.dynamics.dynamics import Output
from mjslq.dynamics.pinocchio import kernels
from mjslq.rotation import product
from mjslq.validation import Array

ORIENTATION = ".orientation"
_PREFERRED = ("BODY", "OP_FRAME", "FIXED_JOINT", "JOINT", "SENSOR")


@dataclass(frozen=True)
class Reading:
    """One output: a frame's position or its orientation."""

    name: str
    frame: int
    joint: int
    rotation: Array
    """Of the frame on its joint. Shape (3, 3)."""
    position: Array
    """Of the frame on its joint. Shape (3,). [m]"""
    moved_by: Array
    """1 for the dofs that move the frame, 0 for the others. Shape (nv,)."""
    columns: slice
    orientation: bool


class Readings:
    """All outputs of a model."""

    def __init__(self, model: Any, names: Sequence[str]) -> None:
        if isinstance(names, str):
            raise ValueError(f"outputs must be a sequence of frame names, got the text {names!r}; write ({names!r},)")
        if len(set(names)) < len(names):
            raise ValueError(f"outputs must differ from each other, got {', '.join(names)}")
        frames = _frames_by_name(model)
        self.all: list[Reading] = []
        start = 0
        for name in names:
            orientation = name not in frames and name.endswith(ORIENTATION)
            index = _find_frame(name.removesuffix(ORIENTATION) if orientation else name, frames)
            stop = start + (4 if orientation else 3)
            frame = model.frames[index]
            joint, placement = int(frame.parentJoint), frame.placement
            moved_by = np.zeros(model.nv)
            for j in list(model.supports[joint])[1:]:  # the first is the world
                moved_by[model.idx_vs[j] : model.idx_vs[j] + model.nvs[j]] = 1.0
            self.all.append(
                Reading(
                    name, index, joint, placement.rotation.copy(), placement.translation.copy(), moved_by,
                    slice(start, stop), orientation,
                )
            )  # fmt: skip
            start = stop
        self.ny = start
        self.joints = sorted({reading.joint for reading in self.all})
        """The joints whose placements tell all readings."""

    @property
    def outputs(self) -> dict[str, Output]:
        """Readings by name."""
        return {reading.name: Output(reading.columns, reading.orientation) for reading in self.all}

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each entry of y."""
        return tuple(f"{r.name}[{i}]" for r in self.all for i in range(r.columns.stop - r.columns.start))

    def read(self, placements: dict[int, tuple[Array, Array]], knots: int) -> Array:
        """Y at all knots, given (R, t) of each joint. Shape (knots, ny)."""
        Y = np.empty((knots, self.ny))
        for r in self.all:
            R, t = placements[r.joint]
            Y[:, r.columns] = quaternions(R @ r.rotation) if r.orientation else R @ r.position + t
        return Y

    def jacobian(self, placements: dict[int, tuple[Array, Array]], J: Array) -> Array:
        """dy/dq at all knots. Shape (M, ny, nv)."""
        C = np.zeros((len(J), self.ny, J.shape[1]))
        for r in self.all:
            R, t = placements[r.joint]
            if r.orientation:
                turned = R @ r.rotation
                q = quaternions(turned)
                half = np.stack([0.5 * product(q, np.broadcast_to(e, q.shape)) for e in np.eye(4)[1:]], axis=-1)
                C[:, r.columns] = half @ (J[..., 3:] @ turned).swapaxes(1, 2) * r.moved_by
            else:
                kernels.position_jacobian(J, R @ r.position + t, r.moved_by, C[:, r.columns])
        return C

    def read_plainly(self, model: Any, data: Any, q: Array) -> Array:
        """Y at one configuration, by Pinocchio's own frame placements. Shape (ny,)."""
        pin.framesForwardKinematics(model, data, q)
        y = np.zeros(self.ny)
        for r in self.all:
            placement = data.oMf[r.frame]
            y[r.columns] = quaternions(placement.rotation) if r.orientation else placement.translation
        return y


def quaternions(R: Array) -> Array:
    """Unit quaternions (w, x, y, z), w >= 0, of rotation matrices. Shape (..., 3, 3) -> (..., 4).

    Of q q' = 1/4 (...), linear in R, the row with the largest diagonal entry is taken: it is q times a number that is
    far from zero (Shepperd 1978, "Quaternion from rotation matrix").
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (tuple(R[..., i, j] for j in range(3)) for i in range(3))
    rows = [
        [1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz],
    ]
    squares = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.argmax(np.diagonal(squares, axis1=-2, axis2=-1), axis=-1)
    q: Array = np.take_along_axis(squares, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0.0, -q, q)


def _frames_by_name(model: Any) -> dict[str, int]:
    """Frames by name; where a link and a joint share one, the link."""
    order = {kind: rank for rank, kind in enumerate(_PREFERRED)}
    ranked = sorted(range(model.nframes), key=lambda i: order.get(str(model.frames[i].type), len(order)), reverse=True)
    return {model.frames[i].name: i for i in ranked}


def _find_frame(name: str, frames: dict[str, int]) -> int:
    if name in frames:
        return frames[name]
    near = difflib.get_close_matches(name, frames, n=6, cutoff=0.4)
    near += [known for known in frames if name.lower() in known.lower() and known not in near][:6]
    hint = f"similar ones are: {', '.join(near)}" if near else f"there are: {', '.join(frames)}"
    raise ValueError(f"unknown frame {name!r}; {hint}")
