"""Take the README's picture: the viewer in headless Chromium, the hopper on its way up.

Run with    python demos/picture.py [file.png]        (needs Chromium, and Playwright from the "test" extra)
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

import mjslq
from mjslq.viewer import Player

FLAGS = "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking --disable-sync"


def main() -> None:
    target = sys.argv[1] if len(sys.argv) > 1 else str(Path(__file__).parent / "viewer.png")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    result = mjslq.solve(mjslq.problems.get("hopper", height=30.0))
    with Player(result, autoplay=False) as player, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS.split())
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(player.url)
        page.wait_for_selector("canvas")
        notice = page.get_by_text("Software WebGL rendering detected")
        notice.wait_for(timeout=20_000)  # Viser says so where there is no graphics card
        page.locator(".mantine-Notification-closeButton").first.click()
        player.set_ghosts("along", 6)
        player.seek(0.9)
        page.wait_for_timeout(6000)  # software rendering draws a few frames a second
        page.screenshot(path=target)
        browser.close()
    print(target)


if __name__ == "__main__":
    main()
