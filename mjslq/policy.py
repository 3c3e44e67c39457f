"""`Policy`: time-varying feedback about a trajectory, within limits; it needs neither a solver nor an engine.

    u(x, t) = [ U_n - K_n difference(x_ref(t), x) ]       t_n <= t < t_{n+1};   [.] clips to the limits of step n

x_ref is X_n at the knots and lies on the way from X_n to X_{n+1} between them. Before the first knot the policy is that
of the first, after the last step that of the last, about the final state.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjslq.manifold import StateSpace
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array, count, frozen, instance, refrozen

NEAR = 1e-9
"""Share of a step within which a time counts as the knot's."""


@dataclass(frozen=True, eq=False)
class Policy:
    """A control law over a horizon; call it with a state and a time.

    Raises ValueError when shapes do not belong together, here and for states and times that are none.

    Examples
    --------
    >>> hold = mjslq.Policy(X=np.zeros((3, 2)), U=np.ones((2, 1)), K=np.full((2, 1, 2), 0.5), dt=0.1, upper=1.2)
    >>> hold([-0.2, 0.0], t=0.05)
    array([1.1])
    >>> hold([-9.0, 0.0], t=0.05)  # within the limits
    array([1.2])
    """

    X: Array
    """Reference states. Shape (N + 1, nx)."""
    U: Array
    """Controls along the reference. Shape (N, nu)."""
    K: Array | None = None
    """Feedback gains; None for none. Shape (N, nu, ndx)."""
    dt: ArrayLike = 1.0
    """Step lengths: a number, or one a step. Shape (N,). [s]"""
    lower: Array | None = None
    """Limits of the controls; None for none. Shape (N, nu) | (nu,)."""
    upper: Array | None = None
    """See `lower`."""
    space: StateSpace | None = None
    """Where the state's quaternions are; a plain vector unless given."""

    def __post_init__(self) -> None:
        X, U = as_array("X", self.X, ("N + 1", "nx")), as_array("U", self.U)
        N = len(X) - 1
        if N < 1:
            raise ValueError(f"X must have at least two knots, so that there is a step, got {len(X)}")
        U = as_array("U", U, (N, "nu"))
        space = StateSpace.plain(X.shape[1]) if self.space is None else self.space
        if instance("space", space, StateSpace, "the state space of an engine").nx != X.shape[1]:
            raise ValueError(f"space has states of {space.nx} entries, but X those of {X.shape[1]}")
        dt = as_array("dt", self.dt)
        if dt.shape not in ((), (N,)):
            raise ValueError(f"dt must be a number or one per step ({N},), got shape {dt.shape}")
        if (dt <= 0.0).any():
            raise ValueError(f"dt must be positive, got {dt.min()}")
        filled = {"X": X, "U": U, "dt": np.array(np.broadcast_to(dt, (N,)))}
        if self.K is not None:
            filled["K"] = as_array("K", self.K, (N, U.shape[1], space.ndx))
        for name, end in (("lower", -np.inf), ("upper", np.inf)):
            limit = getattr(self, name)
            limit = np.array(end) if limit is None else as_array(name, limit, finite=False)
            if limit.shape not in ((), U.shape[1:], U.shape):
                raise ValueError(
                    f"{name} must be a number, one a control {U.shape[1:]} or one a step and control {U.shape}, "
                    f"got shape {limit.shape}"
                )
            filled[name] = np.array(np.broadcast_to(limit, U.shape))
        if not (filled["lower"] <= filled["upper"]).all():
            raise ValueError("lower must not lie above upper, and neither may be NaN")
        for name, array in filled.items():
            object.__setattr__(self, name, frozen(array))
        object.__setattr__(self, "space", space)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(refrozen(state))

    @property
    def horizon(self) -> int:
        """Number of steps N."""
        return len(self.U)

    @property
    def times(self) -> Array:
        """Time of each knot. Shape (N + 1,). [s]"""
        return np.concatenate([[0.0], np.cumsum(self.dt)])

    def __call__(self, x: ArrayLike, t: float) -> Array:
        """Control in state `x` (nx,) at time `t` [s] since the start. Shape (nu,)."""
        assert self.space is not None and self.lower is not None and self.upper is not None  # filled in when made
        x = as_array("x", x, (self.space.nx,))
        time = float(as_array("t", t, (), finite=False))
        if np.isnan(time):
            raise ValueError("t must be a time, got nan")
        n, share = self._place(time)
        u: Array = self.U[n]
        if self.K is not None:
            x_ref = self.X[n]
            if share > 0.0:
                x_ref = self.space.integrate(x_ref, share * self.space.difference(x_ref, self.X[n + 1]))
            u = u - self.K[n] @ self.space.difference(x_ref, x)
        return np.minimum(np.maximum(u, self.lower[n]), self.upper[n])

    def shifted(self, steps: int) -> Policy:
        """The policy from step `steps` on; the last step is repeated, so that the horizon stays."""
        n = min(count("steps", steps, at_least=0), self.horizon)
        at = np.minimum(np.arange(self.horizon) + n, self.horizon - 1)
        states = np.minimum(np.arange(self.horizon + 1) + n, self.horizon)
        assert self.lower is not None and self.upper is not None
        return Policy(
            self.X[states], self.U[at], None if self.K is None else self.K[at], np.asarray(self.dt)[at],
            self.lower[at], self.upper[at], self.space,
        )  # fmt: skip

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the policy to `path`, whole or not at all, as plain arrays that NumPy alone can read.

        `numpy.load(path)` has "X", "U", "K" (zeros where there is no feedback), "dt", "lower" and "upper", with the
        shapes above. Raises ValueError when the file cannot be written.
        """
        from mjslq.policy_file import save_policy

        save_policy(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Policy:
        """Read the file `path` that `save` wrote.

        Raises FileNotFoundError when there is no such file, ValueError when it is something else than a policy.
        """
        from mjslq.policy_file import load_policy

        return load_policy(path)

    @classmethod
    def along(cls, trajectory: Trajectory, space: StateSpace | None = None) -> Policy:
        """The controls of a `trajectory` as a policy without feedback, for states of a `space` (plain unless given)."""
        instance("trajectory", trajectory, Trajectory, "a Trajectory")
        return cls(trajectory.X, trajectory.U, None, trajectory.dt, space=space)

    def _place(self, t: float) -> tuple[int, float]:
        """The step at time t, and how far into it t is, from 0 to 1."""
        times, last = self.times, self.horizon - 1
        n = int(np.clip(np.searchsorted(times, t, side="right") - 1, 0, last))
        share = float(np.clip((t - times[n]) / (times[n + 1] - times[n]), 0.0, 1.0))
        if share > 1.0 - NEAR and n < last:
            return n + 1, 0.0
        return n, 0.0 if share < NEAR else share
