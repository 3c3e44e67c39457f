"""Jacobians of the smooth forces: muscles, fluids, moving moment arms, and what is left to differences."""

from __future__ import annotations

import inverse_force_models as models
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from inverse_models import CONTINUOUS
from test_mujoco_inverse import assert_exact, dynamics_of, some_trajectory

from mjslq.dynamics.derivative_check import compare_jacobians, fine_reference
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.dynamics.mujoco.inverse.cover import refusals
from mjslq.dynamics.mujoco.inverse.forces.muscles import muscle_bias, muscle_gain, muscle_rate
from mjslq.dynamics.mujoco.inverse.forces.unmodelled_forces import unmodelled_forces
from mjslq.dynamics.mujoco.inverse.readings.outputs import sensors
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.actuator_plan import actuator_table
from mjslq.trajectory import Trajectory


def trajectory_of(dynamics: MujocoDynamics, N: int = 5) -> Trajectory:
    """Roll out; muscles are kept at a middling activation, away from the kinks at none and full."""
    if (dynamics.model.actuator_gaintype == mujoco.mjtGain.mjGAIN_MUSCLE).any():
        return some_trajectory(dynamics, N, base=np.full(dynamics.nu, 0.5), settle=30, scale=0.1)
    return some_trajectory(dynamics, N, scale=0.5)


def assert_better_than_transition(dynamics: MujocoDynamics, trajectory: Trajectory, eps: float = 1e-5) -> None:
    reference = fine_reference(dynamics, trajectory, eps)
    other = MujocoDynamics.from_model(dynamics.model, jacobian="transition", threads=1, centered=False)
    ours = compare_jacobians(dynamics.linearize(trajectory), reference).errors
    theirs = compare_jacobians(other.linearize(trajectory), reference).errors
    assert all(ours[name] < max(theirs[name], 1e-8) for name in ours), (ours, theirs)


@pytest.mark.parametrize("integrator", CONTINUOUS)
@pytest.mark.parametrize("case", models.CLOSED)
def test_closed_forms(case, integrator):
    dynamics = dynamics_of(models.chain(integrator, **models.CLOSED[case]))
    rest = unmodelled_forces(dynamics.model)
    assert not (rest.exists or rest.moving_arm_tendons.any() or rest.moving_arm_actuators.any())
    trajectory = trajectory_of(dynamics)
    assert_exact(dynamics, trajectory, tolerance=1e-8)
    assert_better_than_transition(dynamics, trajectory)


@pytest.mark.parametrize("integrator", CONTINUOUS)
@pytest.mark.parametrize("case", models.ARMS)
def test_moving_moment_arms(case, integrator):
    dynamics = dynamics_of(models.chain(integrator, **models.ARMS[case]))
    rest = unmodelled_forces(dynamics.model)
    assert not rest.exists and (rest.moving_arm_tendons.any() or rest.moving_arm_actuators.any() or "branches" in case)
    trajectory = trajectory_of(dynamics)
    assert_exact(dynamics, trajectory, tolerance=2e-8)
    assert_better_than_transition(dynamics, trajectory)


@pytest.mark.parametrize("integrator", CONTINUOUS)
@pytest.mark.parametrize("case", models.REST)
def test_differences_of_their_own_forces(case, integrator):
    dynamics = dynamics_of(models.chain(integrator, **models.REST[case]))
    assert unmodelled_forces(dynamics.model).exists
    trajectory = trajectory_of(dynamics)
    assert_exact(dynamics, trajectory, tolerance=2e-8)
    assert_better_than_transition(dynamics, trajectory)


@pytest.mark.parametrize("integrator", CONTINUOUS)
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_beside_contacts_and_with_tendons_as_constraints(integrator, cone):
    dynamics = dynamics_of(models.tied(integrator, cone))
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1, base=np.array([0.5, 0.1, 0.0]), scale=0.05, settle=30)
    dynamics.linearize(trajectory)
    data = dynamics.simulator.data[0]
    kinds = set(data.efc_type.tolist())
    assert data.ncon and {int(mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON), 2} <= kinds
    assert_exact(dynamics, trajectory, tolerance=1e-6, eps=1e-6)
    assert_better_than_transition(dynamics, trajectory, eps=1e-6)


@pytest.mark.parametrize("integrator", CONTINUOUS)
def test_adhesion(integrator):
    dynamics = dynamics_of(models.sticky(integrator))
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1, base=np.array([0.5, 0.0]), scale=0.1, settle=20)
    assert_exact(dynamics, trajectory, tolerance=1e-6, eps=1e-6)
    assert np.abs(dynamics.linearize(trajectory).B[:, :, 0]).max() > 1e-4


@pytest.mark.parametrize("scale", [0.1, 0.02, 0.01])
def test_small_swimmers_meet_the_guard_of_implicit_integrators(scale):
    sizes = " ".join(str(scale * size) for size in (0.05, 0.08, 0.15))
    text = f"""<mujoco><option timestep=".004" integrator="implicitfast" density="1000" gravity="0 0 0"/>
      <worldbody><body><freejoint/><geom type="ellipsoid" size="{sizes}" {models.ELLIPSOID}/>
      <body pos="0 0 {0.3 * scale}"><joint name="j" axis="1 .3 0"/>
      <geom type="capsule" size="{sizes}" {models.ELLIPSOID} contype="0"/></body></body></worldbody>
      <actuator><motor joint="j" gear="{scale**4}"/></actuator></mujoco>"""
    dynamics = dynamics_of(text)
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=1e-7)


@pytest.mark.parametrize("integrator", CONTINUOUS)
@pytest.mark.parametrize("child", ["", '<joint name="j" axis="1 .3 0"/>'])
def test_lone_and_jointed_bodies_in_a_fluid(integrator, child):
    dynamics = dynamics_of(f"""<mujoco><option timestep=".004" integrator="{integrator}" {models.WATER}/>
      <worldbody><body><freejoint name="root"/>
      <geom type="ellipsoid" size=".1 .12 .15" density="200" {models.ELLIPSOID}/>
      <body pos=".1 0 -.15">{child}<geom size=".05" density="300" {models.ELLIPSOID}/></body></body></worldbody>
      <actuator><motor joint="root" gear="5 0 9 0 2 0"/></actuator></mujoco>""")
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=1e-8)


@pytest.mark.parametrize("integrator", CONTINUOUS)
@pytest.mark.parametrize("slide", models.SLIDES)
def test_slides_of_simple_bodies(slide, integrator):
    dynamics = dynamics_of(models.sliding(slide, integrator))
    assert (dynamics.model.dof_simplenum[:2] > 0).all()
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=2e-8)


def test_simple_bodies_in_a_fluid_are_refused_where_the_integrator_neglects_couplings():
    water = 'integrator="implicitfast" density="1000"'
    model = mujoco.MjModel.from_xml_string(models.sliding("damper").replace('integrator="Euler"', water))
    assert any("simple bodies" in reason for reason in refusals(model))


@pytest.mark.parametrize("flags", ['spring="disable"', 'damper="disable"', 'spring="disable" damper="disable"'])
def test_gravity_compensation_ends_with_the_other_passive_forces(flags):
    dynamics = dynamics_of(f"""<mujoco><option><flag {flags}/></option><worldbody>
      <body gravcomp="1"><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".04"/></body>
      </worldbody><actuator><motor joint="a"/></actuator></mujoco>""")
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=1e-8)


def test_fluid_at_rest_and_switched_off():
    dynamics = dynamics_of(models.chain("implicitfast", **models.CLOSED["swimmer"]))
    still = dynamics.rollout(dynamics.initial_state, np.zeros((2, 1)))
    assert np.isfinite(dynamics.linearize(still).A).all()
    flags = '<flag spring="disable" damper="disable"/></option>'
    xml = models.chain("implicit", options=models.WATER).replace('wind="1 .2 0"/>', 'wind="1 .2 0">' + flags)
    dynamics = dynamics_of(xml)
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=1e-8)


def test_controls_at_and_beyond_their_limits():
    servo = '<pid joint="a" kp="3" input="pos" posrange="-.5 .5"/>'
    for centered in (True, False):
        dynamics = dynamics_of(models.chain("implicitfast", servo), centered=centered)
        trajectory = dynamics.rollout(dynamics.initial_state, np.array([[0.5], [-0.5], [0.2], [0.51], [-3.0]]))
        B = dynamics.linearize(trajectory).B
        assert (np.abs(B[:3]).max(axis=(1, 2)) > 1e-3).all()  # on the border the inner derivative, beyond it none
        assert (B[3:] == 0.0).all()


def test_one_sided_differences_when_asked_for():
    for case in (models.ARMS["actuators, around a cylinder"], models.REST["controllers"]):
        xml = models.chain("implicitfast", **case)
        centred = dynamics_of(xml)
        trajectory = trajectory_of(centred)
        one_sided = dynamics_of(xml, centered=False).linearize(trajectory).A
        reference = centred.linearize(trajectory).A
        assert 0.0 < np.abs(one_sided - reference).max() < 1e-3 * np.abs(reference).max()


def test_sensors_of_moving_arms_are_differenced():
    reading = '<sensor><actuatorfrc actuator="p"/><jointactuatorfrc joint="a"/><tendonpos tendon="t"/>'
    reading += '<tendonvel tendon="t"/><actuatorpos actuator="p"/><actuatorvel actuator="p"/></sensor></mujoco>'
    servo = '<position name="p" tendon="t" kp="3" kv=".3"/>'
    xml = models.chain("implicitfast", servo, models.path("around a cylinder")).replace("</mujoco>", reading)
    dynamics = dynamics_of(xml)
    assert (sensors(dynamics.model)["sen_kind"] == columns.BY_DIFFERENCES).all()
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=1e-6)


@given(st.data())
def test_mixtures(data):
    """Any of the parts that have no kinks, together."""
    draw = data.draw
    tendon = draw(st.sampled_from(list(models.PATHS)))
    drives = ['<motor joint="a"/>', '<position tendon="t" kp="3" kv=".3"/>']
    for case in ("crank", "reference site", "site", "ball joint"):
        drives += [models.ARMS[case]["actuators"]] if draw(st.booleans()) else []
    for case in ("motors", "orientation"):
        drives += [models.REST[case]["actuators"]] if draw(st.booleans()) else []
    xml = models.chain(
        draw(st.sampled_from(CONTINUOUS)),
        "".join(drives),
        models.path(tendon, draw(st.sampled_from(["", 'stiffness="3"', 'damping=".3 .1"']))),
        options=draw(st.sampled_from(["", models.WATER])),
        geom=draw(st.sampled_from(["", models.ELLIPSOID])),
        floating=draw(st.booleans()),
        joint=draw(st.sampled_from(["", 'stiffness="2"'])),
    )
    dynamics = dynamics_of(xml)
    assert_exact(dynamics, some_trajectory(dynamics, N=2, spread=0.2), tolerance=1e-7)


NUMBER = st.floats(-0.2, 1.2, allow_subnormal=False)


@given(NUMBER, st.floats(-2.0, 2.0), NUMBER, NUMBER)
def test_muscles_are_those_of_mujoco(length, velocity, u, a):
    model = mujoco.MjModel.from_xml_string(models.chain("Euler", models.MUSCLES))
    prm = actuator_table(model)["act_muscle"]
    given_range, acc0 = model.actuator_lengthrange, model.actuator_acc0
    for i in (1, 2):
        ours = muscle_gain(prm[i], length, velocity)[0], muscle_bias(prm[i], length)[0]
        theirs = (
            mujoco.mju_muscleGain(length, velocity, given_range[i], acc0[i], model.actuator_gainprm[i, :9]),
            mujoco.mju_muscleBias(length, given_range[i], acc0[i], model.actuator_biasprm[i, :9]),
        )
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)
    for i in (0, 1):
        theirs = mujoco.mju_muscleDynamics(u, a, model.actuator_dynprm[i, :3])
        np.testing.assert_allclose(muscle_rate(prm[i], u, a)[0], theirs, rtol=1e-12, atol=1e-12)


def test_what_serves_the_forces_is_said():
    def rows(**case: str) -> dict[str, str]:
        return dict(dynamics_of(models.chain("implicitfast", **case)).support_report())

    assert rows(options=models.WATER)["fluid"] == "analytic"
    assert "moment arms" in rows(**models.ARMS["crank"])["forces of 1 actuators"]
    assert rows(**models.REST["motors"])["forces of 2 actuators"] == "differences of their own forces"


def test_actuators_with_several_inputs_have_names():
    dynamics = dynamics_of(models.chain("Euler", '<orientation name="o" joint="c"/><motor name="m" joint="a"/>'))
    assert dynamics.control_names == ("o.rx", "o.ry", "o.rz", "m")
