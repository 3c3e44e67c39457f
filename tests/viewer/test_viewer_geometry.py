"""Triangles and poses against MuJoCo's own extents and kinematics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjslq.reports.units import model_from_mjb
from mjslq.result import Result
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.viewer import camera, geometry, motion

SHAPES = {
    "sphere": ('type="sphere" size=".3"', 4 / 3 * np.pi * 0.3**3),
    "capsule": ('type="capsule" size=".2 .5"', np.pi * 0.2**2 * (1.0 + 4 / 3 * 0.2)),
    "ellipsoid": ('type="ellipsoid" size=".1 .2 .4"', 4 / 3 * np.pi * 0.1 * 0.2 * 0.4),
    "cylinder": ('type="cylinder" size=".2 .5"', np.pi * 0.2**2),
    "box": ('type="box" size=".1 .2 .4"', 8 * 0.1 * 0.2 * 0.4),
    "mesh": ('type="mesh" mesh="wedge"', 0.5),
}
WEDGE = '<asset><mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1  1 0 1  0 1 1"/></asset>'


def model_of(geom: str, asset: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f"<mujoco>{asset}<worldbody><body><freejoint/><geom {geom}/></body></worldbody></mujoco>"
    )


@pytest.mark.parametrize("name", SHAPES)
def test_shape_has_the_extent_and_the_volume_of_its_geom(name: str) -> None:
    text, volume = SHAPES[name]
    model = model_of(text, WEDGE if name == "mesh" else "")
    vertices, faces = geometry.geom_mesh(model, 0)
    centre, half = model.geom_aabb[0, :3], model.geom_aabb[0, 3:]
    np.testing.assert_allclose(vertices.min(axis=0), centre - half, atol=1e-6)
    np.testing.assert_allclose(vertices.max(axis=0), centre + half, atol=1e-6)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    enclosed = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0  # positive only if faces look outward
    assert enclosed == pytest.approx(volume, rel=0.03)
    assert set(faces.ravel()) == set(range(len(vertices)))


def test_height_field_reaches_its_heights() -> None:
    asset = (
        '<asset><hfield name="hill" nrow="3" ncol="4" size="2 1 .5 .1" elevation="0 0 0 0 0 1 1 0 0 0 0 0"/></asset>'
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco>{asset}<worldbody><geom type="hfield" hfield="hill"/></worldbody></mujoco>'
    )
    vertices, faces = geometry.geom_mesh(model, 0)
    np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], [[-2, -1, -0.1], [2, 1, 0.5]])
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    surface = np.abs(normals[:, 2]) > 1e-12
    assert surface.sum() == 2 * 2 * 3 and (normals[surface, 2] > 0).all()
    outward = np.einsum("ij,ij->i", normals, vertices[faces[:, 0]] - [0.0, 0.0, -0.1])
    assert (outward[~surface] > 0).all()  # of the sides, from its middle


def test_pieces_stand_where_mujoco_puts_their_geoms() -> None:
    xml = """<mujoco><worldbody><body pos="1 2 3" euler="10 20 30"><joint axis="1 1 0"/>
      <geom type="box" size=".1 .2 .3" pos=".5 0 .1" euler="0 40 0"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[0] = 0.7
    mujoco.mj_forward(model, data)
    (piece,) = geometry.pieces(model)
    world = piece.vertices @ data.xmat[1].reshape(3, 3).T + data.xpos[1]
    local = (world - data.geom_xpos[0]) @ data.geom_xmat[0].reshape(3, 3)
    np.testing.assert_allclose(np.abs(local), np.tile([0.1, 0.2, 0.3], (24, 1)), atol=1e-12)


def test_colours_groups_and_materials() -> None:
    xml = """<mujoco><asset><material name="red" rgba="1 0 0 .5"/></asset><worldbody>
      <geom type="plane" size="2 3 1" rgba=".1 .2 .3 1"/>
      <body><joint/><geom size=".1" material="red"/><geom size=".1" rgba="0 1 0 1"/><geom size=".1"/>
        <geom size=".1" group="3"/><geom size=".1" rgba="1 1 1 0"/><site size=".02" rgba="0 0 1 1"/></body>
      </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    colours = {piece.rgba for piece in geometry.pieces(model)}
    assert {(1.0, 0.0, 0.0, 0.5), (0.0, 1.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)} < colours
    assert len(colours) == 4  # and the one for geoms without a colour
    (plane,) = geometry.planes(model)
    assert plane.size == (4.0, 6.0) and plane.rgb == pytest.approx((0.1, 0.2, 0.3))


def test_only_hidden_groups_are_shown_after_all() -> None:
    model = model_of('size=".1" group="3"')
    assert len(geometry.pieces(model)) == 1


def test_poses_are_those_of_mj_forward(arm: Result) -> None:
    assert arm.scene is not None
    model = model_from_mjb(arm.scene.model)
    moved = motion.motion(model, arm.scene, arm.trajectory)
    data = mujoco.MjData(model)
    for n in (0, 17, 100):
        data.qpos[:] = arm.trajectory.X[n, :2]
        mujoco.mj_forward(model, data)
        positions, wxyzs = moved.at(arm.trajectory.times[n])
        np.testing.assert_allclose(positions, data.xpos, atol=1e-9)
        np.testing.assert_allclose(np.abs(np.sum(wxyzs * data.xquat, axis=1)), 1.0, atol=1e-9)


def test_poses_between_and_beyond_knots(arm: Result) -> None:
    assert arm.scene is not None
    moved = motion.motion(model_from_mjb(arm.scene.model), arm.scene, arm.trajectory)
    positions, wxyzs = moved.at(0.01)
    np.testing.assert_allclose(positions, 0.5 * (moved.positions[0] + moved.positions[1]))
    np.testing.assert_allclose(np.linalg.norm(wxyzs, axis=1), 1.0)
    np.testing.assert_array_equal(moved.at(99.0)[0], moved.positions[-1])
    assert moved.spread(5)[0].shape == (5, 3, 3)


def test_turning_round_does_not_jump() -> None:
    model = model_of('size=".1"')
    angle = np.linspace(0.0, 4.0 * np.pi, 60)
    quaternions = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=1)
    quaternions *= np.where(np.arange(60) % 7 == 0, -1.0, 1.0)[:, None]  # either sign is the same orientation
    X = np.hstack([np.zeros((60, 3)), quaternions])
    moved = motion.motion(model, Scene(b"", tuple(range(7))), Trajectory(X, np.zeros((59, 1))))
    assert np.abs(np.diff(moved.wxyzs[:, 1], axis=0)).max() < 0.2


def test_diverged_motion_holds_its_last_finite_pose(arm: Result) -> None:
    assert arm.scene is not None
    X = arm.trajectory.X.copy()
    X[30:] = np.nan
    model = model_from_mjb(arm.scene.model)
    moved = motion.motion(model, arm.scene, Trajectory(X, arm.trajectory.U, dt=0.02, diverged_at=30))
    np.testing.assert_array_equal(moved.at(2.0)[0], moved.positions[29])
    lost = motion.motion(
        model, arm.scene, Trajectory(np.full_like(X, np.nan), arm.trajectory.U, dt=0.02, diverged_at=0)
    )
    assert np.isfinite(lost.at(1.0)[0]).all()


def test_extent_holds_every_vertex_of_the_motion(arm: Result) -> None:
    assert arm.scene is not None
    model = model_from_mjb(arm.scene.model)
    moved = motion.motion(model, arm.scene, arm.trajectory)
    pieces = geometry.pieces(model)
    boxes = np.array([[piece.vertices.min(axis=0), piece.vertices.max(axis=0)] for piece in pieces])
    low, high = motion.extent(moved, np.array([piece.body for piece in pieces]), boxes)
    data = mujoco.MjData(model)
    for x in arm.trajectory.X:
        data.qpos[:] = x[:2]
        mujoco.mj_kinematics(model, data)
        for piece in pieces:
            world = piece.vertices @ data.xmat[piece.body].reshape(3, 3).T + data.xpos[piece.body]
            assert (world >= low - 1e-9).all() and (world <= high + 1e-9).all()


@pytest.mark.parametrize("half", [(1.0, 0.1, 0.2), (0.1, 2.0, 0.1), (0.2, 0.2, 5.0), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("aspect", [0.6, 1.7])
def test_camera_sees_the_whole_box_and_fills_the_window(half: tuple[float, ...], aspect: float) -> None:
    low, high = 3.0 - np.array(half), 3.0 + np.array(half)
    view = camera.fit(low, high, aspect)
    forward = (view.look_at - view.position) / np.linalg.norm(view.look_at - view.position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    seen = corners - view.position
    tall = np.tan(camera.FIELD_OF_VIEW / 2) * (seen @ forward)
    filled = max(np.abs(seen @ right / (tall * aspect)).max(), np.abs(seen @ up / tall).max())
    assert filled == pytest.approx(0.8) if any(half) else filled < 0.8


def test_scene_that_is_no_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo keeps a log where it stands
    with pytest.raises(ValueError, match="not a model that MuJoCo"):
        model_from_mjb(b"nothing of the kind")


def test_scene_that_does_not_fit_its_model(arm: Result, compiled: Callable[[str], bytes]) -> None:
    assert arm.scene is not None
    with pytest.raises(ValueError, match="names 1 entries of the state as qpos, but its model has 2"):
        motion.motion(model_from_mjb(arm.scene.model), Scene(arm.scene.model, (0,)), arm.trajectory)
