"""Traces: the paths of chosen bodies and sites, the part that has passed stronger than what is to come.

A path is cut into pieces, so that time running on shows or hides one of them and moves the end of another.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from mjslq.validation import Array
from mjslq.viewer.geometry import Piece
from mjslq.viewer.layers.layer import Layer, Stage, node_name
from mjslq.viewer.motion import Frame, Motion, rotated
from mjslq.viewer.theme import Color

_CHOSEN = 4  # paths from the start, at most
_PIECES = 24
_WIDE, _THIN = 3.0, 1.5  # [px]
_LATE = 3  # knots that the line ahead may begin too early, which saves most of its updates
_PALE = 0.62  # share of the ground's colour in what is to come


@dataclass(frozen=True)
class Point:
    """A point of a body."""

    name: str
    """What the model calls it."""
    body: int
    offset: Array
    """In the frame of the body. Shape (3,). [m]"""

    def path(self, moved: Motion) -> Array:
        """Where it is at the knots. Shape (n, 3). [m]"""
        return moved.positions[:, self.body] + rotated(moved.wxyzs[:, self.body], self.offset)

    def at(self, frame: Frame) -> Array:
        """Where it is at a time. Shape (3,). [m]"""
        return frame.positions[self.body] + rotated(frame.wxyzs[self.body], self.offset)


@dataclass
class _Line:
    """A path in pieces: those that have passed, those to come, and one that time is in, drawn in two."""

    point: Point
    path: Array
    spans: list[tuple[int, int]]
    """First and last knot of each piece."""
    parts: list[Any]
    behind: Any
    ahead: Any
    states: list[int]
    """Of each piece: 0 to come, 1 passed, 2 hidden."""
    color: Color
    pale: Color
    ahead_from: tuple[int | None, int] = (None, -1)
    """Piece and knot that `ahead` was last drawn from."""

    def show(self, frame: Frame) -> None:
        """Mark what has passed."""
        now = self.point.at(frame)[None]
        current = next((k for k, (_, b) in enumerate(self.spans) if frame.before < b), None)
        if current is not None and frame.share >= 1.0 and frame.after == len(self.path) - 1:
            current = None
        for k, part in enumerate(self.parts):
            state = 2 if k == current else int(current is None or k < current)
            if state != self.states[k]:
                self.states[k] = state
                part.visible = state != 2
                if state != 2:
                    part.colors = np.array(self.color if state else self.pale, dtype=np.uint8)
                    part.thickness = _WIDE if state else _THIN
        a, b = self.spans[current] if current is not None else (0, 0)
        none = self.path[:1]
        self.behind.points = _segments(none if current is None else np.r_[self.path[a : frame.before + 1], now])
        piece, knot = self.ahead_from
        if piece != current or not 0 <= frame.before - knot < _LATE:
            self.ahead_from = current, frame.before
            self.ahead.points = _segments(none if current is None else np.r_[now, self.path[frame.after : b + 1]])


class Traces(Layer):
    """Paths of points of a model."""

    title = "Paths"
    hint = "Where bodies and sites go"

    def __init__(self, stage: Stage, moved: Motion, visible: bool, pieces: list[Piece], passed: bool = True) -> None:
        """Draw the paths of the outermost bodies among `pieces`; `passed` marks what time has left behind."""
        self.points = points(stage.model, pieces)
        """What paths there can be of, by name: bodies that move, and the sites on them."""
        self._chosen = outermost(stage.model, pieces)[:_CHOSEN]
        self._passed = passed
        super().__init__(stage, moved, visible)

    @property
    def chosen(self) -> tuple[str, ...]:
        """Names of the points whose paths are shown."""
        return tuple(self._chosen)

    @property
    def note(self) -> str:
        """Which paths are shown, in which colours."""
        if not self.visible:
            return ""
        colors = self._stage.theme.paths
        entries = [
            f'<span style="color:rgb{colors[i % len(colors)]};white-space:nowrap">&#9473; {_escaped(name)}</span>'
            for i, name in enumerate(self._chosen)
        ]
        return " &nbsp; ".join(entries)

    def choose(self, *names: str) -> None:
        """Show the paths of bodies and sites. Raises ValueError for a name that is none of `points`."""
        from mjslq.validation import choose

        self._chosen = [choose("body or site", name, self.points) for name in dict.fromkeys(names)]
        self._redraw()

    def follow(self, moved: Motion) -> None:
        """Show another motion from now on."""
        same = len(moved.times) == len(self._moved.times)
        self._moved, self._frame = moved, moved.frame(self._frame.time)
        if self._visible and same and not self._passed:  # of a plan, which changes often
            for handle, name in zip(self._handles, self._chosen, strict=True):
                handle.points = _segments(self.points[name].path(moved))
        elif self._visible:
            self._redraw()

    def update(self, frame: Frame) -> None:
        """Show a time of the motion; of others, which have no path here, nothing."""
        if frame.moved is self._moved:
            super().update(frame)

    def _build(self) -> list[Any]:
        self._lines: list[_Line] = []
        handles = []
        for i, name in enumerate(self._chosen):
            point, color = self.points[name], self._stage.theme.paths[i % len(self._stage.theme.paths)]
            path = point.path(self._moved)
            node = f"/traces/{name.replace('/', '_')}"
            if not self._passed:
                handles.append(self._line(node, _segments(path), color, _THIN))
                continue
            pale = self._stage.theme.faded(color, _PALE)
            ends = np.unique(np.linspace(0, len(path) - 1, min(_PIECES, len(path) - 1) + 1).astype(int)).tolist()
            spans = list(pairwise(ends))
            parts = [
                self._line(f"{node} {k}", _segments(path[a : b + 1]), pale, _THIN) for k, (a, b) in enumerate(spans)
            ]
            behind = self._line(f"{node} behind", _segments(path[:1]), color, _WIDE)
            ahead = self._line(f"{node} ahead", _segments(path[:1]), pale, _THIN)
            self._lines.append(_Line(point, path, spans, parts, behind, ahead, [0] * len(parts), color, pale))
            handles += [*parts, behind, ahead]
        return handles

    def _pose(self, frame: Frame) -> None:
        for line in self._lines:
            line.show(frame)

    def _line(self, name: str, segments: Array, color: Any, width: float) -> Any:
        return self._stage.server.scene.add_line_segments(
            name, segments, color, thickness=width, thickness_units="screen"
        )


def points(model: Any, pieces: list[Piece]) -> dict[str, Point]:
    """Bodies that move, at the middle of what is drawn of them, and the sites on them; by name."""
    middles: dict[int, Array] = {}
    for piece in pieces:
        if not piece.site:
            middles.setdefault(piece.body, 0.5 * (piece.vertices.min(axis=0) + piece.vertices.max(axis=0)))
    found = {}
    for body in range(1, model.nbody):
        if model.body_weldid[body] != 0:
            name = node_name(model, mujoco.mjtObj.mjOBJ_BODY, body)
            found[name] = Point(name, body, middles.get(body, np.zeros(3)))
    for site in range(model.nsite):
        body, name = int(model.site_bodyid[site]), node_name(model, mujoco.mjtObj.mjOBJ_SITE, site)
        if model.body_weldid[body] != 0:
            name = f"{name} (site)" if name in found else name
            found[name] = Point(name, body, np.array(model.site_pos[site]))
    return found


def outermost(model: Any, pieces: list[Piece]) -> list[str]:
    """Names of the bodies that are drawn, move, and carry no other body."""
    parents = set(model.body_parentid[1:].tolist())
    drawn = dict.fromkeys(piece.body for piece in pieces if model.body_weldid[piece.body] != 0 and not piece.site)
    return [node_name(model, mujoco.mjtObj.mjOBJ_BODY, body) for body in drawn if body not in parents]


def _segments(path: Array) -> Array:
    """Segments (n - 1, 2, 3) between points (n, 3)."""
    return np.stack([path[:-1], path[1:]], axis=1).astype(np.float32)


def _escaped(name: str) -> str:
    import html

    return html.escape(name)
