"""`IterationLog`: one iteration of a solve in numbers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class IterationLog:
    """One iteration in numbers: the iterate, the direction found there, and the step taken along it."""

    iteration: int
    """Number of steps taken before this one: 0 describes the start."""
    cost: float
    """Cost of the iterate."""
    gradient_norm: float
    """Euclidean norm of dJ/dU at the iterate."""
    direction_norm: float
    """Euclidean norm of the search direction found there."""
    slope: float
    """Derivative of the cost along the direction; negative for descent."""
    alpha: float
    """Step size taken; 0 when the solve ended here."""
    evaluations: int
    """Rollouts spent on the step."""
    seconds: float
    """Wall time from the start of the solve to the end of this iteration. [s]"""
    multiplier: float = 0.0
    """Levenberg-Marquardt or trust-region multiplier used for the direction."""
    radius: float = 0.0
    """Radius of the trust region; 0 without one."""
    predicted: float = 0.0
    """Change of the cost that the trust region's model promised, Q(v)."""
    ratio: float = 0.0
    """Actual change relative to the promised one, rho; the step is rejected where it is small."""
    gap: float = 0.0
    """Largest gap between a step's end and the next state of a state guess; 0 for rollouts."""
