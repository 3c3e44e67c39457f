"""Quotients and roots of complex numbers, for compiled code: without the exceptions of Python's own.

The formulas are Python's and numpy's, so that results are theirs bit for bit where these raise nothing.
"""

from __future__ import annotations

import math

from mjslq.dynamics.mujoco.inverse.spatial import compiled


@compiled
def divide(a, b):
    """The quotient a / b; nan where b is zero (Smith 1962, Algorithm 116)."""
    if abs(b.real) >= abs(b.imag):
        ratio = b.imag / b.real
        size = b.real + b.imag * ratio
        return complex((a.real + a.imag * ratio) / size, (a.imag - a.real * ratio) / size)
    if abs(b.imag) >= abs(b.real):
        ratio = b.real / b.imag
        size = b.real * ratio + b.imag
        return complex((a.real * ratio + a.imag) / size, (a.imag * ratio - a.real) / size)
    return complex(math.nan, math.nan)


@compiled
def root(z):
    """The square root with a real part >= 0, of a finite number well below the largest (CACM Algorithm 312)."""
    if z.real == 0.0 and z.imag == 0.0:
        return complex(0.0, z.imag)
    if z.real >= 0.0:
        t = math.sqrt((z.real + math.hypot(z.real, z.imag)) * 0.5)
        return complex(t, z.imag / (2.0 * t))
    t = math.sqrt((-z.real + math.hypot(z.real, z.imag)) * 0.5)
    return complex(abs(z.imag) / (2.0 * t), math.copysign(t, z.imag))
