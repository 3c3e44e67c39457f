"""Making an LQ problem convex, or its minimizer shorter: one multiplier for all stages, or the least change of each.

Multiplier
----------
    "control"   minimize  cost + mu/2 sum_n u_n'u_n         keeps to the controls of the iterate
    "state"     minimize  cost + mu/2 sum_n x_n'x_n         keeps to its states, which suits closed-loop steps

mu is told relative to the largest weight of the problem, max|R| or max|Q|. Where the problem has no minimizer, mu grows
until it has one: `damped`.

Least change of a stage
-----------------------
In the backward sweep the Hessian of the total cost by the controls appears factorized, one block a stage:

    H = L diag(G_0, ..., G_{N-1}) L',    G_n = R_n + B_n'P_{n+1} B_n

so that it is positive definite exactly if every G_n is. Where one is not, its eigenvalues below a floor are
replaced by their absolute values, or by the floor where these are smaller,

    E_n = V (max(|lambda|, floor) - lambda) V'  for  G_n = V lambda V',  lambda < floor,

and the sweep goes on with R_n + E_n. Directions of negative curvature are then descended with their curvature
taken as positive. This is the modified Cholesky factorization by blocks (Gill and Murray 1974).

Sources: Levenberg 1944, Marquardt 1963; Tassa, Erez and Todorov 2012, "Synthesis and stabilization of complex
behaviors through online trajectory optimization", for the two kinds of multiplier.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from mjslq.lq.box import Box, BoxSolution, solve_in_box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.native.declare import helper
from mjslq.validation import Array

By = Literal["control", "state"]
"""What a multiplier keeps near the iterate."""
LEAST_WEIGHT = 1e-9
"""Largest weight of a problem that has none."""


class Damped(NamedTuple):
    """Minimizer with a multiplier."""

    found: BoxSolution
    mu: float
    """The multiplier, relative to the largest weight."""
    multiplier: float
    """The same as it was added to the weights."""


@dataclass(frozen=True)
class Ladder:
    """Multipliers tried in turn until the problem has a minimizer, relative to the largest weight."""

    first: float = 1e-6
    """The first one above zero."""
    growth: float = 10.0
    """Factor from one to the next."""
    largest: float = 1e12
    """The last one."""

    def above(self, mu: float) -> float:
        """The next multiplier."""
        return max(self.growth * mu, self.first)


def largest_weight(problem: LQProblem, by: By = "control") -> float:
    """max|R| or max|Q|: the unit of multipliers."""
    weights = problem.Q if by == "state" else problem.R
    return max(LEAST_WEIGHT, float(np.abs(weights).max(initial=0.0)))


def solve_with(problem: LQProblem, box: Box, mu: float, by: By = "control") -> Damped:
    """Minimize with the multiplier `mu`. Raises NotPositiveDefinite."""
    multiplier = mu * largest_weight(problem, by) if mu else 0.0
    shifts = (0.0, multiplier) if by == "state" else (multiplier, 0.0)
    return Damped(solve_in_box(problem, box, *shifts), mu, multiplier)


def damped(problem: LQProblem, box: Box, mu: float = 0.0, by: By = "control", ladder: Ladder = Ladder()) -> Damped:
    """Minimize with the multiplier `mu`, or the least one further up the ladder with which there is a minimizer.

    Raises NotPositiveDefinite when there is none with the largest, as with entries that are not finite.
    """
    while True:
        try:
            return solve_with(problem, box, mu, by)
        except NotPositiveDefinite:
            mu = ladder.above(mu)
            if mu > ladder.largest:
                raise


def modification(problem: LQProblem, floor: Array) -> Array:
    """E_n for every stage. Shape (N, nu, nu). `floor` holds the least eigenvalue allowed of each G_n. Shape (N,)."""
    E = np.zeros_like(problem.R)
    _modify(problem.A, problem.B, problem.Q, problem.R, problem.M, floor, E)
    return E


@helper(cache=True)
def _modify(A, B, Q, R, M, floor, E):
    P = Q[-1].copy()
    for n in range(B.shape[0] - 1, -1, -1):
        PB = np.dot(P, B[n])
        G = R[n] + np.dot(B[n].T, PB)
        values, V = np.linalg.eigh(0.5 * (G + G.T))
        wanted = values.copy()
        for i in range(values.size):
            if not values[i] >= floor[n]:
                wanted[i] = max(abs(values[i]), floor[n])
                E[n] += (wanted[i] - values[i]) * np.outer(V[:, i], V[:, i])
        W = np.dot(np.ascontiguousarray(V.T), M[n] + np.dot(np.ascontiguousarray(PB.T), A[n]))
        scaled = W.copy()
        for i in range(values.size):
            scaled[i] /= wanted[i]
        P = Q[n] + np.dot(A[n].T, np.dot(P, A[n])) - np.dot(W.T, scaled)
        P = 0.5 * (P + P.T)
