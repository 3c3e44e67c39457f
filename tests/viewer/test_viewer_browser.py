"""The viewer and the exported page in a real browser: what is clicked, and what is drawn."""

from __future__ import annotations

import dataclasses
import io
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser
from PIL import Image

from mjslq.result import Result
from mjslq.scene import Scene
from mjslq.viewer import export_html
from mjslq.viewer.player import Player

WINDOW = {"width": 1280, "height": 800}
FRAMES_DRAWN = (
    "new Promise((done) => { let n = 0; const next = () => ++n < 6 ? requestAnimationFrame(next) : done(); next(); })"
)


def pixels(page: Any, area: dict[str, float]) -> np.ndarray:
    """Return what is on the page in `area`. Shape (height, width, 3)."""
    picture = Image.open(io.BytesIO(page.screenshot(clip=area))).convert("RGB")
    return np.asarray(picture).astype(int)


def orange(picture: np.ndarray) -> int:
    """Return how many pixels show the upper link, the only thing of its colour."""
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    return int(((red > 150) & (red > green + 50) & (green >= blue) & (blue < 130)).sum())


def changed(before: np.ndarray, after: np.ndarray) -> int:
    """Return how many pixels differ beyond doubt."""
    return int((np.abs(after - before).max(axis=2) > 40).sum())


def rendered(client: Any, wanted: Callable[[np.ndarray], bool]) -> np.ndarray:
    """Return the first picture of the client that is as `wanted`; meshes and poses take it a few frames."""
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        picture = client.get_render(height=300, width=300, timeout=60.0).astype(int)
        if wanted(picture):
            return np.asarray(picture)
    raise AssertionError("the client never drew what was expected")


def test_slider_in_the_page_moves_the_robot(arm: Result, browser: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    sought, connected = threading.Event(), threading.Event()
    seek = Player.seek

    def watched(self: Player, to: float) -> None:
        seek(self, to)
        if to > 1.9:
            sought.set()

    monkeypatch.setattr(Player, "seek", watched)
    with Player(arm, autoplay=False) as player:
        clients: list[Any] = []
        player.server.on_client_connect(lambda client: (clients.append(client), connected.set()))
        page = browser.new_page(viewport=WINDOW)
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(player.url)
        page.get_by_text("two links").wait_for()
        assert connected.wait(30.0)
        before = rendered(clients[0], lambda picture: orange(picture) > 100)
        slider = page.get_by_role("slider").first
        slider.focus()
        slider.press("End")
        assert sought.wait(30.0)
        assert player.time == pytest.approx(2.0) and not player.playing
        rendered(clients[0], lambda after: orange(after) > 100 and changed(before, after) > 1000)
        page.get_by_role("button", name="Play").click()
        page.get_by_role("button", name="Pause").wait_for()
        assert player.playing
        page.locator(".uplot").nth(2).wait_for()  # costs, states, controls
        page.close()
    assert not errors


def open_offline(browser: Any, path: Path, strays: list[str]) -> Any:
    """Open the file without a network; whatever it asks for beyond itself, and every error, goes to `strays`."""
    page = browser.new_context(viewport=WINDOW, offline=True).new_page()
    inside = ("file:", "data:", "blob:", "about:")
    page.on("request", lambda request: None if request.url.startswith(inside) else strays.append(request.url))
    page.on("pageerror", lambda error: strays.append(str(error)))
    page.goto(path.as_uri())
    return page


def test_exported_motion_plays_from_disk(arm: Result, browser: Any, tmp_path: Path) -> None:
    export_html(arm, tmp_path / "arm.html")
    strays: list[str] = []
    page = open_offline(browser, tmp_path / "arm.html", strays)
    page.wait_for_function("Number(document.body.dataset.time) > 0", timeout=60_000)  # the mark follows the motion
    frame = page.frame_locator("#scene")
    for close in frame.locator(".mantine-Notification-closeButton").all():
        close.click()
    area = frame.locator("canvas").first.bounding_box()
    area["height"] -= 5.0

    def show(share: float) -> np.ndarray:
        plot = page.locator(".plot.timed svg").first.bounding_box()
        place = 32.0 + share * (plot["width"] - 42.0)
        page.mouse.click(plot["x"] + place, plot["y"] + 0.5 * plot["height"])
        mark = "Number(document.querySelector('.plot.timed svg .mark').getAttribute('x1'))"
        page.wait_for_function(f"Math.abs({mark} - {place}) < 6", timeout=30_000)
        page.frames[1].evaluate(FRAMES_DRAWN)
        return pixels(page, area)

    early, late = show(0.05), show(0.9)
    assert orange(early) > 200 and orange(late) > 200
    assert changed(early, late) > 2000
    assert not strays
    page.context.close()


def test_scenes_have_no_environment_map(arm: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Viser loads it at each start of a recording, and on a slow machine shows nothing but a shade meanwhile."""
    maps: list[str | None] = []
    monkeypatch.setattr(
        viser.SceneApi, "configure_environment_map", lambda _, hdri, **more: maps.append(hdri), raising=True
    )
    export_html(arm, tmp_path / "arm.html")
    assert maps == [None]
    with Player(arm, autoplay=False):
        assert maps == [None, None]


def test_exported_function_problem_has_plots_and_a_clock(function: Result, browser: Any, tmp_path: Path) -> None:
    export_html(function, tmp_path / "function.html")
    strays: list[str] = []
    page = open_offline(browser, tmp_path / "function.html", strays)
    page.wait_for_function("Number(document.body.dataset.time) > 0.2", timeout=30_000)
    page.get_by_role("button", name="Pause").click()
    page.evaluate("seek(1.0)")
    mark = page.locator(".plot.timed svg .mark").first
    before = float(mark.get_attribute("x1"))
    page.evaluate("seek(2.0)")
    assert float(mark.get_attribute("x1")) > before + 50.0
    assert page.locator(".card").count() == 3 and page.locator("iframe").count() == 0
    assert page.locator("h1").inner_text().startswith("a <b> & c")
    assert page.locator(".plot path:not(.limit)").count() == 7  # four states, two controls, the costs
    assert page.locator(".plot path.limit").count() == 2  # of the shoulder, above and below
    assert page.locator(".plot rect.bar").count() == 1  # where it is at the upper one
    assert not strays
    page.context.close()


def test_file_is_one_whole_page(arm: Result, tmp_path: Path) -> None:
    path = tmp_path / "arm.html"
    export_html(arm, path)
    text = path.read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>") and text.rstrip().endswith("</html>")
    assert "@" not in text[: text.index("<style>")] and "two links" in text and "positions [rad]" in text
    assert [entry.name for entry in tmp_path.iterdir()] == ["arm.html"]


def test_diverged_result_can_be_exported(function: Result, tmp_path: Path) -> None:
    X = function.trajectory.X.copy()
    X[5:] = np.nan
    lost = dataclasses.replace(function.trajectory, X=X, diverged_at=5)
    export_html(dataclasses.replace(function, trajectory=lost, cost=np.inf), tmp_path / "lost.html")
    assert (
        "NaN" not in (tmp_path / "lost.html").read_text(encoding="utf-8").split('id="data">')[1].split("</script>")[0]
    )


def test_errors_are_one_sentence(arm: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"cannot write .*there is no folder"):
        export_html(arm, tmp_path / "nowhere" / "arm.html")
    with pytest.raises(ValueError, match="not a model that MuJoCo"):
        export_html(dataclasses.replace(arm, scene=Scene(b"junk", (0, 1))), tmp_path / "arm.html")
    assert not (tmp_path / "arm.html").exists()
