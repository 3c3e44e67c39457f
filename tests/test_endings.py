"""How a solve can end: errors, Ctrl-C, deadlines and tests of convergence, none of which may lose the best iterate."""

import signal
import time

import mujoco
import numpy as np
import pytest
from limited_problems import function_pendulum, mujoco_pendulum
from numba import njit
from small_problems import pendulum, pendulum_equations

import mjslq
from mjslq import Bounds, FunctionDynamics, MujocoDynamics, Problem, Status, costs, solve
from mjslq.compiling import CompileClock

METHODS = ["auto", "slq", "newton", "trust-region", "gradient", "pronto", "gopronto"]
SWING = np.linspace(0.0, 1.0, 41)[:, None] * np.array([2.0, 0.0])


class Broken(RuntimeError):
    """What nobody expects."""


class Fuse:
    """Counts calls; at the `at`-th one, or from it on, it goes off."""

    def __init__(self, once=False):
        self.calls, self.at, self.once = 0, np.inf, once

    def __call__(self):
        self.calls += 1
        if self.calls == self.at or (self.calls > self.at and not self.once):
            raise Broken("the 220 V are\n gone")

    def reset(self, at=np.inf):
        self.calls, self.at = 0, at


def fused_dynamics(fuse, N=12):
    def f(x, u):
        fuse()
        return pendulum_equations.py_func(x, u)

    return pendulum(dynamics=FunctionDynamics(f, 2, 1, 0.05), N=N)


def fused_cost(fuse):
    def distance(x, u, t):
        fuse()
        return x - np.array([2.0, 0.0])

    terms = [costs.Control(0.1), costs.Residual(distance, [200.0, 20.0], "terminal"), costs.Residual(distance, 1e-3)]
    return Problem(pendulum().dynamics, 12, [0.0, 0.0], terms)


def assert_consistent(problem, result):
    """What came out is an iterate of the problem, no worse than any that was told of."""
    assert not result.trajectory.diverged
    assert result.cost == problem.cost(result.trajectory)
    np.testing.assert_array_equal(problem.rollout(result.trajectory.U).X[0], result.trajectory.X[0])
    np.testing.assert_allclose(problem.rollout(result.trajectory.U).X, result.trajectory.X, rtol=1e-9, atol=1e-9)
    told = [entry.cost for entry in result.log if entry.gap == 0.0]
    assert result.cost <= min(told, default=np.inf) * (1.0 + 1e-8)
    assert result.iterations == sum(entry.outcome == "accepted" for entry in result.log)


# Errors


@pytest.mark.parametrize("once", [True, False], ids=["once", "for good"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("make", [fused_dynamics, fused_cost], ids=["dynamics", "cost"])
def test_an_error_inside_the_loop_keeps_the_best_iterate(make, method, once):
    """Wherever it comes, in a rollout, a Jacobian or an expansion, and whether or not it comes again."""
    fuse = Fuse(once=once)
    problem = make(fuse)
    solve(problem, method, max_iterations=0)
    before = fuse.calls
    fuse.reset()
    undisturbed = solve(problem, method, max_iterations=4)
    total = fuse.calls
    for at in np.linspace(before + 1, total - 1, 7).astype(int):
        fuse.reset(int(at))
        result = solve(problem, method, max_iterations=4)
        fuse.reset()
        assert result.status is Status.FAILED and not result.success
        assert "Broken: the 220 V are gone" in result.message and "best iterate so far" in result.message
        assert "\n" not in result.message
        assert result.error.startswith("Traceback") and "Broken" in result.error and "fuse()" in result.error
        assert_consistent(problem, result)
        assert undisturbed.cost <= result.cost * (1.0 + 1e-9)
    assert undisturbed.error == ""


@pytest.mark.parametrize("method", ["slq", "newton"])
@pytest.mark.parametrize("once", [True, False], ids=["once", "for good"])
def test_an_error_while_gaps_are_open(method, once):
    """What is left can be a guess whose gaps nobody can close any more; it is handed over all the same."""
    fuse = Fuse(once=once)
    problem = fused_dynamics(fuse, N=40)
    solve(problem, method, X0=SWING, max_iterations=0)
    before = fuse.calls
    fuse.reset()
    solve(problem, method, X0=SWING, max_iterations=3)
    total = fuse.calls
    outcomes = set()
    for at in np.linspace(before + 1, total - 1, 12).astype(int):
        fuse.reset(int(at))
        result = solve(problem, method, X0=SWING, max_iterations=3)
        fuse.reset()
        assert result.status is Status.FAILED and "Broken" in result.message, result.message
        assert "Broken" in result.error and result.trajectory.horizon == 40
        ends = problem.dynamics.step_each(result.trajectory.X, result.trajectory.U)[0]
        obeys = bool(np.abs(result.trajectory.X[1:] - ends).max() < 1e-9)
        assert obeys != ("gaps" in result.message)  # said where it does not
        outcomes.add(obeys)
        if obeys:
            assert_consistent(problem, result)
    assert once or False in outcomes


@pytest.mark.parametrize("iteration", [0, 2])
@pytest.mark.parametrize("method", METHODS)
def test_an_error_in_the_callback_keeps_the_step_just_taken(method, iteration):
    def callback(entry):
        if entry.iteration == iteration and entry.outcome == "accepted":
            raise Broken("no more")

    problem = function_pendulum(-4.0, 8.0)
    result = solve(problem, method, callback=callback)
    assert result.status is Status.FAILED and result.iterations == iteration + 1
    assert "Broken: no more" in result.message and "no more" in result.error
    assert_consistent(problem, result)
    twin = solve(problem, method, max_iterations=iteration + 1)
    np.testing.assert_array_equal(result.trajectory.U, twin.trajectory.U)
    assert result.gradient_norm == twin.gradient_norm
    if method != "gradient":  # the gains of this iterate, not of the one before
        np.testing.assert_allclose(result.gains, twin.gains, rtol=1e-9, atol=1e-9)


def test_an_error_of_the_simulator(monkeypatch):
    problem, calls, rollouts = mujoco_pendulum(), [], MujocoDynamics.rollouts

    def fused(self, *args):
        calls.append(args)
        if len(calls) >= 4:
            raise mujoco.FatalError("mj_stackAlloc: out of memory")
        return rollouts(self, *args)

    monkeypatch.setattr(MujocoDynamics, "rollouts", fused)
    result = solve(problem, "slq")
    monkeypatch.undo()
    assert result.status is Status.FAILED and "FatalError: mj_stackAlloc: out of memory" in result.message
    assert_consistent(problem, result)
    assert result.iterations > 0


def test_an_error_at_the_start_is_the_callers():
    """There is nothing to keep yet."""
    fuse = Fuse()
    problem = fused_dynamics(fuse)
    fuse.reset(1)
    with pytest.raises(Broken):
        solve(problem, "slq")


def test_the_error_is_kept_with_the_result(tmp_path):
    def callback(entry):
        raise Broken("kept")

    result = solve(pendulum(), "slq", callback=callback)
    result.save(tmp_path / "one.npz")
    again = mjslq.load(tmp_path / "one.npz")
    assert again.error == result.error and "Broken: kept" in again.error and again.status is Status.FAILED


@pytest.mark.parametrize("error", [SystemExit, GeneratorExit])
def test_what_ends_the_program_ends_the_solve(error):
    def callback(entry):
        raise error

    with pytest.raises(error):
        solve(pendulum(), "slq", callback=callback)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# Ctrl-C


@pytest.mark.parametrize("method", METHODS)
def test_a_deadline_that_has_passed_leaves_the_start(method):
    problem = pendulum()
    result = solve(problem, method, deadline=1e-9)
    assert result.status is Status.OUT_OF_TIME and result.iterations == 0 and len(result.log) == 1
    assert result.log[0].outcome == "final" and "deadline" in result.message
    assert_consistent(problem, result)
    assert result.options["deadline"] == 1e-9


def test_a_deadline_leaves_the_best_iterate():
    problem = pendulum()
    result = solve(problem, "slq", tol=1e-12, deadline=0.12, callback=lambda entry: time.sleep(0.05))
    assert result.status is Status.OUT_OF_TIME and result.iterations <= 3
    assert_consistent(problem, result)
    assert solve(problem, "slq", deadline=1e6).success


@pytest.mark.parametrize("deadline", [0.0, -1.0, np.nan, "soon"])
def test_wrong_deadlines_are_refused(deadline):
    with pytest.raises(ValueError, match="deadline must be"):
        solve(pendulum(), deadline=deadline)


# Tests of convergence


def test_the_message_says_which_test_fired():
    by_gradient = solve(pendulum(), "newton", tol_direction=0.0, tol_gradient=1e-5)
    assert "projected gradient" in by_gradient.message and "within tol_gradient = 1e-05" in by_gradient.message
    assert "tol_direction" not in by_gradient.message and by_gradient.gradient_norm <= 1e-5
    by_direction = solve(pendulum(), "newton", tol_direction=1e-3, tol_gradient=0.0)
    assert "within tol_direction = 0.001" in by_direction.message and "tol_gradient" not in by_direction.message
    last = by_direction.log[-1]
    assert last.direction_norm <= 1e-3 * np.linalg.norm(by_direction.trajectory.U)
    assert by_direction.gradient_norm > 0.0


@pytest.mark.parametrize("kind", ["control", "state"])
def test_a_damped_direction_is_no_sign_of_convergence(kind):
    """A huge multiplier makes any direction short."""
    options = {"multiplier": kind, "damping": 1e9, "tol_direction": 1e-3, "tol_gradient": 0.0, "U0": [5.0]}
    result = solve(pendulum(), "slq", max_iterations=100, **options)
    first = result.log[0]
    assert first.direction_norm <= 1e-3 * np.linalg.norm(result.iterates[0].U) and first.multiplier > 0.0
    assert result.iterations > 3
    if result.success:
        assert result.gradient_norm < 0.05 * first.gradient_norm


def test_a_direction_of_the_ball_is_no_sign_of_convergence():
    result = solve(pendulum(), "trust-region", radius=1e-6, tol_direction=1e-3, tol_gradient=0.0, U0=[5.0])
    first = result.log[0]
    assert first.direction_norm <= 1e-3 * np.linalg.norm(result.iterates[0].U)
    assert result.success and result.iterations > 10 and result.gradient_norm < 0.05 * first.gradient_norm


def test_steepest_descent_is_not_tested_by_its_direction():
    result = solve(pendulum(), "gradient", tol_direction=1e9, tol_gradient=1e-9, max_iterations=5)
    assert result.status is Status.MAX_ITERATIONS and result.iterations == 5


def test_a_trial_that_was_refused_at_every_size_ends_the_solve():
    """A wrong Jacobian: the ball shrinks to nothing."""
    dynamics = FunctionDynamics(
        lambda x, u: x + u, 1, 1, 1.0, integrator="map", jacobian=lambda x, u, t: (np.eye(1), -np.eye(1))
    )
    problem = Problem(dynamics, 5, [1.0], [costs.Control(1e-3), costs.State(1.0, when="always")])
    result = solve(problem, "trust-region", hessian="gauss-newton")
    assert result.status is Status.STEP_TOO_SMALL and result.iterations == 0
    assert {entry.outcome for entry in result.log[:-1]} == {"rejected"} and result.log[-1].outcome == "failed"
    assert "check_derivatives=True" in result.message


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_start_whose_cost_is_no_number(method, value):
    problem = Problem(
        pendulum().dynamics, 5, [0.0, 0.0], [costs.Control(1.0), costs.Function(lambda x, u, t: value + 0.0 * x[0])]
    )
    result = solve(problem, method)
    assert result.status is Status.DIVERGED and result.cost == np.inf and result.iterations == 0
    assert "cost of the start is not finite" in result.message


@pytest.mark.parametrize("method", METHODS)
def test_a_start_that_blows_up(method):
    dynamics = FunctionDynamics(lambda x, u: x * x + u, 1, 1, 1.0, integrator="map")
    result = solve(Problem(dynamics, 20, [10.0], [costs.Control(1.0)], Bounds(u=(-1.0, 1.0))), method)
    assert result.status is Status.DIVERGED and f"blew up at step {result.trajectory.diverged_at}" in result.message
    assert result.gradient_norm == np.inf and result.multipliers == {} and result.gains is None
    assert not result.active_limits.any()


# What is counted


@pytest.mark.parametrize("method", METHODS)
def test_rollouts_counted_do_not_depend_on_the_number_of_threads(method):
    logs = []
    for threads in (1, 2, 5):
        problem = mujoco_pendulum()
        dynamics = MujocoDynamics.from_model(problem.dynamics.model, threads=threads)
        same = Problem(dynamics, 30, problem.x0, problem.costs)
        logs.append([(e.cost, e.alpha, e.evaluations) for e in solve(same, method, max_iterations=15).log])
    assert logs[0] == logs[1] == logs[2]


@pytest.mark.parametrize("method", ["slq", "newton", "trust-region", "gradient"])
def test_on_one_thread_the_rollouts_counted_are_those_made(monkeypatch, method):
    problem, made = pendulum(), []
    rollouts = FunctionDynamics.rollouts

    def counted(self, x0s, U, *rest):
        made.append(len(U))
        return rollouts(self, x0s, U, *rest)

    monkeypatch.setattr(FunctionDynamics, "rollouts", counted)
    result = solve(problem, method, max_iterations=10)
    assert sum(made) == 1 + sum(entry.evaluations for entry in result.log)  # the start, too


def test_keep_iterates_off_keeps_none():
    result = solve(pendulum(), "slq", keep_iterates=False)
    assert result.iterates == () and len(result.log) > 1 and result.success


# Time


def test_compiling_is_told_apart():
    @njit
    def fresh(x, u):
        out = np.empty_like(x)
        out[0] = x[1]
        out[1] = u[0] - 9.81 * np.sin(x[0]) - 0.2 * x[1]
        return out

    problem = pendulum(dynamics=FunctionDynamics(fresh, 2, 1, 0.05))
    began = time.perf_counter()
    first = solve(problem, "newton")
    wall = time.perf_counter() - began
    second = solve(problem, "newton")
    assert first.compile_seconds > 0.0 and first.seconds > 0.0
    assert first.seconds + first.compile_seconds <= wall
    assert second.compile_seconds == 0.0 < second.seconds
    assert first.log[-1].seconds <= first.seconds


def test_the_clock_counts_a_compilation_within_another_once():
    @njit
    def inner(x):
        return x + 1.0

    @njit
    def outer(x):
        return inner(x) * 2.0

    began = time.perf_counter()
    with CompileClock() as clock:
        assert clock.seconds == 0.0
        outer(1.0)
        first = clock.seconds
        outer(1.0)
        assert clock.seconds == first
    assert 0.0 < first <= time.perf_counter() - began
    outer(1)  # compiled after the clock has stopped
    assert clock.seconds == first
