"""Ctrl-C, in a callback, from outside, twice in a row: none of it may lose the best iterate."""

import contextlib
import os
import signal
import threading
import time

import numpy as np
import pytest
from small_problems import pendulum
from test_endings import assert_consistent

from mjslq import Problem, Status, costs, problems, solve
from mjslq.solvers import loop
from mjslq.solvers.interrupts import Interrupts

METHODS = ["auto", "slq", "newton", "trust-region", "gradient"]
SWING = np.linspace(0.0, 1.0, 41)[:, None] * np.array([2.0, 0.0])


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.0)  # a bytecode, before which Python calls the handler


@pytest.mark.parametrize("method", METHODS)
def test_ctrl_c_in_a_callback(method):
    def callback(entry):
        if entry.iteration == 1:
            interrupt()

    problem = pendulum()
    result = solve(problem, method, callback=callback)
    assert result.status is Status.INTERRUPTED and "best iterate so far" in result.message
    assert_consistent(problem, result)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_from_outside():
    """While the solver itself is at work, which would go on for ever."""
    problem = problems.get("drag_particle", beta=0.5, horizon=400)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))

    def callback(entry):
        if entry.iteration == 0:  # from then on there is an iterate to keep
            timer.start()

    result = solve(problem, "gradient", max_iterations=10**9, tol=0.0, keep_iterates=False, callback=callback)
    timer.join()
    assert result.status is Status.INTERRUPTED
    assert result.cost == problem.cost(result.trajectory)


def test_ctrl_c_twice_in_a_row():
    def callback(entry):
        if entry.iteration == 1:
            try:
                interrupt()
            finally:
                interrupt()  # the user is impatient
                interrupt()

    problem = pendulum()
    result = solve(problem, "slq", callback=callback)
    assert result.status is Status.INTERRUPTED
    assert_consistent(problem, result)


@pytest.mark.parametrize("first", ["signal", "exception"])
def test_ctrl_c_again_while_the_result_is_put_together(first):
    """The gains of the last iterate are being found: whatever is pressed then waits until they are."""
    pressed = []

    def distance(x, u, t):
        if pressed:
            pressed.append(t)
            interrupt()
        return x - np.array([2.0, 0.0])

    def callback(entry):
        if entry.iteration == 2:
            pressed.append(-1.0)
            if first == "exception":
                raise KeyboardInterrupt
            interrupt()

    terms = [costs.Control(0.1), costs.Residual(distance, [200.0, 20.0], "terminal")]
    problem = Problem(pendulum().dynamics, 40, [0.0, 0.0], terms)
    result = solve(problem, "slq", callback=callback)
    assert len(pressed) > 1
    pressed.clear()
    assert result.status is Status.INTERRUPTED and result.iterations == 3
    assert_consistent(problem, result)
    twin = solve(problem, "slq", max_iterations=3)
    np.testing.assert_array_equal(result.gains, twin.gains)


def test_ctrl_c_after_the_end_loses_no_converged_result(monkeypatch):
    finish = loop._finish

    def interrupted(*given):
        interrupt()
        finish(*given)
        interrupt()

    monkeypatch.setattr(loop, "_finish", interrupted)
    result = solve(pendulum(), "slq")
    assert result.status is Status.CONVERGED


def test_ctrl_c_that_something_swallows_stops_the_solve_at_its_next_turn():
    seen = []

    def callback(entry):
        seen.append(entry.iteration)
        if entry.iteration == 1:
            with contextlib.suppress(KeyboardInterrupt):  # as a careless library does
                interrupt()

    result = solve(pendulum(), "slq", callback=callback)
    assert result.status is Status.INTERRUPTED and seen == [0, 1, 2] and result.iterations == 2


def test_a_program_with_a_handler_of_its_own_keeps_it():
    heard = []

    def handler(number, frame):
        heard.append(number)

    def callback(entry):
        if entry.iteration == 1:
            interrupt()

    before = signal.signal(signal.SIGINT, handler)
    try:
        result = solve(pendulum(), "slq", callback=callback)
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert heard == [signal.SIGINT] and result.success


def test_threads_other_than_the_main_one_solve_too():
    results = []
    thread = threading.Thread(target=lambda: results.append(solve(pendulum(), "slq")))
    thread.start()
    thread.join()
    assert results[0].success


def test_interrupts_are_raised_once_and_counted():
    with Interrupts() as interrupts:
        with pytest.raises(KeyboardInterrupt):
            interrupt()
        interrupt()
        interrupt()
        assert interrupts.count == 3
    with Interrupts() as held:
        held.hold()
        interrupt()
        assert held.count == 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# Deadlines
