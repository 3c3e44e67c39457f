"""Keys, buttons and menus of a player and of a watched solve, in a real browser."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import mjslq
from mjslq.result import Result
from mjslq.viewer.player import Player
from mjslq.viewer.watching import Watch

WINDOW = {"width": 900, "height": 500}


def becomes(wanted: Callable[[], bool]) -> bool:
    """Whether something comes true in time."""
    until = time.monotonic() + 30.0
    while time.monotonic() < until:
        if wanted():
            return True
        time.sleep(0.01)
    return False


@pytest.fixture(scope="module")
def player(arm: Result) -> Iterator[Player]:
    with Player(arm, autoplay=False) as running:
        yield running


@pytest.fixture(scope="module")
def page(player: Player, browser: Any) -> Iterator[Any]:
    """One page for all tests of the player."""
    opened = browser.new_page(viewport=WINDOW)
    errors: list[str] = []
    opened.on("pageerror", lambda error: errors.append(str(error)))
    opened.goto(player.url)
    opened.get_by_text("Press ? or h").wait_for()
    yield opened
    opened.close()
    assert not errors


def press(page: Any, *keys: str) -> None:
    page.evaluate("document.activeElement.blur()")  # no widget has the focus
    for one in keys:
        page.keyboard.press(one)


def test_space_plays_and_pauses(player: Player, page: Any) -> None:
    player.seek(0.0)
    press(page, "Space")
    assert becomes(lambda: player.playing and player.time > 0.1)
    page.get_by_role("button", name="Pause").wait_for()
    press(page, "Space")
    assert becomes(lambda: not player.playing)


def test_arrows_step_from_knot_to_knot_and_leave_the_camera_alone(player: Player, page: Any) -> None:
    (client,) = player.server.get_clients().values()
    camera = client.camera.position.copy()
    player.seek(0.711)  # between knots 35 and 36
    press(page, "ArrowRight")
    assert becomes(lambda: player.time == player.times[36])
    press(page, "ArrowLeft")
    assert becomes(lambda: player.time == player.times[35])
    press(page, "End")
    assert becomes(lambda: player.knot == 100)
    press(page, "Home")
    assert becomes(lambda: player.knot == 0)
    page.get_by_text("knot 0 of 100").wait_for()
    assert (client.camera.position == camera).all()


def test_up_and_down_go_through_the_iterates(player: Player, page: Any) -> None:
    player.show_iterate(1)
    press(page, "ArrowUp")
    assert becomes(lambda: player.iterate == 2)
    page.get_by_text("cost 9, then a step of 0.5").wait_for()
    press(page, "ArrowDown", "ArrowDown", "ArrowDown")
    assert becomes(lambda: player.iterate == 0)
    page.get_by_role("button", name="last").nth(1).click()
    assert becomes(lambda: player.iterate == 3)


def test_scrubbing_stops_at_the_knots(player: Player, page: Any) -> None:
    slider = page.get_by_role("slider").first
    slider.scroll_into_view_if_needed()
    track = page.locator(".mantine-Slider-track").first.bounding_box()
    height = track["y"] + 0.5 * track["height"]
    player.seek(0.0)
    page.mouse.move(track["x"] + 4, height)
    page.mouse.down()
    for share in (0.2, 0.31, 0.437):
        page.mouse.move(track["x"] + share * track["width"], height)
    page.mouse.up()
    assert becomes(lambda: 0.7 < player.time < 1.0)
    assert player.time in player.times and not player.playing
    slider.focus()
    at = player.knot
    slider.press("ArrowRight")  # the slider's own key, which steps once and not twice
    assert becomes(lambda: player.knot != at) and player.knot == at + 1


def test_keys_are_heard_after_a_box_was_clicked(player: Player, page: Any) -> None:
    page.get_by_label("Loop").click()
    assert becomes(lambda: not player.loop)
    page.keyboard.press("l")
    assert becomes(lambda: player.loop)


def test_speed_loop_and_ghosts_have_keys(player: Player, page: Any) -> None:
    press(page, "]", "l", "g")
    assert becomes(lambda: player.speed == 2.0 and not player.loop and player.ghosts[0] == "along")
    press(page, "[", "l")
    assert becomes(lambda: player.speed == 1.0 and player.loop)
    player.set_ghosts("off")


@pytest.mark.parametrize("key", ["h", "Shift+?"])
def test_the_keys_are_listed(page: Any, key: str) -> None:
    press(page, key)
    page.get_by_text("One iterate back").wait_for()
    page.get_by_role("button", name="Close").click()
    page.get_by_text("One iterate back").wait_for(state="detached")


def test_signals_are_chosen_from_a_list(player: Player, page: Any) -> None:
    card = player.plots.cards[0]
    page.get_by_label("Signals").first.click()
    page.get_by_role("option", name="+ elbow \u00b7 torques [Nm]").click()
    assert becomes(lambda: card.names[-1] == "elbow \u00b7 torques [Nm]" and len(card.names) == 3)
    assert becomes(lambda: page.get_by_label("Signals").first.input_value() == "3 of 6: add or take away")
    page.get_by_label("Signals").first.click()
    page.get_by_role("option", name="+ elbow rate").click()  # a third unit
    page.get_by_text("a plot has two axes").wait_for()
    assert len(card.names) == 3
    page.get_by_label("Signals").first.click()
    page.get_by_role("option", name="\u2713 shoulder \u00b7 positions [rad]").click()
    assert becomes(lambda: card.names == ["elbow \u00b7 positions [rad]", "elbow \u00b7 torques [Nm]"])


def test_numbers_stand_at_the_time_axis_while_it_plays(player: Player, page: Any) -> None:
    player.toggle()
    splits = "Object.values(window.__viserTestpoints.uplots).map((plot) => plot.chart.axes[0]._splits)"
    assert becomes(lambda: all(page.evaluate(splits)))
    player.seek(0.0)


def test_stop_button_ends_a_solve_and_its_window_plays_the_result(browser: Any) -> None:
    chain = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0] - x[0]]), 2, 1, 0.05)
    goal = [
        mjslq.costs.State(1e3, [1.0, 0.0], "terminal"),
        mjslq.costs.Control(1e-3),
    ]  # steepest descent takes for ever
    problem = mjslq.Problem(chain, 60, np.zeros(2), goal)
    slow = {"tol": 0.0, "max_iterations": 10**6, "watcher": lambda *_: time.sleep(0.05)}
    with Watch(problem, "gradient", **slow) as watch:
        solve = threading.Thread(target=watch.run)
        solve.start()
        page = browser.new_page(viewport=WINDOW)
        page.goto(watch.url)
        page.get_by_text("solving").wait_for()
        page.locator(".uplot").first.wait_for()  # the costs
        page.get_by_role("button", name="Stop").click()
        solve.join(30.0)
        page.get_by_role("button", name="Pause").wait_for()
        page.get_by_text("Stop button").wait_for()
        page.close()
        assert watch.result.status is mjslq.Status.STOPPED
        assert watch.result.cost == problem.cost(watch.result.trajectory)
