"""The page of a player: scenes, summary, widgets, costs, keys and plots, and what is sent to it."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import viser

from mjslq.viewer import comparison, keyboard, panels
from mjslq.viewer.controls import Actions, Controls
from mjslq.viewer.look import Look
from mjslq.viewer.player_keys import keys_of
from mjslq.viewer.plots import CostPlot
from mjslq.viewer.plots_panel import PlotsPanel
from mjslq.viewer.result_view import ResultView

if TYPE_CHECKING:
    from mjslq.viewer.player import Player

_MARKS = 10.0  # moves of the plots' marks a second; each resends the curves
CONTROLS_WIDTH = 330.0  # [px]
ASPECT = 0.85  # of what the panels leave of a usual window
_NO_SCENE = (
    '<div style="font-size:12px;line-height:1.55;opacity:.75;padding:8px 12px">This problem has no model to draw, '
    "so there are only its plots.</div>"
)


class PlayerPage:
    """What a browser shows of a player."""

    def __init__(self, server: viser.ViserServer, player: Player, views: Sequence[ResultView]) -> None:
        """Fill an empty page; `player` is what its widgets move, `views` are the results that it plays."""
        self._server, self._views = server, views
        self._marked_at = -np.inf
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=player.dark)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(CONTROLS_WIDTH)
        gui.set_panel_label("mjslq")
        scenes = [view for view in views if view.result.scene is not None]
        for place, view in enumerate(scenes):
            view.draw(server, ASPECT, place, player.dark)
        if len(views) > 1:
            gui.add_html(panels.comparison([(view.label, view.color, view.result) for view in views]))
        else:
            gui.add_html(panels.summary(views[0].result))
        if not scenes:
            gui.add_html(_NO_SCENE)
        self.controls = Controls(
            gui,
            _actions(player),
            times=player.times,
            iterates=player.iterates,
            iterate=player.iterate or 0,
            scene=bool(scenes),
            results=[view.label for view in views],
            layouts=player.layouts,
        )
        self._look = self._add_look(gui, player)
        self._costs = self._add_costs(gui, player.iterates)
        keyboard.bind(gui, keys_of(player))
        self.plots = PlotsPanel(gui, views, lambda: player.time, alone=not scenes)

    def show(self, time: float, playing: bool) -> None:
        """Send where playback stands: robots and widgets each time, marks at their own pace."""
        with self._server.atomic():
            for view in self._views:
                view.show(time)
            self.controls.show(time, playing)
            now = clock.monotonic()
            if not playing or now - self._marked_at >= 1.0 / _MARKS:
                self._marked_at = now
                self.plots.mark(time)

    def set_dark(self, dark: bool) -> None:
        """Turn page and scene dark or light."""
        if self._look is None:
            self._server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark)
        else:
            self._look.set_dark(dark)

    def note_iterate(self, iterate: int) -> None:
        """Set slider, line and mark to the iterate shown."""
        self.controls.show_iterate(iterate, "\n".join(view.note() for view in self._views))
        entry = self._views[0].entry
        if self._costs is not None and entry is not None:
            self._costs.mark(float(entry.iteration))

    def _add_look(self, gui: viser.GuiApi, player: Player) -> Look | None:
        """What is shown of the scene; with several results, whether it is dark."""
        stage = next((view.stage for view in self._views if view.stage is not None), None)
        if stage is None:
            return None

        def noted(dark: bool) -> None:
            player.dark = dark

        return Look(gui, stage, skip=("traces",), still=len(self._views) > 1, on_dark=noted)

    def _add_costs(self, gui: viser.GuiApi, iterates: int) -> CostPlot | None:
        results = [view.result for view in self._views]
        if len(results) > 1:
            with gui.add_folder("Comparison"):
                comparison.add_comparison(gui, results)
        elif any(np.isfinite(entry.cost) for entry in results[0].log):
            with self.controls.optimization:
                return CostPlot(gui, results[0].log, bool(results[0].violations))
        self.controls.optimization.visible = iterates > 1
        return None


def _actions(player: Player) -> Actions:
    return Actions(
        player.toggle, lambda time: player.seek_knot(player.knot_at(time)), player.step, player.set_speed,
        player.set_loop, player.show_iterate, player.step_iterate, player.set_ghosts, player.set_trace,
        player.set_layout, player.set_visible,
    )  # fmt: skip
