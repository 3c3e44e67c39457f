"""Derivatives by complex steps, of functions that users write.

    df/dx = Im f(x + i h) / h,   h so small that nothing of second order is left: exact to rounding, nothing cancels

(Squire and Trapp 1998). It holds for functions that are analytic: no abs, no real parts outside comparisons, and
numpy's functions rather than those of `math`, which know no complex numbers.

A step along all entries at once, of another size, has to agree with the sum of the others. It does not where f has an
imaginary part of its own, as numba's z**3 has for z < 0: a power by logarithms, with a rounding error of 1e-16.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.exceptions import ComplexWarning
from numpy.typing import NDArray

from mjslq.validation import Array

TINY = 1e-40
OTHER = 1e-30
"""Size of the step that checks the others; see `unscaled`."""
DIFFERENCE = 6e-6
"""Relative step of the central differences of first derivatives that make second ones."""


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


def complex_step(function: Callable[[Any], Any], z: Array) -> tuple[Array, Array]:
    """Jacobian of `function` at `z`, and its derivative along all entries at once. Shapes (m, len(z)), (m,)."""
    columns = []
    for i in range(z.size):
        w = z.astype(np.complex128)
        w[i] += 1j * TINY
        columns.append(np.asarray(function(w)).imag / TINY)
    return np.stack(columns, axis=-1), np.asarray(function(z + 1j * OTHER)).imag / OTHER


def unscaled(J: Array, along: Array) -> NDArray[np.bool_]:
    """Where a derivative along all entries, by a step of another size, is not the sum of those along each.

    Shapes (..., m, n), (..., m) -> (..., m).
    """
    disagree: NDArray[np.bool_] = np.abs(J.sum(axis=-1) - along) > 1e-8 * (1.0 + np.abs(J).sum(axis=-1))
    return disagree
