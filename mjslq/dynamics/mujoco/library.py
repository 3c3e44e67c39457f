"""MuJoCo's shared library as seen from compiled code: where it lies, how to keep it quiet, how to survive it.

Compiled kernels call libmujoco without Python in between. Two things that Python's bindings do are then up to us.

Errors.  An error inside MuJoCo (a stack overflow, say) ends the process unless somebody catches it. MuJoCo's
         batch interface does: `mjb_apply` runs a function on its threads, traps what is raised there, and says
         which runs failed. `Workers` keeps a batch of a model with nothing in it for this purpose alone, as a
         thread pool with a safety net; the kernels bring models and data of their own.
Warnings. MuJoCo prints warnings and writes MUJOCO_LOG.TXT into the working directory. A rollout that blows up
         is everyday business for an optimizer, and is reported by other means, so `quiet` turns both off for the
         time of a call and puts the user's settings back.
"""

from __future__ import annotations

import ctypes
import functools
import sys
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

_LIBRARY_NAMES = {"linux": "libmujoco.so*", "darwin": "libmujoco*.dylib", "win32": "mujoco.dll"}


class _LogConfig(ctypes.Structure):
    """MuJoCo's mjLogConfig."""

    _fields_ = (
        ("to_console", ctypes.c_bool),
        ("to_file", ctypes.c_bool),
        ("file", ctypes.c_char * 1024),
        ("topics", ctypes.c_int),
    )


class _BatchConfig(ctypes.Structure):
    """MuJoCo's mjBatchConfig."""

    _fields_ = (("nthread", ctypes.c_int), ("persistent", ctypes.c_bool))


def library_path() -> str:
    """Path of the libmujoco that the Python package has loaded; raises ImportError when it is not found."""
    pattern = _LIBRARY_NAMES.get(sys.platform, "libmujoco*")
    found = sorted(path for folder in mujoco.__path__ for path in Path(folder).glob(pattern))
    if not found:
        raise ImportError(f"no {pattern} lies beside the mujoco package; reinstall mujoco to mend it")
    return str(found[0])


@functools.cache
def library() -> ctypes.CDLL:
    """libmujoco, with the signatures of the functions used here."""
    lib = ctypes.CDLL(library_path())
    lib.mju_getLogConfig.restype = _LogConfig
    lib.mju_getLogConfig.argtypes = []
    lib.mju_setLogConfig.restype = None
    lib.mju_setLogConfig.argtypes = [_LogConfig]
    lib.mjb_makeBatch.restype = ctypes.c_void_p
    lib.mjb_makeBatch.argtypes = [
        ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(_BatchConfig), ctypes.c_char_p, ctypes.c_int
    ]  # fmt: skip
    lib.mjb_deleteBatch.restype = None
    lib.mjb_deleteBatch.argtypes = [ctypes.c_void_p]
    lib.mjb_apply.restype = ctypes.c_int
    lib.mjb_apply.argtypes = [
        ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int
    ]  # fmt: skip
    lib.mjb_error.restype = ctypes.c_char_p
    lib.mjb_error.argtypes = [ctypes.c_void_p, ctypes.c_int]
    return lib


def collision_functions() -> int:
    """Address of the table of functions (mjfCollision) that tell how two geoms touch, a row for each type of geom."""
    return ctypes.addressof(ctypes.c_void_p.in_dll(library(), "mjCOLLISIONFUNC"))


_quiet_lock = threading.Lock()
_quiet_depth = 0
_loud_config: _LogConfig | None = None


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's warnings off the console and out of MUJOCO_LOG.TXT; may be nested and used by several threads."""
    global _quiet_depth, _loud_config
    lib = library()
    with _quiet_lock:
        if _quiet_depth == 0:
            _loud_config = lib.mju_getLogConfig()
            silent = lib.mju_getLogConfig()
            silent.to_console = silent.to_file = False
            lib.mju_setLogConfig(silent)
        _quiet_depth += 1
    try:
        yield
    finally:
        with _quiet_lock:
            _quiet_depth -= 1
            if _quiet_depth == 0:
                lib.mju_setLogConfig(_loud_config)


class Workers:
    """Threads that run a compiled kernel, one job each, and survive MuJoCo's errors."""

    def __init__(self, count: int):
        """Make `count` workers; the calling thread is one of them. Raises RuntimeError when MuJoCo cannot."""
        self.count = count
        empty = mujoco.MjModel.from_xml_string("<mujoco/>")
        reason = ctypes.create_string_buffer(1000)
        self._batch = library().mjb_makeBatch(
            empty._address, count, ctypes.byref(_BatchConfig(count, False)), reason, len(reason)
        )
        if not self._batch:
            raise RuntimeError(f"MuJoCo cannot start {count} threads: {reason.value.decode(errors='replace')}")
        weakref.finalize(self, library().mjb_deleteBatch, self._batch)

    def run(self, kernel: int, jobs: np.ndarray[Any, Any]) -> None:
        """Run the kernel at address `kernel` on each of `jobs` (at most `count`), a structured array.

        Raises RuntimeError with MuJoCo's message when it fails in one of them.
        """
        ids = np.arange(len(jobs), dtype=np.intc)
        with quiet():
            failed = library().mjb_apply(self._batch, ids.ctypes.data, len(ids), kernel, jobs.ctypes.data, 0)
        if failed:
            reasons = (library().mjb_error(self._batch, int(i)).decode(errors="replace") for i in ids)
            reason = next((text for text in reasons if text), "no reason given")
            raise RuntimeError(f"MuJoCo stopped with an error: {reason}")


def copied(jobs: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Copy of an array of jobs as plain bytes: numpy's own takes each of the many fields by itself, which is slow."""
    return jobs.view(np.uint8).copy().view(jobs.dtype)
