"""Checks of what a user hands in, with one clear sentence for each thing that can be wrong.

Every public constructor runs its arrays through these helpers, so that a wrong shape, a NaN or an
indefinite matrix is named where it enters (argument, step, expected, given) and not thirty calls later.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Kind = TypeVar("Kind")


def as_array(name: str, value: ArrayLike, shape: Sequence[int | str] | None = None, *, finite: bool = True) -> Array:
    """Return `value` as a C-contiguous float array after checking its shape and its entries.

    A string in `shape` names a size that may be anything; it only serves the message.
    """
    if isinstance(value, np.ndarray) and value.dtype == np.float64 and value.flags.c_contiguous:
        array: Array = value  # what engines pass on, thousands of times a second
    else:
        array = _converted(name, value)
    if shape is not None and not _fits(array.shape, shape):
        expected = "(" + ", ".join(str(size) for size in shape) + ("," if len(shape) == 1 else "") + ")"
        raise ValueError(f"{name} must have shape {expected}, got {array.shape}")
    if finite and not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0]
        index = f"[{', '.join(str(i) for i in where)}]" if array.ndim else ""
        raise ValueError(f"{name} must be finite, but {name}{index} is {array[tuple(where)]}")
    return array


def _converted(name: str, value: ArrayLike) -> Array:
    try:
        given = np.asarray(value)
        if given.dtype.kind in "cUSmMV":
            raise TypeError("complex numbers, texts, times or records")
        array = np.ascontiguousarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of numbers, got {describe(value)}") from None
    return array.reshape(given.shape)  # ascontiguousarray lifts scalars to one dimension


def per_step_matrices(name: str, value: ArrayLike, steps: int, size: int, *, definite: bool) -> Array:
    """Return `value` as (steps, size, size) symmetric matrices, positive definite or semidefinite.

    `value` may be a number (times the identity), a diagonal (size,), a matrix (size, size) or one matrix a step.
    """
    array = as_array(name, value)
    if array.ndim == 0:
        array = array * np.eye(size)
    elif array.shape == (size,):
        array = np.diag(array)
    if array.shape not in ((size, size), (steps, size, size)):
        raise ValueError(
            f"{name} must be a number, a diagonal ({size},), a matrix ({size}, {size}) or one matrix a step "
            f"({steps}, {size}, {size}), got shape {np.shape(value)}"
        )
    constant = array.ndim == 2
    matrices = array[None] if constant else array
    scale = np.abs(matrices).max(axis=(1, 2), initial=0.0)
    asymmetry = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
    _refuse_first(name, constant, asymmetry > 1e-9 * scale, "must be symmetric", asymmetry, "an asymmetry")
    matrices = 0.5 * (matrices + matrices.transpose(0, 2, 1))
    smallest = np.asarray(np.linalg.eigvalsh(matrices)[:, 0] if size else np.ones(len(matrices)), np.float64)
    if definite:
        wrong, kind = smallest <= 0.0, "must be positive definite"
    else:
        wrong, kind = smallest < -1e-9 * scale, "must be positive semidefinite"
    _refuse_first(name, constant, wrong, kind, smallest, "the eigenvalue")
    return np.array(np.broadcast_to(matrices, (steps, size, size)), order="C")


def per_step_vectors(name: str, value: ArrayLike, steps: int, size: int) -> Array:
    """Return `value`, a number, a vector (size,) or one vector a step (steps, size), as (steps, size)."""
    array = as_array(name, value)
    if array.ndim != 0 and array.shape not in ((size,), (steps, size)):
        raise ValueError(
            f"{name} must be a number, a vector ({size},) or one vector a step ({steps}, {size}), "
            f"got shape {array.shape}"
        )
    return np.array(np.broadcast_to(array, (steps, size)), order="C")


def choose(kind: str, given: str, names: Iterable[str]) -> str:
    """Return `given` if it is one of `names`; otherwise raise, listing the names and the nearest of them."""
    known = list(names)
    if isinstance(given, str) and given in known:
        return given
    near = difflib.get_close_matches(given, known, n=1) if isinstance(given, str) else []
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise ValueError(f"unknown {kind} {_short(given)}; there are: {', '.join(known) or 'none'}{hint}")


def positive(name: str, value: float) -> float:
    """Return `value` as a finite float above zero."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number, got {describe(value)}") from None
    if not (np.isfinite(number) and number > 0.0):
        raise ValueError(f"{name} must be positive and finite, got {value}")
    return number


def nonnegative(name: str, value: float) -> float:
    """Return `value` as a finite float of at least zero."""
    number = finite(name, value)
    if number < 0.0:
        raise ValueError(f"{name} must be at least 0, got {value}")
    return number


def finite(name: str, value: float) -> float:
    """Return `value` as a finite float."""
    array = as_array(name, value)
    if array.ndim:
        raise ValueError(f"{name} must be a number, got shape {array.shape}")
    return float(array)


def count(name: str, value: Any, at_least: int = 1) -> int:
    """Return `value` as an int of at least `at_least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < at_least:
        raise ValueError(f"{name} must be a whole number of at least {at_least}, got {describe(value)}")
    return int(value)


def flag(name: str, value: Any) -> bool:
    """Return `value` if it is True or False."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be True or False, got {describe(value)}")
    return value


def function(name: str, value: Any) -> Callable[..., Any]:
    """Return `value` if it can be called."""
    if not callable(value):
        raise ValueError(f"{name} must be a function, got {describe(value)}")
    called: Callable[..., Any] = value
    return called


def instance(name: str, value: Kind, kind: Any, called: str) -> Kind:
    """Return `value` if it is of a kind, which the message calls `called`."""
    if not isinstance(value, kind):
        raise ValueError(f"{name} must be {called}, got {describe(value)}")
    return value


def numbers(name: str, value: Any) -> NDArray[Any]:
    """Return as an array what the function `name` has returned, or raise ValueError where it is no real numbers."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of unequal length
        array = np.asarray(None)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} must return real numbers, got {describe(value)}")
    return array


def path_of(name: str, value: Any) -> Path:
    """Return the path of a file or folder that `value` is."""
    try:
        text = os.fspath(value)
    except TypeError:
        text = b""
    if not isinstance(text, str) or "\0" in text:
        raise ValueError(f"{name} must be the path of a file, as text or pathlib.Path, got {describe(value)}")
    return Path(text)


def frozen(array: Array) -> Array:
    """Return a read-only view, so that what a frozen dataclass hands out stays as it was checked."""
    view = array.view()
    view.flags.writeable = False
    return view


def refrozen(state: dict[str, Any]) -> dict[str, Any]:
    """Fields of a frozen dataclass that pickle or deepcopy made anew, arrays read-only again."""
    return {name: frozen(value) if isinstance(value, np.ndarray) else value for name, value in state.items()}


def _fits(given: tuple[int, ...], expected: Sequence[int | str]) -> bool:
    return len(given) == len(expected) and all(
        have == want or isinstance(want, str) for have, want in zip(given, expected, strict=True)
    )


def _refuse_first(name: str, constant: bool, wrong: NDArray[np.bool_], kind: str, measure: Array, what: str) -> None:
    if wrong.any():
        step = int(np.argmax(wrong))
        place = name if constant else f"{name}[{step}]"
        raise ValueError(f"{place} {kind}, but has {what} {measure[step]:.3g}")


def describe(value: Any) -> str:
    """The type of a value and the value, cut short, on one line: for messages."""
    return f"{type(value).__name__} {_short(value)}"


def gist(error: BaseException) -> str:
    """What an error says, on one line, with its type where it says little by itself."""
    text = " ".join(str(error).split())
    plain = isinstance(error, (ValueError, TypeError, ArithmeticError, IndexError)) and text
    return text if plain else f"{type(error).__name__}: {text}".removesuffix(": ")


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
