"""Differences of the step next to kinks: a contact that opens nearer by than the size of the differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjslq.dynamics.mujoco import MujocoDynamics

HEIGHT = 0.1
DROP = """<mujoco><option timestep="1e-4" integrator="{}" noslip_iterations="3"/><worldbody>
  <geom type="plane" size="5 5 1"/><body><joint name="z" type="slide" axis="0 0 1"/><geom size=".1" mass="1e-3"/></body>
  </worldbody><actuator><motor joint="z" ctrlrange="0 1"/></actuator>
  <sensor><jointpos joint="z"/><accelerometer site="s"/></sensor></mujoco>""".replace(
    '<geom size=".1" mass="1e-3"/>', '<geom size=".1" mass="1e-3"/><site name="s"/>'
)


def drop(integrator: str, above: float) -> tuple[MujocoDynamics, np.ndarray]:
    """A ball so far above the ground."""
    dynamics = MujocoDynamics.from_xml(DROP.format(integrator), jacobian="transition", threads=1)
    return dynamics, np.array([HEIGHT + above, 0.0])


def one_sided(dynamics: MujocoDynamics, x: np.ndarray, column: int, eps: float) -> np.ndarray:
    e = np.zeros(2)
    e[column] = eps
    return (dynamics.step(x + e, np.zeros(1))[0] - dynamics.step(x, np.zeros(1))[0]) / eps


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
@pytest.mark.parametrize("above", [4e-7, -4e-7, 1.2e-7])
def test_a_contact_close_by_is_not_stepped_over(above, integrator):
    dynamics, x = drop(integrator, above)
    A = dynamics.linearize(dynamics.rollout(x, np.zeros((1, 1)))).A[0]
    sides = [one_sided(dynamics, x, 0, eps)[1] for eps in (1e-9, -1e-9)]
    assert sides[0] == pytest.approx(sides[1], rel=1e-2, abs=1e-3)
    assert A[1, 0] == pytest.approx(sides[0], rel=1e-2, abs=1e-3)


def test_what_plain_centred_differences_make_of_it():
    """mjd_transitionFD steps over the contact with the same eps: half of its stiffness, where there is none."""
    dynamics, x = drop("Euler", 4e-7)
    model, data = dynamics.model, mujoco.MjData(dynamics.model)
    data.qpos[:], A = x[:1], np.zeros((2, 2))
    mujoco.mjd_transitionFD(model, data, 1e-6, 1, A, None, None, None)
    ours = dynamics.linearize(dynamics.rollout(x, np.zeros((1, 1)))).A[0]
    assert abs(A[1, 0]) > 0.01 and abs(ours[1, 0]) < 1e-6


def test_a_kink_at_the_knot_itself_has_the_mean_of_both_sides():
    text = """<mujoco><option timestep=".01" gravity="0 0 0"/><worldbody><body><joint name="a" axis="0 1 0"/>
      <geom size=".1" pos=".3 0 0" contype="0"/></body></worldbody><tendon>
      <fixed stiffness="10" springlength="0 1"><joint joint="a" coef="1"/></fixed></tendon>
      <actuator><motor joint="a"/></actuator></mujoco>"""
    dynamics = MujocoDynamics.from_xml(text, jacobian="transition", threads=1)
    A = dynamics.linearize(dynamics.rollout(np.zeros(2), np.zeros((1, 1)))).A[0]
    sides = [one_sided(dynamics, np.zeros(2), 0, eps)[1] for eps in (1e-6, -1e-6)]
    assert sides[0] == pytest.approx(0.0, abs=1e-9) and sides[1] < -0.2
    assert A[1, 0] == pytest.approx(0.5 * (sides[0] + sides[1]), rel=1e-6)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
def test_far_from_kinks_they_are_centred_differences_of_outputs_too(integrator):
    dynamics, x = drop(integrator, 1.0)
    trajectory = dynamics.rollout(x, np.full((3, 1), 0.5))
    A, B, C, D = dynamics.linearize(trajectory)
    np.testing.assert_allclose(A, np.tile([[1.0, 1e-4], [0.0, 1.0]], (3, 1, 1)), atol=1e-8)
    np.testing.assert_allclose(B[:, 1, 0], 0.1, rtol=1e-7)
    np.testing.assert_allclose(C[:, 0], np.tile([1.0, 0.0], (4, 1)), atol=1e-8)
    np.testing.assert_allclose(D[:, 3, 0], [1000.0, 1000.0, 1000.0, 0.0], rtol=1e-7)


def test_controls_at_a_limit_are_moved_to_the_inside():
    for integrator in ("Euler", "RK4"):
        dynamics, x = drop(integrator, 1.0)
        B = dynamics.linearize(dynamics.rollout(x, np.array([[0.0], [0.5], [1.0], [1.5]]))).B[:, 1, 0]
        np.testing.assert_allclose(B, [0.1, 0.1, 0.1, 0.0], atol=1e-7)
