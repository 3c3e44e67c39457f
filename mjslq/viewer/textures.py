"""Textures of MuJoCo materials: their images, where they lie on a surface, and surfaces with them as glTF.

Notation
--------
    X = x / size            coordinates of a vertex in units of its geom: [-1, 1] on a box
    (s, t)                  texture coordinates; the image's first row is t = 0, and it repeats with period 1
    rep                     texrepeat of the material

MuJoCo's renderer places a texture by the role of the material's RGB layer:

    2D, on a mesh that brings coordinates      (s, t) of the mesh
    2D, on planes, height fields, meshes       s = rep_0 X_0 / 2 - 1/2,   t = -rep_1 X_1 / 2 - 1/2
                                               with texuniform, and along infinite sides: x in place of X
    2D, on other shapes                        rep (s', t'), with texuniform rep size (s', t'), where (s', t') runs from
                                               0 to 1 over each side of a box, and round about and down the others
    cube                                       the direction X (x on a mesh, X * size with texuniform) from the
                                               middle of a cube whose six sides carry the image

A renderer of triangles has no cube textures. Each triangle takes the side of the cube that its middle sees, in one
image of all six sides; the triangles of boxes lie within a side, and those of round shapes almost.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjslq.validation import Array

_ROUGHEST, _SMOOTHEST = 0.9, 0.35
# of the cube's sides +x, -x, +y, -y, +z, -z, as OpenGL has them: the axis seen, and those of s and t with their signs
_SIDES = ((0, 2, -1, 1, -1), (0, 2, 1, 1, -1), (1, 0, 1, 2, 1), (1, 0, 1, 2, -1), (2, 0, 1, 1, -1), (2, 0, -1, 1, -1))


@dataclass(frozen=True)
class Texture:
    """The RGB layer of a material."""

    index: int
    """Of the texture."""
    cube: bool
    """Whether it is one image for each side of a cube."""
    repeat: tuple[float, float]
    """How often it repeats along s and t."""
    uniform: bool
    """Whether lengths count, and not the geom's size."""


def texture_of(model: Any, material: int) -> Texture | None:
    """The texture of a material; None where it has none, or one that is a single colour."""
    index = _index(model, material)
    if index < 0 or not np.ptp(_pixels(model, index), axis=0).any():
        return None
    repeat = model.mat_texrepeat[material]
    cube = model.tex_type[index] == mujoco.mjtTexture.mjTEXTURE_CUBE
    return Texture(index, bool(cube), (float(repeat[0]), float(repeat[1])), bool(model.mat_texuniform[material]))


def mean_color(model: Any, material: int) -> Array:
    """The mean colour of a material's texture in [0, 1], or white. Shape (3,)."""
    index = _index(model, material)
    return np.ones(3) if index < 0 else _pixels(model, index).mean(axis=0)[:3] / 255.0


def image(model: Any, texture: int) -> NDArray[np.uint8]:
    """The image of a texture; of a cube all six sides, one below the other. Shape (height, width, 3)."""
    pixels = _pixels(model, texture)
    whole = pixels.reshape(int(model.tex_height[texture]), int(model.tex_width[texture]), 3)
    cube = model.tex_type[texture] != mujoco.mjtTexture.mjTEXTURE_2D
    return np.tile(whole, (6, 1, 1)) if cube and whole.shape[0] == whole.shape[1] else whole


def flat_coordinates(texture: Texture, points: Array, size: Array) -> Array:
    """(s, t) of a 2D texture at points (n, 3) [m] of a geom, whose `size` (3,) is 0 along infinite sides. (n, 2)."""
    scale = np.array(texture.repeat)
    for k in range(2):
        if not texture.uniform and size[k] > 0.0:
            scale[k] /= size[k]
    return 0.5 * scale * points[:, :2] * [1.0, -1.0] - 0.5


def wrapped_coordinates(
    texture: Texture, kind: Any, points: Array, faces: NDArray[np.intp], size: Array
) -> tuple[Array, NDArray[np.intp]]:
    """(s, t) (3 m, 2) of a 2D texture on a box, ellipsoid, capsule or cylinder, and the vertex of each corner (3 m,).

    `points` (n, 3) [m] are the vertices of the geom, `size` (3,) [m] what its unit shape is scaled by.
    """
    X = (points / size)[faces]  # (m, 3, 3)
    middle, shapes = X.mean(axis=1), mujoco.mjtGeom
    if kind == shapes.mjGEOM_BOX:
        axis = np.abs(middle).argmax(axis=1)
        across, down = np.array([[1, 2], [0, 2], [0, 1]])[axis].T
        rows = np.arange(len(faces))[:, None], np.arange(3)[None, :]
        s, t = 0.5 + 0.5 * X[*rows, across[:, None]], 0.5 - 0.5 * X[*rows, down[:, None]]
    else:
        s = np.arctan2(X[..., 1], X[..., 0]) / (2.0 * np.pi) % 1.0
        s += (s.max(axis=1, keepdims=True) - s > 0.5).astype(float)  # over the seam
        axis_to = np.hypot(X[..., 0], X[..., 1])
        pole = axis_to < 1e-9
        s = np.where(pole, np.where(pole, 0.0, s).sum(axis=1, keepdims=True) / 2.0, s)
        t = 0.5 - 0.5 * X[..., 2]
        if kind == shapes.mjGEOM_CYLINDER:
            cap = (np.abs(X[..., 2]).min(axis=1) > 1.0 - 1e-9) & (np.ptp(X[..., 2], axis=1) < 1e-9)
            s[cap], t[cap] = 0.5 + 0.5 * X[cap][..., 0], 0.5 + 0.5 * X[cap][..., 1]
        elif kind == shapes.mjGEOM_CAPSULE:
            above = np.arccos(np.clip(axis_to, 0.0, 1.0)) / (0.5 * np.pi)  # 0 at the rim of a cap, 1 at its pole
            top, bottom = middle[:, 2] > 1.0, middle[:, 2] < -1.0
            t[top], t[bottom] = 1.0 - above[top], above[bottom]
        else:
            t = np.arccos(np.clip(X[..., 2], -1.0, 1.0)) / np.pi
    scale = np.array(texture.repeat) * (size[:2] if texture.uniform else 1.0)
    return np.stack([s, t], axis=2).reshape(-1, 2) * scale, faces.reshape(-1)


def cube_coordinates(directions: Array, faces: NDArray[np.intp]) -> tuple[Array, NDArray[np.intp]]:
    """Unfold a cube texture: (s, t) (3 m, 2) in the image of six sides, and the vertex of each corner (3 m,).

    `directions` (n, 3) are those of the vertices from the middle of the cube, `faces` (m, 3) the triangles.
    """
    corners = directions[faces]  # (m, 3, 3)
    middle = corners.mean(axis=1)
    axis = np.abs(middle).argmax(axis=1)
    side = 2 * axis + (np.take_along_axis(middle, axis[:, None], axis=1)[:, 0] < 0.0)
    _, s_axis, s_sign, t_axis, t_sign = np.array(_SIDES)[side].T
    rows = np.arange(len(faces))[:, None], np.arange(3)[None, :]
    major = np.maximum(np.abs(corners[*rows, axis[:, None]]), 1e-9)
    s = s_sign[:, None] * corners[*rows, s_axis[:, None]] / major
    t = t_sign[:, None] * corners[*rows, t_axis[:, None]] / major
    inside = np.clip(0.5 * (1.0 + np.stack([s, t], axis=2)), 0.002, 0.998)  # not into the side next to it
    inside[..., 1] = (inside[..., 1] + side[:, None]) / 6.0
    return inside.reshape(-1, 2), faces.reshape(-1)


def colors_at(model: Any, texture: int, coordinates: Array) -> Array:
    """Colours in [0, 1] of the pixels at (s, t) (n, 2). Shape (n, 3)."""
    pixels = image(model, texture)
    wrapped = coordinates - np.floor(coordinates)
    column = np.minimum((wrapped[:, 0] * pixels.shape[1]).astype(int), pixels.shape[1] - 1)
    row = np.minimum((wrapped[:, 1] * pixels.shape[0]).astype(int), pixels.shape[0] - 1)
    return pixels[row, column] / 255.0


def glb(
    vertices: Array,
    faces: NDArray[np.intp],
    normals: Array,
    coordinates: Array,
    pixels: NDArray[np.uint8],
    rgba: tuple[float, ...],
    shininess: float,
) -> bytes:
    """A surface with an image on it as binary glTF.

    Viser's page computes normals anew from the faces about each vertex: corners that agree in place, in normal and in
    (s, t) share one, and no others do.
    """
    import trimesh
    from PIL import Image

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=_compact(Image.fromarray(pixels)),
        baseColorFactor=[*linear(np.array(rgba[:3])), rgba[3]],
        metallicFactor=0.0,
        roughnessFactor=_ROUGHEST + (_SMOOTHEST - _ROUGHEST) * float(np.clip(shininess, 0.0, 1.0)),
        alphaMode="BLEND" if rgba[3] < 1.0 else "OPAQUE",
    )
    corners = np.hstack([vertices, normals, coordinates]).round(6)
    _, first, index = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    visual = trimesh.visual.TextureVisuals(uv=coordinates[first] * [1.0, -1.0] + [0.0, 1.0], material=material)
    mesh = trimesh.Trimesh(vertices[first], index.reshape(-1)[faces], visual=visual, process=False)
    with io.BytesIO() as stream:
        mesh.export(stream, file_type="glb", include_normals=False)
        return stream.getvalue()


def linear(rgb: Array) -> Array:
    """Colours as linear light, which is how glTF and Viser's batched meshes count them."""
    return np.asarray(np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4))


def _compact(picture: Any) -> Any:
    """With a palette where few colours make it, which is a fraction of the bytes."""
    return picture.quantize(256) if picture.getcolors(256) is not None else picture


def _index(model: Any, material: int) -> int:
    return -1 if material < 0 else int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])


def _pixels(model: Any, texture: int) -> NDArray[np.uint8]:
    """Colours row by row. Shape (height width, 3)."""
    channels = int(model.tex_nchannel[texture])
    size = int(model.tex_width[texture]) * int(model.tex_height[texture]) * channels
    start = int(model.tex_adr[texture])
    pixels = np.asarray(model.tex_data[start : start + size]).reshape(-1, channels)
    return pixels[:, :3] if channels >= 3 else np.repeat(pixels[:, :1], 3, axis=1)
