"""An LQ problem over a ball: the multiplier of More and Sorensen, found with Newton's method on Riccati sweeps.

Problem
-------
    minimize Q(v)  subject to  ||v|| <= Delta,      ||v||^2 = sum_n w_n v_n'v_n

where Q(v) is the cost of an `LQProblem` with the states eliminated, g'v + 1/2 v'H v, and H need not be positive
definite; with w_n = h_n the norm is that of L2[0, T]. v solves it exactly if for some alpha >= 0

    (H + alpha W) v = -g,    alpha (Delta - ||v||) = 0,    H + alpha W positive semidefinite

(Fukushima and Yamamoto 1986, (2.11)-(2.14)). Their (2.15), H_uu + alpha I >= 0 at every time, is necessary but does
not suffice: H + alpha W is positive definite if and only if the Riccati sweep meets a positive definite
R_n + alpha w_n I + B_n'P_{n+1} B_n at every stage, which is what is asked for here.

Search
------
phi(alpha) = 1/||v(alpha)|| - 1/Delta is concave and nearly straight where H + alpha W is positive definite. Newton's
step for phi = 0 takes two solutions of the same system:

    alpha <- alpha + (||v||^2 / v'W w) (||v|| - Delta)/Delta,      (H + alpha W) w = W v

It is kept between bounds: below, multipliers with which the sweep fails or v is too long; above, those with which
v is too short. In the hard case (v is too short for all alpha with H + alpha W positive definite) the eigenvector z
of H + alpha W next to zero is found by inverse iteration, and v + tau z with ||v + tau z|| = Delta taken.

Limits of the controls are kept by solving each of these problems in the box (`lq.box`); w is then zero for the controls
that a limit holds.

Source: More and Sorensen 1983, "Computing a trust region step"; Conn, Gould and Toint 2000, section 7.3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mjslq.lq.box import Box, BoxSolution, solve_in_box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.riccati import solve
from mjslq.validation import Array

EXACT = 1e-8
"""Relative error allowed of ||v|| = Delta."""
ROUNDS = 200
"""Sweeps after which the search settles for the best it has."""


class BallSolution(NamedTuple):
    """Minimizer over the ball."""

    found: BoxSolution
    """The sweep with the multiplier; its controls are v."""
    multiplier: float
    """alpha; zero when the ball does not limit."""
    value: float
    """Q(v), not positive."""


class _Ball(NamedTuple):
    """A problem, its limits and the norm, for the functions below."""

    problem: LQProblem
    box: Box
    radius: float
    weights: Array

    def norm(self, U: Array) -> float:
        return math.sqrt(float(self.weights @ (U * U).sum(axis=1)))

    def sweep(self, alpha: float) -> BoxSolution | None:
        """v(alpha), None where there is none."""
        try:
            found = solve_in_box(self.problem, self.box, alpha * self.weights[:, None])
        except NotPositiveDefinite:
            return None
        return found if np.isfinite(found.lq.U).all() else None

    def solution(self, found: BoxSolution, alpha: float) -> BallSolution:
        return BallSolution(found, alpha, self.problem.value(found.lq.X, found.lq.U))

    def inverse(self, alpha: float, side: Array, found: BoxSolution) -> Array | None:
        """(H + alpha W)^-1 `side` on the controls that `found` does not hold, zero on the others."""
        zeros = self.problem._replace(
            q=np.zeros_like(self.problem.q), r=np.ascontiguousarray(-side), c=np.zeros_like(self.problem.c)
        )
        try:
            return solve(zeros, alpha * self.weights[:, None], held=found.held).U
        except NotPositiveDefinite:
            return None


def solve_in_ball(problem: LQProblem, box: Box, radius: float, weights: Array, guess: float = 0.0) -> BallSolution:
    """Minimize the LQ problem within `box` over the ball of `radius` in the norm of `weights` (N,).

    `guess` is a multiplier to try early, such as that of a similar problem.

    Raises NotPositiveDefinite when no multiplier makes the problem convex, as with entries that are not finite.
    """
    ball = _Ball(problem, box, radius, weights)
    found = ball.sweep(0.0)
    if found is not None and ball.norm(found.lq.U) <= radius * (1.0 + EXACT):
        return ball.solution(found, 0.0)
    low, high, short = 0.0, math.inf, None
    alpha = guess if guess > 0.0 else 1e-3 * _unit(problem, weights)
    if found is not None:
        alpha = _newton_step(ball, 0.0, found)
    for _ in range(ROUNDS):
        found = ball.sweep(alpha)
        length = math.inf if found is None else ball.norm(found.lq.U)
        if found is not None and abs(length - radius) <= EXACT * radius:
            return ball.solution(found, alpha)
        if length > radius:
            low = alpha
        else:
            high, short = alpha, found
        if math.isfinite(high) and high - low <= 1e-12 * high:
            break
        following = -1.0 if found is None else _newton_step(ball, alpha, found)
        alpha = following if low < following < high else _between(low, high)
        if not math.isfinite(alpha) or alpha > 1e300:
            raise NotPositiveDefinite(0)
    if short is None:
        raise NotPositiveDefinite(0)
    return _to_the_border(ball, high, short)


def _newton_step(ball: _Ball, alpha: float, found: BoxSolution) -> float:
    """Multiplier that Newton's method for phi = 0 goes to."""
    Wv = ball.weights[:, None] * found.lq.U
    w = ball.inverse(alpha, Wv, found)
    length, curvature = ball.norm(found.lq.U), 0.0 if w is None else float(np.vdot(Wv, w))
    if not curvature > 0.0:
        return -1.0
    return alpha + length**2 / curvature * (length - ball.radius) / ball.radius


def _between(low: float, high: float) -> float:
    if math.isinf(high):
        return 10.0 * low
    return math.sqrt(low * high) if low > 1e-6 * high else max(1e-3 * high, 0.5 * (low + 1e-3 * high))


def _to_the_border(ball: _Ball, alpha: float, short: BoxSolution) -> BallSolution:
    """The hard case: go on to the border along the direction of least curvature, to the side of the lower value."""
    problem, weights, v = ball.problem, ball.weights[:, None], short.lq.U
    z = np.where(short.held, 0.0, np.random.default_rng(0).standard_normal(v.shape))
    for _ in range(3):
        further = ball.inverse(alpha, weights * z, short)
        if further is None or not further.any():
            break
        z = further / ball.norm(further)
    z /= max(ball.norm(z), 1e-300)
    inner, missing = float(np.vdot(weights * v, z)), ball.radius**2 - ball.norm(v) ** 2
    root = math.sqrt(inner**2 + max(missing, 0.0))
    candidates = [ball.box.clip(v + tau * z) for tau in (-inner + root, -inner - root)]
    U = min(candidates, key=lambda U: problem.value(problem.states(U), U))
    X = problem.states(U)
    k = U + np.einsum("nij,nj->ni", short.lq.K, X[:-1])
    return ball.solution(short._replace(lq=short.lq._replace(X=X, U=U, k=k)), alpha)


def _unit(problem: LQProblem, weights: Array) -> float:
    """Size of the control weights, in the units of alpha."""
    return max(1e-9, float(np.abs(problem.R / weights[:, None, None]).max(initial=0.0)))
