"""BLAS's product of matrices for compiled code: that of scipy, which numba uses, too."""

from __future__ import annotations

import ctypes
from typing import Any

from mjslq.native import symbols
from mjslq.native.declare import intrinsic

_NAME = "mjslq_dgemm"


_KIND = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 13)


@_KIND
def _first_call(*arguments: Any) -> None:
    """Find the function, and call it: small problems, which do not need it, do not wait until scipy is imported."""
    from scipy.linalg import cython_blas

    capsule, api = cython_blas.__pyx_capi__["dgemm"], ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    _place.value = api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule))
    _KIND(_place.value)(*arguments)


_place = ctypes.c_void_p(ctypes.cast(_first_call, ctypes.c_void_p).value)
"""Where the address of the function is."""


def _make_known() -> None:
    """Make a function that calls the one whose address is in `_place`."""
    import llvmlite.binding as llvm

    from mjslq.native import machine

    given = ", ".join(f"ptr %{i}" for i in range(13))
    text = f"""
        define void @{_NAME}({given}) {{
            %place = inttoptr i64 {ctypes.addressof(_place)} to ptr
            %function = load atomic ptr, ptr %place monotonic, align 8
            tail call void %function({given})
            ret void
        }}"""
    llvm.add_symbol(_NAME, machine.link(machine.translate_text(text), (), _NAME))


def _call(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    from llvmlite import ir
    from numba.core import cgutils

    symbols.find([_NAME])
    i8, i32, number = ir.IntType(8), ir.IntType(32), ir.DoubleType()

    def place(value: Any) -> Any:
        return cgutils.alloca_once_value(builder, value)

    transposed, m, n, k, left, right, stride, out = arguments
    as_is, turned = ir.Constant(i8, ord("N")), ir.Constant(i8, ord("T"))
    letter = place(builder.select(builder.trunc(transposed, ir.IntType(1)), turned, as_is))
    m, n, k, stride = (place(builder.trunc(size, i32)) for size in (m, n, k, stride))
    left, right, out = (builder.inttoptr(address, number.as_pointer()) for address in (left, right, out))
    one, zero = place(ir.Constant(number, 1.0)), place(ir.Constant(number, 0.0))
    given = [place(as_is), letter, m, n, k, one, left, m, right, stride, zero, out, m]
    kind = ir.FunctionType(ir.VoidType(), [value.type for value in given])
    builder.call(cgutils.get_or_insert_function(builder.module, kind, _NAME), given)
    return context.get_dummy_value()


def make_known() -> None:
    """Make the product known: before code that calls it comes out of numba's own cache, which asks for nothing."""
    symbols.find([_NAME])


symbols.provide(_NAME, _make_known)
gemm = intrinsic(_call, "void(int64, int64, int64, int64, intp, intp, int64, intp)")
"""gemm(transposed, m, n, k, A, B, stride, C): C = A B or A B', in Fortran's order of arrays: C (m, n), A (m, k), and B
(k, n) or (n, k), with `stride` between its columns. Arrays by address."""
