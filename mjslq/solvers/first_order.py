"""Update rules of the first-order methods, from curve to curve: each gives the change to go along, and learns from it.

Notation
--------
    g_k         projected gradient by the curve (alpha, mu) at iterate k; w_k its part by mu
    d_k         change of the curve;  s_k = gamma_k d_k the step taken
    <.,.>       Euclidean inner product over both parts of a curve

    gradient        d = -g
    conjugate       d = -g + beta d_{k-1},  beta = max(0, <g, g - g_{k-1}> / <g_{k-1}, g_{k-1}>)               (23)
    heavy-ball      s = -gamma g + rho s_{k-1}                                                                 (24)
    nesterov        g at the curve xi_k + beta_k (xi_k - xi_{k-1}),  beta_k = k / (k + 3)                (25), (26)
    quasi-newton    d = -H w in the feedforward mu alone, alpha stays: H from the last `MEMORY` changes of w (L-BFGS),
                    upon the inverse of the gains' metric G_n where there is one, or a multiple of the identity

Conjugacy. On a cost that is not quadratic it is lost: the conjugate rule starts anew with the gradient where
|<g, g_{k-1}>| > `CONJUGATE` <g, g> (Powell's test) or d does not descend. Momentum starts anew where the cost rises or
it does not descend, unless that is switched off.

Quasi-Newton. On plain states the trajectory depends on a curve through mu + K alpha alone, and the gradient by it is w.
In these closed-loop coordinates the Hessian is nearly the block-diagonal metric of the gains (`solvers.regulator`).

Sources: Hestenes and Stiefel 1952, Polak and Ribiere 1969; Powell 1977, "Restart procedures for the conjugate gradient
method"; Polyak 1964; Nesterov 1983; O'Donoghue and Candes 2015, "Adaptive restart for accelerated gradient schemes";
Nocedal 1980, "Updating quasi-Newton matrices with limited storage"; the equations are Sforni et al.'s, "GoPRONTO".
"""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mjslq.solvers.projection import Curve, CurveIterate
from mjslq.validation import Array

CONJUGATE = 0.2
"""Of the conjugacy test."""
MEMORY = 20
"""Pairs that the quasi-Newton rule keeps."""
CURVED = 1e-10
"""Least cosine between a step and the change of the gradient that a pair is kept with."""


class Gradient:
    """Steepest descent; and what all rules have in common."""

    natural = False
    """Whether a step of size 1 is the one to try first."""

    def __init__(self, restarts: bool = True) -> None:
        self.restarts = restarts
        self.number = 0
        """How often the rule started anew."""

    def change(self, here: CurveIterate) -> Curve:
        """d_k at an iterate."""
        return here.slope.scaled(-1.0)

    def took(self, here: CurveIterate, step: Curve, there: CurveIterate) -> None:
        """Learn from the step `step` = gamma d from `here` to `there`."""
        return

    def restart(self) -> None:
        """Forget the past."""
        return


class Conjugate(Gradient):
    """Polak and Ribiere's conjugate directions."""

    def __init__(self, restarts: bool = True) -> None:
        super().__init__(restarts)
        self._last: tuple[Curve, Curve] | None = None
        self._latest: Curve | None = None

    def change(self, here: CurveIterate) -> Curve:
        """See `Gradient.change`."""
        self._latest = self._conjugate(here.slope)
        return self._latest

    def _conjugate(self, g: Curve) -> Curve:
        if self._last is None:
            return g.scaled(-1.0)
        before, along = self._last
        size = g.dot(g)
        if self.restarts and abs(g.dot(before)) > CONJUGATE * size:
            self.number += 1
            return g.scaled(-1.0)
        beta = max(0.0, (size - g.dot(before)) / max(before.dot(before), 1e-300))
        d = g.scaled(-1.0).plus(along, beta)
        if g.dot(d) < 0.0:
            return d
        self.number += 1
        return g.scaled(-1.0)

    def took(self, here: CurveIterate, step: Curve, there: CurveIterate) -> None:
        """See `Gradient.took`."""
        assert self._latest is not None
        self._last = here.slope, self._latest

    def restart(self) -> None:
        """See `Gradient.restart`."""
        self._last = None


class QuasiNewton(Gradient):
    """L-BFGS in the feedforward, upon the metric of the gains."""

    natural = True

    def __init__(self, restarts: bool = True) -> None:
        super().__init__(restarts)
        self._pairs: deque[tuple[Array, Array, float]] = deque(maxlen=MEMORY)
        self._factors: list[tuple[Array, bool]] | None = None

    def use(self, G: Array | None) -> None:
        """Take the metric of new gains. Shape (N, nu, nu)."""
        self._factors = None if G is None else [cho_factor(block, lower=True) for block in G]

    def change(self, here: CurveIterate) -> Curve:
        """See `Gradient.change`: the two loops of L-BFGS."""
        w = here.projected_gradient
        free, q, kept = w != 0.0, w.copy(), []
        for s, y, rho in reversed(self._pairs):
            a = rho * float(np.vdot(s, q))
            kept.append((a, s, y, rho))
            q -= a * y
        d = self._scaled(q)
        for a, s, y, rho in reversed(kept):
            d += (a - rho * float(np.vdot(y, d))) * s
        d = np.where(free, -d, 0.0)
        if not np.vdot(d, w) < 0.0:
            self.number += 1
            self._pairs.clear()
            d = np.where(free, -self._scaled(w), 0.0)
        return Curve(np.zeros_like(here.slope.alpha), d)

    def took(self, here: CurveIterate, step: Curve, there: CurveIterate) -> None:
        """See `Gradient.took`."""
        s, y = here.feedforward(step), there.gradient - here.gradient
        curvature = float(np.vdot(s, y))
        if curvature > CURVED * float(np.linalg.norm(s) * np.linalg.norm(y)):
            self._pairs.append((s, y, 1.0 / curvature))

    def restart(self) -> None:
        """See `Gradient.restart`."""
        self._pairs.clear()

    def _scaled(self, q: Array) -> Array:
        if self._factors is not None:
            return np.stack([cho_solve(factor, part) for factor, part in zip(self._factors, q, strict=True)])
        if not self._pairs:
            return q.copy()
        s, y, _ = self._pairs[-1]
        return float(np.vdot(s, y) / np.vdot(y, y)) * q


class HeavyBall(Gradient):
    """Momentum: a share of the step before."""

    def __init__(self, restarts: bool = True, momentum: float = 0.9) -> None:
        super().__init__(restarts)
        self.momentum = momentum
        self.last: Curve | None = None
        """s_{k-1}."""

    def took(self, here: CurveIterate, step: Curve, there: CurveIterate) -> None:
        """See `Gradient.took`."""
        if self.restarts and there.cost > here.cost:
            self.number += 1
            self.last = None
            return
        self.last = step

    def restart(self) -> None:
        """See `Gradient.restart`."""
        self.last = None


class Nesterov(HeavyBall):
    """Nesterov's extrapolation; iterates are the extrapolated curves, at which gradients are taken."""

    def __init__(self, restarts: bool = True) -> None:
        super().__init__(restarts, 0.0)
        self.k = 0

    def ahead(self, step: Curve) -> Curve:
        """Where to take the next gradient, from the present one: the step -gamma g there and the extrapolation."""
        way = step if self.last is None else self.last.plus(step)  # xi_{k+1} - xi_k: what was ahead, and the step
        self.last = way.scaled(self.k / (self.k + 3.0))
        self.k += 1
        return step.plus(self.last)

    def took(self, here: CurveIterate, step: Curve, there: CurveIterate) -> None:
        """See `Gradient.took`; `ahead` has learnt already."""
        return

    def restart(self) -> None:
        """See `Gradient.restart`."""
        self.last, self.k = None, 0


RULES: dict[str, type[Gradient]] = {
    "gradient": Gradient, "conjugate": Conjugate, "heavy-ball": HeavyBall, "nesterov": Nesterov,
    "quasi-newton": QuasiNewton,
}  # fmt: skip
