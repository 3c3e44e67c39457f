"""Measure what playing a motion costs the viewer's server: 50 bodies that swing and fly, one browser, 60 Hz.

Run with    python demos/viewer_cost.py [seconds]        (needs Chromium, and Playwright from the "test" extra)
"""

import shutil
import sys
import time

import mujoco
import numpy as np
from playwright.sync_api import sync_playwright

import mjslq
from mjslq.viewer import Player

BODIES, DURATION, DT = 50, 6.0, 0.02
FLAGS = "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking --disable-sync"


def swarm() -> mjslq.Result:
    """Half of the bodies swing about hinges, half of them fly and turn; all have shapes of their own."""
    bodies = ""
    for i in range(BODIES):
        joint = "<freejoint/>" if i % 2 else f'<joint name="hinge{i}" axis="0 1 0"/>'
        shape = f'<geom type="capsule" size=".03" fromto="0 0 0 .2 0 {0.002 * i}" rgba="{i / BODIES} .4 .3 1"/>'
        bodies += f'<body pos="{0.3 * (i % 10)} {0.3 * (i // 10)} .5">{joint}{shape}</body>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0"/><worldbody><geom type="plane" size="0 0 1"/>{bodies}</worldbody>'
        '<actuator><motor joint="hinge0"/></actuator></mujoco>'
    )
    dynamics = mjslq.MujocoDynamics.from_model(model, timestep=DT)
    x0 = np.array(dynamics.initial_state)
    x0[model.nq :] = np.random.default_rng(0).normal(size=model.nv) * 0.5
    steps = round(DURATION / DT)
    problem = mjslq.Problem(dynamics, steps, x0, [mjslq.costs.State(1.0, target=x0), mjslq.costs.Control(1.0)])
    return mjslq.solve(problem, "slq", max_iterations=0)


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 8.0
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with Player(swarm(), autoplay=False) as player, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS.split())
        page = browser.new_page()
        page.goto(player.url)
        page.wait_for_selector("canvas")
        time.sleep(4.0)
        player.toggle()
        time.sleep(1.0)
        frames, used, began = player.frames, time.process_time(), time.monotonic()
        time.sleep(seconds)
        used, passed = time.process_time() - used, time.monotonic() - began
        frames = player.frames - frames
        browser.close()
    print(f"{BODIES} bodies, {frames / passed:.1f} frames a second: {100.0 * used / passed:.1f} % of a core")
    print(f"{1e3 * used / frames:.2f} ms a frame, or {100.0 * used / frames * 60.0:.1f} % of a core at 60 a second")


if __name__ == "__main__":
    main()
