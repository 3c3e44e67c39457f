"""The "Look" folder of the panel: what a scene shows, what the camera does, light or dark."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from mjslq.viewer.layers.layer import Layer
from mjslq.viewer.scene import SceneView

if TYPE_CHECKING:
    import viser

_NOTE = '<div style="font-size:12px;line-height:1.5;opacity:.8;padding:0 10px 6px">{}</div>'
_FREE, _NOTHING, _PICK = "(free)", "(nothing)", "(choose)"
_COLLISION = 3  # the group that models keep their collision shapes in, by custom
PRIMARY = ("traces", "contacts", "tendons", "flexes", "targets", "masses")
"""Layers whose switches stand in the folder itself; those of the others are in one below it."""


class Look:
    """Widgets for a scene, in the current container of the GUI."""

    def __init__(
        self,
        gui: viser.GuiApi,
        view: SceneView,
        *,
        skip: tuple[str, ...] = (),
        still: bool = False,
        on_dark: Callable[[bool], None] | None = None,
    ) -> None:
        """Add a folder for `view`; `skip` names layers that have a switch elsewhere.

        `still` is for a scene that is a backdrop to bodies which others draw: all that it has is light and dark.
        `on_dark` is called when the page turns dark or light.
        """
        self._gui, self._view, self._on_dark = gui, view, on_dark
        self.switches: dict[str, Any] = {}
        """The switch of each layer, by the layer's name."""
        with gui.add_folder("Look"):
            self.dark: Any = gui.add_checkbox("Dark", view.dark)
            self.dark.on_update(_from_browser(lambda event: self.set_dark(bool(event.target.value))))
            if still:
                return
            self._add_camera()
            for name in PRIMARY:
                if name in view.layers and name not in skip:
                    self._add_layer(name)
            with gui.add_folder("More", expand_by_default=False):
                for name in view.layers:
                    if name not in PRIMARY and name not in skip:
                        self._add_layer(name)
                self._add_groups()
                self._add_paths()

    def set_dark(self, dark: bool) -> None:
        """Turn the page and the scene dark or light."""
        self._gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark)
        self._view.set_dark(dark)
        self.dark.value = dark
        if self._on_dark is not None:
            self._on_dark(dark)

    def _add_camera(self) -> None:
        gui, view = self._gui, self._view
        gui.add_button("Frame the motion").on_click(lambda _: view.frame())
        bodies = tuple(view.cameras.bodies.values())
        if bodies:
            follow = gui.add_dropdown("Follow", (_NOTHING, *bodies), initial_value=_NOTHING)
            follow.on_update(_from_browser(lambda event: view.track(_or_none(event.target.value, _NOTHING))))
        names = tuple(view.cameras.names)
        if names:
            cameras = gui.add_dropdown("Camera", (_FREE, *names), initial_value=_FREE)
            cameras.on_update(_from_browser(lambda event: view.use_camera(_or_none(event.target.value, _FREE))))

    def _add_layer(self, name: str) -> None:
        layer = self._view.layers[name]
        switch = self._gui.add_checkbox(layer.title, layer.visible, hint=layer.hint or None)

        def switched(event: Any) -> None:
            layer.visible = bool(event.target.value)

        switch.on_update(_from_browser(switched))
        self.switches[name] = switch
        self._add_note(layer)

    def _add_note(self, layer: Layer) -> None:
        """Add a line that tells what a layer says of itself."""
        note = self._gui.add_html("")

        def noted() -> None:
            note.content, note.visible = _NOTE.format(layer.note), bool(layer.note)

        layer.noted = noted
        noted()

    def _add_groups(self) -> None:
        view = self._view
        present = view.bodies.present
        if present == [0] and not view.model.nsite:
            return
        for group in present:
            label = f"Group {group}" + (" (collision)" if group == _COLLISION else "")
            box = self._gui.add_checkbox(label, group in view.bodies.groups, hint="Geoms and sites of this group")
            box.on_update(_from_browser(partial(_switch, partial(view.show_group, group))))
        if view.model.nsite:
            sites = self._gui.add_checkbox("Sites", True)
            sites.on_update(_from_browser(lambda event: view.bodies.show_sites(bool(event.target.value))))

    def _add_paths(self) -> None:
        traces = self._view.traces
        if not traces.points:
            return
        menu: Any = self._gui.add_dropdown(
            "Path of", (_PICK, *traces.points), initial_value=_PICK, hint="Adds a path, or takes it away"
        )
        if traces.noted is None:
            self._add_note(traces)
        none = self._gui.add_button("No paths")

        def picked(event: Any) -> None:
            name = event.target.value
            if name != _PICK:
                menu.value = _PICK
                rest = tuple(other for other in traces.chosen if other != name)
                traces.choose(*rest, *(() if name in traces.chosen else (name,)))

        menu.on_update(_from_browser(picked))
        none.on_click(lambda _: traces.choose())


def _switch(act: Callable[[bool], None], event: Any) -> None:
    act(bool(event.target.value))


def _or_none(value: str, nothing: str) -> str | None:
    return None if value == nothing else value


def _from_browser(act: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a callback that acts on events from a browser; values set from Python have no client and are ignored."""

    def callback(event: Any) -> None:
        if event.client_id is not None:
            act(event)

    return callback
