"""Ctrl-C during a solve: the first one stops it, further ones wait until the best iterate is safe.

The first Ctrl-C raises KeyboardInterrupt wherever Python stands. Those that follow, and any while the result is put
together, are only counted. Should whatever runs swallow the first one, the loop sees at its next turn that it is to
stop.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any


class Interrupts:
    """A context in which Ctrl-C is raised once.

    Does nothing outside the main thread, or where the program has a handler of its own.
    """

    def __init__(self) -> None:
        self.count = 0
        """How often Ctrl-C was pressed."""
        self._held = False
        self._before: Any = None

    def __enter__(self) -> Interrupts:
        """Take over from Python's own handler."""
        main = threading.current_thread() is threading.main_thread()
        if main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            self._before = signal.signal(signal.SIGINT, self._on_interrupt)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Give back."""
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def hold(self) -> None:
        """From now on only count: a result is being put together."""
        self._held = True

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        if self.count == 1 and not self._held:
            raise KeyboardInterrupt
