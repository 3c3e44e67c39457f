"""Opening a Viser server, and where it is."""

from __future__ import annotations

import socket

import viser

from mjslq.viewer.scene import quiet


def open_server(host: str, port: int) -> viser.ViserServer:
    """A server at `host`:`port`, or at the next free port. Raises ValueError for an address of another machine."""
    _refuse_foreign_host(host)
    with quiet():
        return viser.ViserServer(host, port, label="mjslq", verbose=False)


def address(host: str, server: viser.ViserServer) -> str:
    """Where to point the browser: the port is not the one asked for when that was taken."""
    return f"http://{'127.0.0.1' if host == '0.0.0.0' else host}:{server.get_port()}"


def _refuse_foreign_host(host: str) -> None:
    """Refuse an address that is none of this machine's, at which Viser would wait for ever."""
    try:
        family, kind, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as trial:
            trial.bind(address)
    except OSError as error:
        raise ValueError(f"the viewer cannot listen at {host!r}: {error.strerror or error}") from None
