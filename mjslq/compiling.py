"""Compilation of kernels, which takes some seconds the first time and none after: a word on the screen, and a clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

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


class CompileClock:
    """A context that counts the seconds in which numba compiles; compilations within others count once."""

    def __init__(self) -> None:
        self._total, self._depth, self._began = 0.0, 0, 0.0
        self._listener: Any = None

    @property
    def seconds(self) -> float:
        """Wall time spent on compiling so far. [s]"""
        return self._total + (time.perf_counter() - self._began if self._depth else 0.0)

    def __enter__(self) -> CompileClock:
        """Begin to listen."""
        from numba.core import event

        clock = self

        class Listener(event.Listener):
            def on_start(self, event: event.Event) -> None:
                if clock._depth == 0:
                    clock._began = time.perf_counter()
                clock._depth += 1

            def on_end(self, event: event.Event) -> None:
                clock._depth -= 1
                if clock._depth == 0:
                    clock._total += time.perf_counter() - clock._began

        self._listener = Listener()
        event.register("numba:compile", self._listener)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Stop listening."""
        from numba.core import event

        event.unregister("numba:compile", self._listener)
