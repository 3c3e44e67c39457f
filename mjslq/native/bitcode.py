"""Kernels as LLVM bitcode: files that come with mjslq, one a kernel, and whether they fit.

A file holds a line of JSON, and behind it the bitcode, compressed. The line tells the checksum of the sources that the
kernel was made of (`sources`) and the names of the functions that it calls. `build` makes the files.
"""

from __future__ import annotations

import json
import platform
import sys
from pathlib import Path
from typing import NamedTuple

PLATFORM = f"{platform.machine().lower()}-{sys.platform}"
"""Processor and system that this computer has."""
FOLDER = Path(__file__).parent / "bitcode"
"""Where the files are, in a folder for each platform."""


class Stored(NamedTuple):
    """A kernel that came with mjslq."""

    checksum: str
    """That of the sources."""
    symbols: tuple[str, ...]
    """Functions that it calls."""
    compressed: bytes

    def bitcode(self) -> bytes:
        """LLVM's code."""
        import lzma

        return lzma.decompress(self.compressed)


def path(name: str) -> Path:
    """File of a kernel for this platform."""
    return FOLDER / PLATFORM / f"{name}.bc.xz"


def read(name: str) -> Stored | None:
    """The kernel `name` for this platform, None where there is no such file, or it cannot be read."""
    try:
        head, _, compressed = path(name).read_bytes().partition(b"\n")
        told = json.loads(head)
        return Stored(str(told["checksum"]), tuple(told["symbols"]), compressed)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write(name: str, checksum: str, bitcode: bytes, symbols: tuple[str, ...]) -> Path:
    """Write the file of a kernel for this platform, and return its path."""
    import lzma

    file = path(name)
    file.parent.mkdir(parents=True, exist_ok=True)
    head = json.dumps({"checksum": checksum, "symbols": symbols})
    file.write_bytes(head.encode() + b"\n" + lzma.compress(bitcode, preset=9))
    return file
