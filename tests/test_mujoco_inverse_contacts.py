"""Contacts of any two geoms, and equality constraints, in the Jacobians through the inverse dynamics."""

from __future__ import annotations

from typing import Any

import contact_models as models
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjslq.dynamics.derivative_check import fine_reference
from mjslq.dynamics.dynamics import Linearization
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

WAYS = [
    {"one_tree": False, "option": "", "contact": 'solimp="0 .95 .02" solref=".02 1"'},
    {"one_tree": False, "option": "cone=pyramidal integrator=Euler", "contact": 'condim="1" solref=".05 1"'},
    {
        "one_tree": True,
        "option": "cone=pyramidal integrator=implicit",
        "contact": 'condim="6" friction="1 .05 .01" solref="-5000 -20"',
    },
    {"one_tree": True, "option": "jacobian=sparse", "contact": 'condim="4" friction=".3 .05" solimp=".3 .9 .05 .4 3"'},
]
"""Bodies in two trees or in one, cones, condim, stiff and soft contacts."""


def a_trajectory(dynamics: MujocoDynamics, N: int, spread: float, speed: float) -> Trajectory:
    rng = np.random.default_rng(0)
    nv = dynamics.model.nv
    push = np.append(spread * rng.normal(size=nv), speed * rng.normal(size=nv))
    start = dynamics.integrate(dynamics.initial_state, push)
    return dynamics.rollout(start, 0.1 * rng.normal(size=(N, dynamics.nu)))


def pushing_rows(dynamics: MujocoDynamics, trajectory: Trajectory) -> int:
    """Rows that push at the first knot."""
    model, data = dynamics.model, mujoco.MjData(dynamics.model)
    data.qpos, data.qvel = np.split(trajectory.X[0], [model.nq])
    mujoco.mj_forward(model, data)
    return int((np.abs(data.efc_force) > 1e-9).sum())


def errors_by_knot(
    xml: str, N: int = 2, spread: float = 0.0, speed: float = 0.01, widths: tuple[float, ...] = (1e-6, 1e-7)
) -> tuple[Array, Array]:
    """Relative errors of A and B at each knot, ours and those of one-sided differences of the step.

    Against fine references of several widths, of which the nearest counts: the others may straddle a kink.
    """
    dynamics = MujocoDynamics.from_xml(xml, jacobian="inverse", threads=1)
    trajectory = a_trajectory(dynamics, N, spread, speed)
    if pushing_rows(dynamics, trajectory) == 0:  # what flies apart one way comes together the other way
        trajectory = a_trajectory(dynamics, N, spread, -3.0 * speed)
    assert not trajectory.diverged and pushing_rows(dynamics, trajectory) > 0
    transition = MujocoDynamics.from_xml(xml, jacobian="transition", centered=False, threads=1)
    fine = [fine_reference(dynamics, trajectory, eps) for eps in widths]

    def errors(given: Linearization) -> Array:
        by_width = [
            [np.abs(getattr(given, m) - getattr(f, m)).max(axis=(1, 2)) / np.abs(getattr(f, m)).max() for m in "AB"]
            for f in fine
        ]
        return np.min(np.max(by_width, axis=1), axis=0)

    return errors(dynamics.linearize(trajectory)), errors(transition.linearize(trajectory))


def assert_exact(xml: str, tolerance: float = 1e-7, **options: Any) -> None:
    """Hold our errors below a bound, and below those of one-sided differences of the step."""
    ours, theirs = errors_by_knot(xml, **options)
    assert ours.max() < tolerance, ours
    assert (ours <= np.maximum(theirs, 1e-8)).all(), (ours, theirs)


ROUND = ("ellipsoid", "cylinder")


@pytest.mark.parametrize(("first", "second"), [pair for pair in models.PAIRS if not set(pair) & set(ROUND)])
def test_contacts_of_any_two_geoms(first, second):
    ways = WAYS[:2] if first in models.GROUND else WAYS
    for seed, way in enumerate(ways):
        assert_exact(models.touching(first, second, seed, **way))


@pytest.mark.parametrize("pair", [("plane", "ellipsoid"), ("plane", "cylinder"), ("sphere", "cylinder")])
def test_round_geoms_whose_contacts_mujoco_finds_by_formula(pair):
    for seed, way in enumerate(WAYS[:2] if pair[0] in models.GROUND else WAYS):
        assert_exact(models.touching(*pair, seed, **way))


def test_round_geoms_whose_contacts_mujoco_finds_by_iteration():
    # what stands in for their surfaces has kinks, some nearer than any difference is wide
    both = []
    for pair in models.PAIRS:
        if set(pair) & set(ROUND) and pair[0] != "plane":
            both += [errors_by_knot(models.touching(*pair, seed, **WAYS[0]), N=1) for seed in (0, 1)]
    ours, theirs = np.array(both)[:, :, 0].T
    assert np.median(ours) < 1e-7, np.sort(ours)
    assert np.mean(ours) < np.mean(theirs) and (ours < theirs).mean() > 0.7


@pytest.mark.parametrize("pair", [("box", "box"), ("box", "mesh"), ("cylinder", "cylinder"), ("plane", "cylinder")])
def test_geoms_that_lie_on_each_other(pair):
    for way in WAYS[:1] if pair[0] in models.GROUND else WAYS[:3]:
        assert_exact(models.touching(*pair, 0, aligned=True, **way), tolerance=1e-6)


@given(st.sampled_from([p for p in models.PAIRS if not set(p) & {*ROUND, *models.GROUND}]), st.integers(2, 10**6))
@settings(max_examples=10)
def test_random_poses(pair, seed):
    assert_exact(models.touching(*pair, seed, **WAYS[seed % len(WAYS)]), N=1)


@pytest.mark.parametrize("pair", [("box", "box"), ("box", "mesh"), ("sphere", "mesh")])
@pytest.mark.parametrize("detection", ['margin=".02" gap="-.005"', 'margin=".02" gap=".01"'])
def test_pairs_with_margin_and_gap(pair, detection):
    own = f'<contact><pair geom1="B" geom2="A" {detection} solimp="0 .9 .05"/></contact><actuator>'
    for aligned in (False, True):
        xml = models.touching(*pair, 0, depth=-3e-3, aligned=aligned)
        assert_exact(xml.replace("<actuator>", own))


def test_margin_and_gap_of_geoms():
    assert_exact(models.touching("box", "mesh", 0, contact='margin=".01" gap=".005" solimp="0 .9 .05"', depth=2.5e-2))


def test_signed_distance_fields():
    assert_exact(models.touching("mesh", "sdf", 0), N=1)


@pytest.mark.parametrize("tie", models.TIES)
def test_equality_constraints(tie):
    for integrator, jacobian, parameters in (
        ("Euler", "dense", 'solimp=".5 .95 .1"'),
        ("implicitfast", "dense", 'solimp=".3 .9 1.5" solref="-300 -20"'),
        ("implicit", "sparse", 'solimp=".9 .95 .001" solref=".01 1"'),
    ):
        xml = models.tied(tie, integrator, jacobian, parameters)
        assert_exact(xml, spread=0.2, speed=1.0, widths=(1e-5, 1e-6))


@given(st.sampled_from(sorted(models.TIES)), st.floats(0.1, 1.0), st.floats(0.1, 3.0))
@settings(max_examples=10)
def test_equality_constraints_far_from_satisfied(tie, spread, speed):
    xml = models.tied(tie, "implicitfast", "dense", 'solimp=".3 .9 1.5"')
    assert_exact(xml, N=1, spread=spread, speed=speed, widths=(1e-5, 1e-6))


CROSSED = """<mujoco><option timestep=".005"/><worldbody>
  <body><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".04"/></body>
  <body pos="0 0 -.2"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 {}" size=".03"/></body>
  </worldbody><actuator><motor joint="a"/></actuator></mujoco>"""


@pytest.mark.parametrize("end", [".2 0 .5", ".25 0 .4"])
def test_limbs_that_cross_in_a_plane(end):
    assert_exact(CROSSED.format(end), N=1, spread=0.05, speed=0.3, tolerance=1e-6)


def test_concentric_spheres_leave_no_trace_of_their_missing_normal():
    xml = """<mujoco><worldbody>
      <body><joint name="a" axis="0 1 0"/><geom size=".05" mass="1"/><geom pos=".1 0 0" size=".01"/></body>
      <body><joint type="slide" axis="1 0 0"/><geom size=".03" mass="1"/></body></worldbody>
      <actuator><motor joint="a"/></actuator></mujoco>"""
    dynamics = MujocoDynamics.from_xml(xml, jacobian="inverse", threads=1)
    trajectory = dynamics.rollout(np.array([0.1, 0.0, 0.0, 0.0]), np.zeros((1, 1)))
    assert np.isfinite(dynamics.linearize(trajectory).A).all()
