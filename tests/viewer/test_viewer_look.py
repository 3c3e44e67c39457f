"""The "Look" folder: its switches, in Python and in a browser, and what a browser draws of textures and soft bodies."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from mjslq.dynamics.mujoco.drawing import drawn_scene
from mjslq.markers import markers
from mjslq.result import Result, load
from mjslq.scene import Marker, Scene
from mjslq.status import Status
from mjslq.trajectory import Trajectory
from mjslq.viewer.camera import FIELD_OF_VIEW, lens
from mjslq.viewer.motion import motion
from mjslq.viewer.player import Player

WINDOW = {"width": 760, "height": 1400}
BOX = """
<mujoco model="box"><asset><texture name="t" type="2d" builtin="checker" width="16" height="16" rgb1="1 0 0"
  rgb2="0 0 1"/><material name="t" texture="t"/></asset>
<worldbody><geom type="plane" size="0 0 1"/><camera name="side" pos="0 -3 .5" xyaxes="1 0 0 0 0 1" fovy="40"/>
<body name="box" pos="0 0 .2"><freejoint/><geom type="box" size=".2 .2 .2" material="t"/><site name="top" pos="0 0 .2"/>
<geom type="sphere" size=".3" group="3" contype="0" conaffinity="0" mass="0"/></body>
</worldbody><sensor><framepos name="top" objtype="site" objname="top"/></sensor></mujoco>
"""


def standing(xml: str = BOX, *, sunk: float = 0.002) -> Result:
    """A model that stands still for a second, its first body a little in the ground."""
    model = mujoco.MjModel.from_xml_string(xml)
    X = np.tile(np.r_[model.qpos0, np.zeros(model.nv)], (11, 1))
    X[:, 2] -= sunk
    trajectory, none = Trajectory(X, np.zeros((10, model.nu)), dt=0.1), np.zeros((10, model.nu))
    scene = drawn_scene(model, "box")
    scene = Scene(scene.model, scene.columns, "box", (), (Marker("top", (0.5, 0.0, 0.5)),))
    return Result(
        Status.CONVERGED, Status.CONVERGED.message, 1.0, 0, 0.0, trajectory, None, none, none, problem="box",
        method="slq", scene=scene,
    )  # fmt: skip


def drawn(client: Any, wanted: Callable[[np.ndarray], bool]) -> np.ndarray:
    """The first picture of a client that is as wanted. Shape (150, 150, 3)."""
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        picture = client.get_render(height=150, width=150, timeout=60.0)[..., :3].astype(int)
        if wanted(picture):
            return np.asarray(picture)
    raise AssertionError("the client never drew what was expected")


def red(picture: np.ndarray) -> int:
    return int(((picture[..., 0] > 120) & (picture[..., 1] < 60) & (picture[..., 2] < 60)).sum())


def blue(picture: np.ndarray) -> int:
    return int(((picture[..., 2] > 100) & (picture[..., 0] < 60) & (picture[..., 1] < 60)).sum())


def test_markers_are_saved_and_read(tmp_path: Any) -> None:
    result = standing()
    result.save(tmp_path / "box.npz")
    scene = load(tmp_path / "box.npz").scene
    assert scene is not None and scene.markers == (Marker("top", (0.5, 0.0, 0.5)),)


def test_files_without_markers_are_read(tmp_path: Any) -> None:
    """Those of versions before them."""
    standing().save(tmp_path / "box.npz")
    with np.load(tmp_path / "box.npz") as data:
        arrays = dict(data)
    header = json.loads(str(arrays["header"]))
    del header["scene_markers"]
    np.savez(tmp_path / "old.npz", **arrays | {"header": np.array(json.dumps(header))})
    scene = load(tmp_path / "old.npz").scene
    assert scene is not None and scene.markers == ()


def test_targets_are_those_of_sensors_that_read_a_place() -> None:
    import mjslq

    arm = mjslq.MujocoDynamics.from_xml(
        """<mujoco><worldbody><body><joint name="j" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/><site name="s"/></body>
        </worldbody><actuator><motor joint="j"/></actuator><sensor><framepos name="p" objtype="site" objname="s"/>
        <jointpos name="q" joint="j"/></sensor></mujoco>"""
    )
    costs = [
        mjslq.costs.Sensor("p", [1.0, 2.0, 3.0]),
        mjslq.costs.Sensor("p", [1.0, 2.0, 3.0], when="terminal"),
        mjslq.costs.Sensor("q", 0.5),
        mjslq.costs.Control(1.0),
    ]
    assert markers(costs, arm) == (Marker("p", (1.0, 2.0, 3.0)),)
    scene = mjslq.Problem(arm, 5, np.zeros(2), costs).scene()
    assert scene is not None and scene.markers == (Marker("p", (1.0, 2.0, 3.0)),)


def test_cameras_of_the_model_are_looked_through() -> None:
    result = standing()
    with Player(result, autoplay=False) as player:
        view = player._views[0].stage
        assert view is not None and view.cameras.names == ["side"]
        seen = lens(view.model, motion(view.model, result.scene, result.trajectory).frame(0.0), 0)
        np.testing.assert_allclose(seen.position, [0, -3, 0.5])
        np.testing.assert_allclose(seen.forward, [0, 1, 0], atol=1e-12)
        np.testing.assert_allclose(seen.up, [0, 0, 1], atol=1e-12)
        assert seen.field_of_view == pytest.approx(np.deg2rad(40.0)) and FIELD_OF_VIEW < 1.0
        view.use_camera("side")
        with pytest.raises(ValueError, match="unknown camera 'top'; there are: side"):
            view.use_camera("top")


def test_switches_of_the_folder_in_a_browser(browser: Any) -> None:
    with Player(standing(), autoplay=False) as player:
        view, clients = player._views[0].stage, []
        assert view is not None
        player.server.on_client_connect(clients.append)
        page = browser.new_page(viewport=WINDOW)
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(player.url)
        page.get_by_text("Look", exact=True).wait_for()
        light = drawn(clients[0], lambda picture: red(picture) > 100 and blue(picture) > 100)  # the texture
        page.get_by_role("checkbox", name="Contact forces").click()
        page.get_by_text("An arrow of").wait_for()
        assert view.layers["contacts"].visible
        page.get_by_role("checkbox", name="Dark").click()
        dark = drawn(clients[0], lambda picture: picture.mean() < 0.7 * light.mean())
        assert view.dark and red(dark) > 50
        page.get_by_role("button", name="Frame the motion").click()
        page.get_by_text("More", exact=True).click()
        page.get_by_role("checkbox", name="Group 3 (collision)").click()
        until = time.monotonic() + 20.0
        while 3 not in view.bodies.groups and time.monotonic() < until:
            time.sleep(0.05)
        assert 3 in view.bodies.groups
        drawn(clients[0], lambda picture: red(picture) + blue(picture) < 0.5 * (red(dark) + blue(dark)))  # in the ball
        page.close()
    assert not errors
