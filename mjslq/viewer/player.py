"""`Player`: a result in a browser window, with time, iterations, ghosts and plots."""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import viser

from mjslq.reports.units import model_from_mjb
from mjslq.result import Result
from mjslq.validation import choose, count
from mjslq.viewer import panels, series
from mjslq.viewer.controls import GHOSTS, Actions, Controls
from mjslq.viewer.look import Look
from mjslq.viewer.motion import Motion
from mjslq.viewer.playback import Playback
from mjslq.viewer.scene import SceneView, quiet
from mjslq.viewer.serving import Served

_FRAMES = 60.0  # sent to the browser a second
_MARKS = 10.0  # moves of the plots' marks a second; each resends the curves
_PLOTS_WIDTH, _CONTROLS_WIDTH = 390.0, 330.0  # [px]
_ASPECT = 0.85  # of what the panels leave of a usual window
_AFTERWARDS = {
    "accepted": ", then a step of {}",
    "rejected": ", then a trial that was rejected",
    "failed": ", then no step was found",
}
_NO_SCENE = (
    '<div style="font-size:12px;line-height:1.55;opacity:.75;padding:8px 12px">This problem has no model to draw, '
    "so there are only its plots.</div>"
)


class Player(Served):
    """A Viser server that plays one result; a context manager, or `start` and `stop`.

    Everything that moves it, from Python or from the browser, goes through one lock, so that a frame is never
    half of one state and half of another.
    """

    def __init__(
        self,
        result: Result,
        host: str = "127.0.0.1",
        port: int = 8080,
        *,
        autoplay: bool = True,
        beside: Sequence[Result] = (),
        dark: bool = False,
    ) -> None:
        """Prepare to show `result` at `host`:`port`, or at the next free port; `start` opens it.

        Results `beside` it, of other methods on the same problem, are compared with it by their costs.
        """
        if not isinstance(result, Result):
            raise ValueError(f"a viewer shows a Result of mjslq.solve or mjslq.load, got {type(result).__name__}")
        self._result = result
        self._beside = tuple(beside)
        self._dark = bool(dark)
        super().__init__(host, port)
        self._playback = Playback(float(result.trajectory.times[-1]), playing=autoplay)
        self._model = None if result.scene is None else model_from_mjb(result.scene.model)
        self._trajectory = result.trajectory
        self._iterate = _nearest_iterate(result)
        self._ghosts = ("off", 0)
        self._ghost_motion: Motion | None = None
        self._motion = lru_cache(maxsize=16)(self._iterate_motion)
        self._wake = threading.Event()
        self._thread: threading.Thread | None = None
        self._view: SceneView | None = None
        self._controls: Controls | None = None
        self._plots: list[panels.SignalPlot] = []
        self._cost_plot: panels.CostPlot | None = None
        self._marked_at = -np.inf
        self.frames = 0
        """How many frames were sent so far."""

    @property
    def controls(self) -> Controls:
        """The widgets in the browser; RuntimeError before `start` and after `stop`."""
        if self._controls is None:
            raise RuntimeError("the viewer is not running; start it first")
        return self._controls

    @property
    def running(self) -> bool:
        """Whether the server is up."""
        return self._server is not None

    @property
    def time(self) -> float:
        """Time shown, in [s]."""
        return self._playback.time

    @property
    def playing(self) -> bool:
        """Whether time runs."""
        return self._playback.playing

    @property
    def iterate(self) -> int | None:
        """Place in `result.iterates` of what is shown; None when the result kept none."""
        return self._iterate

    def start(self) -> None:
        """Open the server and, with `autoplay`, play; does nothing when running."""
        with self._lock:
            if self._server is not None:
                return
            server = self._open()
            try:
                self._build(server)
            except BaseException:
                self.stop()
                raise
            self._thread = threading.Thread(target=self._run, name="mjslq player", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Stop playing and close the server; does nothing when not running."""
        self._ended.set()
        self._wake.set()
        with self._lock:
            thread, self._thread = self._thread, None
            server, self._server = self._server, None
            self._view, self._controls, self._cost_plot, self._plots = None, None, None, []
        if thread is not None and thread is not threading.current_thread():
            thread.join()
        if server is not None:
            with quiet():
                server.stop()

    def toggle(self) -> None:
        """Play or pause; from the end, start over."""
        with self._lock:
            self._playback.toggle()
            self._refresh()
        self._wake.set()

    def seek(self, time: float) -> None:
        """Show `time` [s] and pause."""
        with self._lock:
            self._playback.seek(time)
            self._refresh()

    def set_speed(self, speed: float) -> None:
        """Play `speed` seconds of motion a second."""
        if not speed > 0.0:
            raise ValueError(f"speed must be positive, got {speed}")
        with self._lock:
            self._playback.speed = float(speed)

    def set_loop(self, loop: bool) -> None:
        """Start over at the end, or stop there."""
        with self._lock:
            self._playback.loop = bool(loop)

    def show_iterate(self, index: int) -> None:
        """Show an iterate, by its place in `result.iterates`."""
        if not 0 <= index < len(self._result.iterates):
            raise ValueError(f"iterate must be one of the {len(self._result.iterates)} kept, got {index}")
        with self._lock:
            self._iterate = index
            self._trajectory = self._result.iterates[index]
            if self._view is not None:
                self._view.follow(self._motion(index))
            self._note_iterate(index)
            self._redraw_plots()
            self.set_ghosts(*self._ghosts)

    def set_ghosts(self, mode: str, number: int = 8) -> None:
        """Show ghosts: "off", `number` poses "along" the motion, or the "previous" or "first" iterate moving along."""
        choose("ghost mode", mode, GHOSTS.values())
        with self._lock:
            self._ghosts, self._ghost_motion = (mode, number), None
            if self._controls is not None:
                self._controls.show_ghosts(mode, number)
            if self._view is None:
                return
            if mode == "along":
                self._view.set_ghosts(*self._view.motion(self._trajectory).spread(count("number", number)))
            elif mode == "off" or not self._iterate:
                self._view.clear_ghosts()
            else:
                self._ghost_motion = self._motion(self._iterate - 1 if mode == "previous" else 0)
            self._refresh()

    def set_trace(self, visible: bool) -> None:
        """Show or hide the paths of the outermost bodies."""
        with self._lock:
            if self._view is not None:
                self._view.set_trace(visible)

    def _note_iterate(self, index: int) -> None:
        entry = self._result.log[index] if index < len(self._result.log) else None
        if self._controls is not None:
            told = "" if entry is None else f"cost {panels.short(entry.cost)}"
            if entry is not None:
                told += _AFTERWARDS.get(entry.outcome, "").format(panels.short(entry.alpha))
            self._controls.show_iterate(index, told)
        if self._cost_plot is not None and entry is not None:
            self._cost_plot.mark(float(entry.iteration))

    def _build(self, server: viser.ViserServer) -> None:
        result, gui = self._result, server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=self._dark)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_CONTROLS_WIDTH)
        gui.set_panel_label("mjslq")
        if result.scene is not None:
            self._view = SceneView(
                server, result.scene, self._trajectory, _ASPECT, dark=self._dark, contact=result.contact
            )
        gui.add_html(panels.summary(result))
        if result.scene is None:
            gui.add_html(_NO_SCENE)
        actions = Actions(
            self.toggle, self.seek, self.set_speed, self.set_loop, self.show_iterate, self.set_ghosts, self.set_trace
        )
        self._controls = Controls(
            gui,
            actions,
            duration=self._playback.duration,
            iterates=len(result.iterates),
            iterate=self._iterate or 0,
            scene=result.scene is not None,
        )
        if len(series.costs(result)[0]):
            with self._controls.optimization:
                self._cost_plot = panels.CostPlot(gui, result)
        else:
            self._controls.optimization.visible = len(result.iterates) > 1
        if self._beside:
            from mjslq.viewer.comparison import add_comparison

            with gui.add_folder("Comparison"):
                add_comparison(gui, (result, *self._beside))
        if self._view is not None:
            Look(gui, self._view, skip=("traces",))
        self._add_plots(gui)
        if self._iterate is not None:
            self._note_iterate(self._iterate)
        self._refresh()

    def _add_plots(self, gui: viser.GuiApi) -> None:
        result, panel = self._result, gui.add_panel()
        panel.dock_left()
        panel.set_width(_PLOTS_WIDTH if self._view is not None else 2.1 * _PLOTS_WIDTH)
        with panel.add_tab("Plots"):
            for title, kind in series.KINDS:
                found = series.groups(result, kind, self._model)
                if found:
                    self._plots.append(
                        panels.SignalPlot(gui, title, result, found, self._redraw_plots, self._view is None)
                    )
        self._redraw_plots()

    def _redraw_plots(self) -> None:
        with self._lock:
            for plot in self._plots:
                plot.set_trajectory(self._trajectory)
            self._marked_at = -np.inf
            self._refresh()

    def _iterate_motion(self, index: int) -> Motion:
        assert self._view is not None
        return self._view.motion(self._result.iterates[index])

    def _refresh(self) -> None:
        """Send where playback stands: robot and widgets each time, marks at their own pace."""
        if self._server is None or self._controls is None:
            return
        time, playing = self._playback.time, self._playback.playing
        self.frames += 1
        with self._server.atomic():
            if self._view is not None:
                if self._ghost_motion is not None:
                    positions, wxyzs = self._ghost_motion.at(time)
                    self._view.set_ghosts(positions[None], wxyzs[None])
                self._view.show(time)
            self._controls.show(time, playing)
            now = clock.monotonic()
            if not playing or now - self._marked_at >= 1.0 / _MARKS:
                self._marked_at = now
                for plot in self._plots:
                    plot.mark(time)

    def _run(self) -> None:
        """Let time run until the end; sleeps while paused."""
        last = clock.monotonic()
        while not self._ended.is_set():
            if not self._playback.playing:
                self._wake.wait()
                self._wake.clear()
                last = clock.monotonic()
                continue
            self._ended.wait(max(last + 1.0 / _FRAMES - clock.monotonic(), 0.0))
            with self._lock:
                now = clock.monotonic()
                moved = self._playback.elapse(now - last)
                last = now
                if moved or not self._playback.playing:
                    self._refresh()


def _nearest_iterate(result: Result) -> int | None:
    """Return the iterate that the result's trajectory is, or the last one."""
    if not result.iterates:
        return None
    same = [i for i, t in enumerate(result.iterates) if np.array_equal(t.U, result.trajectory.U)]
    return same[-1] if same else len(result.iterates) - 1
