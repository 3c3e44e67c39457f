"""A model with every sensor that MuJoCo has, for the tests of the sensors' Jacobians."""

from __future__ import annotations

from inverse_models import SOFT

ANALYTIC = """
  <touch site="tip"/><accelerometer site="tip"/><velocimeter site="tip"/><gyro site="tip"/><force site="wrist"/>
  <torque site="wrist"/><magnetometer site="tip"/>
  <jointpos joint="elbow"/><jointvel joint="elbow"/><tendonpos tendon="t"/><tendonvel tendon="t"/>
  <actuatorpos actuator="servo"/><actuatorvel actuator="servo"/><actuatorfrc actuator="servo"/>
  <jointactuatorfrc joint="elbow"/><tendonactuatorfrc tendon="t"/><ballquat joint="ball"/><ballangvel joint="ball"/>
  <jointlimitpos joint="elbow"/><jointlimitvel joint="elbow"/><jointlimitfrc joint="elbow"/>
  <tendonlimitpos tendon="t"/><tendonlimitvel tendon="t"/><tendonlimitfrc tendon="t"/>
  <framepos objtype="camera" objname="eye"/><framequat objtype="camera" objname="eye"/>
  <framexaxis objtype="site" objname="tip"/><frameyaxis objtype="site" objname="tip"/>
  <framezaxis objtype="site" objname="tip"/><framelinvel objtype="site" objname="tip" reftype="camera" refname="eye"/>
  <frameangvel objtype="body" objname="hand"/><framelinacc objtype="body" objname="hand"/>
  <frameangacc objtype="geom" objname="finger"/>
  <subtreecom body="arm"/><subtreelinvel body="arm"/><subtreeangmom body="world"/>
  <contact geom1="finger" data="found force torque dist pos normal tangent linvel angvel"/><e_kinetic/>
  <rangefinder site="tip"/>
"""
"""Sensors that have a derivative in closed form."""
CONSTANT = '<insidesite site="zone" objtype="body" objname="hand"/><clock/><user dim="2"/>'
"""Sensors whose derivative is zero."""
OWN_STAGE = """
  <camprojection site="tip" camera="eye"/><distance geom1="finger" geom2="floor" cutoff="1"/>
  <normal geom1="finger" geom2="puck" cutoff="5"/><fromto geom1="finger" geom2="puck" cutoff="5"/><e_potential/>
  <tactile geom="pad" mesh="plate"/>
"""
"""Sensors that are differenced within their stage."""


def laboratory(integrator: str, height: float = 0.2, sensors: str = ANALYTIC + CONSTANT + OWN_STAGE) -> str:
    """An arm at its limits that presses a finger on the floor, beside a tumbling puck: at a height, it does not."""
    return f"""
    <mujoco><option timestep=".004" integrator="{integrator}" cone="elliptic" impratio="2" tolerance="0"
      iterations="200" ls_iterations="200" ls_tolerance="1e-10" magnetic=".1 -.5 .2"/>
    <asset><mesh name="plate" builtin="plate" params="2 2" scale=".04 .04 .005"/></asset>
    <worldbody><geom name="floor" type="plane" size="5 5 .1" {SOFT}/>
      <site name="zone" type="box" size="9 9 9"/>
      <body name="arm" pos="0 0 {height}"><joint name="shoulder" axis="0 1 0" damping=".3" armature=".02"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1" contype="0" conaffinity="0"/>
        <camera name="eye" pos=".1 .1 .3" euler="10 160 20" resolution="100 80"/>
        <body name="forearm" pos=".3 0 0">
          <joint name="elbow" axis="0 1 .1" damping=".1" range="-1 1" limited="true" armature=".01" {SOFT_LIMIT}/>
          <geom type="box" size=".1 .02 .03" pos=".1 0 0" mass=".5" contype="0" conaffinity="0"/>
          <body name="hand" pos=".25 0 0"><joint name="ball" type="ball" damping=".05" stiffness="2"/>
            <site name="wrist" pos="0 0 .01" euler="20 30 10"/>
            <geom name="finger" type="capsule" fromto="0 0 0 .1 .02 -.18" size=".03" mass=".4" {SOFT}/>
            <geom name="pad" type="mesh" mesh="plate" pos=".1 .02 -.21" mass="0" contype="0" conaffinity="0"/>
            <site name="tip" type="sphere" size=".06" pos=".1 .02 -.18" euler="30 160 20"/></body></body></body>
      <body pos=".1 .6 1" euler="10 20 30"><freejoint/>
        <geom name="puck" type="box" size=".1 .05 .08" contype="0" conaffinity="0"/></body>
    </worldbody>
    <tendon><fixed name="t" limited="true" range="-.1 .05" {SOFT_LIMIT}>
      <joint joint="shoulder" coef=".5"/><joint joint="elbow" coef="-1"/></fixed></tendon>
    <actuator><position name="servo" joint="elbow" kp="3" kv=".2"/><motor name="shoulder" joint="shoulder" gear="3"/>
      <motor tendon="t" gear="2"/><general joint="elbow" dyntype="filter" dynprm=".05" gainprm=".5"/></actuator>
    <sensor>{sensors}</sensor></mujoco>"""


SOFT_LIMIT = 'solimplimit="0 .95 .1"'
