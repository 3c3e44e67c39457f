"""`MujocoDynamics(substeps=k)`: a control held over k simulator steps, against single steps and plain loops."""

import mujoco
import numpy as np
import pytest
from test_mujoco import MODELS, controls, start
from test_second_derivatives import BALL, dense

from mjslq import MujocoDynamics, Trajectory, problems
from mjslq.dynamics.dynamics import Feedback

K = 4
SERVO = """
<mujoco><option timestep=".005"/><worldbody>
  <body><joint name="hinge" damping=".1"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
    <body pos=".3 0 0"><joint name="c" type="ball"/><geom type="box" size=".1 .05 .03"/></body></body></worldbody>
  <actuator><general joint="c" gaintype="so3" biastype="so3" gainprm="2" biasprm="0 -2 -.1" dyntype="integrator"/>
    <muscle joint="hinge" lengthrange="-1 1.5" force="4" timeconst=".02 .06"/></actuator>
  <sensor><jointvel joint="hinge"/><clock/></sensor></mujoco>"""
CASES = {**MODELS, "servo": SERVO}


def made(name, substeps=K, **options):
    """A model with steps of the same horizon, whatever number of simulator steps they take."""
    if name in problems.names():
        model = problems.get(name).dynamics.model
        return MujocoDynamics.from_model(model, timestep=model.opt.timestep / K, substeps=substeps, **options)
    return MujocoDynamics.from_xml(CASES[name], substeps=substeps, **options)


def beginning(name, dynamics):
    """State and controls to start from; Solo12 stands on its feet, which have sunk into the soft floor."""
    if name in problems.names():
        problem = problems.get(name)
        noise = np.random.default_rng(0).normal(size=(8, dynamics.nu))
        settled = made(name, threads=1).rollout(problem.x0, problem.U0[:60]).X[-1]
        return settled, np.array(problem.U0)[60:68] + 0.1 * noise
    return start(dynamics), controls(dynamics, 8, 0.3) + (0.5 if name == "servo" else 0.0)


def rollout(name, dynamics):
    return dynamics.rollout(*beginning(name, dynamics))


every_case = pytest.mark.parametrize("name", [*CASES, "panda_reach", "solo12_stand"])


@every_case
def test_a_rollout_is_one_of_single_steps(name):
    """Bit for bit, states between the knots included; outputs are those at the knots."""
    dynamics, single = made(name), made(name, 1)
    ours = rollout(name, dynamics)
    whole = single.rollout(ours.X[0], np.repeat(ours.U, K, axis=0))
    assert dynamics.dt == K * single.dt and ours.substates.shape == (8, K - 1, dynamics.nx)
    np.testing.assert_array_equal(ours.X, whole.X[::K])
    np.testing.assert_array_equal(ours.Y, whole.Y[::K])
    between = whole.X[:-1].reshape(8, K, -1)[:, 1:]
    np.testing.assert_array_equal(ours.substates, between)
    assert whole.substates is None and not ours.substates.flags.writeable
    np.testing.assert_allclose(ours.times, whole.times[::K], rtol=1e-12)


@every_case
@pytest.mark.parametrize("jacobian", ["auto", "transition"])
def test_jacobians_are_products_of_those_of_single_steps(name, jacobian):
    dynamics, single = made(name, jacobian=jacobian), made(name, 1, jacobian=jacobian)
    trajectory = rollout(name, dynamics)
    whole = single.rollout(trajectory.X[0], np.repeat(trajectory.U, K, axis=0))
    ours, steps = dynamics.linearize(trajectory), single.linearize(whole)
    for n in range(trajectory.horizon):
        A, B = np.eye(dynamics.ndx), np.zeros((dynamics.ndx, dynamics.nu))
        for s in range(n * K, (n + 1) * K):
            A, B = steps.A[s] @ A, steps.A[s] @ B + steps.B[s]
        np.testing.assert_allclose(ours.A[n], A, rtol=0, atol=1e-12 * max(1.0, np.abs(A).max()))
        np.testing.assert_allclose(ours.B[n], B, rtol=0, atol=1e-12 * max(1.0, np.abs(B).max()))
    np.testing.assert_array_equal(ours.C, steps.C[::K])
    np.testing.assert_array_equal(ours.D, steps.D[::K])


@every_case
@pytest.mark.parametrize("jacobian", ["auto", "transition"])
def test_jacobians_are_as_good_as_without(name, jacobian):
    """Against fourth-order differences of the held-control step."""
    errors = {}
    for k in (1, K):
        dynamics = made(name, k, jacobian=jacobian)
        errors[k] = dynamics.check_derivatives(rollout(name, dynamics)).errors
    for part, error in errors[K].items():
        assert error < max(4.0 * errors[1][part], 2e-8), errors


@pytest.mark.parametrize("name", ["arm", "floater", "solo12_stand"])
@pytest.mark.parametrize("jacobian", ["inverse", "transition"])
def test_states_between_are_simulated_where_a_trajectory_has_none(name, jacobian):
    dynamics = made(name, jacobian=jacobian)
    known = rollout(name, dynamics)
    other = made(name, 2).rollout(known.X[0], known.U)
    ours = dynamics.linearize(known)
    for given in (
        Trajectory(known.X, known.U, known.Y, known.dt),
        Trajectory(known.X, known.U, known.Y, known.dt, substates=other.substates),  # those of another k
    ):
        for one, theirs in zip(ours, dynamics.linearize(given), strict=True):
            np.testing.assert_allclose(theirs, one, rtol=0, atol=1e-6 * max(1.0, np.abs(one).max(initial=0.0)))


@every_case
def test_steps_apart_from_each_other(name):
    """`step_each` is the plain `step`, each from a clean start; NaN where it blows up; and its Jacobians fit."""
    dynamics = made(name, threads=3)
    known = rollout(name, dynamics)
    F, Y = dynamics.step_each(known.X, known.U)
    for n in range(known.horizon):
        x, y = dynamics.step(known.X[n], known.U[n], n)
        np.testing.assert_array_equal(F[n], x)
        np.testing.assert_array_equal(Y[n], y)
    np.testing.assert_allclose(Y[-1], known.Y[-1], rtol=0, atol=1e-6 * max(1.0, np.abs(known.Y).max(initial=0.0)))
    apart, along = dynamics.linearize_steps(known.X, known.U, F), dynamics.linearize(known)
    for ours, theirs in zip(apart, along, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-5 * max(1.0, np.abs(theirs).max(initial=0.0)))
    X, U = np.array(known.X), np.array(known.U)
    X[2, -1], U[5, 0] = 1e12, np.nan
    F = dynamics.step_each(X, U)[0]
    assert np.isnan(F).all(axis=1).tolist() == [n in (2, 5) for n in range(8)]


@pytest.mark.parametrize("jacobian", ["inverse", "transition"])
def test_threads_change_nothing(jacobian):
    results = []
    for threads in (1, 3):
        dynamics = made("box", threads=threads, jacobian=jacobian)
        results.append(dynamics.linearize(rollout("box", dynamics)))
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one, other)


def test_feedback_looks_at_the_knots_alone():
    dynamics, rng = made("floater"), np.random.default_rng(1)
    x0, U = beginning("floater", dynamics)
    plan = dynamics.rollout(x0, U)
    gains, limit = rng.normal(size=(8, dynamics.nu, dynamics.ndx)), np.full((8, dynamics.nu), 0.4)
    law = Feedback(plan.X, gains, -limit, limit)
    pushed = dynamics.integrate(x0, 0.05 * rng.normal(size=dynamics.ndx))
    ours = dynamics.rollouts(pushed[None], plan.U[None], law)[0]
    for n in range(8):
        wanted = plan.U[n] - gains[n] @ dynamics.difference(plan.X[n], ours.X[n])
        np.testing.assert_allclose(ours.U[n], np.clip(wanted, -0.4, 0.4), rtol=0, atol=1e-12)
    again = dynamics.rollout(pushed, ours.U)
    np.testing.assert_array_equal(again.X, ours.X)
    np.testing.assert_array_equal(again.substates, ours.substates)


def test_second_derivatives():
    dynamics = MujocoDynamics.from_xml(BALL, substeps=3, timestep=0.01)
    rng = np.random.default_rng(5)
    x0 = dynamics.integrate(dynamics.initial_state, rng.normal(size=dynamics.ndx))
    trajectory = dynamics.rollout(x0, rng.normal(size=(4, dynamics.nu)))
    costates, weights = rng.normal(size=(5, dynamics.ndx)), rng.normal(size=(5, dynamics.ny))
    reference, ndx = dense(dynamics, trajectory, costates, weights), dynamics.ndx
    xx, ux, uu = dynamics.hessian(trajectory, costates, weights)
    # positions and velocities by ball joints: only the part that is no turning of the tangent directions is meant
    scale = np.abs(reference).max()
    np.testing.assert_allclose(ux, reference[:-1, ndx:, :ndx], rtol=0, atol=2e-5 * scale)
    np.testing.assert_allclose(uu, reference[:-1, ndx:, ndx:], rtol=0, atol=2e-5 * scale)
    np.testing.assert_allclose(xx, reference[:, :ndx, :ndx], rtol=0, atol=2e-5 * scale)


def test_a_blow_up_between_knots():
    """The knot behind it is the first bad one, and nothing is left of the states on the way there."""
    xml = """<mujoco><option timestep=".01"><flag contact="disable"/></option><worldbody><body><joint name="a"/>
      <geom size=".1"/></body></worldbody><actuator><motor joint="a"/></actuator></mujoco>"""
    dynamics, single = MujocoDynamics.from_xml(xml, substeps=3), MujocoDynamics.from_xml(xml)
    U = np.zeros((6, 1))
    U[2] = 9e9
    whole, ours = single.rollout(np.zeros(2), np.repeat(U, 3, axis=0)), dynamics.rollout(np.zeros(2), U)
    bad = -(-whole.diverged_at // 3)
    assert whole.diverged_at % 3 and ours.diverged_at == bad and np.isnan(ours.X[bad:]).all()
    assert np.isfinite(ours.substates[: bad - 1]).all() and np.isnan(ours.substates[bad - 1 :]).all()


def test_timestep_is_the_simulators_own():
    for make, source in ((MujocoDynamics.from_xml, MODELS["arm"]),
                         (MujocoDynamics.from_spec, mujoco.MjSpec.from_string(MODELS["arm"])),
                         (MujocoDynamics.from_model, mujoco.MjModel.from_xml_string(MODELS["arm"]))):  # fmt: skip
        dynamics = make(source, timestep=0.002, substeps=5)
        assert dynamics.dt == pytest.approx(0.01) and dynamics.model.opt.timestep == 0.002 and dynamics.substeps == 5
    assert ("5 substeps", "of 0.002 s, the control held") in dynamics.support_report()
    assert not any("substeps" in part for part, _ in made("arm", 1).support_report())


def test_files_may_be_stepped_so_too(tmp_path):
    (tmp_path / "arm.xml").write_text(MODELS["arm"])
    assert MujocoDynamics.from_path(tmp_path / "arm.xml", substeps=3).dt == pytest.approx(0.03)


@pytest.mark.parametrize("k", [0, -1, 1.5, "2", True])
def test_odd_numbers_of_substeps_are_refused(k):
    with pytest.raises(ValueError, match="substeps must be a whole number of at least 1"):
        made("arm", k)


def test_trajectories_check_what_they_are_given():
    X, U, S = np.zeros((4, 2)), np.zeros((3, 1)), np.zeros((3, 2, 2))
    assert Trajectory(X, U, substates=S).substates.shape == (3, 2, 2)
    with pytest.raises(ValueError, match=r"substates must have shape \(3, k - 1, 2\), got \(2, 2, 2\)"):
        Trajectory(X, U, substates=S[:2])
    S[1, 0, 0] = np.nan
    with pytest.raises(ValueError, match="substates must be finite"):
        Trajectory(X, U, substates=S)
    X[2:] = np.nan
    assert Trajectory(X, U, diverged_at=2, substates=S).diverged
