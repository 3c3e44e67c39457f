"""A word on the screen while kernels compile, which takes some seconds the first time and none after."""

from __future__ import annotations

import threading
from collections.abc import Callable

_MESSAGE = "compiling kernels (the first time only; they are kept on disk) ..."
_lock = threading.Lock()
_announced = False


def announce_compilation(say: Callable[[str], object]) -> None:
    """Arrange for `say` to be called once, when numba first compiles something instead of finding it on disk."""
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: event.Event) -> None:
            global _announced
            with _lock:
                first, _announced = not _announced, True
            if first:
                say(_MESSAGE)

        def on_end(self, event: event.Event) -> None:
            """Nothing: whoever waits sees what comes next."""

    if not _announced:
        event.register("numba:compile", Listener())
