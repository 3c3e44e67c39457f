"""Small problems whose controls are limited by their models, one on each engine."""

import numpy as np
from small_problems import pendulum_equations

from mjslq import FunctionDynamics, MujocoDynamics, PinocchioDynamics, Problem, costs

MJCF = """
<mujoco><option timestep="0.05"/><worldbody><body><joint name="hinge" axis="0 1 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.6" size=".05" mass="1"/></body></worldbody>
<actuator><motor name="torque" joint="hinge" ctrlrange="{limits}"/></actuator></mujoco>"""


def _link(name):
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 -.3"/><mass value="1"/>'
        '<inertia ixx=".03" iyy=".03" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _joint(name, parent, child, z, effort):
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {z}"/><axis xyz="0 1 0"/><limit effort="{effort}" velocity="9"/>'
        '<dynamics damping=".1"/></joint>'
    )


URDF = (
    '<robot name="double_pendulum"><link name="base"/>' + _link("upper") + _link("lower")
    + _joint("shoulder", "base", "upper", 0.0, 3.0) + _joint("elbow", "upper", "lower", -0.6, 0.8) + "</robot>"
)  # fmt: skip


def function_pendulum(lower=-5.0, upper=4.0, N=30, **more):
    dynamics = FunctionDynamics(pendulum_equations, 2, 1, 0.05, control_limits=(lower, upper))
    terms = [costs.Control(0.1), costs.State([200.0, 20.0], [2.0, 0.0], "terminal")]
    return Problem(dynamics, N, [0.0, 0.0], terms, name="pendulum", **more)


def mujoco_pendulum(limits="-1.2 1", N=30, **more):
    dynamics = MujocoDynamics.from_xml(MJCF.format(limits=limits))
    terms = [costs.Control(0.1), costs.State([100.0, 10.0], [1.2, 0.0], "terminal")]
    return Problem(dynamics, N, [0.0, 0.0], terms, name="pendulum", **more)


def pinocchio_pendulum(folder, N=30, **more):
    """Two joints, the effort of the second one of which is small."""
    file = folder / "double_pendulum.urdf"
    file.write_text(URDF)
    dynamics = PinocchioDynamics.from_path(file, 0.05)
    x0 = dynamics.initial_state
    goal = dynamics.integrate(x0, np.array([0.6, -0.9, 0.0, 0.0]))
    terms = [costs.Control(0.1), costs.State([100.0, 100.0, 10.0, 10.0], goal, "terminal")]
    return Problem(dynamics, N, x0, terms, name="double pendulum", **more)
