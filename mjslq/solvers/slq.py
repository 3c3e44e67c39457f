"""`slq`: sequential linear quadratic optimization (Sideris and Bobrow 2005, Algorithm 2), known as iLQR, too.

    1  roll out U, linearize the steps and expand the cost along the trajectory
    2  U_bar <- minimizer of the LQ tracking problem so obtained, started at zero (Algorithm 1), within the limits of
       the controls (`lq.box`)
    3  U <- U + alpha U_bar, alpha by line search on the true cost

U_bar is the Gauss-Newton direction of the least-squares problem behind the quadratic cost (Theorem 3), and descends:

    grad J . U_bar = - sum_n [ x_bar'Q x_bar + u_bar'R u_bar ] - x_bar_N'Q_N x_bar_N < 0        (34)

Beyond the paper: the sweep's feedback acts during the rollouts of step 3 (`steps`), short steps are followed by a
search along the previous change (`acceleration`), and a multiplier comes in where the search fails (`damping`).
"""

from __future__ import annotations

from mjslq.options import SLQOptions
from mjslq.solvers.damping import Damping
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Method, Step
from mjslq.solvers.steps import LineSearch


class SLQ(Method):
    """Sequential linear quadratic optimization; keeps its multiplier from iteration to iteration."""

    def __init__(self, options: SLQOptions) -> None:
        self.options = options
        self.search = LineSearch(options)
        by = options.multiplier
        self.damping = Damping("state") if by == "state" else Damping()
        self.damping.mu = 0.0 if by is None else options.damping

    def direction(self, here: Iterate) -> Direction:
        """Step 2. Where the model has no minimizer, a multiplier on the controls grows until it has one."""
        return self.damping.direction(here.gauss_newton, here.box)

    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """Step 3."""
        step = self.search(here, direction, merit)
        if step.iterate is not None:
            self.damping.adapt(step)
        elif self.options.rescue and here.gaps is None:
            rescued = self.damping.rescue(here, here.gauss_newton, self.options.step, merit)
            return Step(rescued.iterate, rescued.alpha, step.rollouts + rescued.rollouts)
        return step
