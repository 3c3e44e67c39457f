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

Source: More and Sorensen 1983, "Computing a trust region step"; Conn, Gould and Toint 2000, section 7.3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mjslq.lq.riccati import LQProblem, LQSolution, NotPositiveDefinite, solve
from mjslq.validation import Array

EXACT = 1e-8
"""Relative error allowed of ||v|| = Delta."""
ROUNDS = 200
"""Sweeps after which the search settles for the best it has."""


class BallSolution(NamedTuple):
    """Minimizer over the ball."""

    U: Array
    """v. Shape (N, nu)."""
    k: Array
    """The same as feedforward beside the gains. Shape (N, nu)."""
    K: Array
    """Feedback gains of the sweep with the multiplier. Shape (N, nu, nx)."""
    multiplier: float
    """alpha; zero when the ball does not limit."""
    value: float
    """Q(v), not positive."""


def solve_in_ball(problem: LQProblem, radius: float, weights: Array, guess: float = 0.0) -> BallSolution:
    """Minimize the LQ problem over the ball of `radius` in the norm of `weights` (N,).

    `guess` is a multiplier to try early, such as that of a similar problem.

    Raises NotPositiveDefinite when no multiplier makes the problem convex, as with entries that are not finite.
    """
    found = _sweep(problem, 0.0, weights)
    if found is not None and _norm(found.U, weights) <= radius * (1.0 + EXACT):
        return BallSolution(found.U, found.k, found.K, 0.0, model_value(problem, found.U))
    low, high, short = 0.0, math.inf, None
    alpha = guess if guess > 0.0 else 1e-3 * _scale(problem, weights)
    if found is not None:
        alpha = _newton_step(problem, 0.0, found, radius, weights)
    for _ in range(ROUNDS):
        found = _sweep(problem, alpha, weights)
        length = math.inf if found is None else _norm(found.U, weights)
        if found is not None and abs(length - radius) <= EXACT * radius:
            return BallSolution(found.U, found.k, found.K, alpha, model_value(problem, found.U))
        if length > radius:
            low = alpha
        else:
            high, short = alpha, found
        if math.isfinite(high) and high - low <= 1e-12 * high:
            break
        following = -1.0 if found is None else _newton_step(problem, alpha, found, radius, weights)
        alpha = following if low < following < high else _between(low, high)
        if not math.isfinite(alpha) or alpha > 1e300:
            raise NotPositiveDefinite(0)
    if short is None:
        raise NotPositiveDefinite(0)
    return _to_the_border(problem, high, short, radius, weights)


def model_value(problem: LQProblem, U: Array) -> float:
    """Q(v): the cost of the controls `U` in the LQ problem."""
    X = _states(problem, U)
    _, _, Q, R, M, q, r, _ = problem
    quadratic = np.einsum("ni,nij,nj", X, Q, X) + np.einsum("ni,nij,nj", U, R, U)
    return float(np.vdot(q, X) + np.vdot(r, U) + 0.5 * quadratic + np.einsum("ni,nij,nj", U, M, X[:-1]))


def _sweep(problem: LQProblem, alpha: float, weights: Array) -> LQSolution | None:
    R = problem.R + alpha * weights[:, None, None] * np.eye(problem.R.shape[1])
    try:
        found = solve(problem._replace(R=R))
    except NotPositiveDefinite:
        return None
    return found if np.isfinite(found.U).all() else None


def _newton_step(problem: LQProblem, alpha: float, found: LQSolution, radius: float, weights: Array) -> float:
    """Multiplier that Newton's method for phi = 0 goes to."""
    Wv = weights[:, None] * found.U
    shifted = _sweep(_with_right_side(problem, Wv), alpha, weights)
    length, curvature = _norm(found.U, weights), 0.0 if shifted is None else float(np.vdot(Wv, shifted.U))
    if not curvature > 0.0:
        return -1.0
    return alpha + length**2 / curvature * (length - radius) / radius


def _with_right_side(problem: LQProblem, side: Array) -> LQProblem:
    """The problem whose solution is (H + alpha W)^-1 `side`."""
    return problem._replace(q=np.zeros_like(problem.q), r=-side, c=np.zeros_like(problem.c))


def _between(low: float, high: float) -> float:
    if math.isinf(high):
        return 10.0 * low
    return math.sqrt(low * high) if low > 1e-6 * high else max(1e-3 * high, 0.5 * (low + 1e-3 * high))


def _to_the_border(problem: LQProblem, alpha: float, short: LQSolution, radius: float, weights: Array) -> BallSolution:
    """The hard case: go on to the border along the direction of least curvature, to the side of the lower value."""
    z = np.random.default_rng(0).standard_normal(short.U.shape)
    for _ in range(3):
        further = _sweep(_with_right_side(problem, weights[:, None] * z), alpha, weights)
        if further is None:
            break
        z = further.U / _norm(further.U, weights)
    z /= _norm(z, weights)
    inner, missing = float(np.vdot(weights[:, None] * short.U, z)), radius**2 - _norm(short.U, weights) ** 2
    root = math.sqrt(inner**2 + max(missing, 0.0))
    candidates = [short.U + tau * z for tau in (-inner + root, -inner - root)]
    value, U = min(((model_value(problem, U), U) for U in candidates), key=lambda pair: pair[0])
    k = U + np.einsum("nij,nj->ni", short.K, _states(problem, U)[:-1])
    return BallSolution(U, k, short.K, alpha, value)


def _states(problem: LQProblem, U: Array) -> Array:
    """States of the LQ problem under the controls `U`. Shape (N + 1, nx)."""
    X = np.zeros_like(problem.q)
    for n in range(len(U)):
        X[n + 1] = problem.A[n] @ X[n] + problem.B[n] @ U[n] + problem.c[n]
    return X


def _norm(U: Array, weights: Array) -> float:
    return math.sqrt(float(weights @ (U * U).sum(axis=1)))


def _scale(problem: LQProblem, weights: Array) -> float:
    """Size of the control weights, in the units of alpha."""
    return max(1e-9, float(np.abs(problem.R / weights[:, None, None]).max(initial=0.0)))
