"""What engines take and give beside trajectories: Jacobians, second derivatives, feedback laws, places of outputs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np

from mjslq.validation import Array

Sides = np.ndarray[Any, np.dtype[np.int8]]
"""Where controls are: `mjslq.lq.adjoint.FREE`, LOWER, UPPER or FIXED. Shape (N, nu)."""
OfFrame = Literal["position", "orientation", "linear-velocity", "angular-velocity"]
"""What can be read of a frame."""
QUANTITIES: tuple[OfFrame, ...] = ("position", "orientation", "linear-velocity", "angular-velocity")
SLICE = 16
"""Steps at least whose Jacobians are made at a time where memory has to stay small."""


def frame_sensor(frame: str, of: str) -> str:
    """Name of the sensor that is added to a model to read a frame."""
    return f"{frame}.{of}"


class Linearization(NamedTuple):
    """Jacobians of the step and of the outputs along a trajectory, in tangent directions.

    Examples
    --------
    >>> system = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0]]), nx=2, nu=1, dt=0.1)
    >>> A, B, C, D = system.linearize(system.rollout([0.0, 1.0], np.zeros((10, 1))))
    >>> A[0].round(6).tolist()
    [[1.0, 0.1], [0.0, 1.0]]
    """

    A: Array
    """d x_{n+1} / d x_n. Shape (N, ndx, ndx)."""
    B: Array
    """d x_{n+1} / d u_n. Shape (N, ndx, nu)."""
    C: Array
    """d y_n / d x_n. Shape (N + 1, ny, ndx)."""
    D: Array
    """d y_n / d u_n; zero at the last knot. Shape (N + 1, ny, nu)."""


class Curvature(NamedTuple):
    """Second derivatives of steps and outputs, contracted with costates, in tangent directions."""

    xx: Array
    """Shape (N + 1, ndx, ndx); the last knot has outputs only."""
    ux: Array
    """Shape (N, nu, ndx)."""
    uu: Array
    """Shape (N, nu, nu)."""


class Feedback(NamedTuple):
    """The law u_n = clip(U_n - K_n difference(X_n, x_n), lower_n, upper_n), for given U_n."""

    X: Array
    """Reference states. Shape (N + 1, nx)."""
    K: Array
    """Gains. Shape (N, nu, ndx)."""
    lower: Array
    """Smallest controls; -inf where there is no limit. Shape (N, nu)."""
    upper: Array
    """Largest controls; inf where there is no limit. Shape (N, nu)."""

    @classmethod
    def unlimited(cls, X: Array, K: Array) -> Feedback:
        """The law without limits."""
        lower = np.full(K.shape[:2], -np.inf)
        return cls(X, K, lower, -lower)

    def contiguous(self) -> Feedback:
        """The same with arrays as compiled code wants them; those that are so already are not copied."""
        return Feedback(*(np.ascontiguousarray(array, dtype=np.float64) for array in self))


class Adjoint(NamedTuple):
    """Derivatives of a cost along a trajectory, under feedback u_n = v_n - K_n dx_n where there is one."""

    costates: Array
    """By the states. Shape (N + 1, ndx)."""
    gradient: Array
    """By the feedforward v. Shape (N, nu)."""
    held: np.ndarray[Any, np.dtype[np.bool_]]
    """Controls at a limit that descent would push beyond it. Shape (N, nu)."""


class Output(NamedTuple):
    """Where a named output stands in y."""

    columns: slice
    """Its entries."""
    quaternion: bool = False
    """Whether they are a unit quaternion."""


def curvature_of(H: Array, ndx: int) -> Curvature:
    """Blocks of the Hessians by (x, u) at every knot. Shape (N + 1, ndx + nu, ndx + nu)."""
    blocks = H[:, :ndx, :ndx], H[:-1, ndx:, :ndx], H[:-1, ndx:, ndx:]
    return Curvature(*(np.ascontiguousarray(block) for block in blocks))


def slices(N: int, ndx: int) -> Iterator[tuple[int, int]]:
    """Steps (first, last) that follow each other backward, so many that their Jacobians take as much room as states."""
    size, last = max(SLICE, N // max(ndx, 1)), N
    while last > 0:
        first = max(0, last - size)
        yield first, last
        last = first


def feedback_arguments(
    N: int, nu: int, ndx: int, K: Array | None, sides: Sides | None
) -> tuple[Array, Sides, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Gains and sides as compiled code takes them, without rows where there are none, and room for what is held."""
    gains = np.empty((0, nu, ndx)) if K is None else np.ascontiguousarray(K)
    return gains, np.empty((0, nu), np.int8) if sides is None else sides, np.zeros((N, nu), np.bool_)
