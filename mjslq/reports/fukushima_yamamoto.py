"""Fukushima and Yamamoto 1986, "A second-order algorithm for continuous-time nonlinear optimal control problems".

Table I, the cost at the end, and Fig. 1 (the controls of the first iterations), by `trust-region` on `van_der_pol`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from mjslq import problems
from mjslq.optimize import solve
from mjslq.reports import figures
from mjslq.reports.rows import Row
from mjslq.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ETA_1 = 0.25
"""Ratio from which on a step is accepted."""


def solved() -> Result:
    """The paper's example by its method, to ||dJ/dU|| < 1e-8."""
    return solve(problems.get("van_der_pol"), "trust-region", tol_direction=0.0, tol_gradient=1e-8)


def rows() -> Iterator[Row]:
    """Table I, and where the iteration ends."""
    from mjslq.problems.van_der_pol import PAPER_COST, PAPER_TABLE

    result = solved()
    for k, ((J, after, Q, rho, Delta), entry) in enumerate(zip(PAPER_TABLE, result.log, strict=False)):
        there = entry.cost + entry.ratio * entry.predicted
        ours = f"J {entry.cost:.3f} -> {there:.3f}, Q {entry.predicted:+.3f}, rho {entry.ratio:+.3f}"
        same = (rho >= ETA_1) == (entry.ratio >= ETA_1) and Delta == entry.radius
        verdict = "same radius, same decision" if same else "another radius or decision"
        verdict += f"; J differs by {100.0 * abs(entry.cost / J - 1.0):.1f} %"
        if Q > 0.0 > entry.predicted:
            verdict += "; the paper's model has not been minimized here, as it says itself"
        yield Row(
            "Table I, the first iterations",
            f"iteration {k}",
            f"J {J:.3f} -> {after:.3f}, Q {Q:+.3f}, rho {rho:+.3f}, Delta {Delta:g}",
            f"{ours}, Delta {entry.radius:g}",
            verdict,
        )
    gap = 100.0 * (result.cost / PAPER_COST - 1.0)
    said = f"converged, J differs by {gap:+.1f} %; no reading of the example that was tried gives the paper's"
    yield Row(
        "Section IV", "where it ends", f"J {PAPER_COST:.3f} after 12 iterations",
        f"J {result.cost:.6f}, |gradient| {result.gradient_norm:.0e} after {len(result.log) - 1}",
        said if result.success else result.status.value,
    )  # fmt: skip


@figures.styled
def figure_1() -> Figure:
    """Fig. 1: the controls of the first iterations, and those at the end."""
    result = solved()
    figure, ((axis,),) = figures.subplots(1, 1, (6.4, 4.0))
    steps = [0, *(k + 1 for k, entry in enumerate(result.log) if entry.outcome == "accepted")]
    shown, last = steps[:4], steps[-1]
    for place, k in enumerate([*shown, last]):
        U = result.iterates[k].U[:, 0]
        end = k == last
        label = f"$u^{{{k}}}$, the solution" if end else f"$u^{{{k}}}$"
        color = figures.INK if end else figures.RAMP[place]
        axis.stairs(U, result.iterates[k].times, baseline=None, label=label, color=color, linewidth=2.0 if end else 1.4)
    axis.set(xlabel="t [s]", ylabel="u", xlim=(0.0, float(result.trajectory.times[-1])))
    axis.set_title("Fukushima and Yamamoto 1986, Fig. 1: convergence of the control")
    axis.legend(title="iteration")
    return figure


FIGURES = {"figure-1": figure_1}
"""What can be drawn again."""
