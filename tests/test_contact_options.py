"""Contact as an option: what is set, what results say of it, replays, and derivatives that foresee touch."""

import numpy as np
import pytest

import mjslq
from mjslq.contact import Contact

BALL = """<mujoco><option timestep=".01" integrator="implicitfast"/><worldbody>
<geom name="floor" type="plane" size="2 2 .1" solimp=".8 .9 .005"/>
<body pos="0 0 .2"><joint name="z" type="slide" axis="0 0 1"/><geom name="ball" size=".1" mass="1"/></body>
</worldbody><actuator><motor name="lift" joint="z" ctrlrange="-20 20"/></actuator></mujoco>"""


def ball(**options):
    return mjslq.MujocoDynamics.from_xml(BALL, **options)


def landing(**options):
    """A ball is to come down from 0.1 m above the floor and rest."""
    costs = [mjslq.costs.Control(1e-3), mjslq.costs.State([100.0, 1.0], [-0.1, 0.0], "terminal")]
    return mjslq.Problem(ball(**options), 60, [0.0, 0.0], costs)


def test_each_kind_sets_all_contacts_and_only_on_the_copy():
    given = ball().model
    for contact in ("smooth", "stiff"):
        model = ball(contact=contact).model
        assert (model.geom_solimp == Contact(contact).solimp).all()
        assert (model.geom_solref == Contact(contact).solref).all()
    assert np.allclose(given.geom_solimp[:, :3], [[0.8, 0.9, 0.005], [0.9, 0.95, 0.001]])
    assert np.array_equal(ball(contact="model").model.geom_solimp, given.geom_solimp)


def test_the_values_of_smooth_and_stiff():
    assert Contact("smooth").solimp[:3] == (0.0, 0.99, 0.02) and Contact("smooth").solref == (0.02, 1.0)
    assert Contact("stiff").solimp[:3] == (0.9, 0.95, 0.001)  # MuJoCo's own
    softer = Contact("smooth", width=0.05, time_constant=0.04, damping_ratio=0.9, at_touch=0.1, at_width=0.8)
    assert softer.solimp[:3] == (0.1, 0.8, 0.05) and softer.solref == (0.04, 0.9)
    assert "width 50 mm, time constant 40 ms" in str(softer)


def test_smooth_contact_sinks_deeper_and_the_result_says_so(tmp_path):
    results = {contact: mjslq.solve(landing(contact=contact)) for contact in ("smooth", "stiff")}
    for contact, result in results.items():
        assert result.contact == Contact(contact)
        lowest = result.trajectory.X[:, 0].min()
        assert result.penetration == pytest.approx(-lowest - 0.1, abs=1e-12) and result.penetration > 0.0
    assert results["smooth"].penetration > 5.0 * results["stiff"].penetration
    results["smooth"].save(tmp_path / "landing.npz")
    again = mjslq.load(tmp_path / "landing.npz")
    assert again.contact == results["smooth"].contact and again.penetration == results["smooth"].penetration


def test_summary_and_report_name_the_contact(capsys):
    from mjslq.reports.tables import as_dict, contacts, print_summary

    problem = landing(contact=Contact("smooth", width=0.03))
    result = mjslq.solve(problem, max_iterations=3)
    print_summary(result, problem)
    assert "smooth (width 30 mm, time constant 20 ms), largest penetration" in capsys.readouterr().out
    assert as_dict(result)["penetration"] == result.penetration
    assert ("contacts", "smooth (width 30 mm, time constant 20 ms)") in problem.dynamics.support_report()
    assert contacts(mjslq.solve(mjslq.problems.get("hopper", height=1.0))) == ""


def test_replay_with_the_own_contact_is_the_trajectory_itself():
    result = mjslq.solve(landing(contact="smooth"))
    for feedback in (True, False):
        own = result.replay("smooth", feedback=feedback)
        assert np.array_equal(own.trajectory.X, result.trajectory.X) and not own.deviation.any()
        assert own.penetration == result.penetration


@pytest.mark.parametrize("feedback", [True, False])
def test_replay_is_a_rollout_of_the_other_model(feedback):
    result = mjslq.solve(landing(contact="smooth"))
    for contact in ("stiff", "model", Contact("stiff", time_constant=0.05)):
        other, plan = ball(contact=contact), result.trajectory
        if feedback:
            expected = other.rollout_feedback(plan, result.gains, 0.0 * plan.U)
        else:
            expected = other.rollout(plan.X[0], plan.U)
        replayed = result.replay(contact, feedback=feedback)
        assert np.array_equal(replayed.trajectory.X, expected.X)
        assert replayed.contact == Contact.of(contact)
        assert np.allclose(replayed.deviation, np.abs(expected.X - plan.X), atol=1e-15)
    assert result.replay("stiff").penetration < 0.2 * result.penetration


@pytest.mark.parametrize("name", ["solo12_stand", "g1_reach"])
def test_replay_of_robots_and_steps_with_substeps(name):
    """Meshes and several substeps are simulated from the result as from the engine."""
    made = mjslq.problems.get(name, horizon=10)
    dynamics = mjslq.MujocoDynamics.from_model(made.dynamics.model, timestep=0.005, substeps=2, contact="smooth")
    problem = mjslq.Problem(dynamics, 10, made.x0, made.costs, U0=np.asarray(made.U0)[:10])
    result = mjslq.solve(problem, max_iterations=2)
    assert np.array_equal(result.replay("smooth").trajectory.X, result.trajectory.X)
    assert result.replay("stiff").deviation.max() > 1e-6


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: ball(contact="soft"), "unknown contact 'soft'; there are: model, smooth, stiff"),
        (lambda: ball(contact=3), "contact must be one of model, smooth, stiff or mjslq.Contact, got 3"),
        (lambda: Contact("model", width=0.1), "keeps the model's own parameters, so width cannot be given"),
        (lambda: Contact("smooth", width=0.0), "width must be positive"),
        (lambda: Contact("smooth", at_touch=1.0), "at_touch must lie from 0 to below 1"),
        (lambda: Contact("model").solimp, "keeps the model's own parameters"),
        (lambda: ball(foresight=-0.1), "foresight must be at least 0"),
        (lambda: mjslq.solve(mjslq.problems.get("van_der_pol")).replay(), "only results of MuJoCo models"),
    ],
)
def test_wrong_input_is_answered_in_a_sentence(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_rollouts_know_nothing_of_foresight():
    U = np.random.default_rng(0).normal(size=(40, 1))
    X = ball(contact="smooth").rollout([0.0, 0.0], U).X
    assert np.array_equal(ball(contact="smooth", foresight=0.1).rollout([0.0, 0.0], U).X, X)


def test_far_from_everything_foresight_changes_no_derivative():
    trajectory = ball().rollout([0.5, 0.0], np.zeros((5, 1)))
    for true, foreseen in zip(ball().linearize(trajectory), ball(foresight=0.05).linearize(trajectory), strict=True):
        assert np.allclose(true, foreseen, atol=1e-9)


def test_near_the_floor_foresight_feels_it():
    trajectory = ball().rollout([-0.06, 0.0], np.full((1, 1), 9.81))
    true, foreseen = ball().linearize(trajectory), ball(foresight=0.1).linearize(trajectory)
    assert np.allclose(true.A[0], [[1.0, 0.01], [0.0, 1.0]])
    assert foreseen.A[0, 1, 0] < -1e-3  # the nearer, the more it is pushed away


def test_a_box_is_pushed_from_controls_that_touch_nothing():
    """From servos that stay, no true derivative tells of the box; with foresight it gets to its place."""
    blind = mjslq.problems.get("box_push", start="still")
    assert not blind.gradient(blind.rollout(blind.U0)).any()
    ended = mjslq.solve(blind)
    assert (ended.status, ended.iterations) == (mjslq.Status.NO_CONTACT_GRADIENT, 0)
    assert not ended.success and "foresight" in ended.message
    problem = mjslq.problems.get("box_push", start="still", foresight=0.2)
    assert np.abs(problem.gradient(problem.rollout(problem.U0))).max() > 0.1
    result = mjslq.solve(problem, "slq", multiplier="state", line_search="armijo", max_iterations=60)
    from mjslq.problems.box_push import errors

    distance, angle = errors(result.trajectory, np.array([0.3, 0.1, 0.05]), 0.5)
    assert distance < 0.02 and angle < 0.1
    assert "Derivatives with a foresight of 0.2 m for" in result.message


BESIDE = """<mujoco><option timestep=".02" integrator="implicitfast"/><worldbody>
<geom type="plane" size="2 2 .1"/>
<body pos="0 0 .5"><joint name="hinge" axis="0 1 0" damping=".5"/><geom size=".05" pos=".2 0 0" mass="1"/></body>
<body pos="1 0 .1"><joint name="fall" type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>
</worldbody><actuator><motor joint="hinge" ctrlrange="-5 5"/></actuator></mujoco>"""


@pytest.mark.parametrize("where, status", [(0.0, "converged"), (0.3, "no_contact_gradient")])
def test_a_body_that_nothing_touches_counts_if_the_cost_is_about_it(where, status):
    """A pendulum, and a ball that lies on the floor beside it: as the cost wants it, but for sinking in, or not."""
    dynamics = mjslq.MujocoDynamics.from_xml(BESIDE)
    terms = [mjslq.costs.Control(1e-2), mjslq.costs.State([1.0, 10.0, 0.1, 0.1], [0.5, where, 0.0, 0.0], "always")]
    assert mjslq.solve(mjslq.Problem(dynamics, 50, np.zeros(4), terms)).status.value == status


def test_a_search_that_limits_end_says_so(monkeypatch):
    """Where no step is found: nearly all controls at their limits or not makes the difference."""
    from mjslq.solvers.auto import Auto
    from mjslq.solvers.method import Step

    monkeypatch.setattr(Auto, "step", lambda *arguments: Step(None))
    for target, status in ((5.0, "at_limits"), (0.1, "step_too_small")):
        costs = [mjslq.costs.Control(1e-6), mjslq.costs.State([1e3, 1.0], [target, 0.0], "terminal")]
        problem = mjslq.Problem(ball(), 20, [0.3, 0.0], costs, U0=[-20.0] if target == 5.0 else [0.0])
        result = mjslq.solve(problem)
        assert result.status.value == status and not result.success
        assert ("Widen the limits" in result.message) is (status == "at_limits")


def test_converged_is_said_of_true_derivatives_alone():
    problem = landing(contact="smooth", foresight=0.05)
    result = mjslq.solve(problem)
    assert result.success, result.message
    assert "with true ones" in result.message
    true = landing(contact="smooth")
    assert np.linalg.norm(true.gradient(result.trajectory)) == pytest.approx(result.gradient_norm, rel=1e-6, abs=1e-9)
