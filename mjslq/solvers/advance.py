"""Steps along a direction: open or closed loop, as far as a line search goes. What all descent methods share.

    open-loop       u_n = u_ref,n + alpha u_bar,n                     the change of the controls as it is
    closed-loop     u_n = u_ref,n + alpha k_n - K_n (x_n - x_ref,n)   under the sweep's feedback, which unstable
                                                                      systems need
    auto            closed loop on the engines that simulate robots, open loop elsewhere

Steps that had to be shortened are followed by a search along the previous change of the controls (`acceleration`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mjslq.solvers.acceleration import accelerate
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import SEARCHES, Trial, in_roundoff, search
from mjslq.solvers.loop import Accepted
from mjslq.validation import Array, choose

SHORT = 0.5
"""Steps below this are followed by the search along the previous change: there the model is poor."""
STEPS = ("auto", "open-loop", "closed-loop")
Advance = Callable[[Iterate, Direction], tuple[Accepted | None, int]]
"""A step rule: the step taken, None for none, and the rollouts spent."""


def line_searching(start: Iterate, line_search: str, step: str, acceleration: bool) -> Advance:
    """Make the step rule of the line-search methods. Raises ValueError for names that there are not."""
    choose("line_search", line_search, SEARCHES)
    kind = kind_of_step(start, step)
    if not isinstance(acceleration, bool):
        raise ValueError(f"acceleration must be True or False, got {acceleration!r}")
    change: Array | None = None  # of the controls, by the step before

    def advance(here: Iterate, direction: Direction) -> tuple[Accepted | None, int]:
        nonlocal change
        slope = here.slope(direction)
        at_once = here.problem.dynamics.candidates_at_once
        trial = Trial(here, slope, lambda alphas: take(here, direction, alphas, kind), at_once=at_once)
        found = search(line_search, trial)
        if found is None:
            return None, trial.evaluations
        there, spent = found.iterate, trial.evaluations
        if acceleration and change is not None and found.alpha < SHORT and not in_roundoff(slope, here.cost):
            there, more = accelerate(there, change)
            spent += more
        change = there.trajectory.U - here.trajectory.U
        return Accepted(found.alpha, there), spent

    return advance


def kind_of_step(start: Iterate, step: str) -> str:
    """Which of the two kinds `step` means for the engine of `start`."""
    if choose("step", step, STEPS) != "auto":
        return step
    return "closed-loop" if start.problem.dynamics.wants_feedback else "open-loop"


def take(here: Iterate, direction: Direction, alphas: Sequence[float], kind: str) -> list[Iterate]:
    """Iterates after steps of the sizes `alphas`."""
    problem, reference = here.problem, here.trajectory
    if kind == "closed-loop":
        trajectories = problem.dynamics.rollout_candidates(reference, direction.K, direction.k, alphas)
    else:
        trajectories = [problem.rollout(reference.U + alpha * direction.U) for alpha in alphas]
    return [Iterate(problem, trajectory) for trajectory in trajectories]
