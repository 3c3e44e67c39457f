"""Marks that belong to a model and not to its surface: frames of bodies and sites, axes of joints, centres of mass.

And targets: where a problem's costs want things to be.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjslq.scene import Marker
from mjslq.validation import Array
from mjslq.viewer import geometry
from mjslq.viewer.batches import place
from mjslq.viewer.details import details
from mjslq.viewer.layers.layer import Layer, Stage, place_sticks
from mjslq.viewer.motion import Frame, Motion, rotated

_AXIS, _AXIS_RADIUS = 0.10, 0.003  # of frames, in sizes of the model
_JOINT, _JOINT_RADIUS = 0.32, 0.006
_MASS, _PLUMB, _TARGET = 0.03, 0.0025, 0.03


class Frames(Layer):
    """The axes of bodies that move, red, green and blue for x, y and z."""

    title = "Body frames"

    def _build(self) -> list[Any]:
        model = self._stage.model
        self._bodies = np.flatnonzero(model.body_weldid != 0)
        return [_axes(self._stage, "frames/bodies", len(self._bodies))]

    def _pose(self, frame: Frame) -> None:
        place(self._handles[0], frame.positions[self._bodies], frame.wxyzs[self._bodies])


class SiteFrames(Layer):
    """The axes of sites."""

    title = "Site frames"

    def _build(self) -> list[Any]:
        return [_axes(self._stage, "frames/sites", self._stage.model.nsite)]

    def _pose(self, frame: Frame) -> None:
        model = self._stage.model
        positions, wxyzs = frame.positions[model.site_bodyid], frame.wxyzs[model.site_bodyid]
        place(self._handles[0], positions + rotated(wxyzs, model.site_pos), product(wxyzs, model.site_quat))


class JointAxes(Layer):
    """An arrow along the axis of each hinge and slide."""

    title = "Joint axes"

    def _build(self) -> list[Any]:
        model, length = self._stage.model, self._stage.length
        hinges = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        self._joints = np.flatnonzero(np.isin(model.jnt_type, hinges))
        return [
            self._stage.server.scene.add_arrows(
                "/joints/axes",
                np.zeros((len(self._joints), 2, 3), dtype=np.float32),
                self._stage.theme.axis,
                shaft_radius=_JOINT_RADIUS * length,
                head_radius=2.2 * _JOINT_RADIUS * length,
                head_length=5.0 * _JOINT_RADIUS * length,
            )
        ]

    def _pose(self, frame: Frame) -> None:
        found = details(self._stage.model, frame.moved)
        anchors, axes = frame.of(found.anchors)[self._joints], frame.of(found.axes)[self._joints]
        half = 0.5 * _JOINT * self._stage.length * axes
        self._handles[0].points = np.stack([anchors - half, anchors + half], axis=1).astype(np.float32)


class Masses(Layer):
    """A ball at the centre of mass of each thing that moves by itself, and where it is above a level ground."""

    title = "Centres of mass"
    hint = "With a plumb line to a level ground"

    def _build(self) -> list[Any]:
        model = self._stage.model
        roots = np.unique(model.body_rootid[model.body_weldid != 0])
        self._shares = np.zeros((len(roots), model.nbody))
        for row, root in zip(self._shares, roots, strict=True):
            row[model.body_rootid == root] = model.body_mass[model.body_rootid == root]
        self._shares = self._shares[self._shares.sum(axis=1) > 0.0]
        self._shares /= self._shares.sum(axis=1, keepdims=True)
        level = [plane.position[2] for plane in geometry.planes(model) if abs(plane.wxyz[0]) > 1.0 - 1e-6]
        self._ground = float(max(level)) if level else None
        number, color = len(self._shares), self._stage.theme.mass
        if not number:
            return []
        vertices, faces = geometry.geom_ball(_MASS * self._stage.length)
        ball = self._batch("masses/balls", vertices, faces, number * (1 + bool(level)), color)
        sizes = np.repeat([1.0, 0.45], number)[: len(ball.batched_positions)]
        ball.batched_scales = np.repeat(sizes[:, None], 3, axis=1).astype(np.float32)
        return [ball, self._sticks("masses/lines", number, color)] if level else [ball]

    def _pose(self, frame: Frame) -> None:
        if not self._handles:
            return
        positions = center_of_mass(self._stage.model, frame, self._shares)
        if self._ground is not None:
            feet = np.column_stack([positions[:, :2], np.full(len(positions), self._ground)])
            radii = np.full(len(positions), _PLUMB * self._stage.length)
            place_sticks(self._handles[1], np.stack([positions, feet], axis=1), radii)
            positions = np.concatenate([positions, feet])
        self._handles[0].batched_positions = positions.astype(np.float32)


class Targets(Layer):
    """A translucent ball where a cost wants a frame or a site to be, with its name."""

    title = "Targets"

    def __init__(self, stage: Stage, moved: Motion, visible: bool, markers: tuple[Marker, ...]) -> None:
        """Draw the markers of a scene."""
        self._markers = markers
        super().__init__(stage, moved, visible)

    def _build(self) -> list[Any]:
        scene, length = self._stage.server.scene, self._stage.length
        handles: list[Any] = []
        for i, marker in enumerate(self._markers):
            for radius, opacity in ((_TARGET, 0.35), (0.3 * _TARGET, 0.95)):
                vertices, faces = geometry.geom_ball(radius * length)
                handles.append(
                    scene.add_mesh_simple(
                        f"/targets/{i}/{radius}",
                        vertices.astype(np.float32),
                        faces.astype(np.uint32),
                        color=self._stage.theme.target,
                        opacity=opacity,
                        position=np.array(marker.position),
                        cast_shadow=False,
                        receive_shadow=False,
                    )
                )
        return handles

    def _pose(self, frame: Frame) -> None:
        """Targets stand still."""


def unmarked(model: Any, frame: Frame, markers: tuple[Marker, ...], near: float) -> tuple[Marker, ...]:
    """The markers that no geom or site fixed to the world stands at already, within `near` [m]."""
    marked = [np.zeros((0, 3))]
    for bodies, positions in ((model.geom_bodyid, model.geom_pos), (model.site_bodyid, model.site_pos)):
        fixed = model.body_weldid[bodies] == 0
        marked.append((frame.positions[bodies] + rotated(frame.wxyzs[bodies], positions))[fixed])
    places = np.concatenate(marked)
    return tuple(m for m in markers if not (np.linalg.norm(places - m.position, axis=1) <= near).any())


def center_of_mass(model: Any, frame: Frame, shares: Array) -> Array:
    """Mean positions of the bodies' centres of mass, by `shares` (k, nbody) of sum 1. Shape (k, 3). [m]"""
    return shares @ (frame.positions + rotated(frame.wxyzs, model.body_ipos))


def product(left: Array, right: Array) -> Array:
    """Products of quaternions (..., 4)."""
    a, b = left[..., :1], left[..., 1:]
    c, d = right[..., :1], right[..., 1:]
    scalar = a * c - (b * d).sum(axis=-1, keepdims=True)
    return np.concatenate([scalar, a * d + c * b + np.cross(b, d)], axis=-1)


def _axes(stage: Stage, name: str, number: int) -> Any:
    return stage.server.scene.add_batched_axes(
        f"/{name}",
        batched_wxyzs=np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (number, 1)),
        batched_positions=np.zeros((number, 3), dtype=np.float32),
        axes_length=_AXIS * stage.length,
        axes_radius=_AXIS_RADIUS * stage.length,
    )
