"""Flexes (cables, cloth, soft bodies) and skins: surfaces whose vertices move.

    dim 1       a stick for each edge, as thick as the flex
    dim 2       both sides, radius r away from the middle surface along its normals, and the rim between them
    dim 3       the outer shell, r outside of the vertices
    skin        v = sum over bones of w (R_bone R_bind^T (v_0 - p_bind) + p_bone), weights w of sum 1

What has a texture is drawn in a few colours of it, a mesh for each: a face takes the colour at its middle.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjslq.validation import Array
from mjslq.viewer import textures
from mjslq.viewer.details import details
from mjslq.viewer.geometry import SHOWN_GROUPS, color_of, vertex_normals
from mjslq.viewer.layers.layer import Layer, color_bytes, place_sticks
from mjslq.viewer.motion import Frame, rotated

Faces = NDArray[np.intp]
_COLORS = 6  # of a texture, at most


class Flexes(Layer):
    """All flexes and skins of a model."""

    title = "Soft bodies"

    @staticmethod
    def offered(model: Any) -> bool:
        """Whether a model has any that can be drawn."""
        return bool(_flexes(model) or _skins(model))

    def _build(self) -> list[Any]:
        model, handles = self._stage.model, []
        self._updates: list[Any] = []
        surface: _Sheet | _Skin
        for flex in _flexes(model):
            if model.flex_dim[flex] == 1:
                edges = flex_edges(model, flex)
                color = color_bytes(np.array(_flex_color(model, flex)[:3]))
                handle = self._sticks(f"flexes/{flex}", len(edges), color)
                handles.append(handle)
                self._updates.append(_Cable(model, flex, edges, handle))
                continue
            surface = _Sheet(model, flex)
            parts = self._meshes(f"flexes/{flex}", surface.faces, surface.classes, surface.at(self._frame))
            handles += parts
            self._updates.append(_Moved(surface, parts))
        for skin in _skins(model):
            surface = _Skin(model, skin)
            parts = self._meshes(f"skins/{skin}", surface.faces, surface.classes, surface.at(self._frame))
            handles += parts
            self._updates.append(_Moved(surface, parts))
        return handles

    def _pose(self, frame: Frame) -> None:
        for update in self._updates:
            update(frame)

    def _meshes(self, name: str, faces: Faces, classes: list[tuple[Any, Faces]], vertices: Array) -> list[Any]:
        """Make a mesh for each (rgba, faces of that colour), with the vertices that it uses."""
        used = [np.unique(faces[chosen], return_inverse=True) for _, chosen in classes]
        return [
            self._stage.server.scene.add_mesh_simple(
                f"/{name}/{k}",
                vertices=vertices[used[k][0]].astype(np.float32),
                faces=used[k][1].reshape(-1, 3).astype(np.uint32),
                color=color_bytes(np.array(rgba[:3])),
                opacity=rgba[3] if rgba[3] < 1.0 else None,
                side="double",
            )
            for k, (rgba, _) in enumerate(classes)
        ]


class _Cable:
    """Sticks along the edges of a flex of dimension 1."""

    def __init__(self, model: Any, flex: int, edges: Faces, handle: Any) -> None:
        self._model, self._edges, self._handle = model, edges, handle
        self._radii = np.full(len(edges), max(float(model.flex_radius[flex]), 1e-4))

    def __call__(self, frame: Frame) -> None:
        place_sticks(self._handle, frame.of(details(self._model, frame.moved).vertices)[self._edges], self._radii)


class _Moved:
    """Meshes of one surface, each with the vertices that it uses."""

    def __init__(self, surface: Any, handles: list[Any]) -> None:
        self._surface, self._handles = surface, handles
        self._used = [np.unique(surface.faces[chosen]) for _, chosen in surface.classes]
        self._last = np.empty(0)

    def __call__(self, frame: Frame) -> None:
        vertices = self._surface.at(frame).astype(np.float32)
        if not np.array_equal(vertices, self._last):
            self._last = vertices
            for handle, used in zip(self._handles, self._used, strict=True):
                handle.vertices = vertices[used]


class _Sheet:
    """The surface of a flex of dimension 2 or 3."""

    def __init__(self, model: Any, flex: int) -> None:
        self._model, self._flex = model, flex
        start, count = int(model.flex_vertadr[flex]), int(model.flex_vertnum[flex])
        self._rows = slice(start, start + count)
        self._middle = flex_triangles(model, flex)
        self._radius = float(model.flex_radius[flex])
        self._two_sided = model.flex_dim[flex] == 2
        faces = self._middle
        if self._two_sided:
            faces = np.concatenate([faces, faces[:, ::-1] + count, _rim(faces, count)])
        self.faces = faces
        self.classes = self._colored(count)

    def at(self, frame: Frame) -> Array:
        """Vertices at a time. [m]"""
        middle = frame.of(details(self._model, frame.moved).vertices)[self._rows]
        shift = self._radius * vertex_normals(middle, self._middle)
        return np.concatenate([middle + shift, middle - shift]) if self._two_sided else middle + shift

    def _colored(self, count: int) -> list[tuple[Any, Faces]]:
        model, flex = self._model, self._flex
        rgba, material = _flex_color(model, flex), int(model.flex_matid[flex])
        texture = textures.texture_of(model, material)
        if texture is None or model.flex_texcoordadr[flex] < 0:
            return [(rgba, np.arange(len(self.faces)))]
        start = int(model.flex_texcoordadr[flex])
        coordinates = model.flex_texcoord[start:].reshape(-1, 2)[:count].astype(float)
        middle = coordinates[self.faces % count].mean(axis=1)
        mean = np.maximum(textures.mean_color(model, material), 1e-9)
        colors = textures.colors_at(model, texture.index, middle) * np.array(rgba[:3]) / mean
        return [((*color, rgba[3]), chosen) for color, chosen in _classes(colors)]


class _Skin:
    """A skin over bodies."""

    def __init__(self, model: Any, skin: int) -> None:
        self._model = model
        start, count = int(model.skin_vertadr[skin]), int(model.skin_vertnum[skin])
        self._rest = model.skin_vert[start : start + count].astype(float)
        rows = slice(int(model.skin_faceadr[skin]), int(model.skin_faceadr[skin]) + int(model.skin_facenum[skin]))
        self.faces = model.skin_face[rows].astype(np.intp)
        first = int(model.skin_boneadr[skin])
        self._bones = range(first, first + int(model.skin_bonenum[skin]))
        self._inflate = float(model.skin_inflate[skin])
        material = int(model.skin_matid[skin])
        rgba = color_of(model, model.skin_rgba[skin], material, moving=True)
        self.classes = [(rgba, np.arange(len(self.faces)))]

    def at(self, frame: Frame) -> Array:
        """Vertices at a time. [m]"""
        model, vertices = self._model, np.zeros_like(self._rest)
        for bone in self._bones:
            rows = slice(int(model.skin_bonevertadr[bone]), None)
            rows = slice(rows.start, rows.start + int(model.skin_bonevertnum[bone]))
            index, weight = model.skin_bonevertid[rows], model.skin_bonevertweight[rows].astype(float)
            body = int(model.skin_bonebodyid[bone])
            unbound = model.skin_bonebindquat[bone] * [1.0, -1.0, -1.0, -1.0]
            local = rotated(unbound, self._rest[index] - model.skin_bonebindpos[bone])
            placed = rotated(frame.wxyzs[body], local) + frame.positions[body]
            np.add.at(vertices, index, weight[:, None] * placed)
        if self._inflate:
            vertices += self._inflate * vertex_normals(vertices, self.faces)
        return vertices


def flex_triangles(model: Any, flex: int) -> Faces:
    """Triangles of a flex of dimension 2, or of the outer shell of one of dimension 3. Shape (m, 3)."""
    if model.flex_dim[flex] == 2:
        start, number = int(model.flex_elemdataadr[flex]), int(model.flex_elemnum[flex])
        return np.asarray(model.flex_elem[start : start + 3 * number]).reshape(-1, 3).astype(np.intp)
    start, number = int(model.flex_shelldataadr[flex]), int(model.flex_shellnum[flex])
    return np.asarray(model.flex_shell[start : start + 3 * number]).reshape(-1, 3).astype(np.intp)


def flex_edges(model: Any, flex: int) -> Faces:
    """Pairs of vertices, by their index among those of all flexes. Shape (m, 2)."""
    start, number = int(model.flex_edgeadr[flex]), int(model.flex_edgenum[flex])
    return model.flex_edge[start : start + number].astype(np.intp) + int(model.flex_vertadr[flex])


def _rim(faces: Faces, count: int) -> Faces:
    """The triangles that join the edges with one face only to those of a copy `count` vertices later."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, index, uses = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    a, b = edges[index[uses == 1]].T
    return np.concatenate([np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)])


def _classes(colors: Array) -> list[tuple[Array, Faces]]:
    """A few colours for many (n, 3), each with the rows that take it: the most frequent ones, rounded."""
    rounded, index, uses = np.unique((8.0 * colors).round(), axis=0, return_inverse=True, return_counts=True)
    kept = np.argsort(-uses)[:_COLORS]
    nearest = np.linalg.norm(rounded[:, None] - rounded[kept][None], axis=2).argmin(axis=1)[index.ravel()]
    return [(colors[nearest == k].mean(axis=0), np.flatnonzero(nearest == k)) for k in range(len(kept))]


def _flex_color(model: Any, flex: int) -> tuple[float, float, float, float]:
    return color_of(model, model.flex_rgba[flex], int(model.flex_matid[flex]), moving=True)


def _flexes(model: Any) -> list[int]:
    seen = [flex for flex in range(model.nflex) if model.flex_group[flex] in SHOWN_GROUPS]
    return [flex for flex in seen if _flex_color(model, flex)[3] > 0.0]


def _skins(model: Any) -> list[int]:
    return [skin for skin in range(model.nskin) if model.skin_group[skin] in SHOWN_GROUPS]
