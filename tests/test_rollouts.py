"""`Dynamics.rollouts`: several simulations in one call, open loop and under a law with limits, against plain loops."""

import numpy as np
import pytest
from numba import njit

import mjslq
from mjslq.dynamics.dynamics import Feedback
from mjslq.robots import robot_path

N, M = 15, 5

TUMBLER = """
<mujoco><option timestep="0.005"/><worldbody>
  <body pos="0 0 1"><freejoint name="root"/><geom type="box" size="0.2 0.1 0.05" mass="2"/>
    <body pos="0.2 0 0"><joint name="ball" type="ball" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.4"/><site name="tip" pos=".3 0 0"/></body></body>
  </worldbody>
  <actuator><motor joint="ball" gear="0 0 1"/>
    <general site="tip" gear="0 1 0 0 0 0" dyntype="filter" dynprm="0.05"/></actuator>
  <sensor><framepos objtype="site" objname="tip"/><accelerometer site="tip"/></sensor></mujoco>"""


def equations(x, u):
    out = np.empty_like(x)
    out[0] = x[1] + 0.1 * u[1]
    out[1] = u[0] - 9.81 * np.sin(x[0]) - 0.1 * x[1]
    return out


def solo12(integrator):
    return mjslq.PinocchioDynamics.from_path(
        robot_path("solo12"), 0.01, floating_base=True, armature=0.02, outputs=("FL_FOOT",), integrator=integrator
    )


ENGINES = {
    "plain function": lambda: mjslq.FunctionDynamics(equations, 2, 2, 0.05, outputs=lambda x, u: x * u),
    "compiled function": lambda: mjslq.FunctionDynamics(njit(equations), 2, 2, 0.05),
    "mujoco": lambda: mjslq.MujocoDynamics.from_xml(TUMBLER, jacobian="transition", threads=1),
    "mujoco, two threads": lambda: mjslq.MujocoDynamics.from_xml(TUMBLER, jacobian="transition", threads=2),
    "mujoco, eight threads": lambda: mjslq.MujocoDynamics.from_xml(TUMBLER, jacobian="transition", threads=8),
    "pinocchio arm": lambda: mjslq.PinocchioDynamics.from_path(
        robot_path("panda"), 0.01, outputs=("panda_hand_tcp",), locked_joints=("panda_finger_joint1",)
    ),
    "pinocchio floating": lambda: solo12("semi-implicit-euler"),
    "pinocchio runge-kutta": lambda: solo12("rk4"),
}


@pytest.fixture(params=ENGINES)
def case(request):
    """An engine, M starts and controls, and a law that runs into its limits now and then."""
    dynamics, rng = ENGINES[request.param](), np.random.default_rng(0)
    nu, ndx = dynamics.nu, dynamics.ndx
    start = getattr(dynamics, "initial_state", np.zeros(dynamics.nx))
    x0s = dynamics.integrate(start, 0.2 * rng.normal(size=(M, ndx)))
    U, K = 0.5 * rng.normal(size=(M, N, nu)), 0.2 * rng.normal(size=(N, nu, ndx))
    X = dynamics.rollout(x0s[0], U[0]).X
    limit = rng.uniform(0.2, 0.6, (N, nu))
    return dynamics, x0s, U, Feedback(X, K, -limit, 1.5 * limit)


def test_open_loop_is_one_rollout_after_the_other(case):
    dynamics, x0s, U, _ = case
    for x0, u, ours in zip(x0s, U, dynamics.rollouts(x0s, U), strict=True):
        alone = dynamics.rollout(x0, u)
        for name in ("X", "U", "Y", "dt"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(alone, name))
            assert not getattr(ours, name).flags.writeable


def test_law_with_limits_is_the_plain_one(case):
    dynamics, x0s, U, law = case
    clipped = 0
    for x0, given, ours in zip(x0s, U, dynamics.rollouts(x0s, U, law), strict=True):
        np.testing.assert_array_equal(ours.X[0], x0)
        for n in range(N):
            wanted = given[n] - law.K[n] @ dynamics.difference(law.X[n], ours.X[n])
            applied = np.minimum(np.maximum(wanted, law.lower[n]), law.upper[n])
            at_limit = applied != wanted
            np.testing.assert_allclose(ours.U[n], applied, rtol=0, atol=1e-12)
            np.testing.assert_array_equal(ours.U[n][at_limit], applied[at_limit])
            clipped += at_limit.sum()
        again = dynamics.rollout(x0, ours.U)
        np.testing.assert_allclose(again.X, ours.X, rtol=0, atol=1e-9)
        assert not ((law.lower > ours.U) | (law.upper < ours.U)).any()
    assert 0.1 < clipped / U.size < 0.9


def test_law_without_limits_is_the_feedback_rollout(case):
    dynamics, x0s, U, law = case
    reference = dynamics.rollout(x0s[0], U[0])
    free = Feedback.unlimited(reference.X, law.K)
    ours = dynamics.rollouts(x0s[:1], reference.U[None] + 0.3 * U[:1], free)[0]
    np.testing.assert_array_equal(ours.X, dynamics.rollout_feedback(reference, law.K, U[0], 0.3).X)


def test_arrays_in_any_order_of_memory_will_do(case):
    dynamics, x0s, U, law = case
    turned = Feedback(*(np.asfortranarray(array) for array in law))
    ours, same = dynamics.rollouts(x0s, np.asfortranarray(U), turned), dynamics.rollouts(x0s, U, law)
    for one, other in zip(ours, same, strict=True):
        np.testing.assert_array_equal(one.X, other.X)


def test_one_that_blows_up_does_not_touch_the_others(case):
    dynamics, x0s, U, law = case
    bad = U.copy()
    bad[2, 4:], bad[3, 6] = 1e30, np.nan
    wide = law._replace(lower=np.full_like(law.lower, -np.inf), upper=np.full_like(law.upper, np.inf))
    for feedback in (None, wide):
        found, clean = dynamics.rollouts(x0s, bad, feedback), dynamics.rollouts(x0s, U, feedback)
        for i in (0, 1, 4):
            np.testing.assert_array_equal(found[i].X, clean[i].X)
        for i, last in ((2, 5), (3, 7)):
            n = found[i].diverged_at
            assert n is not None and n <= last
            assert (
                np.isfinite(found[i].X[:n]).all() and np.isnan(found[i].X[n:]).all() and np.isnan(found[i].Y[n:]).all()
            )
            np.testing.assert_array_equal(found[i].U[n:], bad[i, n:])


def test_a_law_cannot_lose_nan_in_its_limits(case):
    """Clipping by min and max would turn a NaN into a limit, and the rollout into a good one."""
    dynamics, x0s, U, law = case
    lost = U.copy()
    lost[0, 3] = np.nan
    assert dynamics.rollouts(x0s, lost, law)[0].diverged_at in (3, 4)


def test_single_controls_are_not_copied():
    dynamics, U = ENGINES["compiled function"](), np.ones((1, N, 2))
    assert np.shares_memory(dynamics.rollouts(np.zeros((1, 2)), U)[0].U, U)
    many = dynamics.rollouts(np.zeros((M, 2)), np.ones((M, N, 2)))
    assert not any(np.shares_memory(one.U, other.U) for one in many for other in many if one is not other)
