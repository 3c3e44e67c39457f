"""`Iterate`: a trajectory with what the methods ask about it, each computed when first asked for and then kept."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from mjslq._validation import Array
from mjslq.costs import Expansion
from mjslq.dynamics._base import Linearization
from mjslq.lq.adjoint import adjoint
from mjslq.problem import Problem
from mjslq.trajectory import Trajectory


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
    def gradient(self) -> Array:
        """dJ/dU. Shape (N, nu)."""
        A, B = self.linearization.A, self.linearization.B
        return adjoint(A, B, self.expansion.q, self.expansion.r)[1]

    @cached_property
    def gradient_norm(self) -> float:
        """Euclidean norm of dJ/dU; infinite for a trajectory that diverged or has no finite derivatives."""
        if not np.isfinite(self.cost):
            return np.inf
        norm = float(np.linalg.norm(self.gradient))
        return norm if np.isfinite(norm) else np.inf

    def slope(self, direction: Direction) -> float:
        """Derivative of the cost along `direction`."""
        return float(np.vdot(self.gradient, direction.U))
