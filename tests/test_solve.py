"""`solve`: every way in which it can end, what it logs and prints, and what it refuses."""

import dataclasses
import functools
import io
import math

import numpy as np
import pytest
from small_problems import DOUBLE_INTEGRATOR, PENDULUM, drag, linear, pendulum, pendulum_equations

import mjslq
from mjslq import FunctionDynamics, Problem, Status, costs, problems
from mjslq.solvers.linesearch import SEARCHES

solve = functools.partial(mjslq.solve, method="slq")


# How a solve ends


def test_max_iterations():
    result = solve(pendulum(), max_iterations=2)
    assert result.status is Status.MAX_ITERATIONS and not result.success
    assert result.iterations == 2 and len(result.log) == 3 and len(result.iterates) == 3
    assert "Raise max_iterations" in result.message
    assert result.cost == result.log[-1].cost == pendulum().cost(result.trajectory)


def test_no_iterations_at_all_evaluates_the_start():
    result = solve(pendulum(), max_iterations=0)
    assert result.status is Status.MAX_ITERATIONS and result.iterations == 0 and len(result.log) == 1
    np.testing.assert_array_equal(result.trajectory.X, pendulum().rollout(np.zeros((40, 1))).X)


@pytest.mark.parametrize(
    "f, knot",
    [(lambda x, u: x * x + u, 7), (lambda x, u: np.where(x.real > 1e3, np.nan, 10.0 * x), 5)],
    ids=["blow-up", "nan"],
)
def test_a_start_that_diverges_is_a_status(f, knot):
    dynamics = FunctionDynamics(f, 1, 1, 1.0, integrator="map")
    result = solve(Problem(dynamics, 20, [10.0] if knot == 5 else [2.0], [costs.Control(1.0)]))
    assert result.status is Status.DIVERGED and not result.success
    assert result.cost == math.inf and result.gradient_norm == math.inf and result.iterations == 0
    assert result.trajectory.diverged_at is not None
    assert f"step {result.trajectory.diverged_at}" in result.message and "guess=" in result.message
    assert result.gains is None and result.log == () and "controls" not in result.multipliers


def test_a_cost_that_is_not_finite_is_a_status():
    problem = Problem(DOUBLE_INTEGRATOR, 5, [1.0, 0.0], [costs.Control(1.0), costs.Function(lambda x, u, t: math.inf)])
    result = solve(problem)
    assert result.status is Status.DIVERGED and "cost of the start is not finite" in result.message
    assert "blew up" not in result.message  # it did not


def test_derivatives_that_are_not_finite_are_a_status():
    def jacobian(x, u, t):
        return np.full((2, 2), np.nan), np.zeros((2, 1))

    dynamics = FunctionDynamics(pendulum_equations, 2, 1, 0.05, jacobian=jacobian)
    result = solve(pendulum(dynamics=dynamics))
    assert result.status is Status.DIVERGED
    assert "derivatives along the trajectory are not finite" in result.message
    assert "blew up" not in result.message  # it did not
    assert np.isfinite(result.cost) and np.isfinite(result.trajectory.X).all()


@pytest.mark.parametrize("line_search", sorted(SEARCHES))
def test_a_wrong_jacobian_ends_in_a_step_too_small(line_search):
    def jacobian(x, u, t):
        return np.eye(2), np.array([[0.0], [-0.1]])  # of the wrong sign

    dynamics = FunctionDynamics(DOUBLE_INTEGRATOR._f, 2, 1, 0.1, jacobian=jacobian)
    problem = Problem(dynamics, 10, [0.0, 0.0], [costs.Control(1e-3), costs.State([0.0, 1.0], [0.0, 1.0], "terminal")])
    result = solve(problem, line_search=line_search, max_iterations=20)
    assert result.status is Status.STEP_TOO_SMALL
    assert result.iterations == 0 and [entry.outcome for entry in result.log] == ["failed"]
    assert "check_derivatives=True" in result.message


def stop_at(iteration, how):
    def callback(entry):
        if entry.iteration == iteration:
            if how is KeyboardInterrupt:
                raise KeyboardInterrupt
            return how
        return None

    return callback


def test_callback_stops_by_returning_true():
    result = solve(pendulum(), callback=stop_at(2, True))
    assert result.status is Status.STOPPED
    assert "callback" in result.message
    assert_consistent(result, pendulum())


def test_callback_sees_every_entry_and_nothing_else_stops():
    entries = []
    result = solve(pendulum(), callback=lambda entry: entries.append(entry))
    assert result.success and tuple(entries) == result.log
    assert [entry.iteration for entry in entries] == list(range(len(entries)))


@pytest.mark.parametrize("iteration", [0, 3])
def test_ctrl_c_in_the_callback_keeps_the_step_just_taken(iteration):
    result = solve(pendulum(), callback=stop_at(iteration, KeyboardInterrupt))
    assert result.status is Status.INTERRUPTED
    assert_consistent(result, pendulum())


@pytest.mark.parametrize("calls", [400, 700, 1500, 4000])
def test_ctrl_c_in_the_model_keeps_the_best_iterate(calls):
    left = [math.inf]

    def f(x, u):
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        return np.stack([x[1], u[0] - 9.81 * np.sin(x[0]) - 0.1 * x[1]])

    problem = pendulum(dynamics=FunctionDynamics(f, 2, 1, 0.05))
    left[0] = calls
    result = solve(problem)
    assert result.status is Status.INTERRUPTED and "best iterate so far" in result.message
    left[0] = math.inf
    assert result.cost == problem.cost(result.trajectory) <= min((entry.cost for entry in result.log), default=math.inf)
    assert_consistent(result, problem)


def assert_consistent(result, problem):
    """What came out is the iterate after as many steps as it says, with its own cost, gradient and gains."""
    assert result.cost == problem.cost(result.trajectory)
    twin = solve(problem, max_iterations=result.iterations)
    assert result.cost == pytest.approx(twin.cost, rel=1e-12)
    np.testing.assert_allclose(result.trajectory.U, twin.trajectory.U, rtol=1e-9, atol=1e-12)
    assert result.gradient_norm == pytest.approx(np.linalg.norm(problem.gradient(result.trajectory)), rel=1e-9)
    if result.log:  # else it ended before the first sweep, and has no gains
        np.testing.assert_allclose(result.gains, twin.gains, rtol=1e-7, atol=1e-9)


def test_log_describes_each_iterate():
    problem = pendulum()
    result = solve(problem)
    assert len(result.log) == len(result.iterates) == result.iterations + 1
    for entry, trajectory in zip(result.log, result.iterates, strict=True):
        assert entry.cost == problem.cost(trajectory)
        assert entry.gradient_norm == pytest.approx(np.linalg.norm(problem.gradient(trajectory)))
        assert entry.slope < 0.0
    assert result.log[-1].alpha == 0.0 and all(0.0 < entry.alpha <= 1.0 for entry in result.log[:-1])
    assert [entry.outcome for entry in result.log] == ["accepted"] * result.iterations + ["final"]
    assert all(entry.predicted < 0.0 for entry in result.log[:-1])
    assert all(entry.evaluations >= 1 for entry in result.log[:-1])
    seconds = [entry.seconds for entry in result.log] + [result.seconds]
    assert seconds == sorted(seconds)
    assert solve(problem, keep_iterates=False).iterates == ()


def test_tolerances_can_be_set_apart():
    problem = pendulum()
    loose = solve(problem, tol=1e-1)
    tight = solve(problem, tol_direction=0.0, tol_gradient=1e-7)
    assert loose.success and tight.success and loose.iterations < tight.iterations
    assert tight.gradient_norm <= 1e-7
    last = solve(problem, tol_gradient=0.0, tol_direction=1e-3).log[-1]
    assert last.direction_norm <= 1e-3 * np.linalg.norm(solve(problem).trajectory.U) * 1.01


def test_problem_options_hold_unless_told_otherwise():
    problem = pendulum(max_iterations=1)
    assert solve(problem).iterations == 1
    assert solve(problem, max_iterations=2).iterations == 2


# What is printed


def test_silent_means_silent(capfd):
    solve(pendulum())
    solve(pendulum(), max_iterations=1)
    assert capfd.readouterr() == ("", "")


def test_verbose_prints_aligned_lines(capsys):
    result = solve(drag(0.5), verbose=1)
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    table, last = lines[:-1], lines[-1]
    assert last == f"converged: {result.message}" and captured.err == ""
    assert len({len(line) for line in table}) == 1
    headers = [line for line in table if "cost" in line]
    rows = [line for line in table if "cost" not in line]
    assert len(rows) == len(result.log) and len(headers) == 1 + (len(rows) - 1) // 20
    ends = [i + len(name) for name in ("cost", "|gradient|", "|direction|", "step") for i in [headers[0].index(name)]]
    for line, entry in zip(rows, result.log, strict=True):
        assert all(line[end - 1] != " " and line[end] == " " for end in ends)
        words = line.split()
        assert int(words[0]) == entry.iteration
        assert float(words[1]) == pytest.approx(entry.cost, rel=1e-8)
        assert float(words[2]) == pytest.approx(entry.gradient_norm, rel=1e-2)


def test_verbose_goes_where_it_is_told(capsys):
    stream = io.StringIO()
    solve(linear(), verbose=1, stream=stream)
    assert "converged" in stream.getvalue() and capsys.readouterr().out == ""


# Checks before the start


@pytest.mark.parametrize("name, entry", [("A", (1, 0)), ("B", (1, 0))])
def test_derivative_check_refuses_a_wrong_jacobian(name, entry):
    def jacobian(x, u, t):
        right = PENDULUM.linearize(PENDULUM.rollout(x, u[None]))
        matrices = {"A": right.A[0], "B": right.B[0]}
        matrices[name][entry] *= 1.05
        return matrices["A"], matrices["B"]

    dynamics = FunctionDynamics(pendulum_equations, 2, 1, 0.05, jacobian=jacobian)
    place = rf"{name}\[\d+, {entry[0]}, {entry[1]}\]"
    with pytest.raises(ValueError, match=rf"derivative check: {name} is off at 100% of the knots, most at {place} by"):
        solve(pendulum(dynamics=dynamics), check_derivatives=True)


@pytest.mark.parametrize("make", [drag, linear, pendulum])
def test_derivative_check_lets_right_ones_through(make):
    assert solve(make(), check_derivatives=True, max_iterations=1).iterations == 1


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"method": "sql"}, r"unknown method 'sql'; there are: .*slq.*; did you mean 'slq'\?"),
        ({"linesearch": "armijo"}, "unknown option for method 'slq' 'linesearch'; there are: line_search, step, .*tol"),
        ({"linesearch": "armijo"}, r"did you mean 'line_search'\?"),
        ({"line_search": "armja"}, "unknown line_search 'armja'; there are: quadratic-fit, armijo, goldstein, wolfe"),
        ({"step": "loop"}, "unknown step 'loop'; there are: closed-loop, open-loop"),
        ({"acceleration": "no"}, "acceleration must be"),
        ({"tol": -1.0}, "tol.* must be a number of at least 0, got -1.0"),
        ({"tol": math.nan}, "tol.* must be a number of at least 0, got nan"),
        ({"tol": "small"}, "tol.* must be a number of at least 0, got 'small'"),
        ({"tol_gradient": math.inf}, "tol_gradient must be a number of at least 0, got inf"),
        ({"max_iterations": -1}, "max_iterations must be a whole number of at least 0, got -1"),
        ({"max_iterations": 2.5}, "max_iterations must be a whole number of at least 0, got 2.5"),
        ({"U0": np.zeros((3, 1))}, r"U0 must have shape \(40, 1\) or \(1,\), got \(3, 1\)"),
        ({"U0": np.full((40, 1), math.nan)}, r"U0 must be finite, but U0\[0, 0\] is nan"),
        ({"problem": PENDULUM}, "problem must be a"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused_in_one_sentence(change, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        solve(**({"problem": pendulum()} | change))
    assert "\n" not in str(caught.value)


def test_methods_tell_what_they_take():
    methods = mjslq.methods()
    search = {"line_search": "quadratic-fit", "step": "closed-loop", "acceleration": True}
    assert methods["slq"].options == search | {"multiplier": None, "damping": 1e-3, "rescue": True}
    assert methods["newton"].options == search | {"modification": "multiplier", "costates": "sweep"}
    assert methods["slq"].summary and methods["slq"].needs
    methods.clear()  # a copy
    assert "slq" in mjslq.methods()


@pytest.mark.parametrize("line_search", ["quadratic-fit", "armijo", "exact"])
def test_any_number_of_threads_gives_the_same_result(line_search):
    problem = problems.get("hopper", height=10.0)
    results = []
    for threads in (1, 3):
        dynamics = mjslq.MujocoDynamics.from_model(problem.dynamics.model, threads=threads)
        results.append(solve(dataclasses.replace(problem, dynamics=dynamics), line_search=line_search))
    one, three = results
    assert one.iterations == three.iterations
    np.testing.assert_array_equal(one.trajectory.U, three.trajectory.U)
    np.testing.assert_array_equal(one.gains, three.gains)
    assert [entry.evaluations for entry in one.log] == [entry.evaluations for entry in three.log]


def test_what_the_caller_asks_for_goes_before_what_the_problem_asks_for():
    """`tol` stands for both tolerances, also where the problem sets one of them."""
    problem = dataclasses.replace(pendulum(), options={"tol_direction": 0.5, "max_iterations": 3})
    assert solve(problem).success
    strict = solve(problem, tol=1e-9, max_iterations=200)
    assert strict.success and strict.iterations > 3
    assert strict.options["tol_direction"] == strict.options["tol_gradient"] == 1e-9


def test_options_of_a_problem_that_a_method_does_not_know_are_passed_over():
    problem = dataclasses.replace(pendulum(), options={"radius": 0.5, "line_search": "armijo"})
    result = solve(problem)
    assert result.success and result.options["line_search"] == "armijo" and "radius" not in result.options
    assert solve(problem, method="trust-region").log[0].radius == 0.5
