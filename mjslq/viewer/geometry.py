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
from mjslq.viewer import textures

Faces = NDArray[np.intp]
Color = tuple[float, float, float, float]

SHOWN_GROUPS = (0, 1, 2)
"""Groups of geoms and sites that MuJoCo's own viewer shows from the start; collision shapes sit above them."""

_UNSET = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's default rgba: nobody chose a colour
_MOVING, _FIXED = (0.30, 0.44, 0.62, 1.0), (0.62, 0.65, 0.69, 1.0)
_AROUND = 32  # segments of a full turn


@dataclass(frozen=True)
class Piece:
    """All triangles of one body and group that share a colour and a texture."""

    body: int
    """Index of the body."""
    vertices: Array
    """In the body's frame. Shape (n, 3). [m]"""
    faces: Faces
    """Vertex indices of each triangle. Shape (m, 3)."""
    rgba: tuple[float, float, float, float]
    """Colour and opacity in [0, 1]; of what has a texture, its mean colour."""
    group: int = 0
    """MuJoCo's group, 0 to 5."""
    site: bool = False
    """Whether it marks sites, and is no body's surface."""
    cover: Cover | None = None
    """Its texture."""


@dataclass(frozen=True)
class Cover:
    """A texture laid on triangles."""

    texture: int
    """Index of the texture."""
    tint: tuple[float, float, float, float]
    """Colour and opacity that the image is multiplied by."""
    shininess: float
    """Of the material, in [0, 1]."""
    coordinates: Array
    """(s, t) of each vertex; see `textures`. Shape (n, 2)."""
    normals: Array
    """Of each vertex. Shape (n, 3)."""


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
    group: int = 0
    """MuJoCo's group, 0 to 5."""


def pieces(model: Any, groups: tuple[int, ...] | None = None) -> list[Piece]:
    """Return geoms, but for planes, and sites: one piece per body, group, colour and texture.

    Those of some `groups`, or what is visible from the start.
    """
    parts: dict[tuple[Any, ...], list[_Part]] = {}
    for geom in visible_geoms(model) if groups is None else np.flatnonzero(np.isin(model.geom_group, groups)):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        body, material = int(model.geom_bodyid[geom]), int(model.geom_matid[geom])
        rgba = color_of(model, model.geom_rgba[geom], material, model.body_weldid[body] != 0)
        part = _part(model, int(geom))
        if rgba[3] > 0.0 and len(part.faces):
            key: tuple[Any, ...] = (body, int(model.geom_group[geom]), rgba, False)
            if part.coordinates is not None:
                key += (material, _rounded(tint_of(model, model.geom_rgba[geom], material)))
            parts.setdefault(key, []).append(part.placed(model.geom_pos[geom], model.geom_quat[geom]))
    for site in np.flatnonzero(np.isin(model.site_group, SHOWN_GROUPS if groups is None else groups)):
        body = int(model.site_bodyid[site])
        rgba = color_of(model, model.site_rgba[site], int(model.site_matid[site]), model.body_weldid[body] != 0)
        if rgba[3] > 0.0:
            part = _Part(*_SHAPES[mujoco.mjtGeom(model.site_type[site])](model.site_size[site]))
            key = (body, int(model.site_group[site]), rgba, True)
            parts.setdefault(key, []).append(part.placed(model.site_pos[site], model.site_quat[site]))
    return [_joined(model, *key, joined=some) for key, some in parts.items()]


def planes(model: Any, groups: tuple[int, ...] | None = None) -> list[Plane]:
    """Return the planes of some `groups`, or those that are visible from the start."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    for geom in visible_geoms(model) if groups is None else np.flatnonzero(np.isin(model.geom_group, groups)):
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        rgba = color_of(model, model.geom_rgba[geom], int(model.geom_matid[geom]), moving=False)
        wxyz = np.zeros(4)
        mujoco.mju_mat2Quat(wxyz, data.geom_xmat[geom])
        half = model.geom_size[geom]
        chosen = model.geom_matid[geom] >= 0 or not np.allclose(model.geom_rgba[geom], _UNSET)
        if rgba[3] > 0.0:
            size = (2.0 * float(half[0]), 2.0 * float(half[1]))
            rgb = rgba[:3] if chosen else None
            found.append(Plane(int(geom), data.geom_xpos[geom].copy(), wxyz, size, rgb, int(model.geom_group[geom])))
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


def geom_ball(radius: float) -> tuple[Array, Faces]:
    """Return vertices (n, 3) [m] and faces (m, 3) of a ball."""
    return _sphere(np.array([radius]))


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
    vertices, faces, _ = _mesh_with_coordinates(model, mesh, textured=False)
    return vertices, faces


def _mesh_with_coordinates(model: Any, mesh: int, textured: bool) -> tuple[Array, Faces, Array | None]:
    """Return a mesh asset, and the coordinates of its texture where it has some and they are asked for."""
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[start : start + count].astype(float)
    rows = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    corners = [model.mesh_face[rows].ravel(), model.mesh_facenormal[rows].ravel()]
    textured = textured and model.mesh_texcoordadr[mesh] >= 0
    if textured:
        corners.append(model.mesh_facetexcoord[rows].ravel())
    used, index = np.unique(np.stack(corners, axis=1), axis=0, return_inverse=True)
    coordinates = None
    if textured:
        coordinates = model.mesh_texcoord[model.mesh_texcoordadr[mesh] + used[:, 2]].astype(float)
    return vertices[used[:, 0]], index.reshape(-1, 3), coordinates


def _height_field(model: Any, field: int) -> tuple[Array, Faces]:
    """Return the upper surface of a height field, and its sides down to its base."""
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    start = int(model.hfield_adr[field])
    x_half, y_half, top, base = model.hfield_size[field]
    heights = top * model.hfield_data[start : start + rows * columns]
    y, x = np.meshgrid(np.linspace(-y_half, y_half, rows), np.linspace(-x_half, x_half, columns), indexing="ij")
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    upper = np.stack([corner, corner + columns + 1, corner + columns], axis=1)
    vertices, faces = [np.stack([x.ravel(), y.ravel(), heights], axis=1)], [lower, upper]
    grid = np.arange(rows * columns).reshape(rows, columns)
    for edge in (grid[0], grid[:, -1], grid[-1, ::-1], grid[::-1, 0]):  # counter-clockwise seen from above
        first, n = sum(map(len, vertices)), len(edge)
        rim = vertices[0][edge]
        vertices += [rim, rim * [1.0, 1.0, 0.0] - [0.0, 0.0, base]]
        i = first + np.arange(n - 1)
        faces += [np.stack([i + n, i + n + 1, i + 1], axis=1), np.stack([i + n, i + 1, i], axis=1)]
    return np.concatenate(vertices), np.concatenate(faces)


def color_of(model: Any, rgba: Array, material: int, moving: bool) -> tuple[float, float, float, float]:
    """Return the colour shown: the geom's own, else its material's, else one for what moves or what stands."""
    chosen = material >= 0 or not np.allclose(rgba, _UNSET)
    color = tint_of(model, rgba, material) if chosen else np.array(_MOVING if moving else _FIXED)
    if material >= 0:
        color = color * [*textures.mean_color(model, material), 1.0]
    return _rounded(color)


def tint_of(model: Any, rgba: Array, material: int) -> Array:
    """Return the colour that a material's texture is multiplied by: the geom's own, else the material's."""
    own = material < 0 or not np.allclose(rgba, _UNSET)
    return np.array(rgba if own else model.mat_rgba[material], dtype=float)


def _rounded(color: Array) -> Color:
    r, g, b, a = (round(float(c), 4) for c in np.clip(color, 0.0, 1.0))
    return r, g, b, a


@dataclass(frozen=True)
class _Part:
    """Triangles of one geom, with the coordinates of its texture."""

    vertices: Array
    faces: Faces
    coordinates: Array | None = None
    normals: Array | None = None

    def placed(self, position: Array, wxyz: Array) -> _Part:
        """The same in the frame of the body."""
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, wxyz)
        turn = rotation.reshape(3, 3).T
        normals = None if self.normals is None else self.normals @ turn
        return _Part(self.vertices @ turn + position, self.faces, self.coordinates, normals)


def _part(model: Any, geom: int) -> _Part:
    """Return the surface of a geom, unfolded along its texture where it has one."""
    material = int(model.geom_matid[geom])
    texture = textures.texture_of(model, material)
    if texture is None:
        return _Part(*geom_mesh(model, geom))
    own = None
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        vertices, faces, own = _mesh_with_coordinates(model, int(model.geom_dataid[geom]), not texture.cube)
    else:
        vertices, faces = geom_mesh(model, geom)
    normals = vertex_normals(vertices, faces)
    size = _extent_of(model, geom)
    if own is not None:
        return _Part(vertices, faces, own, normals)
    free = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF, mujoco.mjtGeom.mjGEOM_HFIELD)
    shape = mujoco.mjtGeom(model.geom_type[geom])
    if not texture.cube and shape in free:
        return _Part(vertices, faces, textures.flat_coordinates(texture, vertices, size), normals)
    if not texture.cube:
        coordinates, corner = textures.wrapped_coordinates(texture, shape, vertices, faces, size)
    else:
        if shape == mujoco.mjtGeom.mjGEOM_BOX and texture.uniform:  # its edges are not those of the cube
            vertices, faces = divided(vertices, faces, 3)
            normals = vertex_normals(vertices, faces)
        directions = vertices if shape in free else vertices / size
        directions = directions * size if texture.uniform else directions
        coordinates, corner = textures.cube_coordinates(directions, faces)
    return _Part(vertices[corner], np.arange(len(corner)).reshape(-1, 3), coordinates, normals[corner])


def divided(vertices: Array, faces: Faces, times: int) -> tuple[Array, Faces]:
    """Return triangles cut into four, `times` over; those that shared no vertices still share none."""
    for _ in range(times):
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        corners = [a, b, c, 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)]
        start = np.arange(len(faces))[:, None]
        index = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
        faces = np.concatenate([start + len(start) * np.array(triangle) for triangle in index])
        vertices = np.concatenate(corners)
    return vertices, faces


def _extent_of(model: Any, geom: int) -> Array:
    """Return what MuJoCo's renderer scales the unit shape of a geom by. Shape (3,). [m]"""
    size = model.geom_size[geom]
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.full(3, size[0])
    if kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        return np.array([size[0], size[0], size[1]])
    return np.array(size)


def vertex_normals(vertices: Array, faces: Faces) -> Array:
    """Return the mean normals of the faces around each vertex, by area. Shape (n, 3)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normals = np.zeros_like(vertices)
    np.add.at(normals, faces, np.cross(b - a, c - a)[:, None])
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _joined(
    model: Any, body: int, group: int, rgba: Color, site: bool, material: int = -1, tint: Color | None = None,
    *, joined: list[_Part],
) -> Piece:  # fmt: skip
    offsets = np.cumsum([0] + [len(part.vertices) for part in joined[:-1]])
    faces = np.concatenate([part.faces + offset for part, offset in zip(joined, offsets, strict=True)])
    vertices = np.concatenate([part.vertices for part in joined])
    cover = None
    if tint is not None:
        texture = textures.texture_of(model, material)
        assert texture is not None
        coordinates = np.concatenate([part.coordinates for part in joined if part.coordinates is not None])
        normals = np.concatenate([part.normals for part in joined if part.normals is not None])
        cover = Cover(texture.index, tint, float(model.mat_shininess[material]), coordinates, normals)
    return Piece(body, vertices, faces, rgba, group, site, cover)


_SHAPES = {
    mujoco.mjtGeom.mjGEOM_SPHERE: _sphere,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: _ellipsoid,
    mujoco.mjtGeom.mjGEOM_CAPSULE: _capsule,
    mujoco.mjtGeom.mjGEOM_CYLINDER: _cylinder,
    mujoco.mjtGeom.mjGEOM_BOX: _box,
}
