"""The outer loop that all descent methods share: expand, find a direction, test for the end, accept a step.

A method hands in two functions and keeps no loop of its own:

    direction(iterate)             -> Direction
    step(iterate, direction)       -> (alpha, next iterate) or None when no step will do, and the rollouts spent;
                                      alpha = 0 stays at the iterate, with another direction to come

The loop ends when (Sideris and Bobrow 2005, Algorithm 2, Step 2)

    ||U_bar|| <= tol_direction ||U||   or   ||dJ/dU|| <= tol_gradient,

and never by an exception that a model can cause: a start that blows up, derivatives that are not finite, no step to
take, Ctrl-C and a callback's wish all end in a `Status`, with the best iterate at hand.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple, TextIO

import numpy as np

from mjslq.log import IterationLog
from mjslq.lq.riccati import NotPositiveDefinite
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.status import Status
from mjslq.trajectory import Trajectory


class Accepted(NamedTuple):
    """A step that was taken."""

    alpha: float
    iterate: Iterate
    ratio: float = 0.0
    """Change of the cost relative to what the model promised; trust region only."""


@dataclass(frozen=True)
class Stopping:
    """When a solve is over."""

    tol_direction: float = 1e-6
    """On ||U_bar|| relative to ||U||; 0 leaves the test to the gradient."""
    tol_gradient: float = 1e-6
    """On ||dJ/dU||, absolute; 0 leaves the test to the direction."""
    max_iterations: int = 300


@dataclass
class Monitor:
    """What watches a solve: the table on the screen, the callback, the log and the iterates kept."""

    verbose: int = 0
    callback: Callable[[IterationLog], object] | None = None
    keep_iterates: bool = True
    stream: TextIO = field(default_factory=lambda: sys.stdout)
    log: list[IterationLog] = field(default_factory=list)
    iterates: list[Trajectory] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)

    def record(self, entry: IterationLog, trajectory: Trajectory) -> bool:
        """Keep an entry, print it, tell the callback; True when the callback asks to stop."""
        self.log.append(entry)
        if self.keep_iterates:
            self.iterates.append(trajectory)
        if self.verbose:
            if entry.iteration % 20 == 0:
                print(_HEADER, file=self.stream)
            print(_line(entry), file=self.stream, flush=True)
        return bool(self.callback is not None and self.callback(entry))

    @property
    def seconds(self) -> float:
        """Wall time since the solve began. [s]"""
        return time.perf_counter() - self.started


_TITLES = (
    ("it", 4),
    ("cost", 16),
    ("|gradient|", 10),
    ("|direction|", 11),
    ("step", 8),
    ("rollouts", 8),
    ("time [s]", 8),
)
_HEADER = "  ".join(f"{title:>{width}}" for title, width in _TITLES)


def _line(e: IterationLog) -> str:
    alpha, rollouts = f"{e.alpha:.2g}" if e.alpha else "-", e.evaluations or "-"
    norms = f"{e.gradient_norm:>10.2e}  {e.direction_norm:>11.2e}"
    return f"{e.iteration:>4}  {e.cost:>16.9g}  {norms}  {alpha:>8}  {rollouts:>8}  {e.seconds:>8.3f}"


@dataclass
class Outcome:
    """Where a descent ended."""

    status: Status
    iterate: Iterate
    gains: np.ndarray
    remark: str = ""
    """What the status alone does not tell."""


def descend(
    start: Iterate,
    direction: Callable[[Iterate], Direction],
    step: Callable[[Iterate, Direction], tuple[Accepted | None, int]],
    stopping: Stopping,
    monitor: Monitor,
) -> Outcome:
    """Improve `start` until one of the tests above ends it; see the head of this file."""
    dynamics = start.problem.dynamics
    outcome = Outcome(Status.DIVERGED, start, np.zeros((start.problem.horizon, dynamics.nu, dynamics.ndx)))
    if not np.isfinite(start.cost):
        at = start.trajectory.diverged_at
        outcome.remark = "The first rollout's cost is not finite."
        if at is not None:
            outcome.remark = f"The first rollout blew up at step {at}."
        return outcome
    try:
        _descend(outcome, direction, step, stopping, monitor)
    except KeyboardInterrupt:
        outcome.status = Status.INTERRUPTED
    if outcome.status in (Status.INTERRUPTED, Status.STOPPED):  # the gains are those of the iterate before
        with suppress(NotPositiveDefinite):
            outcome.gains = direction(outcome.iterate).K
    return outcome


def _descend(
    outcome: Outcome,
    direction: Callable[[Iterate], Direction],
    step: Callable[[Iterate, Direction], tuple[Accepted | None, int]],
    stopping: Stopping,
    monitor: Monitor,
) -> None:
    """Run the loop, keeping `outcome` up to date at every moment, so that an interrupt loses nothing."""
    for iteration in range(stopping.max_iterations + 1):
        here = outcome.iterate
        if not np.isfinite(here.gradient_norm):
            outcome.status, outcome.remark = Status.DIVERGED, "The derivatives along the trajectory are not finite."
            return
        try:
            ahead = direction(here)
        except NotPositiveDefinite as error:
            outcome.status, outcome.remark = Status.STEP_TOO_SMALL, f"There is no descent direction: {error}."
            return
        outcome.gains = ahead.K
        length, slope = float(np.linalg.norm(ahead.U)), here.slope(ahead)
        small = not ahead.limited and length <= stopping.tol_direction * np.linalg.norm(here.trajectory.U)
        accepted, evaluations = None, 0
        if small or here.gradient_norm <= stopping.tol_gradient:
            outcome.status = Status.CONVERGED
        elif iteration == stopping.max_iterations:
            outcome.status = Status.MAX_ITERATIONS
        else:
            accepted, evaluations = step(here, ahead)
            outcome.status = Status.STEP_TOO_SMALL
        entry = IterationLog(
            len(monitor.log), here.cost, here.gradient_norm, length, slope,
            0.0 if accepted is None else accepted.alpha, evaluations, monitor.seconds, ahead.multiplier,
            ahead.radius, ahead.predicted, 0.0 if accepted is None else accepted.ratio,
        )  # fmt: skip
        if accepted is not None:
            outcome.iterate = accepted.iterate  # before anyone is told: telling may be interrupted
        stop = monitor.record(entry, here.trajectory)
        if accepted is None:
            return
        if stop:
            outcome.status = Status.STOPPED
            return
