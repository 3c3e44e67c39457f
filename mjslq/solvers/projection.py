"""The projection operator: curves to trajectories by a tracking controller, and the cost's gradient by the curve.

Notation
--------
    alpha_n, mu_n      a curve: states and controls that need not obey the dynamics
    K_n                gains of the tracking controller; difference(.,.) is minus on plain states
    w_n, lambda_n      gradient and costates under feedback (`mjslq.lq.adjoint`)

    P(alpha, mu)       x_0 given,  u_n = [ mu_n + K_n difference(x_n, alpha_n) ],  x_{n+1} = f(x_n, u_n)        (8)-(9)

[.] clips to the limits of the controls. P(P(curve)) = P(curve). The cost of P(curve) has the gradient

    by mu_n:  w_n            by alpha_n:  K_n'w_n                                                               (16)

where lambda runs backward under A - B K: it stays small where an open-loop costate grows with the horizon. Curves are
always taken about the trajectory that they have become, on which the controller does nothing: on plain states that
changes nothing while the gains stay, and on a manifold it makes all the derivatives of difference() the identity there.

Sources: Hauser 2002, "A projection operator approach to the optimization of trajectory functionals"; Sforni,
Spedicato, Notarnicola and Notarstefano, "GoPRONTO: a feedback-based framework for nonlinear optimal control" (the
numbers of equations are its).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mjslq.dynamics.dynamics import Adjoint, Feedback, Sides
from mjslq.lq.adjoint import FIXED, FREE, LOWER, UPPER
from mjslq.lq.box import Box
from mjslq.problem import Problem
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

REMAINS = 0.05
"""Share of a control's slack that a step leaves: next to a limit a barrier is so steep that the way back is long."""


class Curve(NamedTuple):
    """A change of a curve, in tangent directions of its states."""

    alpha: Array
    """Shape (N + 1, ndx)."""
    mu: Array
    """Shape (N, nu)."""

    def scaled(self, factor: float) -> Curve:
        """A multiple."""
        return Curve(factor * self.alpha, factor * self.mu)

    def plus(self, other: Curve, factor: float = 1.0) -> Curve:
        """The sum with a multiple of another."""
        return Curve(self.alpha + factor * other.alpha, self.mu + factor * other.mu)

    def dot(self, other: Curve) -> float:
        """Euclidean inner product."""
        return float(np.vdot(self.alpha, other.alpha) + np.vdot(self.mu, other.mu))


class CurveIterate(Iterate):
    """A trajectory with the gains that track it; its gradient and costates are those under feedback."""

    def __init__(
        self,
        problem: Problem,
        trajectory: Trajectory,
        K: Array | None,
        start: CurveIterate | None = None,
        inside: bool = False,
    ) -> None:
        super().__init__(problem, trajectory)
        self.inside = inside
        """Whether barriers keep the controls inside of their limits, or they may lie on them."""
        self.K = K
        """Gains; None for none, which makes everything here open loop. Shape (N, nu, ndx)."""
        if start is not None and not _keeps(start, self):
            self.cost = np.inf

    def under(self, K: Array | None, problem: Problem | None = None) -> CurveIterate:
        """The same trajectory with other gains, or as an iterate of another cost; its linearization is kept."""
        there = CurveIterate(self.problem if problem is None else problem, self.trajectory, K, inside=self.inside)
        if "linearization" in self.__dict__:
            there.__dict__["linearization"] = self.linearization
        return there

    @cached_property
    def sides(self) -> Sides | None:
        """Where the controls are at limits; None where none is."""
        box, U = self.problem.box, self.trajectory.U
        sides = np.full(U.shape, FREE, np.int8)
        sides[box.lower >= U] = LOWER
        sides[box.upper <= U] = UPPER
        sides[box.lower == box.upper] = FIXED
        return sides if sides.any() else None

    @cached_property
    def along(self) -> Adjoint:
        """Costates and gradient under feedback; no Jacobian is kept."""
        slopes = self.problem.slopes(self.trajectory)
        return self.problem.dynamics.adjoint(self.trajectory, slopes.q, slopes.r, self.K, slopes.y, self.sides)

    @property
    def costates(self) -> Array:
        """Lambda of (16). Shape (N + 1, ndx)."""
        return self.along.costates

    @property
    def gradient(self) -> Array:
        """W of (16): by the feedforward mu. Shape (N, nu)."""
        return self.along.gradient

    @cached_property
    def projected_gradient(self) -> Array:
        """W without the controls that push against a limit. Shape (N, nu)."""
        return np.where(self.along.held, 0.0, self.along.gradient)

    @cached_property
    def gains(self) -> Array | None:
        """The gains that the controller has here: zero for controls that a limit holds."""
        held = self.along.held
        return self.K if self.K is None or not held.any() else np.where(held[:, :, None], 0.0, self.K)

    @cached_property
    def slope(self) -> Curve:
        """The gradient by the curve, projected."""
        w, alpha = self.projected_gradient, np.zeros((self.problem.horizon + 1, self.problem.dynamics.ndx))
        if self.gains is not None:
            alpha[:-1] = np.einsum("nij,ni->nj", self.gains, w)
        return Curve(alpha, w)

    @cached_property
    def gradient_norm(self) -> float:
        """Euclidean norm of the projected gradient by the curve; infinite where there are no finite derivatives."""
        if not np.isfinite(self.cost):
            return np.inf
        with np.errstate(over="ignore", invalid="ignore"):
            norm = np.sqrt(self.slope.dot(self.slope))
        return float(norm) if np.isfinite(norm) else np.inf

    @property
    def reachable(self) -> Box:
        """Limits of the controls after a step: with barriers, `REMAINS` of the slack that there is has to remain."""
        box, U = self.problem.box, self.trajectory.U
        if not (self.inside and box.bounded):
            return box
        return Box(box.lower + REMAINS * (U - box.lower), box.upper - REMAINS * (box.upper - U))

    def slope_along(self, direction: Direction) -> float:
        """Derivative of the cost along a direction, by what it is under the feedback of this iterate."""
        return float(np.vdot(self.gradient, direction.k))

    def feedforward(self, change: Curve) -> Array:
        """Mu + K alpha: the change of a curve as one of the controls under feedback. Shape (N, nu)."""
        return change.mu if self.gains is None else change.mu + np.einsum("nij,nj->ni", self.gains, change.alpha[:-1])


def project(here: CurveIterate, change: Curve, alphas: Sequence[float]) -> list[CurveIterate]:
    """Iterates that multiples of a change of the curve become."""
    problem, at = here.problem, here.trajectory
    dynamics, box = problem.dynamics, here.reachable
    K = np.zeros((problem.horizon, dynamics.nu, dynamics.ndx)) if here.gains is None else here.gains
    found: list[Trajectory] = []
    if here.gains is None or not dynamics.space.parts or not change.alpha.any():
        U = at.U + np.multiply.outer(np.asarray(alphas, dtype=np.float64), here.feedforward(change))
        law = None if here.gains is None else Feedback(at.X, K, box.lower, box.upper)
        x0s = np.tile(at.X[0], (len(U), 1))
        found = dynamics.rollouts(x0s, box.clip(U) if law is None else U, law)
    else:  # the controller's reference itself moves, which a law shared by all cannot
        for size in alphas:
            law = Feedback(dynamics.integrate(at.X, size * change.alpha), K, box.lower, box.upper)
            found += dynamics.rollouts(at.X[:1], (at.U + size * change.mu)[None], law)
    return [CurveIterate(problem, trajectory, here.K, here, here.inside) for trajectory in found]


def _keeps(here: CurveIterate, there: CurveIterate) -> bool:
    """Whether the constraints that `here` meets stay met, and the violation of none of the others grows."""
    problem = here.problem.unpenalized
    if there.trajectory.diverged or not problem.bound_constraints:
        return True
    return all(
        constraint.violation(there.trajectory).max(initial=0.0)
        <= constraint.violation(here.trajectory).max(initial=0.0)
        for constraint in problem.bound_constraints
    )
