"""What users give to `FunctionDynamics`, checked and brought into one form: functions, limits, names."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from mjslq.validation import Array, as_array, describe, frozen, function, gist, numbers


def plain(f: Callable[..., Any]) -> Callable[..., Any]:
    """The Python function that a compiled one was made of."""
    python: Callable[..., Any] = f.py_func if isinstance(f, Dispatcher) else f
    return python


class WrongReturn(ValueError):
    """A sentence about what a user's function returned."""


def with_all_arguments(
    f: Callable[..., Any], compiled: bool, name: str = "f", size: int | None = None
) -> Callable[..., Any]:
    """Return f as a function of (x, u, t, p); plain functions return arrays (size,) whatever they are given as."""
    given = _positional(function(name, plain(f)))
    if given not in (2, 3, 4):
        raise ValueError(f"{name} must take (x, u), (x, u, t) or (x, u, t, p), but takes {given} arguments")
    if compiled:
        _refuse_uncompilable(name, f, given)
        if given == 4:
            return f
        if given == 3:
            return numba.njit(lambda x, u, t, p: f(x, u, t))
        return numba.njit(lambda x, u, t, p: f(x, u))

    def checked(x: Array, u: Array, t: float, p: Array) -> Any:
        value = f(*(x, u, t, p)[:given])
        array = value if isinstance(value, np.ndarray) else _array_of(value)
        if array.dtype.kind not in "iufc":
            raise WrongReturn(f"{name} must return numbers, got {describe(value)} at t = {t:g}")
        if size is not None and array.shape != (size,):
            raise WrongReturn(f"{name} must return shape ({size},), got {array.shape} at t = {t:g}")
        return array

    return checked


def as_rows(name: str, f: Callable[..., Any], size: int) -> Callable[..., Any]:
    """Return f as a function whose numbers come in a row (size,), at every knot as many."""

    def checked(x: Array, u: Array, t: float, p: Array) -> Any:
        row = np.atleast_1d(f(x, u, t, p))
        if row.shape != (size,):
            raise WrongReturn(f"{name} must return shape ({size},), got {row.shape} at t = {t:g}")
        return row

    return checked


def _array_of(value: Any) -> Any:
    try:
        return np.asarray(value)
    except ValueError:  # rows of unequal length
        return np.asarray(None)


def limits_of(given: Any, nu: int) -> Array:
    """Return limits given as (lower, upper) or as an array (nu, 2) as the latter, or raise ValueError."""
    if given is None:
        return np.tile([-np.inf, np.inf], (nu, 1))
    if isinstance(given, tuple):
        if len(given) != 2:
            raise ValueError(f"control_limits must be (lower, upper) or an array ({nu}, 2), got {len(given)} entries")
        sides = [as_array(f"control_limits[{i}]", side, finite=False) for i, side in enumerate(given)]
        for i, side in enumerate(sides):
            if side.shape not in ((), (nu,)):
                raise ValueError(f"control_limits[{i}] must be a number or an array ({nu},), got shape {side.shape}")
        limits = np.stack([np.broadcast_to(side, (nu,)) for side in sides], axis=-1)
    else:
        limits = np.array(as_array("control_limits", given, finite=False))
        if limits.shape != (nu, 2):
            raise ValueError(f"control_limits must be (lower, upper) or an array ({nu}, 2), got shape {limits.shape}")
    wrong = ~(limits[:, 0] <= limits[:, 1])  # NaN too
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ValueError(
            f"control_limits must have lower <= upper, but control {i} has {limits[i, 0]} and {limits[i, 1]}"
        )
    return limits


def takes_time(f: Callable[..., Any] | None) -> bool:
    """Whether a user's function takes t."""
    return f is not None and _positional(plain(f)) > 2


def named_parameters(given: Any) -> tuple[Array, tuple[str, ...]]:
    """P as an array, and its names: those of a mapping, or p[0], p[1], ...  Raises ValueError."""
    if isinstance(given, Mapping):
        return np.array(as_array("parameters", list(given.values()), ("size",))), tuple(map(str, given))
    array = np.array(as_array("parameters", given, ("size",)))
    return array, tuple(f"p[{i}]" for i in range(array.size))


def probe(f: Callable[..., Any], nx: int, nu: int, parameters: Array) -> None:
    """Call f once, so that a wrong shape is reported here and not from inside a rollout. Raises ValueError."""
    value = numbers("f", tried("f", f, nx, nu, parameters))
    if value.shape != (nx,):
        raise ValueError(f"f must return shape ({nx},), got {value.shape}")


def reading(
    outputs: Callable[..., Any] | None, nx: int, nu: int, parameters: Array
) -> tuple[Callable[..., Any], bool, int]:
    """Outputs as a function of (x, u, t, p), whether it is compiled, and ny, by a call at the origin.

    Compiled ones that return something other than an array or a number are called from Python.
    """
    if outputs is None:
        return lambda x, u, t, p: np.zeros(0), False, 0
    compiled = isinstance(outputs, Dispatcher)
    read = with_all_arguments(outputs, compiled, "outputs")
    value = tried("outputs", read, nx, nu, parameters)
    y = np.atleast_1d(numbers("outputs", value))
    if y.ndim != 1:
        raise ValueError(f"outputs must return numbers in a row (ny,), got shape {y.shape}")
    if compiled and isinstance(value, (float, np.floating)):
        number = read
        return numba.njit(lambda x, u, t, p: np.array([number(x, u, t, p)])), True, 1
    compiled = compiled and isinstance(value, np.ndarray)
    return read if compiled else as_rows("outputs", plain(read), y.size), compiled, y.size


def _positional(f: Callable[..., Any]) -> int:
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return sum(p.kind in kinds and p.default is p.empty for p in inspect.signature(f).parameters.values())


def names_of(name: str, given: Sequence[str] | None, letter: str, size: int) -> tuple[str, ...]:
    """Names as given, or letters with indices; ValueError where there are not as many as there are entries."""
    if given is None:
        return tuple(f"{letter}[{i}]" for i in range(size))
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise ValueError(f"{name} must be a list of {size} names, got {describe(given)}")
    if len(given) != size:
        raise ValueError(f"{name} must have {size} entries, got {len(given)}")
    for i, one in enumerate(given):
        if not isinstance(one, str) or not one or one in given[:i]:
            raise ValueError(f"{name} must be texts that differ from each other, got {describe(one)} at {i}")
    return tuple(given)


def checked_hessian(parts: Any, nx: int, nu: int) -> Array:
    """H by (x, u) from the three blocks that a user's hessian returns. Raises ValueError."""
    wanted = [(nx, nx), (nu, nx), (nu, nu)]
    if (given := _shapes(parts)) != wanted:
        came = describe(parts) if given is None else ", ".join(map(str, given))
        raise ValueError(f"hessian must return H_xx, H_ux and H_uu of shapes {wanted}, got {came}")
    xx, ux, uu = (np.asarray(part, dtype=np.float64) for part in parts)
    return np.block([[xx, ux.T], [ux, uu]])


def checked_jacobian(parts: Any, nx: int, nu: int) -> tuple[Any, Any]:
    """A and B as a user's jacobian returns them. Raises ValueError."""
    wanted = [(nx, nx), (nx, nu)]
    if (given := _shapes(parts)) != wanted:
        came = describe(parts) if given is None else " and ".join(map(str, given))
        raise ValueError(f"jacobian must return A and B of shapes {' and '.join(map(str, wanted))}, got {came}")
    A, B = parts
    return A, B


def tried(name: str, f: Callable[..., Any], nx: int, nu: int, parameters: Array) -> Any:
    """Call f(x, u, t, p) at the origin with arrays that it cannot write into. Raises ValueError if it fails."""
    try:
        with np.errstate(all="ignore"):
            return plain(f)(frozen(np.zeros(nx)), frozen(np.zeros(nu)), 0.0, parameters)
    except WrongReturn:
        raise
    except Exception as error:  # whatever f raises
        raise ValueError(f"{name} fails for x of shape ({nx},) and u of shape ({nu},): {gist(error)}") from error


def _shapes(parts: Any) -> list[tuple[int, ...]] | None:
    """Shapes of the arrays in a tuple or list; None for anything else."""
    if not isinstance(parts, (tuple, list)):
        return None
    try:
        return [np.shape(part) for part in parts]
    except ValueError:  # rows of unequal length
        return None


def _refuse_uncompilable(name: str, f: Callable[..., Any], arguments: int) -> None:
    """Have numba compile a function for real numbers. Raises ValueError where it cannot, with numba's reason."""
    vector = numba.float64[::1]
    try:
        f.compile((vector, vector, numba.float64, vector)[:arguments])  # type: ignore[attr-defined]
    except NumbaError as error:
        lines = [line.strip() for line in str(error).splitlines()]
        reason = next((line for line in lines[1:] if line), lines[0] if lines else "")
        raise ValueError(f"{name} cannot be compiled by numba: {reason}") from None
