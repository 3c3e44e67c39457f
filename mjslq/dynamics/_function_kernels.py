"""Integration and Jacobians of a user's function over whole horizons.

One text, two executions: every function here runs as plain Python when the user's function is plain Python,
and is compiled (by numba, once, kept on disk) for functions that are compiled themselves. `register_jitable`
makes that possible; `compiled` gives the compiled entry points, with the user's function passed as a pointer, so that
a new function does not compile them again.

Notation: f(x, u, t, p) is the user's function, h the length of a step, nv the number of velocities, which are
the last entries of the state.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import register_jitable

MAP, EULER, SEMI_IMPLICIT_EULER, RK4 = range(4)
ABSURD = 1e15
"""Entries of a state beyond this count as divergence; their squares would soon overflow."""
COMPLEX_STEP = 1e-40
"""So small that the second-order error underflows; no difference is taken, so nothing cancels."""


@register_jitable
def advance(f, integrator, nv, x, u, t, h, p):
    """Next state."""
    if integrator == MAP:
        return f(x, u, t, p)
    if integrator == EULER:
        return x + h * f(x, u, t, p)
    if integrator == SEMI_IMPLICIT_EULER:  # velocities first, then the rest with the new velocities
        nq = x.shape[0] - nv
        forward = x.copy()
        forward[nq:] = x[nq:] + h * f(x, u, t, p)[nq:]
        forward[:nq] = x[:nq] + h * f(forward, u, t, p)[:nq]
        return forward
    k1 = f(x, u, t, p)
    k2 = f(x + 0.5 * h * k1, u, t + 0.5 * h, p)
    k3 = f(x + 0.5 * h * k2, u, t + 0.5 * h, p)
    k4 = f(x + h * k3, u, t + h, p)
    return x + (h / 6.0) * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@register_jitable
def is_bad(x):
    """Whether a state is not finite, or absurdly large."""
    for entry in x:  # noqa: SIM110  (a generator expression would not compile)
        if not abs(entry) < ABSURD:
            return True
    return False


@register_jitable
def rollout(f, integrator, nv, times, steps, p, U, X):
    """Fill X from X[0]; return the first bad knot, from which on X is NaN, or -1."""
    for n in range(U.shape[0]):
        X[n + 1] = advance(f, integrator, nv, X[n], U[n], times[n], steps[n], p)
        if is_bad(X[n + 1]):
            X[n + 1 :] = np.nan
            return n + 1
    return -1


@register_jitable
def rollout_feedback(f, integrator, nv, times, steps, p, reference_X, reference_U, K, k, alpha, X, U):
    """Fill X from X[0] and U under u = u_ref + alpha k - K (x - x_ref); return as `rollout` does."""
    for n in range(U.shape[0]):
        for i in range(U.shape[1]):
            u = reference_U[n, i] + alpha * k[n, i]
            for j in range(X.shape[1]):
                u -= K[n, i, j] * (X[n, j] - reference_X[n, j])
            U[n, i] = u
        X[n + 1] = advance(f, integrator, nv, X[n], U[n], times[n], steps[n], p)
        if is_bad(X[n + 1]) or is_bad(U[n]):
            X[n + 1 :] = np.nan
            U[n:] = reference_U[n:]
            return n + 1
    return -1


@register_jitable
def linearize_complex(f, integrator, nv, times, steps, p, X, U, A, B):
    """Jacobians by complex steps: exact to rounding for functions that are analytic in x and u."""
    nx, nu = X.shape[1], U.shape[1]
    step = complex(0.0, COMPLEX_STEP)
    for n in range(U.shape[0]):
        x, u = X[n].astype(np.complex128), U[n].astype(np.complex128)
        for j in range(nx):
            x[j] += step
            A[n, :, j] = advance(f, integrator, nv, x, u, times[n], steps[n], p).imag / COMPLEX_STEP
            x[j] = X[n, j]
        for j in range(nu):
            u[j] += step
            B[n, :, j] = advance(f, integrator, nv, x, u, times[n], steps[n], p).imag / COMPLEX_STEP
            u[j] = U[n, j]


@register_jitable
def linearize_differences(f, integrator, nv, times, steps, p, X, U, A, B):
    """Jacobians by centred differences with steps of eps^(1/3), scaled by the entry; error about 1e-10."""
    relative = 6e-6
    for n in range(U.shape[0]):
        x, u = X[n].copy(), U[n].copy()
        for j in range(X.shape[1]):
            e = relative * max(1.0, abs(X[n, j]))
            x[j] = X[n, j] + e
            beyond = advance(f, integrator, nv, x, u, times[n], steps[n], p)
            x[j] = X[n, j] - e
            A[n, :, j] = (beyond - advance(f, integrator, nv, x, u, times[n], steps[n], p)) / (2.0 * e)
            x[j] = X[n, j]
        for j in range(U.shape[1]):
            e = relative * max(1.0, abs(U[n, j]))
            u[j] = U[n, j] + e
            beyond = advance(f, integrator, nv, x, u, times[n], steps[n], p)
            u[j] = U[n, j] - e
            B[n, :, j] = (beyond - advance(f, integrator, nv, x, u, times[n], steps[n], p)) / (2.0 * e)
            u[j] = U[n, j]


_vector, _matrix, _cube = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
REAL = types.FunctionType(_vector(_vector, _vector, types.float64, _vector))
"""Type of a compiled f for real arguments."""
COMPLEX = types.FunctionType(
    types.complex128[::1](types.complex128[::1], types.complex128[::1], types.float64, _vector)
)
"""Type of a compiled f for complex arguments."""
_common = (types.int64, types.int64, _vector, _vector, _vector)
_SIGNATURES = {
    rollout: types.int64(REAL, *_common, _matrix, _matrix),
    rollout_feedback: types.int64(
        REAL, *_common, _matrix, _matrix, _cube, _matrix, types.float64, _matrix, _matrix
    ),
    linearize_complex: types.void(COMPLEX, *_common, _matrix, _matrix, _cube, _cube),
    linearize_differences: types.void(REAL, *_common, _matrix, _matrix, _cube, _cube),
}  # fmt: skip


@cache
def compiled(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return the compiled form of one of the four functions above, compiled when first asked for."""
    return njit(_SIGNATURES[kernel], cache=True, nogil=True)(kernel)
