"""Addresses that a server of this machine can listen at, checked without opening one."""

from __future__ import annotations

import socket

from mjslq.validation import count, instance

LAST_PORT = 65535
"""Largest number of a port."""


def check_port(port: int) -> int:
    """Return `port` if it is the number of a port; ValueError otherwise."""
    if count("port", port) > LAST_PORT:
        raise ValueError(f"port must be at most {LAST_PORT}, got {port}")
    return port


def check_host(host: str) -> str:
    """Return `host` if it is an address of this machine; ValueError otherwise."""
    instance("host", host, str, "a name or an address of this machine")
    try:
        family, kind, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as trial:
            trial.bind(address)
    except (OSError, UnicodeError) as error:  # names that are too long or empty in part are no text of the protocol
        raise ValueError(f"the viewer cannot listen at {host!r}: {getattr(error, 'strerror', None) or error}") from None
    return host
