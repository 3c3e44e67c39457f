"""The viewer of models: sliders, keyframes and what touches, without and with a browser."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from test_viewer_browser import WINDOW, orange, rendered

from mjslq import MujocoDynamics, cli
from mjslq.viewer import model_view
from mjslq.viewer.model_view import ModelView

MODEL = """
<mujoco model="reacher">
  <compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="upper" pos="0 0 .6">
      <joint name="shoulder" axis="0 1 0" range="-2 1.5" limited="true"/>
      <geom type="capsule" size=".05" fromto="0 0 0 .4 0 0" rgba=".9 .3 .1 1"/>
      <body name="lower" pos=".4 0 0">
        <joint name="elbow" axis="0 1 0"/><geom name="tip" type="capsule" size=".04" fromto="0 0 0 .3 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/></actuator>
  <keyframe><key name="bent" qpos="-.5 .7"/></keyframe>
</mujoco>
"""


def test_sliders_have_the_joints_ranges_and_move_with_the_pose() -> None:
    dynamics = MujocoDynamics.from_xml(MODEL)
    with ModelView(dynamics) as view:
        shoulder, elbow = view.sliders["shoulder"], view.sliders["elbow"]
        assert (shoulder.min, shoulder.max) == (-2.0, 1.5)
        assert (elbow.min, elbow.max) == pytest.approx((-np.pi, np.pi))
        view.show(dynamics.keyframe("bent"))
        assert (shoulder.value, elbow.value) == (-0.5, 0.7)
        assert view.positions == '{ "shoulder" = -0.5, "elbow" = 0.7 }'
        view.move("elbow", 0.2)
        assert view.x[1] == elbow.value == 0.2
        with pytest.raises(ValueError, match="unknown joint with one axis 'elbw'; there are: shoulder, elbow"):
            view.move("elbw", 0.2)
    with pytest.raises(RuntimeError, match="not running"):
        _ = view.url


def test_what_touches_is_mujocos() -> None:
    dynamics = MujocoDynamics.from_xml(MODEL)
    with ModelView(dynamics) as view:
        assert view.touching == []
        view.move("shoulder", 1.4)
        data = mujoco.MjData(dynamics.model)
        data.qpos[:] = view.x[:2]
        mujoco.mj_forward(dynamics.model, data)
        depth = -1e3 * min(contact.dist for contact in data.contact[: data.ncon])
        assert depth > 0.0 and view.touching[0] == f"floor and tip, {depth:.1f} mm"


def test_the_robot_is_drawn_and_moves_in_a_browser(browser: Any) -> None:
    with ModelView(MujocoDynamics.from_xml(MODEL)) as view:
        page = browser.new_page(viewport=WINDOW)
        page.goto(view.url)
        page.get_by_text("Nothing touches.").wait_for(timeout=60_000)
        client = next(iter(view.server.get_clients().values()))
        before = rendered(client, lambda picture: orange(picture) > 100)
        view.move("shoulder", -1.5)
        rendered(client, lambda picture: int((np.abs(picture - before).max(axis=2) > 40).sum()) > 100)
        page.close()


def test_robots_are_viewed_and_checked_by_name(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    shown: list[Any] = []
    monkeypatch.setattr(model_view, "view_model", lambda dynamics, host, port, **_: shown.append(dynamics))
    cli.app(["view", "go2"], standalone_mode=False)
    assert shown[0].name == "go2" and shown[0].nu == 12
    assert cli.app(["check", "two_dofs", "--steps", "2"], standalone_mode=False) == 0
    assert "the Jacobians agree" in capsys.readouterr().out
