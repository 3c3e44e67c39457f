"""`solve`, the entry point of all methods."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike

from mjslq import starts
from mjslq.compiling import CompileClock
from mjslq.log import IterationLog
from mjslq.lowering import lowered
from mjslq.method_table import ALIASES, CONSTRAINED, METHODS, PRESETS
from mjslq.options import COMMON, Stopping, check_tolerance, names
from mjslq.problem import Problem
from mjslq.result import Result
from mjslq.solvers.foresight import descend_with_foresight
from mjslq.solvers.held_time import descend_with_time_held_first
from mjslq.solvers.interrupts import Interrupts
from mjslq.solvers.iterate import Iterate
from mjslq.solvers.loop import Outcome
from mjslq.solvers.method import Method
from mjslq.solvers.monitor import Monitor
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose, count, describe, flag, function, instance


def solve(
    problem: Problem,
    method: str = "auto",
    *,
    guess: Any = None,
    U0: ArrayLike | None = None,
    X0: ArrayLike | None = None,
    tol: float | None = None,
    max_iterations: int | None = None,
    deadline: float | None = None,
    preset: str | None = None,
    verbose: int = 0,
    callback: Callable[[IterationLog], object] | None = None,
    watcher: Callable[[IterationLog, Trajectory], object] | None = None,
    check_derivatives: bool = False,
    keep_iterates: bool = True,
    stream: TextIO | None = None,
    **options: Any,
) -> Result:
    """Minimize the cost of `problem` over its controls, within their limits.

    Parameters
    ----------
    problem : Problem
        What to solve. Its own `options` hold unless given here.
    method : str
        One of `methods()`; "ilqr" is another name for "slq".
    guess : Result, Trajectory, Policy or array
        What to start from: a result or a policy is followed under its feedback, a trajectory's controls are taken; an
        array holds controls, as U0, or states, as X0. Multipliers that a result has for constraints of the same names
        and shapes are taken as well.
    U0 : array
        Controls to start from; the problem's own start unless given. Shape (N, nu) | (nu,).
    X0 : array
        States to start from, which need not obey the dynamics: multiple shooting closes the gaps between the steps
        first. Its first state is the problem's own, whatever is given. "slq" and "newton" take it. Shape (N + 1, nx).
    tol : float
        Stop when ||U_bar|| <= tol ||U|| or ||dJ/dU|| <= tol, with the projected gradient; 1e-6 unless the problem says
        otherwise. The two can be set apart by `tol_direction` and `tol_gradient`; 0 switches one off. The message tells
        which of them ended the solve.
    max_iterations : int
        300, or 1000 for "constrained", unless the problem says otherwise.
    deadline : float
        Wall time after which the best iterate so far is returned, compiling not counted. [s]
    preset : str
        A paper's version of the method, nothing added: "sideris-bobrow" for "slq".
    verbose : int
        0 is silent, 1 prints a line an iteration.
    callback : callable
        Called with each `IterationLog`; stops the solve by returning True.
    watcher : callable
        As `callback`, with the `Trajectory` that the entry is about as a second argument; see `mjslq.watch`.
    check_derivatives : bool
        Compare the engine's Jacobians with a fine reference along the start, and refuse to go on with wrong ones.
    keep_iterates : bool
        Keep the trajectory of every iterate in the result.
    stream : file
        Where `verbose` prints; standard output unless given.
    **options
        The method's own; see `methods()` and `mjslq.options`.

    Returns
    -------
    Result
        Not converging is a `status` with advice, never an exception. An error in a callback, a cost or the simulator
        after the start ends the solve with the best iterate; its traceback is `Result.error`.

    Raises
    ------
    ValueError
        For an unknown method or option, a start of the wrong shape, or derivatives that fail their check.

    Examples
    --------
    >>> result = mjslq.solve(mjslq.problems.get("hopper", height=1.0), "slq", max_iterations=50)
    >>> result.status.value, round(float(result.trajectory.X[-1, 0]), 1)
    ('converged', 1.0)
    """
    instance("problem", problem, Problem, "a mjslq.Problem")
    count("verbose", verbose, at_least=0)
    flag("check_derivatives", check_derivatives)
    flag("keep_iterates", keep_iterates)
    if callback is not None:
        function("callback", callback)
    if stream is not None and not hasattr(stream, "write"):
        raise ValueError(f"stream must be a file that is open for writing, got {describe(stream)}")
    if problem.dynamics.nu == 0:
        raise ValueError("this model has no controls, so there is nothing to optimize; give it actuators")
    stated, problem = problem, problem.lifted
    method = choose("method", method, [*METHODS, *ALIASES])
    method = ALIASES.get(method, method)
    if stated.unknowns is not None and not METHODS[method].takes_unknowns:
        takers = [name for name, entry in METHODS.items() if entry.takes_unknowns]
        raise ValueError(
            f"method {method!r} takes no free time or parameters, but the problem has "
            f"{', '.join(stated.unknowns.names)}; these do: {', '.join(takers)}"
        )
    routed = ""
    if problem.bound_constraints:
        if method == "auto":
            method, routed = CONSTRAINED, f"auto: {CONSTRAINED!r}, since the problem has constraints."
        _refuse_constraints(problem, method)
    if problem.free_start is not None and not METHODS[method].takes_free_start:
        takers = [name for name, entry in METHODS.items() if entry.takes_free_start]
        raise ValueError(f"method {method!r} takes no free initial state; these do: {', '.join(takers)}")
    chosen = METHODS[method]
    stops = {"tol": tol, "max_iterations": max_iterations, "deadline": deadline}
    asked = {name: value for name, value in stops.items() if value is not None} | options
    settings = dict(chosen.defaults) | _settings(problem, method, preset, asked)
    stopping = _stopping(settings)
    record = chosen.record(**settings)
    chosen.make(record).check(problem)
    start = starts.read(stated, guess, U0, X0)
    if start.X is not None and problem.bound_constraints:
        raise ValueError("a problem with constraints takes no state guess X0; give controls, U0, or a policy, guess")
    if start.X is not None and not chosen.takes_states:
        takers = [name for name, entry in METHODS.items() if entry.takes_states]
        raise ValueError(f"method {method!r} takes no state guess X0; these do: {', '.join(takers)}")
    with CompileClock() as compiling, Interrupts() as interrupts:
        monitor = Monitor(
            verbose, callback, watcher, keep_iterates, sys.stdout if stream is None else stream, compiling
        )
        if check_derivatives:
            _refuse_wrong_derivatives(problem, start.U)
        if start.X is None:
            here = Iterate(problem, problem.dynamics.rollouts(start.x0[None], start.U[None])[0])
        else:
            here = Iterate.guess(problem, start.X, start.U)

        def make(multipliers: Mapping[str, Array] = start.multipliers) -> Method:
            made = chosen.make(record)
            made.warm_start(multipliers)
            return made

        unknowns, rest = stated.unknowns, (stopping, monitor, interrupts)
        if unknowns is not None and method in ("auto", CONSTRAINED) and unknowns.begins_held(guess):
            outcome = descend_with_time_held_first(here, unknowns, make, start.multipliers, *rest)
        else:
            outcome = descend_with_foresight(here, make, *rest)
        remarks = [start.remark, routed, outcome.remark]
        result = _result(outcome, monitor, problem, method, asdict(stopping) | asdict(record), remarks)
        result = lowered(result, stated)
    monitor.say(f"{result.status.value}: {result.message}")
    return result


def _settings(problem: Problem, method: str, preset: str | None, asked: dict[str, Any]) -> dict[str, Any]:
    """Options of the problem as far as the method has them, over them the preset's, over these what was asked for."""
    known = names(method)
    for name in asked:
        choose(f"option for method {method!r}", name, known)
    own = {name: value for name, value in problem.options.items() if name in known}
    if "tol" in asked:  # it stands for both tolerances, the problem's own included
        own = {name: value for name, value in own.items() if not name.startswith("tol")}
    if preset is not None:
        if method not in PRESETS:
            there = "; ".join(f"{name!r} has: {', '.join(presets)}" for name, presets in PRESETS.items())
            raise ValueError(f"method {method!r} has no presets; {there}")
        own |= PRESETS[method][choose(f"preset of method {method!r}", preset, PRESETS[method])]
    return own | asked


def _stopping(settings: dict[str, Any]) -> Stopping:
    """Take the stopping options out of `settings`; `tol` stands for both tolerances unless they are given."""
    given = {name: settings.pop(name) for name in COMMON if name in settings}
    if "tol" in given:
        tol = given.pop("tol")
        check_tolerance("tol", tol)
        given = {"tol_direction": tol, "tol_gradient": tol} | given
    return Stopping(**given)


def _refuse_constraints(problem: Problem, method: str) -> None:
    if not METHODS[method].takes_constraints:
        names = ", ".join(repr(constraint.name) for constraint in problem.bound_constraints)
        takers = [name for name, entry in METHODS.items() if entry.takes_constraints]
        raise ValueError(
            f"method {method!r} takes no constraints, but the problem has {names}; these do: auto, {', '.join(takers)}"
        )
    equalities = [repr(c.name) for c in problem.bound_constraints if (c.lower == c.upper).any()]
    if equalities and not METHODS[method].takes_equalities:
        takers = [name for name, entry in METHODS.items() if entry.takes_constraints and entry.takes_equalities]
        raise ValueError(
            f"method {method!r} takes no equality constraints, but the problem has {', '.join(equalities)}; these do: "
            f"auto, {', '.join(takers)}"
        )


def _refuse_wrong_derivatives(problem: Problem, U: Any) -> None:
    trajectory = problem.dynamics.rollouts(np.asarray(problem.x0)[None], U[None])[0]
    if trajectory.diverged:
        return
    check = problem.dynamics.check_derivatives(trajectory)
    for name in check.suspects:
        step, row, column = check.worst[name]
        share = len(check.wrong[name]) / check.knots[name]
        raise ValueError(
            f"derivative check: {name} is off at {share:.0%} of the knots, most at "
            f"{name}[{step}, {row}, {column}] by {check.errors[name]:.1e} of the largest entry; "
            f"give a correct jacobian, or one by finite differences"
        )


def _residuals(problem: Problem, iterate: Iterate) -> dict[str, Array]:
    """Sizes of the cost's residuals; empty where they cannot be had, since a result is not to be lost for them."""
    try:
        return problem.unpenalized.residual_sizes(iterate.trajectory)
    except Exception:  # a user's function, which has failed already
        return {}


def _result(
    outcome: Outcome, monitor: Monitor, problem: Problem, method: str, options: dict[str, Any], remarks: list[str]
) -> Result:
    dynamics, iterate, box = problem.dynamics, outcome.iterate, problem.box
    limits = {} if outcome.multipliers is None else {"controls": outcome.multipliers}
    return Result(
        status=outcome.status,
        message=" ".join(part for part in (outcome.status.message, *remarks) if part),
        cost=iterate.cost if iterate.problem.unpenalized is iterate.problem else problem.cost(iterate.trajectory),
        iterations=monitor.steps,
        gradient_norm=outcome.gradient_norm,
        trajectory=iterate.trajectory,
        gains=outcome.gains,
        lower=box.lower,
        upper=box.upper,
        constraint_violation=outcome.duals.violation,
        violations=outcome.duals.violations,
        multipliers=limits | outcome.duals.multipliers,
        knots={c.name: c.seen_at for c in problem.bound_constraints},
        cost_terms={} if iterate.trajectory.diverged else problem.unpenalized.named(iterate.terms),
        gradient=iterate.projected_gradient if math.isfinite(outcome.gradient_norm) else None,
        costates=iterate.costates if math.isfinite(outcome.gradient_norm) else None,
        residuals={} if outcome.lean else _residuals(problem, iterate),
        log=tuple(monitor.log),
        iterates=tuple(monitor.iterates),
        seconds=monitor.seconds,
        compile_seconds=monitor.compiling.seconds,
        problem=problem.name,
        method=method,
        options=options,
        parameters=dict(problem.parameters),
        names={
            "states": tuple(dynamics.state_names),
            "controls": tuple(dynamics.control_names),
            "outputs": tuple(dynamics.output_names),
        },
        space=dynamics.space,
        scene=problem.scene(),
        contact=dynamics.contact,
        error=outcome.error,
    )
