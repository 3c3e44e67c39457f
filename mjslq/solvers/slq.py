"""`slq`: sequential linear quadratic optimization (Sideris and Bobrow 2005, Algorithm 2).

    1  roll out U, linearize the steps and expand the cost along the trajectory
    2  U_bar <- minimizer of the LQ tracking problem so obtained, started at zero (Algorithm 1)
    3  U <- U + alpha U_bar, alpha by line search on the true cost

U_bar is the Gauss-Newton direction of the least-squares problem behind the quadratic cost (Theorem 3), and descends:

    grad J . U_bar = - sum_n [ x_bar'Q x_bar + u_bar'R u_bar ] - x_bar_N'Q_N x_bar_N < 0        (34)

Step 3 adds the change of the controls as it is ("open-loop", the paper's), or lets the sweep's feedback act during
the rollout ("closed-loop": u = u_ref + alpha k - K (x - x_ref)), which unstable systems need. Steps that had to be
shortened are followed by a search along the previous change of the controls (`_acceleration.py`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjslq._validation import Array, choose
from mjslq.lq.riccati import LQProblem, NotPositiveDefinite, solve
from mjslq.solvers._acceleration import accelerate
from mjslq.solvers._iterate import Direction, Iterate
from mjslq.solvers._linesearch import SEARCHES, Trial, in_roundoff, search
from mjslq.solvers._loop import Accepted, Monitor, Outcome, Stopping, descend

STEPS = ("auto", "open-loop", "closed-loop")


def slq(
    start: Iterate,
    stopping: Stopping,
    monitor: Monitor,
    *,
    line_search: str = "quadratic-fit",
    step: str = "auto",
    acceleration: bool = True,
) -> Outcome:
    """Minimize from `start`.

    Parameters
    ----------
    line_search : str
        "quadratic-fit", "armijo", "goldstein", "wolfe" or "exact".
    step : str
        "open-loop", "closed-loop", or "auto": closed loop on the engines that simulate robots, open loop elsewhere.
    acceleration : bool
        After a step that the line search had to shorten, also search along the previous change of the controls.
    """
    choose("line_search", line_search, SEARCHES)
    choose("step", step, STEPS)
    if not isinstance(acceleration, bool):
        raise ValueError(f"acceleration must be True or False, got {acceleration!r}")
    if step == "auto":
        step = "closed-loop" if start.problem.dynamics.wants_feedback else "open-loop"
    change: Array | None = None  # of the controls, by the step before

    def advance(here: Iterate, direction: Direction) -> tuple[Accepted | None, int]:
        nonlocal change
        slope = here.slope(direction)
        at_once = here.problem.dynamics.candidates_at_once
        trial = Trial(here, slope, lambda alphas: take(here, direction, alphas, step), at_once=at_once)
        found = search(line_search, trial)
        if found is None:
            return None, trial.evaluations
        there, spent = found.iterate, trial.evaluations
        if acceleration and change is not None and found.alpha < 1.0 and not in_roundoff(slope, here.cost):
            there, more = accelerate(there, change)
            spent += more
        change = there.trajectory.U - here.trajectory.U
        return Accepted(found.alpha, there), spent

    return descend(start, gauss_newton, advance, stopping, monitor)


def gauss_newton(here: Iterate) -> Direction:
    """Direction of step 2. Where the model has no minimizer, a multiplier on the controls grows until it has one."""
    A, B, _, _ = here.linearization
    Q, R, M, q, r = here.expansion
    c = np.zeros_like(here.trajectory.U, shape=(len(A), A.shape[1]))
    scale = max(1.0, float(np.abs(R).max()))
    multiplier = 0.0
    while True:
        try:
            lq = solve(LQProblem(A, B, Q, R, M, q, r, c), multiplier)
        except NotPositiveDefinite:
            multiplier = max(10.0 * multiplier, 1e-6 * scale)
            if multiplier > 1e12 * scale:
                raise
            continue
        return Direction(lq.U, lq.k, lq.K, multiplier)


def take(here: Iterate, direction: Direction, alphas: Sequence[float], step: str) -> list[Iterate]:
    """Iterates after steps of the sizes `alphas`."""
    problem, reference = here.problem, here.trajectory
    if step == "closed-loop":
        trajectories = problem.dynamics.rollout_candidates(reference, direction.K, direction.k, alphas)
    else:
        trajectories = [problem.rollout(reference.U + alpha * direction.U) for alpha in alphas]
    return [Iterate(problem, trajectory) for trajectory in trajectories]
