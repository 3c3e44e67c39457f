"""The linear algebra of the sweeps: arrays in and arrays out, compiled; no models, no problems.

`square_root` is public, and imported when first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mjslq.lq import square_root as square_root

__all__ = ["square_root"]


def __getattr__(name: str) -> Any:
    if name != "square_root":
        raise AttributeError(f"module 'mjslq.lq' has no attribute {name!r}; there is: square_root")
    return importlib.import_module("mjslq.lq.square_root")
