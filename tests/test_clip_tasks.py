"""Clips in task files: the problem that one would write in Python, and what is said of wrong ones."""

import numpy as np
import pytest

import mjslq
from mjslq import costs

ARM = """
<mujoco model="arm">
  <option timestep="0.01"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1"/>
      <body name="lower" pos="0.5 0 0"><joint name="elbow" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="0.5"/><site name="tip" pos="0.4 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="m0" joint="shoulder"/><motor name="m1" joint="elbow"/></actuator>
</mujoco>
"""
TASK = """
model = "arm.xml"
horizon = 20

[engine]
substeps = 2

[start]
clip = "wave.csv"
controls = "clip"

[[costs]]
kind = "control"
weight = 1e-4

[[costs]]
kind = "clip"
file = "wave.csv"
names = { Hand = "tip", Elbow = "lower" }
weights = { position = 50.0, orientation = 2.0, linear-velocity = 0.5 }
width = { position = 0.2 }
offset = 0.1
stretch = 1.5

[[costs]]
kind = "frame"
name = "tip"
target = [0.5, 0.0, 0.1]
weight = 0.01
when = { from = 0.1, to = 0.2 }
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    arm = mjslq.MujocoDynamics.from_xml(ARM, timestep=0.008)
    clip = mjslq.Clip.record(arm.rollout([0.3, -0.4, 0.0, 0.0], np.full((60, 2), [2.0, 0.3])), arm, ["tip", "lower"])
    clip.renamed({"tip": "Hand", "lower": "Elbow"}).save(tmp_path / "wave.csv")
    return tmp_path


def load(folder, text):
    (folder / "task.toml").write_text(text)
    return mjslq.load_task(folder / "task.toml")


def test_a_task_is_the_problem_that_one_would_write_in_python(folder):
    task = load(folder, TASK)
    arm = mjslq.MujocoDynamics.from_path(folder / "arm.xml", substeps=2, frames=["tip", "lower"])
    clip = mjslq.clips.load(folder / "wave.csv")
    weights = {"position": 50.0, "orientation": 2.0, "linear-velocity": 0.5}
    terms = clip.costs(
        arm, weights, names={"Hand": "tip", "Elbow": "lower"}, width={"position": 0.2}, offset=0.1, stretch=1.5
    )
    frame = costs.Frame("tip", [0.5, 0.0, 0.1], 0.01, slice(5, 11))
    x0 = clip.states(arm, 0.0, 0.1, 1.5)
    twin = mjslq.Problem(arm, 20, x0, [costs.Control(1e-4), *terms, frame])
    U = np.random.default_rng(0).normal(size=(20, 2))
    assert len(task.problem.costs) == 8 and np.array_equal(task.problem.x0, x0) and x0[2:].any()
    assert task.problem.cost(task.problem.rollout(U)) == pytest.approx(twin.cost(twin.rollout(U)), rel=1e-13)
    assert np.array_equal(task.guess, clip.guess(twin, 0.1, 1.5))
    result = task.solve()
    assert result.success and result.cost < 0.05 * twin.cost(twin.rollout(np.zeros(2)))


def test_a_task_with_pinocchio_follows_positions(tmp_path):
    panda = mjslq.PinocchioDynamics.from_path(mjslq.robot_path("panda"), 0.01, outputs=("panda_hand_tcp",))
    along = panda.rollout(panda.initial_state, np.full((10, panda.nu), 0.3))
    mjslq.Clip.record(along, panda, ["panda_hand_tcp"]).save(tmp_path / "reach.npz")
    text = """
model = "panda"
horizon = 10
[engine]
kind = "pinocchio"
timestep = 0.01
[start]
clip = "reach.npz"
[[costs]]
kind = "clip"
file = "reach.npz"
weights = { position = 3.0 }
"""
    problem = load(tmp_path, text).problem
    assert problem.cost(along) < 1e-20 and list(problem.dynamics.outputs) == ["panda_hand_tcp"]
    with pytest.raises(ValueError, match=r"task.toml, line 12, costs\[0\].weights: unknown output of a frame of Pinoc"):
        load(tmp_path, text.replace("position = 3.0", "linear-velocity = 3.0"))


WRONG = [
    ("weight = 1e-4", "", "line 12, costs[0].weight: is missing"),
    ('"wave.csv"\nnames', '"wav.csv"\nnames', "line 18, costs[1].file: clip file"),
    ('clip = "wave.csv"', 'clip = "wave.bvh"', "line 9, start.clip: a clip's file must end in .npz or .csv"),
    ("Elbow = ", "Elbo = ", "line 16, costs[1]: unknown frame of 'wave' 'Elbo'; there are: Hand, Elbow; did you"),
    ('"lower"', '"lowr"', "line 16, costs[1]: unknown site, body, geom or camera 'lowr'; there are: tip, upper, lower"),
    (
        "orientation = 2.0",
        "attitude = 2.0",
        "line 16, costs[1]: unknown quantity in weights 'attitude'; there are: pos",
    ),
    ("orientation = 2.0", "orientation = -2.0", "line 16, costs[1]: weight of 'orientation' must be at least 0"),
    ("{ position = 0.2 }", "-1.0", "line 21, costs[1].width: must be a number above 0 or a table of such"),
    ("stretch = 1.5", "stretch = 0.0", "line 23, costs[1].stretch: must be a number above 0"),
    ("stretch = 1.5", 'beyond = "stop"', 'line 23, costs[1].beyond: must be "hold" or "refuse", got \'stop\''),
    ("stretch = 1.5", 'loss = "abs"', "line 23, costs[1].loss: must be a loss or a table of losses"),
    ("offset = 0.1", 'offset = 0.3\nbeyond = "refuse"', "line 16, costs[1]: the clip lasts from 0 to 0.48 s, but"),
    ('clip = "wave.csv"', "", "line 10, start.controls: is 'clip', but start has no clip"),
    ('clip = "wave.csv"', 'clip = "wave.csv"\nkeyframe = "bent"', "line 9, start.clip: start has a keyframe, too"),
    ("target = [0.5, 0.0, 0.1]", "target = [0.5, 0.0]", "line 25, costs[2]: target must be"),
]


@pytest.mark.parametrize("old, new, told", WRONG, ids=range(len(WRONG)))
def test_one_sentence_for_each_wrong_task(folder, old, new, told):
    assert old in TASK
    with pytest.raises(ValueError) as caught:
        load(folder, TASK.replace(old, new))
    assert str(caught.value).startswith(f"task.toml, {told}") and "\n" not in str(caught.value)
