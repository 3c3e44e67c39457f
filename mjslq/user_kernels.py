"""Values and derivatives of a user's compiled function at many knots, without a Python call for each.

Notation
--------
    f(x, u, t)     the user's function, compiled by numba.njit: numbers in a row (m,), or one number (m = 1);
                   f(x, u, t, p) where it takes parameters: p is the tuple of them, empty or of one array
    z_n = (x_n, u_n)   Z  Shape (k, nx + nu)
    e              imaginary step: df/dz_j = Im f(z + i e) / e, exact to rounding (Squire and Trapp 1998)

The function is passed as a pointer, so that another function does not compile the kernels again. They are kept on
disk. Their slow twin is the plain Python in `mjslq.user_function`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, Literal

import numpy as np
from numba import njit, types
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from mjslq.complex_step import DIFFERENCE, OTHER, SMALL, TINY

Returns = Literal["row", "number"]


def values(f, Z, nx, times, p, out):
    """out_n = f(x_n, u_n, t_n)."""
    for n in range(Z.shape[0]):
        value = f(Z[n, :nx], Z[n, nx:], times[n], *p)
        if np.size(value) != out.shape[1]:
            raise ValueError("a function of (x, u, t) must return as many numbers at every knot as at the origin")
        out[n, :] = value


def jacobians(f, Z, nx, times, p, J, along):
    """J_n = df/dz at knot n, and its derivative along all of z at once."""
    size = Z.shape[1]
    z = np.empty(size, np.complex128)
    for n in range(Z.shape[0]):
        for j in range(size):
            z[:] = Z[n]
            z[j] += 1j * TINY
            J[n, :, j] = f(z[:nx], z[nx:], times[n], *p).imag / TINY
        z[:] = Z[n] + 1j * OTHER
        along[n, :] = f(z[:nx], z[nx:], times[n], *p).imag / OTHER


def hessians(f, Z, nx, times, p, weights, H):
    """H_n = d2(w_n'f)/dz2 at knot n, by central differences of complex steps."""
    size, m = Z.shape[1], weights.shape[1]
    z, slope = np.empty(size, np.complex128), np.empty(m)
    for n in range(Z.shape[0]):
        H[n] = 0.0
        for i in range(size):
            d = DIFFERENCE * max(1.0, abs(Z[n, i]))
            for sign in (1.0, -1.0):
                for j in range(size):
                    z[:] = Z[n]
                    z[i] += sign * d
                    z[j] += 1j * SMALL
                    slope[:] = f(z[:nx], z[nx:], times[n], *p).imag / SMALL
                    for k in range(m):
                        H[n, j, i] += sign * weights[n, k] * slope[k] / (2.0 * d)
        for i in range(size):
            for j in range(i):
                H[n, i, j] = H[n, j, i] = 0.5 * (H[n, i, j] + H[n, j, i])


_row, _rows, _cube = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_complex_row = types.complex128[::1]
_REAL = {"row": _row, "number": types.float64}
_COMPLEX = {"row": _complex_row, "number": types.complex128}


def _real_arguments(parameters: int) -> tuple[Any, ...]:
    return (_row, _row, types.float64, *(_row,) * parameters)


def _complex_arguments(parameters: int) -> tuple[Any, ...]:
    return (_complex_row, _complex_row, types.float64, *(_row,) * parameters)


@cache
def compiled(kernel: Callable[..., Any], returns: Returns, parameters: int) -> Callable[..., Any]:
    """The compiled form of one of the functions above.

    For user's functions that return a row or a number, and take no parameters or one array of them.
    """
    common = (_rows, types.int64, _row, types.Tuple((_row,) * parameters))
    real = types.FunctionType(_REAL[returns](*_real_arguments(parameters)))
    imaginary = types.FunctionType(_COMPLEX[returns](*_complex_arguments(parameters)))
    signature = {
        values: types.void(real, *common, _rows),
        jacobians: types.void(imaginary, *common, _cube, _rows),
        hessians: types.void(imaginary, *common, _rows, _cube),
    }[kernel]
    return njit(signature, cache=True, nogil=True)(kernel)


def returns_of(f: Any, parameters: int) -> Returns | None:
    """What a function compiled by numba returns for real x and u; None for anything that the kernels do not take.

    Raises numba's error where it cannot be compiled.
    """
    return _returns(f, _real_arguments(parameters), _REAL) if isinstance(f, Dispatcher) else None


def takes_complex(f: Any, returns: Returns, parameters: int) -> bool:
    """Whether a compiled function returns complex numbers, in the same form, for complex x and u."""
    try:
        return _returns(f, _complex_arguments(parameters), _COMPLEX) == returns
    except NumbaError:
        return False


def _returns(f: Any, arguments: tuple[Any, ...], kinds: dict[str, Any]) -> Returns | None:
    try:
        f.compile(arguments)
        found = f.overloads[arguments].signature.return_type
    except (RuntimeError, KeyError):  # compiled beforehand, for other types
        return None
    if found == kinds["row"]:
        return "row"
    return "number" if found == kinds["number"] else None
