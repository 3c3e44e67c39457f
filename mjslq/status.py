"""How a solve can end, and what to do about it."""

from __future__ import annotations

import enum


class Status(enum.Enum):
    """Why a solve stopped. Only `CONVERGED` is success; not converging is a status, never an exception.

    Examples
    --------
    >>> result = mjslq.solve(mjslq.problems.get("hopper"), max_iterations=2)
    >>> result.status is mjslq.Status.MAX_ITERATIONS
    True
    >>> print(result.status.message)
    The iterations ran out before the tolerance was met. Raise max_iterations, ...
    """

    CONVERGED = "converged"
    MAX_ITERATIONS = "max_iterations"
    STEP_TOO_SMALL = "step_too_small"
    DIVERGED = "diverged"
    OUT_OF_TIME = "out_of_time"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    STOPPED = "stopped"
    INFEASIBLE = "infeasible"
    AT_LIMITS = "at_limits"
    NO_CONTACT_GRADIENT = "no_contact_gradient"
    AT_KINK = "at_kink"

    @property
    def message(self) -> str:
        """One sentence on what happened and what can be tried."""
        return _MESSAGES[self]


_MESSAGES = {
    Status.CONVERGED: "A stationary point was found to the tolerance asked for.",
    Status.MAX_ITERATIONS: (
        "The iterations ran out before the tolerance was met. Raise max_iterations, start nearer (guess=), "
        "weigh the controls more, or ask for less (tol)."
    ),
    Status.STEP_TOO_SMALL: (
        "No step along the search direction lowers the cost, although the gradient is not zero. Check the "
        "derivatives (check_derivatives=True), smooth the contacts, or accept this point if its gradient is small."
    ),
    Status.DIVERGED: (
        "There is no finite cost or derivative to go on from. Start from controls that keep the system bounded "
        "(guess=), shorten the timestep, or check the cost."
    ),
    Status.OUT_OF_TIME: "The deadline came before the tolerance was met; this is the best iterate so far.",
    Status.FAILED: "An error ended the solve; this is the best iterate so far.",
    Status.INTERRUPTED: "Interrupted; this is the best iterate so far.",
    Status.INFEASIBLE: (
        "The constraints cannot be met from here: this is a stationary point of their violation, beside which there "
        "may be others. Start elsewhere (guess=), lengthen the horizon, or relax the constraint."
    ),
    Status.AT_LIMITS: (
        "No step along the search direction lowers the cost, and nearly all controls are at their limits. Widen the "
        "limits, give the motion more time (horizon), or ask for less of it."
    ),
    Status.NO_CONTACT_GRADIENT: (
        "The gradient is zero because nothing that the controls move touches what the cost is about, not because there "
        "is nothing to gain. Start from controls that touch it (guess=), or give the engine foresight "
        "(MujocoDynamics.from_path(..., foresight=0.1))."
    ),
    Status.AT_KINK: (
        "Stationary at a kink: the cost has other slopes on other sides of this point, and no direction descends along "
        "all of those that were found. As far as they tell this is a minimum; to look further, smooth the contacts or "
        "perturb the controls."
    ),
    Status.STOPPED: "A callback, or the Stop button of a viewer, asked to stop; this is the best iterate so far.",
}
