"""Costates of a compiled function's steps from its pullback: no Jacobian is made, and nothing allocated but rows.

Notation
--------
    f(x, u, t, p)           the user's function
    (f_x'w, f_u'w)          its pullback of the weights w, as one row (nx + nu,), from back(x, u, t, p, w)
    lambda                  costate after the step;  A'lambda, B'lambda before it

    map      A'lambda = f_x'lambda
    euler    A'lambda = lambda + h f_x'lambda
    rk4      stages x_i, slopes k_i: weights of k_4 are h/6 lambda, of k_3 h/3 lambda + h f_x(x_4)'(weights of k_4), ...

and so for the controls, without the terms of lambda itself. The recursion over the steps, with feedback and limits, is
the one of `mjslq.lq.adjoint`. (Griewank and Walther 2008, "Evaluating Derivatives", chapter 3.)
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numba import njit, types

from mjslq.dynamics.function_kernels import EULER, MAP, REAL, SEMI_IMPLICIT_EULER
from mjslq.lq.adjoint import subtract_feedback
from mjslq.validation import Array

_row, _given, _cube = types.float64[::1], types.Array(types.float64, 2, "C", readonly=True), types.float64[:, :, ::1]
_rows, _bytes, _flags = types.float64[:, ::1], types.int8[:, ::1], types.boolean[:, ::1]
PULLBACK = types.FunctionType(_row(_row, _row, types.float64, _row, _row))
"""Type of a compiled pullback."""
_given_cube = types.Array(types.float64, 3, "C", readonly=True)
_common = (types.int64, types.int64, _row, _row, _row, _given, _given, _given_cube, _bytes)
_SIGNATURE = types.void(REAL, PULLBACK, *_common, _rows, _rows, _flags)


@njit(cache=True, nogil=True)
def pulled_back(f, back, integrator, nv, x, u, t, h, p, weights):
    """(A'lambda, B'lambda) of a step, as one row (nx + nu,)."""
    nx, nq = x.shape[0], x.shape[0] - nv
    if integrator == MAP:
        return back(x, u, t, p, weights)
    if integrator == EULER:
        total = h * back(x, u, t, p, weights)
        total[:nx] += weights
        return total
    if integrator == SEMI_IMPLICIT_EULER:
        forward = x.copy()
        forward[nq:] += h * f(x, u, t, p)[nq:]
        part = np.zeros(nx)
        part[:nq] = h * weights[:nq]
        total = back(forward, u, t, p, part)
        total[:nx] += weights
        part[:nq], part[nq:] = 0.0, h * total[nq:nx]
        return total + back(x, u, t, p, part)
    k1 = f(x, u, t, p)
    x2 = x + 0.5 * h * k1
    x3 = x + 0.5 * h * f(x2, u, t + 0.5 * h, p)
    x4 = x + h * f(x3, u, t + 0.5 * h, p)
    g4 = back(x4, u, t + h, p, (h / 6.0) * weights)
    g3 = back(x3, u, t + 0.5 * h, p, (h / 3.0) * weights + h * g4[:nx])
    g2 = back(x2, u, t + 0.5 * h, p, (h / 3.0) * weights + 0.5 * h * g3[:nx])
    total = back(x, u, t, p, (h / 6.0) * weights + 0.5 * h * g2[:nx]) + g2 + g3 + g4
    total[:nx] += weights
    return total


def _adjoint(f, back, integrator, nv, times, steps, p, X, U, K, sides, costates, gradient, held):
    """In place, as `mjslq.lq.adjoint.closed_loop_adjoint`: costates and gradient come in with q and r."""
    nx = X.shape[1]
    for n in range(U.shape[0] - 1, -1, -1):
        x, u = X[n].copy(), U[n].copy()
        both = pulled_back(f, back, integrator, nv, x, u, times[n], steps[n], p, costates[n + 1])
        costates[n] += both[:nx]
        gradient[n] += both[nx:]
        subtract_feedback(n, K, sides, gradient, held, costates[n])


@cache
def adjoint_kernel() -> Any:
    """The compiled recursion; functions are passed as pointers, so that another does not compile it again."""
    return njit(_SIGNATURE, cache=True, nogil=True)(_adjoint)


def check_pullback(pullback: Any, compiled: bool, nx: int, nu: int, parameters: Array) -> None:
    """Raise ValueError for a pullback that is not compiled as f is, or does not return (nx + nu,)."""
    if not (compiled and hasattr(pullback, "py_func")):
        raise ValueError("pullback is for functions compiled by numba.njit, and must be compiled itself, as f must")
    try:
        with np.errstate(all="ignore"):
            value = np.asarray(pullback.py_func(np.zeros(nx), np.zeros(nu), 0.0, parameters, np.ones(nx)))
    except (IndexError, ValueError, TypeError) as error:
        raise ValueError(
            f"pullback(x, u, t, p, w) fails for x of shape ({nx},) and u of shape ({nu},): {error}"
        ) from None
    if value.shape != (nx + nu,):
        raise ValueError(f"pullback must return (f_x'w, f_u'w) as one row of shape ({nx + nu},), got {value.shape}")
