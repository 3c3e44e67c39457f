"""The bodies of a model: geoms and sites by group, and ghosts of them.

A frame only sets the poses of the batched meshes of bodies that have moved; shapes are sent once. Ghosts are batches
of their own, so that the robot stays opaque, and ghosts that stand still cost a frame nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from mjslq.validation import Array
from mjslq.viewer import geometry, textures
from mjslq.viewer.batches import place
from mjslq.viewer.layers.layer import Stage, color_bytes, linear_bytes, node_name
from mjslq.viewer.motion import Frame
from mjslq.viewer.simplify import simplified

if TYPE_CHECKING:
    import viser

_GHOST_OPACITY, _GHOST_PALENESS = 0.3, 0.3
_GHOST_SHRINK = 0.002  # each ghost a little smaller than the one before: surfaces that coincide would flicker


@dataclass(frozen=True)
class _Drawn:
    """A piece of a body; `moves` is False for what is fixed to the world."""

    piece: geometry.Piece
    handle: Any
    moves: bool
    name: str


class Bodies:
    """Geoms and sites of a model."""

    def __init__(self, stage: Stage, frame: Frame, groups: tuple[int, ...] | None = None) -> None:
        """Draw the geoms and sites of some groups, or those that MuJoCo's viewer shows from the start."""
        self._stage, self._frame = stage, frame
        self._drawn: dict[int, list[_Drawn]] = {}
        self._ghosts: list[tuple[geometry.Piece, Any]] = []
        self._ghost_poses: tuple[Array, Array, Array | None] = (np.empty((0, 0, 3)), np.empty((0, 0, 4)), None)
        self._sites = True
        self._last: tuple[Array, Array] = (np.empty(0), np.empty(0))
        model = stage.model
        shown = {int(model.geom_group[geom]) for geom in geometry.visible_geoms(model)}
        self.groups = set(groups) if groups is not None else shown | set(geometry.SHOWN_GROUPS)
        """Groups that are shown."""
        for group in sorted(self.groups):
            self._drawn[group] = self._draw(group)
        self._place_all()

    @property
    def present(self) -> list[int]:
        """Groups that the model has geoms or sites in."""
        model = self._stage.model
        return sorted({*model.geom_group.tolist(), *model.site_group.tolist()})

    @property
    def pieces(self) -> list[geometry.Piece]:
        """What is shown."""
        return [drawn.piece for drawn in self._shown()]

    def show_group(self, group: int, visible: bool) -> None:
        """Show or hide the geoms and sites of a group."""
        with self._stage.server.atomic():
            (self.groups.add if visible else self.groups.discard)(group)
            if visible:
                self._drawn.setdefault(group, self._drawn.get(group) or self._draw(group))
                self._place_all()
            self._set_visibility()
            self._make_ghosts()

    def show_sites(self, visible: bool) -> None:
        """Show or hide the sites of all groups that are shown."""
        self._sites = visible
        self._set_visibility()

    def update(self, frame: Frame) -> None:
        """Put the bodies where they are at a time."""
        self._frame = frame
        positions, wxyzs = self._last
        moved = (frame.positions != positions).any(axis=1) | (frame.wxyzs != wxyzs).any(axis=1)
        self._last = frame.positions, frame.wxyzs
        self._place(moved)

    def set_ghosts(self, positions: Array, wxyzs: Array, colors: Array | None = None) -> None:
        """Show pale copies of the robot at poses (k, nbody, 3) [m] and (k, nbody, 4); none with k = 0.

        Each in a colour of its own, where `colors` (k, 3) in [0, 1] are given.
        """
        before = self._ghost_poses
        same = len(before[0]) == len(positions) and np.array_equal(
            np.zeros(0) if before[2] is None else before[2], np.zeros(0) if colors is None else colors
        )
        self._ghost_poses = positions, wxyzs, colors
        with self._stage.server.atomic():
            if same:
                self._place_ghosts()
            else:
                self._make_ghosts()

    def _make_ghosts(self) -> None:
        positions, _, colors = self._ghost_poses
        for _, handle in self._ghosts:
            handle.remove()
        moving = [drawn for drawn in self._shown() if drawn.moves and not drawn.piece.site and len(positions)]
        self._ghosts = [(drawn.piece, self._draw_ghosts(drawn, len(positions), colors)) for drawn in moving]
        self._place_ghosts()

    def _place_ghosts(self) -> None:
        positions, wxyzs, _ = self._ghost_poses
        for piece, handle in self._ghosts:
            place(handle, positions[:, piece.body], wxyzs[:, piece.body])

    def _shown(self) -> list[_Drawn]:
        return [drawn for group in sorted(self.groups) for drawn in self._drawn.get(group, ()) if self._seen(drawn)]

    def _seen(self, drawn: _Drawn) -> bool:
        return drawn.piece.group in self.groups and (self._sites or not drawn.piece.site)

    def _set_visibility(self) -> None:
        for some in self._drawn.values():
            for drawn in some:
                if drawn.handle.visible != self._seen(drawn):
                    drawn.handle.visible = self._seen(drawn)

    def _place_all(self) -> None:
        self._last = self._frame.positions, self._frame.wxyzs
        self._place(np.ones(self._stage.model.nbody, dtype=bool))

    def _place(self, moved: Array) -> None:
        positions, wxyzs = self._frame.positions, self._frame.wxyzs
        for group, some in self._drawn.items():
            if group not in self.groups:
                continue
            for drawn in some:
                body = drawn.piece.body
                if drawn.moves and moved[body]:
                    place(drawn.handle, positions[body : body + 1], wxyzs[body : body + 1])

    def _draw(self, group: int) -> list[_Drawn]:
        model, drawn = self._stage.model, []
        start = sum(len(some) for some in self._drawn.values())
        for number, whole in enumerate(geometry.pieces(model, (group,)), start):
            piece = simplified(whole, self._stage.cell)
            moves = bool(model.body_weldid[piece.body] != 0)
            body = node_name(model, mujoco.mjtObj.mjOBJ_BODY, piece.body).replace("/", "_")
            name = f"{body}/{number}"
            handle = self._draw_covered(name, piece, moves) if piece.cover else self._draw_plain(name, piece, moves)
            drawn.append(_Drawn(piece, handle, moves, name))
        return drawn

    def _draw_plain(self, name: str, piece: geometry.Piece, moves: bool) -> Any:
        scene, rgb = self._stage.server.scene, np.array(piece.rgba[:3])
        clear = piece.rgba[3] < 1.0
        more: dict[str, Any] = _shape(piece) | {"cast_shadow": not clear and not piece.site}
        if not moves:
            return scene.add_mesh_simple(f"/bodies/{name}", color=color_bytes(rgb), **more, **self._pose(piece))
        return scene.add_batched_meshes_simple(
            f"/bodies/{name}", batched_colors=linear_bytes(rgb), lod="off", **more, **self._batch(piece)
        )

    def _draw_covered(self, name: str, piece: geometry.Piece, moves: bool) -> Any:
        scene, cover = self._stage.server.scene, piece.cover
        assert cover is not None
        pixels = textures.image(self._stage.model, cover.texture)
        surface = (piece.vertices, piece.faces, cover.normals, cover.coordinates)
        data = textures.glb(*surface, pixels, cover.tint, cover.shininess)
        if not moves:
            return scene.add_glb(f"/bodies/{name}", data, **self._pose(piece))
        return scene.add_batched_glb(f"/bodies/{name}", data, lod="off", **self._batch(piece))

    def _pose(self, piece: geometry.Piece) -> dict[str, Any]:
        return {"position": self._frame.positions[piece.body], "wxyz": self._frame.wxyzs[piece.body]}

    def _batch(self, piece: geometry.Piece) -> dict[str, Any]:
        body = slice(piece.body, piece.body + 1)
        positions, wxyzs = self._frame.positions[body], self._frame.wxyzs[body]
        return {"batched_positions": positions.astype(np.float32), "batched_wxyzs": wxyzs.astype(np.float32)}

    def _draw_ghosts(self, drawn: _Drawn, number: int, colors: Array | None) -> viser.BatchedMeshHandle:
        rgb = np.array(drawn.piece.rgba[:3])
        paint: Any = linear_bytes(rgb + _GHOST_PALENESS * (1.0 - rgb))
        if colors is not None:
            shades = 0.35 * rgb + 0.65 * colors
            paint = np.array([linear_bytes(shade) for shade in shades], dtype=np.uint8)
        return self._stage.server.scene.add_batched_meshes_simple(
            f"/ghosts/{drawn.name}",
            **_shape(drawn.piece) | {"opacity": _GHOST_OPACITY * drawn.piece.rgba[3]},
            batched_positions=np.zeros((number, 3), dtype=np.float32),
            batched_wxyzs=np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (number, 1)),
            batched_scales=(1.0 - _GHOST_SHRINK * (1 + np.arange(number))).astype(np.float32),
            batched_colors=paint,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )


def _shape(piece: geometry.Piece) -> dict[str, Any]:
    opacity = piece.rgba[3] if piece.rgba[3] < 1.0 else None
    return {
        "vertices": piece.vertices.astype(np.float32),
        "faces": piece.faces.astype(np.uint32),
        "opacity": opacity,
    }
