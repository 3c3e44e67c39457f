"""What a method is: a way to find directions, and a way to step along them. `loop.descend` does the rest."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.merit import Merit


@dataclass(frozen=True)
class Step:
    """What came of one direction."""

    iterate: Iterate | None
    """The next iterate; the same one where the trial was `rejected`; None where no step was found."""
    alpha: float = 0.0
    """Step size taken."""
    rollouts: int = 0
    """Rollouts spent."""
    ratio: float = 0.0
    """Change of the cost relative to what the model expected; trust region only."""
    rejected: bool = False
    """Whether the trial was refused and another direction is to come from the same iterate."""


class Method(ABC):
    """Finds directions and steps; may keep state from an iteration to the next, such as a multiplier."""

    tests_direction: bool = True
    """Whether a short direction is a sign of convergence."""

    @abstractmethod
    def direction(self, here: Iterate) -> Direction:
        """Search direction at `here`. Raises NotPositiveDefinite where there is none."""

    @abstractmethod
    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """Go along `direction` so that the merit falls."""

    def remark(self) -> str:
        """What a user should know of how the method went, in a sentence; often nothing."""
        return ""
