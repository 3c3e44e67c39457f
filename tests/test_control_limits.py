"""`Dynamics.control_limits`: whence each engine has them, and that MuJoCo clamps where they say so and nowhere else."""

import numpy as np
import pinocchio as pin
import pytest
from numba import njit

import mjslq

INF = np.inf
CARTPOLE = """
<mujoco><option timestep=".01" integrator="{integrator}"><flag clampctrl="{clamp}"/></option><worldbody>
  <body><joint name="cart" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="1"/>
    <body><joint name="pole" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.6" size=".03" mass=".3"/></body>
  </body></worldbody>
  <actuator><motor joint="cart" ctrlrange="-5 3"/><motor joint="pole" ctrlrange="-1 1" ctrllimited="false"/>
    <general joint="pole" dyntype="filter" dynprm=".1" ctrlrange="-.3 .7"/></actuator></mujoco>"""
LIMITS = [[-5.0, 3.0], [-INF, INF], [-0.3, 0.7]]


def cartpole(clamp="enable", integrator="Euler", **options):
    return mjslq.MujocoDynamics.from_xml(CARTPOLE.format(clamp=clamp, integrator=integrator), **options)


def test_mujoco_has_its_control_ranges():
    np.testing.assert_array_equal(cartpole().control_limits, LIMITS)


def test_mujoco_has_none_where_clamping_is_disabled():
    dynamics = cartpole("disable")
    np.testing.assert_array_equal(dynamics.control_limits, [[-INF, INF]] * 3)
    x0, U = np.zeros(5), np.tile([9.0, 0.0, 2.0], (4, 1))
    ours, clamped = dynamics.rollout(x0, U), cartpole().rollout(x0, U)
    assert np.abs(ours.X[-1] - clamped.X[-1]).max() > 0.01


def test_each_input_of_an_actuator_has_its_own():
    xml = """<mujoco><worldbody><body><joint name="a" type="ball"/><geom size=".1"/></body></worldbody><actuator>
      <orientation joint="a" kp="1" ctrlrange="-2 2"/><motor joint="a" gear="1 0 0"/></actuator></mujoco>"""
    dynamics = mjslq.MujocoDynamics.from_xml(xml)
    np.testing.assert_array_equal(dynamics.control_limits, [[-2.0, 2.0]] * 3 + [[-INF, INF]])


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_mujoco_leaves_controls_alone_that_keep_to_the_limits(integrator):
    """To the last bit, on the limits and inside of them: with and without clamping the motion is the same."""
    limits, rng = np.array(LIMITS), np.random.default_rng(0)
    U = rng.normal(size=(60, 3)) * 4.0
    inside = np.minimum(np.maximum(U, limits[:, 0]), limits[:, 1])
    clamped, free = cartpole("enable", integrator), cartpole("disable", integrator)
    assert 20 < (inside != U).sum() < 100
    ours = clamped.rollout(np.zeros(5), inside)
    np.testing.assert_array_equal(ours.X, free.rollout(np.zeros(5), inside).X)
    np.testing.assert_array_equal(ours.X, clamped.rollout(np.zeros(5), U).X)
    assert np.abs(ours.X[-1] - free.rollout(np.zeros(5), U).X[-1]).max() > 0.01


@pytest.mark.parametrize("jacobian", ["inverse", "transition"])
def test_on_a_limit_the_jacobian_is_that_from_inside(jacobian):
    """A box-constrained step may leave a limit: B must not be zero there, nor half of what it is."""
    limits = np.array(LIMITS)
    U = np.array([[limits[0, 0], 0.2, limits[2, 1]], [limits[0, 1], 0.2, limits[2, 0]]])
    clamped, free = cartpole(jacobian=jacobian), cartpole("disable", jacobian=jacobian)
    ours, theirs = (d.linearize(d.rollout(np.full(5, 0.1), U)) for d in (clamped, free))
    assert (np.abs(theirs.B).max(axis=1) > 1e-3).all()
    for name in ("A", "B"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=0, atol=1e-9)


def test_pinocchio_has_the_efforts_of_the_file(tmp_path):
    links = "".join(f'<link name="l{i}"><inertial><mass value="1"/><origin xyz="0 0 .1"/><inertia ixx="1" iyy="1"'
                    ' izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>' for i in range(1, 4))  # fmt: skip
    efforts = ('<limit effort="7" velocity="1"/>', '<limit effort="0" velocity="1"/>', "")
    joints = "".join(f'<joint name="j{i}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/>'
                     f'<axis xyz="0 1 0"/>{effort}</joint>' for i, effort in enumerate(efforts))  # fmt: skip
    file = tmp_path / "three.urdf"
    file.write_text(f'<robot name="three"><link name="l0"/>{links}{joints}</robot>')
    dynamics = mjslq.PinocchioDynamics.from_path(file, 0.01)
    np.testing.assert_array_equal(dynamics.control_limits, [[-7.0, 7.0], [-INF, INF], [-INF, INF]])
    one = mjslq.PinocchioDynamics.from_path(file, 0.01, actuated=("j1", "j0"))
    np.testing.assert_array_equal(one.control_limits, [[-INF, INF], [-7.0, 7.0]])


def test_pinocchio_takes_efforts_that_differ_by_side():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "j")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.1, 0.0, 0.2]), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.lowerEffortLimit, model.upperEffortLimit = np.zeros(1), np.array([4.0])
    dynamics = mjslq.PinocchioDynamics.from_model(model, 0.01)
    np.testing.assert_array_equal(dynamics.control_limits, [[0.0, 4.0]])


@pytest.mark.parametrize(
    "given, wanted",
    [
        (None, [[-INF, INF], [-INF, INF]]),
        ((-1, 2), [[-1, 2], [-1, 2]]),
        (([-1, -INF], 2.0), [[-1, 2], [-INF, 2]]),
        (np.array([[-1, 1], [0, INF]]), [[-1, 1], [0, INF]]),
        ([[-1, 1], [3, 3]], [[-1, 1], [3, 3]]),
    ],
)
def test_functions_have_what_they_are_given(given, wanted):
    dynamics = mjslq.FunctionDynamics(lambda x, u: x, 2, 2, 0.1, control_limits=given)
    np.testing.assert_array_equal(dynamics.control_limits, wanted)


@pytest.mark.parametrize(
    "given, sentence",
    [
        ((1, -1), "control_limits must have lower <= upper, but control 0 has 1.0 and -1.0"),
        (([0, np.nan], 1), "lower <= upper, but control 1 has nan and 1.0"),
        ((-1, 0, 1), r"must be \(lower, upper\) or an array \(2, 2\), got 3 entries"),
        ((-1, [1, 2, 3]), r"control_limits\[1\] must be a number or an array \(2,\), got shape \(3,\)"),
        (5.0, r"must be \(lower, upper\) or an array \(2, 2\), got shape \(\)"),
        ([[0, 1, 2]], r"must be \(lower, upper\) or an array \(2, 2\), got shape \(1, 3\)"),
        ("wide", "must be an array of numbers"),
        ((0, "wide"), r"control_limits\[1\] must be an array of numbers"),
    ],
)
def test_functions_refuse_what_is_no_limit(given, sentence):
    with pytest.raises(ValueError, match=sentence):
        mjslq.FunctionDynamics(lambda x, u: x, 2, 2, 0.1, control_limits=given)


def test_limits_are_not_the_callers_array():
    given = np.array([[-1.0, 1.0]])
    dynamics = mjslq.FunctionDynamics(njit(lambda x, u: x * u[0]), 1, 1, 0.1, control_limits=given)
    given[:] = 0.0
    np.testing.assert_array_equal(dynamics.control_limits, [[-1.0, 1.0]])
