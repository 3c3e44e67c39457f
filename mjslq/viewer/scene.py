"""A compiled MuJoCo model as a Viser scene: bodies that take poses, ghosts of them, ground, light and camera."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import rich

from mjslq.reports.units import model_from_mjb
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import Array
from mjslq.viewer import camera, geometry
from mjslq.viewer.motion import Motion, extent, motion

if TYPE_CHECKING:
    import viser

_GHOST_OPACITY, _GHOST_PALENESS = 0.3, 0.3
_GHOST_SHRINK = 0.002  # each ghost a little smaller than the one before: surfaces that coincide would flicker
_GROUND, _CELL, _SECTION = (238, 240, 243), (220, 224, 230), (196, 202, 211)
_SKY: dict[str, Any] = {"sky_color": (255, 255, 255), "ground_color": (150, 155, 165), "intensity": 2.2}
"""Light that stands for an environment map."""
_TRACE = (214, 93, 50)
_TRACES = 4  # paths drawn at most
_SURROUNDINGS = 0.12  # how far the first view goes beyond the motion, for what stands there; of the motion's size


@dataclass(frozen=True)
class _Mover:
    """A piece of a body that moves; its ghosts are further instances of the same shape."""

    piece: geometry.Piece
    handle: viser.BatchedMeshHandle


class SceneView:
    """The robot of a result in a Viser server.

    A frame only sets the pose of each piece's batched mesh; shapes are sent once. Ghosts are batches of their own,
    so that the robot stays opaque, and ghosts that stand still cost a frame nothing.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        scene: Scene,
        trajectory: Trajectory,
        aspect: float = 1.0,
        *,
        recorded: bool = False,
    ) -> None:
        """Draw `scene`, with the camera on all of `trajectory` in a window of width / height `aspect`.

        A `recorded` scene has plain lights: Viser's page may load an environment map anew each time that a recording
        starts over, and shows next to nothing meanwhile, on slow machines for ever.
        """
        self._recorded = recorded
        self._server = server
        self._scene = scene
        self._model = model_from_mjb(scene.model)
        self._ghosts: list[_Mover] = []
        self._trace_visible = True
        self._motion = self.motion(trajectory)
        self._pieces = geometry.pieces(self._model)
        low, high = self._extent()
        with server.atomic():
            self._movers = self._draw_bodies()
            self._draw_ground(low, high)
            self._traces = self._draw_traces()
            self._set_light_and_camera(low, high, aspect)
        self.show(0.0)

    def motion(self, trajectory: Trajectory) -> Motion:
        """Return the poses of the bodies along `trajectory`."""
        return motion(self._model, self._scene, trajectory)

    def follow(self, moved: Motion) -> None:
        """Take the poses of `moved` from now on."""
        self._motion = moved
        with self._server.atomic():
            for trace in self._traces:
                trace.remove()
            self._traces = self._draw_traces()

    def show(self, time: float) -> None:
        """Put the robot where it is at `time` [s]."""
        self.pose(*self._motion.at(time))

    def pose(self, positions: Array, wxyzs: Array) -> None:
        """Put the robot at a pose of all bodies, (nbody, 3) [m] and (nbody, 4)."""
        with self._server.atomic():
            _pose(self._movers, positions[None], wxyzs[None])

    def set_ghosts(self, positions: Array, wxyzs: Array) -> None:
        """Show pale copies of the robot at poses (k, nbody, 3) [m] and (k, nbody, 4); none with k = 0."""
        with self._server.atomic():
            if not self._ghosts or len(self._ghosts[0].handle.batched_positions) != len(positions):
                for ghost in self._ghosts:
                    ghost.handle.remove()
                self._ghosts = [self._draw_ghosts(mover, len(positions)) for mover in self._movers if len(positions)]
            _pose(self._ghosts, positions, wxyzs)

    def clear_ghosts(self) -> None:
        """Show no ghosts."""
        self.set_ghosts(np.empty((0, self._model.nbody, 3)), np.empty((0, self._model.nbody, 4)))

    def set_trace(self, visible: bool) -> None:
        """Show or hide the paths of the outermost bodies."""
        for trace in self._traces:
            trace.visible = visible
        self._trace_visible = visible

    def _draw_bodies(self) -> list[_Mover]:
        positions, wxyzs = self._motion.at(0.0)
        movers = []
        for number, piece in enumerate(self._pieces):
            name = f"/bodies/{_name(self._model, piece.body)}/{number}"
            shape = _shape(piece)
            if self._model.body_weldid[piece.body] == 0:
                place = {"position": positions[piece.body], "wxyz": wxyzs[piece.body]}
                self._server.scene.add_mesh_simple(name, **shape, color=_bytes(np.array(piece.rgba[:3])), **place)
                continue
            handle = self._server.scene.add_batched_meshes_simple(
                name,
                **shape,
                batched_positions=positions[None, piece.body].astype(np.float32),
                batched_wxyzs=wxyzs[None, piece.body].astype(np.float32),
                batched_colors=_linear_bytes(np.array(piece.rgba[:3])),
                lod="off",
            )
            movers.append(_Mover(piece, handle))
        return movers

    def _draw_ghosts(self, mover: _Mover, number: int) -> _Mover:
        rgb = np.array(mover.piece.rgba[:3])
        handle = self._server.scene.add_batched_meshes_simple(
            mover.handle.name.replace("/bodies/", "/ghosts/", 1),
            **_shape(mover.piece) | {"opacity": _GHOST_OPACITY * mover.piece.rgba[3]},
            batched_positions=np.zeros((number, 3), dtype=np.float32),
            batched_wxyzs=np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (number, 1)),
            batched_scales=(1.0 - _GHOST_SHRINK * (1 + np.arange(number))).astype(np.float32),
            batched_colors=_linear_bytes(rgb + _GHOST_PALENESS * (1.0 - rgb)),
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )
        return _Mover(mover.piece, handle)

    def _draw_ground(self, low: Array, high: Array) -> None:
        size = float(np.linalg.norm(high - low))
        cell = _round_length(size / 8.0)
        look: dict[str, Any] = {
            "cell_size": cell,
            "section_size": 5.0 * cell,
            "fade_distance": 12.0 * size,
            "fade_strength": 1.5,
            "shadow_opacity": 0.22,
        }
        planes = geometry.planes(self._model)
        for plane in planes:
            rgb = np.array(_GROUND) / 255.0 if plane.rgb is None else np.array(plane.rgb)
            infinite = min(plane.size) <= 0.0 or min(plane.size) > 8.0 * size
            self._server.scene.add_grid(
                f"/ground/{plane.geom}",
                plane.size[0] or 1.0,
                plane.size[1] or 1.0,
                infinite_grid=infinite,
                plane_color=_bytes(rgb),
                plane_opacity=1.0,
                cell_color=_CELL if plane.rgb is None else _bytes(rgb + 0.15 * (1.0 - rgb)),
                section_color=_SECTION if plane.rgb is None else _bytes(rgb + 0.3 * (1.0 - rgb)),
                position=plane.position,
                wxyz=plane.wxyz,
                **look,
            )
        if not planes:  # nothing to stand on in the model: a faint net below the motion, for orientation only
            below = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2] - 0.05 * size])
            self._server.scene.add_grid(
                "/reference", infinite_grid=True, cell_color=_CELL, section_color=_CELL, position=below, **look
            )

    def _draw_traces(self) -> list[viser.LineSegmentsHandle]:
        model, moved = self._model, self._motion
        parents = set(model.body_parentid[1:])
        seen = {piece.body: piece for piece in self._pieces if model.body_weldid[piece.body] != 0}
        leaves = [body for body in seen if body not in parents]
        traces = []
        for body in leaves[:_TRACES]:
            centre = 0.5 * (seen[body].vertices.min(axis=0) + seen[body].vertices.max(axis=0))
            w, v = moved.wxyzs[:, body, :1], moved.wxyzs[:, body, 1:]
            twice = 2.0 * np.cross(v, centre)
            path = moved.positions[:, body] + centre + w * twice + np.cross(v, twice)
            if len(path) < 2:
                continue
            traces.append(
                self._server.scene.add_line_segments(
                    f"/traces/{_name(model, body)}",
                    np.stack([path[:-1], path[1:]], axis=1).astype(np.float32),
                    _TRACE,
                    thickness=1.5,
                    thickness_units="screen",
                    visible=self._trace_visible,
                )
            )
        return traces

    def _set_light_and_camera(self, low: Array, high: Array, aspect: float) -> None:
        scene, start = self._server.scene, self._server.initial_camera
        scene.set_up_direction("+z")
        scene.configure_default_lights(True, cast_shadow=True)
        if self._recorded:
            scene.configure_environment_map(None)
            scene.add_light_hemisphere("/light", **_SKY)
        else:
            scene.configure_environment_map("studio", environment_intensity=0.35)
        seen = camera.fit(low, high, aspect)
        distance = float(np.linalg.norm(seen.position - seen.look_at))
        start.position, start.look_at, start.fov = seen.position, seen.look_at, camera.FIELD_OF_VIEW
        start.near, start.far = distance / 200.0, distance * 200.0

    def _extent(self) -> tuple[Array, Array]:
        """Return the box of all that moves, widened a little by what stands around it."""
        if not self._pieces:
            return -np.ones(3), np.ones(3)
        boxes = np.array([[piece.vertices.min(axis=0), piece.vertices.max(axis=0)] for piece in self._pieces])
        bodies = np.array([piece.body for piece in self._pieces])
        moves = self._model.body_weldid[bodies] != 0
        all_low, all_high = extent(self._motion, bodies, boxes)
        if not moves.any():
            return all_low, all_high
        low, high = extent(self._motion, bodies[moves], boxes[moves])
        room = _SURROUNDINGS * float(np.linalg.norm(high - low))
        return np.maximum(all_low, low - room), np.minimum(all_high, high + room)


@contextmanager
def quiet() -> Iterator[None]:
    """Keep Viser from printing its banner; the viewer prints a line of its own."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def _pose(movers: list[_Mover], positions: Array, wxyzs: Array) -> None:
    """Set the instances of `movers` to poses of all bodies, (k, nbody, 3) and (k, nbody, 4)."""
    for mover in movers:
        mover.handle.batched_positions = positions[:, mover.piece.body].astype(np.float32)
        mover.handle.batched_wxyzs = wxyzs[:, mover.piece.body].astype(np.float32)


def _shape(piece: geometry.Piece) -> dict[str, Any]:
    opacity = piece.rgba[3] if piece.rgba[3] < 1.0 else None
    return {
        "vertices": piece.vertices.astype(np.float32),
        "faces": piece.faces.astype(np.uint32),
        "opacity": opacity,
    }


def _linear_bytes(rgb: Array) -> tuple[int, int, int]:
    """Return the colour as linear light, which is how Viser reads the colours of batched meshes."""
    return _bytes(np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4))


def _bytes(rgb: Array) -> tuple[int, int, int]:
    r, g, b = (round(255.0 * float(c)) for c in np.clip(rgb, 0.0, 1.0))
    return r, g, b


def _name(model: Any, body: int) -> str:
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or f"body {body}"
    return str(name).replace("/", "_")


def _round_length(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= length * (1.0 + 1e-9)))
