"""A user's function of (x, u, t) at many knots, and its derivatives.

Notation
--------
    z_n = (x_n, u_n)   Z  Shape (k, nx + nu);  at knot N, where there is no control, u is zero
    f(x, u, t)         numbers in a row (m,), or one number (m = 1);  f(x, u, t, p) where there are parameters p

    df/dz              as given, or by complex steps
    d2(w'f)/dz2        as given, or by central differences of df/dz

Complex steps are held against real differences at every call (`mjslq.complex_step`): a function that is not analytic
is differentiated by differences from there on, with a warning.

Plain Python is called knot by knot. Functions compiled by numba.njit run in a compiled loop over the knots.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjslq.complex_step import (
    DIFFERENCE,
    SMALL,
    Values,
    central_differences,
    complex_step,
    complex_step_along,
    refused_complex,
    second_differences,
    unscaled,
    wrong_slopes,
)
from mjslq.native.users import is_compiled
from mjslq.validation import Array, as_array, describe, frozen, function, gist, numbers

Derivative = Callable[..., Any] | None
"""A user's derivative, where one is given."""
_NUMBERS = "iufc"
"""Kinds of arrays that hold numbers, complex ones included."""
_GENERIC = 0.6180339887498949
"""Entries of the point at which a function is called that is not defined at the origin."""


class UserFunction:
    """f(x, u, t) -> (m,) with its derivatives, by the knots of a horizon.

    Raises ValueError when f does not return numbers in a row for x (nx,), u (nu,) at the origin, where it need not be
    defined.
    """

    _remedy = "jacobian="
    _derivative_name = "jacobian"

    def __init__(
        self,
        letter: str,
        f: Callable[..., Any],
        nx: int,
        nu: int,
        jacobian: Derivative = None,
        parameters: ArrayLike | None = None,
    ) -> None:
        self.name = f"{letter}(x, u, t)" if parameters is None else f"{letter}(x, u, t, p)"
        function(self.name, f)
        if jacobian is not None:
            function(self._derivative_name, jacobian)
        self._f, self._nx, self._nu, self._jacobian = f, nx, nu, jacobian
        self._p = () if parameters is None else (np.array(as_array("parameters", parameters, ("size",))),)
        value = self._at_origin()
        if value.ndim > 1 or not value.size:
            raise ValueError(f"{self.name} must return a number or numbers in a row (m,), got shape {value.shape}")
        self.size = value.size
        self._returns = _returned(self.name, f, len(self._p)) if is_compiled(f) else None
        self.by_differences = False
        """Whether derivatives are real differences, since complex steps were found to be wrong."""
        if jacobian is None and not self.compiled:
            self._try_out()

    @property
    def compiled(self) -> bool:
        """Whether values are computed in a compiled loop over the knots."""
        return self._returns is not None

    def values(self, Z: Array, times: Array) -> Array:
        """Values of f at every knot. Shape (k, m)."""
        out = np.empty((len(Z), self.size))
        if self._returns is not None:
            self._kernel(_kernels().values)(self._f, Z, self._nx, times, self._p, out)
            return out
        for n, t in enumerate(times.tolist()):
            out[n] = self._value(Z[n], t)
        return out

    def jacobians(self, Z: Array, times: Array) -> Array:
        """Derivatives df/dz at every knot. Shape (k, m, nx + nu)."""
        if self._jacobian is not None:
            J = np.empty((len(Z), self.size, Z.shape[1]))
            for n, t in enumerate(times.tolist()):
                J[n] = self._given_derivative(Z[n], t)
            return J
        values = self._values_of(times)
        if self.by_differences:
            return central_differences(values, Z)
        J, along = self._complex_steps(Z, times)
        wrong = wrong_slopes(values, Z, J) | unscaled(J, along)
        return self._instead(wrong, Z, times) if wrong.any() else J

    def _complex_steps(self, Z: Array, times: Array) -> tuple[Array, Array]:
        """df/dz by complex steps, unchecked, and along all entries at once. Shapes (k, m, nx + nu), (k, m)."""
        J, along = np.empty((len(Z), self.size, Z.shape[1])), np.empty((len(Z), self.size))
        if self._in_loop:
            self._kernel(_kernels().jacobians)(self._f, Z, self._nx, times, self._p, J, along)
        else:
            with refused_complex(self.name, self._remedy):
                for n, t in enumerate(times.tolist()):
                    value = partial(self._value, t=t)
                    J[n], along[n] = complex_step(value, Z[n]), complex_step_along(value, Z[n])
        return J, along

    def hessians(self, Z: Array, times: Array, weights: Array) -> Array:
        """d2(w_n'f)/dz2 at every knot, symmetric; weights w_n of shape (k, m). Shape (k, nx + nu, nx + nu).

        Complex steps are not checked here, but where `jacobians` takes them.
        """
        H = np.empty((len(Z), Z.shape[1], Z.shape[1]))
        if self.by_differences:
            return second_differences(self._values_of(times), Z, weights)
        if self._in_loop:
            self._kernel(_kernels().hessians)(self._f, Z, self._nx, times, self._p, weights, H)
            return H
        with refused_complex(self.name, self._remedy):
            for n, t in enumerate(times.tolist()):
                H[n] = self._second_derivative(Z[n], t, weights[n])
        return 0.5 * (H + H.swapaxes(1, 2))

    @cached_property
    def _in_loop(self) -> bool:
        """Whether derivatives are complex steps in a compiled loop; ValueError where a compiled f cannot take them."""
        if self._returns is None or self._jacobian is not None:
            return False
        if not _kernels().takes_complex(self._f, self._returns, len(self._p)):
            raise ValueError(
                f"{self.name} cannot be differentiated by complex steps: compiled for complex x and u it must return "
                f"complex numbers; write it analytic in x and u, or use {self._remedy}"
            )
        return True

    def _instead(self, wrong: NDArray[np.bool_], Z: Array, times: Array, where: str = "") -> Array:
        """df/dz by differences, now and from now on, where complex steps are wrong: one warning.

        Raises ValueError where differences are not finite.
        """
        n, i = np.argwhere(wrong)[0]
        entry = self.name if self.size == 1 else f"entry {i} of {self.name}"
        with np.errstate(all="ignore"):
            instead = central_differences(self._values_of(times), Z)
        if not np.isfinite(instead[n]).all():
            raise ValueError(
                f"{entry} cannot be differentiated by complex steps at t = {times[n]:g}: it has an imaginary part of "
                f"its own there, as logarithms and roots of negative numbers have, and real differences are not "
                f"finite; use {self._remedy}"
            )
        self.by_differences = True
        sentence = not_analytic(entry, self._f, where or f"at t = {times[n]:g}", self._remedy)
        warnings.warn(sentence, stacklevel=2)
        return instead

    def _try_out(self) -> None:
        """Hold complex steps against differences at generic points near the origin, where f is defined there."""
        Z, times = np.random.default_rng(0).uniform(-1.0, 1.0, (2, self._nx + self._nu)), np.full(2, _GENERIC)
        try:
            with np.errstate(all="ignore"):
                J, _ = self._complex_steps(Z, times)
                wrong = wrong_slopes(self._values_of(times), Z, J)
        except Exception:  # whatever f raises off its domain; refused, if so, when it is differentiated
            return
        if wrong.any():
            self._instead(wrong, Z, times, "near the origin")

    def _values_of(self, times: Array) -> Values:
        """The function at some of the knots, as `mjslq.complex_step` takes it."""
        return lambda at, Z: self.values(np.ascontiguousarray(Z), times[at])

    def _kernel(self, plain: Callable[..., Any]) -> Callable[..., Any]:
        assert self._returns is not None
        return _kernels().compiled(plain, self._returns, len(self._p))

    def _value(self, z: Array, t: float) -> Array:
        given = self._f(z[: self._nx], z[self._nx :], t, *self._p)
        value = np.atleast_1d(np.asarray(given))
        if value.shape != (self.size,) or value.dtype.kind not in _NUMBERS:
            came = f"shape {value.shape}" if value.dtype.kind in _NUMBERS else describe(given)
            raise ValueError(
                f"{self.name} must return as many numbers at every knot as at the origin, ({self.size},), "
                f"got {came} at t = {t:g}"
            )
        return value

    def _derivative(self, z: Array, t: float) -> Array:
        """df/dz. Shape (m, nx + nu)."""
        if self._jacobian is None:
            return complex_step(partial(self._value, t=t), z, SMALL)
        return self._given_derivative(z, t)

    def _given_derivative(self, z: Array, t: float) -> Array:
        assert self._jacobian is not None
        parts = self._jacobian(z[: self._nx], z[self._nx :], t, *self._p)
        return np.hstack(checked("jacobian", parts, [(self.size, self._nx), (self.size, self._nu)]))

    def _second_derivative(self, z: Array, t: float, weights: Array) -> Array:
        """Jacobian of the gradient w'df/dz by central differences, not quite symmetric. Shape (nx + nu, nx + nu)."""
        columns = []
        for i in range(z.size):
            d = np.zeros(z.size)
            d[i] = DIFFERENCE * max(1.0, abs(z[i]))
            beyond, before = self._derivative(z + d, t), self._derivative(z - d, t)
            columns.append(weights @ (beyond - before) / (2.0 * d[i]))
        return np.stack(columns, axis=-1)

    def _at_origin(self) -> Array:
        """What f returns at the origin, where it need not be defined but has its shape; or else near it."""
        plain = getattr(self._f, "py_func", self._f)  # which checks its indices
        errors: list[Exception] = []
        for number in (0.0, _GENERIC):
            x, u = frozen(np.full(self._nx, number)), frozen(np.full(self._nu, number))
            try:
                with np.errstate(all="ignore"):
                    value = plain(x, u, number, *self._p)
            except Exception as error:  # whatever f raises
                errors.append(error)
            else:
                return numbers(self.name, value)
        raise ValueError(f"{self.name} fails for x of shape ({self._nx},): {gist(errors[0])}") from errors[0]


class UserCost(UserFunction):
    """A function that returns one number, with its derivatives in the forms that go with one."""

    _remedy = "gradient= and hessian="
    _derivative_name = "gradient"

    def __init__(
        self,
        letter: str,
        f: Callable[..., Any],
        nx: int,
        nu: int,
        gradient: Derivative = None,
        hessian: Derivative = None,
        parameters: ArrayLike | None = None,
    ) -> None:
        super().__init__(letter, f, nx, nu, gradient, parameters)
        self._hessian = None if hessian is None else function("hessian", hessian)

    def hessians(self, Z: Array, times: Array, weights: Array) -> Array:
        """See `UserFunction.hessians`."""
        if self._hessian is None:
            return super().hessians(Z, times, weights)
        H = np.empty((len(Z), Z.shape[1], Z.shape[1]))
        for n, t in enumerate(times.tolist()):
            value = self._hessian(Z[n, : self._nx], Z[n, self._nx :], t, *self._p)
            H[n] = weights[n, 0] * checked("hessian", (value,), [H.shape[1:]])[0]
        return 0.5 * (H + H.swapaxes(1, 2))

    def _given_derivative(self, z: Array, t: float) -> Array:
        assert self._jacobian is not None
        parts = self._jacobian(z[: self._nx], z[self._nx :], t, *self._p)
        return np.concatenate(checked("gradient", parts, [(self._nx,), (self._nu,)]))[None]

    def _at_origin(self) -> Array:
        value = super()._at_origin()
        if value.size != 1:
            raise ValueError(f"{self.name} must return a number, got shape {value.shape}")
        return value.reshape(1)


def not_analytic(name: str, f: Callable[..., Any], where: str, remedy: str) -> str:
    """The sentence that warns of a function whose derivatives are taken by differences."""
    called = getattr(f, "__name__", type(f).__name__)
    return (
        f"{name} ({called!r}) is not analytic in x and u: complex steps and real differences disagree {where}. abs, "
        f"norm, vdot, .real, .conj, sign and angle lose the derivative, and x**3 compiled by numba goes through "
        f"logarithms. Finite differences are taken from now on; use {remedy}, or write it with sqrt, dot products and "
        f"x*x*x"
    )


def _kernels() -> Any:
    """The compiled loops, which import numba: only for functions that it has compiled."""
    from mjslq import user_kernels

    return user_kernels


def _returned(name: str, f: Any, parameters: int) -> Any:
    """What a compiled function returns (`user_kernels.returns_of`); ValueError where numba cannot compile it."""
    from numba.core.errors import NumbaError

    try:
        return _kernels().returns_of(f, parameters)
    except NumbaError as error:
        raise ValueError(f"{name} cannot be compiled by numba: {_reason(error)}") from None


def _reason(error: Exception) -> str:
    """The line of numba's message that says what is wrong."""
    lines = [line.strip() for line in str(error).splitlines()]
    return next((line for line in lines[1:] if line), lines[0] if lines else "")


def checked(name: str, parts: Sequence[Any], shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Return what a user's derivative gave, as arrays of the right shapes."""
    try:
        arrays = [np.asarray(part, dtype=np.float64) for part in parts]
        given = [array.shape for array in arrays]
    except (TypeError, ValueError):
        raise ValueError(f"{name} must return shape {' and '.join(map(str, shapes))}, got {describe(parts)}") from None
    if given != list(shapes):
        raise ValueError(
            f"{name} must return shape {' and '.join(map(str, shapes))}, got {' and '.join(map(str, given))}"
        )
    return arrays
