"""Second derivatives in closed form against their slow twin: central differences of whole linearizations."""

from __future__ import annotations

import contact_models
import inverse_models as models
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from test_mujoco_inverse import STAND, dynamics_of, random_tree, some_trajectory
from test_second_derivatives import dense_hessian, total_hessian

from mjslq import Problem, costs, problems
from mjslq.dynamics import dynamics as base
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.rotation import right_jacobian, right_jacobian_slope
from mjslq.solvers.iterate import Iterate
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

ROWS = 1e-6
"""Width of the twin's differences where constraint rows push, whose impedance bends within millimetres."""


def is_analytic(dynamics: MujocoDynamics) -> bool:
    return dict(dynamics.support_report())["second derivatives"].startswith("analytic")


def some_costates(dynamics: MujocoDynamics, N: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(5)
    return rng.standard_normal((N + 1, dynamics.ndx)), rng.standard_normal((N + 1, dynamics.ny))


def assert_agree(
    dynamics: MujocoDynamics, trajectory: Trajectory, tolerance: float = 1e-7, width: float = 1e-5
) -> None:
    """Compare with the twin, whose differences have a width; relative to the largest entry of all."""
    costates, weights = some_costates(dynamics, trajectory.horizon)
    assert not trajectory.diverged and is_analytic(dynamics)
    ours = dynamics.hessian(trajectory, costates, weights)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(base, "DIFFERENCE", width)
        theirs = Dynamics.hessian(dynamics, trajectory, costates, weights)
    scale = max(np.abs(part).max(initial=0.0) for part in theirs)
    assert scale > 0.0
    for mine, twin in zip(ours, theirs, strict=True):
        assert mine.shape == twin.shape
        np.testing.assert_allclose(mine, twin, rtol=0.0, atol=tolerance * scale)
    np.testing.assert_array_equal(ours.xx, ours.xx.swapaxes(1, 2))


@pytest.mark.parametrize("integrator", models.CONTINUOUS)
@pytest.mark.parametrize("model", [models.arm, models.mixed, models.clipped, models.quadrotor, models.sensed])
def test_smooth_models(model, integrator):
    dynamics = dynamics_of(model(integrator))
    assert_agree(dynamics, some_trajectory(dynamics))


def test_euler_without_implicit_damping():
    xml = models.mixed("Euler").replace(
        'integrator="Euler"/>', 'integrator="Euler"><flag eulerdamp="disable"/></option>'
    )
    dynamics = dynamics_of(xml)
    assert_agree(dynamics, some_trajectory(dynamics))


@settings(max_examples=15)
@given(st.data())
def test_random_trees(data):
    xml = random_tree(data.draw)
    assume('"discrete"' not in xml)
    dynamics = dynamics_of(xml)
    trajectory = some_trajectory(dynamics, N=2, spread=1.0)
    # quadratic damping and springs bend at zero, within reach of the twin's differences only
    assume(np.abs(trajectory.X[:, dynamics.model.nq :]).min() > 1e-4)
    assert_agree(dynamics, trajectory, tolerance=1e-6)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("integrator", models.CONTINUOUS)
def test_walking_on_a_plane(integrator, cone):
    dynamics = dynamics_of(models.walker(integrator, cone, soft=models.SOFT))
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1, scale=0.05, base=STAND, settle=200)
    assert_agree(dynamics, trajectory, 3e-6, ROWS)


def test_flying_over_a_plane():
    dynamics = dynamics_of(models.walker("implicitfast", "pyramidal", height=3.0))
    assert_agree(dynamics, some_trajectory(dynamics, base=STAND))


@pytest.mark.parametrize("shape", models.SHAPES)
@pytest.mark.parametrize("speed", [0.1, 1.0])
@pytest.mark.parametrize(
    ("integrator", "cone", "condim"),
    [("Euler", "pyramidal", 3), ("implicitfast", "elliptic", 3), ("implicit", "elliptic", 6), ("Euler", "elliptic", 4),
     ("implicitfast", "pyramidal", 6), ("Euler", "pyramidal", 1)],
)  # fmt: skip
def test_shapes_on_a_plane(shape, speed, integrator, cone, condim):
    dynamics = dynamics_of(models.dropped(shape, integrator, cone, condim))
    assert_agree(dynamics, some_trajectory(dynamics, spread=0.0, speed=speed), 5e-5, ROWS)


def test_a_stiff_contact():
    dynamics = dynamics_of(models.dropped("sphere", "implicitfast", "elliptic", 3, soft=""))
    assert_agree(dynamics, some_trajectory(dynamics, spread=0.0, speed=0.1), 1e-4, 1e-7)


@pytest.mark.parametrize("integrator", models.CONTINUOUS)
def test_limits_and_friction(integrator):
    dynamics = dynamics_of(models.limits(integrator))
    assert_agree(dynamics, some_trajectory(dynamics, N=20, spread=0.0, scale=0.5), 1e-6, ROWS)


@pytest.mark.parametrize("integrator", models.CONTINUOUS)
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_moving_pairs(integrator, cone):
    dynamics = dynamics_of(models.pair(integrator, cone))
    assert_agree(dynamics, some_trajectory(dynamics, spread=0.0, speed=0.1, scale=0.1), 5e-5, ROWS)


@pytest.mark.parametrize("hands", models.HANDS)
def test_contacts_within_one_tree(hands):
    dynamics = dynamics_of(models.clasp(hands, "implicitfast", "elliptic", 3))
    assert_agree(dynamics, some_trajectory(dynamics, spread=0.0, speed=0.1, scale=0.1), 5e-5, ROWS)


@pytest.mark.parametrize("integrator", models.CONTINUOUS)
@pytest.mark.parametrize("model", [models.linkage, models.geared])
def test_equality_constraints(model, integrator):
    dynamics = dynamics_of(model(integrator))
    assert_agree(dynamics, some_trajectory(dynamics, spread=0.05, speed=0.5), 2e-6, ROWS)


@pytest.mark.parametrize("tie", contact_models.TIES)
def test_every_kind_of_tie(tie):
    dynamics = dynamics_of(contact_models.tied(tie, "implicitfast", "sparse", 'solref=".05 1"'))
    assert_agree(dynamics, some_trajectory(dynamics, N=3, spread=0.05, speed=0.5), 2e-6, ROWS)


def test_sparse_constraint_jacobian():
    xml = models.walker("implicitfast", "elliptic", soft=models.SOFT)
    dense = dynamics_of(xml.replace("<option", '<option jacobian="dense"'))
    sparse = dynamics_of(xml.replace("<option", '<option jacobian="sparse"'))
    trajectory = some_trajectory(dense, spread=0.0, speed=0.1, base=STAND, scale=0.05, settle=200)
    costates, _ = some_costates(dense, trajectory.horizon)
    for ours, theirs in zip(dense.hessian(trajectory, costates), sparse.hessian(trajectory, costates), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6 * max(1.0, np.abs(ours).max()))


def test_steps_apart_from_each_other():
    """Knots of a state guess: where a step ends is not the next state."""
    dynamics = dynamics_of(models.mixed("implicitfast"))
    rng = np.random.default_rng(3)
    X = dynamics.integrate(np.tile(dynamics.initial_state, (6, 1)), 0.5 * rng.standard_normal((6, dynamics.ndx)))
    U = rng.standard_normal((5, dynamics.nu))
    ends, Y = dynamics.step_each(X, U)
    costates, weights = some_costates(dynamics, 5)
    along = dynamics.linearize_steps(X, U, ends)
    guess = Trajectory(X, U, Y, dynamics.dt)
    ours = dynamics.hessian(guess, costates, weights, along, ends)
    theirs = Dynamics.hessian(dynamics, guess, costates, weights, along, ends)
    for mine, twin in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, twin, rtol=0, atol=1e-7 * np.abs(theirs.xx).max())


def test_any_number_of_threads_gives_the_same():
    xml = models.walker("implicitfast", "pyramidal", soft=models.SOFT)
    one = dynamics_of(xml)
    trajectory = some_trajectory(one, N=17, spread=0.0, speed=0.1, base=STAND, scale=0.05, settle=100)
    costates, _ = some_costates(one, 17)
    reference = one.hessian(trajectory, costates)
    for threads in (2, 5):
        several = MujocoDynamics.from_xml(xml.replace('tolerance="0"', 'tolerance="1e-30"'), threads=threads)
        for ours, theirs in zip(several.hessian(trajectory, costates), reference, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_singular_inertia_gives_nan():
    dynamics = dynamics_of(models.arm("Euler").replace('damping=".1" armature=".01"', ""))
    trajectory = some_trajectory(dynamics)
    wild = Trajectory(trajectory.X * np.array([1e160]), trajectory.U, trajectory.Y, trajectory.dt)
    assert not np.isfinite(dynamics.hessian(wild, *some_costates(dynamics, wild.horizon)).xx).all()


FEELING = (
    """<sensor><accelerometer site="a"/><framelinvel objtype="site" objname="b"/><velocimeter site="b"/></sensor>"""
)


def test_sensors_without_a_closed_form_have_their_share():
    xml = models.quadrotor("Euler").replace("</mujoco>", FEELING + "</mujoco>")
    dynamics = dynamics_of(xml)
    assert "some sensors" in dict(dynamics.support_report())["second derivatives"]
    assert_agree(dynamics, some_trajectory(dynamics))


MUSCLE = models.arm("Euler").replace("</actuator>", '<muscle joint="j2" lengthrange="0 1" force="5"/></actuator>')


@pytest.mark.parametrize(
    ("xml", "why"),
    [(models.arm("discrete"), "integrator is not Euler"),
     (models.arm("Euler").replace("<option", '<option density="1000" viscosity=".1"'), "fluid"),
     (MUSCLE, "muscles")],
    ids=["discrete", "fluid", "muscles"],
)  # fmt: skip
def test_other_models_go_the_slow_way_and_say_so(xml, why):
    dynamics = dynamics_of(xml)
    served = dict(dynamics.support_report())["second derivatives"]
    assert served.startswith("differences") and why in served
    trajectory = some_trajectory(dynamics, N=2, base=np.full(dynamics.nu, 0.5), scale=0.1)
    costates, weights = some_costates(dynamics, 2)
    theirs = Dynamics.hessian(dynamics, trajectory, costates, weights)
    for mine, twin in zip(dynamics.hessian(trajectory, costates, weights), theirs, strict=True):
        np.testing.assert_array_equal(mine, twin)


@pytest.mark.parametrize(("name", "tolerance"), [("panda_reach", 1e-7), ("solo12_stand", 1e-5), ("g1_reach", 1e-5)])
def test_robots(name, tolerance):
    problem = problems.get(name)
    trajectory = problem.rollout(np.broadcast_to(problem.U0, (problem.horizon, problem.dynamics.nu)).copy())
    first = problem.horizon // 2
    knots, steps = slice(first, first + 3), slice(first, first + 2)
    part = Trajectory(trajectory.X[knots], trajectory.U[steps], trajectory.Y[knots], problem.dynamics.dt)
    assert_agree(problem.dynamics, part, tolerance, 1e-5 if name == "panda_reach" else ROWS)


@pytest.mark.parametrize(("integrator", "cone"), [("implicitfast", "pyramidal"), ("Euler", "elliptic")])
def test_hessian_of_the_total_cost_in_contact(integrator, cone):
    dynamics = dynamics_of(models.walker(integrator, cone, soft=models.SOFT))
    x0 = dynamics.rollout(dynamics.initial_state, np.tile(STAND, (150, 1))).X[-1]
    terms = [costs.Control(0.1), costs.State(1.0, dynamics.initial_state, "always")]
    problem = Problem(dynamics, 6, x0, terms)
    U = STAND + 0.05 * np.random.default_rng(0).standard_normal((6, dynamics.nu))
    here = Iterate(problem, problem.rollout(U))
    theirs = dense_hessian(problem, U)
    scale = np.abs(theirs).max()
    np.testing.assert_allclose(total_hessian(here.newton), theirs, rtol=0, atol=2e-7 * scale)
    assert np.abs(total_hessian(here.gauss_newton) - theirs).max() > 0.01 * scale


def test_right_jacobian_and_its_slope_at_any_angle():
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-9, 1e-3, 0.3, 0.499, 0.501, 1.0, 3.0):
        x, costate = size * rng.standard_normal(3), rng.standard_normal(3)
        e = 1e-6
        D = np.array([(right_jacobian(x + d) - right_jacobian(x - d)).T @ costate / (2 * e) for d in e * np.eye(3)])
        np.testing.assert_allclose(right_jacobian_slope(x, costate), 0.5 * (D + D.T), atol=1e-9)
