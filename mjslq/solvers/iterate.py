"""`Iterate`: a trajectory with what the methods ask about it, each computed when first asked for and then kept."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from mjslq.costs import Expansion
from mjslq.dynamics.dynamics import Linearization
from mjslq.lq.adjoint import adjoint
from mjslq.lq.riccati import LQProblem
from mjslq.problem import Problem
from mjslq.trajectory import Trajectory
from mjslq.validation import Array


class Direction(NamedTuple):
    """A search direction at an iterate."""

    U: Array
    """Change of the controls. Shape (N, nu)."""
    k: Array
    """The same as feedforward beside the gains, for closed-loop steps. Shape (N, nu)."""
    K: Array
    """Feedback gains. Shape (N, nu, ndx)."""
    multiplier: float = 0.0
    """Multiplier that the direction was found with."""
    predicted: float = 0.0
    """Change of the cost that the model promises; trust region only."""
    radius: float = 0.0
    """Of the ball that the direction was found in; 0 for none."""
    limited: bool = False
    """Whether the direction is short because a multiplier keeps it so, which is no sign of convergence."""


class Iterate:
    """A candidate: trajectory and cost at once; linearization, expansion and gradient when asked for."""

    def __init__(self, problem: Problem, trajectory: Trajectory) -> None:
        self.problem = problem
        self.trajectory = trajectory
        self.cost = problem.cost(trajectory)

    @cached_property
    def linearization(self) -> Linearization:
        """Jacobians along the trajectory."""
        return self.problem.dynamics.linearize(self.trajectory)

    @cached_property
    def expansion(self) -> Expansion:
        """Second-order expansion of the cost along the trajectory."""
        return self.problem.expand(self.trajectory, self.linearization)

    @cached_property
    def _adjoint(self) -> tuple[Array, Array]:
        A, B = self.linearization.A, self.linearization.B
        return adjoint(A, B, self.expansion.q, self.expansion.r)

    @property
    def costates(self) -> Array:
        """dJ/dx_n, the controls held. Shape (N + 1, ndx)."""
        return self._adjoint[0]

    @property
    def gradient(self) -> Array:
        """dJ/dU. Shape (N, nu)."""
        return self._adjoint[1]

    @cached_property
    def gauss_newton(self) -> LQProblem:
        """The cost to second order, but for the curvature of dynamics and residuals: convex."""
        A, B, _, _ = self.linearization
        Q, R, M, q, r = self.expansion
        return LQProblem(A, B, Q, R, M, q, r, np.zeros((len(A), A.shape[1])))

    @cached_property
    def newton(self) -> LQProblem:
        """The cost to second order: with the Hessians of the Hamiltonian; need not be convex."""
        return self.hamiltonian(self.costates)

    def hamiltonian(self, costates: Array) -> LQProblem:
        """The LQ problem with the Hessians of l + lambda'f for given costates lambda. Shape (N + 1, ndx)."""
        dynamics, (A, B, _, _) = self.problem.dynamics, self.linearization
        (Q, R, M, q, r), weights = self.problem.complete(self.trajectory, self.expansion)
        xx, ux, uu = dynamics.hessian(self.trajectory, costates, weights, self.linearization)
        return LQProblem(A, B, Q + xx, R + uu, M + ux, q, r, np.zeros((len(A), A.shape[1])))

    @cached_property
    def gradient_norm(self) -> float:
        """Euclidean norm of dJ/dU; infinite for a trajectory that diverged or has no finite derivatives."""
        if not np.isfinite(self.cost):
            return np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            norm = float(np.linalg.norm(self.gradient))
        return norm if np.isfinite(norm) else np.inf

    def slope(self, direction: Direction) -> float:
        """Derivative of the cost along `direction`."""
        return float(np.vdot(self.gradient, direction.U))
