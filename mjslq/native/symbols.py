"""Where functions that kernels call, but that are not in them, come from.

Functions of the C library are found by themselves. Whoever declares others says how they are found:

    provide("mj", load_libmujoco)     load_libmujoco() makes all functions whose names begin with mj known
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

_providers: dict[str, Callable[[], None]] = {}
_provided: set[str] = set()


def provide(prefix: str, make_known: Callable[[], None]) -> None:
    """Have `make_known` called once, before a kernel is made that calls functions whose names begin with `prefix`.

    It makes them known by `load_library` or `add_symbol` of `llvmlite.binding`.
    """
    _providers[prefix] = make_known


def find(names: Iterable[str]) -> list[str]:
    """Make functions known, and return the names of those that are not to be had."""
    import llvmlite.binding as llvm

    names = list(names)
    for prefix, make_known in _providers.items():
        if prefix not in _provided and any(name.startswith(prefix) for name in names):
            make_known()
            _provided.add(prefix)
    return [name for name in names if not llvm.address_of_symbol(name)]
