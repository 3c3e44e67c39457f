"""`Live`: a plant under receding-horizon control, in the browser while it runs.

The plant goes ahead in real time, or as fast as the planner lets it. The robot is the plant; ghosts are poses of the
plan in force, lines the paths that it plans for the outermost bodies. Planner and plant start and stop apart: a plant
without a planner goes on under the feedback of the last plan. A push acts on a body for a tenth of a second. Where the
problem can be posed anew, a target is dragged and weights are slid.
"""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import viser
from numpy.typing import ArrayLike

from mjslq.mpc import MPC
from mjslq.problem import Problem
from mjslq.result import Result
from mjslq.simulation import Plant, Push, plant_of
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array, choose, positive
from mjslq.viewer.look import Look
from mjslq.viewer.scene import SceneView, quiet
from mjslq.viewer.serving import Served

GHOSTS = 4
"""Poses of the plan that are shown."""
_FRAMES = 30.0  # sent to the browser a second
_ASPECT, _FARTHER = 1.2, 2.0
Pose = Callable[[Array, Mapping[str, float]], Problem]
"""Makes the problem anew for a target (3,) [m] and weights by name."""


class Live(Served):
    """A server that runs and shows a closed loop; a context manager, or `start` and `stop`.

    Parameters
    ----------
    mpc : MPC
        The controller.
    plant : mujoco.MjModel or Dynamics
        As in `mjslq.simulation.run`; the problem's own engine unless given.
    pose : callable
        pose(target, weights) -> Problem, of the same engine and horizon: called when the target is dragged or a weight
        is slid. Without it neither is shown.
    target : array
        Where the target is at first. Shape (3,). [m]
    weights : mapping
        First values of the weights, by name; each is slid between a hundredth and a hundred times of it.
    push : float
        Largest force of a push. [N]
    dark : bool
        Whether the page is dark at first.
    """

    kind = "live view"

    def __init__(
        self,
        mpc: MPC,
        plant: Any = None,
        *,
        pose: Pose | None = None,
        target: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
        push: float = 20.0,
        dark: bool = False,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        super().__init__(host, port)
        if not isinstance(mpc, MPC):
            raise ValueError(f"mpc must be a mjslq.MPC, got {type(mpc).__name__}")
        problem, scene = mpc.problem, mpc.problem.scene()
        if scene is None:
            raise ValueError("this problem has no model to draw")
        if pose is None and (target is not None or weights):
            raise ValueError("target and weights need pose, which makes the problem anew for them")
        self._mpc, self._scene, self._pose, self._contact = mpc, scene, pose, problem.dynamics.contact
        self._plant: Plant = plant_of(problem.dynamics if plant is None else plant, problem.dynamics)
        self._substeps = max(1, round(mpc.period / self._plant.timestep))
        self._target = None if target is None else as_array("target", target, (3,))
        self._weights = {name: positive(name, value) for name, value in (weights or {}).items()}
        self._force, self._dark = positive("push", push), bool(dark)
        self._thread: threading.Thread | None = None
        self.planning, self.running = True, True
        self.restart()

    @property
    def time(self) -> float:
        """Time of the plant. [s]"""
        return self._steps * self._mpc.period

    @property
    def state(self) -> Array:
        """State of the plant. Shape (nx,)."""
        with self._lock:
            return np.array(self._plant.x)

    def restart(self) -> None:
        """Put the plant where the problem begins, and forget the plan."""
        with self._lock:
            self._plant.x = np.array(self._mpc.problem.x0)
            self._mpc.reset()
            self._steps, self._pushes = 0, list[Push]()
            self._shown_plan: Result | None = None
            self._held = np.zeros(self._mpc.problem.dynamics.nu)
            self.message = ""

    def push(self, body: str, force: ArrayLike, duration: float = 0.1) -> None:
        """Push a body of a MuJoCo plant from now on, by `force` (3,) [N]."""
        if not self._plant.bodies:
            raise ValueError("only MuJoCo plants can be pushed")
        choose("body", body, self._plant.bodies)
        with self._lock:
            self._pushes.append(Push(body, as_array("force", force, (3,)), self.time, positive("duration", duration)))

    def aim(self, target: ArrayLike | None = None, **weights: float) -> None:
        """Pose the problem anew, for another target or other weights; plans go on from the plan in force."""
        if self._pose is None:
            raise ValueError("this view was made without pose, which makes the problem anew")
        with self._lock:
            if target is not None:
                self._target = as_array("target", target, (3,))
            for name, value in weights.items():
                self._weights[choose("weight", name, self._weights)] = positive(name, value)
            problem = self._pose(np.zeros(3) if self._target is None else self._target, dict(self._weights))
            self._mpc.pose(problem)

    def advance(self) -> None:
        """One control period: plan, unless the planner is stopped, and let the plant go on."""
        with self._lock:
            t, x = self.time, np.array(self._plant.x)
            try:
                u = self._mpc.step(x, t, replan=self.planning)
            except ValueError as error:
                self.running, self.message = False, str(error)
                return
            self._held = np.array(u, dtype=float)
            self._pushes = [push for push in self._pushes if push.at + push.duration > t - self._mpc.period]
            for i in range(self._substeps):
                if not self._plant.advance(u, t + i * self._plant.timestep, self._pushes):
                    self.running, self.message = False, "The plant blew up; restart it."
                    return
            self._steps += 1

    def start(self) -> None:
        """Open the server and run; does nothing when running."""
        if self._server is not None:
            return
        server = self._open()
        with self._lock:
            self.advance()
            self._view = SceneView(
                server,
                self._scene,
                self._mpc.plan.trajectory,
                _ASPECT,
                dark=self._dark,
                contact=self._contact,
                passed=False,
            )
            seen = server.initial_camera  # on the first plan; what comes takes more room
            centre = np.asarray(seen.look_at)
            seen.position = centre + _FARTHER * (np.asarray(seen.position) - centre)
            self._add_widgets(server.gui)
            self.show()
        self._thread = threading.Thread(target=self._run, name="mjslq live", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop and close the server; does nothing when not running."""
        self._ended.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join()  # it may be sending a frame
        server, self._server = self._server, None
        if server is not None:
            with quiet():
                server.stop()

    def show(self) -> None:
        """Send the plant's pose, and the plan where it is a new one."""
        with self._lock, self.server.atomic():
            plan = self._mpc.plan
            if plan is not self._shown_plan:
                self._shown_plan = plan
                planned = self._view.motion(plan.trajectory)
                self._view.follow(planned)
                self._view.set_ghosts(*planned.spread(GHOSTS))
            x = np.array(self._plant.x)[None]
            now = self._view.motion(Trajectory(np.vstack([x, x]), self._held[None], dt=self._mpc.period)).first()
            self._view.stand(now.frame(0.0))
            statistics = self._mpc.statistics
            told = f"t = {self.time:.2f} s\n\n{statistics}" if statistics.plans else f"t = {self.time:.2f} s"
            self._told.content = f"{told}\n\n{self.message}"
            box: Any = self._plant_runs
            if box.value != self.running:  # it blew up
                box.value = self.running

    def _add_widgets(self, gui: viser.GuiApi) -> None:
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=self._dark)
        gui.set_panel_label("mjslq live")
        self._planner = gui.add_checkbox("planner", self.planning)
        self._plant_runs = gui.add_checkbox("plant", self.running)
        self._planner.on_update(lambda event: self._switch(event, "planning"))
        self._plant_runs.on_update(lambda event: self._switch(event, "running"))
        gui.add_button("restart").on_click(lambda _: self.restart())
        if self._plant.bodies:
            with gui.add_folder("push"):
                body = gui.add_dropdown("body", self._plant.bodies)
                ahead, left, up = (
                    gui.add_slider(f"{axis} [N]", -self._force, self._force, self._force / 50.0, start)
                    for axis, start in (("x", self._force), ("y", 0.0), ("z", 0.0))
                )
                button = gui.add_button("push")
                button.on_click(lambda _: self.push(body.value, [ahead.value, left.value, up.value]))
        if self._pose is not None:
            for name, value in self._weights.items():
                slider = gui.add_slider(f"{name}, 10^", -2.0, 2.0, 0.05, 0.0)
                slider.on_update(partial(self._slid, name=name, value=value))
            if self._target is not None:
                gizmo = self.server.scene.add_transform_controls(
                    "/targets/aim", scale=0.15, disable_rotations=True, position=self._target
                )
                gizmo.on_update(lambda _: self.aim(gizmo.position))
        Look(gui, self._view)
        self._told = gui.add_markdown("")

    def _switch(self, event: Any, name: str) -> None:
        if event.client_id is not None:  # not set by `show`
            with self._lock:
                setattr(self, name, bool(event.target.value))

    def _slid(self, event: Any, *, name: str, value: float) -> None:
        if event.client_id is not None:
            self.aim(**{name: value * 10.0**event.target.value})

    def _run(self) -> None:
        """Go on in real time, and send frames at their own pace."""
        due = shown = clock.monotonic()
        while not self._ended.is_set():
            if self.running:
                self.advance()
            due = max(due + self._mpc.period, clock.monotonic() - self._mpc.period)  # what is late is not made up for
            if clock.monotonic() - shown >= 1.0 / _FRAMES:
                shown = clock.monotonic()
                self.show()
            self._ended.wait(max(due - clock.monotonic(), 0.0))
