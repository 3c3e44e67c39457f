"""A compiled MuJoCo model as a Viser scene: bodies that take poses, layers that can be shown, ground, light, camera."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
import rich

from mjslq.contact import Contact
from mjslq.reports.units import model_from_mjb
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import Array
from mjslq.viewer import camera
from mjslq.viewer.layers import marks
from mjslq.viewer.layers.bodies import Bodies
from mjslq.viewer.layers.contacts import Contacts
from mjslq.viewer.layers.flexes import Flexes
from mjslq.viewer.layers.layer import Layer, Stage
from mjslq.viewer.layers.surroundings import Surroundings
from mjslq.viewer.layers.tendons import Tendons
from mjslq.viewer.layers.traces import Traces
from mjslq.viewer.motion import Frame, Motion, extent, motion
from mjslq.viewer.theme import theme

if TYPE_CHECKING:
    import viser

_SURROUNDINGS = 0.12  # how far the first view goes beyond the motion, for what stands there; of the motion's size


class SceneView:
    """The robot of a result in a Viser server."""

    def __init__(
        self,
        server: viser.ViserServer,
        scene: Scene,
        trajectory: Trajectory,
        aspect: float = 1.0,
        *,
        dark: bool = False,
        contact: Contact | None = None,
        passed: bool = True,
        cell: float = 0.0,
    ) -> None:
        """Draw `scene`, with the camera on all of `trajectory` in a window of width / height `aspect`.

        `contact` are the parameters of contacts that the trajectory was computed with, where not the model's own.
        `passed` makes the part of the paths that time has left behind stronger. `cell` is within what meshes may differ
        from the model's; see `simplify`. [m]
        """
        self._server, self._scene, self._aspect = server, scene, aspect
        self.model = model_from_mjb(scene.model)
        """The `mujoco.MjModel` that is drawn."""
        self._motion = self.motion(trajectory)
        self._frame = self._motion.frame(0.0)
        self._stage = Stage(server, self.model, theme(dark), 1.0, 1.0, cell)
        with server.atomic():
            self.cameras = camera.Cameras(self._stage)
            self.bodies = Bodies(self._stage, self._frame)
            low, high = self._extent()
            self._stage.reach = float(np.linalg.norm(high - low))
            self._stage.length = self._length()
            self.surroundings = Surroundings(self._stage, 0.5 * (low + high), self._lowest(low[2]))
            self.layers: dict[str, Layer] = self._make_layers(contact, passed)
            """What can be shown and hidden, by name."""
            self._point_camera(low, high)
        self.show(0.0)

    @property
    def dark(self) -> bool:
        """Whether the scene is dark."""
        return self._stage.theme.dark

    @property
    def traces(self) -> Traces:
        """The paths of bodies and sites."""
        traces = self.layers["traces"]
        assert isinstance(traces, Traces)
        return traces

    def set_dark(self, dark: bool) -> None:
        """Make the scene dark or light; the page around it has a theme of its own, see `look.Look`."""
        if dark == self.dark:
            return
        self._stage.theme = theme(dark)
        self.surroundings.restyle()
        for layer in self.layers.values():
            layer.restyle()

    def motion(self, trajectory: Trajectory) -> Motion:
        """Return the poses of the bodies along `trajectory`."""
        return motion(self.model, self._scene, trajectory)

    def follow(self, moved: Motion) -> None:
        """Take the poses of `moved` from now on."""
        self._motion = moved
        with self._server.atomic():
            for layer in self.layers.values():
                layer.follow(moved)

    def show(self, time: float) -> None:
        """Put everything where it is at `time` [s]."""
        self.stand(self._motion.frame(time))

    def stand(self, frame: Frame) -> None:
        """Put everything where it is at a time of some motion."""
        self._frame = frame
        with self._server.atomic():
            self.bodies.update(frame)
            for layer in self.layers.values():
                layer.update(frame)
            self.cameras.update(frame)

    def set_ghosts(self, positions: Array, wxyzs: Array, colors: Array | None = None) -> None:
        """Show pale copies of the robot at poses (k, nbody, 3) [m] and (k, nbody, 4); none with k = 0.

        Each in a colour of its own, where `colors` (k, 3) in [0, 1] are given.
        """
        self.bodies.set_ghosts(positions, wxyzs, colors)

    def clear_ghosts(self) -> None:
        """Show no ghosts."""
        self.set_ghosts(np.empty((0, self.model.nbody, 3)), np.empty((0, self.model.nbody, 4)))

    def set_trace(self, visible: bool) -> None:
        """Show or hide the paths of bodies and sites."""
        self.traces.visible = visible

    def frame(self) -> None:
        """Turn the camera so that the whole motion is in the window, in all browsers."""
        self.cameras.look(camera.fit(*self._extent(), self._aspect))

    def track(self, body: str | None) -> None:
        """Keep a body in the middle of the window while it moves; None to let it go."""
        self.cameras.follow(body, self._frame)
        self.cameras.update(self._frame)

    def use_camera(self, name: str | None) -> None:
        """Look through a camera of the model; None to look around freely."""
        self.cameras.use(name, self._frame)

    def show_group(self, group: int, visible: bool) -> None:
        """Show or hide the geoms and sites of a group, 0 to 5."""
        self.bodies.show_group(group, visible)
        self.surroundings.show_groups(self.bodies.groups)

    def _make_layers(self, contact: Contact | None, passed: bool) -> dict[str, Layer]:
        stage, moved, model = self._stage, self._motion, self.model
        layers: dict[str, Layer] = {"traces": Traces(stage, moved, True, self.bodies.pieces, passed)}
        if Tendons.offered(model):
            layers["tendons"] = Tendons(stage, moved, visible=True)
        if Flexes.offered(model):
            layers["flexes"] = Flexes(stage, moved, visible=True)
        markers = marks.unmarked(model, self._frame, self._scene.markers, 0.02 * stage.length)
        if markers:
            layers["targets"] = marks.Targets(stage, moved, True, markers)
        if Contacts.offered(model, moved):
            layers["contacts"] = Contacts(stage, moved, contact=contact)
        layers["masses"] = marks.Masses(stage, moved)
        layers["joints"] = marks.JointAxes(stage, moved)
        layers["frames"] = marks.Frames(stage, moved)
        if model.nsite:
            layers["sites"] = marks.SiteFrames(stage, moved)
        return layers

    def _point_camera(self, low: Array, high: Array) -> None:
        start, seen = self._server.initial_camera, camera.fit(low, high, self._aspect)
        distance = float(np.linalg.norm(seen.position - seen.look_at))
        start.position, start.look_at, start.fov = seen.position, seen.look_at, camera.FIELD_OF_VIEW
        start.near, start.far = distance / 200.0, distance * 200.0

    def _extent(self) -> tuple[Array, Array]:
        """Return the box of all that moves, widened a little by what stands around it."""
        pieces = self.bodies.pieces
        if not pieces:
            return -np.ones(3), np.ones(3)
        boxes = np.array([[piece.vertices.min(axis=0), piece.vertices.max(axis=0)] for piece in pieces])
        bodies = np.array([piece.body for piece in pieces])
        moves = self.model.body_weldid[bodies] != 0
        all_low, all_high = extent(self._motion, bodies, boxes)
        if not moves.any():
            return all_low, all_high
        low, high = extent(self._motion, bodies[moves], boxes[moves])
        room = _SURROUNDINGS * float(np.linalg.norm(high - low))
        return np.maximum(all_low, low - room), np.minimum(all_high, high + room)

    def _lowest(self, low: float) -> float:
        """Return the height of the lowest of what moves, which is `low`, and of what stands. [m]"""
        fixed = [piece for piece in self.bodies.pieces if self.model.body_weldid[piece.body] == 0]
        if not fixed:
            return float(low)
        boxes = np.array([[piece.vertices.min(axis=0), piece.vertices.max(axis=0)] for piece in fixed])
        return min(float(low), float(extent(self._motion.first(), np.array([p.body for p in fixed]), boxes)[0][2]))

    def _length(self) -> float:
        """Return the size of what moves as it stands at first, from corner to corner. [m]"""
        pieces = [piece for piece in self.bodies.pieces if self.model.body_weldid[piece.body] != 0]
        if not pieces:
            return self._stage.reach
        first = self._motion.first()
        boxes = np.array([[piece.vertices.min(axis=0), piece.vertices.max(axis=0)] for piece in pieces])
        low, high = extent(first, np.array([piece.body for piece in pieces]), boxes)
        return max(float(np.linalg.norm(high - low)), 0.05 * self._stage.reach)


@contextmanager
def quiet() -> Iterator[None]:
    """Keep Viser from printing its banner; the viewer prints a line of its own."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
