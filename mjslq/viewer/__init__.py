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
    from mjslq.problem import Problem
    from mjslq.viewer.live_view import Live
    from mjslq.viewer.player import Player as Player
    from mjslq.viewer.watching import Watch

__all__ = ["Player", "export_html", "live", "view", "watch"]


def view(
    result: Result | Sequence[Result],
    host: str = "127.0.0.1",
    port: int = 8080,
    block: bool = True,
    beside: Sequence[Result] = (),
    dark: bool = False,
) -> Player:
    """Show `result` in a browser: the motion, its plots, and the iterations that led to it; `?` lists the keys.

    Parameters
    ----------
    result : Result or sequence of Result
        Of `mjslq.solve` or `mjslq.load`; needs no solver. Without a scene there are only plots. Several results, at
        most eight, are compared: each in one colour, on one clock, over each other or side by side, with their curves
        in the same plots. Results of different models stand side by side.
    host, port
        Where to serve; a port that is taken gives way to the next free one, and the one in use is printed.
    block : bool
        Stay until Ctrl-C. Otherwise return at once; the caller stops the `Player` returned.
    beside : sequence of Result
        More results to compare with the first, as if they were in one list with it.
    dark : bool
        Whether the page is dark at first; it has a switch.

    Raises
    ------
    ValueError
        For what is no result, more than eight of them, and an address of another machine.
    """
    from mjslq.viewer.player import Player
    from mjslq.viewer.serving import present

    return present(Player(result, host, port, beside=beside, dark=dark), block)


def watch(
    problem: Problem,
    method: str = "auto",
    host: str = "127.0.0.1",
    port: int = 8080,
    block: bool = True,
    dark: bool = False,
    **options: Any,
) -> Watch:
    """Solve `problem` and show it in a browser while it runs: iterates stream in, and a button stops the solve.

    When the solve ends its window plays the result, as `view` does.

    Parameters
    ----------
    problem, method, **options
        As those of `mjslq.solve`.
    host, port
        Where to serve, as for `view`.
    block : bool
        Stay until Ctrl-C when the solve has ended. Otherwise return then; the caller stops the `Watch` returned.
    dark : bool
        Whether the page is dark at first.

    Returns
    -------
    Watch
        Its `result` is the `Result`. Stop and Ctrl-C during the solve lose nothing: it is the best iterate, then.

    Raises
    ------
    ValueError
        As `mjslq.solve` and `view` do.
    """
    from mjslq.viewer.watching import Watch, watched

    return watched(Watch(problem, method, host, port, dark=dark, **options), block)


def live(
    mpc: MPC, plant: Any = None, host: str = "127.0.0.1", port: int = 8080, block: bool = True, **options: Any
) -> Live:
    """Run a controller and a plant in the browser, in real time.

    Parameters
    ----------
    mpc : MPC
        The controller.
    plant : mujoco.MjModel or Dynamics
        What is controlled; the problem's own engine unless given.
    host, port
        Where to serve; a port that is taken gives way to the next free one.
    block : bool
        Stay until Ctrl-C. Otherwise return at once; the caller stops the `Live` returned.
    **options
        As `mjslq.viewer.live_view.Live` takes them.

    Returns
    -------
    Live
        The server, which runs.

    Raises
    ------
    ValueError
        For what is no controller, a plant of other sizes, and an address of another machine.

    Examples
    --------
    >>> controller = mjslq.MPC(mjslq.problems.get("cart_pole"))
    >>> mjslq.live(controller)  # doctest: +SKIP
    """
    from mjslq.viewer.live_view import Live
    from mjslq.viewer.serving import present

    return present(Live(mpc, plant, host=host, port=port, **options), block)


def export_html(result: Result, path: str | os.PathLike[str], dark: bool = False) -> None:
    """Write `result` to one HTML file that plays in any browser, from disk and without a network.

    Parameters
    ----------
    result : Result
        Of `mjslq.solve` or `mjslq.load`; needs no solver.
    path : str or path
        The file to write, whole or not at all.
    dark : bool
        Whether the page is dark.

    Raises
    ------
    ValueError
        When the file cannot be written, or the result's scene cannot be read.

    Examples
    --------
    >>> import os, tempfile
    >>> result = mjslq.solve(mjslq.problems.get("drag_particle"))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     mjslq.export_html(result, os.path.join(folder, "drag.html"))
    ...     os.listdir(folder)
    ['drag.html']
    """
    from mjslq.viewer.export import export_html as write

    write(result, path, dark)


def __getattr__(name: str) -> Any:
    if name == "Player":
        from mjslq.viewer.player import Player

        return Player
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
