"""The panel of plots: one for each kind of signal at first, and as many more as the reader adds."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from mjslq.validation import choose
from mjslq.viewer.plots import PlotCard
from mjslq.viewer.result_view import ResultView

if TYPE_CHECKING:
    import viser

_WIDTH = 390.0  # [px]


class PlotsPanel:
    """Plots of signals over time, on the left side of the window."""

    def __init__(
        self, gui: viser.GuiApi, views: Sequence[ResultView], time: Callable[[], float], *, alone: bool = False
    ) -> None:
        """Add the panel with its first plots.

        `time` returns the time shown [s], for plots that the reader changes. Plots that stand `alone`, without a scene
        beside them, are larger.
        """
        self._gui, self._views, self._time, self._alone = gui, views, time, alone
        self._lock = threading.RLock()
        self.groups: dict[str, list[str]] = {}
        """Names of the signals in each group, of all results together."""
        first: list[str] = []
        for view in views:
            for title, names in view.registry.groups.items():
                known = self.groups.setdefault(title, [])
                known += [name for name in names if name not in known]
            first += [title for title in view.registry.first if title not in first]
        self.cards: list[PlotCard] = []
        """The plots, from top to bottom."""
        panel = gui.add_panel()
        panel.dock_left()
        panel.set_width(2.1 * _WIDTH if alone else _WIDTH)
        self._tab: Any = panel.add_tab("Plots")
        with self._tab:
            self._holder = gui.add_folder(None)
            for title in first:
                self.add(title)
            gui.add_button("Add a plot").on_click(lambda _: self._add_another())
        self.show(time())

    def add(self, group: str | None = None) -> PlotCard:
        """Add a plot of a group of signals; of the first one that is not plotted yet, unless given."""
        with self._lock:
            plotted = {name for card in self.cards for name in card.names}
            fresh = [title for title, names in self.groups.items() if not plotted.issuperset(names)]
            title = choose("group of signals", group, self.groups) if group else [*fresh, *self.groups][0]
            with self._holder:
                card = PlotCard(self._gui, self.groups, title, self._changed, self._remove, self._alone)
            self.cards.append(card)
            card.show(self._shown(), self._time())
            return card

    def plot(self, *names: str) -> PlotCard:
        """Add a plot of the signals with these names. Raises ValueError as `PlotCard.choose` does."""
        with self._lock:
            card = self.add()
            try:
                card.choose(names)
            except ValueError:
                self._remove(card)
                raise
            card.show(self._shown(), self._time())
            return card

    def show(self, time: float) -> None:
        """Draw all plots anew, where another iterate is shown."""
        with self._lock:
            for card in self.cards:
                card.show(self._shown(), time)

    def mark(self, time: float) -> None:
        """Move the marks to `time` [s]."""
        with self._lock:
            for card in self.cards:
                card.mark(time)

    def _shown(self) -> list[Any]:
        visible = [view.shown for view in self._views if view.visible]
        return visible or [view.shown for view in self._views]

    def _changed(self) -> None:
        self.show(self._time())

    def _add_another(self) -> None:
        self.add()

    def _remove(self, card: PlotCard) -> None:
        with self._lock:
            if card in self.cards:
                self.cards.remove(card)
                card.remove()
