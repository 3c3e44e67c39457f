"""`Player`: a result in a browser window, with time, iterations, ghosts and plots; or several, on one clock."""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Sequence

import numpy as np
import viser

from mjslq.result import Result
from mjslq.validation import Array, choose
from mjslq.viewer import comparison
from mjslq.viewer.controls import GHOSTS, LAYOUTS, Controls
from mjslq.viewer.framing import Framing
from mjslq.viewer.playback import Playback
from mjslq.viewer.player_page import ASPECT, PlayerPage
from mjslq.viewer.plots_panel import PlotsPanel
from mjslq.viewer.scene import quiet
from mjslq.viewer.serving import Served

_FRAMES = 60.0  # sent to the browser a second


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
        dark: bool = False,
    ) -> None:
        """Prepare to show `result`, or several of them, at `host`:`port`, or at the next free port; `start` opens it.

        Results `beside` it are compared with it as if they were given in one list. The page is `dark` at first, or
        light; it has a switch.
        """
        self.dark = bool(dark)
        """Whether the page is dark."""
        self.frames = 0
        """How many frames were sent so far."""
        given = list(result) if isinstance(result, Sequence) else [result]
        self._views = comparison.views_of([*given, *beside])
        self._longest = max(self._views, key=lambda view: view.duration)
        self.layouts = comparison.layouts(self._views)
        """How the results can stand in the scene, of "overlaid" and "side by side"."""
        self.layout = self.layouts[0]
        """How they stand."""
        super().__init__(host, port)
        self._playback = Playback(self._longest.duration, playing=autoplay)
        self.times: Array = self._longest.result.trajectory.times
        """Times of the knots, of several results those of the longest one. [s]"""
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
        self._page: PlayerPage | None = None

    @property
    def controls(self) -> Controls:
        """The widgets in the browser; RuntimeError before `start` and after `stop`."""
        if self._page is None:
            raise RuntimeError("the viewer is not running; start it first")
        return self._page.controls

    @property
    def plots(self) -> PlotsPanel:
        """The plots of signals; RuntimeError before `start` and after `stop`."""
        if self._page is None:
            raise RuntimeError("the viewer is not running; start it first")
        return self._page.plots

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
        return self.knot_at(self.time)

    def knot_at(self, time: float) -> int:
        """The knot that is nearest to `time` [s]."""
        return int(np.abs(self.times - time).argmin())

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
            self._page = None
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
        self.seek(float(self.times[int(np.clip(knot, 0, len(self.times) - 1))]))

    def step(self, knots: int = 1) -> None:
        """Go on by so many knots, back if negative, and pause."""
        with self._lock:
            time = self._playback.time
            near = self.knot
            between = time - self.times[near]
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
            if self._page is not None:
                self._page.note_iterate(index)
                self._page.plots.show(self._playback.time)
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
            if self._page is not None:
                self._page.controls.show_ghosts(mode, number)
            for view in self._views:
                view.set_ghosts(mode, number)
            self._refresh()

    def set_trace(self, visible: bool) -> None:
        """Show or hide the paths of the outermost bodies."""
        with self._lock:
            self.trace = visible
            for view in self._views:
                view.set_trace(visible)
            if self._page is not None:
                self._page.controls.show_trace(visible)

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
        """Show or hide one of several results, in scene and plots, by its place in the list."""
        if not 0 <= place < len(self._views):
            raise ValueError(f"there are {len(self._views)} results, got place {place}")
        with self._lock:
            self._views[place].set_visible(visible)
            self._show_results()
            if self._page is not None:
                self._page.plots.show(self._playback.time)

    def set_dark(self, dark: bool) -> None:
        """Turn page and scene dark or light."""
        with self._lock:
            self.dark = bool(dark)
            if self._page is not None:
                self._page.set_dark(self.dark)

    def frame(self) -> None:
        """Point the camera at the whole motion, of all results."""
        with self._lock:
            if len(self._views) == 1 and self._views[0].stage is not None:
                self._views[0].stage.frame()
                return
            box = comparison.box(self._views, self.layout)
            if self._server is not None and box is not None:
                Framing(self._server, ASPECT).frame(*box)

    def _build(self, server: viser.ViserServer) -> None:
        self._page = PlayerPage(server, self, self._views)
        if self._iterate is not None:
            self._page.note_iterate(self._iterate)
        if len(self._views) > 1 and self.drawn:
            self.set_layout(self.layout)
        self._show_speed()
        self._refresh()

    def _show_speed(self) -> None:
        if self._page is not None:
            self._page.controls.show_speed(self._playback.speed, self._playback.loop)

    def _show_results(self) -> None:
        if self._page is not None:
            self._page.controls.show_results(self.layout, self.results_visible)

    def _refresh(self) -> None:
        """Send where playback stands."""
        if self._page is not None:
            self.frames += 1
            self._page.show(self._playback.time, self._playback.playing)

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
