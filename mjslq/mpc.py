"""`MPC`: receding-horizon control. A plan is improved by a few iterations from each new state; its feedback acts.

Notation
--------
    x, t     state when the control is asked for, and its time [s]
    d        delay [s] from there until the control acts
    x_p      state predicted at t + d, under the controls that were issued before; x without a delay
    t_p      time at which the plan in force begins
    h        step of the horizon [s]

A step of the controller does

    1. every `replan_every` periods: minimize J from (x_p, t + d), starting from the plan in force, moved in time:
           X_n <- X(t_n + t + d - t_p),    U_n, K_n alike;    beyond its end the last step is repeated;
       the start is simulated under its own feedback, so that it begins at x_p
    2. u = [ U_n - K_n difference(X(t + d - t_p), x_p) ], the policy of the plan in force (`mjslq.policy`)

One iteration a plan is the real-time iteration of Diehl, Bock, Schloeder (SIAM J. Control Optim. 43, 2005). A plan that
fails leaves the last one in force. Problems are moved by `Problem.at`, which binds nothing anew.

Constraints that x_p violates at a plan's first knot, where no control can change them, are granted there: they hold
from the next knot on. Multipliers move along with the plan, and so a few iterations do with constraints, too, once a
first plan has found the way (`first_iterations`).
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mjslq.method_table import option_names
from mjslq.optimize import solve
from mjslq.options import check
from mjslq.policy import NEAR, Policy
from mjslq.problem import Problem
from mjslq.result import Result
from mjslq.solvers.feasibility import granted
from mjslq.status import Status
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array, choose, count, finite, nonnegative, positive

if TYPE_CHECKING:
    from mjslq.simulation import ClosedLoop, Disturbance

USELESS = (Status.DIVERGED, Status.FAILED)
"""Endings of a solve that leave no plan."""
RECENT = 1000
"""Plans whose times are kept one by one."""


@dataclass
class Statistics:
    """Times and endings of the plans so far; takes a fixed amount of memory."""

    deadline: float
    """Time within which a plan has to be ready. [s]"""
    plans: int = 0
    """Plans made, failed ones included."""
    failed: int = 0
    """Plans that left the last one in force."""
    missed: int = 0
    """Plans that took longer than the deadline, compiling not counted."""
    seconds: float = 0.0
    """Time of all plans together, compiling not counted. [s]"""
    worst: float = 0.0
    """Longest time of a plan. [s]"""
    compile_seconds: float = 0.0
    """Time spent on compiling kernels, by the first plan. [s]"""
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    """Times of the last plans. [s]"""
    endings: Counter[str] = field(default_factory=Counter)
    """How often each `Status` ended a plan, by its value."""
    last_failure: str = ""
    """Message of the last plan that failed."""

    def quantile(self, share: float) -> float:
        """Time that this share of the last plans stayed within; NaN before the first. [s]"""
        return float(np.quantile(self.recent, share)) if self.recent else math.nan

    def __str__(self) -> str:
        """The numbers in a line."""
        median, high = 1e3 * self.quantile(0.5), 1e3 * self.quantile(0.95)
        return (
            f"{self.plans} plans, {median:.2f} ms (median), {high:.2f} ms (95 %), {1e3 * self.worst:.2f} ms (worst); "
            f"{self.missed} missed the deadline of {1e3 * self.deadline:.2f} ms, {self.failed} failed"
        )

    def _record(self, result: Result, seconds: float, useful: bool) -> None:
        seconds = max(seconds - result.compile_seconds, 0.0)
        self.plans += 1
        self.failed += not useful
        self.missed += seconds > self.deadline
        self.seconds += seconds
        self.worst = max(self.worst, seconds)
        self.compile_seconds += result.compile_seconds
        self.recent.append(seconds)
        self.endings[result.status.value] += 1
        if not useful:
            self.last_failure = result.message


class MPC:
    """Receding-horizon control of a problem; call `step` once a control period.

    Parameters
    ----------
    problem : Problem
        What to plan, constraints included; its x0 is replaced by each new state, and its horizon begins at the present
        time: functions of time among its costs, targets and limits see the plant's time, while arrays with a row for
        each knot move along with the horizon (`Problem.at`).
    method : str
        As in `mjslq.solve`.
    iterations : int
        Iterations of a plan, at most.
    first_iterations : int
        Those of the first plan, for which there may be more time; as many as of the others unless given.
    period : float
        Time between calls of `step`; the step of the horizon unless given. [s]
    replan_every : int
        Periods from plan to plan; between them the feedback of the plan acts. With 1, plans end with their last step,
        unless the option `lean` is given: half the time of a single iteration.
    delay : float
        Time from the measurement of a state until the control that answers it acts. The state is predicted over it. [s]
    deadline : float
        Time within which a plan has to be ready: the search stops there with the best iterate. Without it nothing is
        stopped, and the time until the next plan is what `statistics` measures against. [s]
    guess : Result, Trajectory, Policy or array
        What the first plan starts from, as in `mjslq.solve`.
    **options
        Of the method, as in `mjslq.solve`.

    Raises
    ------
    ValueError
        For options that the method does not have, and for a horizon of unequal steps, which cannot be moved in time.

    Examples
    --------
    >>> dynamics = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0]]), nx=2, nu=1, dt=0.1)
    >>> terms = [mjslq.costs.Control(0.1), mjslq.costs.State(1.0, when="always")]
    >>> controller = mjslq.MPC(mjslq.Problem(dynamics, 20, [1.0, 0.0], terms))
    >>> u = controller.step([1.0, 0.0], t=0.0)
    >>> u.shape, controller.statistics.plans
    ((1,), 1)
    """

    def __init__(
        self,
        problem: Problem,
        method: str = "auto",
        iterations: int = 1,
        *,
        first_iterations: int | None = None,
        period: float | None = None,
        replan_every: int = 1,
        delay: float = 0.0,
        deadline: float | None = None,
        guess: Any = None,
        **options: Any,
    ) -> None:
        if not isinstance(problem, Problem):
            raise ValueError(f"problem must be a mjslq.Problem, got {type(problem).__name__}")
        if problem.unknowns is not None:
            raise ValueError(
                f"a receding horizon takes no free time or parameters, but the problem has "
                f"{', '.join(problem.unknowns.names)}; fix them, as in MPC(problem.fixed(result.unknowns))"
            )
        steps = problem.dynamics.steps(problem.horizon)
        if np.ptp(steps) > NEAR * steps.max():
            raise ValueError(
                f"a receding horizon needs steps of equal length, got {steps.min():g} to {steps.max():g} s"
            )
        self.problem = problem
        """The problem as it was stated."""
        self.period = float(steps[0]) if period is None else positive("period", period)
        """Time between calls of `step`. [s]"""
        self._step, self._delay = float(steps[0]), nonnegative("delay", delay)
        self._interval = count("replan_every", replan_every) * self.period
        self._method, self._iterations = method, count("iterations", iterations)
        self._first = self._iterations if first_iterations is None else count("first_iterations", first_iterations)
        self._options, self._guess = dict(options), guess
        if deadline is not None:
            self._options["deadline"] = positive("deadline", deadline)
        # With a plan for each state its gains serve the next start alone: those of the sweep before do as well.
        self._options.setdefault("lean", replan_every == 1)
        _refuse_options(method, problem, self._options)
        self._deadline = self._interval if deadline is None else float(deadline)
        self.reset()

    def reset(self) -> None:
        """Forget plan, time and statistics: the next `step` begins anew."""
        self.statistics = Statistics(self._deadline)
        """Time and ending of the plans so far."""
        self._plan: Result | None = None
        self._policy: Policy | None = None
        self._asked = -math.inf  # when a plan was asked for last
        self._last = -math.inf  # time of the last call
        self._begins = 0.0
        self._issued: deque[tuple[float, Array]] = deque()  # controls, and when they begin to act

    def pose(self, problem: Problem) -> None:
        """Go on with another `problem` of the same engine and horizon: another target, other weights.

        The plan in force is what the next one starts from. Raises ValueError for problems of other sizes.
        """
        if not isinstance(problem, Problem):
            raise ValueError(f"problem must be a mjslq.Problem, got {type(problem).__name__}")
        (N, nx, nu), own = _sizes(problem), _sizes(self.problem)
        if (N, nx, nu) != own:
            raise ValueError(
                f"the problem has {N} steps, {nx} states and {nu} controls, but the controller {own[0]}, {own[1]} and "
                f"{own[2]}"
            )
        self.problem = problem

    @property
    def plan(self) -> Result:
        """The plan in force, which begins at `plan_time`. Raises ValueError before the first step."""
        return _made(self._plan)

    @property
    def policy(self) -> Policy:
        """The feedback in force; its time counts from `plan_time`. Raises ValueError before the first step."""
        return _made(self._policy)

    @property
    def plan_time(self) -> float:
        """When the plan in force begins. [s]"""
        return self._begins

    def step(self, x: ArrayLike, t: float, *, replan: bool = True) -> Array:
        """Control for the state `x` (nx,) at time `t` [s]; plans anew when it is time to, and `replan`. Shape (nu,).

        Raises ValueError for states that are not finite, for times before those of earlier calls, and when the very
        first plan fails.
        """
        dynamics, t = self.problem.dynamics, finite("t", t)
        x = dynamics.space.normalized(as_array("x", x, (dynamics.nx,)))
        slack = NEAR * self.period
        if t < self._last - slack:
            raise ValueError(f"t must not go back, got {t:g} s after {self._last:g} s; call reset() to begin anew")
        self._last = t
        x, at = self._predicted(x, t), t + self._delay
        if (replan or self._plan is None) and t >= self._asked + self._interval - slack:
            self._asked = t
            self._replan(x, at)
        u = self.policy(x, at - self._begins)
        if self._delay:
            self._issued.append((at, u))
        return u

    def run(
        self,
        plant: Any = None,
        duration: float = 1.0,
        x0: ArrayLike | None = None,
        disturbances: Sequence[Disturbance] = (),
        delay: float | None = None,
    ) -> ClosedLoop:
        """Reset and control a simulated plant; see `mjslq.simulation.run` for the arguments and what is returned."""
        from mjslq.simulation import run

        return run(self, plant, duration, x0, disturbances, self._delay if delay is None else delay)

    def _replan(self, x: Array, t: float) -> None:
        """Improve the plan from state `x` at time `t`, and put it in force unless it failed."""
        began = time.perf_counter()
        first = self._plan is None
        guess = self._guess if self._plan is None else moved(self._plan, t - self._begins)
        problem = self.problem.at(x, t)
        if self._plan is not None:
            problem = granted(problem, guess.trajectory.U)
        result = solve(
            problem, self._method, guess=guess, keep_iterates=False,
            max_iterations=self._first if first else self._iterations, **self._options,
        )  # fmt: skip
        useful = result.status not in USELESS and math.isfinite(result.cost)
        self.statistics._record(result, time.perf_counter() - began, useful)
        if useful:
            self._plan, self._policy, self._begins = result, result.policy, t
        elif first:
            raise ValueError(f"the first plan failed, so there is no control: {result.message}")
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt

    def _predicted(self, x: Array, t: float) -> Array:
        """State after the delay, under the controls issued before; `x` itself where the prediction blows up."""
        if not self._delay:
            return x
        while len(self._issued) > 1 and self._issued[1][0] <= t + NEAR * self.period:
            self._issued.popleft()
        dynamics, steps = self.problem.dynamics, self._delay / self._step
        whole = math.floor(steps + NEAR)
        share = max(steps - whole, 0.0)
        middles = t + self._step * (np.arange(math.ceil(steps - NEAR)) + 0.5)
        middles[whole:] = t + self._step * (whole + 0.5 * share)  # of the fraction of a step that is left
        predicted = dynamics.rollout(x, [self._acting(middle) for middle in middles])
        if predicted.diverged:
            return x
        end = predicted.X[whole]
        if share > NEAR:
            end = dynamics.integrate(end, share * dynamics.difference(end, predicted.X[whole + 1]))
        return end

    def _acting(self, t: float) -> Array:
        """The control that acts at time `t`: the problem's first one before any was issued."""
        acting = [u for begins, u in self._issued if begins <= t]
        return acting[-1] if acting else np.asarray(self.problem.U0)[0]


def moved(plan: Result, elapsed: float) -> Result:
    """Shift a plan by `elapsed` [s], as a start for the next one; its last step and state are repeated.

    Between knots, states lie on the way from one to the next, controls and gains are the means of the two steps that
    a new one overlaps. Multipliers move along where they belong to every step or knot.
    """
    trajectory, N = plan.trajectory, plan.trajectory.horizon
    ahead = max(elapsed, 0.0) / float(np.asarray(trajectory.dt)[0])
    n = math.floor(ahead + NEAR)
    share = ahead - n if ahead - n > NEAR else 0.0

    def later(rows: Array, last: int) -> Array:
        at = np.minimum(np.arange(last + 1) + n, last)
        return rows[at] if not share else (1.0 - share) * rows[at] + share * rows[np.minimum(at + 1, last)]

    at = np.minimum(np.arange(N + 1) + n, N)
    X = trajectory.X[at]
    if share:
        following = trajectory.X[np.minimum(at + 1, N)]
        space = plan.policy.space
        assert space is not None  # filled in when the policy is made
        X = space.integrate(X, share * space.difference(X, following))
    multipliers = {
        name: later(rows, len(rows) - 1) if len(rows) in (N, N + 1) else rows for name, rows in plan.multipliers.items()
    }
    return dataclasses.replace(
        plan,
        trajectory=Trajectory(X, later(trajectory.U, N - 1), dt=trajectory.dt),
        gains=None if plan.gains is None else later(plan.gains, N - 1),
        multipliers=multipliers,
    )


def _sizes(problem: Problem) -> tuple[int, int, int]:
    return problem.horizon, problem.dynamics.nx, problem.dynamics.nu


def _made(value: Any) -> Any:
    if value is None:
        raise ValueError("there is no plan yet: call step first")
    return value


def _refuse_options(method: str, problem: Problem, options: dict[str, Any]) -> None:
    """Refuse options before the first plan does."""
    routed = "constrained" if method == "auto" and problem.bound_constraints else method
    known = [name for name in option_names(routed) if name != "max_iterations"]  # that is `iterations` here
    for name in options:
        choose(f"option for method {method!r}", name, known)
    check(options)
