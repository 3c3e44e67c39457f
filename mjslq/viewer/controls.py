"""Widgets of the viewer and their callbacks. Setting a widget from Python fires no callback, only a browser does."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import viser

SPEEDS = {"0.1 x": 0.1, "0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0}
"""What the speed menu offers."""

GHOSTS = {"none": "off", "along the motion": "along", "previous iterate": "previous", "first iterate": "first"}
"""What the menu of ghosts offers, and the mode each choice stands for."""


_NOTE = '<div style="font-size:12px;opacity:.65;padding:0 10px 6px;text-align:right">{}</div>'


@dataclass(frozen=True)
class Actions:
    """Callbacks of the widgets."""

    toggle: Callable[[], None]
    """Play or pause."""
    seek: Callable[[float], None]
    """Go to a time [s]."""
    set_speed: Callable[[float], None]
    """Seconds of motion a second."""
    set_loop: Callable[[bool], None]
    """Whether to start over at the end."""
    show_iterate: Callable[[int], None]
    """Show an iterate."""
    set_ghosts: Callable[[str, int], None]
    """Mode and number of ghosts."""
    set_trace: Callable[[bool], None]
    """Show or hide the paths of the outermost bodies."""


class Controls:
    """Time, iterations and ghosts, in the current container of the GUI."""

    def __init__(
        self, gui: viser.GuiApi, actions: Actions, *, duration: float, iterates: int, iterate: int, scene: bool
    ) -> None:
        """Add the widgets for a motion of `duration` [s], `iterates` kept iterates (`iterate` shown), and a scene."""
        self._gui = gui
        self._actions = actions
        self._add_time(duration)
        self.iterations: viser.GuiSliderHandle[int] | None = None
        self.note: viser.GuiHtmlHandle | None = None
        self.optimization = gui.add_folder("Optimization")
        if iterates > 1:
            self._add_iterations(iterates, iterate)
        self.ghosts: viser.GuiDropdownHandle[str] | None = None
        self.ghost_count: viser.GuiSliderHandle[int] | None = None
        if scene:
            self._add_ghosts(iterates > 1)

    def show(self, time: float, playing: bool) -> None:
        """Show where playback stands."""
        time = min(round(time, self._digits), self.time.max)
        if self.time.value != time:
            _set(self.time, time)
        label = "Pause" if playing else "Play"
        if self.button.label != label:
            self.button.label = label
            self.button.icon = _icon(playing)

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

    def _add_time(self, duration: float) -> None:
        gui, actions = self._gui, self._actions
        with gui.add_folder("Playback"):
            self._digits = max(0, 3 - int(np.ceil(np.log10(duration)))) if duration > 1.0 else 4
            last = max(round(duration, self._digits), 10.0**-self._digits)
            self.time = gui.add_slider("Time [s]", 0.0, last, round(10.0**-self._digits, self._digits), 0.0)
            self.button = gui.add_button("Play", icon=_icon(False))
            self.speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1 x")
            self.loop = gui.add_checkbox("Loop", True)
        self.time.on_update(_from_browser(lambda event: actions.seek(event.target.value)))
        self.button.on_click(lambda _: actions.toggle())
        self.speed.on_update(_from_browser(lambda event: actions.set_speed(SPEEDS[event.target.value])))
        self.loop.on_update(_from_browser(lambda event: actions.set_loop(event.target.value)))

    def _add_iterations(self, iterates: int, iterate: int) -> None:
        with self.optimization:
            self.iterations = self._gui.add_slider("Iterate", 0, iterates - 1, 1, iterate)
            self.note = self._gui.add_html("")
        self.iterations.on_update(_from_browser(lambda event: self._actions.show_iterate(int(event.target.value))))

    def _add_ghosts(self, compare: bool) -> None:
        gui = self._gui
        choices = tuple(GHOSTS) if compare else tuple(GHOSTS)[:2]
        with gui.add_folder("Scene"):
            ghosts = gui.add_dropdown("Ghosts", choices, initial_value="none")
            number = gui.add_slider("Number", 2, 24, 1, 8, visible=False)
            trace = gui.add_checkbox("Paths", True, hint="Paths of the outermost bodies")
        self.ghosts, self.ghost_count = ghosts, number
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


def _icon(playing: bool) -> Any:
    import viser

    return viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY
