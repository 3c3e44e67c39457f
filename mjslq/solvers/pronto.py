"""`pronto`: Newton's method on the cost of a projected curve, along trajectories of the linearized dynamics (Hauser).

    minimize  g(xi) = J(P(xi))  over curves xi = (alpha, mu);  P the projection operator (`solvers.projection`)     (10)

    1  K <- gains that track the trajectory, where those at hand do not (`solvers.regulator`)
    2  (z, v) <- minimizer of  a'z + b'v + 1/2 (z, v)'W (z, v)  over z_{n+1} = A_n z_n + B_n v_n,  z_0 = 0  (12), (14)
    3  xi <- P(xi + gamma (z, v)),  gamma = 1, 1/2, 1/4, ... until Armijo's rule holds                       (15)

a, b are the cost's gradients along the trajectory, A, B its linearization. W by `order`:

    "first"          the identity
    "gauss-newton"   second derivatives of the cost, those of residuals left out
    "newton"         second derivatives of g, those of the projection operator included:                            (13)

        D2g.(zeta, zeta) = D2J.(zeta, zeta) + DJ.D2P.(zeta, zeta)
                         = sum_n zeta_n' [ l_n'' + lambda_{n+1}' f_n'' ] zeta_n

    with the costates lambda under feedback (16). For D2P.(zeta, zeta) = (y, -K y) where y runs forward from zero by
    y_{n+1} = (A - B K) y_n + f_n''.(zeta_n, zeta_n), and a'y - b'K y summed over n is what lambda sums backward. These
    costates stay small where those of the open loop grow with the horizon; at a solution both are the same.

Where W is not convex on the linearized trajectories, `globalize` says what to do: "blend" takes as much of the
curvature as leaves it convex, "gauss-newton" none of it, "gopronto" takes first-order steps under feedback instead
until it is convex (section III-B2), "none" ends the solve. Armijo's rule takes every full step near a solution, so
that convergence is quadratic for "newton", and for "gauss-newton" as far as its second derivatives are the whole ones.

With limits="clip" the LQ problem keeps to the limits of the controls (`lq.box`); where its minimizer among them is not
found, controls that gradients push against their limits stay there, and the others move by the problem without these
(Bertsekas 1982, projected Newton). The projection operator clips. With barriers a direction counts as short only if it
promises less than `LITTLE` eps, too: next to a limit every step is short.

Sources: Hauser 2002, "A projection operator approach to the optimization of trajectory functionals"; Sforni et al.,
"GoPRONTO", section II-C.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mjslq.lq.box import solve_in_box
from mjslq.lq.problem import LQProblem, LQSolution, NotPositiveDefinite
from mjslq.lq.regularize import largest_weight
from mjslq.lq.riccati import solve
from mjslq.options import GoprontoOptions, ProntoOptions
from mjslq.solvers.curves import CurveMethod
from mjslq.solvers.damping import UNDAMPED
from mjslq.solvers.gopronto import Gopronto
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import Trial, search
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Step
from mjslq.solvers.projection import Curve, CurveIterate, project

SMALLEST = 2.0**-20
"""Step below which the search gives up."""
SWEEPS = 15
"""Sweeps within which an LQ problem's minimizer among the limits has to be found."""
LITTLE = 1e-2
"""Of the barrier's weight; see above."""
SHARES = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Of the curvature that "blend" tries to keep, one after the other."""


class Pronto(CurveMethod):
    """The method PRONTO; see the head of this file."""

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
            lq, model, multiplier = self._minimize(here)
        except NotPositiveDefinite:
            if self._first_order is None:
                raise
            self._latest = None
            return self._first_order.direction(here)
        change = Curve(lq.X, lq.U)
        at = here.under(lq.K) if self.options.gains == "subproblem" else here
        self._latest = here, at, change
        slope = abs(float(np.vdot(here.gradient, here.feedforward(change))))
        short = multiplier > 0.0 or (self.barrier is not None and slope > LITTLE * self.barrier.eps)
        return Direction(
            lq.X, lq.U, here.feedforward(change), lq.K if self.options.gains == "subproblem" else here.gains,
            model.value(lq.X, lq.U), here.along.held, multiplier,
            limited=short, sweep=lq,
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

    def _minimize(self, here: CurveIterate) -> Minimizer:
        """Step 2. Raises NotPositiveDefinite where there is no minimizer, and none is to be made up."""
        convex = here.gauss_newton
        limited = None if self.barriers_controls else here
        if self.options.order == "first":
            return _solved(_first_order_model(convex), limited)
        if self.options.order == "newton":
            model, shares = here.hamiltonian(here.costates), {"blend": SHARES, "gauss-newton": (1.0,)}
            for share in shares.get(self.options.globalize, (1.0,)):
                try:
                    return _solved(_between(convex, model, share), limited)
                except NotPositiveDefinite:
                    if self.options.globalize in ("gopronto", "none"):
                        raise
        mu = 0.0
        while True:
            try:
                return _solved(convex, limited, mu * largest_weight(convex))
            except NotPositiveDefinite:
                mu = UNDAMPED.above(mu)
                if mu > UNDAMPED.largest:
                    raise


class Minimizer(NamedTuple):
    """Minimizer of an LQ problem."""

    lq: LQSolution
    model: LQProblem
    multiplier: float
    """Added to the weights of the controls."""


def _solved(model: LQProblem, here: CurveIterate | None, multiplier: float = 0.0) -> Minimizer:
    """The minimizer; within the limits of the controls along `here`, where they are to be kept by clipping."""
    if here is None:
        return Minimizer(solve(model, multiplier), model, multiplier)
    found = solve_in_box(model, here.box, multiplier, rounds=SWEEPS)
    lq = found.lq if found.converged else solve(model, multiplier, held=here.along.held)
    return Minimizer(lq, model, multiplier)


def _first_order_model(convex: LQProblem) -> LQProblem:
    """W = I."""
    N, ndx, nu = convex.B.shape
    Q, R = np.tile(np.eye(ndx), (N + 1, 1, 1)), np.tile(np.eye(nu), (N, 1, 1))
    return convex._replace(Q=Q, R=R, M=np.zeros_like(convex.M))


def _between(convex: LQProblem, model: LQProblem, share: float) -> LQProblem:
    """The convex model with a share of the curvature that it lacks."""
    if share == 1.0:
        return model
    parts = {name: getattr(convex, name) for name in "QRM"}
    return convex._replace(**{name: part + share * (getattr(model, name) - part) for name, part in parts.items()})
