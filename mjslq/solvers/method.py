"""What a method is: a way to find directions, and a way to step along them. `loop.descend` does the rest."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

from mjslq.problem import Problem
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.merit import Merit
from mjslq.status import Status
from mjslq.validation import Array


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
    """Whether the trial was refused and another direction is to come from the same trajectory."""
    status: Status = Status.STEP_TOO_SMALL
    """How the solve ends where there is no step."""


@dataclass(frozen=True)
class Duals:
    """What belongs to constraints at an iterate, by the constraint's name."""

    multipliers: dict[str, Array] = field(default_factory=dict)
    """Shape (k, m)."""
    violations: dict[str, Array] = field(default_factory=dict)
    """Shape (N + 1,)."""
    violation: float = 0.0
    """The largest of all."""


class Method(ABC):
    """Finds directions and steps; may keep state from an iteration to the next, such as a multiplier."""

    tests_direction: bool = True
    """Whether a short direction is a sign of convergence."""

    def check(self, problem: Problem) -> None:
        """Raise ValueError where the options do not fit a problem; called before anything is solved."""
        return

    def warm_start(self, multipliers: Mapping[str, Array]) -> None:
        """Take multipliers of constraints from an earlier result, by the constraint's name; most methods have none."""
        return

    def begin(self, start: Iterate) -> Iterate:
        """What to start from: a method that changes the cost gives the same trajectory with another problem."""
        return start

    @abstractmethod
    def direction(self, here: Iterate) -> Direction:
        """Search direction at `here`. Raises NotPositiveDefinite where there is none."""

    @abstractmethod
    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """Go along `direction` so that the merit falls."""

    def accepts(self, here: Iterate) -> bool:
        """Whether a stationary point at `here` is what the method looks for."""
        return True

    def best(self, last: Iterate, status: Status) -> Iterate:
        """What the solve returns, after it has ended with `last`."""
        return last

    def duals(self, here: Iterate) -> Duals:
        """Multipliers and violations at the iterate that is returned."""
        return Duals()

    def remark(self) -> str:
        """What a user should know of how the method went, in a sentence; often nothing."""
        return ""
