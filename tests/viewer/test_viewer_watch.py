"""A solve that is watched: nothing about it changes, stopping loses nothing, and a broken viewer does it no harm."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import mjslq
from mjslq.log import IterationLog
from mjslq.viewer import watching
from mjslq.viewer.plots import CostPlot
from mjslq.viewer.watching import Watch

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def problem() -> mjslq.Problem:
    return mjslq.problems.get("van_der_pol", horizon=40)


@pytest.fixture(scope="module")
def endless() -> mjslq.Problem:
    """One that steepest descent goes on with for ever."""
    return mjslq.problems.get("drag_particle", beta=0.5, horizon=400)


@pytest.fixture
def watch(endless: mjslq.Problem) -> Iterator[Watch]:
    with Watch(endless, "gradient", tol=0.0, max_iterations=10**9, keep_iterates=False) as running:
        yield running


def test_a_watched_solve_is_the_same_solve(problem: mjslq.Problem, capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[int] = []
    window = mjslq.watch(problem, "slq", block=False, watcher=lambda entry, trajectory: seen.append(entry.iteration))
    try:
        assert window.url in capsys.readouterr().out
        alone = mjslq.solve(problem, "slq")
        np.testing.assert_array_equal(window.result.trajectory.U, alone.trajectory.U)
        assert window.result.message == alone.message and seen == [entry.iteration for entry in alone.log]
        assert window.player is not None and window.player.url == window.url and window.trouble is None
        window.player.seek(1.0)
    finally:
        window.stop()
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("mjslq")]


def test_stopping_keeps_the_best_iterate(watch: Watch, endless: mjslq.Problem) -> None:
    threading.Timer(0.3, watch.stop_solve).start()
    result = watch.run()
    assert result.status is mjslq.Status.STOPPED and "Stop button" in result.message
    assert result.cost == endless.cost(result.trajectory) <= min(entry.cost for entry in result.log)
    assert watch.player is not None and watch.player.running


def test_ctrl_c_keeps_the_best_iterate(problem: mjslq.Problem) -> None:
    def interrupt(entry: IterationLog) -> None:
        if entry.iteration == 2:
            os.kill(os.getpid(), signal.SIGINT)

    window = mjslq.watch(problem, "gradient", block=False, callback=interrupt)
    try:
        assert window.result.status is mjslq.Status.INTERRUPTED and window.player is not None
    finally:
        window.stop()


def test_errors_of_the_viewer_do_not_harm_the_solve(watch: Watch, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = threading.Event()

    def break_down(*_: Any) -> None:
        failed.set()
        raise RuntimeError("no paint left")

    monkeypatch.setattr(watching._Window, "draw", break_down)
    stop = threading.Thread(target=lambda: (failed.wait(10.0), watch.stop_solve()))
    stop.start()
    result = watch.run()
    stop.join()
    assert result.status is mjslq.Status.STOPPED and str(watch.trouble) == "no paint left"


def test_a_player_that_cannot_start_leaves_the_result(
    problem: mjslq.Problem, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: Any) -> None:
        raise ValueError("no room")

    monkeypatch.setattr(watching.Player, "take_over", refuse)
    window = mjslq.watch(problem, "slq", block=False)
    assert window.result.success and window.player is None
    assert "the viewer failed, the solve did not: no room" in capsys.readouterr().err


def test_wrong_input_is_refused_and_closes_the_window(problem: mjslq.Problem) -> None:
    with pytest.raises(ValueError, match=r"must be a mjslq\.Problem, got dict"):
        mjslq.watch(cast(Any, {}))
    with pytest.raises(ValueError, match="unknown method 'sql'"):
        mjslq.watch(problem, "sql")
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("mjslq")]
    with pytest.raises(RuntimeError, match="has not ended"):
        _ = Watch(problem).result
    with pytest.raises(ValueError, match="unknown iterate 'worst'; there are: newest, best"):
        Watch(problem).show(cast(Any, "worst"))


def test_the_best_has_the_least_violation_and_then_the_least_cost(problem: mjslq.Problem) -> None:
    window, trajectory = Watch(problem), problem.rollout(np.zeros(1))
    for cost, violation in ((5.0, 0.0), (1.0, 0.3), (4.0, 1e-9), (np.nan, 0.0), (4.5, 0.0)):
        entry = IterationLog(0, cost, 1.0, 1.0, -1.0, 1.0, violation=violation)
        assert not window.observe(entry, trajectory)
    assert window._best is not None and window._best[0].cost == 4.0
    assert window._newest is not None and window._newest[0].cost == 4.5


def test_what_moves_and_its_numbers_are_drawn(arm: mjslq.Result) -> None:
    """With a scene, of an iterate that swings far out and of one that blew up."""
    assert arm.scene is not None
    pendulum = mjslq.FunctionDynamics(lambda x, u: np.array([x[2], x[3], u[0], u[1]]), 4, 2, 0.05)
    problem = mjslq.Problem(pendulum, 20, np.zeros(4), [mjslq.costs.Control(1.0)], drawing=arm.scene)
    with Watch(problem) as window:
        drawn, calm = window._window, problem.rollout([0.0, 0.0])
        assert drawn is not None
        wild = problem.rollout([9.0, -3.0])
        X = wild.X.copy()
        X[5:] = np.nan
        lost = mjslq.Trajectory(X, wild.U, dt=0.05, diverged_at=5)
        cameras = []
        for trajectory in (calm, wild, lost):
            entry = IterationLog(0, 3.0, 1.0, 1.0, -1.0, 0.5, multiplier=0.25, violation=0.1)
            drawn._next_change = 0.0
            drawn.draw([entry], (entry, trajectory), False)
            cameras.append(np.array(window.server.initial_camera.position))
        assert "0.25" in drawn._card.content and "solving" in drawn._card.content
        assert np.linalg.norm(cameras[1]) > np.linalg.norm(cameras[0])


def test_axes_of_growing_curves_hold_them_and_seldom_change(problem: mjslq.Problem) -> None:
    log = [IterationLog(i, 1e3 * 0.9**i + 1.0, 1.0, 1.0, -1.0, 1.0) for i in range(200)]
    with Watch(problem) as window:
        plot, axes = CostPlot(window.server.gui, log[:1], False, growing=True), []
        for end in range(1, 201):
            plot.update(log[:end])
            (_, last), (low, high) = plot._room["cost"]
            values = plot._curves["cost"][1]
            assert last >= end - 1 and low < values.min() and values.max() < high
            axes.append(plot._room["cost"])
    assert len(set(axes)) <= 20


def test_the_command_watches_and_then_plays(tmp_path: Path) -> None:
    arguments = ["solve", "drag_particle", "-s", "beta=0.01", "--watch", "--json", "--save", str(tmp_path / "drag.npz")]
    process = subprocess.Popen(
        [sys.executable, "-m", "mjslq.cli", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # background jobs of a shell ignore it
    )  # fmt: skip
    assert process.stdout is not None and process.stderr is not None
    assert process.stderr.readline().startswith("viewer at http://127.0.0.1:")
    for line in process.stderr:
        if line.startswith("the solve has ended"):
            break
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0 and "Traceback" not in err
    assert json.loads(out)["status"] == "converged"
    assert mjslq.load(tmp_path / "drag.npz").success
