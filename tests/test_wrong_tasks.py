"""Wrong task files: one sentence with the file, the line where there is one, the key, and what fits there."""

import pytest
from wrong_inputs import ARM, one_sentence

from mjslq import load_task
from mjslq.tasks.reading import TaskError, parse

MODEL, HORIZON, COST = 'model = "arm.xml"\n', "horizon = 10\n", '[[costs]]\nkind = "control"\nweight = 0.1\n'


def top(line, model=MODEL, horizon=HORIZON):
    return model + horizon + line + "\n" + COST


def table(name, *lines):
    return MODEL + HORIZON + f"[{name}]\n" + "\n".join(lines) + "\n" + ("" if name == "costs" else COST)


def cost(*lines):
    return MODEL + HORIZON + COST + "[[costs]]\n" + "\n".join(lines) + "\n"


def held(*lines):
    return MODEL + HORIZON + COST + "[[constraints]]\n" + "\n".join(lines) + "\n"


def state(when):
    return cost('kind = "state"', "weight = 1.0", f"when = {when}")


def frame(*lines):
    return cost('kind = "frame"', 'name = "tip"', "weight = 1.0", *lines)


TASKS = {
    "no model": (HORIZON + COST, "model: is missing; it must be a text"),
    "no horizon": (MODEL + COST, "give horizon (steps) or duration (seconds), one of the two"),
    "horizon and duration": (top("duration = 1.0"), "give horizon (steps) or duration (seconds)"),
    "horizon 0": (top("horizon = 0", horizon=""), "line 2, horizon: must be a whole number of at least 1, got 0"),
    "horizon float": (top("horizon = 10.0", horizon=""), "horizon: must be a whole number of at least 1, got 10.0"),
    "horizon text": (top('horizon = "10"', horizon=""), "must be a whole number of at least 1, got '10'"),
    "horizon date": (top("horizon = 2020-01-01", horizon=""), "must be a whole number of at least 1"),
    "horizon huge": (top("horizon = 100000000000000000000", horizon=""), "horizon must be at most 10000000 steps"),
    "horizon digits": (top("horizon = 1" + "0" * 5000, horizon=""), "is no valid TOML: Exceeds the limit"),
    "duration between": (top("duration = 0.33", horizon=""), "must be a multiple of the step, 0.02 s, got 0.33"),
    "duration negative": (top("duration = -1.0", horizon=""), "duration: must be a number above 0, got -1.0"),
    "duration nan": (top("duration = nan", horizon=""), "duration: must be a number above 0, got nan"),
    "duration inf": (top("duration = inf", horizon=""), "must be a multiple of the step, 0.02 s, got inf"),
    "unknown key": (top("horizn = 3"), "line 3, horizn: unknown key 'horizn'; there are: model", "'horizon'?"),
    "key with a line's end": (top('"a\\nb" = 1'), "unknown key 'a\\nb'; there are: model"),
    "model missing": (top("", 'model = "none.xml"\n'), "line 1, model: model file", "none.xml' does not exist"),
    "model folder": (top("", 'model = "./"\n'), "line 1, model: model file", "is a folder"),
    "robot": (top("", 'model = "pnda"\n'), "line 1, model: unknown robot 'pnda'", "did you mean 'panda'?"),
    "model number": (top("", "model = 3\n"), "line 1, model: must be a text, got 3"),
    "model empty": (top("", 'model = ""\n'), "line 1, model: must be a text, got ''"),
    "name number": (top("name = 3"), "line 3, name: must be a text, got 3"),
    "engine": (table("engine", 'kind = "bullet"'), 'line 4, engine.kind: must be "mujoco" or "pinocchio"'),
    "engine text": (top('engine = "mujoco"'), "line 3, engine: must be a table, got 'mujoco'"),
    "timestep": (table("engine", "timestep = 0"), "engine.timestep: must be a number above 0, got 0"),
    "timestep inf": (table("engine", "timestep = inf"), "engine: timestep must be positive and finite, got inf"),
    "substeps": (table("engine", "substeps = 0"), "engine.substeps: must be a whole number of at least 1, got 0"),
    "integrator": (table("engine", 'integrator = "x"'), "unknown integrator 'x'; there are: Euler, implicit"),
    "jacobian": (table("engine", 'jacobian = "x"'), 'must be "auto" or "inverse" or "transition", got \'x\''),
    "threads": (table("engine", "threads = 0"), "engine.threads: must be a whole number of at least 1, got 0"),
    "floor": (table("engine", "floor = true"), "line 4, engine.floor: is for URDF models; change arm.xml instead"),
    "engine key": (table("engine", "timesteps = 1"), "unknown key 'timesteps'", "did you mean 'timestep'?"),
    "armature": (table("engine", "armature = -1.0"), "engine.armature: must be a number of at least 0, got -1.0"),
    "locked": (table("engine", 'locked_joints = ["j"]'), "is for kind = 'pinocchio', not 'mujoco'"),
    "pinocchio": (table("engine", 'kind = "pinocchio"', "timestep = 0.1"), "arm.xml is no URDF file"),
    "pinocchio step": (table("engine", 'kind = "pinocchio"'), "engine.timestep: is missing; a URDF has no timestep"),
    "keyframe": (table("start", 'keyframe = "hme"'), "line 4, start.keyframe: unknown keyframe 'hme'", "'home'?"),
    "position": (table("start", "positions = { k = 1.0 }"), "start.positions.k: unknown position 'k'; there are: j"),
    "position text": (table("start", 'positions = { j = "x" }'), "must be a table of numbers by name, got 'x'"),
    "position nan": (table("start", "positions = { j = nan }"), "x0 must be finite, but x0[0] is nan"),
    "velocity": (table("start", "velocities = { k = 1.0 }"), "start.velocities.k: unknown velocity 'k'"),
    "controls": (table("start", 'controls = "x"'), 'must be "zero", "hold"', "got 'x'"),
    "controls of none": (table("start", 'controls = "keyframe"'), "is 'keyframe', but start has no keyframe"),
    "controls two": (table("start", "controls = [1.0, 2.0]"), "must have 1 numbers, for m; got 2"),
    "no costs": (MODEL + HORIZON, "costs: is missing; it must be a list of tables, written [[costs]]"),
    "costs table": (table("costs", 'kind = "control"'), "costs: must be a list of tables, written [[costs]]"),
    "cost kind": (cost('kind = "sensr"'), "line 7, costs[1].kind: unknown kind 'sensr'", "did you mean 'sensor'?"),
    "cost no kind": (cost("weight = 1.0"), "line 6, costs[1]: kind is missing; there are: control, state"),
    "no weight": (cost('kind = "control"'), "line 6, costs[1].weight: is missing; it must be a number"),
    "weight negative": (cost('kind = "control"', "weight = -1.0"), "costs[1]: weight must be positive semidefinite"),
    "weight nan": (cost('kind = "control"', "weight = nan"), "costs[1]: weight must be finite"),
    "weight text": (cost('kind = "control"', 'weight = "high"'), "line 8, costs[1].weight: must be a number, a list"),
    "weight name": (cost('kind = "control"', "weight = { x = 1.0 }"), "unknown control 'x'; there are: m"),
    "weight ragged": (cost('kind = "control"', "weight = [[1.0], [1.0, 2.0]]"), "must be an array of numbers"),
    "loss": (cost('kind = "control"', "weight = 1.0", 'loss = "x"'), 'must be "quadratic" or "smooth-abs"'),
    "width": (cost('kind = "control"', "weight = 1.0", "width = 1.0"), "width is for the losses"),
    "when": (state('"end"'), 'when: must be "running", "terminal", "always"', "got 'end'"),
    "when between": (state("0.005"), "when names the time 0.005 s, at which there is no knot"),
    "when beyond": (state("99"), "when names knot 99, but there are the knots 0 to 10"),
    "window reversed": (state("{ from = 5, to = 2 }"), "the window from 5 to 2 has no knot in it"),
    "window half": (state("{ from = 5 }"), "a window { from = , to = }, got {'from': 5}"),
    "window nan": (state("{ from = nan, to = 1.0 }"), "the window from nan to 1 has no knot in it"),
    "sensor": (cost('kind = "sensor"', 'name = "hnad"', "target = 0.0", "weight = 1.0"), "'hnad'", "'hand'?"),
    "sensor target": (cost('kind = "sensor"', 'name = "hand"', "target = [0.0, 0.0]", "weight = 1.0"), "(3,)"),
    "sensor no target": (cost('kind = "sensor"', 'name = "hand"', "weight = 1.0"), "costs[1].target: is missing"),
    "frame": (cost('kind = "frame"', 'name = "tp"', "target = 0.0", "weight = 1.0"), "'tp'; there are: tip, arm"),
    "frame of": (frame("target = 0.0", 'of = "speed"'), 'must be "position" or "orientation"', "got 'speed'"),
    "frame quaternion": (frame("target = [0.0, 0.0, 0.0]", 'of = "orientation"'), "a vector (4,)", "got shape (3,)"),
    "joints": (cost('kind = "joints"', "target = { k = 1.0 }", "weight = 1.0"), "one axis 'k'; there are: j"),
    "velocities": (cost('kind = "velocities"', "weight = { k = 1.0 }"), "unknown velocity 'k'; there are: j"),
    "constraint": (held('kind = "x"'), "line 7, constraints[0].kind: unknown kind 'x'; there are: control"),
    "limits of three": (held('kind = "control"', "limits = { m = [1.0, 2.0, 3.0] }"), "pairs [lower, upper]"),
    "limits reversed": (held('kind = "control"', "limits = { m = [1.0, -1.0] }"), "got 1 and -1 for 'm'"),
    "limits against": (held('kind = "control"', "limits = { m = [3.0, 4.0] }"), "leave nothing at step 0", "[-2, 2]"),
    "joint limits": (held('kind = "joints"', "limits = { j = [1.0, -1.0] }"), "lower <= upper, got [1.0, -1.0]"),
    "margin": (held('kind = "joints"', 'limits = "model"', "margin = 2.0"), "a margin of 2 leaves nothing of 'j'"),
    "no limit": (held('kind = "sensor"', 'sensor = "hand"'), "there is no finite limit; give lower, upper or both"),
    "distance": (held('kind = "distance"', 'between = ["ball", "x"]', "lower = 0.0"), "geom or body 'x'", "ball"),
    "distance of one": (held('kind = "distance"', 'between = ["ball"]', "lower = 0.0"), "must be a pair of names"),
    "bounds": (table("bounds", 'u = "all"'), 'line 4, bounds.u: must be "model", "none" or a table'),
    "bounds name": (table("bounds", "u = { x = [1.0, 2.0] }"), "unknown control 'x'; there are: m"),
    "bounds reversed": (table("bounds", "u = { m = [2.0, 1.0] }"), "control 'm' must not lie above", "2 and 1"),
    "method": (table("solve", 'method = "slk"'), "line 4, solve.method: unknown method 'slk'", "did you mean 'slq'?"),
    "option": (table("solve", "max_iteration = 1"), "line 4, solve.max_iteration", "did you mean 'max_iterations'?"),
    "option value": (table("solve", "max_iterations = -1"), "must be a whole number of at least 0, got -1"),
    "key twice": (top("horizon = 1"), "is no valid TOML: Cannot overwrite a value (at line 3"),
    "syntax": ("horizon = = 3", "is no valid TOML: Invalid value (at line 1"),
    "nul": ("a\0b", "is no valid TOML"),
    "nested": ("a = " + "[" * 100_000 + "]" * 100_000, "is no valid TOML: it is nested too deeply"),
}  # fmt: skip


@pytest.mark.parametrize("name", TASKS)
def test_wrong_tasks(name, tmp_path):
    text, *fragments = TASKS[name]
    (tmp_path / "arm.xml").write_text(ARM)
    file = tmp_path / "task.toml"
    file.write_text(text)
    with pytest.raises(TaskError) as caught:
        load_task(file)
    one_sentence(str(caught.value), "task.toml", *fragments)


def test_the_task_that_all_of_them_spoil_is_right(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "task.toml").write_text("\ufeff" + MODEL + HORIZON + COST)  # as some editors begin a file
    assert load_task(tmp_path / "task.toml").problem.horizon == 10


@pytest.mark.parametrize("given", [None, 3, b"task.toml", "task\0.toml"])
def test_what_is_no_path(given):
    with pytest.raises(ValueError) as caught:
        load_task(given)
    one_sentence(str(caught.value), "path must be the path of a file")


def test_texts_are_named():
    with pytest.raises(TaskError, match=r"^mine: give|^mine, model: is missing"):
        parse(HORIZON + COST, "mine")
