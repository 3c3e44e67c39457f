"""Derivatives by complex steps, of functions that users write, and how they are held against real differences.

    df/dx = Im f(x + i h) / h,   h so small that nothing of second order is left: exact to rounding, nothing cancels

(Squire and Trapp 1998). It holds for functions that are analytic: no abs, no real parts outside comparisons, and
numpy's functions rather than those of `math`, which know no complex numbers.

A step along all entries at once, of another size, has to agree with the sum of the others. It does not where f has an
imaginary part of its own, as numba's z**3 has for z < 0: a power by logarithms, with a rounding error of 1e-16.

A function that is not analytic has a derivative all the same, which complex steps miss without a word: that of abs
comes out as zero. So the slope J d along one direction d, in which every entry moves, is compared with

    c(e) = [f(z + e d) - f(z - e d)] / 2e

at every point. J is wrong where the two differ by more than rounding and truncation explain: truncation shrinks with
e, rounding with 1/e, a wrong derivative with neither. At a kink any slope between the two one-sided ones is right.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
from numpy.exceptions import ComplexWarning
from numpy.typing import NDArray

from mjslq.validation import Array, frozen

Values = Callable[[NDArray[np.intp], Array], Array]
"""A function at some of its points, moved: (which points (j,), where they are now (j, n)) -> values (j, m)."""

TINY = 1e-40
SMALL = 1e-20
"""Step of the derivatives whose differences make second ones. Beside z = 0 they are taken at z < 0 too, where numba's
z**3 has an imaginary part of 1e-16 z**3, which is nothing beside this one."""
OTHER = 1e-30
"""Size of the step that checks the others; see `unscaled`."""
DIFFERENCE = 6e-6
"""Relative step of central differences: of values, and of first derivatives that make second ones."""
SECOND_DIFFERENCE = 1.2e-4
"""Relative step of second differences of values."""
_OTHER_STEPS = (1e-4, 1e-6, 1e-7, 1e-8)
_AGREE = 1e-5
"""Relative difference up to which two slopes count as the same."""
_ROUNDING = 50.0 * np.finfo(np.float64).eps


@contextmanager
def refused_complex(what: str, remedy: str) -> Iterator[None]:
    """Turn a function's refusal of complex numbers, loud or silent, into a ValueError that names the remedy."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", ComplexWarning)
            yield
    except (TypeError, ComplexWarning) as error:
        raise ValueError(
            f"{what} cannot be differentiated by complex steps ({error}): write it with numpy's functions, analytic "
            f"in x and u, or use {remedy}"
        ) from None


def complex_step(function: Callable[[Any], Any], z: Array, step: float = TINY) -> Array:
    """Jacobian of `function` at `z`. Shape (m, len(z))."""
    columns = []
    for i in range(z.size):
        w = z.astype(np.complex128)
        w[i] += 1j * step
        columns.append(np.asarray(function(w)).imag / step)
    return np.stack(columns, axis=-1)


def complex_step_along(function: Callable[[Any], Any], z: Array) -> Array:
    """Derivative of `function` at `z` along all entries at once, by a step of another size. Shape (m,)."""
    along: Array = np.asarray(function(z + 1j * OTHER)).imag / OTHER
    return along


def unscaled(J: Array, along: Array) -> NDArray[np.bool_]:
    """Where a derivative along all entries, by a step of another size, is not the sum of those along each.

    Shapes (..., m, n), (..., m) -> (..., m).
    """
    disagree: NDArray[np.bool_] = np.abs(J.sum(axis=-1) - along) > 1e-8 * (1.0 + np.abs(J).sum(axis=-1))
    return disagree


def wrong_slopes(values: Values, Z: Array, J: Array, scale: Array | None = None) -> NDArray[np.bool_]:
    """Where Jacobians J (k, m, n) at the points Z (k, n) are not those of real differences; see the head of this file.

    `scale` (k, m) is what slopes are measured by, |J| |d| unless given. Costs two values a point where all is well.
    Points beside which the function raises, or is not finite, are not judged. Shape (k, m).
    """
    D = _directions(Z)
    with np.errstate(all="ignore"):
        slope = np.einsum("kmn,kn->km", J, D)
        scale = np.einsum("kmn,kn->km", np.abs(J), np.abs(D)) if scale is None else scale
        parts = np.einsum("kmn,kn->km", np.abs(J), np.abs(Z))  # values may be small differences of such
        try:
            wrong, gap = _compare(values, np.arange(len(Z)), Z, D, slope, scale, parts)
            at = np.flatnonzero(wrong.any(axis=1))
            if at.size:
                wrong[at] &= _examine(values, at, Z[at], D[at], slope[at], scale[at], parts[at], gap[at])
        except (ArithmeticError, ValueError, IndexError):
            return np.zeros(slope.shape, dtype=bool)
    return wrong


def central_differences(values: Values, Z: Array) -> Array:
    """Jacobians at the points Z (k, n) by central differences; relative error about 1e-10. Shape (k, m, n)."""
    everywhere, columns = np.arange(len(Z)), []
    for e in _moves(Z, DIFFERENCE):
        columns.append((values(everywhere, Z + e) - values(everywhere, Z - e)) / (2.0 * e.sum(axis=1)[:, None]))
    return np.stack(columns, axis=-1)


def second_differences(values: Values, Z: Array, weights: Array) -> Array:
    """Hessians of w_k'f at the points Z (k, n) for weights (k, m); relative error about 1e-7. Shape (k, n, n)."""
    everywhere, moves = np.arange(len(Z)), _moves(Z, SECOND_DIFFERENCE)
    H = np.empty((len(Z), len(moves), len(moves)))

    def weighed(points: Array) -> Array:
        total: Array = np.einsum("km,km->k", weights, values(everywhere, points))
        return total

    for i, a in enumerate(moves):
        for j, b in enumerate(moves[: i + 1]):
            mixed = weighed(Z + a + b) - weighed(Z + a - b) - weighed(Z - a + b) + weighed(Z - a - b)
            H[:, i, j] = H[:, j, i] = mixed / (4.0 * a.sum(axis=1) * b.sum(axis=1))
    return H


def _moves(Z: Array, relative: float) -> list[Array]:
    """A step along each entry, scaled by it. n arrays of shape (k, n)."""
    return [relative * np.maximum(1.0, np.abs(Z)) * unit for unit in np.eye(Z.shape[1])]


@cache
def _generic(n: int) -> Array:
    """A direction in which every entry moves. Shape (n,)."""
    rng = np.random.default_rng(n)
    return frozen(rng.uniform(0.5, 1.5, n) * rng.choice([-1.0, 1.0], n))


def _directions(Z: Array) -> Array:
    """The same direction at every point, scaled by its entries. Shape (k, n)."""
    directions: Array = _generic(Z.shape[1]) * np.maximum(1.0, np.abs(Z))
    return directions


def _moved(values: Values, at: NDArray[np.intp], Z: Array, D: Array, sizes: tuple[float, ...]) -> Array:
    """Values at Z + e D for each e of `sizes`, in one call. Shape (number of sizes, k, m)."""
    points = np.concatenate([Z + e * D for e in sizes])
    return values(np.tile(at, len(sizes)), points).reshape(len(sizes), len(at), -1)


def _compare(
    values: Values, at: NDArray[np.intp], Z: Array, D: Array, slope: Array, scale: Array, parts: Array
) -> tuple[NDArray[np.bool_], Array]:
    """Where slopes are not those of differences, and by how much. Shapes (k, m), (k, m)."""
    plus, minus = _moved(values, at, Z, D, (DIFFERENCE, -DIFFERENCE))
    central = (plus - minus) / (2.0 * DIFFERENCE)
    gap = np.abs(slope - central)
    same = gap <= _AGREE * scale + _ROUNDING / DIFFERENCE * _size(plus, minus, parts)
    return np.isfinite(central) & ~(same & np.isfinite(slope)), gap


def _examine(
    values: Values,
    at: NDArray[np.intp],
    Z: Array,
    D: Array,
    slope: Array,
    scale: Array,
    parts: Array,
    gap: Array,
) -> NDArray[np.bool_]:
    """Look closer at points where `_compare` found gaps: whether nothing explains them. Shape (k, m)."""
    sizes, wrong = (DIFFERENCE, *_OTHER_STEPS), np.ones(slope.shape, dtype=bool)
    here, *beside = _moved(values, at, Z, D, (0.0, *sizes, *(-e for e in sizes)))
    for e, plus, minus in zip(sizes, beside[: len(sizes)], beside[len(sizes) :], strict=True):
        sides = np.sort([(plus - here) / e, (here - minus) / e], axis=0)
        rounding = _ROUNDING / e * _size(plus, minus, parts)
        allowed = _AGREE * scale + rounding
        between = (sides[0] - allowed <= slope) & (slope <= sides[1] + allowed) & (e <= DIFFERENCE)  # of a kink
        same = np.abs(slope - 0.5 * (sides[0] + sides[1])) <= np.maximum(allowed, 0.1 * gap)
        wrong &= ~((between | same) & np.isfinite(slope) & (rounding < 0.1 * gap))
    return wrong


def _size(plus: Array, minus: Array, parts: Array) -> Array:
    """Size of the numbers whose rounding is in a difference. Shape (k, m)."""
    size: Array = np.maximum(np.maximum(np.abs(plus), np.abs(minus)), np.where(np.isfinite(parts), parts, 0.0))
    return size
