"""Rangefinders in the Jacobians through the inverse dynamics: surfaces that turn and move, rays that miss."""

import mujoco
import numpy as np
import pytest

from mjslq.dynamics.derivative_check import fine_reference
from mjslq.dynamics.mujoco import MujocoDynamics

GEOMS = {
    "plane": 'type="plane" size="5 5 .1"',
    "sphere": 'type="sphere" size=".5"',
    "capsule": 'type="capsule" size=".3 .4"',
    "box": 'type="box" size=".4 .5 .3"',
    "ellipsoid": 'type="ellipsoid" size=".4 .5 .3"',
    "cylinder": 'type="cylinder" size=".4 .3"',
    "mesh": 'type="mesh" mesh="stone"',
    "hfield": 'type="hfield" hfield="hills"',
}


def scene(geom: str, moving: bool, sensor: str = "") -> str:
    """A body with three sites, whose rays go up, down and aside, above a geom that moves or not."""
    below = f'<geom name="below" {GEOMS[geom]} contype="0" conaffinity="0" mass="2"/>'
    held = f'<body name="held" pos="0 0 -.2" euler="8 5 3">{"<freejoint/>" if moving else ""}{below}</body>'
    if geom == "plane":
        held = below.replace("mass", "pos='0 0 -.3' euler='4 7 0' mass")
    return f"""<mujoco><option timestep=".01"/><asset><mesh name="stone" builtin="sphere" params="1" scale=".4 .5 .3"/>
      <hfield name="hills" nrow="3" ncol="3" size="1 1 .3 .1" elevation="0 .2 .1 .3 .1 .5 .2 .6 .3"/></asset>
      <worldbody>{held}<body pos=".05 .03 .9" euler="3 -4 20"><freejoint/><geom size=".02" mass="1"/>
        <body pos="0 0 .1"><joint axis="0 1 .2"/><geom size=".05" pos=".1 0 0" contype="0" conaffinity="0"/>
          <site name="down" pos=".1 0 0" euler="180 0 0"/><site name="slanted" pos=".08 .04 0" euler="174 4 0"/>
          <site name="up"/></body></body></worldbody>
      <sensor><rangefinder site="down" {sensor}/><rangefinder site="slanted" {sensor}/><rangefinder site="up"/></sensor>
      </mujoco>"""


def motion(dynamics: MujocoDynamics, N: int = 3):
    x0 = dynamics.initial_state
    x0[-dynamics.model.nv :] = 0.4 * np.random.default_rng(3).normal(size=dynamics.model.nv)
    return dynamics.rollout(x0, np.zeros((N, 0)))


@pytest.mark.parametrize("geom, moving", [(geom, moving) for geom in GEOMS for moving in (False, True)
                                          if not (moving and geom in ("plane", "hfield"))])  # fmt: skip
def test_rays_on_surfaces(geom, moving):
    dynamics = MujocoDynamics.from_xml(scene(geom, moving), threads=1)
    trajectory = motion(dynamics)
    assert (trajectory.Y[:, :2] > 0.0).all() and (trajectory.Y[:, 2] == -1.0).all()
    C, fine = dynamics.linearize(trajectory).C, fine_reference(dynamics, trajectory, 1e-4).C
    assert np.abs(C[:, :2]).max() > 0.9 and (C[:, 2] == 0.0).all()
    np.testing.assert_allclose(C, fine, atol=2e-8 * np.abs(fine).max())


def test_readings_beyond_the_cutoff_do_not_change():
    middle = float(np.mean(motion(MujocoDynamics.from_xml(scene("box", True), threads=1)).Y[:, :2]))
    dynamics = MujocoDynamics.from_xml(scene("box", True, f'cutoff="{middle!r}"'), threads=1)
    trajectory = motion(dynamics)
    cut = trajectory.Y[:, :2] == middle
    assert cut.any() and not cut.all()
    C, fine = dynamics.linearize(trajectory).C, fine_reference(dynamics, trajectory, 1e-6).C
    assert (C[:, :2][cut] == 0.0).all()
    np.testing.assert_allclose(C, fine, atol=1e-7 * np.abs(fine).max())


def test_what_else_a_rangefinder_reports_is_differenced():
    dynamics = MujocoDynamics.from_xml(scene("box", True, 'data="dist point normal"'), threads=1)
    (served,) = [what for part, what in dynamics.support_report() if "rangefinder" in part]
    assert "differences of their own stage" in served
    trajectory = motion(dynamics)
    C, fine = dynamics.linearize(trajectory).C, fine_reference(dynamics, trajectory, 1e-4).C
    np.testing.assert_allclose(C, fine, atol=1e-7 * np.abs(fine).max())


def test_a_robot_that_looks_around(tmp_path):
    """A moving site and a moving target in one tree, whose common motion does not change the distance."""
    xml = """<mujoco><worldbody><body><freejoint/><geom size=".1"/><site name="eye" pos="0 0 .2"/>
      <body pos="0 0 1"><joint axis="1 .3 0" pos="0 .1 -.2"/><geom type="box" size=".3 .3 .1" euler="10 20 0"/></body>
      </body></worldbody><sensor><rangefinder site="eye"/></sensor></mujoco>"""
    dynamics = MujocoDynamics.from_xml(xml, threads=1)
    trajectory = motion(dynamics)
    C, fine = dynamics.linearize(trajectory).C, fine_reference(dynamics, trajectory, 1e-4).C
    assert np.abs(C[:, 0, :6]).max() < 1e-14 < 0.01 < np.abs(C[:, 0, 6]).min()
    np.testing.assert_allclose(C, fine, atol=1e-8)
    assert mujoco.mj_versionString() >= "4"
