"""Keys of a viewer: Viser's own commands with hotkeys, a list of them on `?` and `h`, and no turning camera on arrows.

Viser (1.1) has a public way to hear keys, `gui.add_command(label, hotkey=...)`, whose commands are found under Ctrl+K
as well. Three things it has not, for which `gui.add_html` takes a script into the page. Its camera turns with the arrow
keys: the script hands arrows on to the commands alone. A slider in focus moves with arrows, Home and End: these it
keeps from the commands. And boxes and menus hold the keys once they were clicked: it takes the focus from them. W, A,
S, D, Q and E move Viser's camera and are left to it.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import viser

_SCRIPT = """
if (!window.mjslqKeys) {
  window.mjslqKeys = true;
  document.body.addEventListener("keydown", (event) => {
    const arrow = event.key.startsWith("Arrow");
    if (!(arrow || event.key === "Home" || event.key === "End")) return;
    if (event.target.closest("input, textarea, select")) return;
    const slider = event.target.closest("[role=slider]");
    if (arrow || slider) event.stopPropagation();
    if (arrow && !slider) document.documentElement.dispatchEvent(new KeyboardEvent("keydown", {key: event.key}));
  });
  document.body.addEventListener("click", (event) => {
    const chosen = event.target.closest("button, label, input[type=checkbox], [role=option]");
    if (event.detail && chosen) setTimeout(() => document.activeElement.blur());
  });
}
"""


@dataclass(frozen=True)
class Key:
    """A key and what it does."""

    shown: str
    """What the list calls it."""
    does: str
    """What it does, in a few words; the name of the command, too."""
    act: Callable[[], object]
    """What is called."""
    hotkeys: tuple[tuple[str, str | None], ...]
    """The keys as Viser writes them, each with its modifier."""


def key(shown: str, does: str, act: Callable[[], object], *hotkeys: str) -> Key:
    """One or several keys without modifiers."""
    return Key(shown, does, act, tuple((hotkey, None) for hotkey in hotkeys or (shown,)))


def bind(gui: viser.GuiApi, keys: Sequence[Key]) -> None:
    """Hear `keys`, and show their list on `?` and `h`; adds a line that says so to the current container."""
    for one in keys:
        for hotkey, modifier in one.hotkeys:
            command = gui.add_command(one.does, hotkey=hotkey, modifier=modifier)  # type: ignore[arg-type]
            command.on_trigger(_does(one.act))
    listed = _list(keys)
    for hotkey, modifier in (("H", None), ("?", "shift")):
        gui.add_command("List of keys", hotkey=hotkey, modifier=modifier).on_trigger(_shows(listed))  # type: ignore[arg-type]
    gui.add_html(
        '<div style="font-size:11px;opacity:.6;padding:2px 12px 8px">Press ? or h for the list of keys.'
        f'<img src="data:," alt="" style="display:none" onerror="{html.escape(_SCRIPT)}"></div>'
    )


def _does(act: Callable[[], object]) -> Callable[[Any], None]:
    def triggered(_: Any) -> None:
        act()

    return triggered


def _shows(listed: str) -> Callable[[Any], None]:
    def triggered(event: Any) -> None:
        modal = event.client.gui.add_modal("Keys")
        with modal:
            event.client.gui.add_html(listed)
            event.client.gui.add_button("Close").on_click(lambda _: modal.close())

    return triggered


def _list(keys: Sequence[Key]) -> str:
    rows = "".join(
        f'<kbd style="font:12px ui-monospace,monospace;border:1px solid rgba(128,128,128,.5);border-radius:4px;'
        f'padding:0 6px;justify-self:start;white-space:nowrap">{html.escape(one.shown)}</kbd>'
        f"<div>{html.escape(one.does)}</div>"
        for one in keys
    )
    return (
        '<div style="font-size:13px;display:grid;grid-template-columns:auto 1fr;gap:6px 16px;padding:4px 12px 12px">'
        f'{rows}</div><div style="font-size:12px;opacity:.65;padding:0 12px 10px">W A S D Q E move the camera; '
        "drag turns it. Ctrl+K lists these as commands.</div>"
    )
