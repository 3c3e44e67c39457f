"""Task files: what they state, and what is said of those that state something wrong."""

import json
import shutil
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mjslq
from mjslq.tasks.lines import lines_of
from mjslq.tasks.reading import parse
from mjslq.tasks.schema import TaskFile
from mjslq.tasks.writing import text_for

TASKS = sorted((Path(__file__).parent.parent / "assets" / "tasks").glob("*.toml"))
ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.01"/>
  <worldbody>
    <geom name="box" type="box" size="0.05 0.05 0.05" pos="0.6 0 0.3"/>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" range="-2 2" limited="true" damping="0.1"/>
      <geom name="bone" type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1" contype="0" conaffinity="0"/>
      <body name="lower" pos="0.5 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
        <site name="tip" pos="0.4 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m0" joint="shoulder" ctrlrange="-20 20" ctrllimited="true"/>
    <motor name="m1" joint="elbow" ctrlrange="-10 10" ctrllimited="true"/>
  </actuator>
  <sensor><framepos name="hand" objtype="site" objname="tip"/></sensor>
  <keyframe><key name="bent" qpos="0.3 -0.4" qvel="0.1 0.2" ctrl="1 2"/></keyframe>
</mujoco>
"""
TASK = """
model = "arm.xml"
horizon = 50

[engine]
substeps = 2

[start]
keyframe = "bent"
positions = { shoulder = 0.5 }
velocities = { elbow = -0.3 }
controls = "hold"

[[costs]]
kind = "control"
weight = { m0 = 0.01, m1 = 0.02 }

[[costs]]
kind = "frame"
name = "tip"
target = [0.5, 0.0, 0.1]
weight = 100.0
when = "terminal"

[[costs]]
kind = "joints"
target = { elbow = 0.2 }
weight = 3.0
when = { from = 0.1, to = 0.2 }

[[costs]]
kind = "velocities"
weight = { shoulder = 0.5 }
when = "always"
terminal_weight = 2.0
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    return tmp_path


def load(folder, text):
    file = folder / "task.toml"
    file.write_text(text)
    return mjslq.load_task(file)


def test_a_task_is_the_problem_that_one_would_write_in_python(folder):
    problem = load(folder, TASK).problem
    arm = mjslq.MujocoDynamics.from_path(folder / "arm.xml", substeps=2)
    x0 = np.array([0.5, -0.4, 0.1, -0.3])
    target = x0.copy()
    target[1] = 0.2
    window = slice(5, 11)  # 0.1 to 0.2 s, in steps of 0.02 s
    costs = [
        mjslq.costs.Control([0.01, 0.02]),
        mjslq.costs.Sensor("hand", [0.5, 0.0, 0.1], 100.0, "terminal"),
        mjslq.costs.State([0.0, 3.0, 0.0, 0.0], target, window),
        mjslq.costs.State([0.0, 0.0, 0.5, 0.0], when="always", terminal_weight=[0.0, 0.0, 2.0, 2.0]),
    ]
    twin = mjslq.Problem(arm, 50, x0, costs)
    U = np.random.default_rng(0).normal(size=(50, 2))
    assert problem.horizon == 50 and problem.dynamics.dt == pytest.approx(0.02)
    assert np.array_equal(problem.x0, x0)
    assert problem.cost(problem.rollout(U)) == pytest.approx(twin.cost(twin.rollout(U)), rel=1e-13)
    assert np.array_equal(problem.box.upper[0], [20.0, 10.0])


def test_a_task_solves_with_its_own_options_unless_told_otherwise(folder):
    task = load(folder, TASK + '[solve]\nmethod = "slq"\nmax_iterations = 2\n')
    result = task.solve()
    assert result.method == "slq" and result.iterations == 2
    assert np.array_equal(result.iterates[0].U, mjslq.starts.hold(task.problem))
    assert task.solve("auto", max_iterations=100).success


def test_constraints_and_bounds_by_name(folder):
    extra = """
[[constraints]]
kind = "joints"
limits = "model"
margin = 0.1

[[constraints]]
kind = "joints"
of = "velocity"
limits = { elbow = [-1.0, 2.0] }

[[constraints]]
kind = "frame"
frame = "tip"
lower = [-inf, -inf, -0.3]
when = 30

[[constraints]]
kind = "sensor"
sensor = "hand"
upper = [0.9, inf, inf]
name = "wall"

[[constraints]]
kind = "distance"
between = ["box", "bone"]
lower = 0.02

[[constraints]]
kind = "control"
limits = { m1 = [-3.0, 4.0] }

[bounds]
u = { m0 = [-15.0, 16.0] }
"""
    problem = load(folder, TASK + extra).problem
    bound = {constraint.name: constraint for constraint in problem.bound_constraints}
    assert list(bound) == ["joints", "speeds", "tip.position", "wall", "box to bone"]
    assert np.allclose([bound["joints"].lower[0], bound["joints"].upper[0]], [[-1.9], [1.9]])
    assert np.allclose([bound["speeds"].lower[0], bound["speeds"].upper[0]], [[-1.0], [2.0]])
    assert np.array_equal(problem.box.lower[0], [-15.0, -3.0]) and np.array_equal(problem.box.upper[0], [16.0, 4.0])
    result = mjslq.solve(problem)
    assert result.success and result.constraint_violation <= 1e-6


WRONG = [
    ('kind = "frame"', 'kind = "fram"', "line 19, costs[1].kind: unknown kind 'fram'; there are: control, state"),
    ('name = "tip"', 'name = "tap"', "line 18, costs[1]: unknown site, body, geom or camera 'tap'; there are: tip"),
    ("weight = 100.0", 'weight = "high"', "line 22, costs[1].weight: must be a number, a list (a diagonal)"),
    ("weight = 100.0", "wieght = 100.0", "line 22, costs[1].wieght: unknown key 'wieght'"),
    ("weight = 3.0", "weight = true", "line 28, costs[2].weight: must be a number or a table"),
    ("{ elbow = 0.2 }", "{ elbo = 0.2 }", "line 25, costs[2]: unknown joint with one axis 'elbo'; there are: shoulder"),
    ("m1 = 0.02", "m2 = 0.02", "line 14, costs[0]: unknown control 'm2'; there are: m0, m1"),
    ("[0.5, 0.0, 0.1]", "[0.5, 0.0]", "line 18, costs[1]: target must"),
    ("horizon = 50", "horizon = 0", "line 3, horizon: must be a whole number of at least 1, got 0"),
    ("horizon = 50", "", "give horizon (steps) or duration (seconds)"),
    ("horizon = 50", "duration = 0.03", "line 3, duration: must be a multiple of the step, 0.02 s, got 0.03"),
    ('"bent"', '"bnt"', "line 9, start.keyframe: unknown keyframe 'bnt'; there are: bent; did you mean 'bent'?"),
    ("shoulder = 0.5 }", "sholder = 0.5 }", "line 10, start.positions.sholder: unknown position 'sholder'"),
    (
        "elbow = -0.3",
        "elbw = -0.3",
        "line 11, start.velocities.elbw: unknown velocity 'elbw'; there are: shoulder, elb",
    ),
    ('"hold"', "[1.0]", "line 12, start.controls: must have 2 numbers, for m0, m1; got 1"),
    ('"hold"', '"hang"', 'line 12, start.controls: must be "zero", "hold"'),
    ('"arm.xml"', '"leg.xml"', "line 2, model: model file"),
    ('"arm.xml"', '"armm"', "line 2, model: unknown robot 'armm'"),
    ("substeps = 2", "substeps = 2\nfloor = true", "line 7, engine.floor: is for URDF models; change arm.xml instead"),
    ("substeps = 2", 'kind = "pinocchio"\nsubsteps = 2', "line 7, engine.substeps: is for kind = 'mujoco'"),
    ("from = 0.1, to = 0.2", "from = 0.101, to = 0.102", "line 25, costs[2]: the window from 0.101 to 0.102 has no"),
    ("from = 0.1, ", "", "line 29, costs[2].when: must be"),
    ("[[costs]]", "[[cost]]", "unknown key 'cost'"),
    ("horizon = 50", "horizon = ", "is no valid TOML"),
]


@pytest.mark.parametrize(("right", "wrong", "sentence"), WRONG)
def test_a_wrong_task_is_refused_in_a_sentence_with_its_line(folder, right, wrong, sentence):
    assert right in TASK
    with pytest.raises(ValueError, match=r"^task\.toml") as caught:
        load(folder, TASK.replace(right, wrong, 1))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("solve", "sentence"),
    [
        ('method = "sql"', "line 2, solve.method: unknown method 'sql'; there are: auto"),
        ("max_iteration = 3", "line 2, solve.max_iteration: unknown option of method 'auto' 'max_iteration'"),
        ("max_iterations = -3", "line 2, solve.max_iterations: max_iterations must be a whole number"),
    ],
)
def test_wrong_options_are_refused_with_their_line(folder, solve, sentence):
    with pytest.raises(ValueError) as caught:
        load(folder, f"[solve]\n{solve}\n" + TASK.replace('model = "arm.xml"\nhorizon = 50\n', "", 1))
    assert "model" in str(caught.value)  # keys of the file itself come before the tables
    with pytest.raises(ValueError) as caught:
        load(folder, TASK + f"[solve]\n{solve}\n")
    shifted = sentence.replace("line 2", f"line {len(TASK.splitlines()) + 2}")
    assert shifted in str(caught.value)


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(ValueError, match="does not exist; `mjslq new MODEL` writes one"):
        mjslq.load_task(tmp_path / "none.toml")
    (tmp_path / "bits.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"bits\.toml is no text file"):
        mjslq.load_task(tmp_path / "bits.toml")


def test_pinocchio_reads_the_same_frames(tmp_path):
    text = """
model = "ur5"
horizon = 10
[engine]
kind = "pinocchio"
timestep = 0.01
[[costs]]
kind = "control"
weight = 1e-3
[[costs]]
kind = "frame"
name = "tool0"
target = [0.4, 0.2, 0.5]
when = "terminal"
[[constraints]]
kind = "joints"
limits = "model"
"""
    problem = load(tmp_path, text).problem
    assert isinstance(problem.dynamics, mjslq.PinocchioDynamics) and list(problem.dynamics.outputs) == ["tool0"]
    for right, wrong, sentence in (
        ('name = "tool0"', 'name = "tool0"\nof = "linear-velocity"', "unknown output of a frame of Pinocchio"),
        ("timestep = 0.01", "", "engine.timestep: is missing"),
    ):
        with pytest.raises(ValueError) as caught:
            load(tmp_path, text.replace(right, wrong))
        assert sentence in str(caught.value)


def test_a_robot_of_the_menagerie(folder, monkeypatch):
    """With a stand-in for the package, which would download."""

    class Robot:
        entry_names = ("arm", "scene")

        def xml(self, entry=None):
            if entry == "scene":
                raise OSError("no network")
            return folder / "arm.xml"

    class Failure(Exception):
        """The package's own."""

    stand_in = types.SimpleNamespace(
        names=lambda: ["an_arm"], get=lambda name: Robot(), MenagerieError=Failure, UnknownRobotError=Failure
    )
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", stand_in)
    assert load(folder, TASK.replace('"arm.xml"', '"menagerie:an_arm"')).problem.dynamics.nu == 2
    for model, sentence in (
        ("menagerie:a_leg", "unknown robot of MuJoCo Menagerie 'a_leg'; there are: an_arm"),
        ("menagerie:an_arm/seen", "unknown file of an_arm 'seen'"),
        ("menagerie:an_arm/scene", "'an_arm' could not be fetched: no network"),
    ):
        with pytest.raises(ValueError) as caught:
            load(folder, TASK.replace("arm.xml", model))
        assert sentence in str(caught.value)
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(ValueError, match=r"pip install 'mjslq\[menagerie\]'"):
        load(folder, TASK.replace("arm.xml", "menagerie:an_arm"))


@pytest.mark.parametrize("file", TASKS, ids=lambda file: file.stem)
def test_the_tasks_that_come_along_converge(file):
    result = mjslq.load_task(file).solve()
    assert result.success and result.constraint_violation <= 1e-6


def test_a_new_task_lists_names_and_solves_as_it_is(folder):
    shutil.copy(folder / "arm.xml", folder / "other.xml")
    text = text_for("other.xml", folder)
    for name in ("shoulder [-2, 2]", "m0 [-20, 20]", "hand", "bent", "tip", "lower"):
        assert name in text
    task = load(folder, text)
    result = task.solve()
    assert result.success
    reached = result.trajectory.Y[-1, task.problem.dynamics.outputs["tip.position"].columns]
    assert np.linalg.norm(reached - task.problem.costs[1].target) < 0.02


def test_the_schema_has_every_kind():
    schema = json.dumps(TaskFile.model_json_schema())
    for word in ("velocities", "distance", "terminal_weight", "self_contacts", "smooth-abs"):
        assert word in schema


keys = st.from_regex(r"[a-z]{1,5}", fullmatch=True)


@given(st.lists(st.tuples(keys, st.lists(st.tuples(keys, st.integers()), max_size=3)), max_size=4))
def test_lines_are_found_by_place(tables):
    """Twin: the text is written line by line, with the places noted on the way."""
    written, expected, counts = [], {}, {}
    for name, entries in tables:
        i = counts[name] = counts.get(name, -1) + 1
        written.append(f"[[{name}]]  # a table")
        expected[(name, i)] = len(written)
        for key, value in dict(entries).items():
            written += [f"{key} = [", f"  {value}, # x = 1", "]", "# y = 2"]
            expected[(name, i, key)] = len(written) - 3
    assert {place: line for place, line in lines_of("\n".join(written)).items() if len(place) > 1} == expected


def test_the_first_of_several_mistakes_is_told_with_their_number():
    with pytest.raises(ValueError, match=r"t\.toml, line 1, modl: unknown key .* \(and 3 more\)$"):
        parse('modl = "x"\nhorizon = 3\n[[costs]]\nkind = "control"\nwieght = 1.0\n', "t.toml")
