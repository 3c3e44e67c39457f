"""`Iterate`: states and controls with what the methods ask about them, each computed when first asked for, then kept.

    gaps    c_n = f_n(x_n, u_n) - x_{n+1}        (difference(x_{n+1}, f_n) on a manifold)

A rollout has none. A guess of the states has: the sweep closes them to first order (multiple shooting), since they
stand in the dynamics of the LQ problem, and a merit function weighs them against the cost (`merit`).
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from mjslq.costs import Expansion
from mjslq.dynamics.dynamics import Linearization
from mjslq.lq.adjoint import adjoint
from mjslq.lq.box import Box
from mjslq.lq.problem import LQProblem, LQSolution, Mask
from mjslq.lq.regularize import By, Damped
from mjslq.problem import Problem
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

CLOSED = 1e-4
"""Largest gap, relative to the largest entry of the states, that a rollout may close."""
LIMITING = 0.1
"""Share of a direction's curvature from which on its multiplier counts as what makes it short."""


class Direction(NamedTuple):
    """A search direction at an iterate."""

    X: Array
    """Change of the states, by the linearized dynamics, the first of them zero but for free entries.
    Shape (N + 1, ndx)."""
    U: Array
    """Change of the controls. Shape (N, nu)."""
    k: Array
    """The same as feedforward beside the gains, for closed-loop steps. Shape (N, nu)."""
    K: Array | None
    """Feedback gains, zero for controls that a limit holds; None where the method has none. Shape (N, nu, ndx)."""
    expected: float
    """Change of the cost that the model expects of a full step; negative for descent."""
    held: Mask
    """Controls that a limit holds. Shape (N, nu)."""
    multiplier: float = 0.0
    """Multiplier that the direction was found with."""
    radius: float = 0.0
    """Of the ball that the direction was found in; 0 for none."""
    limited: bool = False
    """Whether the direction is short because a multiplier keeps it so, which is no sign of convergence."""
    undamped: float | None = None
    """Norm of the change of the controls without the multiplier, where it is known."""
    sweep: LQSolution | None = None
    """The sweep that it comes from; None where the method makes none."""

    @property
    def costates(self) -> Array:
        """Multipliers of the dynamics after the step. Shape (N + 1, ndx)."""
        assert self.sweep is not None
        return self.sweep.costates

    @staticmethod
    def to(model: LQProblem, found: Damped, by: By = "control", radius: float = 0.0) -> Direction:
        """The direction to the minimizer of a model, found with a multiplier."""
        lq, multiplier = found.found.lq, found.multiplier
        slope = float(np.vdot(model.q, lq.X) + np.vdot(model.r, lq.U))
        kept = lq.X if by == "state" else lq.U
        plain = multiplier == 0.0 and found.found.sweeps == 1 and not found.found.held.any() and not model.c.any()
        return Direction(
            lq.X, lq.U, lq.k, lq.K, 0.5 * slope if plain else model.value(lq.X, lq.U), found.found.held, multiplier,
            radius, limited=multiplier * float(np.vdot(kept, kept)) > LIMITING * abs(slope), sweep=lq,
        )  # fmt: skip


class Iterate:
    """A candidate: trajectory and cost at once; linearization, expansion and gradient when asked for."""

    def __init__(self, problem: Problem, trajectory: Trajectory, ends: Array | None = None) -> None:
        self.problem = problem
        self.trajectory = trajectory
        self.ends = ends
        """f_n(x_n, u_n) where the states are a guess; None for a rollout. Shape (N, nx)."""
        self.terms = problem.costs_of_terms(trajectory)
        """Cost of each term."""
        self.cost = problem.total(self.terms)

    @classmethod
    def guess(cls, problem: Problem, X: Array, U: Array) -> Iterate:
        """States `X` (N + 1, nx) and controls `U` (N, nu) that need not obey the dynamics."""
        ends, Y = problem.dynamics.step_each(X, U)
        sums = Y.sum(axis=1)  # not finite where an entry is not
        sums[:-1] += ends.sum(axis=1)
        bad = np.flatnonzero(~np.isfinite(sums))
        at = int(bad[0]) if bad.size else None
        return cls(problem, Trajectory(X, U, Y, problem.dynamics.dt, diverged_at=at), ends)

    @cached_property
    def gaps(self) -> Array | None:
        """What is between the end of each step and the next state; None for a rollout. Shape (N, ndx)."""
        return None if self.ends is None else self.problem.dynamics.difference(self.trajectory.X[1:], self.ends)

    @property
    def gap(self) -> float:
        """The largest gap; 0 for a rollout."""
        return 0.0 if self.gaps is None else float(np.abs(self.gaps).max(initial=0.0))

    @property
    def closed(self) -> bool:
        """Whether a rollout may close what gaps there are."""
        return self.gap <= CLOSED * max(1.0, float(np.abs(self.trajectory.X).max()))

    @cached_property
    def box(self) -> Box:
        """Limits of the change of the controls."""
        return self.problem.box.about(self.trajectory.U)

    @cached_property
    def linearization(self) -> Linearization:
        """Jacobians of the steps, A and B in tangent directions of where each step ends, and of the outputs."""
        dynamics, trajectory = self.problem.dynamics, self.trajectory
        if self.ends is None:
            return dynamics.linearize(trajectory)
        return dynamics.linearize_steps(trajectory.X, trajectory.U, self.ends)

    @cached_property
    def expansion(self) -> Expansion:
        """Second-order expansion of the cost along the trajectory."""
        return self.problem.expand(self.trajectory, self.linearization)

    @cached_property
    def gauss_newton(self) -> LQProblem:
        """The cost to second order, but for the curvature of dynamics and residuals: convex."""
        A, B, _, _ = self.linearization
        Q, R, M, q, r = self.expansion
        free = self.problem.free_start
        if self.ends is None:
            return LQProblem(A, B, Q, R, M, q, r, np.zeros(A.shape[:2]), free)
        J = self.problem.dynamics.difference_jacobian(self.trajectory.X[1:], self.ends)
        if J is not None:
            A, B = J @ A, J @ B
        assert self.gaps is not None
        return LQProblem(A, B, Q, R, M, q, r, np.ascontiguousarray(self.gaps), free)

    def hamiltonian(self, costates: Array) -> LQProblem:
        """The LQ problem with the Hessians of l + lambda'f for given costates lambda. Shape (N + 1, ndx)."""
        full, weights = self.problem.complete(self.trajectory, self.expansion)
        Q, R, M, _, _ = full
        costates = costates + self.problem.complete_ends(self.trajectory, self.linearization, full)
        xx, ux, uu = self.problem.dynamics.hessian(self.trajectory, costates, weights, self.linearization, self.ends)
        for whole, part in ((Q, xx), (R, uu), (M, ux)):
            whole += part
        return self.gauss_newton._replace(Q=Q, R=R, M=M)

    @cached_property
    def newton(self) -> LQProblem:
        """The cost to second order, with the trajectory's own costates; need not be convex."""
        return self.hamiltonian(self.costates)

    @cached_property
    def _adjoint(self) -> tuple[Array, Array]:
        model = self.gauss_newton
        return adjoint(model.A, model.B, model.q, model.r)

    @property
    def costates(self) -> Array:
        """dJ/dx_n, the controls held. Shape (N + 1, ndx)."""
        return self._adjoint[0]

    @property
    def gradient(self) -> Array:
        """dJ/dU. Shape (N, nu)."""
        return self._adjoint[1]

    def slope_along(self, direction: Direction) -> float:
        """Derivative of the cost along a direction."""
        return float(np.vdot(self.gradient, direction.U) + self.start_gradient @ direction.X[0])

    @cached_property
    def projected_gradient(self) -> Array:
        """dJ/dU without the entries that push against a limit: zero at a minimum. Shape (N, nu)."""
        return self.problem.box.projected(self.trajectory.U, self.gradient)

    @property
    def start_gradient(self) -> Array:
        """dJ/dx_0 by the entries that are free, zero for others. Shape (ndx,)."""
        return self._of_start(self.costates)

    def _of_start(self, costates: Array) -> Array:
        free = self.problem.free_start
        return np.zeros(costates.shape[1]) if free is None else np.where(free, costates[0], 0.0)

    @cached_property
    def gradient_norm(self) -> float:
        """Euclidean norm of the projected gradient, by controls and by free entries of the initial state.

        Infinite where there are no finite derivatives.
        """
        if not np.isfinite(self.cost):
            return np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            norm = _norm(self.projected_gradient, self.start_gradient)
        return norm if np.isfinite(norm) else np.inf

    def stationarity(self, direction: Direction) -> float:
        """`gradient_norm`; for a guess of the states that of the Lagrangian, with the direction's costates."""
        if self.gaps is None:
            return self.gradient_norm
        model = self.gauss_newton
        gradient = model.r + np.einsum("nij,ni->nj", model.B, direction.costates[1:])
        projected = self.problem.box.projected(self.trajectory.U, gradient)
        return _norm(projected, self._of_start(direction.costates))


def _norm(by_controls: Array, by_start: Array) -> float:
    return float(np.hypot(np.linalg.norm(by_controls), np.linalg.norm(by_start)))
