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

from mjslq._validation import choose
from mjslq.problem import Problem
from mjslq.result import IterationLog, Result
from mjslq.solvers import slq as _slq
from mjslq.solvers._iterate import Iterate
from mjslq.solvers._loop import Monitor, Outcome, Stopping


@dataclass(frozen=True)
class Method:
    """An entry of the table of methods."""

    run: Callable[..., Outcome]
    """run(start, stopping, monitor, **options)."""
    summary: str
    """What it does, in a line."""
    needs: str
    """Derivatives that it uses."""

    @property
    def options(self) -> dict[str, Any]:
        """Its own options, with their defaults."""
        parameters = inspect.signature(self.run).parameters.values()
        return {p.name: p.default for p in parameters if p.kind is p.KEYWORD_ONLY}


METHODS = {
    "slq": Method(_slq.slq, "Gauss-Newton by LQ tracking sweeps, with a line search", "first derivatives"),
}


def methods() -> dict[str, Method]:
    """Methods by name: what each does, needs and can be told."""
    return dict(METHODS)


def solve(
    problem: Problem,
    method: str = "slq",
    *,
    U0: ArrayLike | None = None,
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
    start = Iterate(problem, problem.rollout(problem.U0 if U0 is None else U0))  # type: ignore[arg-type]
    if check_derivatives:
        _refuse_wrong_derivatives(start)
    outcome = chosen.run(start, stopping, monitor, **own)
    result = _result(outcome, monitor, problem, method, asdict(stopping) | chosen.options | own)
    if verbose:
        print(f"{result.status.value}: {result.message}", file=monitor.stream)
    return result


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


def _refuse_wrong_derivatives(start: Iterate, tolerance: float = 1e-3) -> None:
    if start.trajectory.diverged:
        return
    check = start.problem.dynamics.check_derivatives(start.trajectory)
    for name, error in check.errors.items():
        if not error < tolerance:
            step, row, column = check.worst[name]
            raise ValueError(
                f"derivative check: {name}[{step}, {row}, {column}] is off by {error:.1e} of the largest entry; "
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
