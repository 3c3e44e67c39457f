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

SMALL = 1e-20
"""Complex step of the derivatives whose differences make second ones; see `mjslq.complex_step`."""
SECOND_STEP = 6e-6
"""Relative step of the differences that make second derivatives of first ones."""


@register_jitable
def next_state(f, integrator, nv, x, u, t, h, p):
    """Next state."""
    return timed_state(f, integrator, nv, x, u, t, h, h, p)


@register_jitable
def timed_state(f, integrator, nv, x, u, t, d, h, p):
    """Next state, a step of length h that stands for d on the clock: the two differ for derivatives by h alone."""
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
    k2 = f(x + 0.5 * h * k1, u, t + 0.5 * d, p)
    k3 = f(x + 0.5 * h * k2, u, t + 0.5 * d, p)
    k4 = f(x + h * k3, u, t + d, p)
    return x + (h / 6.0) * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@register_jitable
def is_bad(x):
    """Whether a state is not finite, or absurdly large."""
    for entry in x:  # noqa: SIM110  (a generator expression would not compile)
        if not abs(entry) < ABSURD:
            return True
    return False


@register_jitable
def rollout(f, integrator, nv, times, steps, p, U, X_ref, K, lower, upper, applied, X):
    """Fill X from X[0] under U, or under the law u = clip(U - K (x - X_ref), lower, upper), which fills `applied`.

    Without feedback K and `applied` have no rows. Returns the first bad knot, from which on X is NaN, or -1.
    """
    feedback, u = K.shape[0] > 0, np.empty(U.shape[1])
    for n in range(U.shape[0]):
        for i in range(U.shape[1]):
            u[i] = U[n, i]
            if feedback:
                for j in range(X.shape[1]):
                    u[i] -= K[n, i, j] * (X[n, j] - X_ref[n, j])
                if u[i] < lower[n, i]:  # and not min and max, which may lose a NaN
                    u[i] = lower[n, i]
                elif u[i] > upper[n, i]:
                    u[i] = upper[n, i]
                applied[n, i] = u[i]
        X[n + 1] = next_state(f, integrator, nv, X[n], u, times[n], steps[n], p)
        if is_bad(X[n + 1]) or is_bad(u):
            X[n + 1 :] = np.nan
            if feedback:
                applied[n:] = U[n:]
            return n + 1
    return -1


@register_jitable
def read_all(f, times, p, X, U, Y):
    """Fill Y with outputs f(x, u, t, p) at the knots."""
    for n in range(Y.shape[0]):
        Y[n] = f(X[n].copy(), U[n].copy(), times[n], p)


@register_jitable
def linearize_complex(f, integrator, nv, times, steps, p, X, U, A, B):
    """Jacobians by complex steps: exact to rounding for functions that are analytic in x and u."""
    nx, nu = X.shape[1], U.shape[1]
    step = complex(0.0, COMPLEX_STEP)
    for n in range(U.shape[0]):
        x, u = X[n].astype(np.complex128), U[n].astype(np.complex128)
        for j in range(nx):
            x[j] += step
            A[n, :, j] = next_state(f, integrator, nv, x, u, times[n], steps[n], p).imag / COMPLEX_STEP
            x[j] = X[n, j]
        for j in range(nu):
            u[j] += step
            B[n, :, j] = next_state(f, integrator, nv, x, u, times[n], steps[n], p).imag / COMPLEX_STEP
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
            beyond = next_state(f, integrator, nv, x, u, times[n], steps[n], p)
            x[j] = X[n, j] - e
            A[n, :, j] = (beyond - next_state(f, integrator, nv, x, u, times[n], steps[n], p)) / (2.0 * e)
            x[j] = X[n, j]
        for j in range(U.shape[1]):
            e = relative * max(1.0, abs(U[n, j]))
            u[j] = U[n, j] + e
            beyond = next_state(f, integrator, nv, x, u, times[n], steps[n], p)
            u[j] = U[n, j] - e
            B[n, :, j] = (beyond - next_state(f, integrator, nv, x, u, times[n], steps[n], p)) / (2.0 * e)
            u[j] = U[n, j]


@register_jitable
def stretch_complex(f, integrator, nv, times, steps, p, X, U, S):
    """Fill S (N, nx) with derivatives of steps by a factor on their lengths, the clock standing: complex steps."""
    for n in range(U.shape[0]):
        x, u = X[n].astype(np.complex128), U[n].astype(np.complex128)
        h = steps[n] * complex(1.0, COMPLEX_STEP)
        S[n] = timed_state(f, integrator, nv, x, u, times[n], steps[n], h, p).imag / COMPLEX_STEP


@register_jitable
def clock_differences(f, integrator, nv, times, steps, p, X, U, S):
    """Fill S (N, nx) with derivatives of steps by a factor on the clock, their lengths standing: differences."""
    e = 6e-6
    for n in range(U.shape[0]):
        x, u, t, d, h = X[n].copy(), U[n].copy(), times[n], steps[n], steps[n]
        beyond = timed_state(f, integrator, nv, x, u, t * (1.0 + e), d * (1.0 + e), h, p)
        before = timed_state(f, integrator, nv, x, u, t * (1.0 - e), d * (1.0 - e), h, p)
        S[n] = (beyond - before) / (2.0 * e)


@register_jitable
def hessian_complex(f, integrator, nv, times, steps, p, X, U, costates, H):
    """Second derivatives of costate'step: centred differences of complex steps; relative error about 1e-10."""
    nx, size = X.shape[1], X.shape[1] + U.shape[1]
    z, h = np.empty(size, dtype=np.complex128), complex(0.0, SMALL)
    for n in range(U.shape[0]):
        z[:nx], z[nx:] = X[n], U[n]
        for j in range(size):
            e, here = SECOND_STEP * max(1.0, abs(z[j])), z[j]
            for i in range(j + 1):
                H[n, i, j] = 0.0
            for sign in (1.0, -1.0):
                z[j] = here + sign * e
                for i in range(j + 1):
                    z[i] += h
                    forward = next_state(f, integrator, nv, z[:nx].copy(), z[nx:].copy(), times[n], steps[n], p)
                    z[i] = z[i].real
                    for k in range(forward.shape[0]):
                        H[n, i, j] += sign * costates[n, k] * (forward[k].imag / SMALL) / (2.0 * e)
            z[j] = here
            for i in range(j):
                H[n, j, i] = H[n, i, j]


@register_jitable
def hessian_differences(f, integrator, nv, times, steps, p, X, U, costates, H):
    """Second derivatives of costate'step by second differences with steps of eps^(1/4); error about 1e-7."""
    nx, size = X.shape[1], X.shape[1] + U.shape[1]
    z, e, here = np.empty(size), np.empty(size), np.empty(size)
    for n in range(U.shape[0]):
        here[:nx], here[nx:] = X[n], U[n]
        for i in range(size):
            e[i] = 1.2e-4 * max(1.0, abs(here[i]))
        for j in range(size):
            for i in range(j + 1):
                total = 0.0
                for a in (1.0, -1.0):
                    for b in (1.0, -1.0):
                        z[:] = here
                        z[i] += a * e[i]
                        z[j] += b * e[j]
                        forward = next_state(f, integrator, nv, z[:nx].copy(), z[nx:].copy(), times[n], steps[n], p)
                        for k in range(forward.shape[0]):
                            total += a * b * costates[n, k] * forward[k]
                H[n, i, j] = H[n, j, i] = total / (4.0 * e[i] * e[j])


@register_jitable
def step_each(f, integrator, nv, times, steps, p, X, U, F):
    """Fill F with one step from each knot, NaN where it blows up."""
    for n in range(U.shape[0]):
        F[n] = next_state(f, integrator, nv, X[n].copy(), U[n].copy(), times[n], steps[n], p)
        if is_bad(F[n]):
            F[n] = np.nan


_vector, _matrix, _cube = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_given = types.Array(types.float64, 2, "C", readonly=True)
_given_cube = types.Array(types.float64, 3, "C", readonly=True)
REAL = types.FunctionType(_vector(_vector, _vector, types.float64, _vector))
"""Type of a compiled f for real arguments."""
COMPLEX = types.FunctionType(
    types.complex128[::1](types.complex128[::1], types.complex128[::1], types.float64, _vector)
)
"""Type of a compiled f for complex arguments."""
_common = (types.int64, types.int64, _vector, _vector, _vector)
_SIGNATURES = {
    rollout: types.int64(REAL, *_common, _given, _given, _given_cube, _given, _given, _matrix, _matrix),
    read_all: types.void(REAL, _vector, _vector, _given, _given, _matrix),
    linearize_complex: types.void(COMPLEX, *_common, _given, _given, _cube, _cube),
    linearize_differences: types.void(REAL, *_common, _given, _given, _cube, _cube),
    stretch_complex: types.void(COMPLEX, *_common, _given, _given, _matrix),
    clock_differences: types.void(REAL, *_common, _given, _given, _matrix),
    hessian_complex: types.void(COMPLEX, *_common, _given, _given, _given, _cube),
    hessian_differences: types.void(REAL, *_common, _given, _given, _given, _cube),
    step_each: types.void(REAL, *_common, _given, _given, _matrix),
}


@cache
def compiled(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return the compiled form of one of the functions above, compiled when first asked for."""
    return njit(_SIGNATURES[kernel], cache=True, nogil=True)(kernel)
