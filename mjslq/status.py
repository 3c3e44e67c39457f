"""How a solve can end, and what to do about it."""

from __future__ import annotations

import enum


class Status(enum.Enum):
    """Why a solve stopped. Only `CONVERGED` is success; not converging is a status, never an exception."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "max_iterations"
    STEP_TOO_SMALL = "step_too_small"
    DIVERGED = "diverged"
    INTERRUPTED = "interrupted"
    STOPPED = "stopped"

    @property
    def message(self) -> str:
        """One sentence on what happened and what can be tried."""
        return _MESSAGES[self]


_MESSAGES = {
    Status.CONVERGED: "A stationary point was found to the tolerance asked for.",
    Status.MAX_ITERATIONS: (
        "The iterations ran out before the tolerance was met. Raise max_iterations, start nearer (U0), "
        "weigh the controls more, or ask for less (tol)."
    ),
    Status.STEP_TOO_SMALL: (
        "No step along the search direction lowers the cost, although the gradient is not zero. Check the "
        "derivatives (check_derivatives=True), smooth the contacts, or accept this point if its gradient is small."
    ),
    Status.DIVERGED: (
        "There is no finite cost or derivative to go on from. Start from controls that keep the system bounded (U0), "
        "shorten the timestep, or check the cost."
    ),
    Status.INTERRUPTED: "Interrupted; this is the best iterate so far.",
    Status.STOPPED: "The callback asked to stop; this is the best iterate so far.",
}
