"""`Layer`: one kind of thing that a scene shows, and `Stage`: where it is drawn.

A layer that is hidden costs nothing: its nodes are made when it is first shown, and removed when it is hidden.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from mjslq.validation import Array
from mjslq.viewer.motion import Frame, Motion
from mjslq.viewer.theme import Color, Theme

if TYPE_CHECKING:
    import viser

ROOTS = (
    "bodies", "ghosts", "ground", "reference", "traces", "tendons", "flexes", "skins", "contacts", "targets", "masses",
    "joints", "frames",
)  # fmt: skip
"""Nodes that all others hang on; a camera that follows something moves them the other way."""


@dataclass
class Stage:
    """What all layers draw on."""

    server: viser.ViserServer
    model: Any
    """The `mujoco.MjModel` that is drawn."""
    theme: Theme
    length: float
    """About the size of what moves, from corner to corner. [m]"""
    reach: float
    """About the size of the motion, from corner to corner. [m]"""
    cell: float = 0.0
    """Within what meshes may differ from the model's; see `simplify`. [m]"""


class Layer(ABC):
    """One kind of thing in a scene."""

    title: str
    """What the panel calls it."""
    hint = ""
    """What the panel says of it."""

    def __init__(self, stage: Stage, moved: Motion, visible: bool = False) -> None:
        """Draw on `stage` what there is to see of a motion."""
        self._stage, self._moved, self._frame = stage, moved, moved.frame(0.0)
        self._handles: list[Any] = []
        self._visible = False
        self.noted: Callable[[], None] | None = None
        """Called when `note` has changed."""
        self.visible = visible

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return self._visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        if visible == self._visible:
            return
        self._visible = bool(visible)
        self._redraw()

    @property
    def note(self) -> str:
        """A line for the panel, such as a legend, in HTML; empty for none."""
        return ""

    def follow(self, moved: Motion) -> None:
        """Show another motion from now on."""
        self._moved = moved
        if self.noted is not None:
            self.noted()

    def update(self, frame: Frame) -> None:
        """Show a time of the motion."""
        self._frame = frame
        if self._visible:
            self._pose(frame)

    def restyle(self) -> None:
        """Take the colours of the stage's theme."""
        if self._visible:
            self._redraw()

    def _redraw(self) -> None:
        with self._stage.server.atomic():
            for handle in reversed(self._handles):  # what hangs on others first
                handle.remove()
            self._handles = self._build() if self._visible else []
            if self._visible:
                self._pose(self._frame)
        if self.noted is not None:
            self.noted()

    @abstractmethod
    def _build(self) -> list[Any]:
        """Make the nodes."""

    @abstractmethod
    def _pose(self, frame: Frame) -> None:
        """Put the nodes where they are at a time."""

    # building blocks

    def _sticks(self, name: str, number: int, color: Color) -> Any:
        """Make `number` straight round sticks, which `place_sticks` places."""
        turn = np.arange(12) * (2.0 * np.pi / 12.0)
        ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        low, high = (np.column_stack([ring, np.full(12, z)]) for z in (-0.5, 0.5))
        i, j = np.arange(12), (np.arange(12) + 1) % 12
        faces = np.concatenate([np.stack([i, j, j + 12], axis=1), np.stack([i, j + 12, i + 12], axis=1)])
        return self._batch(name, np.concatenate([low, high]), faces, number, color)

    def _batch(self, name: str, vertices: Array, faces: Any, number: int, color: Color, **more: Any) -> Any:
        """Make `number` copies of a shape, of size zero."""
        return self._stage.server.scene.add_batched_meshes_simple(
            f"/{name}",
            vertices=vertices.astype(np.float32),
            faces=np.asarray(faces).astype(np.uint32),
            batched_positions=np.zeros((number, 3), dtype=np.float32),
            batched_wxyzs=np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (number, 1)),
            batched_scales=np.zeros((number, 3), dtype=np.float32),
            batched_colors=linear_bytes(np.array(color) / 255.0),
            lod="off",
            **more,
        )


def place_sticks(handle: Any, segments: Array, radii: Array) -> None:
    """Put sticks between the ends (k, 2, 3) [m], with radii (k,) [m]; those without length vanish."""
    along = segments[:, 1] - segments[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    radii = np.where(lengths > 0.0, radii, 0.0)
    handle.batched_positions = segments.mean(axis=1).astype(np.float32)
    handle.batched_wxyzs = turn_z_to(along).astype(np.float32)
    handle.batched_scales = np.stack([radii, radii, lengths], axis=1).astype(np.float32)


def turn_z_to(directions: Array) -> Array:
    """Quaternions (k, 4) that turn the z axis to `directions` (k, 3), which need not have length 1."""
    lengths = np.linalg.norm(directions, axis=1)
    unit = directions / np.maximum(lengths, 1e-12)[:, None]
    wxyz = np.stack([1.0 + unit[:, 2], -unit[:, 1], unit[:, 0], np.zeros(len(unit))], axis=1)
    norm = np.linalg.norm(wxyz, axis=1)
    about = norm < 1e-6  # half a turn, about any axis across
    wxyz[about] = [0.0, 1.0, 0.0, 0.0]
    wxyz[lengths == 0.0] = [1.0, 0.0, 0.0, 0.0]
    return wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True)


def color_bytes(rgb: Array) -> Color:
    """A colour in [0, 1] in 0 ... 255."""
    r, g, b = (round(255.0 * float(c)) for c in np.clip(rgb, 0.0, 1.0))
    return r, g, b


def linear_bytes(rgb: Array) -> Color:
    """A colour as linear light, which is how Viser reads the colours of batched meshes."""
    from mjslq.viewer.textures import linear

    return color_bytes(linear(rgb))


def node_name(model: Any, kind: Any, index: int) -> str:
    """The name of a part of a model, fit for a node; "body 3" where it has none."""
    word = {mujoco.mjtObj.mjOBJ_BODY: "body", mujoco.mjtObj.mjOBJ_SITE: "site"}.get(kind, "part")
    return str(mujoco.mj_id2name(model, kind, index) or f"{word} {index}")
