"""Several results in one player: colours, layouts, different lengths and models; and single steps of a player."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import viser

import mjslq
from mjslq.result import Result
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.viewer import comparison
from mjslq.viewer.player import Player

STILL = """
<mujoco><worldbody><geom type="plane" size="0 0 1"/>
  <body pos="0 0 1"><joint name="shoulder" axis="0 1 0"/><geom size=".2"/>
    <body><joint name="elbow" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body></body></worldbody></mujoco>
"""


@pytest.fixture(scope="module")
def short(arm: Result) -> Result:
    """The arm's motion by another method, half as long, with fewer iterates."""
    t = arm.trajectory
    half = Trajectory(0.5 * t.X[:51], t.U[:50], dt=0.02)
    return dataclasses.replace(
        arm, method="newton", trajectory=half, iterates=(half, half), log=arm.log[2:], lower=arm.lower[:50],
        upper=arm.upper[:50], cost=9.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def foreign(arm: Result, compiled: Callable[[str], bytes]) -> Result:
    """A result of another model."""
    return dataclasses.replace(arm, problem="balls", scene=Scene(compiled(STILL), (0, 1)))


@pytest.fixture
def player(arm: Result, short: Result, function: Result) -> Iterator[Player]:
    with Player([arm, short, function], autoplay=False) as running:
        yield running


def place(player: Player, result: int) -> np.ndarray:
    """Where the last piece of a result is in the scene, its own offset aside."""
    handles = [player.server.scene.get_handle_by_name(f"/results/{result}/moving/{piece}") for piece in (0, 1, 2)]
    mesh = [handle for handle in handles if handle is not None][-1]
    assert isinstance(mesh, viser.BatchedMeshHandle)
    return np.array(mesh.batched_positions[0])


def test_results_share_a_clock_and_the_shorter_one_waits_at_its_end(player: Player) -> None:
    assert player.duration == pytest.approx(2.0)
    player.seek(1.0)
    end = place(player, 1)
    player.seek(2.0)
    np.testing.assert_array_equal(place(player, 1), end)
    player.seek(0.5)
    assert np.abs(place(player, 1) - end).max() > 0.01 and np.abs(place(player, 1) - place(player, 0)).max() > 0.01


def test_each_result_has_a_colour_and_can_be_hidden(player: Player) -> None:
    assert player.labels == ["two links slq", "two links newton", "a <b> & c gradient"]
    player.set_visible(1, False)
    root = player.server.scene.get_handle_by_name("/results/1")
    assert root is not None and not root.visible and not player.controls.visible[1].value
    assert player.results_visible == [True, False, True]
    assert {line.shown.label for card in player.plots.cards for line in card._drawn.lines} == {  # type: ignore[union-attr]
        "two links slq", "a <b> & c gradient"
    }  # fmt: skip
    player.set_visible(1, True)
    with pytest.raises(ValueError, match="there are 3 results, got place 3"):
        player.set_visible(3, False)
    colors = {line.color for card in player.plots.cards for line in card._drawn.lines}  # type: ignore[union-attr]
    assert len(colors) == 3


def test_side_by_side_they_stand_in_lanes(player: Player) -> None:
    player.set_layout("side by side")
    first, second = (player.server.scene.get_handle_by_name(f"/results/{i}") for i in (0, 1))
    assert first is not None and second is not None
    apart = np.array(second.position) - np.array(first.position)
    assert apart[1] > 0.1 and apart[0] == apart[2] == 0.0  # across the motion, which is in the plane of x and z
    player.set_layout("overlaid")
    assert not np.any(second.position)
    with pytest.raises(ValueError, match="unknown layout 'stacked'; there are: overlaid, side by side"):
        player.set_layout("stacked")


def test_iterates_are_shown_as_far_as_there_are_any(player: Player, short: Result) -> None:
    player.show_iterate(3)
    assert [view.iterate for view in player._views] == [3, 1, None]
    player.step_iterate(-3)
    assert [view.iterate for view in player._views] == [0, 0, None]
    assert player.controls.note is not None and "newton: iteration 2, cost 9" in player.controls.note.content
    player.set_ghosts("along", 5)
    player.set_ghosts("previous")
    player.set_trace(False)


def test_different_models_only_stand_side_by_side(arm: Result, foreign: Result) -> None:
    with Player([arm, foreign], autoplay=False) as player:
        assert player.layout == "side by side" and player.labels == ["two links", "balls"]
        with pytest.raises(ValueError, match="of different models cannot be overlaid; they stand side by side"):
            player.set_layout("overlaid")


def test_labels_tell_results_apart(arm: Result) -> None:
    heights = [dataclasses.replace(arm, parameters={"height": h, "mass": 1.0}) for h in (10.0, 20.0)]
    assert comparison.labels(heights) == ["slq, height 10.0", "slq, height 20.0"]
    assert comparison.labels([arm, arm]) == ["slq (1)", "slq (2)"]


def test_what_cannot_be_compared_is_refused(arm: Result) -> None:
    with pytest.raises(ValueError, match="nothing to show"):
        Player([])
    with pytest.raises(ValueError, match="at most 8 results can be told apart in one window, got 9"):
        Player([arm] * 9)
    with pytest.raises(ValueError, match=r"shows a Result .* got str"):
        Player([arm, cast(Any, "arm.npz")])


def test_results_without_scenes_are_compared_by_their_plots(function: Result) -> None:
    with Player([function, function], autoplay=False) as player:
        assert not player.drawn and len(player.plots.cards[0]._drawn.lines) == 8  # type: ignore[union-attr]


def test_a_backdrop_has_nothing_that_moves(arm: Result) -> None:
    from mjslq.reports.units import model_from_mjb
    from mjslq.viewer import geometry
    from mjslq.viewer.tinted import backdrop

    assert arm.scene is not None
    model = model_from_mjb(backdrop(arm.scene).model)
    assert {piece.body for piece in geometry.pieces(model)} == {0} and len(geometry.planes(model)) == 1


def test_single_steps(arm: Result) -> None:
    player, times = Player(arm, autoplay=False), arm.trajectory.times
    player.step(1)
    assert player.time == times[1]
    player.step(-5)
    assert player.time == 0.0
    for start, knots, end in (
        (0.031, 1, 2),
        (0.031, -1, 1),
        (0.029, 1, 2),
        (0.029, -1, 1),
        (0.031, -2, 0),
        (2.0, 1, 100),
    ):
        player.seek(start)
        player.step(knots)
        assert player.knot == end and player.time == times[end] and not player.playing
    player.seek_knot(1000)
    assert player.knot == 100
    player.step_iterate(-1)
    assert player.iterate == 2


def test_plots_are_added_chosen_and_removed(arm: Result) -> None:
    with Player(arm, autoplay=False) as player:
        panel = player.plots
        card = panel.plot("shoulder \u00b7 torques [Nm]", "shoulder \u00b7 positions [rad]")
        assert len(panel.cards) == 3 and card.names[0] == "shoulder \u00b7 torques [Nm]"
        with pytest.raises(ValueError, match=r"unknown signal 'knee'; there are: shoulder"):
            card.choose(["knee"])
        with pytest.raises(ValueError, match=r"two axes, but these signals have \[Nm\], \[rad\], \[rad/s\]"):
            panel.plot(*card.names, "elbow rate \u00b7 velocities [rad/s]")
        assert len(panel.cards) == 3
        panel.add("States: velocities [rad/s]")
        with pytest.raises(ValueError, match="unknown group of signals 'States'"):
            panel.add("States")
        panel._remove(card)
        player.seek(1.0)
        assert len(panel.cards) == 3


def test_files_are_compared_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mjslq import cli, viewer

    shown: list[Any] = []
    monkeypatch.setattr(viewer, "view", lambda results, host, port, **_: shown.append(results))
    files = [tmp_path / name for name in ("a.npz", "b.npz")]
    for file in files:
        mjslq.solve(mjslq.problems.get("van_der_pol", horizon=5), max_iterations=1).save(file)
    cli.view([str(file) for file in files])
    assert len(shown[0]) == 2
    with pytest.raises(ValueError, match=r"a model is viewed alone, and robot\.xml is one"):
        cli.view([str(files[0]), "robot.xml"])
