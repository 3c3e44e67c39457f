"""`pronto`: Newton's method on the cost of a projected curve, along trajectories of the linearized dynamics (Hauser).

    minimize  g(xi) = J(P(xi))  over curves xi = (alpha, mu);  P the projection operator (`solvers.projection`)     (10)

    1  K <- gains that track the trajectory, where those at hand do not (`solvers.regulator`)
    2  (z, v) <- minimizer of  a'z + b'v + 1/2 (z, v)'W (z, v)  over z_{n+1} = A_n z_n + B_n v_n,  z_0 = 0      (12), (14)
    3  xi <- P(xi + gamma (z, v)),  gamma = 1, 1/2, 1/4, ... until Armijo's rule holds                               (15)

a, b are the cost's gradients along the trajectory, A, B its linearization. W by `order`:

    "first"          the identity
    "gauss-newton"   second derivatives of the cost, those of residuals left out
    "newton"         second derivatives of g, those of the projection operator included:                            (13)

        D2g.(zeta, zeta) = D2J.(zeta, zeta) + DJ.D2P.(zeta, zeta)
                         = sum_n zeta_n' [ l_n'' + lambda_{n+1}' f_n'' ] zeta_n

    with the costates lambda under feedback (16). For D2P.(zeta, zeta) = (y, -K y) where y runs forward from zero by
    y_{n+1} = (A - B K) y_n + f_n''.(zeta_n, zeta_n), and a'y - b'K y summed over n is what lambda sums backward. These
    costates stay small where those of the open loop grow with the horizon; at a solution both are the same.

Where W is not convex on the linearized trajectories, `globalize` says what to do: "blend" takes as much of the curvature
as leaves it convex, "gauss-newton" none of it, "gopronto" takes first-order steps under feedback instead until it is
convex (section III-B2), "none" ends the solve. Armijo's rule takes every full step near a solution, so that convergence
is quadratic for "newton", and for "gauss-newton" as far as its second derivatives are the whole ones.

Sources: Hauser 2002, "A projection operator approach to the optimization of trajectory functionals"; Sforni et al.,
"GoPRONTO", section II-C.
"""

from __future__ import annotations

import numpy as np

from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.regularize import Damped, damped, solve_with
from mjslq.options import GoprontoOptions, ProntoOptions
from mjslq.solvers.curves import CurveMethod
from mjslq.solvers.damping import UNDAMPED
from mjslq.solvers.gopronto import Gopronto
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import Trial, search
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Step
from mjslq.solvers.newton import by_blend
from mjslq.solvers.projection import Curve, CurveIterate, project

SMALLEST = 2.0**-20
"""Step below which the search gives up."""


class Pronto(CurveMethod):
    """The method."""

    def __init__(self, options: ProntoOptions) -> None:
        super().__init__(options)
        self.options = options
        self._latest: tuple[CurveIterate, CurveIterate, Curve] | None = None  # of a direction; its iterate's gains
        self._first_order: Gopronto | None = None
        if options.globalize == "gopronto":
            self._first_order = Gopronto(GoprontoOptions(gains=options.gains, regulator=options.regulator))
            self._first_order.regulator = self.regulator

    def direction(self, here: Iterate) -> Direction:
        """Step 2."""
        assert isinstance(here, CurveIterate)
        try:
            found, model = self._minimize(here)
        except NotPositiveDefinite:
            if self._first_order is None:
                raise
            self._latest = None
            return self._first_order.direction(here)
        lq = found.found.lq
        change = Curve(lq.X, lq.U)
        at = here.under(lq.K) if self.options.gains == "subproblem" else here
        self._latest = here, at, change
        return Direction(
            lq.X, lq.U, here.feedforward(change), lq.K if self.options.gains == "subproblem" else here.gains,
            model.value(lq.X, lq.U), found.found.held, found.multiplier, sweep=lq,
        )  # fmt: skip

    def curve_step(self, here: CurveIterate, direction: Direction, merit: Merit) -> Step:
        """Step 3."""
        if self._latest is None:
            assert self._first_order is not None
            return self._first_order.curve_step(here, direction, merit)
        _, at, change = self._latest
        trial = Trial(
            merit, here, merit.slope(here, direction), direction.expected, lambda sizes: project(at, change, sizes),
            at_once=here.problem.dynamics.threads, smallest=SMALLEST,
        )  # fmt: skip
        found = search("armijo", trial)
        if found is None:
            return Step(None, rollouts=trial.evaluations)
        return Step(found.iterate, found.alpha, trial.evaluations)

    def restart(self) -> None:
        """See `CurveMethod.restart`."""
        if self._first_order is not None:
            self._first_order.restart()

    def _minimize(self, here: CurveIterate) -> tuple[Damped, LQProblem]:
        """The minimizer of step 2, and its model."""
        convex, box = here.gauss_newton, self.box(here)
        if self.options.order == "first":
            N, ndx, nu = convex.B.shape
            weights = {"Q": np.tile(np.eye(ndx), (N + 1, 1, 1)), "R": np.tile(np.eye(nu), (N, 1, 1))}
            model = convex._replace(**weights, M=np.zeros_like(convex.M))
            return solve_with(model, box, 0.0), model
        if self.options.order == "gauss-newton":
            return damped(convex, box, ladder=UNDAMPED), convex
        model = here.hamiltonian(here.costates)
        try:
            return solve_with(model, box, 0.0), model
        except NotPositiveDefinite:
            if self.options.globalize == "blend":
                return by_blend(model, convex, box), convex
            if self.options.globalize == "gauss-newton":
                return damped(convex, box, ladder=UNDAMPED), convex
            raise
