"""Models for the tests of the Jacobians through the inverse dynamics: each has parts that the others lack."""

from __future__ import annotations

CONTINUOUS = ("Euler", "implicitfast", "implicit")
INTEGRATORS = (*CONTINUOUS, "discrete")
SOFT = 'solimp="0 .95 .02" solref=".02 1"'


def arm(integrator: str, options: str = "") -> str:
    """Chain of seven hinges with damping and armature."""
    text = f'<mujoco><option timestep=".01" integrator="{integrator}"/><worldbody>'
    for i in range(7):
        axis = "0 0 1" if i % 2 == 0 else "0 1 0"
        text += (
            f'<body pos="0 0 .2"><joint name="j{i}" axis="{axis}" damping=".1" armature=".01" {options}/>'
            '<geom type="capsule" fromto="0 0 0 0 0 .2" size=".04" mass="1" contype="0" conaffinity="0"/>'
        )
    motors = "".join(f'<motor joint="j{i}" gear="10"/>' for i in range(7))
    return text + "</body>" * 7 + f"</worldbody><actuator>{motors}</actuator></mujoco>"


def mixed(integrator: str) -> str:
    """Ball, hinge and slide joints with all kinds of springs, dampers, tendons, actuators and activations."""
    return f"""
    <mujoco><option timestep=".005" integrator="{integrator}"/>
    <worldbody><body>
      <joint name="ball" type="ball" stiffness="1 2 3" damping=".1 .2 .3" armature=".01"/>
      <geom type="box" size=".1 .2 .3" pos=".1 .05 .2" contype="0"/>
      <body pos="0 .2 .3" gravcomp=".7">
        <joint name="hinge" axis="1 1 0" stiffness="5 2 3" springref=".3" damping=".1 .2 .1"/>
        <joint name="slide" type="slide" axis="0 1 1" pos=".1 0 0" damping=".3"/>
        <geom type="capsule" size=".05 .2" pos="0 .1 0" contype="0"/>
        <body pos="0 0 .3"><joint name="last" axis="0 0 1"/><geom type="box" size=".05 .1 .2" contype="0"/></body>
      </body>
    </body></worldbody>
    <tendon>
      <fixed name="t" stiffness="3 2 1" springlength="-.1 .1" damping=".5 .1 .2" armature=".1">
        <joint joint="hinge" coef="2"/><joint joint="last" coef="-1"/>
      </fixed>
    </tendon>
    <actuator>
      <motor joint="ball" gear="1 2 3"/>
      <general joint="hinge" dyntype="filter" dynprm=".05" gaintype="affine" gainprm="2 .5 .3"
               biastype="affine" biasprm=".1 -2 -.5" gear="1.5"/>
      <general joint="slide" dyntype="integrator" actlimited="true" actrange="-.2 .2" biastype="affine"
               biasprm="0 -1 -.3" actearly="true"/>
      <general tendon="t" dyntype="filterexact" dynprm=".02" gear="2" biastype="affine" biasprm="0 -2 -.2"
               damping=".1 .2 .3" armature=".05"/>
      <motor joint="last" ctrlrange="-.5 .5" gear="2"/>
      <position joint="last" kp="3" kv=".2" forcerange="-1 1" damping=".1 .1 .1" armature=".02"/>
    </actuator></mujoco>"""


def clipped(integrator: str) -> str:
    """Joint limits on what the actuators exert together."""
    return f"""
    <mujoco><option timestep=".01" integrator="{integrator}"/>
    <worldbody><body><joint name="a" axis="0 1 0" actuatorfrcrange="-.6 .6"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1" contype="0"/>
      <body pos="0 0 -.3"><joint name="b" axis="0 1 0" actuatorfrcrange="-2 2" stiffness="1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1" contype="0"/></body>
    </body></worldbody>
    <actuator><position joint="a" kp="5" kv=".5"/><motor joint="a"/><velocity joint="b" kv=".4"/></actuator></mujoco>"""


def quadrotor(integrator: str) -> str:
    """A free body driven at sites: wrenches that move with it, and gyroscopic terms taken implicitly."""
    return f"""
    <mujoco><option timestep=".01" integrator="{integrator}"/>
    <worldbody><body><freejoint/><geom type="box" size=".1 .2 .03" mass="1" contype="0"/>
      <site name="a" pos=".1 .1 0"/><site name="b" pos="-.1 .1 0" euler="10 20 0"/></body></worldbody>
    <actuator><motor site="a" gear="0 0 1 0 0 .02"/><motor site="b" gear="0 0 1 0 .3 .02"/></actuator></mujoco>"""


def walker(integrator: str, cone: str, height: float = 0.36, soft: str = "") -> str:
    """Quadruped with position servos and spherical feet on a plane."""
    legs = servos = ""
    for leg, (x, y) in {"fl": (1, 1), "fr": (1, -1), "rl": (-1, 1), "rr": (-1, -1)}.items():
        joint = 'damping=".5" armature=".01"'
        still = 'contype="0" conaffinity="0"'
        legs += f"""
        <body pos="{0.2 * x} {0.1 * y} 0"><joint name="{leg}0" axis="1 0 0" {joint}/>
          <geom size=".03" mass=".5" {still}/>
          <body pos="0 {0.06 * y} 0"><joint name="{leg}1" axis="0 1 0" {joint}/>
            <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5" {still}/>
            <body pos="0 0 -.2"><joint name="{leg}2" axis="0 1 0" {joint}/>
              <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".015" mass=".2" {still}/>
              <geom name="{leg}" pos="0 0 -.2" size=".02" mass=".05" {soft}/></body></body></body>"""
        servos += "".join(f'<position joint="{leg}{k}" kp="60" kv="2"/>' for k in range(3))
    return f"""
    <mujoco><option timestep=".005" integrator="{integrator}" cone="{cone}" tolerance="0" iterations="200"
      ls_iterations="200" ls_tolerance="1e-10"/>
    <worldbody><geom type="plane" size="5 5 .1" {soft}/><body pos="0 0 {height}"><freejoint/>
      <geom type="box" size=".22 .1 .05" mass="8" contype="0" conaffinity="0"/>{legs}</body></worldbody>
    <actuator>{servos}</actuator></mujoco>"""


SHAPES = {
    "sphere": ('type="sphere" size=".1"', 0.095),
    "capsule": ('type="capsule" size=".05 .2" euler="80 10 30"', 0.08),
    "box": ('type="box" size=".1 .2 .05" euler="3 2 1"', 0.0495),
    "mesh": ('type="mesh" mesh="tetrahedron" euler="3 2 1"', 0.05),
    "cylinder": ('type="cylinder" size=".1 .05" euler="20 5 0"', 0.078),
}


def dropped(shape: str, integrator: str, cone: str, condim: int, soft: str = SOFT) -> str:
    """A shape with a pendulum in it, lying on a plane."""
    geom, height = SHAPES[shape]
    contact = f'condim="{condim}" friction="1 .05 .01" {soft}'
    return f"""
    <mujoco><option timestep=".004" integrator="{integrator}" cone="{cone}" impratio="2" tolerance="0"
      iterations="200" ls_iterations="200" ls_tolerance="1e-10"/>
    <asset><mesh name="tetrahedron" vertex="0 0 0  .2 0 .05  0 .2 .05  .1 .1 .3"/></asset>
    <worldbody><geom type="plane" size="5 5 .1" {contact}/>
      <body pos="0 0 {height}"><freejoint/><geom {geom} mass="1" {contact}/>
        <body pos=".1 .05 .1"><joint name="j" axis="0 1 0" damping=".1"/>
          <geom size=".05" mass=".5" contype="0" conaffinity="0"/></body></body></worldbody>
    <actuator><motor joint="j" gear=".1"/></actuator></mujoco>"""


def pair(integrator: str, cone: str) -> str:
    """A capsule that leans on a ball, both free."""
    return f"""
    <mujoco><option timestep=".004" integrator="{integrator}" cone="{cone}" tolerance="0" iterations="200"
      ls_iterations="200" ls_tolerance="1e-10"/>
    <worldbody><geom type="plane" size="5 5 .1" {SOFT}/>
      <body pos="0 0 .098"><freejoint/><geom size=".1" mass="1" {SOFT}/></body>
      <body pos="0 .03 .29"><freejoint/><geom type="capsule" size=".1 .1" euler="70 0 0" mass="1" {SOFT}/>
        <body pos="0 .1 .1"><joint name="j" axis="1 0 0" damping=".1"/>
          <geom type="box" size=".05 .05 .05" contype="0" conaffinity="0"/></body></body></worldbody>
    <actuator><motor joint="j"/></actuator></mujoco>"""


def limits(integrator: str) -> str:
    """Limits and dry friction of ball, hinge and slide joints and of a fixed tendon."""
    return f"""
    <mujoco><option timestep=".004" integrator="{integrator}" tolerance="0" iterations="200" ls_iterations="200"
      ls_tolerance="1e-10"/>
    <worldbody><body>
      <joint name="ball" type="ball" limited="true" range="0 20" frictionloss=".05" solimplimit="0 .95 .1"/>
      <geom type="box" size=".1 .2 .3" pos=".1 .05 .2" contype="0"/>
      <body pos="0 .2 .3">
        <joint name="hinge" axis="1 1 0" limited="true" range="-5 5" frictionloss=".3"/>
        <joint name="slide" type="slide" axis="0 1 1" damping=".3" limited="true" range="-.02 .02" frictionloss=".5"/>
        <geom type="capsule" size=".05 .2" pos="0 .1 0" contype="0"/>
        <body pos="0 0 .3"><joint name="last" axis="0 0 1" damping=".1"/>
          <geom type="box" size=".05 .1 .2" contype="0"/></body>
      </body></body></worldbody>
    <tendon><fixed name="t" limited="true" range="-.1 .05" frictionloss=".2">
      <joint joint="hinge" coef="2"/><joint joint="last" coef="-1"/></fixed></tendon>
    <actuator><motor joint="hinge" gear="5"/><motor joint="slide" gear="20"/><motor tendon="t"/></actuator></mujoco>"""


def linkage(integrator: str) -> str:
    """Connect, weld and joint equality constraints."""
    return f"""
    <mujoco><option timestep=".004" integrator="{integrator}" tolerance="0" iterations="200" ls_iterations="200"
      ls_tolerance="1e-10"/>
    <default><equality solimp=".5 .95 .1"/></default>
    <worldbody>
      <body><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" contype="0"/>
        <body name="y" pos=".3 0 0"><joint name="b" axis="0 1 0" damping=".1"/>
          <geom type="capsule" fromto="0 0 0 .3 0 .1" size=".02" contype="0"/></body></body>
      <body name="z" pos=".6 0 .1"><freejoint/><geom type="box" size=".1 .05 .03" contype="0"/>
        <body name="w" pos="0 0 .1"><joint name="c" axis="1 0 0"/>
          <geom type="box" size=".03 .05 .1" contype="0"/></body></body></worldbody>
    <equality><connect body1="y" body2="z" anchor=".3 0 .1"/><weld body1="w" body2="world" solref=".1 1"/>
      <joint joint1="a" joint2="b" polycoef="0 .5 .3 .1 0"/></equality>
    <actuator><motor joint="a"/><motor joint="c"/></actuator></mujoco>"""


def geared(integrator: str) -> str:
    """Joints that follow polynomials of others, as in grippers."""
    bodies = "".join(
        f'<body pos="0 0 -.2"><joint name="j{k}" axis="{k % 2} 1 0" damping=".1" ref="{10 * k}"/>'
        '<geom type="capsule" fromto="0 0 0 .05 0 -.2" size=".03" mass="1" contype="0"/>'
        for k in range(4)
    )
    return f"""
    <mujoco><option timestep=".004" integrator="{integrator}" tolerance="0" iterations="200" ls_iterations="200"
      ls_tolerance="1e-10"/>
    <worldbody>{bodies}{"</body>" * 4}</worldbody>
    <equality><joint joint1="j1" joint2="j0" polycoef="0 .5 .3 .2 .1"/><joint joint1="j2" polycoef=".1"/>
      <joint joint1="j3" joint2="j2" polycoef="0 -1" solref=".05 1"/></equality>
    <actuator><motor joint="j0"/><motor joint="j3"/></actuator></mujoco>"""


FRAME_SENSORS = ("framepos", "framequat", "framexaxis", "frameyaxis", "framezaxis", "framelinvel", "frameangvel")


def sensed(integrator: str, extra: str = "") -> str:
    """Two trees with every sensor that has a derivative in closed form."""
    frames = ""
    for kind in FRAME_SENSORS:
        for target in ('objtype="site" objname="s"', 'objtype="body" objname="low"', 'objtype="geom" objname="g"'):
            frames += f"<{kind} {target}/>"
            frames += f'<{kind} {target} reftype="site" refname="r"/><{kind} {target} reftype="xbody" refname="top"/>'
    subtrees = "".join(
        f'<{kind} body="{body}"/>'
        for kind in ("subtreecom", "subtreelinvel", "subtreeangmom")
        for body in ("low", "top")
    )
    return f"""
    <mujoco><option timestep=".005" integrator="{integrator}"/>
    <worldbody>
      <body name="top" pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .3" contype="0"/>
        <site name="r" pos=".1 0 .1"/>
        <body name="mid" pos=".2 .1 .3"><joint name="ball" type="ball" damping=".1"/>
          <geom name="g" type="box" size=".1 .05 .2" pos=".1 0 0" euler="10 20 30" contype="0"/>
          <body name="low" pos="0 .2 .3"><joint name="hinge" axis="1 1 0" damping=".1"/>
            <joint name="slide" type="slide" axis="0 1 1" pos=".1 0 0" damping=".3" actuatorfrcrange="-20 20"/>
            <geom type="box" size=".05 .2 .1" pos="0 .1 0" euler="40 0 0" contype="0"/>
            <site name="s" pos="0 .1 .2" euler="20 30 40"/></body></body></body>
      <body pos="2 0 0"><joint name="other" axis="0 1 0"/>
        <geom type="box" size=".1 .2 .1" pos=".1 0 0" contype="0"/></body>
    </worldbody>
    <tendon><fixed name="t"><joint joint="hinge" coef="2"/><joint joint="other" coef="-1"/></fixed></tendon>
    <actuator>
      <general name="a" joint="hinge" dyntype="filter" dynprm=".05" gaintype="affine" gainprm="2 .5 .3"
               biastype="affine" biasprm=".1 -2 -.5" gear="1.5"/>
      <position name="b" joint="slide" kp="3" kv=".2"/><motor name="c" joint="ball" gear="1 2 3"/>
      <motor name="d" joint="slide" gear="2"/>
    </actuator>
    <sensor>
      <jointpos joint="hinge"/><jointvel joint="slide"/><tendonpos tendon="t"/><tendonvel tendon="t"/>
      <actuatorpos actuator="a"/><actuatorvel actuator="b"/><actuatorfrc actuator="a"/><actuatorfrc actuator="c"/>
      <jointactuatorfrc joint="slide"/><ballquat joint="ball"/><ballangvel joint="ball"/>
      <velocimeter site="s"/><gyro site="s"/>{frames}{subtrees}
      <subtreecom body="world"/><subtreelinvel body="world"/>{extra}
    </sensor></mujoco>"""


HANDS = {
    "spheres": ('size=".06"', 'size=".05" pos="0 .005 -.1"'),
    "sphere and capsule": ('size=".06"', 'type="capsule" size=".05 .1" pos="0 0 -.1" euler="70 10 0"'),
    "crossed capsules": (
        'type="capsule" size=".05 .1" euler="20 60 0"',
        'type="capsule" size=".05 .1" pos="0 0 -.09" euler="70 10 0"',
    ),
    "capsules end to side": (
        'type="capsule" size=".05 .1" euler="10 20 0" pos="0 0 .1"',
        'type="capsule" size=".05 .1" pos="0 0 -.095" euler="70 10 0"',
    ),
    "sphere on face": ('size=".06"', 'type="box" size=".05 .06 .05" pos="0 0 -.108" euler="3 5 10"'),
    "sphere on edge": ('size=".06"', 'type="box" size=".05 .07 .05" pos="0 0 -.0743" euler="0 45 0"'),
    "sphere on corner": ('size=".06"', 'type="box" size=".05 .05 .05" pos="0 0 -.0584" euler="45 35.2644 0"'),
    "boxes": ('type="box" size=".06 .05 .05" euler="5 3 0"', 'type="box" size=".05 .05 .05" pos="0 0 -.0985"'),
}


def clasp(hands: str, integrator: str, cone: str, condim: int) -> str:
    """Two arms of one free body whose hands press on each other."""
    low, high = HANDS[hands]
    contact = f'condim="{condim}" friction="1 .05 .01" {SOFT} mass=".3"'
    return f"""
    <mujoco><option timestep=".004" integrator="{integrator}" cone="{cone}" impratio="2" tolerance="0"
      iterations="200" ls_iterations="200" ls_tolerance="1e-10"/>
    <worldbody><body pos="0 0 1" euler="10 20 30"><freejoint/>
      <geom type="box" size=".1 .1 .1" pos="-.3 0 0" contype="0" conaffinity="0"/>
      <body pos="-.3 .2 0"><joint name="a" axis="0 1 0" damping=".1"/><joint axis="1 .2 0" stiffness="50"/>
        <geom type="capsule" fromto="0 0 0 .3 -.2 0" size=".02" contype="0" conaffinity="0"/>
        <body pos="0.3 -.2 0"><joint type="ball" stiffness="5" damping=".1"/><geom {low} {contact}/></body></body>
      <body pos="-.3 -.2 .1"><joint name="b" axis="0 1 0" damping=".1"/><joint axis="0 0 1" stiffness="50"/>
        <geom type="capsule" fromto="0 0 0 .3 .2 0" size=".02" contype="0" conaffinity="0"/>
        <body pos="0.3 .2 .1"><geom {high} {contact}/></body></body>
    </body></worldbody>
    <actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""
