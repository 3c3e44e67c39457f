"""Meshes with fewer triangles and rounded places, for files: vertices that lie within a pixel become one.

Notation
--------
    h            size of a cell of a grid in space [m]
    c(v)         the cell of a vertex
    n(v)         its normal; m(c) the mean of those in a cell
    s(v)         0 where n and m are less than 20 degrees apart, else n rounded to one of 26 directions

All vertices in a cell go to one place, their mean, which moves none by more than the cell's diagonal. Those with the
same s as well become one vertex, so that edges which are sharp, where vertices are doubled, stay sharp; and since both
sides of such an edge go to the same place, it stays closed. Triangles without area are left out, and those that lie
back to back (J. Rossignac and P. Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993, with
the normals added). Places are multiples of a power of two [m], which packs well: on the G1 meshes take half the room.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np

from mjslq.validation import Array
from mjslq.viewer.geometry import Faces, Piece, vertex_normals

SHARE = 1.0 / 1200.0
"""Size of a cell over that of what moves: less than a pixel, where that fills a window of 1000."""
_STEPS = 8.0
"""Places are rounded to a step of a cell at most so many times as large."""
_ALIKE = 0.94
"""Cosine of the angle to the mean normal from which on a normal belongs to it."""
_FEW = 2000
"""Meshes with fewer triangles are left as they are."""


def cell_of(model: Any) -> float:
    """Size of the cells that fit what moves of a model, from corner to corner as it stands at first. [m]"""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    sized = (model.geom_rbound > 0.0) & (model.body_weldid[model.geom_bodyid] != 0)
    if not sized.any():
        return 0.0
    centres, radii = data.geom_xpos[sized], model.geom_rbound[sized, None]
    return SHARE * float(np.linalg.norm((centres + radii).max(axis=0) - (centres - radii).min(axis=0)))


def simplified(piece: Piece, cell: float) -> Piece:
    """A piece with fewer triangles, or itself where it has few, or a texture. `cell` in [m]; 0 for no change."""
    if cell <= 0.0 or piece.cover is not None or len(piece.faces) < _FEW:
        return piece
    vertices, faces = merged(piece.vertices, piece.faces, cell)
    return dataclasses.replace(piece, vertices=vertices, faces=faces)


def merged(vertices: Array, faces: Faces, cell: float) -> tuple[Array, Faces]:
    """Return vertices (n, 3) [m] and faces (m, 3), one vertex for those of each cell and direction of normals."""
    normals = vertex_normals(vertices, faces)
    _, place = _numbered(np.floor(vertices / cell).astype(np.int64))
    step = 2.0 ** np.floor(np.log2(cell / _STEPS))
    means = np.round(_means(vertices, place) / step) * step
    around = _means(normals, place)
    around /= np.maximum(np.linalg.norm(around, axis=1, keepdims=True), 1e-12)
    apart = (normals * around[place]).sum(axis=1) < _ALIKE
    side = np.where(apart[:, None], np.round(1.2 * normals), 0.0).astype(np.int64)
    first, vertex = _numbered(np.column_stack([place, side]))
    corners = vertex[faces[_seen(place[faces])]]
    used, index = _numbered(corners.reshape(-1, 1))
    return means[place[first[corners.ravel()[used]]]], index.reshape(-1, 3)


def _seen(corners: Faces) -> Faces:
    """Which triangles, given by the places of their corners, have an area and another side than their copies."""
    whole = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))
    turned = np.take_along_axis(corners, (corners.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)[whole]
    side = np.where(turned[:, 1] < turned[:, 2], 1, -1)
    _, same = _numbered(np.sort(turned, axis=1))
    net = np.bincount(same, weights=side)  # a triangle and its back side are a fin, which is gone
    kept = side == np.sign(net[same])
    _, first = np.unique(same[kept], return_index=True)
    return whole[kept][np.sort(first)]


def _means(values: Array, place: Faces) -> Array:
    """Means of the rows that have the same number. Shape (k, 3)."""
    number = np.bincount(place)[:, None]
    return np.stack([np.bincount(place, weights=column) for column in values.T], axis=1) / number


def _numbered(rows: np.ndarray[Any, np.dtype[np.int64]]) -> tuple[Faces, Faces]:
    """Where each different row first occurs, in the order in which they occur, and the number of each row."""
    _, first, number = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[number.ravel()]
