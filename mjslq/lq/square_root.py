"""The LQ problem with equality rows, by Potter's square-root sweep: free initial states, rows at any step, any weight.

Problem
-------
    minimize   the cost of `lq.problem`  +  1/2 sum_i (H_i x_n + C_i u_n - d_i)^2 / s_i    over the rows with s_i > 0
    subject to x_{n+1} = A_n x_n + B_n u_n + c_n
               H_i x_n + C_i u_n = d_i                                                     for the rows with s_i = 0
               E_N x_N = d_N     terminal rows,        E_0 x_0 = d_0     initial rows, or x_0 given, or free

Each row belongs to a step n and has a scale factor s_i >= 0: zero makes it hard, anything above is the reciprocal of
its weight (a least-squares row, or a constraint with -s_i in the dual block of the first-order conditions).
Weights [Q M'; M R] must be positive semidefinite. A may be singular, linear terms need not lie in the range of the
weights, and rows may depend on each other as long as they do not contradict.

Notation
--------
    W  (N+1, nx, nx)  p  (N+1, nx)      weighted part of the cost-to-go 1/2 |W x|^2 + p'x
    E  (N+1, e, nx)   v  (N+1, e)       hard part: rows E x + v = 0 that the state must meet
    T  (N, nu, nu)    Z  (nu, nx)       pivot rows T u + Z x: the hard ones first, then the weighted ones
    K  (N, nu, nx)    k  (N, nu)        feedback u_n = k_n - K_n x_n, (3.73)
    lambda (N+1, nx)                    costates: derivative of the cost-to-go by the state
    mu, nu(N), nu(0)                    multipliers of path, terminal and initial rows
    psi  (N+1, e)                       v-costate: derivative of the cost by v, (3.105)

Recursion, from W_N'W_N = Q_N, p_N = q_N and the terminal rows down
-------------------------------------------------------------------
The rows of a stage in (u, x), next to their scale factors (3.53)-(3.54), are

    [E+ B, E+ A]   0      rows carried back          [W+ B, W+ A]   1      the weighted part of what follows
    [C,    H   ]   0      its own hard rows          F              1      F'F = [R M; M' Q], Cholesky
                                                     [C, H]/sqrt s  1      its own weighted rows

and a generalized Householder transformation (`lq.householder`) makes of them

    [T_1 T_12 Z_1]  0     as many controls as the hard rows determine
    [0   0    E  ]  0     what they leave to the state; zero rows, which depend on others, are dropped
    [0   T_2  Z_2]  1     the other controls
    [0   0    W  ]  1

so that T K = Z. Only square roots are transformed: P = W'W, which the Riccati recursion carries, is never formed.
Right-hand sides enter a vector recursion alone. The hard rows fix the shift w of the controls at x = 0,
T_1 w_1 = -y_1 with y_1 the transformed offsets (v+ + E+ c, -d), the others of which make up v; then

    beta = p+ + W+'W+ (c + B w),   g = r + R w + B'beta - C'(d - C w)/s
    k = w + u*,   u* the minimizer of g'u + 1/2 |T_2 u|^2 over T_1 u = 0
    p = q + M'w + A'beta - H'(d - C w)/s - K'g

At n = 0 the rows [E; E_0] and [W] determine x_0. Forth go the trajectory, under the feedback, and the multipliers: at
each step those of the pivot rows follow from the derivative by the controls, those of the carried rows are psi_n, and
the transposed transformation turns both into mu_n and psi_{n+1}. The controls may also be had from psi alone (3.108),
but without feedback: on unstable dynamics that ends 1e8 from where it should, the feedback 1e-15.

Where a dependent row contradicts those it depends on, the transposed transformation of what is left of it tells which
these are: rows with multipliers that combine to zero on the left, and not on the right.

Sources: Potter's method as in McQuade 1989, "Trajectory optimization in the presence of constraints", chapter 3, whose
numbers of equations stand above. There rows pair x_{n+1} with u_n, and the cost is 1/2 u'R u alone; here they pair x_n
with u_n, and weights of states, linear terms, offsets c, weighted rows and singular A are added.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.square_root_matrices import Factors, empty_factors, factorize_stages
from mjslq.lq.square_root_rows import (
    Infeasible,
    InitialStage,
    InitialState,
    PathRows,
    Row,
    Sorting,
    StateRows,
    Unbounded,
    conflicting,
    initial_stage,
    sorted_rows,
)
from mjslq.lq.square_root_vectors import backward, forward, residual
from mjslq.validation import Array, as_array, count

__all__ = ["Factorization", "Infeasible", "PathRows", "Solution", "StateRows", "Unbounded", "factorize", "solve"]

WIDE = 1e4
"""Spread of the squared pivots of T up to which rounding stays below 1e-11 without refinement."""
SMALL = 1e-9
"""Relative change by a refinement up to which no second one is made."""

Initial: TypeAlias = StateRows | ArrayLike | Literal["free"] | None
"""Initial state: rows on it, the state itself (nx,), free, or zero (None)."""


class CostToGo(NamedTuple):
    """Least cost from the state x of step n on: 1/2 |W_n x|^2 + p_n'x + a constant, over E_n x + v_n = 0."""

    W: Array
    """Weighted rows, whose scale factors are one. Shape (N + 1, nx, nx)."""
    p: Array
    """Gradient at x = 0. Shape (N + 1, nx)."""
    E: Array
    """Hard rows, whose scale factors are zero; those not in use are zero. Shape (N + 1, e, nx)."""
    v: Array
    """Offsets of the hard rows. Shape (N + 1, e)."""
    psi: Array
    """The v-costate dJ/dv of the hard rows. Shape (N + 1, e)."""


class Solution(NamedTuple):
    """Minimizer, its feedback, and multipliers.

    A multiplier is the derivative of the least cost J by -d, the right-hand side of its row: mu = -dJ/dd, so that
    J + mu'(H x + C u - d) is stationary. Where rows depend on others, the multipliers are one choice among many.
    """

    X: Array
    """Optimal states. Shape (N + 1, nx)."""
    U: Array
    """Optimal controls. Shape (N, nu)."""
    K: Array
    """Feedback gains of u_n = k_n - K_n x_n. Shape (N, nu, nx)."""
    k: Array
    """Feedforward. Shape (N, nu)."""
    costates: Array
    """lambda_n, the derivative of the least cost from step n on by its state. Shape (N + 1, nx)."""
    mu: Array
    """Multipliers of the path rows, in their order. Shape (m,)."""
    nu_terminal: Array
    """Multipliers of the terminal rows. Shape (m,)."""
    nu_initial: Array
    """Multipliers of the initial rows (m,), or of x_0 given (nx,); lambda_0 = -E_0'nu_initial."""
    cost: float
    """J, weighted rows included."""
    to_go: CostToGo
    """Cost-to-go."""
    violation: float
    """Largest |H x + C u - d| of the hard path and terminal rows, over the norms of their coefficients: rounding."""


class _Pass(NamedTuple):
    """What one pass of the vector recursions leaves; rows are sorted by step."""

    X: Array
    U: Array
    costates: Array
    psi: Array
    hard: Array
    weighted: Array
    initial: Array
    k: Array
    p: Array
    v: Array


class Factorization(NamedTuple):
    """A problem whose matrices are swept, to be solved for any right-hand sides. Made by `factorize`."""

    problem: LQProblem
    rows: Sorting
    factors: Factors
    initial: InitialStage
    slack: float
    rounds: int
    """Rounds of refinement that rounding asks for, 0 or 1."""

    def solve(
        self,
        *,
        path: ArrayLike | None = None,
        terminal: ArrayLike | None = None,
        initial: ArrayLike | None = None,
        q: ArrayLike | None = None,
        r: ArrayLike | None = None,
        c: ArrayLike | None = None,
        refinements: int | None = None,
    ) -> Solution:
        """Solve for other right-hand sides; what is left out is as it was given to `factorize`.

        Parameters
        ----------
        path, terminal, initial : array_like
            d of the rows, in their order, or x_0 where that is given. Shape (m,), (m,), (m,) | (nx,).
        q, r, c : array_like
            Linear terms and offsets as in `lq.problem`. Shapes (N + 1, nx), (N, nu), (N, nx).
        refinements : int
            As in `solve`.

        Raises
        ------
        Infeasible, Unbounded
        """
        changed: dict[str, Any] = {
            name: _writable(as_array(name, value, getattr(self.problem, name).shape))
            for name, value in (("q", q), ("r", r), ("c", c))
            if value is not None
        }
        problem = self.problem._replace(**changed)
        d, d_initial = self.rows.right_side(path, terminal), self.initial.right_side(initial)
        d_hard, d_weighted = d[self.rows.from_hard], d[self.rows.from_weighted]
        found = self._pass(problem, d_hard, d_weighted, d_initial, self.slack)
        most = 2 * self.rounds if refinements is None else count("refinements", refinements, 0)
        for _ in range(most):
            better = self._refined(problem, d_hard, d_weighted, d_initial, found)
            change, found = max(np.abs(better.X - found.X).max(), np.abs(better.U - found.U).max()), better
            if refinements is None and change <= SMALL * max(np.abs(found.X).max(), np.abs(found.U).max()):
                break
        k = found.U + np.einsum("nij,nj->ni", self.factors.K, found.X[:-1]) if most else found.k
        multipliers = self.rows.merged(found.hard, found.weighted)
        return Solution(
            found.X, found.U, self.factors.K, k, found.costates,
            multipliers[: self.rows.paths], multipliers[self.rows.paths :], found.initial,
            self._cost(problem, found),
            CostToGo(self.factors.W, found.p, self.factors.E, found.v, found.psi),
            self.rows.violation(found.X, found.U, d_hard),
        )  # fmt: skip

    def _pass(self, problem: LQProblem, d_hard: Array, d_weighted: Array, d_initial: Array, slack: float) -> _Pass:
        """Back and forth once. Raises Infeasible (a dependent row is missed by more than `slack`) and Unbounded."""
        f, hard, weighted = self.factors, self.rows.hard, self.rows.weighted
        (N, nu), nx = problem.r.shape, problem.q.shape[1]
        k, p, v = np.empty((N, nu)), np.empty((N + 1, nx)), np.zeros(f.E.shape[:2])
        failed, y, variance = backward(problem, hard, weighted, d_hard, d_weighted, slack, f, k, p, v)
        if failed >= 0:
            y[: f.pivots[failed] + f.carried[failed]] = 0.0
            raise Infeasible(failed, *self.rows.named(conflicting(hard, f, failed, y)))
        start = self.initial.solve(f, v[0], p[0], d_initial, variance, slack)
        if not isinstance(start, InitialState):
            raise self._contradiction_at_start(start)
        X, U, costates = np.empty((N + 1, nx)), np.empty((N, nu)), np.empty((N + 1, nx))
        psi, mu_hard, mu_weighted = np.zeros_like(v), np.zeros_like(d_hard), np.zeros_like(d_weighted)
        X[0], psi[0] = start.x, start.psi
        forward(problem, hard, weighted, d_weighted, f, k, p, X, U, costates, psi, mu_hard, mu_weighted)
        nu_initial = -costates[0] if self.initial.given else start.nu
        return _Pass(X, U, costates, psi, mu_hard, mu_weighted, nu_initial, k, p, v)

    def _refined(self, problem: LQProblem, d_hard: Array, d_weighted: Array, d_initial: Array, found: _Pass) -> _Pass:
        """The solution after one step of iterative refinement on the first-order conditions."""
        rest = problem._replace(**{name: np.empty_like(getattr(problem, name)) for name in ("q", "r", "c")})
        rest_hard, rest_weighted = np.empty_like(d_hard), np.empty_like(d_weighted)
        residual(
            problem, self.rows.hard, self.rows.weighted, d_hard, d_weighted, found.X, found.U, found.costates,
            found.hard, found.weighted, rest, rest_hard, rest_weighted,
        )  # fmt: skip
        start = self.initial
        at_start = found.costates[0] + start.H.T @ found.initial
        rest.q[0] += at_start
        rest_initial = d_initial + start.scale * found.initial - start.H @ found.X[0]
        change = self._pass(rest, rest_hard, rest_weighted, rest_initial, np.inf)
        changed = {name: getattr(found, name) + getattr(change, name) for name in _Pass._fields[:7]}
        changed["costates"][0] -= at_start
        return found._replace(**changed)

    def _cost(self, problem: LQProblem, found: _Pass) -> float:
        soft = self.initial.scale > 0.0
        total = problem.value(found.X, found.U)
        total += 0.5 * float(self.rows.weighted.scale @ found.weighted**2)
        return total + 0.5 * float(self.initial.scale[soft] @ found.initial[soft] ** 2)

    def _contradiction_at_start(self, rest: Array) -> Infeasible:
        """The error for what is left of the hard rows on x_0: those carried back, then the initial ones."""
        f, e, start = self.factors, int(self.factors.carried[0]), self.initial
        w = np.zeros(f.h.shape[1])
        w[f.pivots[0] : f.pivots[0] + e] = rest[:e]
        rows, multipliers = self.rows.named(conflicting(self.rows.hard, f, 0, w))
        own = -f.E[0, :e].T @ rest[:e] if start.given else rest[e:]
        places = np.arange(len(start.d)) if start.given else np.flatnonzero(start.scale == 0.0)
        keep = np.abs(own) > 1e-6 * np.abs(own).max(initial=0.0)
        first = [Row("initial", int(i), 0) for i in places[keep]]
        return Infeasible(0, first + rows, np.concatenate([own[keep], multipliers]))


def solve(
    problem: LQProblem,
    path: PathRows | None = None,
    terminal: StateRows | None = None,
    initial: Initial = None,
    *,
    slack: float = 1e-12,
    refinements: int | None = None,
) -> Solution:
    """Minimize by one sweep back and one forth.

    Parameters
    ----------
    problem : LQProblem
        Dynamics and cost as in `lq.problem`; the weights of each stage positive semidefinite.
    path : PathRows
        Rows on states and controls, any number at any step.
    terminal : StateRows
        Rows on x_N.
    initial : StateRows or array_like or "free"
        Rows on x_0, x_0 itself (nx,), or nothing at all; zero unless given. What rows and cost do not determine of x_0
        is taken as small as can be.
    slack : float
        What may be left of the right side of a row that depends on others, in rows scaled to norm one, besides
        rounding.
    refinements : int
        Rounds of iterative refinement. Unless given, none for an initial state given, no hard rows carried back
        and pivots of similar size, else one, and a second one where the first changes much.

    Returns
    -------
    Solution

    Raises
    ------
    NotPositiveDefinite
        Naming the step whose weights are not positive semidefinite, or whose controls are not determined.
    Infeasible
        Naming the step and the rows that contradict each other.
    Unbounded
        When the cost falls without bound along free initial states.
    ValueError
        For arrays of wrong shapes, and entries that are not finite.

    Examples
    --------
    A double integrator, the position given at three samples, the second control too, the initial speed free
    (McQuade 1989, section 3.6):

    >>> import numpy as np
    >>> from mjslq.lq.problem import LQProblem
    >>> from mjslq.lq.square_root import PathRows, StateRows, solve
    >>> problem = LQProblem(
    ...     A=np.tile([[1.0, 1.0], [0.0, 1.0]], (2, 1, 1)), B=np.tile([[0.5], [1.0]], (2, 1, 1)), c=np.zeros((2, 2)),
    ...     Q=np.zeros((3, 2, 2)), R=np.ones((2, 1, 1)), M=np.zeros((2, 1, 2)), q=np.zeros((3, 2)), r=np.zeros((2, 1)))
    >>> path = PathRows(step=[1, 1], H=[[1.0, 0.0], [0.0, 0.0]], C=[[0.0], [1.0]], d=[0.3, 0.2])
    >>> terminal = StateRows(H=[[1.0, 0.0]], d=[1.0])
    >>> initial = StateRows(H=[[1.0, 0.0]], d=[0.0])
    >>> found = solve(problem, path, terminal, initial)
    >>> found.U.ravel().round(12)
    array([0.6, 0.2])
    >>> found.X[:, 1].round(12) + 0.0
    array([0. , 0.6, 0.8])
    >>> round(found.cost, 12)
    0.2
    >>> found.mu.round(12)
    array([2.4, 0.4])
    >>> found.nu_initial.round(12)
    array([-1.2])
    """
    return factorize(problem, path, terminal, initial, slack=slack).solve(refinements=refinements)


def factorize(
    problem: LQProblem,
    path: PathRows | None = None,
    terminal: StateRows | None = None,
    initial: Initial = None,
    *,
    slack: float = 1e-12,
) -> Factorization:
    """Sweep the matrices only; parameters and errors are those of `solve`, which `Factorization.solve` completes."""
    problem = _checked(problem)
    N, nx, nu = problem.B.shape
    rows = sorted_rows(path, terminal, N, nx, nu)
    factors = empty_factors(rows.hard.start, N, nx, nu)
    failed = factorize_stages(problem, rows.hard, rows.weighted, factors)
    if failed >= 0:
        raise NotPositiveDefinite(failed)
    start = initial_stage(initial, factors)
    return Factorization(problem, rows, factors, start, slack, _rounds(start, factors))


def _checked(problem: LQProblem) -> LQProblem:
    if problem.free is not None:
        raise ValueError("problem.free must be None; say by initial= what of the initial state is free")
    B = as_array("B", problem.B, ("N", "nx", "nu"))
    N, nx, nu = B.shape
    if not B.size:
        raise ValueError(f"B must hold at least one step, state and control, got shape {B.shape}")
    shapes = {
        "A": (N, nx, nx), "B": (N, nx, nu), "Q": (N + 1, nx, nx), "R": (N, nu, nu), "M": (N, nu, nx),
        "q": (N + 1, nx), "r": (N, nu), "c": (N, nx),
    }  # fmt: skip
    arrays: dict[str, Any] = {
        name: _writable(as_array(name, getattr(problem, name), shape)) for name, shape in shapes.items()
    }
    return LQProblem(**arrays)


def _writable(array: Array) -> Array:
    """The array, or a copy of one that is read-only, for which the kernels would have to be compiled again."""
    return array if array.flags.writeable else array.copy()


def _rounds(initial: InitialStage, factors: Factors) -> int:
    """Rounds of refinement that rounding asks for: rows that are carried back gather it."""
    pivots = np.abs(factors.T.diagonal(axis1=1, axis2=2))
    hard = np.arange(pivots.shape[1]) < factors.pivots[:-1, None]
    weighted = pivots[~hard]
    spread = max(weighted.max(initial=0.0) / weighted.min(initial=np.inf), 1.0 / pivots[hard].min(initial=1.0))
    return int(bool(factors.carried.any()) or not initial.given or spread**2 > WIDE)
