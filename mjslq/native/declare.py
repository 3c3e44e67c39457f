"""Declarations of compiled code that do not import numba: functions, MuJoCo's functions, kernels.

numba asks whatever a compiled function refers to for its `_numba_type_`. The objects here answer that question only
when numba asks it, so that a module full of compiled functions is imported in no time, and runs, where its kernels
have been made already (`mjslq.native.kernel`), without numba.

helper(...)         a compiled function that other compiled functions call; called from Python, numba compiles it
external(...)       a C function, by its name
intrinsic(...)      one or a few machine instructions
stand_in(...)       an object of numba's own
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cached_property
from typing import Any

from mjslq.compiling import listen_to_numba
from mjslq.native import symbols

OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}
"""What all functions here are compiled with: divisions by zero give inf or nan and raise nothing."""
_emitting = threading.local()


class Declared:
    """An object that numba takes for the one that `make` returns."""

    def __init__(self, make: Callable[[], Any]):
        self._make = make

    @cached_property
    def made(self) -> Any:
        """The object itself."""
        return self._make()

    @property
    def _numba_type_(self) -> Any:
        return numba_type(self.made)

    def __call__(self, *arguments: Any) -> Any:
        """For compiled functions only."""
        raise TypeError(f"{self.made!r} is there for compiled functions only")


class Helper:
    """A compiled function that compiled functions call."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]):
        self.function, self._options = function, OPTIONS | options
        self.__name__, self.__doc__, self.__module__ = function.__name__, function.__doc__, function.__module__
        self.__wrapped__ = function

    @cached_property
    def dispatcher(self) -> Any:
        """The function as numba compiles it for calls from Python."""
        import numba

        listen_to_numba()
        return numba.njit(**self._options)(self.function)

    @cached_property
    def emitted(self) -> Any:
        """The same, of which only LLVM's code is made (`mjslq.native.emit`)."""
        from mjslq.native.emit import emitter

        return emitter(self.function, {name: value for name, value in self._options.items() if name != "cache"})

    @property
    def _numba_type_(self) -> Any:
        from numba import types

        return types.Dispatcher(self.emitted if getattr(_emitting, "now", False) else self.dispatcher)

    def __call__(self, *arguments: Any) -> Any:
        """Compile for these arguments, and call."""
        return self.dispatcher(*arguments)


class emission:  # noqa: N801 -- a context, as those of the standard library
    """A context within which helpers are compiled to LLVM's code alone."""

    def __enter__(self) -> None:
        """Begin."""
        _emitting.now = True

    def __exit__(self, *of_error: object) -> None:
        """End."""
        _emitting.now = False


def helper(**options: Any) -> Callable[[Callable[..., Any]], Helper]:
    """Decorate a function that compiled functions call; options are numba's."""
    return lambda function: Helper(function, options)


def external(name: str, signature: str) -> Any:
    """Declare the C function `name`, its signature in numba's words: "void(intp, float64)"."""

    def make() -> Any:
        from numba import types
        from numba.core import sigutils

        symbols.find([name])  # for functions that numba compiles to be called from Python
        arguments, result = sigutils.normalize_signature(signature)
        return types.ExternalFunction(name, result(*arguments))

    return Declared(make)


def intrinsic(make: Callable[[Any, Any, Any, Any], Any], signature: str) -> Any:
    """Declare an operation on numbers: `make(context, builder, signature, arguments)` writes LLVM's."""

    def declare() -> Any:
        from numba.core import sigutils
        from numba.extending import intrinsic as declare_intrinsic

        arguments, result = sigutils.normalize_signature(signature)
        names = ", ".join(f"_{i}" for i in range(len(arguments)))
        scope: dict[str, Any] = {"answer": (result(*arguments), make)}
        exec(f"def operation(context, {names}):\n    return answer", scope)
        return declare_intrinsic(scope["operation"])

    return Declared(declare)


def stand_in(make: Callable[[], Any]) -> Any:
    """Declare an object of numba's, which `make` imports."""
    return Declared(make)


def numba_type(value: Any) -> Any:
    """What numba takes a value for."""
    from numba.core.registry import cpu_target

    cpu_target.typing_context.refresh()  # it may have been declared just now
    cpu_target.target_context.refresh()
    return cpu_target.typing_context.resolve_value_type(value)
