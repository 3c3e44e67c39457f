"""Jacobians through the inverse dynamics under the discrete integrator: its metric, its rows, their weights."""

from __future__ import annotations

import inverse_models as models
import mujoco
import numpy as np
import pytest
import sensor_models
from hypothesis import given, settings
from hypothesis import strategies as st
from test_mujoco_inverse import assert_exact, dynamics_of, some_trajectory

from mjslq.dynamics.derivative_check import compare_jacobians, fine_reference
from mjslq.dynamics.mujoco import MujocoDynamics

BALL = 'type="sphere" size=".06" pos="0 0 -.2"'
VARIED = 'solref=".02 1" solimp=".3 .9 .05"'


def creature(
    cone: str = "pyramidal",
    condim: int = 3,
    contact: str = models.SOFT,
    foot: str = BALL,
    options: str = "",
    flag: str = "",
    extra: str = "",
) -> str:
    """Three legs, with every spring, damper and servo that changes its stiffness, on a plane."""
    still = 'mass=".3" contype="0" conaffinity="0"'
    return f"""
    <mujoco><option timestep=".004" integrator="discrete" cone="{cone}" impratio="2" tolerance="1e-30" iterations="200"
      ls_iterations="200" ls_tolerance="1e-10" {options}>{flag}</option>
    <default><geom condim="{condim}" friction="1 .05 .01" {contact}/></default>
    <worldbody><geom type="plane" size="5 5 .1"/>
      <body name="trunk" pos="0 0 .34"><joint type="free" damping=".3 .2 .1"/>
        <geom type="box" size=".2 .1 .05" mass="2" contype="0" conaffinity="0"/>
        <body pos=".15 0 0">
          <joint name="a" axis="0 1 0" stiffness="30 20 10" springref="10" damping="1 .5 .3"/>
          <geom type="capsule" fromto="0 0 0 0 0 -.1" size=".02" {still}/>
          <body pos="0 0 -.1">
            <joint name="b" axis="1 .3 0" frictionloss=".05" limited="true" range="-10 2" solimplimit="0 .95 .05"/>
            <geom {foot} mass=".2"/></body></body>
        <body pos="-.15 .1 0"><joint name="c" type="ball" stiffness="2 3 4" damping=".5 .2 .1"/>
          <geom type="capsule" fromto="0 0 0 0 0 -.1" size=".02" {still}/>
          <body pos="0 0 -.1"><joint name="d" axis="0 1 0" armature=".01"/>
            <geom size=".06" pos="0 0 -.2" mass=".2"/></body></body>
        <body pos="-.15 -.1 0"><joint name="e" axis="1 0 0" damping="1"/>
          <geom type="capsule" fromto="0 0 0 0.03 0 -.285" size=".05" mass=".3"/></body>
      </body></worldbody>
    <tendon><fixed name="t" stiffness="10 20 30" springlength="-.02 .02" damping=".5 .3 .2" frictionloss=".02">
      <joint joint="b" coef="1.5"/><joint joint="d" coef="-1"/></fixed></tendon>
    <actuator>
      <position joint="a" kp="40" kv="1"/>
      <general joint="d" dyntype="filter" dynprm=".05" gaintype="affine" gainprm="2 -3 -.4" biastype="affine"
               biasprm="0 -30 -.5"/>
      <general joint="e" gaintype="affine" gainprm="2 -5 -.4" biastype="affine" biasprm="0 -30 -.5"/>
      <general tendon="t" dyntype="integrator" gainprm="2 0 0" biastype="affine" biasprm="0 -10 -.3" actearly="true"/>
    </actuator>{extra}</mujoco>"""


def rows_of(dynamics: MujocoDynamics, trajectory, n: int = 0) -> mujoco.MjData:
    """MuJoCo's own rows at a knot."""
    data = mujoco.MjData(dynamics.model)
    x, nq, nv = trajectory.X[n], dynamics.model.nq, dynamics.model.nv
    data.qpos, data.qvel, data.act, data.ctrl = x[:nq], x[nq : nq + nv], x[nq + nv :], trajectory.U[n]
    mujoco.mj_forward(dynamics.model, data)
    return data


def on_its_feet(dynamics: MujocoDynamics, spread: float = 0.02):
    trajectory = some_trajectory(dynamics, spread=spread, speed=0.3, scale=0.3)
    assert any((rows_of(dynamics, trajectory, n).efc_state == 1).any() for n in range(trajectory.horizon))
    return trajectory


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("condim", [1, 3, 4, 6])
def test_everything_at_once(cone, condim):
    dynamics = dynamics_of(creature(cone, condim))
    trajectory = on_its_feet(dynamics)
    assert (rows_of(dynamics, trajectory).efm_sdiag > 0).any()
    assert_exact(dynamics, trajectory, tolerance=1e-8, eps=1e-6)


@pytest.mark.parametrize("foot", ['type="cylinder" size=".06 .03"', 'type="ellipsoid" size=".06 .05 .055"'])
def test_contacts_by_differences_of_positions(foot):
    dynamics = dynamics_of(creature("elliptic", foot=foot + ' pos="0 0 -.2" euler="20 10 0"'))
    assert_exact(dynamics, on_its_feet(dynamics), eps=1e-6)


RESOLVED = (
    'solref=".0015 1" solimp=".3 .9 .05"', 'solref=".003 .5" solimp=".3 .9 .05"', 'solref=".0042 1" solimp=".3 .5 .05"',
    'solref=".003 1" solimp=".99999 .99999 .05"', 'solref=".002 1" solimp=".9 .9999 .02 .5 1"',
    'solref=".0015 2" solimp=".99 .9999 .04 .5 1"', 'solref=".0012 1" solimp=".3 .99999 .05"',
)  # fmt: skip


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("contact", RESOLVED)
def test_rows_stiffer_than_the_time_step(contact, cone):
    dynamics = dynamics_of(creature(cone, contact=contact))
    trajectory = on_its_feet(dynamics)
    resolved = 0
    for n in range(trajectory.horizon):
        K = rows_of(dynamics, trajectory, n).efc_KBIP
        resolved += int((np.abs(K[:, 0] * K[:, 2] * dynamics.model.opt.timestep**2 - 1.0) < 1e-9).sum())
    assert resolved
    assert_exact(dynamics, trajectory, eps=1e-6)


@pytest.mark.parametrize(
    "contact",
    ['solref="-60000 -100" solimp=".3 .9999 .03"', 'solref="-4e5 -100"', 'solimp=".95 .1 .05" solref=".02 1"', VARIED],
)
def test_rows_as_they_are_given(contact):
    dynamics = dynamics_of(creature("elliptic", contact=contact))
    assert_exact(dynamics, on_its_feet(dynamics), eps=1e-6)
    dynamics = dynamics_of(creature(contact='solref=".003 1" solimp=".3 .9 .05"', flag='<flag refsafe="disable"/>'))
    assert_exact(dynamics, on_its_feet(dynamics), eps=1e-6)


def test_limits_stiffer_than_the_time_step():
    xml = creature().replace("solimplimit", 'solreflimit=".003 1" solimplimit').replace('range="-10 2"', 'range="1 2"')
    dynamics = dynamics_of(xml)
    assert_exact(dynamics, on_its_feet(dynamics), eps=1e-6)


def test_slopes_of_the_wrong_sign_stay_out_of_the_metric():
    joint = creature("elliptic").replace('stiffness="30 20 10"', 'stiffness="-30 -2 -1"')
    joint = joint.replace('damping="1 .5 .3"', 'damping="-.1 -.5 -.3"')
    servo = creature("elliptic").replace('biasprm="0 -30 -.5"', 'biasprm="0 30 .5"')
    servo = servo.replace('stiffness="10 20 30" spring', 'stiffness="-10 -20 -30" spring')
    for xml in (joint, servo):
        dynamics = dynamics_of(xml)
        assert_exact(dynamics, on_its_feet(dynamics), eps=1e-6)


@pytest.mark.parametrize("flag", ["spring", "damper", "frictionloss", "limit", "clampctrl"])
def test_flags(flag):
    dynamics = dynamics_of(creature("elliptic", flag=f'<flag {flag}="disable"/>'))
    assert_exact(dynamics, on_its_feet(dynamics), eps=1e-6)


@pytest.mark.parametrize("solver", ["CG", "PGS"])
def test_other_solvers(solver):
    dynamics = dynamics_of(creature(options=f'solver="{solver}"'))
    assert_exact(dynamics, on_its_feet(dynamics), eps=1e-6)
    dynamics = dynamics_of(models.mixed("discrete").replace('"discrete"/>', f'"discrete" solver="{solver}"/>'))
    assert_exact(dynamics, some_trajectory(dynamics, N=12), tolerance=5e-9)


def test_sparse_constraint_jacobian():
    dynamics = dynamics_of(creature("elliptic", options='jacobian="sparse"'))
    assert_exact(dynamics, on_its_feet(dynamics), eps=1e-6)


def test_equality_constraints():
    extra = """<equality><connect body1="trunk" body2="world" anchor=".1 0 0"/>
      <joint joint1="a" joint2="b" polycoef="0 .5 .3 .1 0"/></equality>"""
    dynamics = dynamics_of(creature("elliptic", extra=extra))
    trajectory = on_its_feet(dynamics)
    assert_exact(dynamics, trajectory, tolerance=1e-6, eps=1e-6)


@pytest.mark.parametrize("height", [2.0, 0.14])
def test_only_bodies_that_touch_nothing_spin_implicitly(height):
    body = '<geom type="box" size=".1 .2 .05" mass="1" pos=".02 .03 .01" solimp=".5 .9 .1"/></body>'
    joint = '<joint type="free" damping=".3 .2 .1"/>'
    dynamics = dynamics_of(f"""
    <mujoco><option timestep=".01" integrator="discrete" tolerance="1e-30" iterations="200" ls_tolerance="1e-10"/>
    <worldbody><geom type="plane" size="5 5 .1" solimp=".5 .9 .1"/>
      <body pos="0 0 {height}" euler="20 30 0">{joint}{body}<body pos="2 0 2" euler="20 30 0">{joint}{body}
      <body pos="4 0 2"><joint name="a" axis="0 1 0" frictionloss=".1"/><geom size=".1" pos=".3 0 0"/></body>
    </worldbody><actuator><motor joint="a"/></actuator></mujoco>""")
    trajectory = some_trajectory(dynamics, N=4, spread=0.0, speed=3.0)
    assert (rows_of(dynamics, trajectory).ncon > 0) == (height < 1.0)
    assert_exact(dynamics, trajectory, eps=1e-6)


def test_sensors_of_the_acceleration():
    extra = '<accelerometer site="s"/><force site="s"/><actuatorfrc actuator="b"/>'
    dynamics = dynamics_of(models.sensed("discrete", extra))
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=1e-6)


def test_no_worse_than_differences_of_the_step():
    dynamics = dynamics_of(creature("elliptic"))
    trajectory = on_its_feet(dynamics)
    fine = fine_reference(dynamics, trajectory, 1e-6)
    other = MujocoDynamics.from_model(dynamics.model, jacobian="transition", centered=False, threads=1)
    ours = compare_jacobians(dynamics.linearize(trajectory), fine).errors
    theirs = compare_jacobians(other.linearize(trajectory), fine).errors
    assert ours["A"] < 1e-2 * theirs["A"] and ours["B"] <= theirs["B"]


def test_forces_that_the_metric_does_not_know_fall_back():
    for xml, reason in (
        (models.arm("discrete").replace("<option", '<option density="1000"'), "takes forces implicitly"),
        (sensor_models.laboratory("discrete"), "sensors feel constraint forces"),
        (creature(options='noslip_iterations="3"'), "noslip"),
        (creature(flag='<flag diagexact="enable"/>'), "exact constraint diagonals"),
    ):
        dynamics = MujocoDynamics.from_xml(xml)
        assert dynamics.jacobian == "transition"
        assert any(reason in served for _, served in dynamics.support_report())
    assert any("discrete" in part for part, _ in dynamics_of(creature()).support_report())


@settings(max_examples=25)
@given(st.data())
def test_random_legs(data):
    number = st.floats(0.0, 1.0, allow_subnormal=False)

    def some(scale: float) -> float:
        return round(scale * data.draw(number), 3)

    def curve(scale: float) -> str:
        return f"{some(scale)} {some(scale)} {data.draw(st.sampled_from([0.0, some(scale)]))}"

    legs = servos = ""
    for k in range(data.draw(st.integers(1, 3))):
        kind = data.draw(st.sampled_from(["hinge", "ball"]))
        motor = 'gear="1 2 3"' if kind == "ball" else f'kp="{some(50)}" kv="{some(2)}"'
        servos += f'<{"motor" if kind == "ball" else "position"} joint="j{k}" {motor}/>'
        servos += f'<position joint="k{k}" kp="{some(50)}" kv="{some(2)}"/>'
        legs += f"""<body pos="{0.2 * k - 0.2} {some(0.2) - 0.1} 0">
          <joint name="j{k}" type="{kind}" axis="{some(1)} 1 0" stiffness="{curve(20)}" damping="{curve(1)}"/>
          <geom type="capsule" fromto="0 0 0 0 0 -.1" size=".02" mass="{0.1 + some(0.5)}" contype="0"/>
          <body pos="0 0 -.1"><joint name="k{k}" axis="0 1 0" stiffness="{curve(20)}" damping="{curve(1)}"/>
            <geom size=".06" pos="0 0 -.2" mass="{0.1 + some(0.5)}"/></body></body>"""
    dynamics = dynamics_of(f"""
    <mujoco><option timestep=".005" integrator="discrete" tolerance="1e-30" iterations="200" ls_iterations="200"
      ls_tolerance="1e-10" cone="{data.draw(st.sampled_from(["pyramidal", "elliptic"]))}"/>
    <default><geom {VARIED}/></default><worldbody><geom type="plane" size="5 5 .1"/>
      <body pos="0 0 .34"><freejoint/><geom type="box" size=".2 .1 .05" mass="2" contype="0" conaffinity="0"/>{legs}
      </body></worldbody><actuator>{servos}</actuator></mujoco>""")
    assert_exact(dynamics, some_trajectory(dynamics, N=2, spread=0.02, speed=0.1), eps=1e-6)
