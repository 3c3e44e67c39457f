"""Small results to show, and a browser to show them in."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mjslq.log import IterationLog
from mjslq.result import Result
from mjslq.scene import Scene
from mjslq.status import Status
from mjslq.trajectory import Trajectory

CHROMIUM_ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--enable-unsafe-swiftshader",
]  # fmt: skip

SHOULDER_LIMIT = 1.5
"""Of the shoulder's torque, which the motion reaches towards its end."""

ARM = """
<mujoco model="arm">
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <geom type="cylinder" size=".1 .05" pos="0 0 .05"/>
    <body name="upper" pos="0 0 .6">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" size=".05" fromto="0 0 0 .4 0 0" rgba=".9 .3 .1 1"/>
      <body name="lower" pos=".4 0 0">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" size=".04" fromto="0 0 0 .3 0 0"/>
        <geom type="box" size=".05 .05 .05" pos=".3 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], bytes]:
    """Return a function from MJCF to MJB bytes."""

    def compile_model(xml: str) -> bytes:
        path = tmp_path_factory.mktemp("model") / "model.mjb"
        mujoco.mj_saveModel(mujoco.MjModel.from_xml_string(xml), str(path))
        return path.read_bytes()

    return compile_model


def swing(steps: int, dt: float, amplitude: float) -> Trajectory:
    t = dt * np.arange(steps + 1)
    q = amplitude * np.stack([np.sin(2.0 * t), 1.0 - np.cos(3.0 * t)], axis=1)
    U = np.stack([t[:-1], -t[:-1]], axis=1)
    U[:, 0] = np.clip(U[:, 0], -SHOULDER_LIMIT, SHOULDER_LIMIT)
    return Trajectory(np.hstack([q, np.gradient(q, dt, axis=0)]), U, dt=dt)


def limits(steps: int) -> dict[str, np.ndarray]:
    """Limits of the shoulder's control alone."""
    upper = np.tile([SHOULDER_LIMIT, np.inf], (steps, 1))
    return {"lower": -upper, "upper": upper}


def iteration_log(costs: list[float]) -> tuple[IterationLog, ...]:
    last = len(costs) - 1
    return tuple(
        IterationLog(i, cost, cost, 1.0, -1.0, 0.5, "final" if i == last else "accepted", 2, 0.01 * i)
        for i, cost in enumerate(costs)
    )


@pytest.fixture(scope="session")
def arm(compiled: Callable[[str], bytes]) -> Result:
    """Two links on a post, four iterates, the last one shown."""
    iterates = tuple(swing(100, 0.02, amplitude) for amplitude in (0.1, 0.4, 0.7, 1.0))
    return Result(
        Status.CONVERGED, Status.CONVERGED.message, 2.0, 3, 1e-8, iterates[-1], np.zeros((100, 2, 4)), **limits(100),
        log=iteration_log([900.0, 80.0, 9.0, 2.0]), iterates=iterates, seconds=0.25, problem="two links", method="slq",
        names={"states": ("shoulder", "elbow", "shoulder rate", "elbow rate"), "controls": ("shoulder", "elbow")},
        scene=Scene(compiled(ARM), (0, 1), "arm"),
    )  # fmt: skip


@pytest.fixture(scope="session")
def function() -> Result:
    """A problem with nothing to draw."""
    return Result(
        Status.MAX_ITERATIONS, Status.MAX_ITERATIONS.message, 3.0, 2, 0.1, swing(50, 0.04, 1.0), None, **limits(50),
        log=iteration_log([5.0, -1.0, 3.0]), problem="a <b> & c", method="gradient",
    )  # fmt: skip


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, headless; tests that need it are skipped where there is none."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = [path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))]
    with sync_api.sync_playwright() as playwright:
        program = found[0] if found else playwright.chromium.executable_path
        if not Path(program).exists():
            pytest.skip("there is no Chromium on this machine")
        chromium = playwright.chromium.launch(executable_path=program, args=CHROMIUM_ARGUMENTS)
        yield chromium
        chromium.close()
