"""Models for the tests of the smooth forces' Jacobians: one chain, and what can act on it."""

from __future__ import annotations

from typing import Any

PATHS = {
    "straight": """<spatial name="t" {}><site site="w"/><site site="s0"/><site site="s2"/><pulley divisor="2"/>
        <site site="s2"/><site site="s3"/><pulley divisor="1"/><site site="s1"/><site site="s2"/></spatial>""",
    "around a sphere": """<spatial name="t" {}><site site="w"/><site site="s0"/><geom geom="ball" sidesite="side"/>
        <site site="s1"/></spatial>""",
    "around a cylinder": """<spatial name="t" {}><site site="w"/><geom geom="cylinder"/><site site="s0"/>
        <pulley divisor="2"/><site site="s0"/><site site="s2"/></spatial>""",
    "fixed": '<fixed name="t" {}><joint joint="a" coef="1"/><joint joint="b" coef=".5"/></fixed>',
    "between branches": '<fixed name="t" {}><joint joint="f" coef="1"/><joint joint="b" coef=".5"/></fixed>',
}
AFFINE = 'gaintype="affine" gainprm="1 .3 2" biastype="affine" biasprm=".1 -2 -.3"'
DRIVES = f"""<general tendon="t" gear="1.7" {AFFINE} damping=".1 .2" dyntype="filter" dynprm=".03"/>
    <general tendon="t" {AFFINE} actearly="true" dyntype="filterexact" dynprm=".03"/>
    <position tendon="t" kp="3" kv=".3"/>"""
MUSCLES = """<muscle joint="a" ctrlrange="0 1" lengthrange="-1 1.5" force="4" timeconst=".02 .06" tausmooth=".3"/>
    <muscle joint="b" lengthrange="-1 1" force="3" range=".6 1.5"/>
    <general joint="f" gaintype="muscle" biastype="muscle" gainprm=".7 1.1 5 200 .5 1.6 1.5 1.3 1.2"
      biasprm=".7 1.1 5 200 .5 1.6 1.5 1.3 1.2" lengthrange="-1 1"/>"""


def path(name: str, options: str = "") -> str:
    """One of the tendons' paths."""
    return PATHS[name].format(options)


def chain(
    integrator: str,
    actuators: str = '<motor joint="a"/>',
    tendons: str = "",
    options: str = "",
    joint: str = "",
    beside: str = "",
    geom: str = "",
    body: str = "",
    floating: bool = False,
) -> str:
    """Two branches with hinges, a slide and a ball joint; sites for tendons, cranks and servos."""
    base = '<body><freejoint/><geom type="box" size=".1 .1 .1"/>' if floating else ""
    return f"""
    <mujoco><option timestep=".005" integrator="{integrator}" {options}/>
    <default><geom contype="0" conaffinity="0"/></default>
    <worldbody><site name="w" pos=".1 0 .2"/>
      <geom name="cylinder" type="cylinder" size=".04 .3" pos=".05 .1 -.1" euler="90 0 0"/>{beside}
      {base}<body {body}><joint name="a" axis="0 1 0" damping=".1" {joint}/><joint axis="1 0 0" damping=".1"/>
        <geom type="capsule" size=".04" fromto="0 0 0 0 0 -.3" {geom}/>
        <site name="s0" pos=".06 0 -.2"/><site name="k0" pos=".05 0 -.05" euler="20 0 0"/>
        <body pos="0 0 -.3"><joint name="b" axis="0 1 0" damping=".2"/>
          <geom name="ball" size=".05"/><geom type="box" size=".03 .02 .1" pos="0 0 -.1" {geom}/>
          <site name="s1" pos=".05 0 -.12"/><site name="side" pos=".1 0 0"/>
          <body pos="0 0 -.25"><joint name="c" type="ball" damping=".05"/>
            <geom type="ellipsoid" size=".03 .05 .08" pos="0 .02 -.05" {geom}/>
            <site name="s2" pos=".05 .02 -.1" euler="10 20 30"/></body></body>
        <body pos=".1 .1 0"><joint name="e" type="slide" axis="0 0 1" damping=".3" stiffness="5"/>
          <joint name="f" axis="1 0 0" damping=".1"/><geom type="box" size=".05 .02 .1" pos="0 .1 -.1" {geom}/>
          <site name="s3" pos="0 .1 -.2"/></body></body>{"</body>" if floating else ""}</worldbody>
    <tendon>{tendons}</tendon><actuator>{actuators}</actuator></mujoco>"""


FREE = '<body pos="1 0 0"><joint name="q" type="free" {}/><geom type="box" size=".1 .2 .3" mass="3"/></body>'
ELLIPSOID = 'fluidshape="ellipsoid" fluidcoef="1 .3 2 .7 .4"'
WATER = 'density="1000" viscosity=".1" wind="1 .2 0"'

CLOSED: dict[str, dict[str, Any]] = {
    "muscles": {"actuators": MUSCLES},
    "boxes in water": {"options": WATER},
    "ellipsoids in water": {"options": WATER, "geom": ELLIPSOID},
    "ellipsoids in honey": {"options": 'density="1" viscosity="5" jacobian="sparse"', "geom": ELLIPSOID},
    "swimmer": {"options": WATER, "geom": ELLIPSOID, "floating": True},
}
"""Whose forces are analytic altogether."""

ARMS: dict[str, dict[str, Any]] = {
    f"{what}, {name}": case
    for name in PATHS
    if name != "fixed"
    for what, case in (
        ("springs and dampers", {"tendons": path(name, 'stiffness="10 5 2" damping=".2 .1 .05" springlength=".1 .2"')}),
        ("actuators", {"tendons": path(name, 'damping=".3"'), "actuators": DRIVES}),
    )
} | {
    "crank": {"actuators": '<position cranksite="s1" slidersite="k0" cranklength=".4" kp="3" kv=".3"/>'},
    "reference site": {
        "actuators": '<position site="s2" refsite="s3" gear="1 .5 .2 .1 .2 .3" kp="3" kv=".3"/>'
        '<motor site="s1" refsite="k0" gear="1 .5 .2 .1 .2 .3"/>'
    },
    "site": {"actuators": '<position site="s2" gear="1 .5 .2 .1 .2 .3" kp="3" kv=".3"/>'},
    "ball joint": {
        "actuators": '<position joint="c" gear="1 .5 .2" kp="3" kv=".3"/><motor jointinparent="c" gear="1 .5 .2"/>'
    },
    "free joint": {
        "beside": FREE.format(""), "actuators": '<position joint="q" kp="3" kv=".3" gear="1 .3 .5 .2 .1 .7"/>'
    },
}  # fmt: skip
"""Whose moment arms are differenced, where they are not straight."""

CLIP = 'actuatorfrcrange="-.5 .5"'
REST: dict[str, dict[str, Any]] = {
    "clipped joint": {
        "joint": CLIP, "tendons": path("fixed"),
        "actuators": '<position tendon="t" kp="5" kv=".5"/><motor joint="a"/><motor site="s2" gear="1 2 3"/>',
    },
    "clipped spatial tendon": {
        "joint": CLIP, "tendons": path("around a cylinder"),
        "actuators": '<position tendon="t" kp="10" kv="1"/><motor joint="a"/>',
    },
    "clipped gravity compensation": {
        "joint": 'actuatorfrcrange="-3 3" actuatorgravcomp="true"', "body": 'gravcomp="1"',
    },
    "limited tendon": {
        "tendons": path("fixed", CLIP), "actuators": '<position tendon="t" kp="5" kv=".5"/><motor tendon="t"/>',
    },
    "free joint with a nonlinear spring": {"beside": FREE.format('stiffness="3 2 1"')},
    "motors": {
        "actuators": '<dcmotor joint="a" motorconst=".1" resistance="1" cogging=".1 6 .3"/><dcmotor joint="b" '
        'motorconst=".5" resistance="1" inductance="0 .02" thermal="1 2 0 .004 20 20"/>',
    },
    "controlled motors": {
        "actuators": '<dcmotor joint="a" motorconst=".1" resistance="1" input="pos vel" controller="2 .5 .1 3 .2 6"/>'
        '<dcmotor joint="b" motorconst=".1" resistance="1" input="none" lugre="10 .1 .1 .2 .1"/>',
    },
    "controllers": {
        "actuators": '<pid joint="a" kp="3" kv=".3" ki="1" imax=".5" slewmax="2"/>'
        '<pid joint="b" kp="2" kv=".2" input="pos ff"/><pid tendon="t" kp="2" kv=".3"/>',
        "tendons": path("around a cylinder"),
    },
    "orientation": {
        "actuators": '<orientation joint="c" kp="3" kv=".3"/><orientation site="s3" refsite="s0" kp="2" kv=".1"/>'
        '<general joint="c" gaintype="so3" biastype="so3" gainprm="2" biasprm="0 -2 -.1" dyntype="integrator"/>',
    },
}  # fmt: skip
"""Whose forces are differenced."""


def tied(integrator: str, cone: str) -> str:
    """A capsule that lies on the ground, with arms in water, a tendon with limits and friction, and muscles."""
    soft = 'solimp="0 .95 .02" solref=".02 1"'
    return f"""
    <mujoco><option timestep=".004" integrator="{integrator}" cone="{cone}" density="500" tolerance="0"
      iterations="200" ls_iterations="200" ls_tolerance="1e-10"/>
    <worldbody><geom type="plane" size="5 5 .1" {soft}/><site name="w" pos=".4 .3 .5"/>
      <body pos="0 0 .048"><freejoint/><geom type="capsule" size=".05 .2" euler="85 10 0" {soft}/>
        <site name="s0" pos=".05 0 .05"/>
        <body name="arm" pos=".1 0 .1"><joint name="a" axis="0 1 0" damping=".1"/>
          <geom type="box" size=".03 .02 .1" pos="0 0 .1" contype="0" conaffinity="0" {ELLIPSOID}/>
          <site name="s1" pos=".03 0 .2"/></body></body></worldbody>
    <tendon><spatial name="t" limited="true" range="0 .3" frictionloss=".5" stiffness="3">
      <site site="w"/><site site="s1"/></spatial>
      <spatial name="m"><site site="s0"/><site site="s1"/></spatial></tendon>
    <actuator><muscle tendon="m" lengthrange=".1 .4" force="5"/><pid joint="a" kp="1" ki="1"/></actuator></mujoco>"""


def sticky(integrator: str) -> str:
    """A ball that clings to the ground."""
    return f"""
    <mujoco><option timestep=".004" integrator="{integrator}" tolerance="0" iterations="200" ls_iterations="200"
      ls_tolerance="1e-10"/>
    <worldbody><geom type="plane" size="5 5 .1" solimp="0 .95 .02"/>
      <body name="ball" pos="0 0 .098"><freejoint/><geom size=".1" solimp="0 .95 .02"/>
        <body pos="0 0 .1"><joint name="j" axis="0 1 0"/><geom size=".05" pos=".1 0 .1" contype="0"/></body></body>
    </worldbody>
    <actuator><adhesion body="ball" gain="3" ctrlrange="0 1"/><motor joint="j" gear=".1"/></actuator></mujoco>"""


SLIDES = {
    "damper": ('<spatial damping="3"><site site="w"/><site site="s"/></spatial>', ""),
    "nonlinear damper": (
        '<fixed damping="3 1 .5"><joint joint="x" coef="1"/><joint joint="y" coef="-.7"/></fixed>',
        "",
    ),
    "servo": ("", '<general site="s" refsite="w" gear="1 .5 .3 0 0 0" biastype="affine" biasprm="0 -1 -2"/>'),
    "motor": (
        '<fixed name="t"><joint joint="x" coef="1"/><joint joint="y" coef="-.7"/></fixed>',
        '<dcmotor tendon="t" motorconst="1" resistance=".5" input="pos vel" controller="0 0 5"/>',
    ),
}


def sliding(case: str, integrator: str = "Euler") -> str:
    """A body on slides only, whose inertia MuJoCo keeps diagonal, with velocities that feel each other."""
    tendon, actuator = SLIDES[case]
    return f"""<mujoco><option timestep=".01" integrator="{integrator}"/><worldbody><site name="w" pos=".3 .2 .1"/>
      <body><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
        <geom size=".1" mass="1" contype="0" conaffinity="0"/><site name="s"/></body></worldbody>
      <tendon>{tendon}</tendon><actuator><motor joint="x"/>{actuator}</actuator></mujoco>"""
