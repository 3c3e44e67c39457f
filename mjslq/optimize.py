"""`solve`: one front for all methods, and the table of what they are."""

from __future__ import annotations

import inspect
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike

from mjslq.log import IterationLog
from mjslq.problem import Problem
from mjslq.result import Result
from mjslq.solvers import gradient, newton, slq, trust_region
from mjslq.solvers.iterate import Iterate
from mjslq.solvers.loop import Monitor, Outcome, Stopping
from mjslq.solvers.shooting import close_gaps, shortened
from mjslq.validation import Array, as_array, choose


@dataclass(frozen=True)
class Method:
    """An entry of the table of methods."""

    run: Callable[..., Outcome]
    """run(start, stopping, monitor, **options)."""
    summary: str
    """What it does, in a line."""
    needs: str
    """Derivatives that it uses."""
    shooting: str | None = None
    """How it takes a state guess X0, by "first" or "second" derivatives; None when it does not."""

    @property
    def options(self) -> dict[str, Any]:
        """Its own options, with their defaults."""
        parameters = inspect.signature(self.run).parameters.values()
        return {p.name: p.default for p in parameters if p.kind is p.KEYWORD_ONLY}


METHODS = {
    "slq": Method(slq.slq, "Gauss-Newton by LQ tracking sweeps, with a line search", "first derivatives", "first"),
    "newton": Method(
        newton.newton, "Newton by LQ sweeps, made to descend, with a line search", "second derivatives", "second"
    ),
    "trust-region": Method(
        trust_region.trust_region, "second-order model, minimized over a ball whose size adapts", "second derivatives"
    ),
    "gradient": Method(gradient.gradient, "steepest descent with exact line search", "first derivatives"),
}


def methods() -> dict[str, Method]:
    """Methods by name: what each does, needs and can be told."""
    return dict(METHODS)


def solve(
    problem: Problem,
    method: str = "slq",
    *,
    U0: ArrayLike | None = None,
    X0: ArrayLike | None = None,
    tol: float | None = None,
    max_iterations: int | None = None,
    verbose: int = 0,
    callback: Callable[[IterationLog], object] | None = None,
    check_derivatives: bool = False,
    keep_iterates: bool = True,
    stream: TextIO | None = None,
    **options: Any,
) -> Result:
    """Minimize the cost of `problem` over its controls.

    Parameters
    ----------
    problem : Problem
        What to solve. Its own `options` hold unless given here.
    method : str
        One of `methods()`.
    U0 : array
        Controls to start from; the problem's own start unless given. Shape (N, nu) | (nu,).
    X0 : array
        States to start from, which need not obey the dynamics: multiple shooting closes the gaps between the steps
        first. Its first state is the problem's own, whatever is given. "slq" and "newton" take it. Shape (N + 1, nx).
    tol : float
        Stop when ||U_bar|| <= tol ||U|| or ||dJ/dU|| <= tol; 1e-6 unless the problem says otherwise. The two can
        be set apart by `tol_direction` and `tol_gradient`; 0 switches one off.
    max_iterations : int
        300 unless the problem says otherwise.
    verbose : int
        0 is silent, 1 prints a line an iteration.
    callback : callable
        Called with each `IterationLog`; stops the solve by returning True.
    check_derivatives : bool
        Compare the engine's Jacobians with a fine reference along the start, and refuse to go on with wrong ones.
    keep_iterates : bool
        Keep the trajectory of every iterate in the result.
    stream : file
        Where `verbose` prints; standard output unless given.
    **options
        The method's own; see `methods()`.

    Returns
    -------
    Result
        Not converging is a `status` with advice, never an exception.

    Raises
    ------
    ValueError
        For an unknown method or option, a start of the wrong shape, or derivatives that fail their check.
    """
    if not isinstance(problem, Problem):
        raise ValueError(f"problem must be a mjslq.Problem, got {type(problem).__name__}")
    chosen = METHODS[choose("method", method, METHODS)]
    asked = {"tol": tol, "max_iterations": max_iterations} | options
    settings = _settings(problem, method, {name: value for name, value in asked.items() if value is not None})
    stopping = _stopping(settings)
    own = {name: settings.pop(name) for name in list(settings) if name in chosen.options}
    for name in settings:
        choose(f"option for method {method!r}", name, option_names(method))
    monitor = Monitor(verbose, callback, keep_iterates, sys.stdout if stream is None else stream)
    guess = problem.U0 if U0 is None else U0
    assert guess is not None  # a problem fills in its own start when it is made
    controls = problem.checked_controls(guess)
    states = None if X0 is None else _state_guess(problem, method, X0)
    start = Iterate(problem, problem.rollout(controls))
    if check_derivatives:
        _refuse_wrong_derivatives(start)
    if states is None:
        outcome = chosen.run(start, stopping, monitor, **own)
    else:
        outcome = _shoot(problem, states, controls, chosen, stopping, monitor, own)
    result = _result(outcome, monitor, problem, method, asdict(stopping) | chosen.options | own)
    if verbose:
        print(f"{result.status.value}: {result.message}", file=monitor.stream)
    return result


def _state_guess(problem: Problem, method: str, X0: ArrayLike) -> Array:
    """X0 as states (N + 1, nx), the first of them the problem's own."""
    takers = [name for name, entry in METHODS.items() if entry.shooting]
    if METHODS[method].shooting is None:
        raise ValueError(f"method {method!r} takes no state guess X0; these do: {', '.join(takers)}")
    dynamics = problem.dynamics
    X = np.array(as_array("X0", X0, (problem.horizon + 1, dynamics.nx)))
    X = np.stack([dynamics.checked_start(x) for x in X])
    X[0] = problem.x0
    return X


def _shoot(
    problem: Problem,
    X: Array,
    U: Array,
    chosen: Method,
    stopping: Stopping,
    monitor: Monitor,
    own: dict[str, Any],
) -> Outcome:
    """Close the gaps of a state guess, then go on by single shooting."""
    closed = close_gaps(problem, X, U, stopping, monitor, chosen.shooting == "second")
    if closed.status is not None:
        return Outcome(closed.status, closed.iterate, closed.gains)
    return chosen.run(closed.iterate, shortened(stopping, monitor), monitor, **own)


def _settings(problem: Problem, method: str, asked: dict[str, Any]) -> dict[str, Any]:
    """Options of the problem as far as the method knows them, and over them what the caller asked for."""
    known = option_names(method)
    own = {name: value for name, value in problem.options.items() if name in known}
    if "tol" in asked:  # it stands for both tolerances, the problem's own included
        own = {name: value for name, value in own.items() if not name.startswith("tol")}
    return own | asked


def option_names(method: str) -> list[str]:
    """Names of all options that `solve` takes for a method."""
    return [*METHODS[choose("method", method, METHODS)].options, *COMMON]


COMMON = ("tol", "tol_direction", "tol_gradient", "max_iterations")
"""Options that every method takes."""


def _stopping(settings: dict[str, Any]) -> Stopping:
    """Take the stopping options out of `settings`; `tol` stands for both tolerances unless they are given."""
    default = Stopping()
    tol = settings.pop("tol", None)
    values = {
        "tol_direction": settings.pop("tol_direction", default.tol_direction if tol is None else tol),
        "tol_gradient": settings.pop("tol_gradient", default.tol_gradient if tol is None else tol),
    }
    for name, value in values.items():
        number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        if not (number and 0.0 <= value < np.inf):
            raise ValueError(f"{name} must be a number of at least 0, got {value!r}")
    limit = settings.pop("max_iterations", default.max_iterations)
    if isinstance(limit, bool) or not isinstance(limit, (int, np.integer)) or limit < 0:
        raise ValueError(f"max_iterations must be a whole number of at least 0, got {limit!r}")
    return Stopping(float(values["tol_direction"]), float(values["tol_gradient"]), int(limit))


def _refuse_wrong_derivatives(start: Iterate) -> None:
    if start.trajectory.diverged:
        return
    check = start.problem.dynamics.check_derivatives(start.trajectory)
    for name in check.suspects:
        step, row, column = check.worst[name]
        raise ValueError(
            f"derivative check: {name} is off at {check.share[name]:.0%} of the knots, most at "
            f"{name}[{step}, {row}, {column}] by {check.errors[name]:.1e} of the largest entry; "
            f"give a correct jacobian, or one by finite differences"
        )


def _result(outcome: Outcome, monitor: Monitor, problem: Problem, method: str, options: dict[str, Any]) -> Result:
    dynamics, iterate = problem.dynamics, outcome.iterate
    message = " ".join(part for part in (outcome.status.message, outcome.remark) if part)
    return Result(
        status=outcome.status,
        message=message,
        cost=iterate.cost,
        iterations=sum(entry.alpha > 0.0 for entry in monitor.log),
        gradient_norm=iterate.gradient_norm,
        trajectory=iterate.trajectory,
        gains=outcome.gains,
        log=tuple(monitor.log),
        iterates=tuple(monitor.iterates),
        seconds=time.perf_counter() - monitor.started,
        problem=problem.name,
        method=method,
        options=options | {"parameters": dict(problem.parameters)},
        names={
            "states": tuple(dynamics.state_names),
            "controls": tuple(dynamics.control_names),
            "outputs": tuple(dynamics.output_names),
        },
        scene=problem.scene(),
    )
