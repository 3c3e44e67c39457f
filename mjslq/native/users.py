"""Functions that users have compiled by numba, told from others without importing numba."""

from __future__ import annotations

import sys
from typing import Any


def is_compiled(f: Any) -> bool:
    """Whether `f` was made by numba.njit; then numba has been imported by whoever made it."""
    numba = sys.modules.get("numba.core.dispatcher")
    return numba is not None and isinstance(f, numba.Dispatcher)
