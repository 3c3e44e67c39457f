"""The LQ tracking problem with limits on the controls, by projected Newton steps made of Riccati sweeps.

Problem
-------
    minimize the cost of `lq.problem` over U subject to lower_n <= u_n <= upper_n

Free entries of x_0 have no limits and move along with the controls; the gradient by them is the costate at knot 0.

Notation
--------
    m(U), g(U)     cost of the controls with the states eliminated, and its gradient (an adjoint sweep)
    W(U)           working set: controls at a limit with the gradient pushing outward, u = lower and g > 0, or
                   u = upper and g < 0
    [.]            clipping to the limits

Iterations, from U = [0] and W(U)
---------------------------------
    G1  V <- minimizer of m over the controls outside of W, those of W held at their limits: one sweep
    G2  V is the minimizer if it lies within the limits and g(V) pushes all of W outward; else
        W <- W without the controls that g(V) pulls inward, with those that V has beyond a limit

    P1  W <- W(U)
    P2  d <- minimizer of m(U + d) over the controls outside of W, those of W held: one sweep
    P3  U + d within the limits: it is the minimizer if the gradient there still pushes all of W outward;
        else U <- [U + t d],  t = 1, 1/2, 1/4, ... until m falls

G guesses the working set from the minimizer's signs (a primal-dual active set); it takes two to five sweeps, but may
cycle. P takes its place after `GUESSES` sweeps: Newton's method on the free controls, which descends. From an outer
iteration to the next the working set is warm: the controls of an iterate lie exactly on their limits, where W(U) finds
them. Where no limit is in reach the first sweep is the plain one, bit for bit.

The feedback gains are those of the last sweep: zero for controls that are held, the optimal ones among the others.

Sources: Bertsekas 1982, "Projected Newton methods for optimization problems with simple constraints"; Hintermueller,
Ito and Kunisch 2002, "The primal-dual active set strategy as a semismooth Newton method"; Tassa, Mansard and Todorov
2014, "Control-limited differential dynamic programming", for the gains of the free controls.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mjslq.lq.adjoint import adjoint
from mjslq.lq.dense import add_product, copy
from mjslq.lq.problem import LQProblem, LQSolution, Mask, NotPositiveDefinite
from mjslq.lq.riccati import solve
from mjslq.native.arrays import array_kernel
from mjslq.validation import Array

ROUNDS = 60
"""Sweeps after which the best controls found have to do."""
GUESSES = 12
"""Sweeps after which guessing gives way to steps that descend."""
C1 = 1e-4
"""Share of the decrease promised by the slope that a step must bring."""
SMALLEST = 1e-12
"""Step below which there is none."""
ROUNDING = 1e-12
"""Relative size of what is taken for rounding: in costs, in gradients, and of controls beyond a limit."""


class Box(NamedTuple):
    """Limits of the controls, -inf and inf where there are none."""

    lower: Array
    """Shape (N, nu)."""
    upper: Array
    """Shape (N, nu)."""

    @property
    def bounded(self) -> bool:
        """Whether there is any limit."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    def within(self, other: Box, names: Sequence[str]) -> Box:
        """What both allow. Raises ValueError, with the control's name, where that is nothing."""
        both = Box(np.maximum(self.lower, other.lower), np.minimum(self.upper, other.upper))
        for n, i in np.argwhere(~(both.lower <= both.upper)):
            raise ValueError(
                f"limits of the control {names[i]!r} leave nothing at step {n}: one asks for [{self.lower[n, i]:g}, "
                f"{self.upper[n, i]:g}], another for [{other.lower[n, i]:g}, {other.upper[n, i]:g}]"
            )
        return both

    def clip(self, U: Array) -> Array:
        """`U` (N, nu) within the limits, exactly on them where it is beyond."""
        return np.minimum(np.maximum(U, self.lower), self.upper)

    def contains(self, U: Array) -> bool:
        """Whether all of `U` (N, nu) is within the limits, but for rounding."""
        slack = ROUNDING * np.abs(U)
        return bool((self.lower - slack <= U).all() and (self.upper + slack >= U).all())

    def beyond(self, U: Array) -> Mask:
        """Controls of `U` (N, nu) outside of the limits by more than rounding. Shape (N, nu)."""
        slack = ROUNDING * np.abs(U)
        return (self.lower - slack > U) | (self.upper + slack < U)

    def about(self, U: Array) -> Box:
        """Limits of the change from `U`."""
        return Box(self.lower - U, self.upper - U)

    def touches(self, U: Array) -> bool:
        """Whether a control of `U` (N, nu) is at a limit."""
        return bool((self.lower >= U).any() or (self.upper <= U).any())

    def pushed(self, U: Array, gradient: Array) -> Mask:
        """Controls at a limit which the descent direction -gradient would leave. Shape (N, nu)."""
        return ((self.lower >= U) & (gradient > 0.0)) | ((self.upper <= U) & (gradient < 0.0))

    def projected(self, U: Array, gradient: Array) -> Array:
        """The gradient without its entries that push against a limit: zero at a minimum. Shape (N, nu)."""
        return np.where(self.pushed(U, gradient), 0.0, gradient)


class BoxSolution(NamedTuple):
    """Minimizer of an LQ tracking problem within limits."""

    lq: LQSolution
    """As without limits; K and k are those of u_n = k_n - K_n x_n, rows of K zero for held controls."""
    held: Mask
    """Controls that a limit holds. Shape (N, nu)."""
    sweeps: int
    """Riccati sweeps spent."""
    converged: bool
    """Whether the minimizer was reached."""


def solve_in_box(
    problem: LQProblem, box: Box, control_shift: float | Array = 0.0, state_shift: float = 0.0, rounds: int = ROUNDS
) -> BoxSolution:
    """Minimize within limits, between which zero must lie; the shifts are those of `riccati.solve`.

    After `rounds` sweeps the best controls found have to do; the answer says so.

    Raises NotPositiveDefinite when the problem without the held controls has no minimizer.
    """
    U = np.zeros_like(problem.r)
    if not box.bounded:
        return BoxSolution(solve(problem, control_shift, state_shift), U.astype(np.bool_), 1, True)
    X = problem.states(U)
    gradient, held = U, U.astype(np.bool_)
    if box.touches(U):
        gradient = _gradient(problem, X, U)
        held = box.pushed(U, gradient)
    lq = solve(problem, control_shift, state_shift, held)
    if not held.any() and box.contains(lq.U):
        return BoxSolution(lq, held, 1, True)
    shifted = _shifted(problem, control_shift, state_shift)
    guessed = _by_guesses(shifted, box, held, lq, min(GUESSES, rounds - 1))
    if guessed.converged:
        return guessed
    return _by_steps(shifted, box, X, U, held, lq, guessed.sweeps, rounds)


def _by_guesses(problem: LQProblem, box: Box, held: Mask, lq: LQSolution, most: int) -> BoxSolution:
    """Iteration G at the head of this file, from the minimizer `lq` of one sweep with controls `held`."""
    sweeps = 1
    while True:
        U = box.clip(lq.U)
        inside = box.contains(lq.U)
        gradient = problem.control_gradient(lq.X, lq.U, lq.costates) if held.any() else U
        wanted = (held & ~_released(held, box.pushed(U, gradient), gradient)) | box.beyond(lq.U)
        if inside and (wanted == held).all():
            return BoxSolution(lq._replace(U=U), held, sweeps, True)
        if sweeps > most:
            return BoxSolution(lq, held, sweeps, False)
        held, sweeps = wanted, sweeps + 1
        X = problem.states(U, lq.X[0])
        try:
            lq = _moved(solve(problem.about(X, U), held=held), X, U)
        except NotPositiveDefinite:
            return BoxSolution(lq, held, sweeps, False)


def _by_steps(
    problem: LQProblem, box: Box, X: Array, U: Array, held: Mask, lq: LQSolution, sweeps: int, rounds: int
) -> BoxSolution:
    """Iteration P at the head of this file, from controls `U` and the minimizer `lq` with controls `held`."""
    gradient, inside = _gradient(problem, X, U), box.contains(lq.U)
    while True:
        before, x0 = U, X[0]
        if inside:
            X, U = lq.X, box.clip(lq.U)
        else:
            X, U = _clipped_step(problem, box, X, U, lq, gradient)
        gradient = _gradient(problem, X, U)
        pushed = box.pushed(U, gradient)
        if inside and not _released(held, pushed, gradient).any():
            return BoxSolution(lq._replace(U=U), held, sweeps, True)
        if sweeps >= rounds or ((before == U).all() and (x0 == X[0]).all()):
            k = U + np.einsum("nij,nj->ni", lq.K, X[:-1])
            return BoxSolution(lq._replace(X=X, U=U, k=k), held, sweeps, False)
        held, sweeps = pushed, sweeps + 1
        lq = _moved(solve(problem.about(X, U), held=held), X, U)
        inside = box.contains(lq.U)


def _released(held: Mask, pushed: Mask, gradient: Array) -> Mask:
    """Controls that are held, but which the gradient pulls inward by more than rounding. Shape (N, nu)."""
    return held & ~pushed & (np.abs(gradient) > ROUNDING * np.abs(gradient).max(initial=0.0))


def _shifted(problem: LQProblem, control_shift: float | Array, state_shift: float) -> LQProblem:
    """The problem with the shifts in its weights."""
    if not (np.any(control_shift) or state_shift):
        return problem
    (N, nu), nx = problem.r.shape, problem.q.shape[1]
    by_control = np.broadcast_to(control_shift, (N, nu))[:, :, None]
    return problem._replace(R=problem.R + by_control * np.eye(nu), Q=problem.Q + state_shift * np.eye(nx))


def _gradient(problem: LQProblem, X: Array, U: Array) -> Array:
    """g(U), the states following from the controls. Shape (N, nu)."""
    return _gradients(problem, X, U)[1]


def _gradients(problem: LQProblem, X: Array, U: Array) -> tuple[Array, Array]:
    """Costates, the first of which is the gradient by x_0, and g(U). Shapes (N + 1, nx), (N, nu)."""
    here = problem.about(X, U)
    return adjoint(here.A, here.B, here.q, here.r)


def _moved(lq: LQSolution, X: Array, U: Array) -> LQSolution:
    """A solution in the differences from (X, U) as one from zero."""
    whole_X, whole_U = lq.X + X, lq.U + U
    k = whole_U + np.einsum("nij,nj->ni", lq.K, whole_X[:-1])
    return LQSolution(lq.K, k, whole_X, whole_U, lq.P, lq.p - np.einsum("nij,nj->ni", lq.P, X))


def _clipped_step(
    problem: LQProblem, box: Box, X: Array, U: Array, lq: LQSolution, gradient: Array
) -> tuple[Array, Array]:
    """States and controls after the longest of the steps 1, 1/2, 1/4, ..., clipped to the limits, that descends."""
    k = lq.k - np.einsum("nij,nj->ni", lq.K, X[:-1]) - U
    start, t = problem.value(X, U), 1.0
    Y, V = np.empty_like(X), np.empty_like(U)
    by_x0 = 0.0 if problem.free is None else float(_gradients(problem, X, U)[0][0] @ (lq.X[0] - X[0]))
    while t > SMALLEST:
        for K, step in ((lq.K, t * k), (np.zeros_like(lq.K), t * (lq.U - U))):
            Y[0] = X[0] + t * (lq.X[0] - X[0])
            _follow(problem.A, problem.B, problem.c, X, U, K, step, box.lower, box.upper, Y, V)
            if problem.value(Y, V) <= start + C1 * (t * by_x0 + float(np.vdot(gradient, V - U))):
                return Y, V
        t *= 0.5
    return X, U


@array_kernel(
    "lq-follow",
    "void(f8[3], f8[3], f8[2], f8[2], f8[2], f8[3], f8[2], f8[2], f8[2], f8[2], f8[2])",
)
def _follow(A, B, c, X, U, K, k, lower, upper, Y, V):
    """Run the LQ problem's dynamics under v = [U + k - K (y - X)]."""
    N, nx, nu = B.shape
    for n in range(N):
        for i in range(nu):
            v = U[n, i] + k[n, i]
            for j in range(nx):
                v -= K[n, i, j] * (Y[n, j] - X[n, j])
            V[n, i] = min(max(v, lower[n, i]), upper[n, i])
        copy(c[n], Y[n + 1])
        add_product(A[n], Y[n], Y[n + 1])
        add_product(B[n], V[n], Y[n + 1])
