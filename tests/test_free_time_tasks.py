"""Free time and parameters in task files, and on the command line."""

import pytest
from typer.testing import CliRunner

import mjslq
from mjslq.cli import app

ARM = """<mujoco><option timestep="0.01"/><worldbody><body name="arm"><joint name="hinge" axis="0 1 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1"/></body></worldbody>
<actuator><motor name="m" joint="hinge" ctrlrange="-3 3" ctrllimited="true"/></actuator></mujoco>"""
TASK = """model = "arm.xml"
horizon = 20
free_time = [0.1, 3.0]
free_parameters = { mass = [0.5, 2.0] }

[engine]
substeps = 2
parameters = { mass = "body/arm/mass" }

[[costs]]
kind = "time"
weight = 2.0

[[costs]]
kind = "control"
weight = 0.1

[[costs]]
kind = "joints"
target = { hinge = 0.5 }
weight = 100.0
when = "terminal"
"""


@pytest.fixture
def task(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)

    def write(text=TASK):
        file = tmp_path / "task.toml"
        file.write_text(text)
        return file

    return write


def test_a_task_has_free_time_and_parameters(task):
    problem = mjslq.load_task(task()).problem
    assert problem.free_time == (0.1, 3.0) and problem.free_parameters == {"mass": (0.5, 2.0)}
    assert problem.costs[0] == mjslq.costs.Time(2.0) and problem.dynamics.parameter_names == ("mass",)
    result = mjslq.solve(problem)
    assert result.success and result.final_time < 1.0 and result.unknowns["mass"] == 0.5


@pytest.mark.parametrize(
    "old, new, sentence",
    [
        ("[0.1, 3.0]", "[3.0, 0.1]", "line 3, free_time: must be a pair .* with the lower one first"),
        ("[0.1, 3.0]", "[0.0, 1.0]", "line 3.*T_min must be above zero, got 0"),
        ("[0.1, 3.0]", "2.0", r"line 3, free_time: must be a pair \[lower, upper\], got 2.0"),
        ("free_time", "fre_time", "line 3.*'fre_time'.*did you mean 'free_time'"),
        (
            "{ mass = [0.5, 2.0] }",
            "{ mas = [0.5, 2.0] }",
            "line 4, free_parameters: unknown parameter 'mas'; .*did you mean 'mass'",
        ),
        ("body/arm/mass", "body/leg/mass", "line 6, engine: parameters.*unknown body 'leg'"),
        ('when = "terminal"', "when = 0.2", "when names times, but the final time is free"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(task, old, new, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        mjslq.load_task(task(TASK.replace(old, new)))
    assert "\n" not in str(caught.value)


def test_pinocchio_has_no_parameters(task, tmp_path):
    (tmp_path / "arm.urdf").write_text('<robot name="arm"><link name="base"/></robot>')
    text = TASK.replace("arm.xml", "arm.urdf").replace("substeps = 2", 'kind = "pinocchio"\ntimestep = 0.01')
    with pytest.raises(ValueError, match=r"engine\.parameters: needs kind = 'mujoco'"):
        mjslq.load_task(task(text))


def test_the_command_line_checks_and_solves_it(task):
    run = CliRunner().invoke
    checked = run(app, ["check", str(task()), "--steps", "20"])
    assert checked.exit_code == 0 and "an unknown, a constant state" in checked.output, checked.output
    solved = run(app, ["solve", str(task())])
    assert solved.exit_code == 0 and "final time" in solved.output and "mass" in solved.output, solved.output
