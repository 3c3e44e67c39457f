"""The outer loop that all methods share: find a direction, test for the end, take a step.

The loop ends when (Sideris and Bobrow 2005, Algorithm 2, Step 2)

    ||U_bar|| <= tol_direction ||U||   or   ||dJ/dU|| <= tol_gradient,

U_bar the direction of the method and dJ/dU the projected gradient, and the states have no gaps; a direction that is
short because a multiplier keeps it so does not count. It never ends by an exception: a start that blows up,
derivatives that are not finite, no step to take, Ctrl-C, a deadline, a callback's wish and errors in callbacks, costs
and simulators all end in a `Status`, with the best iterate at hand.
"""

from __future__ import annotations

import traceback
from dataclasses import dataclass, field

import numpy as np

from mjslq.log import IterationLog
from mjslq.lq.problem import NotPositiveDefinite
from mjslq.options import Stopping
from mjslq.solvers.endings import told_apart
from mjslq.solvers.interrupts import Interrupts
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.merit import CostAndGaps, Merit
from mjslq.solvers.method import Duals, Method, Step
from mjslq.solvers.monitor import Monitor
from mjslq.solvers.steps import rolled_out
from mjslq.status import Status
from mjslq.validation import Array

_NO_DIRECTION = "There is no descent direction: {error}. Give each control a cost, such as mjslq.costs.Control(1e-3)."


@dataclass
class Outcome:
    """Outcome of a descent: its status, the last iterate, and what belongs to it."""

    status: Status
    iterate: Iterate
    gains: Array | None = None
    """Feedback gains at `iterate`; None where the method has none. Shape (N, nu, ndx)."""
    remark: str = ""
    """What the status alone does not tell: the test that fired, for one."""
    gradient_norm: float = np.inf
    """Of the projected gradient at `iterate`; infinite where derivatives fail."""
    multipliers: Array | None = None
    """Of the limits of the controls; None where there are none. Shape (N, nu)."""
    duals: Duals = field(default_factory=Duals)
    """Of the constraints."""
    error: str = ""
    """Traceback of the error that ended the solve."""
    lean: bool = False
    """Whether nothing is to be found at the last iterate (`Stopping.lean`)."""


def descend(start: Iterate, method: Method, stopping: Stopping, monitor: Monitor, interrupts: Interrupts) -> Outcome:
    """Improve `start` until one of the tests above ends it; see the head of this file."""
    outcome, merit = Outcome(Status.DIVERGED, start), CostAndGaps()
    if not np.isfinite(start.cost):
        at = start.trajectory.diverged_at
        outcome.remark = "The cost of the start is not finite."
        if at is not None:
            outcome.remark = f"The start blew up at step {at}."
        return outcome
    try:
        _descend(outcome, method, merit, stopping, monitor, interrupts)
        interrupts.hold()
    except KeyboardInterrupt:
        outcome.status = outcome.status if outcome.status is Status.CONVERGED else Status.INTERRUPTED
    except Exception as error:  # whatever a callback, a cost or MuJoCo raises: the best iterate is not to be lost
        _fail(outcome, error)
    interrupts.hold()
    _finish(outcome, method, stopping.lean)
    if np.isfinite(outcome.gradient_norm):
        outcome.status = told_apart(outcome.status, outcome.iterate)
    outcome.remark = " ".join(part for part in (outcome.remark, method.remark()) if part)
    return outcome


def _descend(
    outcome: Outcome, method: Method, merit: Merit, stopping: Stopping, monitor: Monitor, interrupts: Interrupts
) -> None:
    """Run the loop, keeping `outcome` up to date at every moment, so that an interrupt loses nothing."""
    outcome.iterate = method.begin(outcome.iterate)
    for iteration in range(stopping.max_iterations + 1):
        here = outcome.iterate
        if here.gaps is None and not np.isfinite(here.gradient_norm):
            outcome.status, outcome.remark = Status.DIVERGED, "The derivatives along the trajectory are not finite."
            return
        try:
            ahead = method.direction(here)
        except NotPositiveDefinite as error:
            outcome.status, outcome.remark = Status.STEP_TOO_SMALL, _NO_DIRECTION.format(error=error)
            if here.gaps is None and method.accepts(here) and here.gradient_norm <= stopping.tol_gradient:
                outcome.status, outcome.remark = Status.CONVERGED, _stationary(here, stopping)
            return
        outcome.gains = ahead.K
        merit.update(here, ahead)
        test = _converged(here, ahead, method, stopping)
        step, tried = Step(None), False
        if test:
            outcome.status, outcome.remark = Status.CONVERGED, test
        elif interrupts.count:
            outcome.status = Status.INTERRUPTED
        elif stopping.deadline is not None and monitor.seconds >= stopping.deadline:
            outcome.status = Status.OUT_OF_TIME
        elif iteration == stopping.max_iterations:
            outcome.status = Status.MAX_ITERATIONS
        else:
            step, tried = method.step(here, ahead, merit), True
            outcome.status = step.status
        if step.iterate is not None:
            outcome.iterate = step.iterate  # assigned before callbacks, which may raise
        if monitor.record(_entry(monitor, merit, here, ahead, step, tried), here.trajectory):
            outcome.status = Status.STOPPED if step.iterate is not None else outcome.status
            return
        if step.iterate is None:
            return
        if stopping.lean and iteration + 1 == stopping.max_iterations and not step.rejected:
            outcome.status, outcome.lean = Status.MAX_ITERATIONS, outcome.iterate.gaps is None
            return


def _converged(here: Iterate, ahead: Direction, method: Method, stopping: Stopping) -> str:
    """Which of the tests fires, as a sentence; empty when none does."""
    if here.gaps is not None or not method.accepts(here):
        return ""
    if here.gradient_norm <= stopping.tol_gradient:
        return _stationary(here, stopping)
    length, size = float(np.linalg.norm(ahead.U)), float(np.linalg.norm(here.trajectory.U))
    if here.problem.free_start is not None:  # x_0 is an unknown beside the controls
        length = float(np.hypot(length, np.linalg.norm(ahead.X[0])))
        size = float(np.hypot(size, np.linalg.norm(here.trajectory.X[0])))
    if ahead.limited:
        length = np.inf if ahead.undamped is None else max(length, ahead.undamped)
    if method.tests_direction and length <= stopping.tol_direction * size:
        return (
            f"The direction is {length / max(size, 1e-300):.1e} times as long as the controls, within tol_direction = "
            f"{stopping.tol_direction:g}."
        )
    return ""


def _stationary(here: Iterate, stopping: Stopping) -> str:
    return (
        f"The norm of the projected gradient, {here.gradient_norm:.1e}, is within tol_gradient = "
        f"{stopping.tol_gradient:g}."
    )


def _entry(monitor: Monitor, merit: Merit, here: Iterate, ahead: Direction, step: Step, tried: bool) -> IterationLog:
    problem = here.problem.unpenalized
    return IterationLog(
        iteration=monitor.steps,
        cost=here.cost if problem is here.problem else problem.cost(here.trajectory),
        gradient_norm=here.stationarity(ahead),
        direction_norm=float(np.linalg.norm(ahead.U)),
        slope=merit.slope(here, ahead),
        alpha=step.alpha,
        outcome=("rejected" if step.rejected else "accepted" if step.iterate is not None else "failed")
        if tried
        else "final",
        evaluations=step.rollouts,
        seconds=monitor.seconds,
        multiplier=ahead.multiplier,
        radius=ahead.radius,
        predicted=ahead.expected,
        ratio=step.ratio,
        gap=here.gap,
        limited=int(ahead.held.sum()),
        violation=problem.violation(here.trajectory) if problem.bound_constraints else 0.0,
    )


def _fail(outcome: Outcome, error: Exception) -> None:
    """Note what ended the solve: the first error that there was."""
    if not outcome.error:
        outcome.status, outcome.error = Status.FAILED, "".join(traceback.format_exception(error))
        outcome.remark = f"{type(error).__name__}: {' '.join(str(error).split())}."


def _finish(outcome: Outcome, method: Method, lean: bool) -> None:
    """Roll out a guess of the states that was left open, and find what belongs to the last iterate."""
    try:
        if outcome.iterate.ends is not None:
            outcome.iterate = rolled_out(outcome.iterate, outcome.gains)
        last = outcome.iterate
        if not lean:
            outcome.iterate = method.best(last, outcome.status)
        moved, here = last is not outcome.iterate, outcome.iterate
        outcome.duals = method.duals(here)
        if outcome.lean:
            return
        outcome.gradient_norm = here.gradient_norm
        if here.problem.box.bounded and np.isfinite(here.gradient_norm):
            outcome.multipliers = here.projected_gradient - here.gradient
    except Exception as error:  # as above; most often the same one again
        _fail(outcome, error)
        if outcome.iterate.ends is not None:
            outcome.remark += " The gaps between the steps are not closed."
        return
    if moved or outcome.status in (
        Status.INTERRUPTED,
        Status.STOPPED,
        Status.FAILED,
    ):  # the gains are those of the one before
        try:
            outcome.gains = method.direction(outcome.iterate).K
        except Exception as error:  # as above; the gains of the iterate before serve
            outcome.remark += f" The gains belong to the iterate before ({type(error).__name__})."
