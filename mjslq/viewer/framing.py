"""The box that a motion fills, and cameras pointed at it: in all windows, or where the reader has not turned them."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from mjslq.validation import Array
from mjslq.viewer import camera, geometry
from mjslq.viewer.motion import Motion, extent

_SAME = 1e-3
"""How far a camera may be from where it was put, relative to its distance, to count as untouched."""


_ROOM = 0.06
"""Room around what moves, for what stands there; relative to its size."""


class MovingBoxes:
    """The boxes around the moving pieces of a model."""

    def __init__(self, model: Any) -> None:
        """Find them in a compiled model."""
        pieces = [piece for piece in geometry.pieces(model) if model.body_weldid[piece.body] != 0]
        self._bodies = np.array([piece.body for piece in pieces], dtype=int)
        self._boxes = np.array([[piece.vertices.min(axis=0), piece.vertices.max(axis=0)] for piece in pieces])

    def around(self, moved: Motion) -> tuple[Array, Array] | None:
        """Corners (3,) and (3,) [m] of the box that they fill over a whole motion; None where nothing moves."""
        if not len(self._bodies):
            return None
        low, high = extent(moved, self._bodies, self._boxes)
        room = _ROOM * float(np.linalg.norm(high - low))
        return low - room, high + room


class Framing:
    """Points cameras, and remembers where."""

    def __init__(self, server: viser.ViserServer, aspect: float) -> None:
        """For windows of width / height `aspect`."""
        self._server, self._aspect = server, aspect
        start: Any = server.initial_camera
        self._put = np.array(start.position, dtype=float)

    def frame(self, low: Array, high: Array) -> None:
        """Point every camera at the box `low` ... `high` (3,) [m], and those of windows to come."""
        self._point(low, high, self._cameras())

    def follow(self, low: Array, high: Array) -> None:
        """As `frame`, but leave cameras alone that the reader has turned."""
        self._point(low, high, [camera for camera in self._cameras() if not self._turned(camera)])

    def follow_to(self, position: Array, look_at: Array) -> None:
        """Put untouched cameras at `position`, looking at `look_at`, both (3,) [m]."""
        for seen in [seen for seen in self._cameras() if not self._turned(seen)]:
            seen.position, seen.look_at = position, look_at
        self._put = position

    def _cameras(self) -> list[Any]:
        return [client.camera for client in self._server.get_clients().values()]

    def _turned(self, seen: Any) -> bool:
        position, distance = np.array(seen.position), float(np.linalg.norm(self._put - np.array(seen.look_at)))
        return bool(np.linalg.norm(position - self._put) > _SAME * max(distance, 1e-9))

    def _point(self, low: Array, high: Array, cameras: list[Any]) -> None:
        seen = camera.fit(low, high, self._aspect)
        distance = float(np.linalg.norm(seen.position - seen.look_at))
        self._put = seen.position
        for target in (self._server.initial_camera, *cameras):
            target.position, target.look_at = seen.position, seen.look_at
            target.near, target.far = distance / 200.0, distance * 200.0
