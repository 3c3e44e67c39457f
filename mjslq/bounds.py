"""`Bounds`: limits that an optimizer keeps to at every step.

    lower_n <= u_n <= upper_n,   n = 0 ... N - 1
    lower_n <= x_n <= upper_n,   n = 0 ... N

Controls of a result never leave them, to the last bit; limits of states are a constraint like others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from mjslq import constraints
from mjslq.bound_constraints import BoundConstraint
from mjslq.dynamics.dynamics import Dynamics
from mjslq.lq.box import Box
from mjslq.validation import Array

STATES = "bounds"
"""What results call the limits of the states."""


@dataclass(frozen=True)
class Bounds:
    """Limits of controls and states.

    Raises ValueError when a problem is made with them, for shapes that do not belong to its controls and for limits
    that leave nothing between them; the message names the control.

    Examples
    --------
    >>> wide = mjslq.Bounds(u=(-5.0, 5.0), x=(None, [np.inf, 0.3]))  # the second state at most 0.3
    >>> free = mjslq.Bounds(u=None)
    """

    u: Literal["model"] | tuple[ArrayLike, ArrayLike] | None = "model"
    """"model" for the engine's own limits (`Dynamics.control_limits`), None for none, or (lower, upper): numbers, one
    a control or one a step and control, -inf and inf where there is no limit. Shape () | (nu,) | (N, nu). A MuJoCo
    model clamps its controls at ctrlrange all the same: beyond it a control has the effect of the limit."""

    x: tuple[ArrayLike | None, ArrayLike | None] | None = None
    """(lower, upper) of the states at all knots: numbers, one an entry or one a knot and entry, -inf and inf where
    there is no limit; None for none. Shape () | (nx,) | (N + 1, nx)."""

    def bind_states(self, dynamics: Dynamics, N: int, taken: Sequence[str]) -> BoundConstraint:
        """The limits of the states over `N` steps of `dynamics`, as a constraint called "bounds".

        Raises ValueError, also where "bounds" is among the names of constraints that are `taken`.
        """
        try:
            lower, upper = (None, None) if self.x is None else self.x
        except (TypeError, ValueError):
            raise ValueError(f"bounds: x must be None or a pair (lower, upper), got {self.x!r}") from None
        if STATES in taken:
            raise ValueError(f"bounds: the constraint of the states is called {STATES!r}; give the other another name")
        try:
            return constraints.State(lower, upper).bind(dynamics, N, STATES)
        except ValueError as error:
            raise ValueError(f"bounds: x: {error}") from None

    def bind(self, dynamics: Dynamics, N: int) -> Box:
        """The limits of the controls over `N` steps of `dynamics`. Raises ValueError, see the class."""
        nu = dynamics.nu
        if isinstance(self.u, str):
            if self.u != "model":
                raise ValueError(f'bounds: u must be "model", None or a pair (lower, upper), got {self.u!r}')
            lower, upper = dynamics.control_limits.T
        elif self.u is None:
            lower, upper = np.full(nu, -np.inf), np.full(nu, np.inf)
        else:
            lower, upper = _pair(self.u, N, nu)
        lower, upper = (np.array(np.broadcast_to(limit, (N, nu)), order="C") for limit in (lower, upper))
        wrong = np.argwhere(~(lower <= upper))
        if wrong.size:
            n, i = wrong[0]
            raise ValueError(
                f"bounds: the lower limit of control {dynamics.control_names[i]!r} must not lie above the upper one, "
                f"got {lower[n, i]:g} and {upper[n, i]:g} at step {n}"
            )
        return Box(lower, upper)


def _pair(given: Any, N: int, nu: int) -> tuple[Array, Array]:
    """(lower, upper) as arrays of numbers that can be spread over (N, nu)."""
    try:
        lower, upper = (np.asarray(limit, dtype=np.float64) for limit in given)
    except (TypeError, ValueError):
        raise ValueError(f'bounds: u must be "model", None or a pair (lower, upper), got {given!r}') from None
    for name, limit in (("lower", lower), ("upper", upper)):
        if limit.shape not in ((), (nu,), (N, nu)):
            raise ValueError(
                f"bounds: the {name} limit of the controls must be a number, one a control ({nu},) or one a step and "
                f"control ({N}, {nu}), got shape {limit.shape}"
            )
        if np.isnan(limit).any():
            raise ValueError(f"bounds: the {name} limit of the controls must not be NaN; write -inf or inf for none")
    return lower, upper
