"""The keys of a player, and what each does."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjslq.viewer.controls import GHOSTS, LAYOUTS, SPEEDS
from mjslq.viewer.keyboard import Key, key

if TYPE_CHECKING:
    from mjslq.viewer.player import Player


def keys_of(player: Player) -> list[Key]:
    """Keys for what this player shows."""
    found = [
        key("space", "Play or pause", player.toggle),
        key("\u2192", "One knot on", lambda: player.step(1), "arrowright"),
        key("\u2190", "One knot back", lambda: player.step(-1), "arrowleft"),
        key("home", "First knot", lambda: player.seek(0.0)),
        key("end", "Last knot", lambda: player.seek(player.duration)),
        key("[", "Slower", lambda: _change_speed(player, -1)),
        key("]", "Faster", lambda: _change_speed(player, 1)),
        key("L", "Loop, or stop at the end", lambda: player.set_loop(not player.loop)),
        key("N", "Dark or light", lambda: player.set_dark(not player.dark)),
    ]
    if player.iterates > 1:
        found[3:3] = [
            key("\u2191", "One iterate on", lambda: player.step_iterate(1), "arrowup"),
            key("\u2193", "One iterate back", lambda: player.step_iterate(-1), "arrowdown"),
        ]
    if player.drawn:
        found += [
            key("F", "Frame the motion", player.frame),
            key("G", "Next kind of ghosts", lambda: _next_ghosts(player)),
            key("T", "Show or hide paths", lambda: player.set_trace(not player.trace)),
        ]
    labels = player.labels
    if len(labels) > 1:
        if len(player.layouts) > 1:
            found.append(key("B", "Overlaid, or side by side", lambda: _next_layout(player)))
        for place, label in enumerate(labels):
            found.append(_shows(player, place, label))
    return found


def _shows(player: Player, place: int, label: str) -> Key:
    return key(
        str(place + 1), f"Show or hide {label}", lambda: player.set_visible(place, not player.results_visible[place])
    )


def _change_speed(player: Player, by: int) -> None:
    speeds = sorted(SPEEDS.values())
    place = int(np.abs(np.log(np.array(speeds) / player.speed)).argmin()) + by
    player.set_speed(speeds[int(np.clip(place, 0, len(speeds) - 1))])


def _next_ghosts(player: Player) -> None:
    modes = list(GHOSTS.values())[: None if player.iterates > 1 else 2]
    mode, number = player.ghosts
    player.set_ghosts(modes[(modes.index(mode) + 1) % len(modes)], number or 8)


def _next_layout(player: Player) -> None:
    player.set_layout(LAYOUTS[(LAYOUTS.index(player.layout) + 1) % len(LAYOUTS)])
