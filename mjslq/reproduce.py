"""`mjslq reproduce`: what the papers report, beside what comes out here, row by row.

A verdict says how the two compare and hides nothing: "reproduced" needs the paper's number or a better one by the
paper's own method; where the paper reports a failure and ours converges, it says so; where a number differs, both
stand in the row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mjslq import problems
from mjslq._solve import solve
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
    for alpha in (1e-4, 1e-5, 1e-6):
        result = solve(problems.get("hopper", alpha=alpha, engine="function"))
        paper = "converges" if alpha >= 1e-5 else "no convergence"
        ours = f"{result.status.value} in {result.iterations}"
        better = "the paper's method fails here, ours converges" if alpha < 1e-5 else "reproduced"
        yield Row(
            f"section 4.2, hopper, height 20, alpha = {alpha:g}",
            paper,
            ours,
            better if result.success else "not reached",
        )


PAPERS: dict[str, Callable[[], Iterator[Row]]] = {"slq": slq}
"""Papers by the name of their method."""


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
