"""Sforni, Spedicato, Notarnicola, Notarstefano, "GoPRONTO: a Feedback-based Framework for Nonlinear Optimal Control".

The equations and tables of the text at hand are lost: what stands beside ours are its statements in words. The train's
parameters, weights and reference are ours, too, so that no number can be the paper's; what can be reproduced is which
method converges where, and which is faster. All solves start from the train upright at rest, theta as told.

Table II: QP solvers that are installed (`reports.qp_solvers`). Table III: times by the number of carts. Figure 5:
gradient norms of the gradient method, first-order PRONTO and GoPRONTO; 6: conjugate; 7: momentum with fixed steps; 8:
limited forces, by barriers. Theorem III.2: stationarity with the costates under feedback. Section III-B2: first-order
steps as a globalization of Newton's method.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq import problems
from mjslq.optimize import solve
from mjslq.problem import Problem
from mjslq.reports import figures, qp_solvers, train
from mjslq.reports.rows import Row
from mjslq.result import Result
from mjslq.solvers.projection import CurveIterate
from mjslq.solvers.regulator import Regulator

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOL = 1e-4
"""On the gradient by the curve, as in the figures."""
LOST = "(number lost)"
CARTS = (2, 5, 10, 20, 50)
STEP = 0.02
"""Fixed, for Figure 7."""
LIMIT = 6.0
"""Of the forces, for Figure 8; the paper's is lost. [N]"""
METHODS: dict[str, dict[str, Any]] = {
    "PRONTO, Newton": {"method": "pronto", "order": "newton"},
    "PRONTO, Gauss-Newton": {"method": "pronto"},
    "PRONTO, first order": {"method": "pronto", "order": "first"},
    "GoPRONTO, gradient": {"method": "gopronto", "variant": "gradient"},
    "GoPRONTO, conjugate": {"method": "gopronto", "variant": "conjugate"},
    "GoPRONTO, quasi-Newton (not in the paper)": {"method": "gopronto"},
    "gradient method, open loop": {"method": "gradient", "line_search": "armijo"},
}
FIXED: dict[str, dict[str, Any]] = {
    "gradient": {"variant": "gradient"},
    "heavy-ball": {"variant": "heavy-ball", "restarts": False},
    "Nesterov": {"variant": "nesterov", "restarts": False},
}


@cache
def solved(name: str, theta: float = 30.0, carts: int = 2) -> Result:
    """The swing by one of `METHODS`, to `TOL`."""
    problem = problems.get("cart_train", carts=carts, theta=theta)
    return solve(problem, tol_direction=0.0, tol_gradient=TOL, max_iterations=600, **METHODS[name])


@cache
def fixed(name: str) -> Result:
    """The swing by one of `FIXED`."""
    problem = problems.get("cart_train")
    options: dict[str, Any] = {"step_rule": "fixed", "step_size": STEP, "max_iterations": 500, **FIXED[name]}
    return solve(problem, "gopronto", tol_direction=0.0, tol_gradient=TOL, **options)


def rows() -> Iterator[Row]:
    """Every statement of section V, and of the theorem."""
    yield from theorem()
    yield from qp_solvers.rows()
    yield from convergence_of_methods()
    yield from larger_swings()
    yield from momentum()
    yield from times()
    yield from globalization()
    yield from limits()


def theorem() -> Iterator[Row]:
    """Theorem III.2 and section III-B1: stationarity, and how costates grow."""
    section, problem = "Theorem III.2, section III-B1: costates", problems.get("cart_train")
    result = solve(problem, "pronto", order="newton", tol_direction=0.0, tol_gradient=1e-9)
    here = CurveIterate(problem, result.trajectory, None)
    closed = Regulator("lqr", problem.options["regulator"]).with_gains(here)
    A, B, _, _ = here.linearization
    Hu = here.expansion.r + np.einsum("nij,ni->nj", B, closed.costates[1:])
    largest = float(np.abs(Hu).max())
    said = "reproduced" if largest < 1e-7 else "differs"
    yield Row(section, "largest |H_u| at the limit, costates under feedback", "0", f"{largest:.1e}", said)
    assert closed.K is not None
    grows = [_growth(A), _growth(A - B @ closed.K)]
    yield Row(
        section, "growth of a costate over the horizon, under A and under A - B K", "grows, and stays bounded",
        f"{grows[0]:.1e} and {grows[1]:.1e}", "reproduced" if grows[0] > 1e6 > 10.0 * grows[1] else "differs",
    )  # fmt: skip


def convergence_of_methods() -> Iterator[Row]:
    """Figures 5 and 6: iterations to `TOL`."""
    section = f"Figures 5 and 6: two carts, 30 deg, iterations to |gradient| < {TOL:g}"
    newton = solved("PRONTO, Newton")
    paper = {
        "PRONTO, first order": "slower than GoPRONTO",
        "GoPRONTO, gradient": "converges",
        "GoPRONTO, conjugate": "faster than the gradient",
        "gradient method, open loop": "diverges after very few iterations",
    }
    for name in METHODS:
        result = solved(name)
        ours = (
            f"{result.iterations}, J = {result.cost:.9g}, relative to Newton's {result.cost / newton.cost - 1.0:+.0e}"
        )
        if not result.success:
            ours = f"{result.status.value} after {result.iterations}, |gradient| {result.gradient_norm:.0e}"
        yield Row(section, name, paper.get(name, "-"), ours, _convergence_verdict(name, result))
    norms = np.array([entry.gradient_norm for entry in newton.log[-4:]])
    tail = ", ".join(f"{norm:.1e}" for norm in norms)
    falls = np.log(norms[2:] / norms[1:-1]) / np.log(norms[1:-1] / norms[:-2])
    said = f"{'reproduced' if falls[-1] > 1.7 else 'differs'}: of order {falls[-1]:.2f}"
    yield Row(section, "the last gradient norms of PRONTO, Newton", "quadratic", tail, said)


def _convergence_verdict(name: str, result: Result) -> str:
    if name == "gradient method, open loop":
        return "reproduced: it fails" if not result.success else "differs: it converges"
    if name == "PRONTO, first order":
        slower = not result.success or result.iterations > solved("GoPRONTO, gradient").iterations
        return "reproduced" if slower else "differs: it is faster"
    if name == "GoPRONTO, conjugate":
        faster = result.success and result.iterations < solved("GoPRONTO, gradient").iterations
        return "reproduced" if faster else "differs"
    return ("reproduced" if "gradient" in name else "-") if result.success else "differs: it does not converge"


def larger_swings() -> Iterator[Row]:
    """Section V-2: larger amplitudes, where problems are nearly ill-posed."""
    section = "Section V-2: larger swings, two carts, iterations"
    for theta in (60.0, 90.0):
        for name in ("PRONTO, Newton", "PRONTO, Gauss-Newton", "GoPRONTO, quasi-Newton (not in the paper)"):
            result = solved(name, theta)
            ours = f"{result.iterations}, J = {result.cost:.9g}" if result.success else result.status.value
            said = "converges" if result.success else "does not converge"
            yield Row(section, f"{theta:g} deg, {name}", LOST, ours, said)


def momentum() -> Iterator[Row]:
    """Figure 7: fixed steps."""
    section = f"Figure 7: fixed steps of {STEP:g}, two carts, 30 deg, iterations"
    plain = fixed("gradient")
    for name in FIXED:
        result = fixed(name)
        ours = f"{result.iterations}" if result.success else f"|gradient| {result.gradient_norm:.0e} after 500"
        faster = result.gradient_norm < plain.gradient_norm or result.iterations < plain.iterations
        yield Row(
            section, name, "converges" if name == "gradient" else "faster than the gradient", ours,
            "-" if name == "gradient" else "reproduced" if faster else "differs",
        )  # fmt: skip


@cache
def timed(name: str, carts: int) -> tuple[float, float, int]:
    """Processor time of an iteration and in total [s], and iterations, by the number of carts."""
    problem = problems.get("cart_train", carts=carts)
    started = time.process_time()
    result = solve(
        problem, tol_direction=0.0, tol_gradient=TOL * np.sqrt(carts / 2.0), max_iterations=1000, keep_iterates=False,
        **METHODS[name],
    )  # fmt: skip
    total = time.process_time() - started
    return (
        1e-3 * train.milliseconds(METHODS[name]["method"], carts) * problem.horizon / train.HORIZON,
        total,
        (result.iterations if result.success else -1),
    )


def times() -> Iterator[Row]:
    """Table III: an iteration and the whole solve; the number of carts from which first-order steps are faster."""
    section = "Table III: seconds an iteration; in total, gains included (iterations)"
    names = ("PRONTO, Gauss-Newton", "GoPRONTO, gradient", "GoPRONTO, quasi-Newton (not in the paper)")
    for name in names:
        train_of_one = problems.get("cart_train", carts=1, horizon=20)
        solve(train_of_one, max_iterations=1, **METHODS[name])  # compiling
        for carts in CARTS:
            each, total, count = timed(name, carts)
            yield Row(section, f"{carts} carts, {name}", LOST, f"{each:.2g}; {total:.2g} ({count})", "-")
    for name in names[1:]:
        ahead = [carts for carts in CARTS if timed(name, carts)[1] < timed(names[0], carts)[1]]
        ours = f"{ahead[0]} carts" if ahead else f"none up to {CARTS[-1]}"
        said = "-" if name == names[2] else "reproduced" if ahead else "not reached"
        yield Row(section, f"{name} is faster in total from", "large numbers of carts", ours, said)


def globalization() -> Iterator[Row]:
    """Section III-B2: first-order steps, then Newton's."""
    section = "Section III-B2: globalization of Newton's method, two carts, 90 deg"
    problem = problems.get("cart_train", theta=90.0)
    for globalize, what in (("none", "Newton alone"), ("gopronto", "first-order steps, then Newton")):
        result = solve(problem, "pronto", order="newton", globalize=globalize, tol_direction=0.0, tol_gradient=1e-8)
        tail = ", ".join(f"{entry.gradient_norm:.0e}" for entry in result.log[-4:])
        ours = f"{result.iterations} iterations, the last gradients {tail}" if result.success else result.status.value
        expected = result.success is (globalize == "gopronto")
        paper = "-" if globalize == "none" else "can be used as a globalization"
        yield Row(section, what, paper, ours, "as expected" if expected else "differs")


@cache
def limited(method: str) -> tuple[Problem, Result]:
    """The swing with limited forces."""
    problem = problems.get("cart_train", limit=LIMIT)
    return problem, solve(problem, method, max_iterations=600)


def limits() -> Iterator[Row]:
    """Figure 8: limited forces."""
    section = f"Figure 8: forces within {LIMIT:g} N (ours), two carts, 30 deg"
    best = limited("auto")[1]
    yield Row(section, "auto, which keeps to limits exactly", "-", f"J = {best.cost:.7g}", best.status.value)
    problem, result = limited("pronto")
    worst = max(problem.violation(iterate) for iterate in result.iterates)
    ours = f"J = {result.cost:.7g} ({100.0 * (result.cost / best.cost - 1.0):+.3f} %), worst violation {worst:.0e}"
    kept = worst == 0.0 and result.success
    yield Row(section, "PRONTO with barriers", "limits are kept", ours, "reproduced" if kept else "differs")


def _growth(F: np.ndarray[Any, Any]) -> float:
    """Largest length of a costate, started with length 1 at the end, that runs backward under F'."""
    costate, largest = np.ones(F.shape[1]) / np.sqrt(F.shape[1]), 1.0
    for Fn in F[::-1]:
        costate = Fn.T @ costate
        largest = max(largest, float(np.linalg.norm(costate)))
    return largest


@figures.styled
def figure_5() -> Figure:
    """Figures 5 to 7: norms of the gradient by the curve."""
    figure, ((left, right),) = figures.subplots(1, 2, (10.0, 4.2), sharey=True)
    for name in METHODS:
        log = solved(name).log
        norms = [entry.gradient_norm for entry in log]
        style = "--" if name.startswith("GoPRONTO") else "-" if name.startswith("PRONTO") else "x"
        left.loglog([entry.iteration + 1 for entry in log], norms, style, label=name)
    for name in FIXED:
        log = fixed(name).log
        right.loglog([entry.iteration + 1 for entry in log], [entry.gradient_norm for entry in log], label=name)
    left.set(xlabel="iteration + 1", ylabel="|gradient|", ylim=(1e-9, 1e4))
    right.set(xlabel="iteration + 1")
    left.set_title("Armijo's rule, with a parabola for GoPRONTO")
    right.set_title("fixed steps")
    left.legend(fontsize=7)
    right.legend()
    figure.suptitle("Two carts, 30 deg: Figures 5 to 7 of GoPRONTO, with parameters of our own")
    return figure


@figures.styled
def figure_8() -> Figure:
    """Figures 4 and 8: the swing, free and with limited forces."""
    figure, axes = figures.subplots(2, 2, (10.0, 5.2), sharex=True)
    problem = problems.get("cart_train")
    for column, (title, result) in enumerate((("free", solved("PRONTO, Newton")), ("limited", limited("pronto")[1]))):
        t = result.trajectory
        axes[0, column].plot(t.times, np.degrees(t.X[:, 1]), label="pendulum 1")
        axes[0, column].plot(t.times, np.degrees(_reference(problem)), "--", color=figures.SOFT, label="reference")
        axes[1, column].stairs(t.U[:, 0], t.times, baseline=None, color=figures.COLORS[0])
        axes[0, column].set_title(title)
        axes[1, column].set(xlabel="t [s]")
        axes[0, column].legend()
    axes[0, 0].set(ylabel="angle [deg]")
    axes[1, 0].set(ylabel="force [N]")
    for side in (-LIMIT, LIMIT):
        axes[1, 1].axhline(side, color=figures.SOFT, linestyle=":")
    figure.suptitle("The swing of two carts, free and with limited forces")
    return figure


@figures.styled
def growth() -> Figure:
    """Times of an iteration by the number of carts."""
    figure, ((axis,),) = figures.subplots(1, 1, (6.4, 4.2))
    for method in train.METHODS:
        times = train.growth(method)
        power = train.exponent(times)
        axis.loglog(list(times), list(times.values()), marker="o", label=f"{method}: ~ carts^{power:.1f} from 20 on")
    axis.set(xlabel="carts", ylabel=f"processor time of an iteration, {train.HORIZON} steps [ms]")
    axis.legend()
    axis.set_title("Cost of an iteration")
    return figure


def _reference(problem: Problem) -> np.ndarray[Any, Any]:
    """Angles that the pendulums are to follow. Shape (N + 1,). [rad]"""
    from mjslq.problems.cart_train import reference
    from mjslq.problems.cart_train_model import Train

    h = float(np.asarray(problem.dynamics.dt))
    return reference(Train(2), np.radians(problem.parameters["theta"]), problem.horizon, h)[:, 1]


FIGURES = {"figures-5-to-7": figure_5, "figures-4-and-8": figure_8, "growth": growth}
"""What can be drawn again."""
