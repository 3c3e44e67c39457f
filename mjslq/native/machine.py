"""From LLVM bitcode to machine code of this computer, and from machine code to functions, by llvmlite alone.

Machine code is kept in a folder of the user's, under a name that tells what it was made of and for which processor.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import sys
import threading
import time
import zlib
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from mjslq.native import symbols

FOLDER = "MJSLQ_CACHE_DIR"
"""Environment variable that names another folder for machine code."""
KEPT = 90 * 86400.0
"""How long machine code is kept. [s]"""
_lock = threading.RLock()


@functools.cache
def _target() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_triple(llvm.get_process_triple())


@functools.cache
def _machine() -> Any:
    return _target().create_target_machine(**_host(), opt=3, reloc="static", codemodel="jitdefault", jit=True)


@functools.cache
def _host() -> dict[str, str]:
    return {"cpu": llvm.get_host_cpu_name(), "features": llvm.get_host_cpu_features().flatten()}


@functools.cache
def _engine() -> Any:
    empty = llvm.parse_assembly("")
    return llvm.create_mcjit_compiler(empty, _machine())


def translate(bitcode: bytes) -> bytes:
    """Machine code, as an object file, of LLVM bitcode."""
    _target()
    return _emitted(llvm.parse_bitcode(bitcode))


def translate_text(text: str) -> bytes:
    """The same of LLVM's language."""
    _target()
    return _emitted(llvm.parse_assembly(text))


def _emitted(module: Any) -> bytes:
    module.triple = llvm.get_process_triple()
    module.verify()
    code: bytes = _machine().emit_object(module)
    return code


def link(code: bytes, names: tuple[str, ...], entry: str) -> int:
    """Address of the function `entry` in machine code, which calls functions of the given names.

    Raises ImportError when one of them is not to be had: LLVM would end the process.
    """
    with _lock:
        _target()
        engine = _engine()  # which makes the functions of the process known
        missing = symbols.find(names)
        if missing:
            raise ImportError(f"the kernel {entry} calls functions that no library has: {', '.join(missing)}")
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        address: int = engine.get_function_address(entry)
    return address


def key(made_of: str) -> str:
    """Name for machine code of this computer, made of what `made_of` tells."""
    host = (made_of, llvmlite.__version__, llvm.get_process_triple(), *_host().values())
    return hashlib.sha256("\0".join(host).encode()).hexdigest()[:32]


def folder() -> Path:
    """Where machine code is kept."""
    if os.environ.get(FOLDER):
        return Path(os.environ[FOLDER])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", "~")).expanduser() / "mjslq" / "cache"
    if sys.platform == "darwin":
        return Path("~/Library/Caches/mjslq").expanduser()
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "mjslq"


def _forget(place: Path) -> None:
    """Delete machine code that was kept long ago: it may be of other versions, and is made again in no time."""
    for path in place.glob("*.o"):
        if path.stat().st_mtime < time.time() - KEPT:
            path.unlink()


def recall(name: str) -> tuple[bytes, tuple[str, ...]] | None:
    """Machine code kept under a name, and the functions it calls; None where there is none, or it is damaged."""
    try:
        head, _, code = (folder() / f"{name}.o").read_bytes().partition(b"\n")
        told = json.loads(head)
        if told["checksum"] == zlib.crc32(code):
            return code, tuple(told["symbols"])
    except (OSError, ValueError, KeyError, TypeError, RuntimeError):
        pass
    return None


def keep(name: str, code: bytes, names: tuple[str, ...]) -> None:
    """Keep machine code, whole or not at all; where no folder can be written to, it is made anew next time."""
    import tempfile

    head = json.dumps({"checksum": zlib.crc32(code), "symbols": names}).encode()
    try:
        place = folder()
        place.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=place, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(head + b"\n" + code)
            os.replace(part, place / f"{name}.o")
            _forget(place)
        except BaseException:
            os.unlink(part)
            raise
    except (OSError, RuntimeError):
        pass
