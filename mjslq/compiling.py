"""Compilation of kernels, which takes some seconds the first time: announced once, and timed.

Kernels are made by `mjslq.native`, which tells of it by `compilation`. What users write is compiled by numba, which has
events of its own; they are listened to as soon as numba is there.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType

_MESSAGE = "compiling kernels (the first time only; they are kept on disk) ..."
_lock = threading.Lock()
_announced = False
_say: Callable[[str], object] | None = None
_clocks: list[CompileClock] = []
_listening = False


def announce_compilation(say: Callable[[str], object]) -> None:
    """Arrange for `say` to be called once, when something is first compiled instead of being found on disk."""
    global _say
    if _say is None:
        _say = say
    listen_to_numba()


@contextmanager
def compilation() -> Iterator[None]:
    """A context within which something is compiled."""
    listen_to_numba()
    _start()
    try:
        yield
    finally:
        _end()


def listen_to_numba() -> None:
    """Have numba tell when it compiles, if it has been imported."""
    global _listening
    with _lock:
        if _listening or "numba.core.event" not in sys.modules or "numba" not in sys.modules:
            return
        _listening = True
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: event.Event) -> None:
            _start()

        def on_end(self, event: event.Event) -> None:
            _end()

    event.register("numba:compile", Listener())


def _start() -> None:
    global _announced
    with _lock:
        first = _say is not None and not _announced
        _announced = _announced or first
        for clock in _clocks:
            clock.start()
    if first and _say is not None:
        _say(_MESSAGE)


def _end() -> None:
    with _lock:
        for clock in _clocks:
            clock.stop()


class CompileClock:
    """A context that counts the seconds in which something is compiled; compilations within others count once."""

    def __init__(self) -> None:
        self._total, self._depth, self._began = 0.0, 0, 0.0

    @property
    def seconds(self) -> float:
        """Wall time spent on compiling so far. [s]"""
        return self._total + (time.perf_counter() - self._began if self._depth else 0.0)

    def start(self) -> None:
        """Something begins to be compiled."""
        if self._depth == 0:
            self._began = time.perf_counter()
        self._depth += 1

    def stop(self) -> None:
        """The same is done; what began before this clock was there does not count."""
        if self._depth:
            self._depth -= 1
            if self._depth == 0:
                self._total += time.perf_counter() - self._began

    def __enter__(self) -> CompileClock:
        """Begin to listen."""
        listen_to_numba()
        with _lock:
            _clocks.append(self)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Stop listening."""
        with _lock:
            _clocks.remove(self)
