"""Losses: functions that turn a residual into a cost.

Notation
--------
    r        residual at a knot. Shape (m,)
    W        its weight, positive semidefinite; w the mean of W's diagonal, S = W / w (1 for a number)
    s        length of the residual, sqrt(r'S r);  d the width, in the residual's unit
    c        scale of the knot: length of its step for an integral, 1 for a value

    loss             cost / (c w)                                        rho'/s                  far out
    quadratic        s^2/2                                               1                       s^2/2
    huber            s^2/2 for s <= d, else d (s - d/2)                  min(1, d/s)             d |s|
    pseudo-huber     d^2 (sqrt(1 + s^2/d^2) - 1)                         d / sqrt(s^2 + d^2)     d |s|
    smooth-abs       sqrt(s^2 + d^2) - d                                 1 / sqrt(s^2 + d^2)     |s|

    slope       p = c w (rho'/s) S r
    curvature   H = c w [ (rho'/s) S + (rho'' - rho'/s)/s^2 (S r)(S r)' ] = (c w rho'/s) S + bend p p'

The slope grows no further beyond the width: a residual that cannot be made small, such as an outlier among targets,
pulls with a bounded force. All of them are convex, so that H is positive semidefinite, and so is its Gauss-Newton
product J'H J. (Huber 1964; the smooth ones as in Charbonnier et al. 1997.)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from mjslq.quadratic import weighted
from mjslq.validation import Array, choose, positive

LossName = Literal["quadratic", "smooth-abs", "huber", "pseudo-huber"]
WIDTH = 0.1
"""Width of a loss unless given, in the residual's unit."""


class LossCurvature(NamedTuple):
    """Second derivatives of a loss by the residuals: scales_n W_n + bend_n p_n p_n', with p_n the slope."""

    scales: Array
    """Shape (k,)."""
    W: Array
    """One a knot, or one for all of them. Shape (k, m, m) | (1, m, m)."""
    bend: Array | None
    """None stands for zero. Shape (k,)."""


class Loss(ABC):
    """Cost of the residuals at k knots, weights and scales of the knots included."""

    constant: bool = False
    """Whether the curvature is the same for all residuals."""

    @abstractmethod
    def value(self, r: Array) -> Array:
        """Cost at each knot, of residuals of shape (k, m). Shape (k,)."""

    def total(self, r: Array) -> float:
        """Sum of `value`."""
        return float(self.value(r).sum())

    @abstractmethod
    def slope(self, r: Array) -> Array:
        """Derivative of the cost by the residuals. Shape (k, m)."""

    @abstractmethod
    def curvature(self, r: Array) -> LossCurvature:
        """Second derivatives of the cost by the residuals."""


class Quadratic(Loss):
    """c/2 r'W r."""

    constant = True

    def __init__(self, W: Array, scales: Array) -> None:
        self._W, self._scales = W, scales
        uniform = len(W) == 1 and (scales == scales[0]).all()
        self._same: Array | None = scales[0] * W[0] if uniform else None
        """c W, where it is the same at all knots."""

    def value(self, r: Array) -> Array:
        """See `Loss.value`."""
        return 0.5 * np.vecdot(r, self.slope(r))

    def total(self, r: Array) -> float:
        """See `Loss.total`."""
        return 0.5 * float(np.vdot(r, self.slope(r)))

    def slope(self, r: Array) -> Array:
        """See `Loss.slope`."""
        return weighted(self._scales, self._W, r) if self._same is None else r @ self._same

    def curvature(self, r: Array) -> LossCurvature:
        """See `Loss.curvature`."""
        return LossCurvature(self._scales, self._W, None)


class Shape(NamedTuple):
    """A loss of the length s with weight and scale 1, as functions of (s^2, d) over all knots at once."""

    value: Callable[[Array, float], Array]
    """rho."""
    ratio: Callable[[Array, float], Array]
    """rho'/s."""
    bend: Callable[[Array, float], Array]
    """(rho'' - rho'/s)/s^2 over (rho'/s)^2: never above zero."""


class Robust(Loss):
    """c w rho(s), for the losses that grow like |s|."""

    def __init__(self, shape: Shape, width: float, W: Array, scales: Array) -> None:
        w = float(np.trace(W[0])) / W.shape[1]
        self._shape, self._width, self._S, self._scales = shape, width, W / w, scales * w

    def value(self, r: Array) -> Array:
        """See `Loss.value`."""
        return self._scales * self._shape.value(self._squares(r), self._width)

    def slope(self, r: Array) -> Array:
        """See `Loss.slope`."""
        return weighted(self._scales * self._shape.ratio(self._squares(r), self._width), self._S, r)

    def curvature(self, r: Array) -> LossCurvature:
        """See `Loss.curvature`."""
        squares = self._squares(r)
        scales = self._scales * self._shape.ratio(squares, self._width)
        return LossCurvature(scales, self._S, self._shape.bend(squares, self._width) / self._scales)

    def _squares(self, r: Array) -> Array:
        return np.maximum(np.vecdot(r @ self._S[0], r), 0.0)


def _rounded(squares: Array, d: float) -> Array:
    return np.sqrt(squares + d * d)


def _smooth_abs(squares: Array, d: float) -> Array:
    return squares / (_rounded(squares, d) + d)  # sqrt(s^2 + d^2) - d without the cancellation


def _huber(squares: Array, d: float) -> Array:
    return np.where(squares <= d * d, 0.5 * squares, d * (np.sqrt(squares) - 0.5 * d))


def _huber_ratio(squares: Array, d: float) -> Array:
    return d / np.sqrt(np.maximum(squares, d * d))


def _huber_bend(squares: Array, d: float) -> Array:
    return np.where(squares <= d * d, 0.0, -1.0 / (d * np.sqrt(np.maximum(squares, d * d))))


def _smooth_abs_ratio(squares: Array, d: float) -> Array:
    return 1.0 / _rounded(squares, d)


def _smooth_abs_bend(squares: Array, d: float) -> Array:
    return -1.0 / _rounded(squares, d)


def _pseudo_huber(squares: Array, d: float) -> Array:
    return d * _smooth_abs(squares, d)


def _pseudo_huber_ratio(squares: Array, d: float) -> Array:
    return d / _rounded(squares, d)


def _pseudo_huber_bend(squares: Array, d: float) -> Array:
    return -1.0 / (d * _rounded(squares, d))


SHAPES = {
    "smooth-abs": Shape(_smooth_abs, _smooth_abs_ratio, _smooth_abs_bend),
    "huber": Shape(_huber, _huber_ratio, _huber_bend),
    "pseudo-huber": Shape(_pseudo_huber, _pseudo_huber_ratio, _pseudo_huber_bend),
}
NAMES = ("quadratic", *SHAPES)


def bind_loss(name: str, width: float | None, W: Array, scales: Array) -> Loss:
    """The loss called `name`, of residuals with weights W (1, m, m) or (k, m, m) and scales (k,).

    Raises ValueError for an unknown name, a width that is not above zero, or a width for the quadratic loss. Losses
    other than the quadratic one take one weight for all knots.
    """
    check_loss(name, width)
    if name == "quadratic":
        return Quadratic(W, scales)
    return Robust(SHAPES[name], WIDTH if width is None else float(width), W, scales)


def check_loss(name: str, width: float | None) -> None:
    """Raise ValueError for an unknown loss, or a width that does not go with it."""
    choose("loss", name, NAMES)
    if width is None:
        return
    if name == "quadratic":
        raise ValueError(
            f"width is for the losses {', '.join(SHAPES)}; the quadratic loss, which is the default, has none"
        )
    positive("width", width)
