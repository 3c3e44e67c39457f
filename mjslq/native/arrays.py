"""Kernels whose arguments are numpy arrays and numbers.

    @array_kernel("lq-adjoint", "void(f8[3], f8[3], f8[2], f8[2], f8[2], f8[2])")
    def adjoint(A, B, q, r, costates, gradient): ...

In the signature f8 is a number, i8 an integer (i1 of one byte), b1 a truth value, and f8[3] a C-contiguous array of
numbers with three axes. The C function behind it is given the address and the sizes of each array.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mjslq.native.declare import Helper
from mjslq.native.kernel import Kernel
from mjslq.native.memory import carray, pointer

_NUMBA = {"f8": "float64", "i8": "int64", "i1": "int8", "b1": "boolean", "void": "void"}
_C: dict[str, Any] = {"float64": ctypes.c_double, "int64": ctypes.c_int64, "boolean": ctypes.c_bool, "void": None}
_DTYPES = {"f8": np.float64, "i8": np.int64, "i1": np.int8, "b1": np.bool_}


class _Kind(NamedTuple):
    """What an argument is."""

    code: str
    ndim: int

    @property
    def typestr(self) -> str:
        """As numpy's interface of arrays calls it."""
        return np.dtype(_DTYPES[self.code]).str

    @property
    def words(self) -> list[str]:
        """Types of what the C function is given for it."""
        return ["int64"] * (1 + self.ndim) if self.ndim else [_NUMBA[self.code]]


def _kind(text: str) -> _Kind:
    code, _, axes = text.strip().rstrip("]").partition("[")
    return _Kind(code, int(axes or 0))


class ArrayKernel(Helper):
    """A kernel that Python calls with arrays; compiled functions may call it, too.

    Arrays that are not C-contiguous, or of another type, are copied, and what was written is copied back.
    """

    def __init__(self, name: str, function: Callable[..., Any], signature: str, options: dict[str, Any]):
        super().__init__(function, options)
        result, _, arguments = signature.rstrip(")").partition("(")
        self._kinds = [_kind(text) for text in arguments.split(",")]
        self._expected = [(kind.ndim, kind.typestr) for kind in self._kinds]
        self._words = [word for kind in self._kinds for word in kind.words]
        self._result = _NUMBA[result]
        signature = f"{self._result}({', '.join(self._words)})"
        self.kernel = Kernel(name, self._entry(), signature, function.__module__)

    def _entry(self) -> Callable[..., Any]:
        """The C function, in Python: makes arrays of addresses and sizes, and calls."""
        given, made = [], []
        for i, kind in enumerate(self._kinds):
            sizes = [f"n{i}_{axis}" for axis in range(kind.ndim)]
            given += [f"a{i}", *sizes]
            made.append(f"carray(pointer(a{i}), ({', '.join(sizes)},), {kind.code})" if kind.ndim else f"a{i}")
        text = f"def entry({', '.join(given)}):\n    return function({', '.join(made)})\n"
        scope: dict[str, Any] = {"function": self, "carray": carray, "pointer": pointer, **_DTYPES}
        exec(text, scope)
        entry: Callable[..., Any] = scope["entry"]
        return entry

    @cached_property
    def _call(self) -> Any:
        kinds = [_C[word] for word in self._words]
        return ctypes.CFUNCTYPE(_C[self._result], *kinds)(self.kernel.address)

    def __call__(self, *arguments: Any) -> Any:
        """Run on arrays and numbers."""
        given: list[Any] = []
        for (ndim, typestr), value in zip(self._expected, arguments, strict=True):
            if not ndim:
                given.append(value)
                continue
            face = value.__array_interface__
            shape = face["shape"]
            if face["strides"] is not None or face["typestr"] != typestr or len(shape) != ndim:
                return self._with_copies(arguments)
            given.append(face["data"][0])
            given += shape
        return self._call(*given)

    def _with_copies(self, arguments: tuple[Any, ...]) -> Any:
        copies = list(arguments)
        for i, (kind, value) in enumerate(zip(self._kinds, arguments, strict=True)):
            if kind.ndim:
                if value.ndim != kind.ndim:
                    raise ValueError(f"argument {i} of {self.__name__} must have {kind.ndim} axes, got {value.ndim}")
                copies[i] = np.ascontiguousarray(value, _DTYPES[kind.code])
        result = self(*copies)
        for value, made in zip(arguments, copies, strict=True):
            if made is not value and value.flags.writeable:
                value[...] = made
        return result


def array_kernel(name: str, signature: str, **options: Any) -> Callable[[Callable[..., Any]], ArrayKernel]:
    """Decorate a kernel of arrays; `name` is its own among all kernels, options are numba's."""
    return lambda function: ArrayKernel(name, function, signature, options)
