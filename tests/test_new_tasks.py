"""What `mjslq new` suggests for robots that it has never seen: an end that moves, a goal of that same end."""

import numpy as np
import pytest

from mjslq.tasks import load_task
from mjslq.tasks.writing import text_for

PLANAR = """
<mujoco model="planar"><worldbody><body name="torso" pos="0 0 1">
  <joint name="rootx" type="slide" axis="1 0 0"/><joint name="rootz" type="slide" axis="0 0 1"/>
  <geom type="capsule" size=".05" fromto="0 0 0 0 0 .4"/>
  <body name="leg"><joint name="hip" axis="0 1 0" range="-150 0"/>
    <geom type="capsule" size=".05" fromto="0 0 0 0 0 -.4"/></body></body></worldbody>
<actuator><motor joint="hip"/></actuator></mujoco>
"""


@pytest.mark.parametrize("robot, end", [("go2", "FL_foot"), ("anymal_c", "LF_FOOT"), ("ur5", "ee_link")])
def test_a_robot_reaches_with_an_end_that_moves(robot, end, tmp_path):
    (tmp_path / "robot.toml").write_text(text_for(robot, tmp_path))
    task = load_task(tmp_path / "robot.toml")
    (reach,) = [cost for cost in task.problem.costs if getattr(cost, "name", "") == f"{end}.position"]
    columns = task.problem.dynamics.outputs[f"{end}.position"].columns
    now = task.problem.dynamics.step(task.problem.x0, np.zeros(task.problem.dynamics.nu))[1][columns]
    assert 0.05 < np.linalg.norm(now - reach.target) < 0.8
    result = task.solve()
    assert result.success and np.linalg.norm(result.trajectory.Y[-1, columns] - reach.target) < 0.02


def test_a_base_that_nothing_drives_holds_its_pose(tmp_path):
    (tmp_path / "planar.xml").write_text(PLANAR)
    text = text_for("planar.xml", tmp_path)
    assert "hold the start" in text and 'kind = "frame"' not in text
    assert "# positions = {" in text  # and none that moves the leg away from where it stands
    driven = PLANAR.replace("<actuator>", '<actuator><motor joint="rootx"/><motor joint="rootz"/>')
    (tmp_path / "driven.xml").write_text(driven)
    assert 'name = "leg"' in text_for("driven.xml", tmp_path)


def test_contacts_of_a_task_are_those_it_asks_for(tmp_path):
    (tmp_path / "planar.xml").write_text(PLANAR)
    text = text_for("planar.xml", tmp_path).replace("[engine]", '[engine]\ncontact = "smooth"\nforesight = 0.05')
    (tmp_path / "planar.toml").write_text(text)
    dynamics = load_task(tmp_path / "planar.toml").problem.dynamics
    assert dynamics.contact.kind == "smooth" and dynamics.foresight == 0.05
    (tmp_path / "planar.toml").write_text(text.replace('"smooth"', '"soft"'))
    with pytest.raises(ValueError, match="contact"):
        load_task(tmp_path / "planar.toml")
