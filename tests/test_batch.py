"""Many problems at once: the same results wherever they are solved, errors apart, folders that take up again."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import numpy as np
import pytest

import mjslq
from mjslq.batch import Solved


def pole(target=0.5, horizon=20, **options):
    """A damped pole is turned to an angle [rad]."""
    dynamics = mjslq.MujocoDynamics.from_xml(POLE, threads=1)
    costs = [mjslq.costs.Control(0.01), mjslq.costs.State([10.0, 1.0], [target, 0.0], "terminal")]
    return mjslq.Problem(dynamics, horizon, np.zeros(2), costs, name="pole", **options)


POLE = """<mujoco><option timestep=".02"/><worldbody><body><joint axis="0 1 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1"/></body></worldbody>
<actuator><motor joint="joint0" name="m" ctrlrange="-2 2"/></actuator></mujoco>""".replace(
    "<joint axis", '<joint name="joint0" axis'
)


class Dies:
    """A cost that ends the process that it is evaluated in, without a word."""

    def __call__(self, x, u, t):
        if os.environ.get("MJSLQ_TEST_MAIN") != str(os.getpid()):
            os._exit(9)
        return 0.0 * x[0]


class Inline(Executor):
    """Solves at once, in this thread."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except BaseException as error:
            future.set_exception(error)
        return future


def same(a, b):
    return np.array_equal(a.trajectory.X, b.trajectory.X) and np.array_equal(a.gains, b.gains) and a.cost == b.cost


def test_threads_give_what_solve_gives():
    problems = [pole(target) for target in (0.1, 0.2, 0.3, 0.4)]
    with ThreadPoolExecutor(2) as executor:
        found = sorted(mjslq.solve_many(problems, executor), key=lambda solved: solved.index)
    assert [solved.index for solved in found] == [0, 1, 2, 3] and all(solved.success for solved in found)
    assert all(same(solved.result, mjslq.solve(problem)) for solved, problem in zip(found, problems, strict=True))
    assert all(isinstance(solved, Solved) and not solved.result.iterates for solved in found)


def test_thirty_problems_on_two_processes_are_those_of_one_process():
    problems = [pole(target) for target in np.linspace(-1.0, 1.0, 30)]
    found = list(mjslq.solve_many(problems, workers=2, ordered=True))
    assert [solved.index for solved in found] == list(range(30))
    for solved, problem in zip(found, problems, strict=True):
        assert solved.success and same(solved.result, mjslq.solve(problem))


def test_an_error_is_a_record_and_takes_nobody_along():
    broken = pole(U0=np.full((20, 1), 0.1))
    object.__setattr__(broken, "U0", np.zeros((3, 1)))
    found = list(mjslq.solve_many([pole(), broken, "no problem", pole(0.2)], Inline(), ordered=True))
    assert [solved.success for solved in found] == [True, False, False, True]
    assert "must have shape" in found[1].error and found[1].result is None
    assert "problem must be a mjslq.Problem" in found[2].error


def test_a_process_that_dies_takes_nobody_along(monkeypatch):
    monkeypatch.setenv("MJSLQ_TEST_MAIN", str(os.getpid()))
    deadly = pole(0.3)
    deadly = mjslq.Problem(
        deadly.dynamics, 20, deadly.x0, [*deadly.costs, mjslq.costs.Residual(Dies(), 1.0, "running")], name="deadly"
    )
    found = list(mjslq.solve_many([deadly, pole(0.2)], workers=1, ordered=True))  # both are under way when it dies
    assert [solved.success for solved in found] == [False, True]
    assert "process that solved it died" in found[0].error


def test_a_folder_takes_up_where_it_was_left(tmp_path):
    problems = [pole(target) for target in (0.1, 0.2, 0.3)]
    with ThreadPoolExecutor(1) as executor:
        first = list(mjslq.solve_many(problems[:2], executor, out=tmp_path))
        assert sorted(path.name for path in tmp_path.iterdir()) == ["0000_pole.npz", "0001_pole.npz"]
        assert all(same(mjslq.load(solved.file), solved.result) for solved in first)
        again = list(mjslq.solve_many(problems, executor, out=tmp_path, ordered=True))
    assert [solved.resumed for solved in again] == [True, True, False]
    assert all(same(solved.result, mjslq.solve(problem)) for solved, problem in zip(again, problems, strict=True))


@pytest.mark.parametrize(
    "other, options, said",
    [
        (pole(0.7), {}, "cost"),
        (pole(0.1, horizon=10), {}, "20 steps"),
        (pole(0.1).at([0.1, 0.0]), {}, "other states"),
        (pole(0.1, bounds=mjslq.Bounds(u=(-1.0, 1.0))), {}, "other limits"),
        (pole(0.1), {"tol_gradient": 1e-3}, "tol_gradient = 1e-06, not 0.001"),
        (pole(0.1), {"method": "newton"}, "method 'auto', not 'newton'"),
    ],
)
def test_a_file_of_another_problem_is_not_taken_for_this_ones(other, options, said, tmp_path):
    list(mjslq.solve_many([pole(0.1)], Inline(), out=tmp_path))
    with pytest.raises(ValueError, match=rf"0000_pole.npz belongs to another problem or other options.*{said}"):
        list(mjslq.solve_many([other], Inline(), out=tmp_path, **options))


def test_errors_are_files_until_the_problem_is_solved(tmp_path):
    list(mjslq.solve_many([pole()], Inline(), out=tmp_path, guess="perhaps"))
    file = tmp_path / "0000_pole.error.json"
    assert "perhaps" in json.loads(file.read_text())["error"]
    list(mjslq.solve_many([pole()], Inline(), out=tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["0000_pole.npz"]


def test_problems_are_taken_as_there_is_room():
    taken = []

    def coming():
        for i in range(10):
            taken.append(i)
            yield pole(0.1 * i)

    found = mjslq.solve_many(coming(), Inline(), in_flight=2)
    next(found)
    assert len(taken) <= 3
    assert len(list(found)) == 9


KILLED = """
import sys, time
sys.path.insert(0, {tests!r})
from test_batch import Inline, pole
import mjslq

for solved in mjslq.solve_many([pole(t / 30) for t in range(30)], Inline(), out={out!r}, in_flight=2):
    print(solved.index, solved.resumed, flush=True)
    if solved.index == 4 and sys.argv[1:] == ["wait"]:
        time.sleep(600.0)
"""


def test_a_killed_run_resumes(tmp_path):
    script, out = tmp_path / "many.py", tmp_path / "runs"
    script.write_text(KILLED.format(tests=os.path.dirname(__file__), out=str(out)))
    process = subprocess.Popen(
        [sys.executable, str(script), "wait"], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    for line in process.stdout:
        if line.startswith("4 "):
            break
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    before = {path.name: path.stat().st_mtime_ns for path in out.glob("*.npz")}
    assert 5 <= len(before) < 30
    time.sleep(0.01)
    again = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=100)
    assert again.returncode == 0, again.stderr
    lines = [line.split() for line in again.stdout.splitlines()]
    assert len(lines) == 30 and sum(resumed == "True" for _, resumed in lines) == len(before)
    assert len(list(out.glob("*.npz"))) == 30
    assert all((out / name).stat().st_mtime_ns == stamp for name, stamp in before.items())


@pytest.mark.parametrize(
    "arguments, said",
    [
        ({"problems": [], "executor": 2}, "executor must be a concurrent.futures.Executor, got int"),
        ({"problems": [], "executor": Inline(), "workers": 2}, "either executor or workers"),
        ({"problems": [], "workers": 0}, "workers must be a whole number of at least 1"),
        ({"problems": [], "in_flight": 0}, "in_flight must be a whole number of at least 1"),
        ({"problems": [], "out": __file__}, "cannot write to .*test_batch.py: File exists"),
        ({"problems": pole()}, "problems must be several"),
    ],
)
def test_wrong_input_is_answered_at_once(arguments, said):
    with pytest.raises(ValueError, match=said):
        mjslq.solve_many(**arguments)


def test_the_progress_bar_counts(capsys):
    found = list(mjslq.solve_many([pole(), pole(0.1)], Inline(), progress=True))
    assert len(found) == 2
    assert "2/2" in capsys.readouterr().err
