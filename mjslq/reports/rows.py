"""`Row`: a number that a paper reports, beside ours."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One reported number."""

    section: str
    """Where the paper reports it, and what is counted."""
    what: str
    """What was computed: the case."""
    paper: str
    """What the paper reports."""
    ours: str
    """What came out here."""
    verdict: str
    """How they compare."""


def verdict(count: int | None, reported: int | None, *, faithful: bool = True) -> str:
    """Compare a number of iterations with the one reported; None where a method did not converge.

    Only a `faithful` method, the paper's own, can reproduce a number; others are told as fewer or more.
    """
    if count is None:
        return "the paper fails here, and so does ours" if reported is None else "not reached"
    if reported is None:
        return "differs: the paper's fails, ours converges" if faithful else "the paper's fails, this one converges"
    if count > reported:
        return f"{'differs: ' if faithful else ''}{count - reported} more"
    if not faithful:
        return "fewer" if count < reported else "as many"
    return "reproduced" if count > 0.8 * reported else "reproduced, in fewer"
