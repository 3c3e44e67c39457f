"""What a kernel's code depends on: its module, all that this imports from mjslq, and MuJoCo's numbers.

Compiled code holds copies of everything that it refers to: functions, constants of other modules, layouts of records,
and numbers of MuJoCo's. Where any of these files has changed, or another MuJoCo is installed, it is stale.
"""

from __future__ import annotations

import functools
import hashlib
import re
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the package."""
_OWN = ("mjslq.native.declare", "mjslq.native.emit", "mjslq.native.memory")
"""Modules whose text decides what is made of any kernel."""
_IMPORT = re.compile(r"^(?:from\s+(mjslq[\w.]*)\s+import\s+(\([^)]*\)|[^\n]*)|import\s+(mjslq[\w.]*))", re.MULTILINE)
"""Imports that are not indented: those for types only, and those inside of functions, do not count."""
_MUJOCO = re.compile(r"^(?:import|from)\s+mujoco\b", re.MULTILINE)

_START = time.time()


@functools.cache
def checksum(module: str) -> str | None:
    """Checksum of all that the kernels in `module` depend on; None where that cannot be known.

    That is so for modules that are not of mjslq, and where a file was changed after this process began, which may have
    imported it before.
    """
    total: Any = hashlib.sha256()
    texts: dict[str, str] = {}
    waiting = [*_OWN, module]
    while waiting:
        name = waiting.pop()
        if name not in texts:
            path = _path(name)
            if path is None or path.stat().st_mtime > _START:
                return None
            texts[name], imported = _read(path)
            waiting += imported
    for name in sorted(texts):
        total.update(name.encode() + b"\0" + texts[name].encode() + b"\0")
    if any(_MUJOCO.search(text) for text in texts.values()):
        import mujoco

        total.update(mujoco.mj_versionString().encode())
    return total.hexdigest()


@functools.cache
def _read(path: Path) -> tuple[str, tuple[str, ...]]:
    """Text of a module, with the same ends of lines on all systems, and what it imports."""
    text = path.read_text(encoding="utf-8")
    return text, tuple(_imported(text))


def _imported(text: str) -> list[str]:
    """Modules of mjslq that a module imports at its head."""
    found = []
    for match in _IMPORT.finditer(text):
        home, names, whole = match.groups()
        if whole:
            found.append(whole)
            continue
        parts = re.findall(r"[\w]+", re.sub(r"#[^\n]*|\bas\s+\w+", "", names))
        modules = [f"{home}.{part}" for part in parts if _path(f"{home}.{part}") is not None]
        found += modules
        if len(modules) < len(parts):
            found.append(home)
    return found


@functools.cache
def _path(module: str) -> Path | None:
    """File of a module, None where there is no such module."""
    if module.partition(".")[0] != "mjslq":
        return None
    place = ROOT.joinpath(*module.split(".")[1:])
    for path in (place.with_name(place.name + ".py"), place / "__init__.py"):
        if path.is_file():
            return path
    return None
