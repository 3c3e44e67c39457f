"""Geoms of a compiled MuJoCo model as triangles, in the frame of the body that carries them.

Curved surfaces share vertices and so shade smoothly; at sharp edges the vertices are doubled, so that a renderer
which averages face normals at shared vertices leaves the edge sharp. Faces are counter-clockwise seen from outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjslq.validation import Array

Faces = NDArray[np.intp]

SHOWN_GROUPS = (0, 1, 2)
"""Groups of geoms and sites that MuJoCo's own viewer shows from the start; collision shapes sit above them."""

_UNSET = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's default rgba: nobody chose a colour
_MOVING, _FIXED = (0.30, 0.44, 0.62, 1.0), (0.62, 0.65, 0.69, 1.0)
_AROUND = 32  # segments of a full turn


@dataclass(frozen=True)
class Piece:
    """All triangles of one body that share a colour."""

    body: int
    """Index of the body."""
    vertices: Array
    """In the body's frame. Shape (n, 3). [m]"""
    faces: Faces
    """Vertex indices of each triangle. Shape (m, 3)."""
    rgba: tuple[float, float, float, float]
    """Colour and opacity in [0, 1]."""


@dataclass(frozen=True)
class Plane:
    """A plane geom; planes are fixed to the world."""

    geom: int
    """Index of the geom."""
    position: Array
    """Centre. Shape (3,). [m]"""
    wxyz: Array
    """Orientation; the normal is the local z. Shape (4,)."""
    size: tuple[float, float]
    """Full extent along the local x and y; 0 for infinite. [m]"""
    rgb: tuple[float, float, float] | None
    """Colour in [0, 1]; None when the model chose none."""


def pieces(model: Any) -> list[Piece]:
    """Return what is visible of `model`, but for its planes: one piece per body and colour."""
    parts: dict[tuple[int, tuple[float, float, float, float]], list[tuple[Array, Faces]]] = {}
    for geom in visible_geoms(model):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        body = int(model.geom_bodyid[geom])
        rgba = _color(model, model.geom_rgba[geom], int(model.geom_matid[geom]), model.body_weldid[body] != 0)
        vertices, faces = geom_mesh(model, geom)
        placed = _placed(vertices, model.geom_pos[geom], model.geom_quat[geom])
        if rgba[3] > 0.0 and len(faces):
            parts.setdefault((body, rgba), []).append((placed, faces))
    for site in range(model.nsite):
        body = int(model.site_bodyid[site])
        rgba = _color(model, model.site_rgba[site], int(model.site_matid[site]), model.body_weldid[body] != 0)
        if model.site_group[site] not in SHOWN_GROUPS or rgba[3] == 0.0:
            continue
        vertices, faces = _SHAPES[mujoco.mjtGeom(model.site_type[site])](model.site_size[site])
        placed = _placed(vertices, model.site_pos[site], model.site_quat[site])
        parts.setdefault((body, rgba), []).append((placed, faces))
    return [Piece(body, *_joined(meshes), rgba) for (body, rgba), meshes in parts.items()]


def planes(model: Any) -> list[Plane]:
    """Return the visible planes of `model`."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    for geom in visible_geoms(model):
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        rgba = _color(model, model.geom_rgba[geom], int(model.geom_matid[geom]), moving=False)
        wxyz = np.zeros(4)
        mujoco.mju_mat2Quat(wxyz, data.geom_xmat[geom])
        half = model.geom_size[geom]
        chosen = model.geom_matid[geom] >= 0 or not np.allclose(model.geom_rgba[geom], _UNSET)
        if rgba[3] > 0.0:
            size = (2.0 * float(half[0]), 2.0 * float(half[1]))
            found.append(Plane(geom, data.geom_xpos[geom].copy(), wxyz, size, rgba[:3] if chosen else None))
    return found


def visible_geoms(model: Any) -> list[int]:
    """Return the geoms in the shown groups; all of them when a model has none there."""
    shown = [geom for geom in range(model.ngeom) if model.geom_group[geom] in SHOWN_GROUPS]
    return shown or list(range(model.ngeom))


def geom_mesh(model: Any, geom: int) -> tuple[Array, Faces]:
    """Return vertices (n, 3) [m] in the geom's own frame and faces (m, 3) of any geom but a plane."""
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF):
        return _mesh(model, int(model.geom_dataid[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
        return _height_field(model, int(model.geom_dataid[geom]))
    return _SHAPES[kind](model.geom_size[geom])


def _sphere(size: Array) -> tuple[Array, Faces]:
    return _ellipsoid(np.full(3, size[0]))


def _ellipsoid(size: Array) -> tuple[Array, Faces]:
    angle = np.linspace(-np.pi / 2, np.pi / 2, _AROUND // 2 + 1)
    return _turned(size[:2], np.cos(angle), size[2] * np.sin(angle))


def _capsule(size: Array) -> tuple[Array, Faces]:
    radius, half = size[0], size[1]
    angle = np.linspace(-np.pi / 2, 0.0, _AROUND // 4 + 1)
    low = radius * np.sin(angle) - half
    return _turned(np.full(2, radius), np.r_[np.cos(angle), np.cos(angle[::-1])], np.r_[low, -low[::-1]])


def _turned(radii: Array, widths: Array, heights: Array) -> tuple[Array, Faces]:
    """Return the closed surface with a ring of half-axes `radii` times `widths[k]` at each of `heights`, low to high.

    The first and the last ring are the poles: one vertex each.
    """
    rings = np.concatenate([_ring(radii * width, height) for width, height in zip(widths, heights, strict=True)][1:-1])
    vertices = np.concatenate([rings, [[0.0, 0.0, heights[0]], [0.0, 0.0, heights[-1]]]])
    south, north, last = len(rings), len(rings) + 1, len(rings) - _AROUND
    faces = [face for start in range(0, last, _AROUND) for face in _band(start, start + _AROUND)]
    return vertices, np.concatenate([*faces, _fan(south, 0)[:, ::-1], _fan(north, last)])


def _ring(radii: Array, height: float) -> Array:
    turn = np.arange(_AROUND) * (2 * np.pi / _AROUND)
    return np.stack([radii[0] * np.cos(turn), radii[1] * np.sin(turn), np.full(_AROUND, height)], axis=1)


def _fan(pole: int, ring: int) -> Faces:
    """Return the triangles between a ring of vertices that starts at `ring` and the vertex `pole` above it."""
    i = np.arange(_AROUND)
    return np.stack([np.full(_AROUND, pole), ring + i, ring + (i + 1) % _AROUND], axis=1)


def _band(below: int, above: int) -> list[Faces]:
    """Return the triangles between two rings of vertices that start at `below` and `above`."""
    i, j = np.arange(_AROUND), (np.arange(_AROUND) + 1) % _AROUND
    return [np.stack([below + i, below + j, above + j], axis=1), np.stack([below + i, above + j, above + i], axis=1)]


def _cylinder(size: Array) -> tuple[Array, Faces]:
    half, n = size[1], _AROUND
    low, high = _ring(np.full(2, size[0]), -half), _ring(np.full(2, size[0]), half)
    vertices = np.concatenate([low, high, low, high, [[0.0, 0.0, -half], [0.0, 0.0, half]]])
    return vertices, np.concatenate([*_band(0, n), _fan(4 * n, 2 * n)[:, ::-1], _fan(4 * n + 1, 3 * n)])


def _box(size: Array) -> tuple[Array, Faces]:
    square = np.array([[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])  # the side z = 1
    sides = [np.roll(square, axis, axis=1) for axis in range(3)]
    sides += [-side[::-1] for side in sides]
    vertices = np.concatenate(sides) * size
    quads = 4 * np.arange(6)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return vertices, quads.reshape(-1, 3)


def _mesh(model: Any, mesh: int) -> tuple[Array, Faces]:
    """Return a mesh asset, with a vertex for each pair of position and normal that a face uses."""
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[start : start + count].astype(float)
    rows = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    corners = np.stack([model.mesh_face[rows].ravel(), model.mesh_facenormal[rows].ravel()], axis=1)
    pairs, index = np.unique(corners, axis=0, return_inverse=True)
    return vertices[pairs[:, 0]], index.reshape(-1, 3)


def _height_field(model: Any, field: int) -> tuple[Array, Faces]:
    """Return the upper surface of a height field."""
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    start = int(model.hfield_adr[field])
    x_half, y_half, top, _ = model.hfield_size[field]
    heights = top * model.hfield_data[start : start + rows * columns]
    y, x = np.meshgrid(np.linspace(-y_half, y_half, rows), np.linspace(-x_half, x_half, columns), indexing="ij")
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    upper = np.stack([corner, corner + columns + 1, corner + columns], axis=1)
    return np.stack([x.ravel(), y.ravel(), heights], axis=1), np.concatenate([lower, upper])


def _color(model: Any, rgba: Array, material: int, moving: bool) -> tuple[float, float, float, float]:
    """Return the colour shown: the geom's own, else its material's, else one for what moves or what stands."""
    if not np.allclose(rgba, _UNSET):
        color = np.array(rgba, dtype=float)
    elif material >= 0:
        color = model.mat_rgba[material] * _texture_mean(model, material)
    else:
        color = np.array(_MOVING if moving else _FIXED)
    r, g, b, a = (round(float(c), 4) for c in np.clip(color, 0.0, 1.0))
    return r, g, b, a


def _texture_mean(model: Any, material: int) -> Array:
    """Return the mean colour of a material's texture, or white; textures themselves are not drawn."""
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture < 0:
        return np.ones(4)
    channels = int(model.tex_nchannel[texture])
    size = int(model.tex_width[texture]) * int(model.tex_height[texture]) * channels
    start = int(model.tex_adr[texture])
    mean = model.tex_data[start : start + size].reshape(-1, channels).mean(axis=0) / 255.0
    return np.array([*(mean[:3] if channels >= 3 else np.repeat(mean[:1], 3)), 1.0])


def _placed(vertices: Array, position: Array, wxyz: Array) -> Array:
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, wxyz)
    return vertices @ rotation.reshape(3, 3).T + position


def _joined(meshes: list[tuple[Array, Faces]]) -> tuple[Array, Faces]:
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in meshes[:-1]])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=True)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


_SHAPES = {
    mujoco.mjtGeom.mjGEOM_SPHERE: _sphere,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: _ellipsoid,
    mujoco.mjtGeom.mjGEOM_CAPSULE: _capsule,
    mujoco.mjtGeom.mjGEOM_CYLINDER: _cylinder,
    mujoco.mjtGeom.mjGEOM_BOX: _box,
}
