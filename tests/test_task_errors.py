"""Distances of sensors from their targets, in the summary."""

import numpy as np
import pytest

import mjslq
from mjslq.reports.errors import sensor_unit, task_errors
from mjslq.reports.tables import print_summary

ARM = """<mujoco><option timestep=".02"/><worldbody>
<body><joint name="hinge" axis="0 1 0" damping=".2"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="1"/>
<site name="tip" pos=".4 0 0"/><body pos=".4 0 0"><joint name="slide" type="slide" axis="1 0 0" damping="1"/>
<geom size=".04" mass=".2"/></body></body></worldbody>
<actuator><motor name="hinge" joint="hinge"/><motor joint="slide"/></actuator>
<sensor><framepos name="tip" objtype="site" objname="tip"/><framequat name="turn" objtype="site" objname="tip"/>
<jointpos name="angle" joint="hinge"/><jointvel name="out" joint="slide"/><gyro name="gyro" site="tip"/>
<actuatorfrc name="effort" actuator="hinge"/></sensor></mujoco>"""


def arm(*terms):
    dynamics = mjslq.MujocoDynamics.from_xml(ARM)
    return mjslq.Problem(dynamics, 20, dynamics.initial_state, [mjslq.costs.Control(1e-2), *terms])


def test_units_of_sensors():
    dynamics = arm().dynamics
    units = {name: sensor_unit(dynamics, name) for name in ("tip", "turn", "angle", "out", "gyro", "effort", "none")}
    assert units == {
        "tip": "m", "turn": "rad", "angle": "rad", "out": "m/s", "gyro": "rad/s", "effort": "", "none": ""
    }  # fmt: skip


def test_distances_are_those_of_the_readings():
    target = np.array([0.3, 0.0, -0.2])
    problem = arm(
        mjslq.costs.Sensor("tip", target, 100.0, "terminal"), mjslq.costs.Sensor("angle", 0.5, 1.0),
        mjslq.costs.Sensor("turn", [np.cos(0.1), 0.0, np.sin(0.1), 0.0], 1.0, "terminal"),
    )  # fmt: skip
    trajectory = problem.rollout(np.full((20, 2), 0.3))
    tip, angle, turn = task_errors(problem, trajectory)
    assert (tip.sensor, tip.unit, tip.knots) == ("tip", "m", 1)
    assert tip.last == tip.largest == pytest.approx(np.linalg.norm(trajectory.Y[-1, :3] - target))
    assert angle.largest == pytest.approx(np.abs(trajectory.X[:-1, 0] - 0.5).max())
    assert angle.last == pytest.approx(abs(trajectory.X[-2, 0] - 0.5)) and angle.knots == 20
    assert turn.last == pytest.approx(abs(trajectory.X[-1, 0] - 0.2), abs=1e-9)


def test_the_summary_tells_them(capsys):
    problem = arm(mjslq.costs.Sensor("tip", [0.3, 0.0, -0.2], 1e4, "terminal"))
    result = mjslq.solve(problem)
    print_summary(result, problem)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("tip")]
    assert line.split()[2:] == ["mm", "off"] and float(line.split()[1]) < 150.0


def test_pinocchio_frames_are_in_metres(capsys):
    problem = mjslq.problems.get("panda_reach", engine="pinocchio", horizon=20, duration=0.2)
    error = task_errors(problem, problem.rollout(problem.U0))[-1]
    assert (error.unit, error.knots) == ("m", 1) and " m off" in str(error)
