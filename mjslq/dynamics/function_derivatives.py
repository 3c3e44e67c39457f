"""Derivatives of a user's map (x, u, t, p) -> (m,), or of a step of its integration, at many knots.

Notation
--------
    F(z) = step(x, u)     z = (x, u); the map itself where `code` is MAP
    J = (A, B)            its Jacobian: by complex steps, or by central differences
    H                     second derivatives of w'F

Complex steps are held against real differences (`mjslq.complex_step`) at every call, and at generic points when made.
Where they disagree, differences are taken from then on, with one warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from mjslq.complex_step import refused_complex, wrong_slopes
from mjslq.dynamics import function_kernels as kernels
from mjslq.user_function import not_analytic
from mjslq.validation import Array

_REMEDY = 'jacobian="finite-difference"'
_Indices = np.ndarray[Any, np.dtype[np.intp]]


class Derivatives:
    """Derivatives of the steps of one function, or of its values."""

    def __init__(
        self,
        name: str,
        f: Callable[..., Any],
        given: Callable[..., Any],
        compiled: bool,
        code: int,
        nv: int,
        parameters: Array,
        by_differences: bool,
    ) -> None:
        self._name, self._f, self._given, self._compiled = name, f, given, compiled
        self._code, self._nv, self._parameters = code, nv, parameters
        self.by_differences = by_differences
        """Whether real differences are taken: as asked for, or since complex steps were found to be wrong."""

    def jacobians(self, times: Array, steps: Array, X: Array, U: Array, A: Array, B: Array) -> None:
        """Fill in A (k, m, nx) and B (k, m, nu) at knots of these times and step lengths, X (k, nx), U (k, nu)."""
        arguments = (self._f, self._code, self._nv, times, steps, self._parameters, X, U, A, B)
        if not self.by_differences:
            with np.errstate(all="ignore"), refused_complex(self._name, _REMEDY):
                self._kernel(kernels.linearize_complex)(*arguments)
            wrong = self._wrong(times, steps, X[: len(U)], U, A, B)
            if not wrong.any():
                return
            self._turn(f"at knot {np.flatnonzero(wrong)[0]}")
        with np.errstate(all="ignore"):
            self._kernel(kernels.linearize_differences)(*arguments)

    def hessians(self, times: Array, steps: Array, X: Array, U: Array, weights: Array, H: Array) -> None:
        """Fill in H (k, nx + nu, nx + nu) for weights w (k, m). Complex steps are checked by `jacobians` alone."""
        kernel = self._kernel(kernels.hessian_differences if self.by_differences else kernels.hessian_complex)
        with np.errstate(all="ignore"), refused_complex(self._name, _REMEDY):
            kernel(self._f, self._code, self._nv, times, steps, self._parameters, X, U, weights, H)

    def under(self, parameters: Array) -> None:
        """Take other parameters p from now on."""
        self._parameters = parameters

    def by_stretch(self, times: Array, steps: Array, X: Array, U: Array, timed: bool) -> Array | None:
        """Derivatives of the steps by a factor on their lengths, at one; `timed` says whether the function takes t.

        None where complex steps do not serve. The part of the clock is a difference. Shape (k, m).
        """
        if self.by_differences:
            return None
        S, clock = np.empty((len(U), X.shape[1])), np.empty((len(U), X.shape[1]))
        arguments = (self._code, self._nv, times, steps, self._parameters, X, U)
        with np.errstate(all="ignore"), refused_complex(self._name, _REMEDY):
            self._kernel(kernels.stretch_complex)(self._f, *arguments, S)
            if timed:
                self._kernel(kernels.clock_differences)(self._f, *arguments, clock)
                S += clock
        return S

    def by_clock(self, times: Array, X: Array, U: Array) -> Array:
        """Derivatives of the values of a map by a factor on the clock, by differences. Shape (k, m)."""
        found, e = [], 6e-6
        for factor in (1.0 + e, 1.0 - e):
            Y = np.empty((len(X), np.size(self._f(X[0], U[0], times[0], self._parameters))))
            with np.errstate(all="ignore"):
                self._kernel(kernels.read_all)(self._f, factor * times, self._parameters, X, U, Y)
            found.append(Y)
        slope: Array = (found[0] - found[1]) / (2.0 * e)
        return slope

    def try_out(self, nx: int, nu: int, m: int, step: float) -> None:
        """Judge complex steps of a plain function at generic points near the origin, where it is defined there."""
        if self._compiled or self.by_differences or not m:
            return
        X, U = np.split(np.random.default_rng(0).uniform(-1.0, 1.0, (2, nx + nu)), [nx], axis=1)
        times, steps, A, B = np.zeros(2), np.full(2, step), np.empty((2, m, nx)), np.empty((2, m, nu))
        try:
            with np.errstate(all="ignore"), refused_complex(self._name, _REMEDY):
                kernels.linearize_complex(self._f, self._code, self._nv, times, steps, self._parameters, X, U, A, B)
            wrong = self._wrong(times, steps, X, U, A, B)
        except Exception:  # whatever functions raise off their domain; refused, if so, when they are differentiated
            return
        if wrong.any():
            self._turn("near the origin")

    def _wrong(self, times: Array, steps: Array, X: Array, U: Array, A: Array, B: Array) -> np.ndarray[Any, Any]:
        """Knots at which Jacobians are not those of differences. Shape (k,)."""

        def values(at: _Indices, Z: Array) -> Array:
            moved, held = np.split(Z, [X.shape[1]], axis=1)
            F = np.empty((len(at), A.shape[1]))
            rest = (self._code, self._nv, times[at], steps[at], self._parameters)
            self._kernel(kernels.step_each)(self._f, *rest, np.array(moved, order="C"), np.array(held, order="C"), F)
            return F

        Z, J = np.hstack([X, U]), np.concatenate([A, B], axis=2)
        judged = J.copy()
        if self._code != kernels.MAP:  # of x + h (...), the second part is judged
            judged[:, :, : X.shape[1]] -= np.eye(X.shape[1])
        scale = np.einsum("kmn,kn->km", np.abs(judged), np.maximum(1.0, np.abs(Z)))
        return np.asarray(wrong_slopes(values, Z, J, scale).any(axis=1))

    def _turn(self, where: str) -> None:
        """Take differences from now on."""
        self.by_differences = True
        warnings.warn(not_analytic(self._name, self._given, where, _REMEDY), stacklevel=4)

    def _kernel(self, plain: Callable[..., Any]) -> Callable[..., Any]:
        return kernels.compiled(plain) if self._compiled else plain
