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

Step 2 is `mjslq.lq.trust_region`, within the limits of the controls. Step 4 enlarges a ball that did not limit the
step, too, as the paper does; that costs nothing, since only a ball that limits is ever felt. One iteration is one
solution of step 2, whether its step is accepted or not.

Where the decrease to hope for drowns in the rounding of J, rho is noise: the step is then accepted if the gradient
falls (the roundoff rule of `linesearch`).
"""

from __future__ import annotations

import math

import numpy as np

from mjslq.lq.regularize import Damped
from mjslq.lq.trust_region import solve_in_ball
from mjslq.options import TrustRegionOptions
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import ROUNDOFF, in_roundoff
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Method, Step
from mjslq.solvers.steps import candidates

HOPELESS = -1e9
"""Ratio reported when the cost is not finite or no decrease is predicted."""
SMALLEST = 1e-14
"""Radius, relative to the norm of the controls, below which there is no going on."""


class TrustRegion(Method):
    """The trust-region method; keeps its radius from iteration to iteration."""

    def __init__(self, options: TrustRegionOptions) -> None:
        self.options = options
        self.radius, self._multiplier = options.radius, 0.0

    def direction(self, here: Iterate) -> Direction:
        """Step 2; the multiplier of the ball before is a good guess for the next."""
        model = here.newton if self.options.hessian == "newton" else here.gauss_newton
        ball = solve_in_ball(model, here.box, self.radius, np.array(here.trajectory.dt), self._multiplier)
        self._multiplier = ball.multiplier
        ahead = Direction.to(model, Damped(ball.found, 0.0, ball.multiplier), radius=self.radius)
        return ahead._replace(limited=ball.multiplier > 0.0)

    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """Steps 3 and 4."""
        (eta_1, eta_2), (shrink, grow) = self.options.eta, self.options.gamma
        there = candidates(here, direction, [1.0], self.options.step)[0]
        ratio = _ratio(here, there, direction.expected)
        if ratio >= eta_1:
            if ratio >= eta_2:
                self.radius = min(self.radius * grow, 1e100)
            return Step(there, 1.0, 1, ratio)
        self.radius *= shrink
        size = math.sqrt(float(here.trajectory.dt @ (here.trajectory.U**2).sum(axis=1)))
        if self.radius < SMALLEST * max(size, 1e-6):
            return Step(None, 0.0, 1, ratio)
        return Step(here, 0.0, 1, ratio, rejected=True)


def _ratio(here: Iterate, there: Iterate, expected: float) -> float:
    """(2.9); one or zero where rounding leaves only the gradient to tell."""
    if not math.isfinite(there.cost) or not expected < 0.0:
        return HOPELESS
    ratio = (there.cost - here.cost) / expected
    if not in_roundoff(expected, here.cost):
        return ratio
    tolerated = here.cost + 10.0 * ROUNDOFF * abs(here.cost)
    if there.cost <= tolerated and there.gradient_norm < here.gradient_norm:
        return 1.0
    return min(ratio, 0.0)
