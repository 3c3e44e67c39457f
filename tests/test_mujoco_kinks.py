"""Derivatives where pieces of a law meet, and how the derivative check tells kinks from mistakes."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from mjslq import FunctionDynamics
from mjslq.cli import app
from mjslq.dynamics.derivative_check import compare_jacobians, fine_reference
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.dynamics.mujoco.inverse.forces.muscles import muscle_gain, muscle_rate
from mjslq.dynamics.mujoco.inverse.table import columns

SPRING = """<mujoco><option timestep="0.01" gravity="0 0 0" integrator="{integrator}"/><worldbody>
  <site name="w" pos=".3 0 0"/><body><joint name="a" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1" contype="0" conaffinity="0"/>
  <site name="s" pos="0 0 -.4"/></body></worldbody>
  <tendon>{tendon}</tendon><actuator><motor joint="a"/></actuator></mujoco>"""
TENDONS = {
    "fixed": '<fixed stiffness="10" {}><joint joint="a" coef="1"/></fixed>',
    "polynomial": '<fixed stiffness="10 3 5" {}><joint joint="a" coef="1"/></fixed>',
    "spatial": '<spatial stiffness="10 3 5" {}><site site="w"/><site site="s"/></spatial>',
}
BANDS = {"fixed": 'springlength="0 .5"', "polynomial": 'springlength="0 .5"', "spatial": 'springlength=".5 .9"'}
RIGHT = {"fixed": -1.77292581, "polynomial": -1.77292581, "spatial": -0.10212053}
"""A[1, 0] of the arm at rest with a band of no width; without the spring's stiffness it is 0."""


def at_rest(integrator: str, tendon: str, band: str = "") -> tuple[MujocoDynamics, np.ndarray, np.ndarray]:
    text = SPRING.format(integrator=integrator, tendon=TENDONS[tendon].format(band))
    dynamics = MujocoDynamics.from_xml(text, jacobian="inverse", threads=1)
    trajectory = dynamics.rollout(np.zeros(2), np.zeros((1, 1)))
    return dynamics, dynamics.linearize(trajectory).A[0], fine_reference(dynamics, trajectory, 1e-6).A[0]


ALL_INTEGRATORS = ["Euler", "implicit", "implicitfast", "discrete"]
AT_REST = [(tendon, integrator) for tendon in TENDONS for integrator in ALL_INTEGRATORS]
AT_REST.remove(("spatial", "discrete"))  # which takes no moving moment arms


@pytest.mark.parametrize("tendon, integrator", AT_REST)
def test_a_tendon_spring_at_rest_has_its_stiffness(tendon, integrator):
    dynamics, ours, fine = at_rest(integrator, tendon)
    if integrator == "discrete":  # MuJoCo leaves the spring out of its metric at that one point: look beside it
        fine = fine_reference(dynamics, dynamics.rollout([1e-5, 0.0], np.zeros((1, 1))), 1e-6).A[0]
    implicit = 1.0 - 1e-2 * RIGHT[tendon] if integrator == "discrete" else 1.0  # M + h^2 k in place of M
    assert ours[1, 0] == pytest.approx(RIGHT[tendon] / implicit, rel=1e-7)
    np.testing.assert_allclose(ours, fine, atol=5e-5 if integrator == "discrete" else 1e-7)


@pytest.mark.parametrize("tendon", TENDONS)
def test_a_tendon_spring_at_the_edge_of_its_band_has_half_of_it(tendon):
    _, ours, fine = at_rest("implicitfast", tendon, BANDS[tendon])
    assert ours[1, 0] == pytest.approx(0.5 * RIGHT[tendon], rel=1e-7)
    np.testing.assert_allclose(ours, fine, atol=1e-5)


DRAG = """<mujoco><option timestep="0.01" integrator="{}" {}/><worldbody><body>
  <joint name="a" axis="0 1 0" damping="{}"/><geom type="box" size=".2 .1 .02" pos=".2 0 0" mass=".05"/></body>
  </worldbody><actuator><motor joint="a"/></actuator></mujoco>"""


DRAGS = [("", ".1 2", "Euler"), ("", ".1 2", "implicitfast"), ("", ".1 2", "discrete")]
DRAGS += [('density="1000"', "0", "Euler"), ('density="1000"', "0", "implicitfast")]  # discrete takes no fluids


@pytest.mark.parametrize("options, damping, integrator", DRAGS)
def test_quadratic_drag_at_rest_has_the_mean_of_both_sides(options, damping, integrator):
    """At rest under gravity the implicit part of the drag changes with |v|: slopes of either sign, zero on average."""
    text = DRAG.format(integrator, options, damping)
    dynamics = MujocoDynamics.from_xml(text, jacobian="inverse", threads=1)
    trajectory = dynamics.rollout(np.zeros(2), np.zeros((1, 1)))
    A, fine = dynamics.linearize(trajectory).A[0], fine_reference(dynamics, trajectory, 1e-7).A[0]
    np.testing.assert_allclose(A, fine, atol=1e-6)


def muscle(tau_smooth: float = 0.0) -> np.ndarray:
    prm = np.zeros(columns.MUSCLE_NUMBERS)
    prm[columns.MUSCLE_TIMES : columns.MUSCLE_TIMES + 3] = 0.01, 0.04, tau_smooth
    prm[columns.LENGTH_RANGE : columns.LENGTH_RANGE + 2] = 0.0, 1.0
    prm[columns.MUSCLE_GAIN : columns.MUSCLE_GAIN + 9] = 0.75, 1.05, 2.0, 200.0, 0.5, 1.6, 1.5, 1.3, 1.2
    return prm


def sides(function, x, eps=1e-7):
    return (function(x) - function(x - eps)) / eps, (function(x + eps) - function(x)) / eps


@pytest.mark.parametrize("a", [0.0, 0.3, 1.0])
def test_a_muscle_whose_control_meets_its_activation(a):
    """In between the mean of both sides; at an end the side from which the muscle comes: rising from none at all."""
    prm = muscle()
    _, by_u, by_a = muscle_rate(prm, a, a)
    down_u, up_u = sides(lambda u: muscle_rate(prm, u, a)[0], a)
    down_a, up_a = sides(lambda s: muscle_rate(prm, a, s)[0], a)
    expected = {0.0: (up_u, up_a), 1.0: (down_u, down_a)}.get(a, (0.5 * (down_u + up_u), 0.5 * (down_a + up_a)))
    np.testing.assert_allclose((by_u, by_a), expected, rtol=1e-5)
    if a == 0.0:
        assert by_u == pytest.approx(200.0)  # and not 12.5, with which it falls


def test_a_muscle_at_no_velocity():
    prm = muscle()
    second = muscle_gain(prm, 0.4, 0.0)[4]
    low, high = sides(lambda v: muscle_gain(prm, 0.4, v)[2], 0.0, 1e-6)
    assert second == pytest.approx(0.5 * (low + high), rel=1e-4) and low != pytest.approx(high)


# The check

DRAWER = """<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>
  <body><joint name="drawer" type="slide" axis="1 0 0" range="0 1" limited="true" damping="5"/>
    <geom type="box" size=".1 .1 .1" mass="1" contype="0" conaffinity="0"/></body>
  <body pos="0 1 0"><joint name="arm" axis="0 1 0" damping=".1"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1" contype="0" conaffinity="0"/></body>
  </worldbody><actuator><motor joint="arm"/></actuator></mujoco>"""
MASSLESS = """<robot name="r"><link name="base"/><link name="l1"><inertial><origin xyz="0 0 -.1"/><mass value="1"/>
  <inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial></link><link name="tip"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" effort="20" velocity="5"/></joint>
  <joint name="j2" type="revolute"><parent link="l1"/><child link="tip"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" effort="20" velocity="5"/></joint></robot>"""


@pytest.mark.parametrize("jacobian", ["inverse", "transition"])
def test_a_kink_at_every_knot_is_no_wrong_derivative(jacobian):
    dynamics = MujocoDynamics.from_xml(DRAWER, jacobian=jacobian, threads=1)
    check = dynamics.check_derivatives(dynamics.rollout(np.zeros(4), 0.1 * np.ones((5, 1))))
    assert check.suspects == [] and check.wrong == {"A": (), "B": ()}
    if jacobian == "inverse":  # the side that does not touch; differences to both sides give the mean
        assert check.kinks["A"] == (0, 1, 2, 3, 4) and check.errors["A"] > 0.1
        assert check.verdict.startswith("a kink at 5 of 5 knots: ")


def kinked(slope: float) -> FunctionDynamics:
    """x+ = x + u + max(x, 0): at x = 0 its derivative is 1 or 2; `slope` is what it is said to be."""
    return FunctionDynamics(
        lambda x, u, t: x + u + np.maximum(x, 0.0),
        1,
        1,
        0.1,
        integrator="map",
        jacobian=lambda x, u, t: (np.array([[slope]]), np.array([[1.0]])),
    )


@pytest.mark.parametrize("slope, right", [(1.0, True), (2.0, True), (1.5, True), (0.9, False), (2.1, False)])
def test_a_wrong_derivative_agrees_with_neither_side(slope, right):
    dynamics = kinked(slope)
    check = dynamics.check_derivatives(dynamics.rollout([0.0], np.zeros((3, 1))))
    assert (check.suspects == []) is right
    if right:
        assert check.kinks["A"] == (() if slope == 1.5 else (0, 1, 2))
    else:
        assert check.wrong["A"] == (0, 1, 2) and "A at 3 of 3 knots agrees with neither" in check.verdict


def test_without_the_sides_every_difference_counts():
    dynamics = kinked(1.0)
    trajectory = dynamics.rollout([0.0], np.zeros((3, 1)))
    assert compare_jacobians(dynamics.linearize(trajectory), fine_reference(dynamics, trajectory)).suspects == ["A"]


def test_check_says_kink_and_ends_well(tmp_path):
    (tmp_path / "drawer.xml").write_text(DRAWER)
    outcome = CliRunner().invoke(app, ["check", str(tmp_path / "drawer.xml"), "--steps", "4"])
    assert outcome.exit_code == 0 and "a kink at 4 of 4 knots" in outcome.output


def test_check_names_a_joint_that_moves_no_mass(tmp_path):
    (tmp_path / "tip.urdf").write_text(MASSLESS)
    outcome = CliRunner().invoke(app, ["check", str(tmp_path / "tip.urdf")])
    assert isinstance(outcome.exception, ValueError)
    assert "joint 'j2' moves no mass" in str(outcome.exception) and "j1" not in str(outcome.exception)


@pytest.mark.parametrize("slope, wrong", [(1.0, False), (50.0, False), (-1e9, True)])
def test_a_step_that_jumps_has_no_derivative_to_agree_with(slope, wrong):
    """x+ = x + 1 left of 0, x + 2 at 0, x + 3 right of it; what no difference comes near is wrong all the same."""
    dynamics = FunctionDynamics(
        lambda x, u, t: x + u + 2.0 + np.sign(x),
        1,
        1,
        0.1,
        integrator="map",
        jacobian=lambda x, u, t: (np.array([[slope]]), np.array([[1.0]])),
    )
    check = dynamics.check_derivatives(dynamics.rollout([0.0], -2.0 * np.ones((3, 1))))
    assert (check.suspects == ["A"]) is wrong
    if not wrong:
        assert check.jumps["A"] == (0, 1, 2) and check.verdict.startswith("a jump at 3 of 3 knots: ")


def test_a_constraint_solver_cut_short():
    """Its solution is differentiated, and the check says that the steps are not that yet."""
    dynamics = MujocoDynamics.from_xml(SLIDING.replace("<option ", '<option tolerance="0.1" '), threads=1)
    check = dynamics.check_derivatives(dynamics.rollout(start(dynamics), np.zeros((3, 0))))
    assert check.suspects == [] and check.unsolved["A"]
    assert "a constraint solver cut short at" in check.verdict
    solved = MujocoDynamics.from_xml(SLIDING, threads=1)
    assert not solved.check_derivatives(solved.rollout(start(solved), np.zeros((3, 0)))).unsolved["A"]


def start(dynamics: MujocoDynamics):
    x = dynamics.initial_state
    x[2], x[dynamics.model.nq : dynamics.model.nq + 6] = 0.099, (0.7, 0.3, -0.1, 0.2, 0.3, 0.5)
    return x


SLIDING = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 1"/>
  <body pos="0 0 .1"><freejoint/><geom type="box" size=".2 .1 .1" mass="1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("gap, slope", [(3e-7, 2.0), (3e-7, 0.0), (3e-7, 1.5), (1.0, 2.0)])
def test_a_kink_close_by_does_not_excuse_a_wrong_derivative(gap, slope):
    """x+ = x + u + max(x - gap, 0): at x = 0 its derivative is 1."""
    dynamics = FunctionDynamics(
        lambda x, u, t: x + u + np.maximum(x - gap, 0.0),
        1,
        1,
        0.1,
        integrator="map",
        jacobian=lambda x, u, t: (np.array([[slope]]), np.array([[1.0]])),
    )
    check = dynamics.check_derivatives(dynamics.rollout([0.0], np.zeros((1, 1))))
    assert check.jumps["A"] == ()
    assert check.suspects == ([] if slope == 1.5 else ["A"])
