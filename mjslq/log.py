"""`IterationLog`: one iteration of a solve in numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Outcome = Literal["accepted", "rejected", "failed", "final"]
"""What came of an iteration's direction: a step was taken; a trial was refused, and another direction follows from the
same iterate; no step was found; none was looked for, because the solve ended here."""


@dataclass(frozen=True)
class IterationLog:
    """One iteration in numbers: the iterate, the direction found there, and the step taken along it.

    Examples
    --------
    >>> result = mjslq.solve(mjslq.problems.get("hopper", height=1.0))
    >>> start = result.log[0]
    >>> start.iteration, start.cost > result.cost
    (0, True)
    """

    iteration: int
    """Number of steps taken before this one: 0 describes the start."""
    cost: float
    """Cost of the iterate."""
    gradient_norm: float
    """Euclidean norm of the projected gradient dJ/dU at the iterate."""
    direction_norm: float
    """Euclidean norm of the search direction found there."""
    slope: float
    """Derivative of the merit along the direction; negative for descent."""
    alpha: float
    """Step size taken; 0 where none was."""
    outcome: Outcome = "accepted"
    """What came of the direction."""
    evaluations: int = 0
    """Rollouts spent on the step."""
    seconds: float = 0.0
    """Wall time from the start of the solve to the end of this iteration. [s]"""
    multiplier: float = 0.0
    """Levenberg-Marquardt or trust-region multiplier used for the direction."""
    radius: float = 0.0
    """Radius of the trust region; 0 without one."""
    predicted: float = 0.0
    """Change of the cost that the model expects of a full step."""
    ratio: float = 0.0
    """Actual change relative to the expected one, rho; trust region only."""
    gap: float = 0.0
    """Largest gap between a step's end and the next state of a state guess; 0 for rollouts."""
    limited: int = 0
    """Controls that a limit holds, over all steps."""
    violation: float = 0.0
    """Largest violation of a constraint; 0 without constraints."""
