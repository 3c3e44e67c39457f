"""Gains of the projection operator: a regulator on the linearization, made anew only when it stops to stabilize.

    minimize  sum_n [ 1/2 x_n'Q x_n + 1/2 u_n'R u_n ] + 1/2 x_N'Q_N x_N    subject to  x_{n+1} = A_n x_n + B_n u_n

for the user's weights (`regulator=(Q, R)` or `(Q, R, Q_N)`; barriers of the controls add their curvature to R), or
those of the cost's own second-order model. With given
weights the sweep runs over a few steps at a time, from the last to the first, so that no Jacobian is kept but the gains
themselves; the cost's own make arrays (N, ndx, ndx) while it runs.

Stabilizing. Under good gains the costates of (16) are a sum of the cost's gradients that soon forgets; under gains that
do not stabilize they grow backward from step to step. So every adjoint pass tells, for nothing: the gains are lost when

    max_n |lambda_n|  >  `LOST` g max_n |q_n|,        g the same ratio when they were made, at least 1,

or when costates are not finite. They are also made anew where the search finds no step with gains that are not of the
present trajectory.

With the Hessian of the regulator's cost by a control under feedback, G_n = R + B_n'P_{n+1} B_n, the gains come with a
metric: where the weights are the cost's own, sum_n v_n'G_n v_n is the second-order model of the cost in the feedforward
v of its optimal feedback, stage by stage. First-order variants may use it.

Source: Sforni et al., section V: "recomputed only when it looses its stabilizing property".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mjslq.dynamics.records import slices
from mjslq.lq.box import Box
from mjslq.lq.problem import LQProblem
from mjslq.lq.regularize import damped
from mjslq.lq.riccati import solve
from mjslq.problem import Problem
from mjslq.solvers.damping import UNDAMPED
from mjslq.solvers.projection import CurveIterate
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array, per_step_matrices

LOST = 100.0
"""Growth of the ratio of costates to cost gradients, with which gains do not stabilize any more."""


class Regulator:
    """The gains of a solve."""

    def __init__(self, gains: Any, weights: tuple[Any, ...] | None) -> None:
        self._given, self._weights = gains, weights
        self.G: Array | None = None
        """The metric that came with the gains; None without. Shape (N, nu, nu)."""
        self.stiffen: Callable[[Trajectory], Array | None] = lambda trajectory: None
        """Curvature that barriers add to R along a trajectory. Shape (N, nu)."""
        self.made = 0
        """How often gains were made."""
        self._ratio = 1.0
        self._made_at: Any = None

    @property
    def adapts(self) -> bool:
        """Whether gains are made here, not given."""
        return isinstance(self._given, str) and self._given == "lqr"

    def check(self, problem: Problem) -> None:
        """Raise ValueError for gains or weights that do not belong to the problem."""
        dynamics = problem.dynamics
        if not isinstance(self._given, str):
            as_array("gains", self._given, (problem.horizon, dynamics.nu, dynamics.ndx))
        if self._weights is not None:
            _spread(self._weights, dynamics.ndx, dynamics.nu)

    def with_gains(self, here: CurveIterate) -> CurveIterate:
        """The iterate with new gains, or the given ones."""
        if not self.adapts:
            return here.under(None if isinstance(self._given, str) else self._given)
        self.made += 1
        K, self.G = self._by_cost(here) if self._weights is None else self._by_weights(here, self._weights)
        there = here.under(K)
        self._made_at, self._ratio = there.trajectory, max(1.0, _ratio(there))
        return there

    def watched(self, here: CurveIterate) -> CurveIterate:
        """The iterate, with new gains where the present ones are lost."""
        if not self.adapts or not np.isfinite(here.cost) or _ratio(here) <= LOST * self._ratio:
            return here
        return self.with_gains(here)

    def renewed(self, here: CurveIterate) -> CurveIterate | None:
        """The iterate with gains of its own trajectory; None where it has them."""
        return None if not self.adapts or self._made_at is here.trajectory else self.with_gains(here)

    def _by_cost(self, here: CurveIterate) -> tuple[Array, Array]:
        model = here.gauss_newton
        found = damped(model, _unlimited(model), ladder=UNDAMPED)
        PB = found.found.lq.P[1:] @ model.B
        G = model.R + np.einsum("nij,nik->njk", model.B, PB) + found.multiplier * np.eye(model.R.shape[1])
        return found.found.lq.K, G

    def _by_weights(self, here: CurveIterate, weights: tuple[Any, ...]) -> tuple[Array, Array]:
        dynamics, at = here.problem.dynamics, here.trajectory
        N, ndx, nu = at.horizon, dynamics.ndx, dynamics.nu
        Q, R, P = _spread(weights, ndx, nu)
        K, G = np.empty((N, nu, ndx)), np.empty((N, nu, nu))
        G[:] = R
        if (stiffer := self.stiffen(at)) is not None:
            G[:, np.arange(nu), np.arange(nu)] += stiffer
        for first, last in slices(N, ndx):
            A, B, _, _ = dynamics.linearize_slice(at, first, last)
            m = last - first
            costs = np.concatenate([np.broadcast_to(Q, (m, ndx, ndx)), P[None]]), G[first:last]
            zeros = np.zeros((m, nu, ndx)), np.zeros((m + 1, ndx)), np.zeros((m, nu)), np.zeros((m, ndx))
            found = solve(LQProblem(A, B, *costs, *zeros), refinements=0)
            K[first:last], P = found.K, found.P[0]
            G[first:last] += np.einsum("nij,nik->njk", B, found.P[1:] @ B)
        return K, G


def _spread(weights: tuple[Any, ...], ndx: int, nu: int) -> tuple[Array, Array, Array]:
    """Q, R and Q_N as matrices. Raises ValueError."""
    Q = per_step_matrices("regulator: Q", weights[0], 1, ndx, definite=False)[0]
    R = per_step_matrices("regulator: R", weights[1], 1, nu, definite=True)[0]
    last = Q if len(weights) < 3 else per_step_matrices("regulator: Q_N", weights[2], 1, ndx, definite=False)[0]
    return Q, R, last


def _ratio(here: CurveIterate) -> float:
    """Largest costate over the largest gradient of the cost by a state."""
    costates = np.linalg.norm(here.costates, axis=1).max(initial=0.0)
    largest = np.linalg.norm(here.problem.slopes(here.trajectory).q, axis=1).max(initial=0.0)
    ratio = float(costates / max(largest, 1e-300))
    return ratio if np.isfinite(ratio) else np.inf


def _unlimited(model: LQProblem) -> Box:
    return Box(np.full(model.r.shape, -np.inf), np.full(model.r.shape, np.inf))
