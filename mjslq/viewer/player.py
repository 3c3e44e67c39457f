"""`Player`: a result in a browser window, with time, iterations, ghosts and plots; or several, on one clock."""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Sequence

import numpy as np
import viser

from mjslq.result import Result
from mjslq.validation import Array, choose
from mjslq.viewer import comparison, keyboard, panels
from mjslq.viewer.controls import GHOSTS, LAYOUTS, Actions, Controls
from mjslq.viewer.framing import Framing
from mjslq.viewer.playback import Playback
from mjslq.viewer.player_keys import keys_of
from mjslq.viewer.plots import CostPlot
from mjslq.viewer.plots_panel import PlotsPanel
from mjslq.viewer.scene import quiet
from mjslq.viewer.serving import Served

_FRAMES = 30.0  # sent to the browser a second
_MARKS = 10.0  # moves of the plots' marks a second; each resends the curves
CONTROLS_WIDTH = 330.0  # [px]
ASPECT = 0.85  # of what the panels leave of a usual window
_NO_SCENE = (
    '<div style="font-size:12px;line-height:1.55;opacity:.75;padding:8px 12px">This problem has no model to draw, '
    "so there are only its plots.</div>"
)


class Player(Served):
    """A Viser server that plays results; a context manager, or `start` and `stop`.

    Everything that moves it, from Python or from the browser, goes through one lock, so that a frame is never
    half of one state and half of another.
    """

    def __init__(
        self,
        result: Result | Sequence[Result],
        host: str = "127.0.0.1",
        port: int = 8080,
        *,
        autoplay: bool = True,
        beside: Sequence[Result] = (),
    ) -> None:
        """Prepare to show `result`, or several of them, at `host`:`port`, or at the next free port; `start` opens it.

        Results `beside` it are compared with it as if they were given in one list.
        """
        given = list(result) if isinstance(result, Sequence) else [result]
        self._views = comparison.views_of([*given, *beside])
        self._longest = max(self._views, key=lambda view: view.duration)
        self.layouts = comparison.layouts(self._views)
        """How the results can stand in the scene, of "overlaid" and "side by side"."""
        self.layout = self.layouts[0]
        """How they stand."""
        super().__init__(host, port)
        self._playback = Playback(self._longest.duration, playing=autoplay)
        self._times: Array = self._longest.result.trajectory.times
        self.iterates = max(len(view.result.iterates) for view in self._views)
        """Number of iterates kept; of several results, of the one with the most."""
        shown = [view.iterate for view in self._views if view.iterate is not None]
        self._iterate = max(shown) if shown else None
        self.ghosts = ("off", 0)
        """Mode and number of ghosts."""
        self.trace = True
        """Whether paths are shown."""
        self._wake = threading.Event()
        self._thread: threading.Thread | None = None
        self._controls: Controls | None = None
        self._plots: PlotsPanel | None = None
        self._cost_plot: CostPlot | None = None
        self._marked_at = -np.inf

    @property
    def controls(self) -> Controls:
        """The widgets in the browser; RuntimeError before `start` and after `stop`."""
        if self._controls is None:
            raise RuntimeError("the viewer is not running; start it first")
        return self._controls

    @property
    def plots(self) -> PlotsPanel:
        """The plots of signals; RuntimeError before `start` and after `stop`."""
        if self._plots is None:
            raise RuntimeError("the viewer is not running; start it first")
        return self._plots

    @property
    def running(self) -> bool:
        """Whether the server is up."""
        return self._server is not None

    @property
    def time(self) -> float:
        """Time shown, in [s]."""
        return self._playback.time

    @property
    def duration(self) -> float:
        """Length of the motion, of several results the longest one. [s]"""
        return self._playback.duration

    @property
    def speed(self) -> float:
        """Seconds of motion a second."""
        return self._playback.speed

    @property
    def loop(self) -> bool:
        """Whether it starts over at the end."""
        return self._playback.loop

    @property
    def labels(self) -> list[str]:
        """What tells several results apart."""
        return [view.label for view in self._views]

    @property
    def results_visible(self) -> list[bool]:
        """Whether each of the results is shown in the scene."""
        return [view.visible for view in self._views]

    @property
    def drawn(self) -> bool:
        """Whether there is a scene."""
        return any(view.view is not None for view in self._views)

    @property
    def knot(self) -> int:
        """The knot that is nearest to the time shown."""
        return int(np.abs(self._times - self.time).argmin())

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
            if self._server is None:
                self.take_over(self._open())

    def take_over(self, server: viser.ViserServer) -> None:
        """Show in a server that is open and empty; `stop` closes it."""
        with self._lock:
            self._server = server
            self._ended.clear()
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
            self._controls, self._cost_plot, self._plots = None, None, None
            for view in self._views:
                view.close()
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

    def seek_knot(self, knot: int) -> None:
        """Show a knot, the first or the last one where there are fewer, and pause."""
        self.seek(float(self._times[int(np.clip(knot, 0, len(self._times) - 1))]))

    def step(self, knots: int = 1) -> None:
        """Go on by so many knots, back if negative, and pause."""
        with self._lock:
            time = self._playback.time
            near = self.knot
            between = time - self._times[near]
            if knots > 0 and between < -1e-9 * max(time, 1.0):  # the nearest knot is still ahead: it is the next one
                near -= 1
            elif knots < 0 and between > 1e-9 * max(time, 1.0):
                near += 1
            self.seek_knot(near + knots)

    def set_speed(self, speed: float) -> None:
        """Play `speed` seconds of motion a second."""
        if not speed > 0.0:
            raise ValueError(f"speed must be positive, got {speed}")
        with self._lock:
            self._playback.speed = float(speed)
            self._show_speed()

    def set_loop(self, loop: bool) -> None:
        """Start over at the end, or stop there."""
        with self._lock:
            self._playback.loop = bool(loop)
            self._show_speed()

    def show_iterate(self, index: int) -> None:
        """Show an iterate, by its place in `result.iterates`; of several results the last one where they have fewer."""
        if not 0 <= index < self.iterates:
            raise ValueError(f"iterate must be one of the {self.iterates} kept, got {index}")
        with self._lock:
            self._iterate = index
            for view in self._views:
                view.show_iterate(index)
            self._note_iterate()
            self._show_plots()
            self.set_ghosts(*self.ghosts)

    def step_iterate(self, iterates: int = 1) -> None:
        """Go on by so many iterates, back if negative; does nothing where none were kept."""
        with self._lock:
            if self._iterate is not None:
                self.show_iterate(int(np.clip(self._iterate + iterates, 0, self.iterates - 1)))

    def set_ghosts(self, mode: str, number: int = 8) -> None:
        """Show ghosts: "off", `number` poses "along" the motion, or the "previous" or "first" iterate moving along."""
        choose("ghost mode", mode, GHOSTS.values())
        with self._lock:
            self.ghosts = (mode, number)
            if self._controls is not None:
                self._controls.show_ghosts(mode, number)
            for view in self._views:
                view.set_ghosts(mode, number)
            self._refresh()

    def set_trace(self, visible: bool) -> None:
        """Show or hide the paths of the outermost bodies."""
        with self._lock:
            self.trace = visible
            for view in self._views:
                view.set_trace(visible)
            if self._controls is not None:
                self._controls.show_trace(visible)

    def set_layout(self, layout: str) -> None:
        """Put several results "overlaid" or "side by side". Results of different models only stand side by side."""
        if choose("layout", layout, LAYOUTS) not in self.layouts:
            raise ValueError(f"results of different models cannot be {layout}; they stand {self.layouts[0]}")
        with self._lock:
            self.layout = layout
            for view, offset in zip(self._views, comparison.offsets(self._views, layout), strict=True):
                view.set_offset(offset)
            self._show_results()
            self.frame()

    def set_visible(self, place: int, visible: bool) -> None:
        """Show or hide one of several results in the scene, by its place in the list."""
        if not 0 <= place < len(self._views):
            raise ValueError(f"there are {len(self._views)} results, got place {place}")
        with self._lock:
            self._views[place].set_visible(visible)
            self._show_results()

    def frame(self) -> None:
        """Point the camera at the whole motion, of all results."""
        with self._lock:
            box = comparison.box(self._views, self.layout)
            if self._server is not None and box is not None:
                Framing(self._server, ASPECT).frame(*box)

    def _build(self, server: viser.ViserServer) -> None:
        first, gui = self._views[0], server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(CONTROLS_WIDTH)
        gui.set_panel_label("mjslq")
        scenes = [view for view in self._views if view.result.scene is not None]
        for place, view in enumerate(scenes):
            view.draw(server, ASPECT, place)
        several = len(self._views) > 1
        if several:
            gui.add_html(panels.comparison([(view.label, view.color, view.result) for view in self._views]))
        else:
            gui.add_html(panels.summary(first.result))
        if not scenes:
            gui.add_html(_NO_SCENE)
        actions = Actions(
            self.toggle, lambda time: self.seek_knot(self.controls.knot_of(time)), self.step, self.set_speed,
            self.set_loop, self.show_iterate, self.step_iterate, self.set_ghosts, self.set_trace, self.set_layout,
            self.set_visible,
        )  # fmt: skip
        self._controls = Controls(
            gui,
            actions,
            times=self._times,
            iterates=self.iterates,
            iterate=self._iterate or 0,
            scene=bool(scenes),
            results=[view.label for view in self._views],
            layouts=self.layouts,
        )
        self._add_costs(gui)
        keyboard.bind(gui, keys_of(self))
        self._plots = PlotsPanel(gui, self._views, self._time_shown, alone=not scenes)
        if self._iterate is not None:
            self._note_iterate()
        if several and len(scenes) > 1:
            self.set_layout(self.layout)
        self._show_speed()
        self._refresh()

    def _add_costs(self, gui: viser.GuiApi) -> None:
        results = [view.result for view in self._views]
        if len(results) > 1:
            with gui.add_folder("Comparison"):
                comparison.add_comparison(gui, results)
        elif len([entry for entry in results[0].log if np.isfinite(entry.cost)]):
            with self.controls.optimization:
                self._cost_plot = CostPlot(gui, results[0].log, bool(results[0].violations))
            return
        self.controls.optimization.visible = self.iterates > 1

    def _note_iterate(self) -> None:
        assert self._iterate is not None
        if self._controls is not None:
            self._controls.show_iterate(self._iterate, "\n".join(view.note() for view in self._views))
        entry = self._views[0].entry
        if self._cost_plot is not None and entry is not None:
            self._cost_plot.mark(float(entry.iteration))

    def _show_speed(self) -> None:
        if self._controls is not None:
            self._controls.show_speed(self._playback.speed, self._playback.loop)

    def _show_results(self) -> None:
        if self._controls is not None:
            self._controls.show_results(self.layout, [view.visible for view in self._views])

    def _time_shown(self) -> float:
        return self._playback.time

    def _show_plots(self) -> None:
        with self._lock:
            if self._plots is not None:
                self._plots.show(self._playback.time)

    def _refresh(self) -> None:
        """Send where playback stands: robot and widgets each time, marks at their own pace."""
        if self._server is None or self._controls is None:
            return
        time, playing = self._playback.time, self._playback.playing
        with self._server.atomic():
            for view in self._views:
                view.show(time)
            self._controls.show(time, playing)
            now = clock.monotonic()
            if self._plots is not None and (not playing or now - self._marked_at >= 1.0 / _MARKS):
                self._marked_at = now
                self._plots.mark(time)

    def _run(self) -> None:
        """Let time run until the end; sleeps while paused."""
        last = clock.monotonic()
        while not self._ended.is_set():
            if not self._playback.playing:
                self._wake.wait()
                self._wake.clear()
                last = clock.monotonic()
                continue
            self._ended.wait(1.0 / _FRAMES)
            with self._lock:
                now = clock.monotonic()
                moved = self._playback.elapse(now - last)
                last = now
                if moved or not self._playback.playing:
                    self._refresh()
