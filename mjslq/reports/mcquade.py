"""McQuade 1989, "Trajectory optimization in the presence of constraints": section 3.6, Examples 1 and 2, re-entry.

The method is `square-root-sweep`. The thesis tells neither its percentages nor its number of samples in the examples;
those here stand in the rows. `constrained`, which is not of the thesis, stands beside it: what the best result is.

Re-entry. With all violations corrected at once the linearized rows contradict each other where the angle of attack and
the load are both too large: the angle is given at all steps up to there, and with it the states. What the thesis shows
as its failure, Figs. 5.6 and 5.7, must have come of rounding; a least-squares correction, which stands for it here,
fails in the same way. Its way out, the limit of the angle first, is told in the thesis and done here. Controls are
changed as they are (3.108); under the sweep's feedback the way out fails, as a row says.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq import problems
from mjslq.lq import square_root
from mjslq.lq.problem import LQProblem
from mjslq.lq.square_root import PathRows, StateRows
from mjslq.optimize import solve
from mjslq.problem import Problem
from mjslq.problems import bryson_denham, drag_cart, reentry
from mjslq.reports import figures
from mjslq.reports.rows import Row
from mjslq.result import Result
from mjslq.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METHOD = "square-root-sweep"
SAMPLES = 17
"""Steps of Example 1 with which the thesis's cost is the optimum, nearly."""
THRESHOLDS = (1.0, 1.1, 1.3)
"""The thesis has 1.1; 1 is none."""
RECIPE: dict[str, Any] = {"first": ("attack",), "step": "open-loop"}
"""Section 5.4."""
DATA = (0.0, 0.3, 1.0, 0.2)
"""a, b, c, d of section 3.6, which the thesis leaves open."""


def rows() -> Iterator[Row]:
    """Every number that the thesis reports."""
    yield from analytic_example()
    yield from example_1()
    yield from example_2()
    yield from reentry_nominal()
    yield from reentry_solved()


def analytic_example() -> Iterator[Row]:
    """Section 3.6, by the sweep."""
    a, b, c, d = DATA
    zero = np.zeros
    lq = LQProblem(
        np.tile([[1.0, 1.0], [0.0, 1.0]], (2, 1, 1)), np.tile([[0.5], [1.0]], (2, 1, 1)), zero((3, 2, 2)),
        np.ones((2, 1, 1)), zero((2, 1, 2)), zero((3, 2)), zero((2, 1)), zero((2, 2)),
    )  # fmt: skip
    path = PathRows([1, 1], [[1.0, 0.0], [0.0, 0.0]], [[0.0], [1.0]], [b, d])
    found = square_root.solve(lq, path, StateRows([[1.0, 0.0]], [c]), StateRows([[1.0, 0.0]], [a]))
    section = f"Section 3.6, a double integrator with a free speed: a = {a:g}, b = {b:g}, c = {c:g}, d = {d:g}"
    speed = found.X[0, 1]
    expected = -4.0 / 3.0 * speed - 2.0 / 3.0 * a - (d - 2.0 * c) / 3.0
    yield Row(section, "du(1)", f"d = {d:g}", f"{found.U[1, 0]:.12g}", _equal(found.U[1, 0], d))
    what = "du(0) at the speed dx_2(0) that came out"
    yield Row(section, what, f"(3.139) {expected:.12g}", f"{found.U[0, 0]:.12g}", _equal(found.U[0, 0], expected))
    at = ", ".join(f"{value:.12g}" for value in found.X[:, 0].round(14) + 0.0)
    yield Row(section, "dx_1 at the three samples", f"{a:g}, {b:g}, {c:g}", at, _equal(found.X[:, 0], [a, b, c]))
    posed = solve(problems.get("three_samples", a=a, b=b, c=c, d=d), METHOD)
    U = posed.trajectory.U
    ours = f"u = {U[0, 0]:.12g}, {U[1, 0]:.12g}, J = {posed.cost:.12g} after {posed.iterations} step"
    yield Row(section, "the same as a problem, by its method", "as above", ours, _equal(U, found.U))


def example_1() -> Iterator[Row]:
    """Section 4.2: the cost with and without thresholding, and the first step without the row of the cost."""
    section = f"Section 4.2, Example 1 from u = -2: the cost at the end, exactly {4.0 / 9.0 / 0.1:.4f} without steps"
    for N in (SAMPLES, 50):
        problem, paper = problems.get("bryson_denham", horizon=N), f"{bryson_denham.PAPER_COST:g}, steps not told"
        best = bryson_denham.OPTIMAL_COSTS[N]
        for threshold in THRESHOLDS:
            result = solve(problem, METHOD, threshold=threshold)
            above = 100.0 * (result.cost / best - 1.0)
            said = "reproduced" if result.cost <= bryson_denham.PAPER_COST + 0.005 else "not reached"
            said += f": {above:.2f} % above the optimum of {N} steps"
            yield Row(section, f"N = {N}, threshold {threshold:g}", paper, _ours(result), said)
        result = solve(problem, "constrained")
        yield Row(section, f"N = {N}, constrained", paper, _ours(result), f"the optimum of {N} steps is {best:g}")
    result = solve(problems.get("bryson_denham", horizon=SAMPLES), METHOD, max_iterations=2)
    first, second = result.log[0].cost, result.log[1].cost
    said = "reproduced" if second > first and result.log[1].violation < result.log[0].violation else "differs"
    yield Row(
        section, "the row of the cost off in the first step", "constraints better, cost worse",
        f"J {first:.4g} -> {second:.4g}, violation {result.log[0].violation:.2g} -> {result.log[1].violation:.2g}",
        said,
    )  # fmt: skip


def example_2() -> Iterator[Row]:
    """Section 4.3: feasible, and cheaper than the start; the optimum beside it."""
    section = "Section 4.3, Example 2 from bang-bang controls of 5: 50 steps"
    problem = problems.get("drag_cart")
    start, best = problem.cost(_nominal(problem)), drag_cart.OPTIMAL_COSTS[50]
    paper = "constraints met, cost much lower; optimality not checked"
    tried: tuple[tuple[str, dict[str, Any]], ...] = ((METHOD, {"threshold": 1.1}), ("constrained", {}))
    for name, options in tried:
        result = solve(problem, name, **options)
        met = result.constraint_violation <= 1e-6 and result.cost < start
        said = "not reached" if not met else "reproduced" if name == METHOD else "met"
        said += f": {100.0 * abs(result.cost / best - 1.0):.2f} % from the optimum, {best}"
        yield Row(section, name, paper, f"{_ours(result)}, from {start:.4g}", said)


def reentry_nominal() -> Iterator[Row]:
    """Section 5.4: the nominal trajectory."""
    section, paper = "Section 5.4, the nominal trajectory, its angles read off Fig. 5.1", reentry.PAPER
    problem = problems.get("reentry", limits="row")
    trajectory = _nominal(problem)
    load, angle = reentry.loads(trajectory), float(np.degrees(trajectory.X[-1, 1]))
    yield Row(
        section, "flight path angle at the end", f"{paper['final angle']} deg", f"{angle:.4f} deg",
        _near(angle, paper["final angle"], 1e-3),
    )  # fmt: skip
    peak, at = float(load.max()), float(trajectory.times[load.argmax() + 1])
    yield Row(
        section, "peak of the load", f"{paper['peak load']} g at {paper['peak time']:g} s", f"{peak:.4f} g at {at:g} s",
        _near(peak, paper["peak load"], 1e-2),
    )  # fmt: skip
    too_steep = np.flatnonzero(trajectory.U[:, 0] > np.radians(22.5)) + 1
    both = np.intersect1d(too_steep, np.flatnonzero(load > 5.0) + 1)
    yield Row(
        section,
        "angle and load both too large",
        "58 s to 62 s",
        f"{both[0]} s to {both[-1]} s",
        "nearly the same times",
    )


def reentry_solved() -> Iterator[Row]:
    """Sections 5.4 and 5.5: all at once, the recipe, and the second start."""
    section = "Section 5.4, corrections"
    problem = problems.get("reentry", limits="row")
    result = solve(problem, METHOD, step="open-loop")
    after = problem.rollout(reentry.second_angles(problem))
    angles, end = np.degrees(after.X[:, 1]), 1e5 * after.X[-1, 2]
    failed = "Figs. 5.6, 5.7: path turns by more than 180 deg, altitude below 0"
    rest = result.message.partition("Rows contradict")[2].partition("square-root-sweep")[0].strip()
    yield Row(
        section, "all rows at once", failed, f"no step: rows contradict {rest.removesuffix('.')}",
        "the linearized rows have no solution; the thesis's must be rounding",
    )  # fmt: skip
    yield Row(
        section, "the same by least squares", failed,
        f"path {angles.min():.0f} to {angles.max():.0f} deg, {end:.0f} ft at the end",
        "fails alike: it plunges, not as far",
    )  # fmt: skip
    reported = "angle on its limit for about 60 s, 5 g, level at the end; iterations not told"
    for step in ("open-loop", "closed-loop"):
        result = solve(problem, METHOD, **(RECIPE | {"step": step}))
        yield Row(section, f"limit of the angle first, {step}", reported, _reentry(result), _reached(result))
        if step == "open-loop":
            yield _lower_and_slower(section, result)
    section = "Section 5.5, from the failed correction (least squares)"
    start = problems.get("reentry", limits="row", start="second")
    tracking = problems.get("reentry", variant="tracking", start="second")
    found = {
        METHOD: solve(start, METHOD, step="open-loop"),
        f"{METHOD}, limit of the angle first": solve(start, METHOD, **RECIPE),
        "constrained, with a cost of ours": solve(tracking, "constrained"),
    }
    for name, result in found.items():
        said = "differs: the thesis's fails, this one converges" if result.success else "the thesis fails, and so do we"
        yield Row(section, name, "no convergence", _reentry(result), said)


def _lower_and_slower(section: str, result: Result) -> Row:
    """Section 5.5: the solution ends lower and slower than the nominal trajectory."""
    (v, _, h), (before, _, above) = result.trajectory.X[-1], result.iterates[0].X[-1]
    ours = f"{1e5 * (h - above):+.0f} ft, {1e4 * (v - before):+.0f} ft/s"
    said = "reproduced" if h < above and v < before else "differs: another of the many that meet the constraints"
    return Row(section, "end, beside the nominal one", "lower, slightly slower", ours, said)


def _nominal(problem: Problem) -> Trajectory:
    return problem.rollout(np.asarray(problem.U0))


def _equal(ours: Any, paper: Any) -> str:
    return "reproduced" if np.allclose(ours, paper, rtol=0.0, atol=1e-12) else "differs"


def _near(ours: float, paper: float, tol: float) -> str:
    off = f"{100.0 * (ours / paper - 1.0):+.2f} %"
    return f"{'reproduced' if abs(ours - paper) <= tol else 'differs'}: {off}"


def _reached(result: Result) -> str:
    return "reproduced" if result.success else "not reached"


def _ours(result: Result) -> str:
    stopped = "converged" if result.success else "stopped, not converged,"
    return f"J = {result.cost:.5f}, {stopped} after {result.iterations}, violation {result.constraint_violation:.0e}"


def _reentry(result: Result) -> str:
    load, path = reentry.loads(result.trajectory).max(), np.degrees(result.trajectory.X[-1, 1])
    held = int((result.trajectory.U[:, 0] > np.radians(22.499)).sum())
    how = "converged" if result.success else result.status.value
    return f"{how} after {result.iterations}: {load:.4f} g, path {path:+.1e} deg, angle on its limit for {held} s"


# Figures


def _solved_1() -> Result:
    return solve(problems.get("bryson_denham", horizon=SAMPLES), METHOD, threshold=1.3)


@figures.styled
def example_1_figure() -> Figure:
    """Figs. 4.1 to 4.5: states before and after, and the control."""
    result = _solved_1()
    start, end = result.iterates[0], result.trajectory
    figure, axes = figures.subplots(1, 3, (11.0, 3.4))
    for axis, i, name in zip(axes[0], (0, 1), ("x_1 = r [m]", "x_2 = v [m/s]"), strict=False):
        _before_and_after(axis, (start.times, start.X[:, i]), (end.times, end.X[:, i]), f"${name.split(' ')[0]}$")
        axis.set(xlabel="t [s]", ylabel=name.partition("= ")[2])
    axes[0, 0].axhline(0.1, color=figures.COLORS[1], linestyle="--", linewidth=1.0)
    _steps(axes[0, 2], start, end, "u [N]")
    figure.suptitle(f"McQuade 1989, Figs. 4.1 to 4.5: Example 1, {SAMPLES} steps, J = {result.cost:.3f}")
    return figure


@figures.styled
def example_2_figure() -> Figure:
    """Figs. 4.6 to 4.12: states, control and cost by iterations."""
    result = solve(problems.get("drag_cart"), METHOD, threshold=1.1)
    start, end = result.iterates[0], result.trajectory
    figure, axes = figures.subplots(2, 2, (9.0, 6.2))
    _steps(axes[0, 0], start, end, "u [N]")
    for axis, i, name in ((axes[0, 1], 0, "r [m]"), (axes[1, 0], 1, "v [m/s]")):
        _before_and_after(axis, (start.times, start.X[:, i]), (end.times, end.X[:, i]), "")
        axis.set(xlabel="t [s]", ylabel=name)
    axes[1, 0].axhline(np.sqrt(2.0), color=figures.COLORS[1], linestyle="--", linewidth=1.0)
    axes[1, 1].plot([entry.iteration for entry in result.log], [entry.cost for entry in result.log], marker=".")
    axes[1, 1].set(xlabel="iteration", ylabel="J", title="cost")
    figure.suptitle(f"McQuade 1989, Figs. 4.6 to 4.12: Example 2, J = {result.cost:.3f}")
    return figure


@figures.styled
def nominal_figure() -> Figure:
    """Figs. 5.1 to 5.5: the nominal trajectory of the re-entry."""
    problem = problems.get("reentry", limits="row")
    return _reentry_figure("Figs. 5.1 to 5.5: nominal trajectory", [("nominal", _nominal(problem))])


@figures.styled
def failure_figure() -> Figure:
    """Figs. 5.6 and 5.7: after one correction of all violations, by least squares."""
    problem = problems.get("reentry", limits="row")
    after = problem.rollout(reentry.second_angles(problem))
    shown = [("nominal", _nominal(problem)), ("after 1 iteration", after)]
    return _reentry_figure("Figs. 5.6 and 5.7: all rows at once, by least squares", shown)


@figures.styled
def solution_figure() -> Figure:
    """Figs. 5.8 to 5.12: the solution beside the nominal trajectory."""
    problem = problems.get("reentry", limits="row")
    result = solve(problem, METHOD, **RECIPE)
    shown = [("nominal", result.iterates[0]), ("solution", result.trajectory)]
    return _reentry_figure(f"Figs. 5.8 to 5.12: after {result.iterations} iterations", shown)


def _reentry_figure(title: str, shown: list[tuple[str, Trajectory]]) -> Figure:
    figure, axes = figures.subplots(2, 3, (11.0, 5.8))
    for name, trajectory in shown:
        times, X = trajectory.times, trajectory.X
        curves = (1e4 * X[:, 0], np.degrees(X[:, 1]), 1e5 * X[:, 2])
        for axis, curve in zip(axes.flat, curves, strict=False):
            axis.plot(times, curve, label=name)
        axes[1, 0].plot(times[:-1], np.degrees(trajectory.U[:, 0]), label=name)
        axes[1, 1].plot(times[1:], reentry.loads(trajectory), label=name)
    names = ("speed [ft/s]", "flight path angle [deg]", "altitude [ft]", "angle of attack [deg]", "load [g]")
    for axis, name in zip(axes.flat, names, strict=False):
        axis.set(xlabel="t [s]", title=name)
    axes[1, 0].axhline(22.5, color=figures.COLORS[1], linestyle="--", linewidth=1.0)
    axes[1, 1].axhline(5.0, color=figures.COLORS[1], linestyle="--", linewidth=1.0)
    axes[1, 2].axis("off")
    axes[0, 0].legend()
    figure.suptitle(f"McQuade 1989, {title}")
    return figure


def _before_and_after(axis: Any, before: tuple[Any, Any], after: tuple[Any, Any], title: str) -> None:
    axis.plot(*before, color=figures.COLORS[3], label="nominal")
    axis.plot(*after, color=figures.COLORS[0], label="solution", marker=".")
    axis.set(title=title)
    axis.legend()


def _steps(axis: Any, start: Trajectory, end: Trajectory, name: str) -> None:
    axis.stairs(start.U[:, 0], start.times, baseline=None, color=figures.COLORS[3], label="nominal")
    axis.stairs(end.U[:, 0], end.times, baseline=None, color=figures.COLORS[0], linewidth=1.6, label="solution")
    axis.set(xlabel="t [s]", ylabel=name, title="control")
    axis.legend()


FIGURES = {
    "figures-4.1-4.5": example_1_figure,
    "figures-4.6-4.12": example_2_figure,
    "figures-5.1-5.5": nominal_figure,
    "figures-5.6-5.7": failure_figure,
    "figures-5.8-5.12": solution_figure,
}
"""What can be drawn again."""
