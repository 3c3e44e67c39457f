"""Jacobians C, D of MuJoCo's sensors against a fine reference, sensor by sensor."""

from __future__ import annotations

import inverse_models as models
import mujoco
import numpy as np
import pytest
import sensor_models
from hypothesis import given
from hypothesis import strategies as st
from test_mujoco_inverse import STAND, dynamics_of, random_tree, some_trajectory

from mjslq.dynamics.derivative_check import fine_reference
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.dynamics.mujoco.inverse.readings.outputs import TYPES, sensors
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.trajectory import Trajectory


def kinds_of(dynamics: MujocoDynamics) -> np.ndarray:
    return sensors(dynamics.model)["sen_kind"]


def assert_sensors(
    dynamics: MujocoDynamics, trajectory: Trajectory, tolerance: float = 1e-6, eps: float = 1e-6, floor: float = 1e-2
) -> np.ndarray:
    """Each sensor by itself, relative to its own derivatives; returns which of them have any."""
    assert not trajectory.diverged
    ours, fine = dynamics.linearize(trajectory), fine_reference(dynamics, trajectory, eps)
    theirs = MujocoDynamics.from_model(
        dynamics.model, jacobian="transition", centered=False, substeps=dynamics.substeps, threads=1
    ).linearize(trajectory)
    model, alive = dynamics.model, np.zeros(dynamics.model.nsensor, bool)
    for s in range(model.nsensor):
        rows = slice(model.sensor_adr[s], model.sensor_adr[s] + model.sensor_dim[s])
        for name in ("C", "D"):
            our, exact, other = (getattr(part, name)[:, rows] for part in (ours, fine, theirs))
            scale = max(np.abs(exact).max(initial=0.0), floor)
            error = np.abs(our - exact).max(initial=0.0) / scale
            said = f"{name} of {TYPES[int(model.sensor_type[s])]} {s}: {error}"
            assert error < tolerance, said
            # 1e-6 is the noise of the reference itself, whose steps the solver ends where it may
            assert error <= max(np.abs(other - exact).max(initial=0.0) / scale, 1e-6), said
            alive[s] |= bool(np.abs(exact).max(initial=0.0) > floor)
    return alive


def sensed(xml: str, text: str) -> str:
    return xml.replace("</mujoco>", f"<sensor>{text}</sensor></mujoco>")


def test_every_type_of_sensor_is_there_and_known():
    dynamics = dynamics_of(sensor_models.laboratory("Euler"))
    there = {TYPES[int(kind)] for kind in dynamics.model.sensor_type}
    assert there == set(TYPES.values()) - {"plugin"}  # whose models are refused
    for text, wanted in (
        (sensor_models.ANALYTIC, lambda kind: kind > columns.CONSTANT),
        (sensor_models.CONSTANT, lambda kind: kind == columns.CONSTANT),
        (sensor_models.OWN_STAGE, lambda kind: kind == columns.BY_DIFFERENCES),
    ):
        assert all(map(wanted, kinds_of(dynamics_of(sensor_models.laboratory("Euler", sensors=text)))))


@pytest.mark.parametrize("height", [0.2, 2.0])
@pytest.mark.parametrize("integrator", models.CONTINUOUS)
def test_every_sensor(integrator, height):
    dynamics = dynamics_of(sensor_models.laboratory(integrator, height))
    trajectory = some_trajectory(dynamics, N=8, spread=0.15, speed=0.5, scale=0.5)
    alive = assert_sensors(dynamics, trajectory, tolerance=2e-6, floor=1e-1)
    names = {TYPES[int(kind)] for kind in dynamics.model.sensor_type[~alive]}
    still = {"user", "clock", "insidesite"} if height < 1.0 else {"touch", "contact", "tactile", "geomdist"}
    assert names <= still | {"user", "clock", "insidesite"}


FELT = """
  <touch site="zone"/><touch site="zone" cutoff="3"/><accelerometer site="s"/>
  <force site="inner"/><torque site="inner"/>
"""


def contact_sensors(geom: str, body: str) -> str:
    return f"""
    <contact geom1="{geom}" data="found force torque dist pos normal tangent linvel angvel" num="3"/>
    <contact geom2="{geom}" data="force torque dist pos normal tangent linvel angvel" num="2"/>
    <contact body1="{body}" data="found force dist pos" num="4" reduce="mindist"/>
    <contact geom1="{geom}" data="force dist" num="2" reduce="maxforce"/>
    <contact geom1="{geom}" data="found force normal" reduce="netforce"/>
    <contact geom2="{geom}" data="found force tangent" reduce="netforce"/>
    <contact subtree1="{body}" data="found force torque pos" reduce="netforce"/>
    <contact site="zone" subtree2="{body}" data="found force linvel" num="2"/><contact data="dist angvel"/>"""


def lying(shape: str, integrator: str, cone: str, condim: int) -> str:
    """A shape on a plane, as in `inverse_models`, with sensors for what it feels."""
    geom, height = models.SHAPES[shape]
    sites = '<site name="zone" type="box" size=".3 .3 .3"/><site name="s" pos=".1 .02 .05" euler="30 20 10"/>'
    xml = models.dropped(shape, integrator, cone, condim).replace(f"<geom {geom}", f'{sites}<geom name="g" {geom}')
    xml = xml.replace(f'<body pos="0 0 {height}">', f'<body name="b" pos="0 0 {height}">')
    xml = xml.replace('<joint name="j"', '<site name="inner" euler="10 20 30"/><joint name="j"')
    return sensed(xml, FELT + contact_sensors("g", "b"))


@pytest.mark.parametrize(
    ("shape", "integrator", "cone", "condim"),
    [("capsule", "Euler", "pyramidal", 3), ("box", "implicitfast", "elliptic", 3), ("box", "Euler", "pyramidal", 6),
     ("sphere", "implicit", "elliptic", 6), ("sphere", "Euler", "pyramidal", 1),
     ("cylinder", "implicitfast", "elliptic", 4)],
)  # fmt: skip
def test_contacts_with_a_plane(shape, integrator, cone, condim):
    dynamics = dynamics_of(lying(shape, integrator, cone, condim))
    alive = assert_sensors(dynamics, some_trajectory(dynamics, spread=0.0, speed=0.1), floor=1e-1)
    assert alive[0] and alive[2:].all()


@pytest.mark.parametrize(
    ("hands", "integrator", "cone", "condim"),
    [("spheres", "Euler", "pyramidal", 3), ("crossed capsules", "implicitfast", "elliptic", 3),
     ("sphere on edge", "implicit", "elliptic", 6), ("capsules end to side", "Euler", "elliptic", 4),
     ("boxes", "implicitfast", "pyramidal", 3)],
)  # fmt: skip
def test_contacts_of_moving_pairs(hands, integrator, cone, condim):
    low, high = models.HANDS[hands]
    sites = '<site name="zone" type="ellipsoid" size=".2 .2 .3"/><site name="s" euler="10 20 30" pos=".02 .03 .04"/>'
    xml = models.clasp(hands, integrator, cone, condim).replace(f"<geom {low}", f'{sites}<geom name="g" {low}')
    xml = xml.replace(f"<geom {high}", f'<site name="inner" euler="30 20 30"/><geom name="h" {high}')
    xml = xml.replace('<body pos="-.3 .2 0">', '<body pos="-.3 .2 0"><site name="root" pos=".1 0 0" euler="0 20 0"/>')
    xml = xml.replace('<body pos="0.3 .2 .1">', '<body name="b" pos="0.3 .2 .1">')
    more = '<force site="s"/><torque site="s"/><force site="root"/><torque site="root"/>'
    more += '<contact geom1="h" geom2="g" data="force pos normal tangent"/>'
    dynamics = dynamics_of(sensed(xml, FELT + contact_sensors("g", "b") + more))
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1, scale=0.1)
    assert assert_sensors(dynamics, trajectory, tolerance=2e-6, floor=1e-1)[[0, *range(2, 19)]].all()


@pytest.mark.parametrize("integrator", models.CONTINUOUS)
def test_limits(integrator):
    xml = models.limits(integrator).replace('range="-5 5"', 'range="-.1 .1"').replace('range="0 20"', 'range="0 2"')
    xml = xml.replace('range="-.1 .05"', 'range="-.01 .01"')
    text = "".join(
        f'<jointlimitpos joint="{j}"/><jointlimitvel joint="{j}"/><jointlimitfrc joint="{j}"/>'
        for j in ("ball", "hinge", "slide")
    )
    text += '<tendonlimitpos tendon="t"/><tendonlimitvel tendon="t"/><tendonlimitfrc tendon="t"/>'
    dynamics = dynamics_of(sensed(xml, text))
    trajectory = some_trajectory(dynamics, N=20, spread=0.3, scale=0.5)
    assert assert_sensors(dynamics, trajectory, tolerance=1e-5).all()


@pytest.mark.parametrize("integrator", models.CONTINUOUS)
def test_feet_that_touch_need_no_differences(integrator):
    """A quadruped with a touch sensor and a force sensor at each foot, and an inertial unit in its trunk."""
    xml = models.walker(integrator, "elliptic", soft=models.SOFT)
    xml = xml.replace('<body pos="0 0 0.36">', '<body pos="0 0 0.36"><site name="imu" pos=".1 0 0" euler="10 0 5"/>')
    text = '<accelerometer site="imu"/><gyro site="imu"/>'
    spec = mujoco.MjSpec.from_string(sensed(xml, text))
    feet = [geom for geom in spec.geoms if geom.name in ("fl", "fr", "rl", "rr")]
    assert len(feet) == 4
    for geom in feet:
        geom.parent.add_site(name=geom.name, pos=geom.pos, size=[0.05] * 3)
        for kind in (mujoco.mjtSensor.mjSENS_TOUCH, mujoco.mjtSensor.mjSENS_FORCE):
            spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=geom.name)
    dynamics = MujocoDynamics.from_spec(spec, jacobian="inverse", threads=1)
    assert sensors(dynamics.model)["sensors_differenced"] == 0
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1, scale=0.05, base=STAND, settle=200)
    assert assert_sensors(dynamics, trajectory).all()


@pytest.mark.parametrize("integrator", ["Euler", "implicit"])
def test_force_where_bodies_are_tied(integrator):
    """Connect and weld constraints pull at bodies: force and torque are differenced within their stage."""
    xml = models.linkage(integrator).replace(
        '<body name="w" pos="0 0 .1">', '<body name="w" pos="0 0 .1"><site name="s" euler="9 20 30"/>'
    )
    dynamics = dynamics_of(sensed(xml, '<force site="s"/><torque site="s"/><framelinacc objtype="site" objname="s"/>'))
    assert kinds_of(dynamics)[:2].tolist() == [columns.BY_DIFFERENCES] * 2
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1)
    assert assert_sensors(dynamics, trajectory, tolerance=1e-5).all()


@pytest.mark.parametrize("cutoff", [0.2, 5.0])
def test_readings_at_their_cutoff_do_not_change(cutoff):
    text = "".join(
        f'<{sensor} cutoff="{cutoff}"/>'
        for sensor in (
            'touch site="tip"', 'accelerometer site="tip"', 'framepos objtype="site" objname="tip"',
            'subtreeangmom body="arm"', 'jointvel joint="elbow"', 'actuatorfrc actuator="servo"', "e_kinetic",
        )
    )  # fmt: skip
    dynamics = dynamics_of(sensor_models.laboratory("implicitfast", sensors=text))
    trajectory = some_trajectory(dynamics, N=8, spread=0.15, speed=0.5, scale=0.5)
    cut = np.abs(trajectory.Y) >= cutoff
    assert cut.any() and not cut.all()
    alive = assert_sensors(dynamics, trajectory)
    assert alive.any()
    assert (dynamics.linearize(trajectory).C[cut] == 0.0).all()


def roped(integrator: str, extra: str = "") -> str:
    """The model with many sensors, and a spatial tendon that does nothing."""
    xml = models.sensed(integrator, extra).replace(' actuatorfrcrange="-20 20"', "")
    return xml.replace("<tendon>", '<tendon><spatial name="rope"><site site="s"/><site site="r"/></spatial>')


def test_spatial_tendons_and_site_actuators():
    """What has no closed form beside them: lengths of spatial tendons, actuator forces shared with sites."""
    xml = roped("implicitfast")
    xml = xml.replace('<motor name="c"', '<motor site="s" gear="1 2 3 0 0 0"/><motor name="c"')
    text = '<tendonpos tendon="rope"/><tendonvel tendon="rope"/><jointactuatorfrc joint="hinge"/><force site="s"/>'
    dynamics = dynamics_of(xml.replace("<sensor>", f"<sensor>{text}<e_kinetic/>"))
    assert (kinds_of(dynamics)[:5] == columns.BY_DIFFERENCES).all()
    assert assert_sensors(dynamics, some_trajectory(dynamics), eps=1e-5)[:5].all()


def test_disabled_sensors_read_nothing():
    xml = sensor_models.laboratory("Euler").replace("<option", "<option><flag sensor='disable'/></option><option", 1)
    dynamics = dynamics_of(xml)
    _, _, C, D = dynamics.linearize(some_trajectory(dynamics, N=2))
    assert not C.any() and not D.any()


def test_one_sided_differences_and_threads():
    xml = sensor_models.laboratory("implicit")
    centred = dynamics_of(xml)
    trajectory = some_trajectory(centred, N=9, spread=0.15, speed=0.5, scale=0.5)
    reference = centred.linearize(trajectory)
    one_sided = dynamics_of(xml, centered=False).linearize(trajectory)
    assert 0.0 < np.abs(one_sided.C - reference.C).max() < 1e-4 * np.abs(reference.C).max()
    several = MujocoDynamics.from_model(centred.model, jacobian="inverse", threads=4)
    for ours, theirs in zip(several.linearize(trajectory), reference, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_control_at_its_limit_has_the_inner_derivative():
    xml = roped("Euler", '<tendonpos tendon="rope"/><jointactuatorfrc joint="hinge"/>')
    xml = xml.replace(
        '<motor name="d" joint="slide"', '<motor site="s" gear="1 2 3 0 0 0"/><motor joint="hinge" ctrlrange="-1 1"'
    )
    dynamics = dynamics_of(xml)
    U = np.zeros((3, dynamics.nu))
    U[:, -1] = [1.0, 0.3, 1.5]
    D = dynamics.linearize(dynamics.rollout(dynamics.initial_state, U)).D[:, -1, -1]
    np.testing.assert_allclose(D[:3], [D[1], D[1], 0.0], atol=1e-8)
    assert D[1] == pytest.approx(2.0, abs=1e-8)


def test_the_report_says_what_serves_each_sensor():
    rows = [row for row in dynamics_of(sensor_models.laboratory("Euler")).support_report() if " sensors" in row[0]]
    (analytic, by), (constant, _), (differenced, _) = rows
    assert analytic == "39 sensors" and "analytic" in by
    assert constant == "3 sensors: clock, insidesite, user"
    assert "camprojection" in differenced and "accelerometer" not in differenced


@given(st.data())
def test_random_trees_with_sites_anywhere(data):
    spec = mujoco.MjSpec.from_string(random_tree(data.draw))
    bodies = [body for body in spec.bodies if body.name != "world"]
    number, S, site = st.floats(-0.5, 0.5, allow_subnormal=False), mujoco.mjtSensor, mujoco.mjtObj.mjOBJ_SITE
    for k in range(2):
        body = data.draw(st.sampled_from(bodies))
        body.add_site(name=f"s{k}", pos=[data.draw(number) for _ in range(3)], quat=[1.0, data.draw(number), 0.3, -0.2])
        for kind in (S.mjSENS_ACCELEROMETER, S.mjSENS_FORCE, S.mjSENS_TORQUE, S.mjSENS_MAGNETOMETER,
                     S.mjSENS_FRAMELINACC, S.mjSENS_FRAMEANGACC):  # fmt: skip
            spec.add_sensor(type=kind, objtype=site, objname=f"s{k}")
    spec.add_sensor(type=S.mjSENS_E_KINETIC)
    spec.add_sensor(type=S.mjSENS_E_POTENTIAL)
    dynamics = MujocoDynamics.from_spec(spec, jacobian="inverse", threads=1)
    assert_sensors(dynamics, some_trajectory(dynamics, N=2, spread=1.0), tolerance=1e-6, eps=1e-5, floor=1.0)
