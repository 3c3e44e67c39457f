"""`Trajectory`: states, controls and outputs over a horizon, with their step lengths.

Notation
--------
    x_n   state at knot n,  n = 0 ... N        X  Shape (N + 1, nx)
    u_n   control over step n, n = 0 ... N-1   U  Shape (N, nu)
    y_n   output (sensor readings) at knot n   Y  Shape (N + 1, ny)
    h_n   length of step n [s]                 dt Shape (N,)
    k     simulator steps in step n, through which u_n is held; the states between knots have a field of their own
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjslq.validation import Array, as_array, count, frozen, refrozen


@dataclass(frozen=True)
class Trajectory:
    """States, controls and outputs over a horizon of N steps.

    A rollout that blows up is a trajectory too: `diverged_at` names its first bad knot, and the entries from
    there on are NaN. Such a trajectory can be looked at, but costs infinity.

    Raises ValueError when shapes do not belong together or a knot before `diverged_at` is not finite.

    Examples
    --------
    >>> motion = mjslq.Trajectory(X=np.zeros((4, 2)), U=np.zeros((3, 1)), dt=0.5)
    >>> motion.horizon, motion.times.tolist(), motion.diverged
    (3, [0.0, 0.5, 1.0, 1.5], False)
    """

    X: Array
    """States. Shape (N + 1, nx)."""
    U: Array
    """Controls. Shape (N, nu)."""
    Y: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Outputs. Shape (N + 1, ny); ny = 0 when the engine has none."""
    dt: ArrayLike = 1.0
    """Step lengths: a number, or one per step; kept as an array. Shape (N,). [s]"""
    diverged_at: int | None = None
    """First knot at which the rollout was not finite or the engine warned; None when all is well."""
    substates: Array | None = None
    """States between the knots, at the simulator's own steps: entry n has those of step n. Shape (N, k - 1, nx).
    None when steps are single ones, or the states between are not known; then an engine simulates them anew."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(refrozen(state))

    def __post_init__(self) -> None:
        X = as_array("X", self.X, ("N + 1", "nx"), finite=False)
        if not len(X):
            raise ValueError("X must have at least one knot, got none")
        good = self.diverged_at
        if good is not None and count("diverged_at", good, at_least=0) >= len(X):
            raise ValueError(f"diverged_at must be one of the knots 0 to {len(X) - 1}, got {good}")
        U = as_array("U", self.U, (len(X) - 1, "nu"), finite=False)
        Y = np.zeros((len(X), 0)) if np.size(self.Y) == 0 else as_array("Y", self.Y, (len(X), "ny"), finite=False)
        as_array("X", X[:good])
        as_array("U", U)
        as_array("Y", Y[:good])
        dt = as_array("dt", self.dt)
        if dt.ndim and dt.shape != (len(U),):
            raise ValueError(f"dt must be a number or one per step ({len(U)},), got shape {dt.shape}")
        if (dt <= 0.0).any():
            raise ValueError(f"dt must be positive, got {dt.min()}")
        for name, array in (("X", X), ("U", U), ("Y", Y), ("dt", np.broadcast_to(dt, (len(U),)))):
            object.__setattr__(self, name, frozen(array))
        if self.substates is not None:
            between = as_array("substates", self.substates, (len(U), "k - 1", X.shape[1]), finite=False)
            as_array("substates", between[: None if good is None else max(good - 1, 0)])
            object.__setattr__(self, "substates", frozen(between))

    @classmethod
    def unchecked(
        cls,
        X: Array,
        U: Array,
        Y: Array,
        dt: float | Array,
        diverged_at: int | None = None,
        substates: Array | None = None,
    ) -> Trajectory:
        """Make a trajectory of arrays that an engine has just filled: nothing is checked, and nothing copied.

        `X`, `U`, `Y`, `diverged_at` and `substates` are as the fields; `dt` may be a number. Whoever holds one of the
        arrays must not write into it afterwards.
        """
        made = object.__new__(cls)
        fields = {"X": frozen(X), "U": frozen(U), "Y": frozen(Y), "dt": np.broadcast_to(dt, (len(U),))}
        between = None if substates is None else frozen(substates)
        made.__dict__.update(fields, diverged_at=diverged_at, substates=between)
        return made

    @property
    def horizon(self) -> int:
        """Number of steps N."""
        return len(self.U)

    @property
    def times(self) -> Array:
        """Time of each knot. Shape (N + 1,). [s]"""
        return np.concatenate([[0.0], np.cumsum(self.dt)])

    @property
    def diverged(self) -> bool:
        """Whether the rollout blew up."""
        return self.diverged_at is not None
