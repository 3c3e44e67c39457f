"""`slq`: sequential linear quadratic optimization (Sideris and Bobrow 2005, Algorithm 2).

    1  roll out U, linearize the steps and expand the cost along the trajectory
    2  U_bar <- minimizer of the LQ tracking problem so obtained, started at zero (Algorithm 1)
    3  U <- U + alpha U_bar, alpha by line search on the true cost

U_bar is the Gauss-Newton direction of the least-squares problem behind the quadratic cost (Theorem 3), and descends:

    grad J . U_bar = - sum_n [ x_bar'Q x_bar + u_bar'R u_bar ] - x_bar_N'Q_N x_bar_N < 0        (34)

Step 3 adds the change of the controls as it is ("open-loop", the paper's), or lets the sweep's feedback act during
the rollout ("closed-loop": u = u_ref + alpha k - K (x - x_ref)), which unstable systems need. Steps that had to be
shortened are followed by a search along the previous change of the controls (`acceleration.py`).
"""

from __future__ import annotations

from mjslq.lq.modified import convexified
from mjslq.solvers.advance import line_searching
from mjslq.solvers.damping import START, Damping
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.loop import Monitor, Outcome, Stopping, descend


def slq(
    start: Iterate,
    stopping: Stopping,
    monitor: Monitor,
    *,
    line_search: str = "quadratic-fit",
    step: str = "auto",
    acceleration: bool = True,
    multiplier: str | None = None,
    damping: float = START,
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
    multiplier : str, optional
        "control" or "state": what a Levenberg-Marquardt multiplier keeps near the iterate (`damping`). Without it,
        one on the controls comes in only where the line search fails.
    damping : float
        The multiplier to start with, relative to the largest weight of the controls or states.
    """
    advance = line_searching(start, line_search, step, acceleration)
    damper = Damping(start, step, multiplier, damping)

    def direction(here: Iterate) -> Direction:
        return damper.direction(here.gauss_newton) if damper.mu > 0.0 else gauss_newton(here)

    guarded = damper.guard(advance, lambda here: here.gauss_newton)
    return descend(start, direction, guarded, stopping, monitor)


def gauss_newton(here: Iterate) -> Direction:
    """Direction of step 2. Where the model has no minimizer, a multiplier on the controls grows until it has one."""
    lq, multiplier = convexified(here.gauss_newton)
    return Direction(lq.U, lq.k, lq.K, multiplier)
