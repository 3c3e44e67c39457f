"""Line searches: how far to go along a descent direction, 0 < alpha <= 1.

Notation
--------
    phi(alpha)   merit after a step of size alpha      phi'(0) = slope < 0
    c1, c2       sufficient decrease, curvature

    armijo          halve alpha until phi(alpha) <= phi(0) + c1 alpha phi'(0)
    goldstein       also phi(alpha) >= phi(0) + (1 - c1) alpha phi'(0): not too short, by bisection
    wolfe           armijo, and |phi'(alpha)| <= c2 |phi'(0)| (strong), by bisection
    quadratic-fit   alpha = 1 where phi(1) - phi(0) is about what the model expects; else the minimum of the
                    parabola through phi at 0, alpha/2, alpha, where alpha shrinks until one of them descends
    exact           minimum over (0, 1] by a scan and Brent's method (scipy.optimize.minimize_scalar)

Roundoff rule. Near a minimum the differences of phi drown in rounding while its derivatives still tell. When the
decrease that a step can hope for, |phi'(0)|, is below `ROUNDOFF` |phi(0)|, every search looks at the norm of the
gradient first, and at the cost only if that does not fall. Without this rule all searches stall some digits early.

Sources: Sideris and Bobrow 2005, Algorithm 2, Step 3; Nocedal and Wright, Numerical Optimization, chapter 3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mjslq.solvers.iterate import Iterate
from mjslq.solvers.merit import Merit

Slope = Callable[[Iterate, float], float]

C1 = 1e-4
C1_GOLDSTEIN = 0.1
C2 = 0.9
TRUST = 0.1
"""Relative error of the decrease that a model expects, up to which its step is taken as it is."""
SMALLEST = 1e-10
"""Step below which a search gives up."""
ROUNDOFF = 1e-9


class Trial:
    """phi and its derivative along one direction, counting rollouts and remembering the best iterate."""

    def __init__(
        self,
        merit: Merit,
        here: Iterate,
        slope: float,
        expected: float,
        step: Callable[[Sequence[float]], Sequence[Iterate]],
        slope_at: Slope | None = None,
        at_once: int = 1,
        smallest: float = SMALLEST,
    ) -> None:
        self.here, self.slope, self.expected = here, slope, expected
        self._merit, self.start = merit, merit.value(here)
        self._step, self._slope_at, self._at_once, self.smallest = step, slope_at, at_once, smallest
        self._known: dict[float, Iterate] = {}
        self._asked: dict[float, Iterate] = {}

    def __call__(self, alpha: float) -> Iterate:
        """Iterate after a step of size alpha."""
        self._try([alpha])
        self._asked[alpha] = self._known[alpha]
        return self._known[alpha]

    def ahead(self, *alphas: float) -> None:
        """Simulate steps that will be asked for soon side by side, as many as the engine runs at once."""
        if self._at_once > 1:
            self._try(alphas[: self._at_once])

    def _try(self, alphas: Sequence[float]) -> None:
        new = [alpha for alpha in alphas if alpha not in self._known]
        if new:
            self._known.update(zip(new, self._step(new), strict=True))

    @property
    def evaluations(self) -> int:
        """Rollouts that the search asked for; what threads tried ahead of need does not count."""
        return len(self._asked)

    @property
    def in_roundoff(self) -> bool:
        """Whether the decrease to hope for drowns in the rounding of the merit."""
        return in_roundoff(self.slope, self.start)

    def cost(self, alpha: float) -> float:
        """phi(alpha); infinite where the rollout diverges."""
        return self._merit.value(self(alpha))

    def descends(self, alpha: float, c: float) -> bool:
        """Sufficient decrease, phi(alpha) <= phi(0) + c alpha phi'(0), by more than nothing."""
        cost = self.cost(alpha)
        return cost < self.start and cost <= self.start + c * alpha * self.slope

    def slope_at(self, alpha: float) -> float:
        """phi'(alpha), by a difference unless the step offers better."""
        if self._slope_at is not None:
            return self._slope_at(self(alpha), alpha)
        e = 1e-6 * alpha
        return (self.cost(alpha + e) - self.cost(alpha - e)) / (2.0 * e)

    def best(self) -> float:
        """Step of least cost among those asked for: results must not depend on the number of threads."""
        return min(self._asked, key=lambda alpha: self._merit.value(self._asked[alpha]))


class Found(NamedTuple):
    """Result of a line search."""

    alpha: float
    iterate: Iterate


def search(name: str, trial: Trial) -> Found | None:
    """Find a step by the search called `name`; None when none down to `SMALLEST` will do."""
    alpha = by_gradient_norm(trial) if trial.in_roundoff else None
    if alpha is None:
        alpha = SEARCHES[name](trial)
    return None if alpha is None else Found(float(alpha), trial(alpha))


def in_roundoff(slope: float, cost: float) -> bool:
    """Whether the expected decrease is below the rounding error of the cost."""
    return abs(slope) < ROUNDOFF * abs(cost)


def by_gradient_norm(trial: Trial) -> float | None:
    """The roundoff rule: halve alpha until the gradient is smaller than here and the cost no higher than rounding."""
    alpha, tolerated = 1.0, trial.start + 10.0 * ROUNDOFF * abs(trial.start)
    while alpha > 1e-3:
        there = trial(alpha)
        if there.cost <= tolerated and there.gradient_norm < trial.here.gradient_norm:
            return alpha
        alpha *= 0.5
    return None


def armijo(trial: Trial) -> float | None:
    """Armijo's rule by halving."""
    alpha = 1.0
    while alpha > trial.smallest:
        trial.ahead(alpha, 0.5 * alpha, 0.25 * alpha, 0.125 * alpha)
        if trial.descends(alpha, C1):
            return alpha
        alpha *= 0.5
    return None


def goldstein(trial: Trial) -> float | None:
    """Goldstein's rule by bisection; alpha = 1 may be too short."""
    low, high, alpha = 0.0, 1.0, 1.0
    for _ in range(60):
        if not trial.descends(alpha, C1_GOLDSTEIN):
            high = alpha
        elif trial.cost(alpha) < trial.start + (1.0 - C1_GOLDSTEIN) * alpha * trial.slope and alpha < 1.0:
            low = alpha
        else:
            return alpha
        alpha = 0.5 * (low + high)
        if alpha < trial.smallest:
            return None
    return low or None  # the two bounds met at a kink: the longest step known to descend


def wolfe(trial: Trial) -> float | None:
    """Strong Wolfe conditions by bisection; alpha = 1 may end with a steep slope, there is no going further."""
    low, high, alpha = 0.0, 1.0, 1.0
    for _ in range(60):
        if not trial.descends(alpha, C1):
            high = alpha
        else:
            slope = trial.slope_at(alpha)
            if slope > C2 * abs(trial.slope):
                high = alpha
            elif slope < C2 * trial.slope and alpha < 1.0:
                low = alpha
            else:
                return alpha
        alpha = 0.5 * (low + high)
        if alpha < trial.smallest:
            return None
    return low or None


def quadratic_fit(trial: Trial) -> float | None:
    """Minimum of a parabola through three points, or the best of the points themselves.

    The full step is taken at once where it brings what the model expects of it.
    """
    if abs(trial.cost(1.0) - trial.start - trial.expected) <= TRUST * abs(trial.expected):
        return 1.0
    alpha = 1.0
    while alpha > trial.smallest:
        trial.ahead(alpha, 0.5 * alpha, 0.25 * alpha, 0.125 * alpha)
        start, middle, end = trial.start, trial.cost(0.5 * alpha), trial.cost(alpha)
        if min(middle, end) < start:
            curvature = start - 2.0 * middle + end
            if math.isfinite(curvature) and curvature > 0.0:
                vertex = 0.25 * alpha * (3.0 * start - 4.0 * middle + end) / curvature
                trial.cost(min(max(vertex, 0.05 * alpha), 1.0))
            return trial.best()
        alpha *= 0.25
    return None


def exact(trial: Trial) -> float | None:
    """Minimum over (0, 1]: a geometric scan brackets it, Brent's method refines it."""
    from scipy.optimize import minimize_scalar  # which takes as long to import as all the rest

    grid = [2.0**-i for i in range(12)]
    trial.ahead(*grid)
    costs = [trial.cost(alpha) for alpha in grid]
    least = min(range(len(grid)), key=costs.__getitem__)
    if not costs[least] < trial.start:
        return armijo(trial)
    upper = grid[max(least - 1, 0)]
    lower = grid[least + 1] if least + 1 < len(grid) else 0.0
    with np.errstate(invalid="ignore"):  # a rollout that diverges within the bounds costs infinity
        minimize_scalar(trial.cost, bounds=(lower, upper), method="bounded", options={"xatol": 1e-6 * upper})
    return trial.best()


SEARCHES: dict[str, Callable[[Trial], float | None]] = {
    "quadratic-fit": quadratic_fit,
    "armijo": armijo,
    "goldstein": goldstein,
    "wolfe": wolfe,
    "exact": exact,
}
