"""Take the README's pictures: the viewer in headless Chromium, light and dark.

Run with    python demos/pictures.py [folder] [name ...]     (needs Chromium, and Playwright from the "test" extra)
"""

import inspect
import io
import shutil
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

import mjslq
from mjslq.viewer import Player

FLAGS = "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking --disable-sync"
WINDOW, WIDTH = {"width": 1440, "height": 900}, 1200
"""Of the browser, and of what is kept of it. [px]"""
PAUSE, MOST = 3000, 40  # software rendering draws a few frames a second, or a few a minute [ms, looks]


CLOSE = "document.querySelectorAll('.mantine-Notification-closeButton').forEach((button) => button.click())"
"""Viser's notice that there is no graphics card."""


def hopper(player):
    player.set_ghosts("along", 6)
    player.seek(0.9)


def arm(player):
    player.set_ghosts("along", 5)
    player.seek(2.0)


def quadruped(player):
    player.set_ghosts("along", 7)
    player.seek(0.42)


def comparison(player):
    player.seek(1.2)


def problems():
    """The results of each picture, the one shown first."""
    yield hopper, [mjslq.solve(mjslq.problems.get("hopper", height=30.0))]
    yield arm, [mjslq.solve(mjslq.problems.get("panda_obstacle"))]
    yield quadruped, [mjslq.solve(mjslq.problems.get("solo12_flip"))]
    problem = mjslq.problems.get("cart_pole")
    found = [mjslq.solve(problem, method, max_iterations=100) for method in ("auto", "newton", "gradient")]
    yield comparison, sorted(found, key=lambda result: result.cost)


def take(browser, prepare, results, dark):
    """A screenshot of the viewer, as PNG bytes."""
    best, *others = results
    options = {"dark": dark} if "dark" in inspect.signature(Player.__init__).parameters else {}
    with Player(best, autoplay=False, beside=others, **options) as player:
        page = browser.new_page(viewport=WINDOW, color_scheme="dark" if dark else "light")
        page.set_default_timeout(180_000)
        page.goto(player.url)
        page.wait_for_selector("canvas")
        prepare(player)
        picture, before = b"", b"-"
        for _ in range(MOST):  # until nothing moves any more
            if picture == before:
                break
            page.wait_for_timeout(PAUSE)
            page.evaluate(CLOSE)
            picture, before = page.screenshot(), picture
        page.close()
    return picture


def reduced(picture):
    """The picture with 256 colours, those of thin curves among them: they are told apart by saturation."""
    colours = np.asarray(picture).reshape(-1, 3)
    vivid = colours[np.ptp(colours, axis=1) > 60]
    palettes = [
        Image.fromarray(part[None]).quantize(count, Image.Quantize.MEDIANCUT).getpalette()[: 3 * count]
        for part, count in ((colours, 192), (vivid, 64))
    ]
    palette = Image.new("P", (1, 1))
    palette.putpalette([*palettes[0], *palettes[1]])
    return picture.quantize(palette=palette, dither=Image.Dither.NONE)


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "pictures"
    wanted = sys.argv[2:]
    folder.mkdir(exist_ok=True)
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS.split())
        for prepare, results in problems():
            if wanted and prepare.__name__ not in wanted:
                continue
            for dark in (False, True):
                file = folder / f"{prepare.__name__}-{'dark' if dark else 'light'}.png"
                picture = Image.open(io.BytesIO(take(browser, prepare, results, dark))).convert("RGB")
                picture = picture.resize((WIDTH, WIDTH * picture.height // picture.width), Image.Resampling.LANCZOS)
                reduced(picture).save(file, optimize=True)
                print(f"{file}: {file.stat().st_size // 1000} kB")
        browser.close()


if __name__ == "__main__":
    main()
