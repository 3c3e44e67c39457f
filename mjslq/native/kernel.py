"""Kernels: compiled loops that Python calls, as C functions.

What a kernel is made of is looked for in this order:

    1. machine code kept on this computer, of the same sources and for the same processor  (`machine`)
    2. LLVM bitcode that came with mjslq, of the same sources                              (`bitcode`)
    3. the Python function, which numba compiles                                           (`emit`)

so that numba is imported only where the sources were changed, or no bitcode fits. The three give the same results bit
for bit.
"""

from __future__ import annotations

import importlib
import re
import threading
from collections.abc import Callable
from typing import Any

from mjslq.compiling import compilation
from mjslq.native import bitcode, sources

_lock = threading.RLock()
KERNELS: dict[str, Kernel] = {}
"""All kernels declared so far, by name."""


class Kernel:
    """A C function made of a Python function that neither allocates nor raises."""

    def __init__(self, name: str, function: Callable[..., Any] | None, signature: str, module: str):
        self.name, self._function, self.signature, self.module = name, function, signature, module
        self._address: int | None = None
        KERNELS[name] = self

    def made(self) -> Callable[..., Any]:
        """The Python function."""
        assert self._function is not None
        return self._function

    @property
    def function(self) -> Callable[..., Any]:
        """The Python function that it is made of."""
        return self.made()

    @property
    def entry(self) -> str:
        """Name of the C function."""
        return "mjslq_" + re.sub(r"\W", "_", self.name)

    @property
    def address(self) -> int:
        """Address of the C function, which is made when this is first asked for."""
        if self._address is None:
            with _lock:
                if self._address is None:  # no other thread has made it meanwhile
                    self._address = self._make()
        return self._address

    def _make(self) -> int:
        from mjslq.native import machine

        checksum, stored = sources.checksum(self.module), bitcode.read(self.name)
        if checksum is None:  # what was imported may not be what the files say
            with compilation():
                return machine.link(*self._compiled(None), self.entry)
        if stored is not None and stored.checksum != checksum:
            stored = None
        name = f"{self.name}-{machine.key(self.name + checksum + ('' if stored is None else 'stored'))}"
        kept = machine.recall(name)
        if kept is None:
            with compilation():
                kept = self._compiled(stored)
            machine.keep(name, *kept)
        return machine.link(*kept, self.entry)

    def _compiled(self, stored: bitcode.Stored | None) -> tuple[bytes, tuple[str, ...]]:
        """Machine code of what came with mjslq; where this is nothing, or not for this LLVM, of the function."""
        from mjslq.native import machine

        if stored is not None:
            try:
                return machine.translate(stored.bitcode()), stored.symbols
            except (RuntimeError, ValueError, EOFError, OSError):  # LLVM is too old for it, or the file is damaged
                pass
        from mjslq.native.emit import emit

        code = emit(self.function, self.signature, self.entry)
        return machine.translate(code.bitcode), code.symbols


class _Deferred(Kernel):
    """A kernel whose function is made when it is to be compiled, which imports the modules that it is of."""

    def __init__(self, name: str, signature: str, module: str, maker: str, arguments: tuple[Any, ...]):
        self._maker, self._arguments = maker, arguments
        super().__init__(name, None, signature, module)

    def made(self) -> Callable[..., Any]:
        """The function."""
        maker: Callable[..., Callable[..., Any]] = getattr(importlib.import_module(self.module), self._maker)
        return maker(*self._arguments)


def deferred(name: str, signature: str, module: str, maker: str, arguments: tuple[Any, ...]) -> Kernel:
    """Declare a kernel of the function that `maker(*arguments)` of `module` makes."""
    return _Deferred(name, signature, module, maker, arguments)


def c_function(name: str, signature: str) -> Callable[[Callable[..., Any]], Kernel]:
    """Decorate a C function, its signature in numba's words: "void(intp, float64)"; `name` is its own."""
    return lambda function: Kernel(name, function, signature, function.__module__)
