"""Models of two bodies that touch or are tied to each other, for tests of the Jacobians through inverse dynamics."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np

from mjslq.validation import Array

_rng = np.random.default_rng(0)
_corners = _rng.normal(size=(30, 3))
_corners *= np.array([0.1, 0.08, 0.06]) / np.linalg.norm(_corners, axis=1)[:, None]
_heights = _rng.uniform(size=100)
STILL = 'contype="0" conaffinity="0"'
EXACT = 'tolerance="0" iterations="200" ls_iterations="200" ls_tolerance="1e-10"'

GEOMS = {
    "plane": 'type="plane" size="1 1 .1"',
    "hfield": 'type="hfield" hfield="hills"',
    "sphere": 'size=".08"',
    "capsule": 'type="capsule" size=".05 .1"',
    "ellipsoid": 'type="ellipsoid" size=".1 .07 .05"',
    "cylinder": 'type="cylinder" size=".08 .06"',
    "box": 'type="box" size=".1 .08 .05"',
    "mesh": 'type="mesh" mesh="stone"',
    "sdf": 'type="sdf" mesh="stone"',
}
GROUND = ("plane", "hfield")
PAIRS = [
    (a, b) for a, b in itertools.combinations_with_replacement(GEOMS, 2) if b not in GROUND and "sdf" not in (a, b)
]


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def two_geoms(
    first: str, second: str, turned: Array, pose: Array, *, one_tree: bool = False, contact: str = "", option: str = ""
) -> str:
    """Model of a geom "A" with the orientation `turned`, and a geom "B" with a pose, on moving bodies with arms."""
    options = {"timestep": ".004", "integrator": "implicitfast", "cone": "elliptic"}
    options |= dict(pair.split("=") for pair in option.split())
    head = " ".join(f'{name}="{value}"' for name, value in options.items())
    arm = (
        '<body pos=".1 .05 .15"><joint name="{}" axis="0 1 .3" damping=".1"/>'
        f'<geom size=".04" mass=".3" {STILL}/></body>'
    )
    A = f'<geom name="A" {GEOMS[first]} {"" if first in GROUND else "mass=" + repr("1")} {contact}/>'
    B = f'<geom name="B" {GEOMS[second]} mass="1" {contact}/>'
    place, quat = f'pos="{_text(pose[:3])}"', f'quat="{_text(pose[3:])}"'
    if one_tree:
        bodies = f"""<body><freejoint/><geom type="box" size=".05 .05 .05" pos="0 0 -.5" {STILL}/>
          <body pos="0 0 -.2"><joint axis="1 0 .3" stiffness="10"/><geom size=".03" {STILL}/>
            <body pos="0 0 .2" quat="{_text(turned)}"><joint type="ball" damping=".1"/>{A}</body></body>
          <body {place}><joint axis="0 1 1" name="j"/><joint type="slide" axis="1 0 0"/>
            <geom size=".03" pos=".2 0 0" {STILL}/><body {quat}><joint axis="1 2 3"/>{B}</body></body></body>"""
    else:
        own = f'<body quat="{_text(turned)}"><freejoint/>{A}{arm.format("i")}</body>'
        bodies = (A if first in GROUND else own) + f"<body {place} {quat}><freejoint/>{B}{arm.format('j')}</body>"
    return f"""<mujoco><option gravity="0 0 -1" impratio="2" {head} {EXACT}/>
      <asset><mesh name="stone" vertex="{_text(_corners)}"/>
        <hfield name="hills" nrow="10" ncol="10" size=".3 .3 .1 .1" elevation="{_text(_heights)}"/></asset>
      <worldbody>{bodies}</worldbody><actuator><motor joint="j"/></actuator></mujoco>"""


def touching(first: str, second: str, seed: int, depth: float = 4e-3, aligned: bool = False, **options: object) -> str:
    """Like `two_geoms`, in random poses (or, aligned, one upon the other), a little inside each other."""
    rng = np.random.default_rng(seed)
    turned, quat, way = (
        part / np.linalg.norm(part) for part in (rng.normal(size=4), rng.normal(size=4), rng.normal(size=3))
    )
    if aligned:
        turned, quat = np.eye(4)[0], np.append(1.0, 3e-3 * rng.normal(size=3))
    aside = np.append(rng.uniform(-0.1, 0.1, 2), 0.0) if first == "hfield" else np.zeros(3)
    way = np.eye(3)[2] if aligned or first in GROUND else way
    model = mujoco.MjModel.from_xml_string(two_geoms(first, second, turned, np.append(way, quat), **options))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    B = model.geom("B")
    # the compiler moves a mesh within its body
    shift = data.geom_xpos[B.id] - data.xpos[B.bodyid[0]]

    def place(distance: float) -> Array:
        return data.geom_xpos[model.geom("A").id] + distance * way + aside

    near, far = 0.0, 1.2
    for _ in range(40):
        between = 0.5 * (near + far)
        data.geom_xpos[B.id] = place(between)
        mujoco.mj_collision(model, data)
        near, far = (between, far) if data.ncon else (near, between)
    return two_geoms(first, second, turned, np.append(place(near - depth) - shift, quat), **options)


TIES = {
    "connect bodies": '<connect body1="hand" body2="box" anchor=".3 0 .1"/>',
    "connect to the world": '<connect body1="hand" anchor=".3 0 .1"/>',
    "connect sites": '<connect site1="in hand" site2="in box"/>',
    "connect within a tree": '<connect body1="hand" body2="tail" anchor=".1 .2 .3"/>',
    "connect to an ancestor": '<connect body1="hand" body2="trunk" anchor=".1 .2 .3"/>',
    "weld bodies": '<weld body1="lid" body2="hand" anchor=".1 .2 .3" torquescale=".3"/>',
    "weld to the world": '<weld body1="lid" torquescale="3"/>',
    "weld far off": '<weld body1="lid" body2="arm" relpose=".1 .2 .3 .8 .2 .1 .3" anchor=".1 .1 .1"/>',
    "weld sites": '<weld site1="in box" site2="in hand" torquescale="2"/>',
    "weld within a tree": '<weld site1="in tail" site2="in hand"/>',
    "weld to a site of the world": '<weld site1="fixed" site2="in hand"/>',
    "weld to an ancestor": '<weld body1="trunk" body2="hand" relpose=".1 .2 .3 .8 .2 .1 .3"/>',
    "two tendons": '<tendon tendon1="s" tendon2="t" polycoef=".1 .5 .3 .2 .1"/>',
    "one tendon": '<tendon tendon1="s" polycoef=".1"/>',
    "two joints": '<joint joint1="wrist" joint2="hinge" polycoef=".1 .5 .3 .2 .1"/>',
}


def tied(tie: str, integrator: str, jacobian: str, parameters: str) -> str:
    """A tree with two branches and another tree, held by one equality constraint."""
    rod = f'<geom type="capsule" fromto="0 0 0 {{}}.2 0 .1" size=".02" {STILL}/>'
    return f"""<mujoco><option timestep=".004" integrator="{integrator}" jacobian="{jacobian}" {EXACT}/>
    <default><equality {parameters}/></default>
    <worldbody><site name="fixed" pos=".1 .2 .3" euler="10 20 30"/>
      <body name="trunk" pos="0 0 .5" euler="10 20 30"><freejoint/><geom type="box" size=".1 .05 .08" {STILL}/>
        <body name="arm" pos=".2 0 0"><joint type="ball" damping=".1"/>{rod.format("")}
          <body name="hand" pos=".2 0 .1"><joint name="wrist" axis="0 1 .2" damping=".1"/>
            <joint type="slide" axis="0 1 1"/>{rod.format("")}
            <site name="in hand" pos=".2 .02 .1" euler="3 20 -80"/></body></body>
        <body name="tail" pos="-.2 0 0"><joint name="root" axis="0 1 .2" damping=".1"/>{rod.format("-")}
          <site name="in tail" pos="-.2 .02 .1" euler="3 50 -80"/></body></body>
      <body name="box" pos=".6 0 .1"><freejoint/><geom type="box" size=".1 .05 .03" {STILL}/>
        <site name="in box" pos=".2 .02 .1" euler="3 20 -80"/>
        <body name="lid" pos="0 0 .1"><joint name="hinge" axis="1 0 0"/>
          <geom type="box" size=".03 .05 .1" {STILL}/></body></body></worldbody>
    <tendon><fixed name="s"><joint joint="wrist" coef="2"/><joint joint="root" coef="-1"/></fixed>
      <fixed name="t"><joint joint="hinge" coef=".5"/><joint joint="root" coef="1"/></fixed></tendon>
    <equality>{TIES[tie]}</equality><actuator><motor joint="wrist"/><motor joint="hinge"/></actuator></mujoco>"""
