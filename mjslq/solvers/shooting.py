"""Multiple shooting: from a guess of the states, which need not obey the dynamics, to a trajectory that does.

    minimize   J(X, U)   subject to   f_n(x_n, u_n) = x_{n+1},   x_0 given

    gaps       c_n = f_n(x_n, u_n) - x_{n+1}              (difference(x_{n+1}, f_n) on a manifold)
    step       (x_bar, u_bar) <- minimizer of the LQ problem about (X, U) with the affine dynamics
                   x_bar_{n+1} = A_n x_bar_n + B_n u_bar_n + c_n,   x_bar_0 = 0,
               X <- X + t x_bar,  U <- U + t u_bar:  a full step closes the gaps to first order
    costates   lambda = p + P x_bar, the sweep's, with which `newton` weighs the curvature of the steps
    merit      phi = J + nu sum_n |c_n|_1,  nu at least twice the largest costate, so that phi falls along the step:
                   phi' = q'x_bar + r'u_bar - nu sum_n |c_n|_1

States far from each other are steered side by side, so that what one step does is not amplified by all later ones:
unstable motions and the force peaks of strong drag, at which single shooting fails or creeps, take a few iterations.
Once the gaps are closed (`CLOSED`), or steps become short (`SHORT`) while a rollout has the lower merit, the states
are rolled out, under the sweep's feedback so that rounding does not grow, and single shooting ends the search: the
result obeys the dynamics to rounding.

Sources: Bock and Plitt 1984, "A multiple shooting algorithm for direct solution of optimal control problems";
Nocedal and Wright, Numerical Optimization, chapter 18.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mjslq.costs import Expansion
from mjslq.dynamics.dynamics import Linearization
from mjslq.log import IterationLog
from mjslq.lq.modified import convexified
from mjslq.lq.riccati import LQProblem, LQSolution, NotPositiveDefinite
from mjslq.problem import Problem
from mjslq.solvers.iterate import Iterate
from mjslq.solvers.loop import Monitor, Stopping
from mjslq.solvers.newton import by_multiplier, convex_solution
from mjslq.status import Status
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

CLOSED = 1e-4
"""Largest gap, relative to the largest entry of the states, that the rollout at the end closes."""
SMALLEST = 2.0**-20
"""Step below which the search for a lower merit gives up."""
SHORT = 0.05
"""Step below which a rollout of lower merit is taken instead."""
C1 = 1e-4


class Guess:
    """States and controls with gaps between them; what is asked about them is computed once."""

    def __init__(self, problem: Problem, X: Array, U: Array) -> None:
        dynamics = problem.dynamics
        self.problem = problem
        self.ends, Y = dynamics.step_each(X, U)
        self.finite = bool(np.isfinite(self.ends).all() and np.isfinite(Y).all())
        self.trajectory = Trajectory(X, U, Y if self.finite else np.zeros((0, 0)), dynamics.dt)
        self.gaps = dynamics.difference(X[1:], self.ends) if self.finite else np.full((len(U), dynamics.ndx), np.inf)
        self.cost = problem.cost(self.trajectory) if self.finite else np.inf

    @property
    def gap(self) -> float:
        """The largest gap."""
        return float(np.abs(self.gaps).max(initial=0.0))

    @property
    def closed(self) -> bool:
        """Whether a rollout may close what gaps there are."""
        return self.gap <= CLOSED * max(1.0, float(np.abs(self.trajectory.X).max()))

    def slope(self, lq: LQSolution, nu: float) -> float:
        """Derivative of the merit along a step."""
        _, _, _, _, _, q, r, c = self.gauss_newton
        return float(np.vdot(q, lq.X) + np.vdot(r, lq.U)) - nu * float(np.abs(c).sum())

    def merit(self, nu: float) -> float:
        """J + nu sum |c_n|."""
        return self.cost + nu * float(np.abs(self.gaps).sum())

    @cached_property
    def _steps(self) -> Linearization:
        return self.problem.dynamics.linearize_steps(self.trajectory.X, self.trajectory.U, self.ends)

    @cached_property
    def expansion(self) -> Expansion:
        """Of the cost, about the guess."""
        return self.problem.expand(self.trajectory, self._steps)

    @cached_property
    def gauss_newton(self) -> LQProblem:
        """The LQ problem about the guess, convex, with the gaps in its dynamics."""
        A, B, _, _ = self._steps
        J = self.problem.dynamics.difference_jacobian(self.trajectory.X[1:], self.ends)
        if J is not None:  # tangent directions of the next state instead of those of the step's end
            A, B = J @ A, J @ B
        Q, R, M, q, r = self.expansion
        return LQProblem(A, B, Q, R, M, q, r, np.ascontiguousarray(self.gaps))

    def newton(self, costates: Array) -> LQProblem:
        """The same with the curvature of the steps, weighed by costates (N + 1, ndx)."""
        full, weights = self.problem.complete(self.trajectory, self.expansion)
        xx, ux, uu = self.problem.dynamics.hessian(self.trajectory, costates, weights, self._steps, self.ends)
        return self.gauss_newton._replace(Q=full.Q + xx, R=full.R + uu, M=full.M + ux)

    def gradient_norm(self, costates: Array) -> float:
        """Norm of the Lagrangian's derivative by the controls, r_n + B_n'lambda_{n+1}."""
        model = self.gauss_newton
        return float(np.linalg.norm(model.r + np.einsum("nij,ni->nj", model.B, costates[1:])))


class Closed(NamedTuple):
    """Where closing the gaps ended."""

    iterate: Iterate
    """What is left, rolled out."""
    status: Status | None
    """Why the solve is over, or None when it goes on from `iterate`."""
    gains: Array
    """Feedback gains of the last sweep. Shape (N, nu, ndx)."""


def close_gaps(problem: Problem, X: Array, U: Array, stopping: Stopping, monitor: Monitor, second: bool) -> Closed:
    """Iterate from a state guess `X` (N + 1, nx) and controls `U` until there are no gaps; never raises for a model.

    `second` takes in the curvature of the steps.
    """
    here, status, nu = Guess(problem, X, U), None, 0.0
    K = np.zeros((problem.horizon, problem.dynamics.nu, problem.dynamics.ndx))
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            while status is None and not here.closed and np.isfinite(here.cost):
                if len(monitor.log) >= stopping.max_iterations:
                    status = Status.MAX_ITERATIONS
                    break
                lq, multiplier = _direction(here, second)
                costates = _costates(lq)
                K, nu = lq.K, max(nu, 2.0 * float(np.abs(costates).max()))
                slope = here.slope(lq, nu)
                t, there, spent = _step(here, lq, slope, nu)
                entry = IterationLog(
                    len(monitor.log), here.cost, here.gradient_norm(costates), float(np.linalg.norm(lq.U)), slope,
                    t, spent, monitor.seconds, multiplier, gap=here.gap,
                )  # fmt: skip
                before, here = here, there
                if monitor.record(entry, before.trajectory):
                    status = Status.STOPPED
                if t < SHORT and (rolled := _rolled_out(here, K)).cost <= here.merit(nu):
                    return Closed(rolled, status, K)
                if t == 0.0:
                    break
    except NotPositiveDefinite:  # also of numbers that are not finite: on from what there is
        pass
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    return Closed(_rolled_out(here, K), status, K)


def _direction(here: Guess, second: bool) -> tuple[LQSolution, float]:
    lq, multiplier = convexified(here.gauss_newton)
    if not second:
        return lq, multiplier
    return convex_solution(here.newton(_costates(lq)), here.gauss_newton, by_multiplier)


def _costates(lq: LQSolution) -> Array:
    return lq.p + np.einsum("nij,nj->ni", lq.P, lq.X)


def _step(here: Guess, lq: LQSolution, slope: float, nu: float) -> tuple[float, Guess, int]:
    """Halve the step until the merit falls; 0 when it does not."""
    t, spent, start = 1.0, 0, here.merit(nu)
    while t > SMALLEST:
        X = here.problem.dynamics.integrate(here.trajectory.X, t * lq.X)
        there, spent = Guess(here.problem, X, here.trajectory.U + t * lq.U), spent + 1
        if there.merit(nu) <= start + C1 * t * slope:
            return t, there, spent
        t *= 0.5
    return 0.0, here, spent


def _rolled_out(here: Guess, K: Array) -> Iterate:
    """The guess as a trajectory that obeys the dynamics; the better of closed and open loop."""
    problem, reference = here.problem, here.trajectory
    found = [Iterate(problem, problem.dynamics.rollout_feedback(reference, K, np.zeros_like(reference.U)))]
    if not np.isfinite(found[0].cost):
        found.append(Iterate(problem, problem.rollout(reference.U)))
    return min(found, key=lambda iterate: iterate.cost)


def shortened(stopping: Stopping, monitor: Monitor) -> Stopping:
    """What is left of the iterations."""
    return dataclasses.replace(stopping, max_iterations=stopping.max_iterations - len(monitor.log))
