"""`square-root-sweep`: constraints corrected by fixed percentages, by Potter's sweep (McQuade 1989).

Sources: T. E. McQuade, "Trajectory optimization in the presence of constraints", MIT 1989, whose numbers of equations
stand below. Made to show the method as the thesis has it; `constrained` is the one to use.

An iteration
------------
    minimize  1/2 sum_n du_n'R du_n                                                            (2.46)
    subject to the linearized dynamics, dx_0 = 0 but for free entries, and the rows

    dm = -c_m m, dq = -c_m q  terminal and initial equalities                                  (2.29)-(2.30), (2.34)
    dw_n = -c_w w_n          other constraints, only where they are violated                   (2.31), (2.41)
    dJ = -c_J |J|            the cost, a terminal row, too                                     (2.28), (4.16)

by one square-root sweep (`lq.square_root`), and a rollout under its feedback (3.73), or with du alone (3.108). Running
costs become a terminal one as in (4.6): by an additional state z_{n+1} = z_n + l(x_n, u_n), in the LQ problem only.
Its feedback is the one planned, since a simulated trajectory has no z. Limits of the controls are constraints like the
others: (5.13).

Acceptance (section 2.5), V being the root of the summed squares of the violations:

    V, J better               accept
    V better, J worse         accept if J is worse by `degradation` |J| at most, or without the row of the cost;
                              else halve c_J
    V worse                   halve c_J, c_m, c_w

The sweep is factorized once an iteration; other percentages are other right-hand sides.

Without the row of the cost (section 4.2): for an iteration in which it contradicts the other rows, as in Example 1
from u = -2, and in which no c_J is accepted while there are violations.

Thresholding (4.20): a limit counts as violated from `threshold` times its size on (a limit of zero: from
`threshold` - 1 on). The threshold shrinks towards 1 when nothing is accepted, and every `PERIOD` iterations. At 1,
limits that are touched are rows, so that they hold, once none is violated.

Too many rows at a time (section 5.4-5.5): in the first iteration only the constraints named by `first` are corrected,
beside equalities, and V counts them alone; `overlap` is the share of a control limit's correction where other rows act
at the same step.

End
---
The first-order conditions are tested by the projected gradient (`constraint_rows`). The thesis has no such test, nor a
way to choose c_J: most often the method ends where the constraints are met and no decrease of the cost is accepted,
and says so: that is no convergence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjslq.constraints import RESERVED
from mjslq.dynamics.dynamics import Feedback
from mjslq.lq import square_root
from mjslq.lq.problem import LQProblem
from mjslq.lq.square_root import Factorization, Infeasible, Solution, StateRows
from mjslq.options import SquareRootSweepOptions
from mjslq.problem import Problem
from mjslq.solvers.constraint_rows import ConstrainedIterate, Rows, free_start, split
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Duals, Method, Step
from mjslq.validation import Array, choose

HALVINGS = 12
"""Times that percentages are halved in an iteration, at most."""
GROW = 2.0
"""Factor on the last accepted c_J, with which the next iteration starts."""
SHRINK, NARROW, PERIOD, SLOW = 0.5, 1e-9, 10, 0.02
"""Factor on threshold - 1, its least value, iterations between two times that it shrinks, and the c_J, relative to the
first one, below which it shrinks at once."""
NEGLIGIBLE = 0.1
"""Violation, relative to tol_violation, that counts as none when steps are judged."""
ROUNDOFF = 1e-12
"""Distance below a limit, relative to its size, that still counts as touching it."""


class Shares(NamedTuple):
    """Shares of the errors that an iteration is to correct."""

    cost: float
    """c_J; zero without the row of the cost."""
    terminal: float
    """c_m."""
    path: float
    """c_w."""


class Plan(NamedTuple):
    """The sweep of an iteration."""

    active: Rows
    """Rows that are corrected."""
    factors: Factorization
    cost: float
    """J of the iterate; the row of the cost is the last terminal one, if there is one."""
    has_cost: bool
    overlap: Array
    """Share of each row's correction beside c_w. Shape (m,)."""

    def solve(self, shares: Shares) -> Solution:
        """Changes for these percentages. Raises Infeasible."""
        rows, N = self.active, len(self.factors.problem.B)
        end = rows.step == N
        boundary = end | ((rows.step == 0) & ~(rows.C != 0.0).any(axis=1))
        share = np.where(rows.equality & boundary, shares.terminal, shares.path * self.overlap)
        d = share * (rows.nearest - rows.value)
        decrease = [-shares.cost * abs(self.cost)] if self.has_cost else []
        return self.factors.solve(path=d[~end], terminal=np.concatenate([d[end], decrease]))


class Trial(NamedTuple):
    """Outcome of a search over halved percentages."""

    iterate: ConstrainedIterate | None
    shares: Shares
    rollouts: int


class SquareRootSweep(Method):
    """McQuade's method; keeps its percentages and its threshold from iteration to iteration."""

    tests_direction = False

    def __init__(self, options: SquareRootSweepOptions) -> None:
        self.options = options
        self._threshold, self._c_J = options.threshold, options.cost_decrease
        self._names: list[str] = []
        self._plan: Plan | None = None
        self._taken = self._without = 0  # steps accepted; those without the row of the cost
        self._since = 0  # iterations since the threshold shrank
        self._opening = bool(options.first)  # only the constraints named by `first` are corrected yet
        self._said = ""

    def check(self, problem: Problem) -> None:
        """Refuse names of constraints that the problem has not, and weights for other controls."""
        for name in self.options.first:
            choose("constraint in option 'first'", name, names_in(problem))
        weights, nu = self.options.weights, problem.dynamics.nu
        if weights is not None and len(weights) != nu:
            raise ValueError(f"option 'weights' must have one number a control, {nu}, got {len(weights)}")

    def begin(self, start: Iterate) -> Iterate:
        """The start, its gradient projected."""
        self._names = names_in(start.problem)
        return ConstrainedIterate(start.problem, start.trajectory)

    def direction(self, here: Iterate) -> Direction:
        """The sweep with the percentages that the iteration starts with."""
        assert isinstance(here, ConstrainedIterate)
        model = here.gauss_newton
        wanted = self.options.cost_row and bool(np.any(model.q) or np.any(model.r)) and here.cost != 0.0
        self._said, self._plan = "", None
        self._opening = self._opening and self._counted(here) > 0.0
        for with_cost in (True, False) if wanted else (False,):
            plan = self._planned(here, with_cost)
            try:
                found = plan.solve(self._first_shares(plan))
            except Infeasible as error:
                self._said = _contradiction(here, plan, error)
                continue
            self._plan, self._said = plan, ""
            return _direction(here, found)
        U, ndx = np.zeros_like(here.trajectory.U), model.A.shape[1]
        still = np.zeros((len(U) + 1, ndx))
        return Direction(still, U, U, np.zeros((*U.shape, ndx)), 0.0, np.zeros(U.shape, dtype=bool))

    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """Try the percentages, smaller and smaller; then do without the row of the cost; then shrink the threshold."""
        assert isinstance(here, ConstrainedIterate)
        spent, plan = 0, self._plan
        self._since += 1
        while plan is not None:
            trial = self._tried(here, plan)
            spent += trial.rollouts
            if trial.iterate is not None:
                self._taken, self._opening = self._taken + 1, False
                if plan.has_cost:
                    self._c_J = min(GROW * trial.shares.cost, self.options.cost_decrease)
                else:
                    self._without += 1
                if self._since >= PERIOD or (plan.has_cost and trial.shares.cost < SLOW * self.options.cost_decrease):
                    self._shrink()
                return Step(trial.iterate, max(trial.shares), spent)
            plan = self._planned(here, False) if plan.has_cost and self._counted(here) > 0.0 else None
        if self._threshold > 1.0:
            self._shrink()
            return Step(here, rollouts=spent, rejected=True)
        self._said = self._said or self._verdict(here)
        return Step(None, rollouts=spent)

    def accepts(self, here: Iterate) -> bool:
        """Whether the constraints are met."""
        assert isinstance(here, ConstrainedIterate)
        return here.violation <= self.options.tol_violation

    def duals(self, here: Iterate) -> Duals:
        """Multipliers of the projected gradient."""
        return here.duals if isinstance(here, ConstrainedIterate) else Duals()

    def remark(self) -> str:
        """Why it ended, and how often it did without the row of the cost."""
        without = f"{self._without} of them without the row of the cost" if self._without else "all with that row"
        count = f"square-root-sweep: {self._taken} steps, {without}."
        return f"{self._said} {count}" if self._said else count

    def _planned(self, here: ConstrainedIterate, with_cost: bool) -> Plan:
        """Factorize the sweep of the rows in force."""
        active = here.rows.taken(self._active(here.rows))
        model = here.gauss_newton
        weights = np.ones(model.B.shape[2]) if self.options.weights is None else np.asarray(self.options.weights)
        N, augmented = len(model.B), with_cost and bool(np.any(model.q[:-1]) or np.any(model.r))
        flat = _min_norm(model, weights, augmented)
        path, terminal = split(active, np.zeros(len(active.value)), N)
        path_H, terminal_H = np.asarray(path.H), np.asarray(terminal.H)
        if augmented:
            path_H, terminal_H = (np.pad(H, ((0, 0), (0, 1))) for H in (path_H, terminal_H))
        if with_cost:
            row = np.append(model.q[-1], 1.0) if augmented else model.q[-1]
            terminal_H = np.vstack([terminal_H, row])
        terminal = StateRows(terminal_H, np.zeros(len(terminal_H)))
        free = np.concatenate([free_start(here.problem), np.zeros(int(augmented), np.bool_)])
        initial = StateRows(np.eye(len(free))[~free], np.zeros((~free).sum())) if free.any() else None
        factors = square_root.factorize(flat, path._replace(H=path_H), terminal, initial)
        return Plan(active, factors, here.cost, with_cost, self._shared(active))

    def _active(self, rows: Rows) -> NDArray[np.bool_]:
        """Equalities, and limits that are violated by more than the threshold allows (4.20)."""
        beyond = rows.violation > (self._threshold - 1.0) * rows.size + ROUNDOFF * rows.size
        active = rows.equality | beyond
        if self._threshold == 1.0 and not (beyond & ~rows.equality).any():
            near = np.minimum(np.abs(rows.value - rows.lower), np.abs(rows.value - rows.upper))
            active |= near <= ROUNDOFF * rows.size
        if self._opening:
            active &= rows.equality | self._named(rows)
        return active & rows.movable

    def _named(self, rows: Rows) -> NDArray[np.bool_]:
        """Rows of the constraints in the option `first`."""
        named: NDArray[np.bool_] = np.isin(rows.owner, [self._names.index(name) for name in self.options.first])
        return named

    def _shared(self, rows: Rows) -> Array:
        """1, or `overlap` for limits of the controls where rows that the state enters act at the same step."""
        with_state = (rows.H != 0.0).any(axis=1)
        crowded = np.isin(rows.step, rows.step[with_state & (rows.C != 0.0).any(axis=1)])
        return np.where(crowded & ~with_state, self.options.overlap, 1.0)

    def _first_shares(self, plan: Plan) -> Shares:
        return Shares(self._c_J if plan.has_cost else 0.0, self.options.terminal_share, self.options.path_share)

    def _tried(self, here: ConstrainedIterate, plan: Plan) -> Trial:
        """Section 2.5: halve percentages until a rollout is accepted."""
        shares, V = self._first_shares(plan), self._counted(here)
        if V == 0.0 and not plan.has_cost:
            return Trial(None, shares, 0)
        worst = here.cost + self.options.degradation * abs(here.cost) if plan.has_cost else np.inf
        for rollouts in range(1, HALVINGS + 1):
            try:
                found = plan.solve(shares)
            except Infeasible as error:
                self._said = _contradiction(here, plan, error)
                return Trial(None, shares, rollouts - 1)
            there = _rolled_out(here, found, self.options.step)
            better = np.isfinite(there.cost) and (self._counted(there) < V or self._counted(there) == 0.0)
            if better and (there.cost < here.cost or (V > 0.0 and there.cost <= worst)):
                return Trial(there, shares, rollouts)
            shares = Shares(0.5 * shares.cost, *(shares[1:] if better else 0.5 * np.array(shares[1:])))
        return Trial(None, shares, HALVINGS)

    def _counted(self, there: ConstrainedIterate) -> float:
        """V: root of the summed squares of violations, those left out that the threshold or the tolerance allows."""
        rows = there.rows
        violation, least = rows.violation, NEGLIGIBLE * self.options.tol_violation
        allowed = np.where(rows.equality, 0.0, (self._threshold - 1.0) * rows.size)
        counts = violation > np.maximum(allowed, least)
        if self._opening:
            counts &= self._named(rows)
        return float(np.linalg.norm(violation[counts]))

    def _shrink(self) -> None:
        """Bring the threshold nearer to 1; percentages start anew."""
        narrow = SHRINK * (self._threshold - 1.0)
        self._threshold = 1.0 + narrow if narrow > NARROW else 1.0
        self._c_J, self._since = self.options.cost_decrease, 0

    def _verdict(self, here: ConstrainedIterate) -> str:
        """What is so where no percentages are accepted."""
        worst = here.violation
        if worst > self.options.tol_violation:
            return f"No percentages lessen the violations, of which {worst:.1e} is the largest."
        if not self.options.cost_row:
            return f"The constraints are met within {worst:.1e}; the cost was not asked to decrease (cost_row=False)."
        return (
            f"The constraints are met within {worst:.1e}, but no decrease of the cost keeps them so: the projected "
            f"gradient is {here.gradient_norm:.1e}."
        )


def names_in(problem: Problem) -> list[str]:
    """Names of the constraints in the order of their rows, limits of the controls last."""
    return [constraint.name for constraint in problem.bound_constraints] + [RESERVED]


def _min_norm(model: LQProblem, weights: Array, augmented: bool) -> LQProblem:
    """(2.46) with the dynamics of the model, and with z for the cost if `augmented`."""
    N, ndx, nu = model.B.shape
    n = ndx + augmented
    A, B = np.zeros((N, n, n)), np.zeros((N, n, nu))
    A[:, :ndx, :ndx], B[:, :ndx] = model.A, model.B
    if augmented:
        A[:, ndx, :ndx], A[:, ndx, ndx], B[:, ndx] = model.q[:-1], 1.0, model.r
    R = np.tile(np.diag(weights.astype(np.float64)), (N, 1, 1))
    return LQProblem(
        A, B, np.zeros((N + 1, n, n)), R, np.zeros((N, nu, n)), np.zeros((N + 1, n)), np.zeros((N, nu)),
        np.zeros((N, n)),
    )  # fmt: skip


def _feedback(found: Solution, ndx: int) -> tuple[Array, Array]:
    """Feedforward and gains of the state alone, z as planned."""
    K = np.ascontiguousarray(found.K[:, :, :ndx])
    return found.U + np.einsum("nij,nj->ni", K, found.X[:-1, :ndx]), K


def _direction(here: ConstrainedIterate, found: Solution) -> Direction:
    model = here.gauss_newton
    k, K = _feedback(found, model.A.shape[1])
    X = np.ascontiguousarray(found.X[:, : model.A.shape[1]])
    expected = float(np.vdot(model.q, X) + np.vdot(model.r, found.U))
    return Direction(X, found.U, k, K, expected, np.zeros(found.U.shape, dtype=bool))


def _rolled_out(here: ConstrainedIterate, found: Solution, step: str) -> ConstrainedIterate:
    """The step under the sweep's feedback (3.73), or with the changes of the controls as they are (3.108)."""
    reference, dynamics = here.trajectory, here.problem.dynamics
    k, feedback = found.U, None
    if step == "closed-loop":
        k, K = _feedback(found, dynamics.ndx)
        feedback = Feedback.unlimited(reference.X, K)
    change, x0s = found.X[:1, : dynamics.ndx], reference.X[:1]
    if change.any():
        x0s = dynamics.integrate(x0s, change)
    (trajectory,) = dynamics.rollouts(x0s, (reference.U + k)[None], feedback)
    return ConstrainedIterate(here.problem, trajectory)


def _contradiction(here: ConstrainedIterate, plan: Plan, error: Infeasible) -> str:
    """Which constraints' rows contradict each other."""
    names = names_in(here.problem)
    end = plan.active.step == len(here.trajectory.U)
    owners = {"path": plan.active.owner[~end], "terminal": plan.active.owner[end]}
    found: dict[str, list[int]] = {}
    for row in error.rows:
        if row.kind == "initial":
            continue
        own = owners[row.kind]
        what = repr(names[own[row.number]]) if row.number < len(own) else "the cost"
        found.setdefault(what, []).append(row.step)
    parts = []
    for what, steps in found.items():
        where = f"step {steps[0]}" if len(steps) == 1 else f"{len(steps)} steps from {min(steps)} to {max(steps)}"
        parts.append(what if what == "the cost" else f"{what} at {where}")
    return f"Rows contradict each other, linearized: {', '.join(parts)}."
