"""Results in a browser: `view` serves one, `export_html` writes one to a file that plays anywhere.

Viser and MuJoCo are imported when something is shown, not before.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from mjslq.result import Result

if TYPE_CHECKING:
    from mjslq.mpc import MPC
    from mjslq.viewer.live_view import Live
    from mjslq.viewer.player import Player as Player

__all__ = ["Player", "export_html", "live", "view"]


def view(
    result: Result,
    host: str = "127.0.0.1",
    port: int = 8080,
    block: bool = True,
    beside: Sequence[Result] = (),
    dark: bool = False,
) -> Player:
    """Show `result` in a browser: the motion, its plots, and the iterations that led to it.

    Parameters
    ----------
    result
        Of `mjslq.solve` or `mjslq.load`; needs no solver. Without a scene there are only plots.
    host, port
        Where to serve; a port that is taken gives way to the next free one, and the one in use is printed.
    block
        Stay until Ctrl-C. Otherwise return at once; the caller stops the `Player` returned.
    beside
        Results of other methods on the same problem: their costs are plotted with this one's.
    dark
        Whether the page is dark at first; it has a switch.

    """
    from mjslq.viewer.player import Player
    from mjslq.viewer.serving import present

    return present(Player(result, host, port, beside=beside, dark=dark), block)


def live(
    mpc: MPC, plant: Any = None, host: str = "127.0.0.1", port: int = 8080, block: bool = True, **options: Any
) -> Live:
    """Run a controller and a plant in the browser, in real time; see `mjslq.viewer.live_view.Live` for the options.

    Blocks until Ctrl-C unless `block` is False; then the caller stops the `Live` returned.
    """
    from mjslq.viewer.live_view import Live
    from mjslq.viewer.serving import present

    return present(Live(mpc, plant, host=host, port=port, **options), block)


def export_html(result: Result, path: str | os.PathLike[str]) -> None:
    """Write `result` to one HTML file that plays in any browser, from disk and without a network.

    Raises ValueError when the file cannot be written or the result's scene cannot be read.
    """
    from mjslq.viewer.export import export_html as write

    write(result, path)


def __getattr__(name: str) -> Any:
    if name == "Player":
        from mjslq.viewer.player import Player

        return Player
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
