"""Problems with free time and parameters on all engines, for tests of their derivatives."""

import numpy as np
import pinocchio as pin

from mjslq import FunctionDynamics, MujocoDynamics, PinocchioDynamics, Problem, costs
from mjslq.constraints import Path, Sensor, State, Terminal

POLE = """<mujoco><option timestep="0.008"/><worldbody><body name="pole">
<joint name="hinge" axis="0 1 0" damping=".1"/>
<geom name="rod" type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1"/>
<site name="tip" pos="0 0 -.5"/></body></worldbody><actuator><motor name="m" joint="hinge" ctrlrange="-2 2"
ctrllimited="true"/></actuator><sensor><framepos name="tip" objtype="site" objname="tip"/>
<accelerometer name="felt" site="tip"/></sensor></mujoco>"""
LINKS = """<robot name="links"><link name="base"><inertial><mass value="2"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0"
ixz="0" iyz="0"/></inertial></link><link name="a"><inertial><mass value="1"/><origin xyz="0 0 -.3"/><inertia ixx=".02"
iyy=".02" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="b"><inertial><mass value=".7"/><origin
xyz="0 .1 -.3"/><inertia ixx=".02" iyy=".03" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
<joint name="j2" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0 0 -.5"/><axis xyz="1 0 0"/></joint>
</robot>"""


def pendulum(x, u, t, p):
    """A driven pendulum whose motor weakens with time."""
    return np.array([x[1], -p[0] * np.sin(x[0]) - p[1] * x[1] + u[0] * np.cos(t)])


def read(x, u, t):
    """An output that depends on time."""
    return np.array([np.sin(x[0]) + 0.1 * t])


def wave(x, u, t):
    """A residual that depends on time."""
    return x[0] - np.sin(3.0 * t)


def product(x, u, t):
    """A cost that depends on time."""
    return t * x[0] ** 2 * u[0] + x[1]


def wall(x, u, t):
    """A constraint that depends on time and control."""
    return np.array([x[0] * t - u[0] ** 2, x[1] - 9.0])


def of_function(integrator="rk4", f=pendulum, **options):
    """All kinds of costs and constraints on a function."""
    dynamics = FunctionDynamics(
        f, 2, 1, 0.05, integrator=integrator, parameters={"gravity": 9.0, "drag": 0.3}, outputs=read
    )
    terms = [
        costs.Control(0.1), costs.State([1.0, 0.3], [2.0, 0.1], "always", loss="pseudo-huber"), costs.Time(0.5),
        costs.Residual(wave, 2.0), costs.Function(product), costs.Sensor("y", 0.3, 2.0, "always"),
        costs.Tracking(0.1, 0.1, 5.0, x_target=[1.0, 0.0]),
    ]  # fmt: skip
    held = [
        Path(wall, name="start"), Path(wall, at="end", name="end"), State(-9.0, 9.0, name="state"),
        Terminal(lambda x: x - 1.0, name="goal"), Sensor("y", -2.0, 2.0, name="output"),
    ]  # fmt: skip
    free = {"drag": (0.0, 2.0), "gravity": (1.0, 20.0)}
    given = {"free_time": (0.2, 4.0), "free_parameters": free, "constraints": held} | options
    return Problem(dynamics, 20, [0.4, 0.0], terms, **given)


def of_mujoco(integrator="Euler", substeps=1, **options):
    """A pendulum with sensors."""
    dynamics = MujocoDynamics.from_xml(
        POLE, substeps=substeps, integrator=integrator, threads=1,
        parameters={"mass": "body/pole/mass", "damping": "joint/hinge/damping"},
    )  # fmt: skip
    terms = [
        costs.Control(0.1), costs.Time(0.3), costs.State([1.0, 0.1], [1.0, 0.0], "always"),
        costs.Sensor("tip", [0.1, 0.0, -0.4], 3.0), costs.Sensor("felt", [0.1, 0.0, -0.4], 0.01),
    ]  # fmt: skip
    free = {"free_parameters": {"mass": (0.2, 3.0), "damping": (0.01, 1.0)}, "free_time": (0.05, 4.0)}
    return Problem(dynamics, 20, [0.3, 0.0], terms, **(free | options))


def of_pinocchio(integrator="semi-implicit-euler", floating=False, **options):
    """Two links, on the ground or flying."""
    root = (pin.JointModelFreeFlyer(),) if floating else ()
    model = pin.buildModelFromXML(LINKS, *root)
    damping = {"j1": 0.2, "j2": 0.1}
    dynamics = PinocchioDynamics.from_model(model, 0.01, outputs=["b"], integrator=integrator, damping=damping)
    x0 = np.concatenate([pin.neutral(model), np.full(model.nv, 0.3)])
    terms = [
        costs.Control(0.1),
        costs.Time(0.3),
        costs.State(1.0, x0, "always"),
        costs.Sensor("b", [0.1, 0, -0.4], 3.0),
    ]
    return Problem(dynamics, 20, x0, terms, **({"free_time": (0.05, 4.0)} | options))
