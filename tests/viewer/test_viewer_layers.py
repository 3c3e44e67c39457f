"""What the layers of a scene draw, against MuJoCo's own numbers."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest
import viser

from mjslq.contact import Contact
from mjslq.dynamics.mujoco.contacts import contact_forces
from mjslq.dynamics.mujoco.drawing import drawn_scene
from mjslq.scene import Marker, Scene
from mjslq.trajectory import Trajectory
from mjslq.viewer.batches import place
from mjslq.viewer.details import between, details
from mjslq.viewer.layers import flexes
from mjslq.viewer.layers.layer import turn_z_to
from mjslq.viewer.layers.marks import center_of_mass, product
from mjslq.viewer.motion import motion, rotated
from mjslq.viewer.scene import SceneView, quiet

ROPE = """
<mujoco><worldbody>
  <geom type="plane" size="0 0 1"/>
  <geom name="wheel" type="cylinder" size=".1 .05" pos="0 0 1" zaxis="0 1 0"/>
  <site name="above" pos="0 0 1.2"/>
  <camera name="fixed" pos="2 0 1" xyaxes="0 1 0 0 0 1"/>
  <body name="arm" pos="-.3 0 .5"><joint name="lever" axis="0 1 0"/>
    <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/><site name="tip" pos=".3 0 0" euler="0 30 0"/></body>
  <body name="load" pos=".4 0 .6"><joint type="slide" axis="0 0 1"/><geom type="box" size=".05 .05 .05"/>
    <site name="hook"/><camera name="riding" mode="track" pos="0 -1 0" xyaxes="1 0 0 0 0 1"/></body>
</worldbody>
<tendon><spatial width=".01" rgba="1 0 0 1"><site site="tip"/><geom geom="wheel" sidesite="above"/><site site="hook"/>
  <pulley divisor="2"/><site site="hook"/><site site="above"/></spatial></tendon></mujoco>
"""
CLOTH = """
<mujoco><asset><texture name="c" type="2d" builtin="checker" width="40" height="40" rgb1="1 0 0" rgb2="0 0 1"/>
<material name="c" texture="c"/></asset>
<worldbody><geom type="plane" size="1 1 .1"/><body name="sheet" pos="0 0 .4">
  <flexcomp type="grid" count="4 3 1" spacing=".1 .1 .1" name="cloth" dim="2" radius=".01" mass="1" material="c">
  <edge equality="true"/></flexcomp></body>
  <body name="jelly" pos="1 0 .4"><flexcomp type="grid" count="3 3 3" spacing=".1 .1 .1" name="jelly" dim="3"
    radius=".01" mass="1" rgba="0 1 0 1"><edge equality="true"/></flexcomp></body>
</worldbody></mujoco>
"""
BALL = """
<mujoco><option timestep="0.005"/><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
<body name="ball" pos="0 0 .1"><freejoint/><geom size=".1" mass="2"/></body>
<body name="post" pos="1 0 .5"><joint name="post" type="slide" axis="0 0 1"/><geom type="box"
  size=".1 .1 .1" group="3"/></body>
</worldbody><actuator><motor joint="post"/></actuator></mujoco>
"""


def swung(xml: str, steps: int = 6, seed: int = 0) -> tuple[mujoco.MjModel, Scene, Trajectory]:
    """A model at random states near its own."""
    model = mujoco.MjModel.from_xml_string(xml)
    rng, X = np.random.default_rng(seed), np.empty((steps + 1, model.nq + model.nv))
    for x in X:
        x[: model.nq] = model.qpos0
        mujoco.mj_integratePos(model, x[: model.nq], rng.normal(size=model.nv), 0.05)
        x[model.nq :] = 0.1 * rng.normal(size=model.nv)
    return model, drawn_scene(model, "model"), Trajectory(X, rng.normal(size=(steps, model.nu)), dt=0.02)


def at_knots(model: mujoco.MjModel, trajectory: Trajectory) -> Iterator[tuple[int, mujoco.MjData]]:
    data = mujoco.MjData(model)
    for n, x in enumerate(trajectory.X):
        data.qpos[:] = x[: model.nq]
        mujoco.mj_forward(model, data)
        yield n, data


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    with quiet():
        server = viser.ViserServer("127.0.0.1", 8400, verbose=False)
    yield server
    with quiet():
        server.stop()


def test_tendons_axes_and_cameras_are_mujocos() -> None:
    model, scene, trajectory = swung(ROPE)
    moved = motion(model, scene, trajectory)
    found = details(model, moved)
    wrapped = set()
    for n, data in at_knots(model, trajectory):
        lengths = np.linalg.norm(found.segments[0][n, :, 1] - found.segments[0][n, :, 0], axis=1)
        on_wheel = found.wrapped[0][n]
        wrapped.add(bool(on_wheel.any()))
        before, chord = lengths[:-1], lengths[on_wheel]
        arc = 2 * 0.1 * np.arcsin(chord / 0.2)  # of the wheel, which MuJoCo's length counts
        length = before.sum() - chord.sum() + arc.sum() + lengths[len(before) :].sum() / 2
        assert length == pytest.approx(data.ten_length[0], abs=1e-9)
        np.testing.assert_allclose(found.segments[0][n, 0, 0], data.site("tip").xpos)
        np.testing.assert_allclose(found.anchors[n], data.xanchor)
        np.testing.assert_allclose(found.axes[n], data.xaxis)
        np.testing.assert_allclose(found.camera_positions[n], data.cam_xpos)
        np.testing.assert_allclose(found.camera_rotations[n].reshape(-1, 9), data.cam_xmat)
    assert True in wrapped  # the path lies on the wheel somewhere
    frame = moved.frame(0.03)
    pieces = between(frame, found.segments[0], found.wrapped[0])
    assert pieces.shape == found.segments[0].shape[1:] and np.isfinite(pieces).all()


def test_soft_bodies_are_where_mujoco_has_their_vertices() -> None:
    model, scene, trajectory = swung(CLOTH)
    moved = motion(model, scene, trajectory)
    found = details(model, moved)
    for n, data in at_knots(model, trajectory):
        np.testing.assert_allclose(found.vertices[n], data.flexvert_xpos)
    frame = moved.frame(trajectory.times[3])
    cloth, jelly = flexes._Sheet(model, 0), flexes._Sheet(model, 1)
    vertices = cloth.at(frame)
    np.testing.assert_allclose(0.5 * (vertices[:12] + vertices[12:]), found.vertices[3, :12])
    np.testing.assert_allclose(np.linalg.norm(vertices[:12] - vertices[12:], axis=1), 0.02)
    for surface in (cloth, jelly):
        edges = surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        there, back = ({tuple(e) for e in edges.tolist()}, {tuple(e) for e in edges[:, ::-1].tolist()})
        assert there == back and len(there) == len(edges)  # closed, and all faces turned the same way
    colors = {tuple(np.round(rgba[:3], 2)) for rgba, _ in cloth.classes}
    assert colors == {(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)}
    assert sum(len(rows) for _, rows in cloth.classes) == len(cloth.faces)


def test_skins_are_mujocos() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="a"><freejoint/><geom size=".1"/></body>
        <body name="b" pos=".5 0 0"><freejoint/><geom size=".1"/></body></worldbody><deformable>
        <skin vertex="0 0 0 .2 0 0 .2 .2 0 .4 0 .1" face="0 1 2 1 3 2">
        <bone body="a" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1 2" vertweight="1 .5 .6"/>
        <bone body="b" bindpos=".5 0 0" bindquat=".8 .6 0 0" vertid="1 2 3" vertweight=".5 .4 1"/></skin>
        </deformable></mujoco>"""
    )
    X = np.zeros((1, model.nq + model.nv))
    X[0, : model.nq] = model.qpos0
    mujoco.mj_integratePos(model, X[0, : model.nq], np.random.default_rng(0).normal(size=model.nv), 0.5)
    data = mujoco.MjData(model)
    data.qpos[:] = X[0, : model.nq]
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, 10)
    mujoco.mjv_updateSkin(model, data, scene)
    frame = motion(model, drawn_scene(model, "skin"), Trajectory(X, np.zeros((0, 0)), dt=np.zeros(0))).frame(0.0)
    np.testing.assert_allclose(flexes._Skin(model, 0).at(frame), np.reshape(scene.skinvert, (-1, 3))[:4], atol=1e-6)


@pytest.mark.parametrize("contact", [None, Contact("stiff")])
def test_contact_forces_are_mj_contact_force(contact: Contact | None) -> None:
    from mjslq.dynamics.mujoco.contacts import with_contact

    model = mujoco.MjModel.from_xml_string(BALL)
    model = model if contact is None else with_contact(model, contact)
    X = np.zeros((3, model.nq + model.nv))
    X[:, : model.nq] = model.qpos0
    X[:, 2], X[:, 7] = (0.099, 0.095, 0.5), (0.0, -0.401, 0.0)
    found = contact_forces(model, X, np.zeros((3, 1)))
    assert found.count.tolist() == [1, 5, 0] and found.positions.shape == (3, 5, 3)
    data, wrench = mujoco.MjData(model), np.zeros(6)
    for n, x in enumerate(X):
        data.qpos[:], data.qvel[:] = x[: model.nq], 0.0
        mujoco.mj_forward(model, data)
        for i in range(data.ncon):
            mujoco.mj_contactForce(model, data, i, wrench)
            axes = data.contact[i].frame.reshape(3, 3)
            np.testing.assert_allclose(found.forces[n, i], axes.T @ wrench[:3], atol=1e-9)
            np.testing.assert_allclose(found.positions[n, i], data.contact[i].pos)
            assert found.geoms[n, i].tolist() == data.contact[i].geom.tolist()
        np.testing.assert_array_equal(found.forces[n, data.ncon :], 0.0)
    assert found.forces[0, 0, 2] > 1.0  # the floor pushes the ball up


def test_centres_of_mass_and_quaternions() -> None:
    model, scene, trajectory = swung(ROPE)
    moved = motion(model, scene, trajectory)
    shares = np.array([model.body_mass / model.body_mass.sum()])
    data = mujoco.MjData(model)
    data.qpos[:] = trajectory.X[2, : model.nq]
    mujoco.mj_forward(model, data)
    frame = moved.frame(trajectory.times[2])
    np.testing.assert_allclose(center_of_mass(model, frame, shares)[0], data.subtree_com[0])
    turns = product(frame.wxyzs[model.site_bodyid], model.site_quat)
    axes = np.stack([rotated(turns, np.tile(e, (model.nsite, 1))) for e in np.eye(3)], axis=2)
    np.testing.assert_allclose(axes.reshape(-1, 9), data.site_xmat, atol=1e-12)
    ways = np.array([[0, 0, 2.0], [0, 0, -3.0], [1, 2, 3.0], [0, 0, 0]])
    for way, turned in zip(ways[:3], rotated(turn_z_to(ways), np.tile([0, 0, 1.0], (4, 1))), strict=False):
        np.testing.assert_allclose(turned, way / np.linalg.norm(way), atol=1e-12)


def count_messages(server: viser.ViserServer, act: Any) -> int:
    """How many messages to browsers something makes."""
    from viser.infra._async_message_buffer import AsyncMessageBuffer  # the tests may look inside

    sent = []
    push = AsyncMessageBuffer.push
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(AsyncMessageBuffer, "push", lambda self, message: (sent.append(message), push(self, message)))
        act()
    return len(sent)


def test_a_frame_is_one_message_for_each_body_that_moves(server: viser.ViserServer) -> None:
    bodies = "".join(f'<body pos="{i} 0 0"><freejoint/><geom size=".1"/></body>' for i in range(20))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    X = np.tile(np.r_[model.qpos0, np.zeros(model.nv)], (3, 1))
    X[1, : 7 * 5] += np.tile([0.1, 0, 0, 0, 0.1, 0, 0], 5)  # five of them
    view = SceneView(server, drawn_scene(model, "many"), Trajectory(X, np.zeros((2, 0)), dt=0.1))
    view.set_trace(False)
    assert count_messages(server, lambda: view.show(0.05)) == 5
    assert count_messages(server, lambda: view.show(0.05)) == 0


def test_layers_come_and_go(server: viser.ViserServer) -> None:
    model, scene, trajectory = swung(BALL)
    X = trajectory.X.copy()
    X[:, :7], X[:, 2] = model.qpos0[:7], 0.098
    trajectory = Trajectory(X, trajectory.U, dt=0.02)
    scene = Scene(scene.model, scene.columns, "ball", (), (Marker("ball", (0.0, 0.0, 0.5)), Marker("b", (0, 0, 0))))
    view = SceneView(server, scene, trajectory)
    assert view.layers.keys() >= {"traces", "contacts", "targets", "masses", "joints", "frames"}
    assert server.scene.get_handle_by_name("/targets/1/0.03") is None  # where the floor's middle is already
    for name, layer in view.layers.items():
        before = layer.visible
        for visible in (True, False, before):
            layer.visible = visible
            assert layer.visible == visible, name
    contacts = view.layers["contacts"]
    assert contacts.note == ""
    contacts.visible = True
    arrows: Any = server.scene.get_handle_by_name("/contacts/forces")
    assert arrows.points.shape == (1, 2, 3)
    assert arrows.points[0, 1, 2] > arrows.points[0, 0, 2] and " N" in contacts.note
    for dark in (True, False):
        view.set_dark(dark)
        assert view.dark == dark and contacts.visible
    assert server.scene.get_handle_by_name("/bodies/post/1") is None
    view.show_group(3, True)
    post = [h for h in (server.scene.get_handle_by_name(f"/bodies/post/{n}") for n in range(4)) if h is not None]
    assert len(post) == 1 and post[0].visible
    view.show_group(3, False)
    assert not post[0].visible


def test_paths_of_chosen_points(server: viser.ViserServer) -> None:
    model, scene, trajectory = swung(ROPE)
    view = SceneView(server, scene, trajectory)
    traces = view.traces
    assert set(traces.chosen) == {"arm", "load"} and {"tip", "hook"} < set(traces.points)
    with pytest.raises(ValueError, match="unknown body or site 'nobody'; there are: arm"):
        traces.choose("nobody")
    traces.choose("tip")
    positions = traces.points["tip"].path(view.motion(trajectory))
    for n, data in at_knots(model, trajectory):
        np.testing.assert_allclose(positions[n], data.site("tip").xpos, atol=1e-12)
    for at in (0.0, 0.05, 0.12, 0.03):  # back as well
        view.show(at)
        drawn = [server.scene.get_handle_by_name(f"/traces/tip {part}") for part in ("behind", "ahead", *range(6))]
        lines = [handle.points for handle in drawn if isinstance(handle, viser.LineSegmentsHandle) and handle.visible]
        length = sum(np.linalg.norm(line[:, 1] - line[:, 0], axis=1).sum() for line in lines)
        whole = np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()
        assert (
            length == pytest.approx(whole, rel=0.35) and length > 0.999 * whole
        )  # each stretch once, or a little more


def test_camera_follows_by_moving_the_scene(server: viser.ViserServer) -> None:
    _, scene, trajectory = swung(BALL)
    X = trajectory.X.copy()
    X[:, 0] = np.linspace(0.0, 5.0, len(X))
    view = SceneView(server, scene, Trajectory(X, trajectory.U, dt=0.02))
    view.track("ball")
    view.show(0.0)
    start = view._frame.positions[1].copy()
    view.show(0.12)  # far off at once: it jumps
    bodies = server.scene.get_handle_by_name("/bodies")
    np.testing.assert_allclose(bodies.position + view._frame.positions[1], start, atol=1e-9)
    view.frame()
    view.track(None)
    np.testing.assert_array_equal(server.scene.get_handle_by_name("/bodies").position, 0.0)
    with pytest.raises(ValueError, match="unknown body 'nobody'; there are: ball"):
        view.track("nobody")


@pytest.mark.slow
def test_poses_in_one_message_cost_less_than_in_two(server: viser.ViserServer) -> None:
    """By CPU time, in one process; what a whole page costs, `demos/viewer_cost.py` measures."""
    bodies = "".join(f'<body pos="{i} 0 0"><freejoint/><geom size=".1"/></body>' for i in range(50))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    X = np.tile(np.r_[model.qpos0, np.zeros(model.nv)], (1, 1))
    view = SceneView(server, drawn_scene(model, "many"), Trajectory(X, np.zeros((0, 0)), dt=np.zeros(0)))
    handles = [server.scene.get_handle_by_name(f"/bodies/body {i + 1}/{i}") for i in range(50)]
    poses = np.random.default_rng(0).normal(size=(2, 50, 1, 7))

    def two(k: int) -> None:
        for handle, pose in zip(handles, poses[k % 2], strict=True):
            handle.batched_positions, handle.batched_wxyzs = pose[:, :3], pose[:, 3:]

    def one(k: int) -> None:
        for handle, pose in zip(handles, poses[k % 2], strict=True):
            place(handle, pose[:, :3], pose[:, 3:])

    seconds = {}
    for act in (two, one) * 2:  # the first round warms up
        start = time.process_time()
        for k in range(200):
            with server.atomic():
                act(k)
        seconds[act] = time.process_time() - start
    assert seconds[one] < 0.8 * seconds[two]
    assert view.model.nbody == 51
