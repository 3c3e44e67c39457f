"""`mjslq reproduce`: what the papers report, beside what comes out here, row by row.

A verdict says how the two compare and hides nothing: "reproduced" needs the paper's number or a better one by the
paper's own method; where the paper reports a failure and ours converges, it says so; where a number differs, both
stand in the row.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mjslq import problems
from mjslq.optimize import solve
from mjslq.reports.compare import compare, plot
from mjslq.result import Result


@dataclass(frozen=True)
class Row:
    """One reported number."""

    what: str
    """What was computed."""
    paper: str
    """What the paper reports."""
    ours: str
    """What came out here."""
    verdict: str
    """How they compare."""


def slq() -> Iterator[Row]:
    """Sideris and Bobrow 2005: Table 1, and what section 4.2 says of the hopper."""
    from mjslq.problems.drag_particle import BETAS, OPTIMAL_COSTS, PAPER_ITERATIONS

    for beta in BETAS:
        result = solve(problems.get("drag_particle", beta=beta))
        agrees = abs(result.cost / OPTIMAL_COSTS[beta] - 1.0) < 1e-8
        yield _iterations(
            f"Table 1, drag particle, beta = {beta:g}, SLQ iterations to |gradient| < 1e-6", result,
            PAPER_ITERATIONS[beta], f", J = {result.cost:.10g}" + ("" if agrees else " (another minimum)"),
        )  # fmt: skip
    # The paper's step is open loop; at height 1 nothing else gives its count.
    for height, reported in ((1.0, 3), (50.0, 166)):
        for step in ("open-loop", "closed-loop"):
            problem = problems.get("hopper", height=height)
            result = solve(problem, step=step, tol_direction=1e-3)
            off = 100.0 * (result.trajectory.X[-1, 0] / height - 1.0)
            what = f"section 4.2, hopper, height {height:g}, SLQ iterations ({step}, tol 1e-3)"
            yield _iterations(what, result, reported, f", height {off:+.2f} %")
    for alpha in (1e-4, 1e-5, 1e-6, 1e-8):
        result = solve(problems.get("hopper", alpha=alpha, engine="function"), tol_direction=1e-3)
        paper = "converges" if alpha >= 1e-5 else "no convergence"
        ours = f"{result.status.value} in {result.iterations}"
        better = "the paper's method fails here, ours converges" if alpha < 1e-5 else "reproduced"
        yield Row(
            f"section 4.2, hopper, height 20, alpha = {alpha:g} (tol 1e-3)",
            paper,
            ours,
            better if result.success else "not reached",
        )


def trust_region() -> Iterator[Row]:
    """Fukushima and Yamamoto 1986: Table I, and where the iteration ends."""
    from mjslq.problems.van_der_pol import PAPER_COST, PAPER_TABLE

    eta_1 = 0.25
    result = solve(problems.get("van_der_pol"), "trust-region", tol_direction=0.0, tol_gradient=1e-8)
    for k, ((J, after, Q, rho, Delta), entry) in enumerate(zip(PAPER_TABLE, result.log, strict=False)):
        paper = f"J {J:.3f} -> {after:.3f}, Q {Q:+.3f}, rho {rho:+.3f}, Delta {Delta:g}"
        there = entry.cost + entry.ratio * entry.predicted
        ours = f"J {entry.cost:.3f} -> {there:.3f}, Q {entry.predicted:+.3f}, rho {entry.ratio:+.3f}"
        ours += f", Delta {entry.radius:g}"
        same = (rho >= eta_1) == (entry.ratio >= eta_1) and Delta == entry.radius
        off = 100.0 * abs(entry.cost / J - 1.0)
        decision = "same radius, same decision" if same else "another radius or decision"
        yield Row(f"Table I, iteration {k}", paper, ours, f"{decision}; J differs by {off:.1f} %")
    gap = 100.0 * (result.cost / PAPER_COST - 1.0)
    yield Row(
        "where it ends", f"J {PAPER_COST:.3f} after 12 iterations",
        f"J {result.cost:.6f}, |gradient| {result.gradient_norm:.0e} after {len(result.log) - 1}",
        f"converged, J differs by {gap:+.1f} %" if result.success else result.status.value,
    )  # fmt: skip


PAPERS: dict[str, Callable[[], Iterator[Row]]] = {"slq": slq, "trust-region": trust_region}
"""Papers by the name of their method."""


def figure_2(path: str | os.PathLike[str]) -> None:
    """Draw Fig. 2 of Sideris and Bobrow 2005: relative costs of SLQ, Newton and steepest descent at beta = 0.1."""
    entries = list(compare(problems.get("drag_particle", beta=0.1), ("slq", "newton", "gradient")))
    plot(entries, path, "Sideris and Bobrow 2005, Fig. 2: drag particle, beta = 0.1")


FIGURES: dict[str, Callable[[str | os.PathLike[str]], None]] = {"slq": figure_2}
"""Figures that can be drawn again, by paper."""


def _iterations(what: str, result: Result, reported: int | None, remark: str) -> Row:
    ours = f"{result.iterations if result.success else result.status.value}{remark}"
    if not result.success:
        verdict = "the paper fails here, and so does ours" if reported is None else "not reached"
    elif reported is None:
        verdict = "the paper's method fails here, ours converges"
    elif result.iterations <= reported:
        verdict = "reproduced" if result.iterations > 0.8 * reported else "reproduced, in fewer"
    else:
        verdict = f"differs: {result.iterations - reported} more"
    return Row(what, "none in 300" if reported is None else str(reported), ours, verdict)
