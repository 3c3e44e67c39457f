"""Files that are written whole or not at all, and arrays that are read without pickle."""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from mjslq.validation import Array, gist, path_of

_NAME = 60
"""Characters of a file's name that its temporary one begins with."""
_REASON = 150
"""Characters of a reason that a reader gives; some quote the file."""


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path`; rename it to `path` once its writer has finished without error.

    Raises ValueError when the folder does not exist or cannot be written to, and when the disk is full.
    """
    target = writable(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name[:_NAME]}.", dir=target.parent)
    except OSError as error:
        raise ValueError(f"cannot write {target}: {error.strerror or error}") from None
    try:
        with os.fdopen(handle, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)  # mkstemp makes private files; a result should be as any other file
        os.replace(name, target)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError):  # such as a full disk
            raise ValueError(f"cannot write {target}: {error.strerror or error}") from None
        raise


def writable(path: str | os.PathLike[str]) -> Path:
    """Return the path of a file that may be written, as far as can be told beforehand. Raises ValueError."""
    target = path_of("path", path)
    try:
        if target.is_dir():
            raise ValueError(f"cannot write {target}: it is a folder")
        if not target.parent.is_dir():
            raise ValueError(f"cannot write {target}: there is no folder {target.parent}")
        if target.exists() and not os.access(target, os.W_OK):
            raise ValueError(f"cannot write {target}: the file is read-only")
    except OSError as error:  # such as a name that is too long
        raise ValueError(f"cannot write {target}: {error.strerror or error}") from None
    return target


def read_arrays(path: str | os.PathLike[str], what: str) -> dict[str, Array]:
    """Read all arrays of an .npz file, without pickle; `what` is what it should be: "a result saved by mjslq".

    Raises FileNotFoundError, and ValueError for whatever is no such file, or not a whole one.
    """
    name = path_of("path", path)
    if name.is_dir():
        raise ValueError(f"{name} is a folder, not {what}")
    try:
        with open(name, "rb") as stream, np.load(stream, allow_pickle=False) as data:
            return {entry: np.asarray(data[entry]) for entry in data.files}
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no file {name}") from None
    except OSError as error:
        raise ValueError(f"cannot read {name}: {error.strerror or error}") from None
    except Exception as error:  # whatever foreign and damaged files make the readers of zip and npy raise
        why = gist(error)[:_REASON] if zipfile.is_zipfile(name) else "it is no .npz file"
        raise ValueError(f"{name} is not {what} ({why})") from None
