"""`trust-region`: the second-order algorithm of Fukushima and Yamamoto (1986), globally convergent.

    0  u given, Delta > 0
    1  roll out u, find the costates                                                                   (2.1), (2.4)
    2  v <- minimizer of Q(v) over ||v|| <= Delta, Q the second-order expansion of J at u              (2.5), (2.10)
    3  rho <- (J(u + v) - J(u)) / Q(v)                                                                 (2.9)
    4  rho < eta_1:            Delta <- gamma_1 Delta,  u stays
       eta_1 <= rho < eta_2:   Delta stays,             u <- u + v
       rho >= eta_2:           Delta <- gamma_2 Delta,  u <- u + v

Notation
--------
    Q(v)          g'v + 1/2 v'H v, from LQ sweeps with the Hessians of the Hamiltonian (`newton`), or without the
                  dynamics' second derivatives ("gauss-newton")
    ||v||         the norm of L2[0, T]: ||v||^2 = sum_n h_n v_n'v_n
    eta, gamma    (0.25, 0.75) and (0.25, 2), Fletcher's values, which the paper suggests

Step 2 is `mjslq.lq.trust_region`. Step 4 enlarges a ball that did not limit the step, too, as the paper does; that
costs nothing, since only a ball that limits is ever felt. One iteration is one solution of step 2, whether its step
is accepted or not.

Where the decrease to hope for drowns in the rounding of J, rho is noise: the step is then accepted if the gradient
falls (the roundoff rule of `linesearch`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mjslq.lq.trust_region import solve_in_ball
from mjslq.solvers.advance import kind_of_step, take
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import ROUNDOFF, in_roundoff
from mjslq.solvers.loop import Accepted, Monitor, Outcome, Stopping, descend
from mjslq.validation import choose, positive

HESSIANS = ("newton", "gauss-newton")
WORST = -1e9
"""Ratio told of a step to where there is no finite cost, or from where there is none to hope for."""
SMALLEST = 1e-14
"""Radius, relative to the norm of the controls, below which there is no going on."""


def trust_region(
    start: Iterate,
    stopping: Stopping,
    monitor: Monitor,
    *,
    radius: float = 1.0,
    eta: tuple[float, float] = (0.25, 0.75),
    gamma: tuple[float, float] = (0.25, 2.0),
    hessian: str = "newton",
    step: str = "auto",
) -> Outcome:
    """Minimize from `start`.

    Parameters
    ----------
    radius : float
        Delta^0, the first radius, in the norm above.
    eta : (float, float)
        Ratios from which on a step is accepted, and the ball enlarged; 0 < eta_1 < eta_2 < 1.
    gamma : (float, float)
        Factors by which the ball shrinks and grows; 0 < gamma_1 < 1 < gamma_2.
    hessian : str
        "newton" or "gauss-newton".
    step : str
        "open-loop", the paper's u + v; "closed-loop", v under the sweep's feedback; or "auto": closed loop on the
        engines that simulate robots, open loop elsewhere.
    """
    radius = positive("radius", radius)
    eta_1, eta_2 = _pair("eta", eta, lambda low, high: 0.0 < low < high < 1.0, "0 < eta_1 < eta_2 < 1")
    shrink, grow = _pair("gamma", gamma, lambda low, high: 0.0 < low < 1.0 < high, "0 < gamma_1 < 1 < gamma_2")
    choose("hessian", hessian, HESSIANS)
    kind = kind_of_step(start, step)
    weights = np.array(start.problem.dynamics.steps(start.problem.horizon))
    multiplier = 0.0

    def direction(here: Iterate) -> Direction:
        nonlocal multiplier
        model = here.newton if hessian == "newton" else here.gauss_newton
        found = solve_in_ball(model, radius, weights, multiplier)
        multiplier = found.multiplier
        return Direction(found.U, found.k, found.K, multiplier, found.value, radius, multiplier > 0.0)

    def advance(here: Iterate, ahead: Direction) -> tuple[Accepted | None, int]:
        nonlocal radius
        there = take(here, ahead, [1.0], kind)[0]
        ratio = _ratio(here, there, ahead.predicted)
        if ratio < eta_1:
            radius *= shrink
            size = math.sqrt(float(weights @ (here.trajectory.U**2).sum(axis=1)))
            if radius < SMALLEST * max(size, 1e-6):
                return None, 1
            return Accepted(0.0, here, ratio), 1
        if ratio >= eta_2:
            radius = min(radius * grow, 1e100)
        return Accepted(1.0, there, ratio), 1

    return descend(start, direction, advance, stopping, monitor)


def _ratio(here: Iterate, there: Iterate, predicted: float) -> float:
    """(2.9); one or zero where rounding leaves only the gradient to tell."""
    if not math.isfinite(there.cost) or not predicted < 0.0:
        return WORST
    ratio = (there.cost - here.cost) / predicted
    if not in_roundoff(predicted, here.cost):
        return ratio
    tolerated = here.cost + 10.0 * ROUNDOFF * abs(here.cost)
    if there.cost <= tolerated and there.gradient_norm < here.gradient_norm:
        return 1.0
    return min(ratio, 0.0)


def _pair(name: str, given: Any, fits: Any, what: str) -> tuple[float, float]:
    try:
        low, high = (float(value) for value in given)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a pair of numbers with {what}, got {given!r}") from None
    if not fits(low, high):
        raise ValueError(f"{name} must be a pair of numbers with {what}, got {given!r}")
    return low, high
