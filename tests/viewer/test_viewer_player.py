"""The player: its life, its widgets from Python, and what it does with results that went wrong."""

from __future__ import annotations

import dataclasses
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import viser

from mjslq.log import IterationLog
from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.viewer import view
from mjslq.viewer.player import Player

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture
def player(arm: Result) -> Iterator[Player]:
    with Player(arm, autoplay=False) as running:
        yield running


def test_stopping_twice_and_starting_again(arm: Result, capsys: pytest.CaptureFixture[str]) -> None:
    player = Player(arm)
    player.stop()
    player.start()
    player.start()
    assert player.running and player.url.startswith("http://127.0.0.1:")
    player.stop()
    player.stop()
    assert not player.running
    with pytest.raises(RuntimeError, match="not running"):
        _ = player.url
    with player:
        assert player.running
    assert capsys.readouterr().out == ""
    assert not [thread for thread in threading.enumerate() if thread.name == "mjslq player"]


def test_slider_set_from_python_does_not_pause(arm: Result) -> None:
    with Player(arm) as player:
        moved = threading.Event()
        player.controls.time.on_update(lambda event: moved.set() if event.client_id is None else None)
        assert moved.wait(10.0)  # by the player itself, which keeps the slider where time is
        player.controls.time.value = 0.5
        assert player.playing
        moved.clear()
        assert moved.wait(10.0) and player.playing


def test_time_runs_to_the_end_without_loop(arm: Result) -> None:
    with Player(arm, autoplay=False) as player:
        ended = threading.Event()
        player.controls.time.on_update(lambda event: ended.set() if event.target.value >= 2.0 else None)
        player.set_loop(False)
        player.set_speed(40.0)
        player.toggle()
        assert ended.wait(10.0) and player.time == pytest.approx(2.0)


def test_seek_moves_robot_slider_and_pauses(player: Player) -> None:
    player.toggle()
    lower = player.server.scene.get_handle_by_name("/bodies/lower/2")
    assert isinstance(lower, viser.BatchedMeshHandle)
    player.seek(0.0)
    before = np.array(lower.batched_positions)
    player.seek(0.8)
    assert not player.playing and player.controls.time.value == pytest.approx(0.8)
    angle = np.sin(1.6)
    np.testing.assert_allclose(
        lower.batched_positions[0], [0.4 * np.cos(angle), 0.0, 0.6 - 0.4 * np.sin(angle)], atol=1e-6
    )
    assert np.abs(before - lower.batched_positions).max() > 0.1


def test_iterates_are_replayed(player: Player, arm: Result) -> None:
    assert player.iterate == 3
    player.show_iterate(0)
    assert player.iterate == 0 and player.controls.iterations is not None and player.controls.iterations.value == 0
    with pytest.raises(ValueError, match="one of the 4 kept, got 4"):
        player.show_iterate(4)


@pytest.mark.parametrize(("mode", "number"), [("along", 6), ("previous", 1), ("first", 1), ("off", 0)])
def test_ghosts(player: Player, mode: str, number: int) -> None:
    player.set_ghosts("along", 3)
    player.set_ghosts(mode, 6)
    player.seek(1.0)
    ghosts = player.server.scene.get_handle_by_name("/ghosts/lower/2")
    shown = len(ghosts.batched_positions) if isinstance(ghosts, viser.BatchedMeshHandle) else 0
    assert shown == number


def test_unknown_ghosts_are_named(player: Player) -> None:
    with pytest.raises(ValueError, match="unknown ghost mode 'halo'; there are: off, along, previous, first"):
        player.set_ghosts("halo")


def test_diverged_iterates_and_costs_are_shown(arm: Result) -> None:
    X = arm.trajectory.X.copy()
    X[40:] = np.nan
    lost = Trajectory(X, arm.trajectory.U, dt=0.02, diverged_at=40)
    gone = Trajectory(np.full_like(X, np.nan), arm.trajectory.U, dt=0.02, diverged_at=0)
    log = tuple(
        IterationLog(i, cost, np.nan, 1.0, -1.0, 0.0, "failed", 1, 0.0) for i, cost in enumerate((np.inf, np.nan, 4.0))
    )
    bad = dataclasses.replace(arm, log=log, iterates=(lost, gone, arm.trajectory), cost=np.inf)
    with Player(bad, autoplay=False) as player:
        for index in (0, 1, 2):
            player.show_iterate(index)
            player.set_ghosts("previous")
            player.seek(1.5)


def test_results_with_little_in_them(arm: Result, function: Result) -> None:
    bare = dataclasses.replace(arm, log=(), iterates=(), names={})
    short = dataclasses.replace(function, trajectory=Trajectory(np.zeros((2, 1)), np.zeros((1, 1)), dt=1e-3))
    for result in (bare, function, short):
        with Player(result, autoplay=False) as player:
            player.seek(0.5)
            player.toggle()


def test_what_is_not_a_result_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shows a Result .* got dict"):
        Player(cast(Any, {}))


def test_addresses_that_cannot_be_listened_at_are_refused(arm: Result) -> None:
    with pytest.raises(ValueError, match="port must be at most 65535, got 99999"):
        Player(arm, port=99999)
    for host in ("192.0.2.1", "no.such.host.invalid"):
        with pytest.raises(ValueError, match=f"cannot listen at '{host}'"), Player(arm, host):
            pass


def test_view_prints_the_address_in_use(arm: Result, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        busy = taken.getsockname()[1]
        player = view(arm, port=busy, block=False)
        try:
            printed = capsys.readouterr().out
            assert player.url in printed and f":{busy}" not in printed
        finally:
            player.stop()


def test_ctrl_c_ends_view_without_a_traceback(function: Result, tmp_path: Path) -> None:
    function.save(tmp_path / "result.npz")
    code = "import sys; from mjslq.result import load; from mjslq.viewer import view; view(load(sys.argv[1]))"
    process = subprocess.Popen(
        [sys.executable, "-c", f"{code}; print('over')", str(tmp_path / "result.npz")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # background jobs of a shell ignore it
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline().startswith("viewer at http://127.0.0.1:")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0 and out.strip() == "over" and err == ""


def test_importing_the_room_does_not_import_viser() -> None:
    code = "import sys, mjslq.viewer; assert 'viser' not in sys.modules and 'mujoco' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": str(REPOSITORY)})


def test_constraints_that_hold_nothing_are_shown(arm: Result) -> None:
    """All multipliers and violations are zero: there are no bars to draw."""
    nothing = {"violations": {"wall": np.zeros(101)}, "multipliers": {"wall": np.zeros((101, 1))}}
    with Player(dataclasses.replace(arm, knots={"wall": np.arange(101)}, **nothing), autoplay=False) as player:
        assert player.running
