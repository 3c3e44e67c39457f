"""Arrays at addresses, for compiled code."""

from __future__ import annotations

from typing import Any

from mjslq.native.declare import intrinsic, stand_in


def _to_pointer(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    from numba.core import cgutils

    return builder.inttoptr(arguments[0], cgutils.voidptr_t)


def _carray() -> Any:
    import numba

    return numba.carray


pointer = intrinsic(_to_pointer, "voidptr(int64)")
"""pointer(address): a pointer of an address held in an integer."""
carray = stand_in(_carray)
"""carray(pointer, shape, dtype): numba.carray, an array at a pointer."""
