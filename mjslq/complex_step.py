"""Derivatives by complex steps, of functions that users write.

    df/dx = Im f(x + i h) / h,   h so small that nothing of second order is left: exact to rounding, nothing cancels

(Squire and Trapp 1998). It holds for functions that are analytic: no abs, no real parts outside comparisons, and
numpy's functions rather than those of `math`, which know no complex numbers.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.exceptions import ComplexWarning

from mjslq.validation import Array

TINY = 1e-40
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


def complex_step(function: Callable[[Any], Any], z: Array) -> Array:
    """Jacobian of `function` at `z`. Shape (m, len(z))."""
    columns = []
    for i in range(z.size):
        w = z.astype(np.complex128)
        w[i] += 1j * TINY
        columns.append(np.asarray(function(w)).imag / TINY)
    return np.stack(columns, axis=-1)
