"""A folder for numba's compiled code, where numba can write to neither of its usual ones.

numba keeps what it compiles beside the source, or in the user's folder for caches, and refuses to compile where it
can write to neither: in a container without a home, say, from an installation that is read-only. It gets a folder for
this process then, which is removed at its end.
"""

from __future__ import annotations

import os
import sys

FOLDER = "NUMBA_CACHE_DIR"
"""numba's own environment variable for this folder."""


def provide() -> None:
    """Give numba a folder, unless it has one. For processes started by this one, too."""
    package = os.path.dirname(os.path.abspath(__file__))
    if os.environ.get(FOLDER) or os.access(package, os.W_OK) or _is_writable(_users_folder()):
        return
    import atexit
    import shutil
    import tempfile

    try:
        folder = tempfile.mkdtemp(prefix="mjslq-numba-")
    except OSError:  # there is no place at all; numba says so when it compiles
        return
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[FOLDER] = folder
    if "numba" in sys.modules:  # which has read the environment already
        sys.modules["numba"].config.CACHE_DIR = folder


def _users_folder() -> str:
    """Where numba keeps code of files beside which it cannot write."""
    if sys.platform == "win32":
        return os.path.join(os.environ.get("LOCALAPPDATA") or os.path.expanduser("~"), "numba")
    if sys.platform == "darwin":
        return os.path.expanduser("~/Library/Caches/numba")
    return os.path.join(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "numba")


def _is_writable(folder: str) -> bool:
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
