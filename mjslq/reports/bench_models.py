"""Small problems that `mjslq bench` measures, beside those of the catalogue."""

from __future__ import annotations

import dataclasses

import numpy as np

from mjslq import problems
from mjslq.costs import Control, State
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem

_CART_POLE = """
<mujoco><option timestep=".02" integrator="implicitfast"/><worldbody>
  <body><joint name="rail" type="slide" axis="1 0 0"/><geom type="box" size=".15 .1 .08" mass="1"/>
    <body><joint name="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02" mass=".1"/>
    </body></body></worldbody>
  <actuator><motor joint="rail" ctrlrange="-5 5"/></actuator></mujoco>
"""


def cart_pole() -> Problem:
    """A pole swung up by a force of at most 5 N."""
    dynamics = MujocoDynamics.from_xml(_CART_POLE, threads=1)
    upright = [0.0, np.pi, 0.0, 0.0]
    arrive = State([500.0, 500.0, 50.0, 50.0], upright, when="terminal")
    running = [State([1.0, 1.0, 0.1, 0.1], upright), Control(0.01)]
    return Problem(dynamics, 150, np.zeros(4), [*running, arrive], name="cart-pole")


_GRASP = """
<mujoco><option timestep=".005" integrator="implicitfast"/><worldbody>
  <body pos="0 0 .05"><joint name="lift" type="slide" axis="0 0 1"/><geom type="box" size=".1 .1 .02" mass="1"/></body>
  <body pos="-.08 0 .12"><joint name="left" type="slide" axis="1 0 0"/>
    <geom type="box" size=".02 .06 .03" mass=".5"/></body>
  <body pos=".08 0 .12"><joint name="right" type="slide" axis="-1 0 0"/>
    <geom type="box" size=".02 .06 .03" mass=".5"/></body>
  <body pos="0 0 .11"><freejoint/><geom type="box" size=".06 .05 .04" mass=".5"/></body></worldbody>
  <actuator><position joint="lift" kp="4000" kv="60"/><position joint="left" kp="1000" kv="40"/>
    <position joint="right" kp="1000" kv="40"/></actuator></mujoco>
"""


def grasp() -> Problem:
    """A box on a plate that moves up and down, between two plates that press on it: every body in contact moves."""
    dynamics = MujocoDynamics.from_xml(_GRASP, threads=1)
    x0 = dynamics.initial_state
    goal = x0.copy()
    goal[[0, 5]] += 0.05
    weight = np.concatenate([np.full(9, 10.0), np.full(9, 0.1)])
    held = np.array([0.0, 0.01, 0.01])
    return Problem(dynamics, 100, x0, [State(weight, goal), Control(1.0, held)], name="grasp", U0=held)


def linkages() -> Problem:
    """Four linkages of four bars each, closed by connect constraints, driven at one crank each."""
    bars = ties = motors = ""
    for k in range(4):
        bars += f"""
          <body pos="0 {0.2 * k} 1"><joint name="crank{k}" axis="0 1 0" damping=".05"/>
            <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02"/>
            <body pos="0 0 -.2"><joint axis="0 1 0" damping=".05"/>
              <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
              <body name="end{k}" pos=".3 0 0"><joint axis="0 1 0" damping=".05"/>
                <geom type="capsule" fromto="0 0 0 0 0 .2" size=".02"/></body></body></body>"""
        ties += f'<connect body1="end{k}" body2="world" anchor="0 0 .2"/>'
        motors += f'<motor joint="crank{k}"/>'
    dynamics = MujocoDynamics.from_xml(
        f"""<mujoco><option timestep=".005" integrator="implicitfast"><flag contact="disable"/></option>
        <worldbody>{bars}</worldbody><equality>{ties}</equality><actuator>{motors}</actuator></mujoco>""",
        threads=1,
    )
    goal = np.concatenate([np.tile([0.3, -0.3, 0.3], 4), np.zeros(12)])
    return Problem(dynamics, 100, dynamics.initial_state, [State(1.0, goal), Control(0.1)], name="linkages")


def chain(links: int) -> Problem:
    """A hanging chain of links with a motor at every hinge, which is to come to rest bent."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = 0.01, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    body = spec.worldbody
    for i in range(links):
        body = body.add_body(pos=[0.0, 0.0, -0.2 if i else 0.0])
        joint = body.add_joint(name=f"hinge{i}", axis=[0.0, 1.0, 0.0], damping=[0.1, 0.0, 0.0])
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0.0, 0.0, 0.0, 0.0, 0.0, -0.2], size=[0.02, 0.0, 0.0])
        motor = spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint.name)
        motor.set_to_motor()
    dynamics = MujocoDynamics.from_spec(spec, threads=1)
    goal = np.concatenate([np.full(links, 0.1), np.zeros(links)])
    return Problem(dynamics, 100, np.zeros(2 * links), [State(1.0, goal), Control(0.01)], name="chain")


def solo12_in_flight() -> Problem:
    """The quadruped thrown up from a metre's height: no contact within the horizon."""
    problem = problems.get("solo12_stand", horizon=40)
    x0 = np.array(problem.x0)
    x0[2], x0[problem.dynamics.nx - problem.dynamics.ndx // 2 + 2] = 1.0, 2.0
    return dataclasses.replace(problem, x0=x0)


_MUSCLES = """
<mujoco><option timestep=".005" integrator="implicitfast"><flag contact="disable"/></option><worldbody>
  <site name="s0" pos="-.05 0 .3"/><site name="s1" pos=".05 0 .3"/>
  <body><joint name="shoulder" axis="0 1 0" damping=".05"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03"/>
    <geom name="wrap" type="cylinder" size=".025 .05" euler="90 0 0" pos="0 0 -.3"/>
    <site name="u0" pos="-.03 0 -.1"/><site name="u1" pos=".03 0 -.1"/>
    <site name="u2" pos="-.03 0 -.15"/><site name="u3" pos=".03 0 -.15"/>
    <body pos="0 0 -.3"><joint name="elbow" axis="0 1 0" damping=".05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.25" size=".025"/>
      <site name="l0" pos="-.02 0 -.1"/><site name="l1" pos=".02 0 -.1"/></body></body></worldbody>
  <tendon>
    <spatial name="t0"><site site="s0"/><site site="u0"/></spatial>
    <spatial name="t1"><site site="s1"/><site site="u1"/></spatial>
    <spatial name="t2"><site site="u2"/><geom geom="wrap"/><site site="l0"/></spatial>
    <spatial name="t3"><site site="u3"/><geom geom="wrap"/><site site="l1"/></spatial></tendon>
  <actuator><muscle tendon="t0"/><muscle tendon="t1"/><muscle tendon="t2"/><muscle tendon="t3"/></actuator></mujoco>
"""


def muscles() -> Problem:
    """An arm of two links on four muscles, two of which wrap round the elbow."""
    dynamics = MujocoDynamics.from_xml(_MUSCLES, threads=1)
    weight = np.concatenate([[10.0, 10.0, 0.1, 0.1], np.zeros(4)])
    goal = np.concatenate([[0.3, 0.4], np.zeros(6)])
    costs = [State(weight, goal), Control(0.1)]
    return Problem(dynamics, 100, dynamics.initial_state, costs, name="muscles", U0=np.full(4, 0.1))


def scanner() -> Problem:
    """A quadruped of boxes and capsules on position servos, with twenty rangefinders and an accelerometer."""
    legs = motors = rays = ""
    for k, (x, y) in enumerate(((0.2, 0.12), (0.2, -0.12), (-0.2, 0.12), (-0.2, -0.12))):
        legs += f"""
          <body pos="{x} {y} 0"><joint name="hip{k}" axis="0 1 0" damping=".5" armature=".01"/>
            <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".3"/>
            <body pos="0 0 -.2"><joint name="knee{k}" axis="0 1 0" damping=".5" armature=".01"/>
              <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".015" mass=".2"/>
              <geom pos="0 0 -.2" size=".025" mass=".05"/></body></body>"""
        motors += f'<position joint="hip{k}" kp="60"/><position joint="knee{k}" kp="60"/>'
    for k in range(20):
        angle = 2.0 * np.pi * k / 20
        rays += f'<site name="eye{k}" pos="0 0 .08" zaxis="{np.cos(angle):.6f} {np.sin(angle):.6f} -.5"/>'
    eyes = "".join(f'<rangefinder site="eye{k}"/>' for k in range(20))
    dynamics = MujocoDynamics.from_xml(
        f"""<mujoco><option timestep=".005" integrator="implicitfast"/><worldbody><geom type="plane" size="0 0 1"/>
        <body pos="0 0 .42"><freejoint/><geom type="box" size=".25 .1 .05" mass="4"/>{rays}{legs}</body></worldbody>
        <actuator>{motors}</actuator><sensor>{eyes}<accelerometer site="eye0"/></sensor></mujoco>""",
        threads=1,
        contact="smooth",
    )
    x0, bent = dynamics.initial_state, np.tile([0.4, -0.8], 4)
    x0[2], x0[7:15] = 0.4 * np.cos(0.4) + 0.025, bent
    goal = x0.copy()
    goal[2] -= 0.03
    weight = np.concatenate([np.full(6, 10.0), np.ones(8), np.full(dynamics.nv, 0.01)])
    return Problem(dynamics, 100, x0, [State(weight, goal), Control(0.01, bent)], name="scanner", U0=bent)


def runge_kutta() -> Problem:
    """The swing-up of a double pendulum by MuJoCo's integrator RK4."""
    problem = problems.get("double_pendulum")
    assert isinstance(problem.dynamics, MujocoDynamics)
    dynamics = MujocoDynamics.from_model(problem.dynamics.model, integrator="RK4", threads=1)
    return dataclasses.replace(problem, dynamics=dynamics)
