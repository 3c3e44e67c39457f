"""A page on why a solve ended as it did: cost terms, limits in force, contacts, progress, and advice.

cost          share of each term
gradient      where it is left, by control and time
limits        of controls, and the constraints in force, with their multipliers
contacts      which bodies touched, for how long, how deep
progress      what the last iterations did
derivatives   compared with a fine reference along the trajectory, where the problem is at hand
next          what to try, by what was found
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

import numpy as np

from mjslq.dynamics.derivative_check import DerivativeCheck
from mjslq.problem import Problem
from mjslq.reports import in_force, limits
from mjslq.reports.touches import Touch, touches
from mjslq.result import Result
from mjslq.status import Status
from mjslq.validation import instance

MOST = 6
"""Entries of a list, the largest first."""
LAST = 10
"""Iterations that "the last ones" are."""
SMALL_SHARE = 1e-3
"""Share of the cost below which terms are counted together."""
SHORT = 0.1
"""Steps below this are short."""
STALLED = 1e-6
"""Decrease of the cost over the last iterations, relative to the cost, that is none to speak of."""
_WIDTH = 96


@dataclass(frozen=True)
class Section:
    """A heading and the lines below it."""

    title: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Explanation:
    """What `explain` found; printed, it is a page."""

    sections: tuple[Section, ...]
    advice: tuple[str, ...]
    """What to try next, the most promising first; empty where there is nothing to be done."""

    def __str__(self) -> str:
        page = []
        advice = self.advice or ("Nothing: this is what was asked for.",)
        for section in (*self.sections, Section("next", advice)):
            page.append(section.title)
            for line in section.lines:
                page += textwrap.wrap(line, _WIDTH, initial_indent="  ", subsequent_indent="    ")
        return "\n".join(page)


def explain(result: Result, problem: Problem | None = None) -> Explanation:
    """Say why a solve ended as it did.

    Parameters
    ----------
    result : Result
        What `solve` returned, or `load` read.
    problem : Problem
        What it solved, for a check of the derivatives along its trajectory; left out unless given.

    Returns
    -------
    Explanation
        Print it.

    Raises
    ------
    ValueError
        When the problem's sizes are not those of the result.

    Examples
    --------
    >>> result = mjslq.solve(mjslq.problems.get("hopper"), max_iterations=3)
    >>> page = mjslq.explain(result)
    >>> [section.title for section in page.sections][:3]
    ['ending', 'cost', 'gradient']
    >>> print(page)
    ending
      max_iterations: The iterations ran out before the tolerance was met. ...
    """
    instance("result", result, Result, "a mjslq.Result")
    check = None if problem is None else _checked(result, instance("problem", problem, Problem, "a mjslq.Problem"))
    touched = [] if result.scene is None else touches(result)
    sections = [
        Section("ending", _ending(result)),
        Section("cost", _cost(result)),
        Section("gradient", _gradient(result)),
        Section("limits", _limits(result)),
        Section("contacts", _contacts(result, touched)),
        Section("progress", _progress(result)),
        Section("derivatives", _derivatives(check)),
    ]
    return Explanation(tuple(section for section in sections if section.lines), _advice(result, touched, check))


def _checked(result: Result, problem: Problem) -> DerivativeCheck | None:
    N, nu = result.trajectory.U.shape
    if (problem.horizon, problem.dynamics.nu, problem.dynamics.nx) != (N, nu, result.trajectory.X.shape[1]):
        raise ValueError(
            f"the problem has {problem.horizon} steps, {problem.dynamics.nx} states and {problem.dynamics.nu} "
            f"controls, but the result {N}, {result.trajectory.X.shape[1]} and {nu}"
        )
    if result.trajectory.diverged:
        return None
    if problem.unknowns is None:
        return problem.dynamics.check_derivatives(result.trajectory)
    if tuple(result.unknowns) != problem.unknowns.names:
        raise ValueError(f"the problem leaves {', '.join(problem.unknowns.names)} free, but the result was of another")
    lifted = problem.lifted.dynamics
    return lifted.check_derivatives(problem.unknowns.extended(problem, result.trajectory, result.unknowns))


def _ending(result: Result) -> tuple[str, ...]:
    first = f"{result.status.value}: {result.message}"
    last = result.error.strip().splitlines()[-1:]
    return (first, *(f"error: {line}" for line in last))


def _cost(result: Result) -> tuple[str, ...]:
    """The terms, the largest first."""
    total = sum(abs(value) for value in result.cost_terms.values())
    if not total:
        return (f"{result.cost:.6g}",) if np.isfinite(result.cost) else ()
    terms = sorted(result.cost_terms.items(), key=lambda term: -abs(term[1]))
    large = [(name, value) for name, value in terms if abs(value) >= SMALL_SHARE * total][:MOST]
    lines = [f"{value / total:6.1%}  {value:10.4g}  {name}" for name, value in large]
    rest = terms[len(large) :]
    if rest:
        value = sum(value for _, value in rest)
        lines.append(f"{value / total:6.1%}  {value:10.4g}  {len(rest)} more")
    return tuple(lines)


def _gradient(result: Result) -> tuple[str, ...]:
    """Where the projected gradient is largest."""
    start = result.log[0].gradient_norm if result.log else np.nan
    lines = [f"norm {result.gradient_norm:.2e}" + (f", at the start {start:.2e}" if np.isfinite(start) else "")]
    gradient = result.gradient
    if gradient is None or result.success or not gradient.any():
        return tuple(lines)
    names, times = _control_names(result), result.trajectory.times
    by_control = np.linalg.norm(gradient, axis=0)
    for i in np.argsort(-by_control)[:MOST]:
        share = by_control[i] ** 2 / (by_control**2).sum()
        if share >= 0.01:
            n = int(np.abs(gradient[:, i]).argmax())
            lines.append(f"{share:4.0%} on {names[i]}, most at {times[n]:.3g} s (step {n}): {gradient[n, i]:+.2e}")
    return tuple(lines)


def _limits(result: Result) -> tuple[str, ...]:
    lines = [text for text in (limits.describe(result),) if text]
    found = sorted(in_force.in_force(result), key=lambda entry: -abs(entry.largest))
    lines += [f"constraint {entry}" for entry in found[:MOST]]
    broken = {name: values for name, values in result.violations.items() if values.max(initial=0.0) > 0.0}
    for name, values in sorted(broken.items(), key=lambda entry: -entry[1].max())[:MOST]:
        n = int(values.argmax())
        lines.append(f"violation of {name}: {values[n]:.2e} at knot {n} ({result.trajectory.times[n]:.3g} s)")
    return tuple(lines)


def _contacts(result: Result, touched: list[Touch]) -> tuple[str, ...]:
    if not touched:
        return ()
    lines = [str(touch) for touch in sorted(touched, key=lambda touch: -touch.depth)[:MOST]]
    if len(touched) > MOST:
        lines.append(f"and {len(touched) - MOST} more pairs")
    kind = "" if result.contact is None else f" (contact: {result.contact})"
    return (*lines, f"deepest {1e3 * max(touch.depth for touch in touched):.2f} mm{kind}")


def _progress(result: Result) -> tuple[str, ...]:
    log = result.log
    if len(log) < 2:
        return (f"{result.iterations} iterations in {result.seconds:.2f} s",)
    last = log[-LAST - 1 :]
    steps = [entry.alpha for entry in last if entry.outcome == "accepted"]
    lines = [f"{result.iterations} iterations in {result.seconds:.2f} s, cost {log[0].cost:.6g} to {log[-1].cost:.6g}"]
    fell = last[0].cost - last[-1].cost
    text = f"the last {len(last) - 1}: cost fell by {fell:.2e}"
    if steps:
        text += f", steps {min(steps):.2g} to {max(steps):.2g}"
        text += f", {sum(entry.evaluations for entry in last) / len(last):.1f} rollouts each"
    damped = sum(entry.multiplier > 0.0 for entry in last)
    lines.append(text + (f", {damped} with a multiplier" if damped else ""))
    return tuple(lines)


def _derivatives(check: DerivativeCheck | None) -> tuple[str, ...]:
    return () if check is None else (check.verdict,)


def _advice(result: Result, touched: list[Touch], check: DerivativeCheck | None) -> tuple[str, ...]:
    """What to try, by what was found."""
    if check is not None and check.suspects:
        return ("Mend the derivatives first: with wrong ones nothing else is to be trusted.",)
    if result.success:
        return _advice_after_success(result)
    advice = {
        Status.INFEASIBLE: "Relax the constraint that is violated, lengthen the horizon, or start elsewhere (guess=).",
        Status.DIVERGED: "Start from mjslq.starts.hold(problem) or starts.servo(problem), or shorten the timestep.",
        Status.FAILED: "Mend the error; the best iterate until then is in the result.",
        Status.NO_CONTACT_GRADIENT: "Start from controls that touch, or give the engine foresight=0.1.",
    }
    found = [advice[result.status]] if result.status in advice else []
    last = result.log[-LAST - 1 :]
    steps = [entry.alpha for entry in last if entry.outcome == "accepted"]
    stalled = len(last) > 1 and last[0].cost - last[-1].cost <= STALLED * abs(last[-1].cost)
    stiff = touched and (result.contact is None or result.contact.kind != "smooth")
    if stiff and (result.status is Status.STEP_TOO_SMALL or (steps and max(steps) < SHORT)):
        pair = max(touched, key=lambda touch: touch.changes)
        found.append(
            f"Contacts open and close ({pair.first} and {pair.second} {pair.changes} times), which makes kinks in the "
            f'cost: solve with contact="smooth" on the engine, then see result.replay(contact="stiff").'
        )
    if stalled:
        found.append("The cost hardly falls any more: accept this point, or ask for less (tol).")
    elif result.status in (Status.MAX_ITERATIONS, Status.OUT_OF_TIME):
        found.append("It was still getting better: go on from here with solve(problem, guess=result).")
    share = float((limits.reached(result, result.trajectory.U) != 0).mean())
    if share > 0.5:
        found.append(f"Controls are at their limits {share:.0%} of the time: give the motion more time (horizon).")
    return tuple(found) or (
        "Start elsewhere (guess=), or move the goal: kinks, as at a joint's end, can stop a search.",
    )


def _advice_after_success(result: Result) -> tuple[str, ...]:
    """A solve that converged may still be none to be glad of."""
    found = []
    total = sum(abs(value) for value in result.cost_terms.values())
    for name, value in result.cost_terms.items():
        if "Control" in name and total and value > 0.9 * total:
            found.append(f"{name} is {value / total:.0%} of the cost: weigh the goals more if they are not reached.")
    if result.contact is not None and result.contact.kind == "smooth" and result.penetration:
        found.append('It was solved with smooth contacts: see result.replay(contact="stiff") for what they hide.')
    return tuple(found)


def _control_names(result: Result) -> tuple[str, ...]:
    given, size = result.names.get("controls", ()), result.trajectory.U.shape[1]
    return given if len(given) == size else tuple(f"u[{i}]" for i in range(size))
