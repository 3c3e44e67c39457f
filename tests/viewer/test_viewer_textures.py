"""Textures: where MuJoCo's renderer lays them, sampled as colours of the surface."""

from __future__ import annotations

import io
import itertools

import mujoco
import numpy as np
import pytest
import trimesh

from mjslq.viewer import geometry, textures


def checker(kind: str = "2d") -> str:
    return f'<texture name="t" type="{kind}" builtin="checker" width="16" height="16" rgb1="1 0 0" rgb2="0 0 1"/>'


def covered(geom: str, material: str = "", kind: str = "2d") -> tuple[mujoco.MjModel, geometry.Piece]:
    asset = f'<asset>{checker(kind)}<material name="m" texture="t" {material}/></asset>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco>{asset}<worldbody><body><joint/><geom material="m" {geom}/></body></worldbody></mujoco>'
    )
    (piece,) = geometry.pieces(model)
    assert piece.cover is not None
    return model, piece


def color_at(model: mujoco.MjModel, piece: geometry.Piece, point: list[float]) -> tuple[float, ...]:
    """Colour of the surface where a ray from the middle through `point` leaves it."""
    assert piece.cover is not None
    mesh = trimesh.Trimesh(piece.vertices, piece.faces, process=False)
    along = np.array(point) / np.linalg.norm(point)
    a, b, c = (piece.vertices[piece.faces[:, i]] for i in range(3))
    weights = np.linalg.solve(np.stack([a, b, c], axis=2), np.broadcast_to(along[:, None], (len(a), 3, 1)))[..., 0]
    face = int(np.flatnonzero((weights >= -1e-9).all(axis=1))[0])
    share = weights[face] / weights[face].sum()
    assert len(mesh.faces) == len(piece.faces)
    st = share @ piece.cover.coordinates[piece.faces[face]]
    return tuple(textures.colors_at(model, piece.cover.texture, st[None])[0])


RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@pytest.mark.parametrize("shape", ['type="box" size=".1 .1 .1"', 'type="sphere" size=".1"'])
def test_cube_textures_show_each_side(shape: str) -> None:
    model, piece = covered(shape, kind="cube")
    pixels = textures.image(model, piece.cover.texture)
    assert pixels.shape == (6 * 16, 16, 3)
    for axis, sign, (u, v) in itertools.product(range(3), (1, -1), ((0.4, 0.5), (-0.5, 0.4), (0.3, -0.45))):
        direction = [0.0, 0.0, 0.0]
        direction[axis], direction[(axis + 1) % 3], direction[(axis + 2) % 3] = sign, u, v
        row = {0: {1: 0, -1: 1}, 1: {1: 2, -1: 3}, 2: {1: 4, -1: 5}}[axis][sign]
        s, t = {
            0: (-direction[2], -direction[1]), 1: (direction[2], -direction[1]), 2: (direction[0], direction[2]),
            3: (direction[0], -direction[2]), 4: (direction[0], -direction[1]), 5: (-direction[0], -direction[1]),
        }[row]  # fmt: skip
        expected = pixels[16 * row + int(8 * (1 + t)), int(8 * (1 + s))] / 255.0
        assert color_at(model, piece, direction) == tuple(expected)


def test_flat_textures_lie_as_mujoco_lays_them() -> None:
    model, box = covered('type="box" size=".1 .2 .3"')
    image = textures.image(model, box.cover.texture)
    assert tuple(image[0, 0] / 255.0) == RED
    assert color_at(model, box, [-0.05, 0.1, 0.3]) == RED  # of the top, the first row of the image is at +y
    assert color_at(model, box, [0.05, 0.1, 0.3]) == BLUE
    assert color_at(model, box, [-0.05, -0.2, 0.1]) == RED and color_at(model, box, [0.05, -0.2, 0.1]) == BLUE
    model, ball = covered('type="sphere" size=".1"')
    assert color_at(model, ball, [0.3, 0.8, 0.5]) == RED and color_at(model, ball, [0.3, 0.8, -0.5]) == BLUE
    assert color_at(model, ball, [0.3, -0.8, 0.5]) == BLUE
    model, box = covered('type="box" size=".5 .5 .5"', 'texuniform="true" texrepeat="4 4"')
    assert box.cover.coordinates.max() == pytest.approx(2.0)  # 4 of them a metre


def test_mesh_textures_and_glb() -> None:
    asset = (
        '<mesh name="q" vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 2 1 0 1 3 0 3 2 1 2 3" texcoord="0 0 1 0 0 1 1 1"/>'
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset>{checker()}<material name="m" texture="t" rgba=".5 1 1 1"/>{asset}</asset><worldbody><body>'
        '<joint/><geom type="mesh" mesh="q" material="m"/></body></worldbody></mujoco>'
    )
    (piece,) = geometry.pieces(model)
    cover = piece.cover
    assert cover is not None and cover.tint == pytest.approx((0.5, 1.0, 1.0, 1.0), abs=1e-3)
    stored = {tuple(row) for row in model.mesh_texcoord.round(6).tolist()}
    assert {tuple(row) for row in cover.coordinates.round(6).tolist()} == stored
    image = textures.image(model, cover.texture)
    data = textures.glb(piece.vertices, piece.faces, cover.normals, cover.coordinates, image, cover.tint, 0.5)
    (mesh,) = trimesh.load(io.BytesIO(data), file_type="glb").geometry.values()
    assert len(mesh.faces) == 4 and mesh.area == pytest.approx(model_area(piece), rel=1e-6)
    assert np.asarray(mesh.visual.material.baseColorTexture.convert("RGB")).tolist() == image.tolist()


def model_area(piece: geometry.Piece) -> float:
    a, b, c = (piece.vertices[piece.faces[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def test_single_colours_are_no_textures() -> None:
    texture = '<texture name="t" type="2d" builtin="flat" width="4" height="4" rgb1=".5 .5 .5"/>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset>{texture}<material name="m" texture="t" rgba="1 .5 1 1"/></asset>'
        '<worldbody><geom size=".1" material="m"/></worldbody></mujoco>'
    )
    (piece,) = geometry.pieces(model)
    assert piece.cover is None and piece.rgba == pytest.approx((0.5, 0.25, 0.5, 1.0), abs=0.01)
