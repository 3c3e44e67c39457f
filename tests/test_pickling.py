"""Engines, problems, results and policies that are pickled or copied, also into another process."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest
from numba import njit

from mjslq import Bounds, FunctionDynamics, MujocoDynamics, PinocchioDynamics, Problem, costs, problems, solve

ARM = """
<mujoco><option timestep="0.02"/><worldbody><body><joint name="a" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1"/>
<body pos="0 0 -.5"><joint name="b" type="ball" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1"/><site name="tip" pos="0 0 -.5"/></body></body>
</worldbody><actuator><motor joint="a" ctrllimited="true" ctrlrange="-3 3"/></actuator>
<sensor><framepos objtype="site" objname="tip"/></sensor></mujoco>"""


def pendulum(x, u, t, p):
    out = np.empty_like(x)
    out[0] = x[1]
    out[1] = u[0] - p[0] * np.sin(x[0]) + 0.1 * t
    return out


def energy(x, u):
    return np.array([0.5 * x[1] * x[1] - np.cos(x[0])])


def effort(x, u, t):
    return x[0] * u[0] + x[1] * x[1]


compiled_pendulum, compiled_energy, compiled_effort = njit(pendulum), njit(energy), njit(effort)


def function_problem(f, outputs, cost, **options):
    system = FunctionDynamics(f, 2, 1, 0.05, parameters=[1.3], outputs=outputs, control_limits=(-1.0, 1.0), **options)
    terms = [costs.Control(0.1), costs.State([5.0, 1.0], [1.0, 0.0]), costs.Residual(cost), costs.Sensor("y", 0.3)]
    return Problem(system, 12, [0.1, 0.0], terms)


def plain():
    return function_problem(pendulum, energy, effort)


def compiled():
    return function_problem(compiled_pendulum, compiled_energy, compiled_effort)


def mujoco():
    system = MujocoDynamics.from_xml(ARM, substeps=2, threads=2)
    target = system.initial_state.copy()
    target[0] = 0.5
    return Problem(system, 8, system.initial_state, [costs.Control(0.1), costs.State(1.0, target)], Bounds(u=(-2, 2)))


def pinocchio():
    model = pin.buildSampleModelManipulator()
    system = PinocchioDynamics.from_model(model, 0.01, outputs=["effector_body"], damping=0.3, armature=0.1)
    return Problem(system, 8, system.initial_state, [costs.Control(0.1), costs.State(1.0, np.full(system.nx, 0.2))])


MAKERS = {make.__name__: make for make in (plain, compiled, mujoco, pinocchio)}
COPIES = {"pickle": lambda thing: pickle.loads(pickle.dumps(thing)), "deepcopy": copy.deepcopy}


def answer(problem):
    result = solve(problem, max_iterations=4)
    assert not result.error and result.iterations > 0
    return result


def assert_same(ours, theirs):
    assert ours.cost == theirs.cost and ours.status is theirs.status
    for a, b in ((ours.trajectory.X, theirs.trajectory.X), (ours.trajectory.Y, theirs.trajectory.Y)):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(ours.gains, theirs.gains)


@pytest.mark.parametrize("used", [False, True], ids=["fresh", "used"])
@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("name", MAKERS)
def test_a_copy_solves_to_the_same_bits(name, way, used):
    """Before: cannot pickle '_thread.lock' object."""
    problem = MAKERS[name]()
    before = answer(problem) if used else None
    twin = COPIES[way](problem)
    assert twin.dynamics is not problem.dynamics
    ours = answer(twin)
    assert_same(ours, answer(problem))
    if before is not None:
        assert_same(ours, before)


@pytest.mark.parametrize("name", MAKERS)
def test_a_copy_of_an_engine_is_whole(name):
    system = MAKERS[name]().dynamics
    twin = pickle.loads(pickle.dumps(system))
    assert twin.state_names == system.state_names and repr(twin.outputs) == repr(system.outputs)
    np.testing.assert_array_equal(twin.control_limits, system.control_limits)
    assert twin.support_report() == system.support_report() and (twin.scene() is None) == (system.scene() is None)
    x, u = MAKERS[name]().x0, np.full(system.nu, 0.3)
    for ours, theirs in zip(twin.step(x, u), system.step(x, u), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("way", COPIES)
def test_results_and_policies_are_carried(way):
    result = answer(mujoco())
    twin = COPIES[way](result)
    assert_same(twin, result)
    x = result.trajectory.X[3]
    policy = COPIES[way](result.policy)
    np.testing.assert_array_equal(policy(x, 0.1), result.policy(x, 0.1))
    for array in (twin.trajectory.X, policy.U, COPIES[way](mujoco()).U0):
        assert not array.flags.writeable


@pytest.mark.parametrize("name", problems.names())
def test_problems_of_the_catalogue_are_carried(name):
    problem = problems.get(name)
    twin = pickle.loads(pickle.dumps(problem))
    trajectory = problem.rollout(problem.U0)
    np.testing.assert_array_equal(twin.rollout(twin.U0).X, trajectory.X)
    if not trajectory.diverged:
        assert twin.cost(trajectory) == problem.cost(trajectory)
        assert (twin.describe and twin.describe(trajectory)) == (problem.describe and problem.describe(trajectory))


@pytest.mark.parametrize("name", MAKERS)
def test_another_process_finds_the_same_answer(name, tmp_path):
    problem, there, back = MAKERS[name](), tmp_path / "there", tmp_path / "back"
    there.write_bytes(pickle.dumps(problem))
    script = (
        f"import pickle, sys; sys.path.insert(0, {str(__file__.rpartition('/')[0])!r}); import mjslq\n"
        f"problem = pickle.load(open({str(there)!r}, 'rb'))\n"
        f"pickle.dump(mjslq.solve(problem, max_iterations=4), open({str(back)!r}, 'wb'))"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=300)
    assert_same(pickle.loads(back.read_bytes()), answer(problem))


def test_a_function_that_was_found_out_stays_so():
    """No second warning, and the same derivatives."""
    with pytest.warns(UserWarning, match="is not analytic"):
        system = FunctionDynamics(damped, 1, 1, 0.1)
    for way in COPIES.values():
        assert way(system).jacobian == "finite-difference"


def damped(x, u):
    return u - x * np.abs(x)


def test_a_function_that_cannot_be_imported_is_named():
    system = FunctionDynamics(lambda x, u: u - x, 1, 1, 0.1)
    copy.deepcopy(system)
    with pytest.raises((pickle.PicklingError, AttributeError), match="<lambda>"):
        pickle.dumps(system)
    pickle.loads(pickle.dumps(FunctionDynamics(njit(lambda x, u: u - x), 1, 1, 0.1)))  # travels whole


@pytest.mark.parametrize("loss", ["quadratic", "smooth-abs", "huber", "pseudo-huber"])
def test_losses_are_carried(loss):
    dynamics = problems.get("cart_pole", horizon=20).dynamics
    terms = [costs.Control(0.1), costs.State(2.0, [0.1, 0.2, 0.0, 0.0], loss=loss)]
    problem = Problem(dynamics, 20, [1.0, 0.5, 0.0, 0.0], terms)
    twin = pickle.loads(pickle.dumps(problem))
    U = np.full((20, 1), 0.3)
    assert twin.cost(twin.rollout(U)) == problem.cost(problem.rollout(U))
    assert np.array_equal(twin.gradient(twin.rollout(U)), problem.gradient(problem.rollout(U)))
