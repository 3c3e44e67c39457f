"""Several results in one scene: what moves in each, in one colour and at an offset, over a backdrop of the rest.

Every pose is one instance of each shape, so that a frame costs one message a piece, whatever the number of ghosts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from mjslq.reports.units import model_from_mjb
from mjslq.scene import Scene
from mjslq.validation import Array
from mjslq.viewer import geometry
from mjslq.viewer.motion import Motion

if TYPE_CHECKING:
    import viser

_OPACITY, _GHOST_OPACITY = 0.75, 0.25
_TRACES = 4
"""Paths that are drawn at most."""
_SHRINK = 0.003  # relative to the result before: surfaces that coincide would flicker


def backdrop(scene: Scene) -> Scene:
    """The scene of the same model without anything that moves: ground, lights and fixed bodies."""
    model: Any = model_from_mjb(scene.model)
    for of_body, material, rgba in (
        (model.geom_bodyid, model.geom_matid, model.geom_rgba),
        (model.site_bodyid, model.site_matid, model.site_rgba),
    ):
        moves = model.body_weldid[of_body] != 0
        material[moves] = -1
        rgba[moves, 3] = 0.0
    model.tendon_matid[:] = -1
    model.tendon_rgba[:, 3] = 0.0
    model.flex_matid[:] = -1
    model.flex_rgba[:, 3] = 0.0
    data = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, data)
    return replace(scene, model=data.tobytes())


class TintedView:
    """The moving bodies of a result in a Viser server that shows a backdrop."""

    def __init__(self, server: viser.ViserServer, model: Any, place: int, tint: tuple[float, float, float]) -> None:
        """Draw what moves in a compiled `model`, as the result with number `place` from 0 on, in the colour `tint`."""
        self._server, self._tint, self._place = server, tint, place
        self._opacity = _OPACITY if place else 1.0  # over each other: the first one is solid
        pieces = geometry.pieces(model)
        self._moving = [piece for piece in pieces if model.body_weldid[piece.body] != 0]
        self._standing = [piece for piece in pieces if model.body_weldid[piece.body] == 0]
        self._root = server.scene.add_frame(f"/results/{place}", show_axes=False)
        self._fixed = server.scene.add_frame(f"/results/{place}/fixed", show_axes=False, visible=False)
        parents = set(model.body_parentid[1:])
        seen = {piece.body: piece for piece in self._moving}
        self._leaves = [seen[body] for body in seen if body not in parents][:_TRACES]
        self._traces: list[Any] = []
        self._traced = True
        self._ghosts: list[tuple[int, Any]] = []
        self._movers: list[tuple[int, Any]] = []

    def follow(self, moved: Motion) -> None:
        """Take the poses of `moved` from now on."""
        self._motion = moved
        if not self._movers:
            self._movers = self._draw("moving", 1, self._opacity)
            self._draw_fixed()
        self._draw_traces()
        self.show(0.0)

    def show(self, time: float) -> None:
        """Put the robot where it is at `time` [s]."""
        positions, wxyzs = self._motion.at(time)
        with self._server.atomic():
            _pose(self._movers, positions[None], wxyzs[None])

    def set_ghosts(self, positions: Array, wxyzs: Array) -> None:
        """Show pale copies at poses (k, nbody, 3) [m] and (k, nbody, 4); none with k = 0."""
        with self._server.atomic():
            if not self._ghosts or len(self._ghosts[0][1].batched_positions) != len(positions):
                for _, ghost in self._ghosts:
                    ghost.remove()
                self._ghosts = self._draw("ghosts", len(positions), _GHOST_OPACITY) if len(positions) else []
            _pose(self._ghosts, positions, wxyzs)

    def clear_ghosts(self) -> None:
        """Show no ghosts."""
        self.set_ghosts(np.empty((0, 1, 3)), np.empty((0, 1, 4)))

    def set_trace(self, visible: bool) -> None:
        """Show or hide the paths of the outermost bodies."""
        self._traced = visible
        for trace in self._traces:
            trace.visible = visible

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of it."""
        self._root.visible = visible

    def set_offset(self, offset: Array) -> None:
        """Put all of it at `offset` (3,) [m]; away from zero it is opaque, and stands on fixed bodies of its own."""
        apart = bool(np.any(offset))
        self._root.position = offset
        self._fixed.visible = apart
        for piece, (_, handle) in zip(self._moving, self._movers, strict=True):
            handle.opacity = _shown(piece.rgba[3] * (1.0 if apart else self._opacity))

    def _draw(self, what: str, number: int, opacity: float) -> list[tuple[int, Any]]:
        found = []
        for i, piece in enumerate(self._moving):
            handle = self._server.scene.add_batched_meshes_simple(
                f"/results/{self._place}/{what}/{i}",
                piece.vertices.astype(np.float32),
                piece.faces.astype(np.uint32),
                batched_positions=np.zeros((number, 3), dtype=np.float32),
                batched_wxyzs=np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (number, 1)),
                batched_scales=np.full(number, 1.0 - _SHRINK * self._place, dtype=np.float32),
                batched_colors=linear_bytes(self._tint),
                opacity=_shown(opacity * piece.rgba[3]),
                lod="off",
                cast_shadow=what == "moving" and not self._place,
                receive_shadow=False,
            )
            found.append((piece.body, handle))
        return found

    def _draw_traces(self) -> None:
        for trace in self._traces:
            trace.remove()
        self._traces = []
        for i, piece in enumerate(self._leaves):
            centre = 0.5 * (piece.vertices.min(axis=0) + piece.vertices.max(axis=0))
            wxyz = self._motion.wxyzs[:, piece.body]
            twice = 2.0 * np.cross(wxyz[:, 1:], centre)
            path = self._motion.positions[:, piece.body] + centre + wxyz[:, :1] * twice + np.cross(wxyz[:, 1:], twice)
            if len(path) > 1:
                trace = self._server.scene.add_line_segments(
                    f"/results/{self._place}/traces/{i}",
                    np.stack([path[:-1], path[1:]], axis=1).astype(np.float32),
                    np.array(self._tint),
                    thickness=1.5,
                    thickness_units="screen",
                    visible=self._traced,
                )
                self._traces.append(trace)

    def _draw_fixed(self) -> None:
        for i, piece in enumerate(self._standing):
            self._server.scene.add_mesh_simple(
                f"/results/{self._place}/fixed/{i}",
                piece.vertices.astype(np.float32),
                piece.faces.astype(np.uint32),
                color=np.array(piece.rgba[:3]),
                position=self._motion.positions[0, piece.body],
                wxyz=self._motion.wxyzs[0, piece.body],
            )


def _shown(opacity: float) -> float | None:
    """An opacity as Viser takes it: None is solid, which is drawn sooner and with depth."""
    return opacity if opacity < 1.0 else None


def _pose(movers: list[tuple[int, Any]], positions: Array, wxyzs: Array) -> None:
    for body, handle in movers:
        handle.batched_positions = positions[:, body].astype(np.float32)
        handle.batched_wxyzs = wxyzs[:, body].astype(np.float32)


def linear_bytes(rgb: tuple[float, float, float]) -> tuple[int, int, int]:
    """Return the colour as linear light, which is how Viser reads the colours of batched meshes."""
    array = np.array(rgb)
    linear = np.where(array <= 0.04045, array / 12.92, ((array + 0.055) / 1.055) ** 2.4)
    r, g, b = (round(255.0 * float(c)) for c in linear)
    return r, g, b
