"""Widgets of the viewer and their callbacks. Setting a widget from Python fires no callback, only a browser does."""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.validation import Array

if TYPE_CHECKING:
    import viser

SPEEDS = {"0.05 x": 0.05, "0.1 x": 0.1, "0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "4 x": 4.0}
"""What the speed menu offers."""

GHOSTS = {"none": "off", "along the motion": "along", "previous iterate": "previous", "first iterate": "first"}
"""What the menu of ghosts offers, and the mode each choice stands for."""

LAYOUTS = ("overlaid", "side by side")
"""How several results stand in the scene."""
_STEPS = {"first": None, "- 1": -1, "+ 1": 1, "last": None}
"""What the buttons for single steps are called, and how far they go."""

_NOTE = '<div style="font-size:12px;opacity:.65;padding:0 12px 6px;text-align:right;white-space:pre-line">{}</div>'


@dataclass(frozen=True)
class Actions:
    """Callbacks of the widgets."""

    toggle: Callable[[], None]
    """Play or pause."""
    seek: Callable[[float], None]
    """Go to the knot that is nearest to a time [s]."""
    step: Callable[[int], None]
    """Go on by so many knots."""
    set_speed: Callable[[float], None]
    """Seconds of motion a second."""
    set_loop: Callable[[bool], None]
    """Whether to start over at the end."""
    show_iterate: Callable[[int], None]
    """Show an iterate."""
    step_iterate: Callable[[int], None]
    """Go on by so many iterates."""
    set_ghosts: Callable[[str, int], None]
    """Mode and number of ghosts."""
    set_trace: Callable[[bool], None]
    """Show or hide the paths of the outermost bodies."""
    set_layout: Callable[[str], None]
    """One of `LAYOUTS`."""
    set_visible: Callable[[int, bool], None]
    """Show or hide one of several results."""


class Controls:
    """Time, iterations and ghosts, in the current container of the GUI."""

    def __init__(
        self,
        gui: viser.GuiApi,
        actions: Actions,
        *,
        times: Array,
        iterates: int,
        iterate: int,
        scene: bool,
        results: Sequence[str] = (),
        layouts: Sequence[str] = LAYOUTS,
    ) -> None:
        """Add the widgets for a motion with knots at `times` [s].

        `iterates` were kept, of which `iterate` is shown. Of several `results`, by their labels, each can be hidden.
        """
        self._gui = gui
        self._actions = actions
        self._times, self._knot, self._digits = times, 0, 4
        self._add_time(times)
        self.iterations: viser.GuiSliderHandle[int] | None = None
        self.note: viser.GuiHtmlHandle | None = None
        self.optimization = gui.add_folder("Optimization")
        if iterates > 1:
            self._add_iterations(iterates, iterate)
        self.ghosts: viser.GuiDropdownHandle[str] | None = None
        self.ghost_count: viser.GuiSliderHandle[int] | None = None
        self.trace: viser.GuiCheckboxHandle | None = None
        self.layout: viser.GuiDropdownHandle[str] | None = None
        self.visible: list[viser.GuiCheckboxHandle] = []
        if scene:
            with gui.add_folder("Scene"):
                if len(results) > 1:
                    self._add_results(results, layouts)
                self._add_ghosts(iterates > 1)

    def show(self, time: float, playing: bool) -> None:
        """Show where playback stands."""
        time = min(round(time, self._digits), self.time.max)
        if self.time.value != time:
            _set(self.time, time)
        knot = self.knot_of(time)
        if knot != self._knot:
            self._knot = knot
            self.where.content = _NOTE.format(f"knot {knot} of {len(self._times) - 1}")
        label = "Pause" if playing else "Play"
        if self.button.label != label:
            self.button.label = label
            self.button.icon = _icon(playing)

    def knot_of(self, time: float) -> int:
        """The knot that is nearest to `time` [s]."""
        return int(np.abs(self._times - time).argmin())

    def show_speed(self, speed: float, loop: bool) -> None:
        """Set the menus to how fast time runs, as far as they offer it, and whether it starts over."""
        for title, other in SPEEDS.items():
            if other == speed and self.speed.value != title:
                _set(self.speed, title)
        if self.loop.value != loop:
            _set(self.loop, loop)

    def show_trace(self, visible: bool) -> None:
        """Set the box to whether paths are shown."""
        if self.trace is not None and self.trace.value != visible:
            _set(self.trace, visible)

    def show_results(self, layout: str, visible: Sequence[bool]) -> None:
        """Set the menu to how the results stand, and the boxes to which of them are shown."""
        if self.layout is not None and self.layout.value != layout:
            _set(self.layout, layout)
        for box, shown in zip(self.visible, visible, strict=False):
            if box.value != shown:
                _set(box, shown)

    def show_iterate(self, index: int, note: str) -> None:
        """Set the slider to the iterate shown, and the line below it to `note`."""
        if self.iterations is not None and self.note is not None:
            if self.iterations.value != index:
                _set(self.iterations, index)
            self.note.content = _NOTE.format(html.escape(note))

    def show_ghosts(self, mode: str, number: int) -> None:
        """Set the menu to the ghosts shown."""
        if self.ghosts is None or self.ghost_count is None:
            return
        title = next(title for title, other in GHOSTS.items() if other == mode)
        if title in self.ghosts.options and self.ghosts.value != title:
            _set(self.ghosts, title)
        self.ghost_count.visible = mode == "along"
        if mode == "along" and self.ghost_count.min <= number <= self.ghost_count.max:
            _set(self.ghost_count, number)

    def _add_time(self, times: Array) -> None:
        gui, actions = self._gui, self._actions
        duration, steps = float(times[-1]), np.diff(times)
        even = len(steps) > 0 and np.ptp(steps) <= 1e-9 * duration
        if duration > 1.0:
            self._digits = max(0, 3 - int(np.ceil(np.log10(duration))))
        step = 10.0**-self._digits
        if even and steps[0] > step:  # the slider stops at the knots, then
            step = float(f"{steps[0]:.6g}")
            self._digits = max(self._digits, len(f"{step:.10f}".rstrip("0").partition(".")[2]))
        last = max(round(duration, self._digits), 10.0**-self._digits)
        with gui.add_folder("Playback"):
            self.time = gui.add_slider("Time [s]", 0.0, last, round(step, self._digits), 0.0)
            self.where = gui.add_html(_NOTE.format(f"knot 0 of {len(times) - 1}"))
            self.button = gui.add_button("Play", icon=_icon(False))
            steps_of = gui.add_button_group("Knot", tuple(_STEPS))
            self.speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1 x")
            self.loop = gui.add_checkbox("Loop", True)
        self.time.on_update(_from_browser(lambda event: actions.seek(event.target.value)))
        self.button.on_click(lambda _: actions.toggle())
        steps_of.on_click(lambda event: actions.step(_steps(event.target.value, len(times))))
        self.speed.on_update(_from_browser(lambda event: actions.set_speed(SPEEDS[event.target.value])))
        self.loop.on_update(_from_browser(lambda event: actions.set_loop(event.target.value)))

    def _add_iterations(self, iterates: int, iterate: int) -> None:
        with self.optimization:
            self.iterations = self._gui.add_slider("Iterate", 0, iterates - 1, 1, iterate)
            self.note = self._gui.add_html("")
            steps_of = self._gui.add_button_group("Step", tuple(_STEPS))
        self.iterations.on_update(_from_browser(lambda event: self._actions.show_iterate(int(event.target.value))))
        steps_of.on_click(lambda event: self._actions.step_iterate(_steps(event.target.value, iterates)))

    def _add_results(self, results: Sequence[str], layouts: Sequence[str]) -> None:
        gui, actions = self._gui, self._actions
        layout = self.layout = gui.add_dropdown("Results", tuple(layouts), initial_value=layouts[0])
        layout.on_update(_from_browser(lambda event: actions.set_layout(event.target.value)))
        for place, label in enumerate(results):
            box = gui.add_checkbox(label, True)
            box.on_update(_from_browser(partial(self._show_result, place)))
            self.visible.append(box)

    def _show_result(self, place: int, event: Any) -> None:
        self._actions.set_visible(place, event.target.value)

    def _add_ghosts(self, compare: bool) -> None:
        gui = self._gui
        choices = tuple(GHOSTS) if compare else tuple(GHOSTS)[:2]
        ghosts = gui.add_dropdown("Ghosts", choices, initial_value="none")
        number = gui.add_slider("Number", 2, 24, 1, 8, visible=False)
        trace = gui.add_checkbox("Paths", True, hint="Paths of the outermost bodies")
        self.ghosts, self.ghost_count, self.trace = ghosts, number, trace
        for widget in (ghosts, number):
            widget.on_update(_from_browser(lambda _: self._actions.set_ghosts(GHOSTS[ghosts.value], int(number.value))))
        trace.on_update(_from_browser(lambda event: self._actions.set_trace(event.target.value)))


def _set(widget: Any, value: Any) -> None:
    """Set a widget from Python; Viser's types call its value read-only, which it is not."""
    widget.value = value


def _from_browser(act: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a callback that acts on events from a browser; values set from Python have no client and are ignored."""

    def callback(event: Any) -> None:
        if event.client_id is not None:
            act(event)

    return callback


def _steps(button: str, number: int) -> int:
    """How far a button of `_STEPS` goes among `number` entries; the ends are cut off there."""
    by = _STEPS[button]
    return by if by is not None else number if button == "last" else -number


def _icon(playing: bool) -> Any:
    import viser

    return viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY
