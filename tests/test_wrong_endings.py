"""Programs that are cut short: Ctrl-C at each stage and twice, readers that have gone, streams and homes that are not.

A result that was asked for is on disk afterwards, whole; standard error has one sentence at most.
"""

import os
import shlex
import signal
import subprocess
import sys

import numpy as np
import pytest
from test_cli import hear_ctrl_c
from test_interrupts import interrupt
from wrong_inputs import one_sentence, pose

import mjslq
from mjslq import MPC, Result, Status, cli, costs
from mjslq import __main__ as program

COMMAND = f"{shlex.quote(sys.executable)} -m mjslq"
ENDLESS = ["solve", "hopper", "-m", "gradient", "-s", "tol=0", "-s", "max_iterations=1000000"]


@pytest.fixture(autouse=True)
def own_handler():
    """Python's own handler, whatever the tests before have left."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def run(arguments, monkeypatch, capsys, main=cli.main):
    monkeypatch.setattr("sys.argv", ["mjslq", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    out, err = capsys.readouterr()
    return ended.value.code, out, err


def stopped(*given, **options):
    """What Ctrl-C does to whatever runs."""
    interrupt()
    raise AssertionError("there was no KeyboardInterrupt")


STAGES = [
    ("imports", ["list"], "mjslq.cli.main"),
    ("list", ["list"], "mjslq.problems.names"),
    ("pose", ["solve", "hopper"], "mjslq.problems.get"),
    ("check", ["check", "hopper"], "mjslq.dynamics.dynamics.Dynamics.check_derivatives"),
    ("compare", ["compare", "drag_particle"], "mjslq.reports.compare.compare"),
    ("sweep", ["sweep", "drag_particle"], "mjslq.batch.solve_many"),
    ("bench", ["bench", "hopper"], "mjslq.reports.bench.run"),
    ("load", ["explain", "one.npz"], "mjslq.result.load"),
    ("new", ["new", "panda", "-o", "task.toml"], "mjslq.tasks.writing.text_for"),
    ("schema", ["schema"], "json.dumps"),
]


@pytest.mark.parametrize("arguments, place", [pytest.param(row[1], row[2], id=row[0]) for row in STAGES])
def test_ctrl_c_in_a_command(arguments, place, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(place, stopped)
    code, _, err = run(arguments, monkeypatch, capsys, program.main)
    assert code == 130 and os.listdir(tmp_path) == []
    one_sentence(err.strip().splitlines()[-1], "mjslq: interrupted")
    assert "Traceback" not in err


@pytest.mark.parametrize("times", [1, 2, 3])
@pytest.mark.parametrize("when", ["before", "after"])
def test_ctrl_c_while_a_result_is_saved_waits_for_it(when, times, monkeypatch, capsys, tmp_path):
    save = Result.save

    def disturbed(result, path):
        for _ in range(times if when == "before" else 0):
            interrupt()
        save(result, path)
        for _ in range(times if when == "after" else 0):
            interrupt()

    monkeypatch.setattr(Result, "save", disturbed)
    file = tmp_path / "one.npz"
    code, out, err = run(["solve", "drag_particle", "-q", "--save", str(file)], monkeypatch, capsys)
    assert (code, out, err) == (130, "", "mjslq: interrupted\n")
    assert mjslq.load(file).success and os.listdir(tmp_path) == ["one.npz"]


@pytest.mark.parametrize("place", ["mjslq.reports.tables.print_summary", "mjslq.viewer.view"])
def test_ctrl_c_after_a_result_is_saved(place, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(place, stopped)
    file = tmp_path / "one.npz"
    code, _, err = run(["solve", "drag_particle", "--save", str(file), "--view"], monkeypatch, capsys)
    assert code == 130 and "Traceback" not in err
    assert mjslq.load(file).success


def test_ctrl_c_twice_from_outside_keeps_the_best_iterate(tmp_path):
    file = tmp_path / "hop.npz"
    process = subprocess.Popen(
        [sys.executable, "-m", "mjslq", *ENDLESS, "--save", str(file)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=hear_ctrl_c,
    )  # fmt: skip
    for line in process.stderr:  # it is iterating once the third iterate is on the screen
        if line.split()[:1] == ["3"]:
            break
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "Traceback" not in err, (out, err)
    result = mjslq.load(file)
    assert result.status is Status.INTERRUPTED and result.cost <= result.log[0].cost
    assert os.listdir(tmp_path) == ["hop.npz"]


def test_ctrl_c_in_a_plan_leaves_the_last_one_in_force():
    pressed = []

    def distance(x, u, t):
        if pressed:
            pressed.clear()
            interrupt()
        return x - np.array([1.0, 0.0])

    controller = MPC(pose(costs.Residual(distance, 1.0), x0=[0.1, 0.0]))
    first = controller.step([0.1, 0.0], 0.0)
    pressed.append(True)
    with pytest.raises(KeyboardInterrupt):
        controller.step([0.1, 0.0], 0.05)
    assert np.isfinite(controller.policy([0.1, 0.0], 0.0)).all() and np.isfinite(first).all()


# Streams and surroundings, each in a process of its own

SOLVE = f"{COMMAND} solve hopper -s height=1 --save one.npz"
SHELLS = [
    ("reader gone", f"{COMMAND} list | head -n 1", 0, ["problem"], ""),
    ("output full", f"{COMMAND} list > /dev/full", 2, [], "the output cannot be written: No space left on device"),
    ("output closed", f"{COMMAND} list >&-", 0, [], ""),
    ("all closed", f"{SOLVE} >&- 2>&- <&-", 0, [], ""),
    ("all full", f"{SOLVE} > /dev/full 2>&1", 2, [], ""),
    ("progress unread", f"{SOLVE} -q --json 2>&1 | head -n 0", 0, [], ""),
]


@pytest.mark.parametrize("command, code, starts, said", [pytest.param(*row[1:], id=row[0]) for row in SHELLS])
def test_surroundings(command, code, starts, said, tmp_path):
    if "/dev/full" in command and not os.path.exists("/dev/full"):
        pytest.skip("there is no /dev/full here")
    ended = subprocess.run(command, shell=True, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert ended.returncode == code, ended
    assert [line.split()[0] for line in ended.stdout.splitlines()] == starts
    if said:
        one_sentence(ended.stderr.strip(), "mjslq: " + said)
    else:
        assert ended.stderr == ""
    if "one.npz" in command:
        assert mjslq.load(tmp_path / "one.npz").success
        assert os.listdir(tmp_path) == ["one.npz"]


@pytest.mark.slow  # all kernels are made anew
@pytest.mark.parametrize(
    "setting",
    ["env -u HOME MJSLQ_CACHE_DIR=/dev/null/none", "TMPDIR=/dev/null HOME=/dev/null MJSLQ_CACHE_DIR=/dev/null"],
)
def test_there_is_no_home(setting, tmp_path):
    test_surroundings(f"{setting} {SOLVE} -q", 0, [], "", tmp_path)
