"""What all that is served to a browser has in common: a Viser server, its address, and how it starts and ends."""

from __future__ import annotations

import sys
import threading
from abc import ABC, abstractmethod
from typing import Self, TypeVar

import viser

from mjslq.addresses import check_host, check_port
from mjslq.viewer.scene import quiet


class Served(ABC):
    """Something in a browser; a context manager, or `start` and `stop`."""

    kind = "viewer"
    """What messages call it."""

    def __init__(self, host: str, port: int) -> None:
        """Serve at `host`:`port`, or at the next free port, from `start` on."""
        self._host, self._wanted_port = host, check_port(port)
        self._lock, self._ended = threading.RLock(), threading.Event()
        self._server: viser.ViserServer | None = None

    @abstractmethod
    def start(self) -> None:
        """Open the server; does nothing when running."""

    @abstractmethod
    def stop(self) -> None:
        """Close the server; does nothing when not running."""

    def __enter__(self) -> Self:
        """Start."""
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.stop()

    @property
    def server(self) -> viser.ViserServer:
        """The Viser server; RuntimeError before `start` and after `stop`."""
        if self._server is None:
            raise RuntimeError(f"the {self.kind} is not running; start it first")
        return self._server

    @property
    def url(self) -> str:
        """Where to point the browser: the port is not the one asked for when that was taken."""
        return f"http://{'127.0.0.1' if self._host == '0.0.0.0' else self._host}:{self.server.get_port()}"

    def wait(self) -> None:
        """Return when `stop` has been called; Ctrl-C gets through."""
        while not self._ended.wait(0.5):
            pass

    def _open(self) -> viser.ViserServer:
        """Open the server. Raises ValueError for an address of another machine."""
        self._ended.clear()
        check_host(self._host)  # at that of another machine Viser would wait for ever
        with quiet():
            self._server = viser.ViserServer(self._host, self._wanted_port, label="mjslq", verbose=False)
        return self._server


Shown = TypeVar("Shown", bound=Served)


def present(shown: Shown, block: bool) -> Shown:
    """Start something, say where it is, and stay until Ctrl-C if `block`."""
    shown.start()
    try:
        print(f"{shown.kind} at {shown.url}" + (" (Ctrl-C ends it)" if block else ""), flush=True)
    except KeyboardInterrupt:
        shown.stop()
        return shown
    if block:
        stay(shown)
    return shown


def stay(shown: Served, told: str = "") -> None:
    """Stay until Ctrl-C, which closes what is shown; `told` goes to standard error before."""
    try:
        if told:
            print(told, file=sys.stderr, flush=True)
        shown.wait()
    except KeyboardInterrupt:
        shown.stop()
