"""A solve in a browser while it runs: iterates stream in, a button stops it, and the window goes on as a player.

    solver's thread      each iteration leaves its log entry and its trajectory (`Watch.observe`), and goes on
    drawing thread       a few times a second takes what is newest: numbers, curves, motion

What the drawing thread spends on poses, and on changes of all else, is measured, and it waits so long before the next
that either takes at most `SHARE` of the time. An error in it ends the drawing, not the solve.
"""

from __future__ import annotations

import sys
import threading
import time as clock
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import viser

from mjslq.log import IterationLog
from mjslq.optimize import solve
from mjslq.problem import Problem
from mjslq.reports.units import model_from_mjb
from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.validation import choose
from mjslq.viewer import panels
from mjslq.viewer.framing import Framing, MovingBoxes
from mjslq.viewer.motion import finite_knots
from mjslq.viewer.playback import Playback
from mjslq.viewer.player import Player
from mjslq.viewer.player_page import ASPECT, CONTROLS_WIDTH
from mjslq.viewer.plots import CostPlot
from mjslq.viewer.scene import SceneView, quiet
from mjslq.viewer.serving import Served, stay

SHARE = 0.01
"""Of the time that poses, and that changes of all else, may take. Viser spends about as much on sending them."""
_FRAMES, _CHANGES = 15.0, 3.0
"""Poses, and changes of numbers, curves and motion, a second at most."""
_KNOTS = 60
"""Poses of an iterate's motion that are computed."""
_TOLERATED = 1e-6
"""Violations below are no reason to call an iterate better."""
_GROWN = 1.15
"""How much larger a motion gets before untouched cameras step back."""
Which = Literal["newest", "best"]
WHICH: tuple[Which, ...] = ("newest", "best")
"""Which of the iterates moves: the last one, or the one with the least violation and, among those, the least cost."""


class Watch(Served):
    """A Viser server that shows a solve, and then its result; a context manager, or `start` and `stop`.

    `run` solves, in the thread that calls it.
    """

    def __init__(
        self,
        problem: Problem,
        method: str = "auto",
        host: str = "127.0.0.1",
        port: int = 8080,
        *,
        dark: bool = False,
        **options: Any,
    ) -> None:
        """Prepare to solve `problem` by `method`; `options` are those of `mjslq.solve`, `dark` is the page's colour."""
        if not isinstance(problem, Problem):
            raise ValueError(f"problem must be a mjslq.Problem, got {type(problem).__name__}")
        super().__init__(host, port)
        self._problem, self._method, self._dark = problem, method, bool(dark)
        self._watcher: Callable[[IterationLog, Trajectory], object] | None = options.pop("watcher", None)
        self._options = options
        self._which: Which = "newest"
        self._log: list[IterationLog] = []
        self._newest: tuple[IterationLog, Trajectory] | None = None
        self._best: tuple[IterationLog, Trajectory] | None = None
        self._result: Result | None = None
        self._stopping, self._over = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self._window: _Window | None = None
        self.player: Player | None = None
        """The player of the result, once the solve has ended."""
        self.trouble: Exception | None = None
        """What ended the drawing before the solve; None when nothing did."""

    @property
    def result(self) -> Result:
        """The result; RuntimeError before `run` has ended."""
        if self._result is None:
            raise RuntimeError("the solve has not ended yet")
        return self._result

    @property
    def solved(self) -> bool:
        """Whether there is a result."""
        return self._result is not None

    def start(self) -> None:
        """Open the server; does nothing when running."""
        with self._lock:
            if self._server is not None:
                return
            server = self._open()
            try:
                self._window = _Window(server, self._problem, self._method, self._dark, self.stop_solve, self.show)
            except BaseException:
                self.stop()
                raise
            self._thread = threading.Thread(target=self._draw, name="mjslq watch", daemon=True)
            self._thread.start()

    def run(self) -> Result:
        """Solve; afterwards the window plays the result. Raises ValueError as `mjslq.solve` does."""
        try:
            self._result = solve(self._problem, self._method, watcher=self.observe, **self._options)
        finally:
            self._end_drawing()
        self._play(self._result)
        return self._result

    def stop_solve(self) -> None:
        """End the solve after the iteration at hand, with the best iterate; as the button in the window does."""
        self._stopping.set()

    def show(self, which: Which) -> None:
        """Show the "newest" iterate, or the "best" one so far."""
        choose("iterate", which, WHICH)
        self._which = which

    def stop(self) -> None:
        """Stop the solve and close the server; does nothing when not running."""
        self._stopping.set()
        self._ended.set()
        self._end_drawing()
        with self._lock:
            server, self._server = self._server, None
            player, self.player = self.player, None
        if player is not None:
            player.stop()
        elif server is not None:
            with quiet():
                server.stop()

    def observe(self, entry: IterationLog, trajectory: Trajectory) -> bool:
        """Take an iterate from the solve; True when it is to stop. This is all that the solver waits for."""
        self._log.append(entry)
        self._newest = (entry, trajectory)
        if self._best is None or _rank(entry) <= _rank(self._best[0]):
            self._best = self._newest
        asked = self._watcher is not None and bool(self._watcher(entry, trajectory))
        return asked or self._stopping.is_set()

    def _draw(self) -> None:
        """Draw until the solve is over, and sleep in between."""
        window = self._window
        assert window is not None
        pause = 1.0 / _FRAMES
        while not self._over.wait(pause):
            pair = self._newest if self._which == "newest" else self._best
            try:
                pause = window.draw(self._log, pair, self._stopping.is_set())
            except Exception as error:  # nothing that goes wrong here may harm the solve
                self.trouble = error
                return

    def _end_drawing(self) -> None:
        self._over.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _play(self, result: Result) -> None:
        """Hand the window over to a player of the result."""
        with self._lock:
            if self._server is None:
                return
            try:
                assert self._window is not None
                player = Player(result, self._host, self._wanted_port, dark=self._dark)
                self._window.clear()
                player.take_over(self._server)
                self.player = player
                self._window.frame_untouched()
            except Exception as error:  # the result is there all the same
                self.trouble = error
                self.stop()


class _Window:
    """What a window shows while a solve runs."""

    def __init__(
        self,
        server: viser.ViserServer,
        problem: Problem,
        method: str,
        dark: bool,
        stop: Callable[[], None],
        show: Callable[[Which], None],
    ) -> None:
        self._server, self._problem, self._method = server, problem, method
        self._scene = problem.scene()
        self._view: SceneView | None = None
        self._playback = Playback(1.0, playing=True, rest=0.4)
        self._last, self._next_change = clock.monotonic(), 0.0
        self._known = 0
        self._drawn: Any = None
        self._size = 0.0
        self._boxes: MovingBoxes | None = None
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(CONTROLS_WIDTH)
        gui.set_panel_label("mjslq")
        self._card = gui.add_html(panels.solving(problem.name, method, None))
        self._button = gui.add_button("Stop", color="red", icon=viser.Icon.PLAYER_STOP)
        self._which = gui.add_dropdown("Show", WHICH, hint="Which of the iterates moves")
        self._curves = gui.add_folder("Optimization", visible=False)
        self._costs: CostPlot | None = None
        self._button.on_click(lambda _: self._stop(stop))
        self._which.on_update(lambda event: show(event.target.value))
        if self._scene is not None:
            x0 = np.asarray(problem.x0)
            standing = Trajectory(np.stack([x0, x0]), np.zeros((1, problem.dynamics.nu)), dt=problem.dynamics.dt)
            self._view = SceneView(server, self._scene, standing, ASPECT, dark=dark, passed=False)
            self._boxes = MovingBoxes(model_from_mjb(self._scene.model))
        self._framing = Framing(server, ASPECT)

    def draw(self, log: list[IterationLog], pair: tuple[IterationLog, Trajectory] | None, stopping: bool) -> float:
        """Show the numbers and curves of `log`, and the motion of the iterate in `pair`; return when to go on. [s]"""
        now, spent = clock.monotonic(), clock.thread_time()
        with self._server.atomic():
            if pair is not None and now >= self._next_change:
                self._change(list(log), pair, stopping)
                spent, before = clock.thread_time(), spent
                self._next_change = now + max(1.0 / _CHANGES, (spent - before) / SHARE)
            if self._view is not None and self._playback.elapse(now - self._last):
                self._view.show(self._playback.time)
        self._last = now
        return max(1.0 / _FRAMES, (clock.thread_time() - spent) / SHARE)

    def clear(self) -> None:
        """Take everything from the page but the camera."""
        with self._server.atomic():
            self._server.gui.reset()
            self._server.scene.reset()

    def frame_untouched(self) -> None:
        """Point untouched cameras at what the player shows."""
        start: Any = self._server.initial_camera
        self._framing.follow_to(np.array(start.position), np.array(start.look_at))

    def _stop(self, stop: Callable[[], None]) -> None:
        self._button.disabled = True
        self._button.label = "Stopping after this iteration"
        stop()

    def _change(self, log: list[IterationLog], pair: tuple[IterationLog, Trajectory], stopping: bool) -> None:
        if len(log) > self._known:
            self._known = len(log)
            self._card.content = panels.solving(self._problem.name, self._method, log[-1], stopping)
            self._curves.visible = True
            with self._curves:
                if self._costs is None:
                    self._costs = CostPlot(self._server.gui, log, bool(self._problem.bound_constraints), True)
                else:
                    self._costs.update(log)
        if self._scene is not None and pair[1] is not self._drawn and finite_knots(pair[1]) > 1:
            self._drawn = pair[1]
            self._move(_thinned(pair[1]))

    def _move(self, trajectory: Trajectory) -> None:
        """Let the robot move along another iterate."""
        assert self._view is not None and self._boxes is not None
        moved = self._view.motion(trajectory)
        box = self._boxes.around(moved)
        if box is not None:
            size = float(np.linalg.norm(box[1] - box[0]))
            if size > _GROWN * self._size:
                self._size = size
                self._framing.follow(*box)
        self._view.follow(moved)
        self._playback.duration = float(trajectory.times[-1])


def _rank(entry: IterationLog) -> tuple[float, float]:
    """What the best iterate has least of: violation first, then cost."""
    cost = entry.cost if np.isfinite(entry.cost) else np.inf
    return max(entry.violation, _TOLERATED), cost


def _thinned(trajectory: Trajectory) -> Trajectory:
    """The same motion with fewer knots."""
    knots = np.unique(np.linspace(0, finite_knots(trajectory) - 1, _KNOTS).round().astype(int))
    times = trajectory.times[knots]
    return Trajectory(trajectory.X[knots], trajectory.U[knots[:-1]], dt=np.diff(times))


def watched(watch: Watch, block: bool) -> Watch:
    """Start, say where it is, solve, and stay until Ctrl-C if `block`."""
    try:
        watch.start()
        print(f"{watch.kind} at {watch.url} (Ctrl-C or its Stop button ends the solve)", flush=True)
        watch.run()
    except KeyboardInterrupt:
        watch.stop()
        if not watch.solved:
            raise
        return watch
    except BaseException:
        watch.stop()
        raise
    if watch.trouble is not None:
        print(f"the viewer failed, the solve did not: {watch.trouble}", file=sys.stderr)
    if block:
        stay(watch)
    return watch
