"""The camera: a view in which a whole motion is visible, one that follows a body, and those of the model."""

from __future__ import annotations

import time as clock
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjslq.validation import Array, choose
from mjslq.viewer.details import details
from mjslq.viewer.layers.layer import ROOTS, Stage, node_name
from mjslq.viewer.motion import Frame

_SMOOTHING = 0.12
"""Time in which a camera that follows a body catches up with most of its way. [s]"""
FIELD_OF_VIEW = np.deg2rad(32.0)
"""Vertical; narrow, so that parallel edges stay nearly parallel. [rad]"""


@dataclass(frozen=True)
class View:
    """A pose of the camera."""

    position: Array
    """Shape (3,). [m]"""
    look_at: Array
    """Shape (3,). [m]"""


def fit(low: Array, high: Array, aspect: float, margin: float = 0.8) -> View:
    """Return the view in which the box `low` ... `high` (3,) [m] fills `margin` of a window of width / height `aspect`.

    The camera looks across the longer horizontal side of the box, from slightly above.
    """
    centre, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-3)
    away = np.array([0.80, 0.52, 0.34]) if half[1] > 1.2 * half[0] else np.array([0.52, -0.80, 0.34])
    forward = -away / np.linalg.norm(away)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    tall = np.tan(FIELD_OF_VIEW / 2) * margin
    across, along = np.abs(corners @ right) / (tall * aspect), np.abs(corners @ up) / tall
    distance = float(np.max(np.maximum(across, along) - corners @ forward))
    return View(centre - distance * forward, centre)


@dataclass(frozen=True)
class Lens:
    """A camera of a model at one time."""

    position: Array
    """Shape (3,). [m]"""
    forward: Array
    """Where it looks. Shape (3,)."""
    up: Array
    """Shape (3,)."""
    field_of_view: float
    """Vertical. [rad]"""


class Cameras:
    """The views of all browsers on a scene: the whole motion, a body that is followed, or a camera of the model.

    Following moves the scene and not the camera, so that it can be turned by hand meanwhile.
    """

    def __init__(self, stage: Stage) -> None:
        """Look at what is drawn on a stage."""
        self._stage = stage
        self._roots = [stage.server.scene.add_frame(f"/{name}", show_axes=False) for name in ROOTS]
        self._body: int | None = None
        self._camera: int | None = None
        self._start, self._shift, self._time = np.zeros(3), np.zeros(3), 0.0
        self._lens: Lens | None = None

    @property
    def names(self) -> list[str]:
        """Cameras of the model."""
        model = self._stage.model
        return [str(model.camera(i).name or f"camera {i}") for i in range(model.ncam)]

    @property
    def followed(self) -> str | None:
        """Name of the body that is followed."""
        return None if self._body is None else self.bodies[self._body]

    @property
    def bodies(self) -> dict[int, str]:
        """Names of the bodies that move, by index."""
        model = self._stage.model
        moving = np.flatnonzero(model.body_weldid != 0).tolist()
        return {body: node_name(model, mujoco.mjtObj.mjOBJ_BODY, body) for body in moving}

    def look(self, view: View) -> None:
        """Take a view in all browsers; of a model's camera no more."""
        self._camera, self._lens = None, None
        for client in self._stage.server.get_clients().values():
            with suppress(AssertionError), client.atomic():  # one that has not yet said where it looks from
                client.camera.position = view.position + self._shift
                client.camera.look_at = view.look_at + self._shift
                client.camera.up_direction = (0.0, 0.0, 1.0)
                client.camera.fov = FIELD_OF_VIEW

    def follow(self, body: str | None, frame: Frame) -> None:
        """Keep a body where it is now in the window; None to let it go."""
        if body is None:
            self._body = None
            self._move(np.zeros(3))
            return
        names = {name: index for index, name in self.bodies.items()}
        self._body = names[choose("body", body, names)]
        self._start = frame.positions[self._body] + self._shift
        self._time = clock.monotonic()

    def use(self, camera: str | None, frame: Frame) -> None:
        """Look through a camera of the model; None to look around freely from where it is."""
        self._camera = None if camera is None else self.names.index(choose("camera", camera, self.names))
        self._lens = None
        self.update(frame)

    def update(self, frame: Frame) -> None:
        """Go along with a time of the motion."""
        if self._body is not None:
            wanted = self._start - frame.positions[self._body]
            now = clock.monotonic()
            share = 1.0 - np.exp(-(now - self._time) / _SMOOTHING)
            self._time = now
            far = np.linalg.norm(wanted - self._shift) > self._stage.length  # it was put elsewhere
            self._move(wanted if far else self._shift + share * (wanted - self._shift))
        if self._camera is not None:
            self._see(lens(self._stage.model, frame, self._camera))

    def _move(self, shift: Array) -> None:
        self._shift = shift
        with self._stage.server.atomic():
            for root in self._roots:
                root.position = shift

    def _see(self, lens: Lens) -> None:
        same = self._lens is not None and np.allclose(self._lens.position, lens.position)
        if same and self._lens is not None and np.allclose(self._lens.forward, lens.forward):
            return
        self._lens = lens
        ahead = lens.position + self._stage.reach * lens.forward
        for client in self._stage.server.get_clients().values():
            with suppress(AssertionError), client.atomic():
                client.camera.up_direction = lens.up
                client.camera.position = lens.position + self._shift
                client.camera.look_at = ahead + self._shift
                client.camera.fov = lens.field_of_view


def lens(model: Any, frame: Frame, camera: int) -> Lens:
    """A camera of a model at a time."""
    found = details(model, frame.moved)
    position, rotation = frame.of(found.camera_positions)[camera], frame.of(found.camera_rotations)[camera]
    forward, up = -rotation[:, 2], rotation[:, 1]
    forward, up = forward / np.linalg.norm(forward), up / np.linalg.norm(up)
    return Lens(position, forward, up, float(np.deg2rad(model.cam_fovy[camera])))
