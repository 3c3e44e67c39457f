"""`Dynamics`: the base class of engines, and the interface that the solvers use.

Notation
--------
    x_{n+1} = f_n(x_n, u_n)                    the discrete step
    y_n     = g_n(x_n, u_n)                    outputs; at n = N read with zero control
    dx_{n+1} = A_n dx_n + B_n du_n             its linearization, in tangent directions
    dy_n     = C_n dx_n + D_n du_n

A state has nx entries and ndx tangent directions (ndx < nx with free or ball joints, whose quaternions
live on a sphere). `integrate` walks from a state along a tangent direction, `difference` is its inverse:
integrate(x, difference(x, y)) = y; both are those of the engine's `StateSpace`.

The grain of the interface is the whole horizon: one call rolls out or linearizes all steps.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mjslq.contact import Contact
from mjslq.dynamics.derivative_check import DerivativeCheck, check_jacobians
from mjslq.dynamics.records import Adjoint as Adjoint
from mjslq.dynamics.records import Curvature as Curvature
from mjslq.dynamics.records import Feedback as Feedback
from mjslq.dynamics.records import Linearization as Linearization
from mjslq.dynamics.records import Output as Output
from mjslq.dynamics.records import Sides as Sides
from mjslq.dynamics.records import curvature_of, feedback_arguments, slices
from mjslq.dynamics.variation import Variation
from mjslq.lq.adjoint import closed_loop_adjoint
from mjslq.manifold import StateSpace
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array

if TYPE_CHECKING:
    from mjslq.scene import Scene


DIFFERENCE = 1e-5
"""Step of the differences of Jacobians that make second derivatives."""


class Dynamics(ABC):
    """A discrete-time system, x_{n+1} = f_n(x_n, u_n); the base class of all engines.

    >>> system = mjslq.problems.get("hopper").dynamics
    >>> isinstance(system, mjslq.Dynamics), system.rollout(np.zeros(4), np.ones((50, 1))).X.shape
    (True, (51, 4))
    """

    space: StateSpace
    """Where the state has plain numbers, and where rotations."""
    nx: int
    """Entries of the state."""
    ndx: int
    """Tangent directions of the state."""
    nv: int
    """Velocities: tangent directions nv to 2 nv, after as many positions'; 0 where the state is something else."""
    nu: int
    """Controls."""
    ny: int
    """Outputs."""
    dt: float | Array
    """Step length, or one per step. Shape (N,). [s]"""
    state_names: tuple[str, ...]
    """A name for each entry of x, for plots and messages."""
    control_limits: Array
    """Lower and upper limit of each control: what the model clamps it to, or the actuator is rated for. Shape (nu, 2).
    -inf and inf where there is none."""
    joint_ranges: Mapping[str, tuple[float, float]] = MappingProxyType({})
    """Ranges that the model gives its joints with one axis, by name; those without one are left out. MuJoCo's are
    springs, and Pinocchio ignores them: a constraint keeps to them. [rad or m]"""
    control_names: tuple[str, ...]
    output_names: tuple[str, ...]
    contact: Contact | None = None
    """How hard bodies touch; None where the engine knows no contacts."""
    foresight: float = 0.0
    """Distance from which on contacts act in derivatives alone; 0 for true derivatives. [m]"""
    parameter_names: tuple[str, ...] = ()
    """Numbers in the system that a problem may make unknown (`Problem.free_parameters`)."""

    def __getstate__(self) -> dict[str, Any]:
        """What pickle and deepcopy carry: all but locks and what is made when first asked for, memory and threads."""
        anew = {name for kind in type(self).__mro__ for name, entry in vars(kind).items() if _is_cached(entry)}
        return {name: value for name, value in vars(self).items() if name not in anew and not _is_lock(value)} | {
            "_locks": tuple(name for name, value in vars(self).items() if _is_lock(value))
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what `__getstate__` gave, and make locks anew."""
        state = dict(state)
        locks = state.pop("_locks", ())
        vars(self).update(state)
        vars(self).update({name: threading.Lock() for name in locks})

    @property
    def outputs(self) -> dict[str, Output]:
        """Outputs by name; "y[0]", "y[1]", ... in `output_names` are the entries of one output "y"."""
        found: dict[str, Output] = {}
        for i, name in enumerate(self.output_names):
            owner = name.split("[", 1)[0]
            start = found[owner].columns.start if owner in found else i
            found[owner] = Output(slice(start, i + 1))
        return found

    def frame_output(self, frame: str, of: str) -> str:
        """Name of the output that reads the quantity `of` (`QUANTITIES`) a `frame`; ValueError where there is none."""
        raise ValueError(f"{type(self).__name__} has no frames; use costs.Sensor or costs.Residual")

    @property
    def places(self) -> frozenset[str]:
        """Names of the outputs that are points in the world [m], whose targets a viewer marks."""
        return frozenset()

    @property
    def initial_control(self) -> Array:
        """Controls that a problem starts from unless told otherwise: those of an engine at rest. Shape (nu,)."""
        return np.zeros(self.nu)

    def rollout(self, x0: ArrayLike, U: ArrayLike) -> Trajectory:
        """Simulate from `x0` (nx,) under the controls `U` (N, nu); raises ValueError when they are not that."""
        return self.rollouts(self.checked_start(x0)[None], self.checked_controls(U)[None])[0]

    @abstractmethod
    def rollouts(self, x0s: Array, U: Array, feedback: Feedback | None = None) -> list[Trajectory]:
        """Simulate m times, from `x0s` (m, nx) with controls `U` (m, N, nu), side by side where the engine has threads.

        Open loop, or each under the same law, `feedback`, with its own U_n. A clipped control is the limit itself, to
        the last bit. For callers inside the package: arguments are not checked, nor normalized, nor copied when m = 1.
        """

    @abstractmethod
    def step(self, x: Array, u: Array, n: int = 0) -> tuple[Array, Array]:
        """Step `n` of the horizon: the next state (nx,), and the outputs (ny,) read at (`x`, `u`).

        The plain, slow way to the same numbers as `rollout`; tests and derivative checks go it.
        """

    def rollout_feedback(
        self, reference: Trajectory, K: Array, k: Array, alpha: float = 1.0, x0: ArrayLike | None = None
    ) -> Trajectory:
        """Simulate under u_n = u_ref,n + alpha k_n - K_n difference(x_ref,n, x_n), with all arguments checked.

        The gains `K` have shape (N, nu, ndx), `k` (N, nu) is multiplied by `alpha`. Starts at the first state of the
        trajectory `reference` unless `x0` is given. Raises ValueError for arrays of other shapes, and for a reference
        that diverged or is of another system.
        """
        self.check_trajectory(reference)
        N = reference.horizon
        K, k = as_array("K", K, (N, self.nu, self.ndx)), as_array("k", k, (N, self.nu))
        start = reference.X[0] if x0 is None else self.checked_start(x0)
        return self.rollouts(start[None], (reference.U + alpha * k)[None], Feedback.unlimited(reference.X, K))[0]

    @property
    def threads(self) -> int:
        """How many of the `rollouts` run side by side."""
        return 1

    def limit_threads(self, number: int) -> None:  # noqa: B027 (engines without threads have nothing to do)
        """Use at most `number` threads from the first rollout on: for processes that run side by side."""

    def foreseeing(self, foresight: float) -> Dynamics:
        """The same system with another `foresight`, for engines that have one."""
        raise ValueError(f"{type(self).__name__} has no contacts to foresee")

    def variation(self, names: tuple[str, ...] = ()) -> Variation:
        """A copy whose step length and parameters `names` can be set, for problems in which they are unknown.

        Raises ValueError for engines without.
        """
        raise ValueError(f"{type(self).__name__} has steps of fixed length and no parameters that could be free")

    def by_stretch(self, X: Array, U: Array, ends: Array) -> tuple[Array, Array] | None:
        """Derivatives of steps and outputs by a factor on all step lengths, at one.

        For steps from `X` (N + 1, nx) under `U` (N, nu) to `ends` (N, nx): shapes (N, ndx) and (N + 1, ny). None where
        the engine has no way of its own; then differences are taken.
        """
        return None

    @abstractmethod
    def linearize(self, trajectory: Trajectory) -> Linearization:
        """Jacobians of every step of `trajectory`, and of its outputs. Raises ValueError where it diverged."""

    def linearize_slice(self, trajectory: Trajectory, first: int, last: int) -> Linearization:
        """Jacobians of the steps `first` to `last` - 1 of `trajectory`, and of the outputs at their knots.

        The outputs at knot `last` are those of the horizon's end. Engines whose steps depend on time have their own.
        """
        between, knots, steps = trajectory.substates, slice(first, last + 1), slice(first, last)
        part = Trajectory.unchecked(
            trajectory.X[knots], trajectory.U[steps], trajectory.Y[knots], np.asarray(trajectory.dt)[steps],
            substates=None if between is None else between[steps],
        )  # fmt: skip
        return self.linearize(part)

    def adjoint(
        self,
        trajectory: Trajectory,
        q: Array,
        r: Array,
        K: Array | None = None,
        y: Array | None = None,
        sides: Sides | None = None,
    ) -> Adjoint:
        """Costates and gradient of a cost along `trajectory` under feedback, without the Jacobians of all steps.

        `q` (N + 1, ndx), `r` (N, nu) and `y` (N + 1, ny) are the gradients of the cost by states, controls and outputs,
        `K` (N, nu, ndx) the gains, `sides` (N, nu) where controls are at limits; see `mjslq.lq.adjoint`. Memory is
        linear in N ndx: Jacobians are made for some steps at a time, from the last to the first.
        """
        N = trajectory.horizon
        costates, gradient = np.array(q), np.array(r)
        K, sides, held = feedback_arguments(N, self.nu, self.ndx, K, sides)
        for first, last in slices(N, self.ndx):
            A, B, C, D = self.linearize_slice(trajectory, first, last)
            steps = slice(first, last)
            if y is not None and self.ny:
                knots = slice(first, last + (last == N))
                costates[knots] += np.einsum("nyi,ny->ni", C[: knots.stop - first], y[knots])
                gradient[steps] += np.einsum("nyi,ny->ni", D[: last - first], y[steps])
            closed_loop_adjoint(
                A, B, K[steps], sides[steps], costates[first : last + 1], gradient[steps], held[steps]
            )  # fmt: skip
        return Adjoint(costates, gradient, held)

    def step_each(self, X: ArrayLike, U: ArrayLike) -> tuple[Array, Array]:
        """One step from each knot, the knots being independent of each other, as a state guess has them.

        Takes states `X` (N + 1, nx) and controls `U` (N, nu); returns the states f_n(x_n, u_n) that follow (N, nx), NaN
        where a step blows up, and the outputs (N + 1, ny).
        """
        states, controls = np.asarray(X, dtype=np.float64), np.asarray(U, dtype=np.float64)
        N = len(controls)
        F, Y = np.empty((N, self.nx)), np.empty((N + 1, self.ny))
        for n in range(N):
            F[n], Y[n] = self.step(states[n], controls[n], n)
        Y[N] = self.step(states[N], np.zeros(self.nu), N - 1)[1]
        return F, Y

    def linearize_steps(self, X: Array, U: Array, F: Array) -> Linearization:
        """Jacobians of steps that need not follow each other: from `X` (N + 1, nx) under `U` (N, nu) to `F` (N, nx).

        For engines whose `linearize` reads of a knot only x_n and u_n; others have a way of their own.
        """
        return self.linearize(Trajectory.unchecked(X, U, np.zeros((len(X), 0)), self.dt))

    @property
    def curvature_price(self) -> float:
        """What `hessian` costs, in linearizations."""
        return 2.0 * (self.ndx + self.nu)

    def hessian(
        self,
        trajectory: Trajectory,
        costates: Array,
        weights: Array | None = None,
        linearization: Linearization | None = None,
        ends: Array | None = None,
    ) -> Curvature:
        """Second derivatives of sum_n lambda_{n+1}'f_n + w_n'y_n along `trajectory`, in tangent directions.

        `costates` (N + 1, ndx) are the lambda_n of `adjoint`, `weights` (N + 1, ny) the w_n, `ends` (N, nx) the
        states at which the steps end where these are not the trajectory's next ones, `linearization` the Jacobians
        where they are at hand. Central differences of
        `linearize` along each tangent direction, all knots at once. Only their symmetric part is kept: on a manifold
        the rest is the turning of the tangent directions, not curvature.
        """
        if linearization is None:
            linearization = self.linearize(trajectory)
        if ends is None:
            ends = trajectory.X[1:]
        inward = self._inward(trajectory.U)
        if inward.any():
            ends = self.integrate(ends, np.einsum("nij,nj->ni", linearization.B, inward))
            trajectory = Trajectory(trajectory.X, trajectory.U + inward, trajectory.Y, trajectory.dt)
        N, ndx, size = trajectory.horizon, self.ndx, self.ndx + self.nu
        H = np.zeros((N + 1, size, size))
        for i in range(size):
            for sign in (1.0, -1.0):
                g = self._gradients_beside(trajectory, linearization, ends, i, sign * DIFFERENCE, costates, weights)
                H[:, i, :] += sign / (2.0 * DIFFERENCE) * g
        return curvature_of(0.5 * (H + H.swapaxes(1, 2)), ndx)

    def _inward(self, U: Array) -> Array:
        """How to move controls that are next to a limit, beyond which an engine may clamp them, to take differences."""
        lower, upper = self.control_limits.T
        wide = upper - lower > 4.0 * DIFFERENCE
        up, down = wide & (lower <= U) & (lower + DIFFERENCE > U), wide & (upper >= U) & (upper - DIFFERENCE < U)
        return DIFFERENCE * (up.astype(np.float64) - down)

    def _gradients_beside(
        self,
        trajectory: Trajectory,
        along: Linearization,
        ends: Array,
        i: int,
        e: float,
        costates: Array,
        weights: Array | None,
    ) -> Array:
        """Gradient of lambda'f + w'y by (x, u) at every knot, moved by `e` along direction `i`. (N + 1, ndx + nu)."""
        X, U, ndx = trajectory.X, np.array(trajectory.U), self.ndx
        if i < ndx:
            direction, move = along.A[:, :, i], np.zeros((len(X), ndx))
            move[:, i] = e
            X = self.integrate(X, move)
        else:
            direction = along.B[:, :, i - ndx]
            U[:, i - ndx] += e
        A, B, C, D = self.linearize_steps(X, U, self.integrate(ends, e * direction))
        g = np.zeros((len(X), ndx + self.nu))
        g[:-1, :ndx] = (costates[1:, None, :] @ A)[:, 0]
        g[:-1, ndx:] = (costates[1:, None, :] @ B)[:, 0]
        if weights is not None:
            g[:, :ndx] += (weights[:, None, :] @ C)[:, 0]
            g[:, ndx:] += (weights[:, None, :] @ D)[:, 0]
        return g

    def difference(self, x: Array, y: Array) -> Array:
        """Tangent direction that leads from state `x` to state `y`. Shapes (..., nx) -> (..., ndx)."""
        return self.space.difference(x, y)

    def integrate(self, x: Array, dx: Array) -> Array:
        """State reached from `x` along the tangent direction `dx`. Shapes (..., nx), (..., ndx) -> (..., nx)."""
        return self.space.integrate(x, dx)

    def difference_jacobian(self, x: Array, y: Array) -> Array | None:
        """Derivative of difference(`x`, `y`) by y, in tangent directions of y. Shape (..., ndx, ndx).

        None stands for the identity, which is what plain vectors have.
        """
        return self.space.difference_jacobian(x, y)

    def tangent_basis(self, x: Array) -> Array | None:
        """Derivative of integrate(`x`, dx) by dx at zero. Shape (..., nx, ndx); None stands for the identity."""
        return self.space.tangent_basis(x)

    def scene(self) -> Scene | None:
        """What a viewer needs to draw a trajectory of this system; None when there is nothing to draw."""
        return None

    def check_derivatives(self, trajectory: Trajectory) -> DerivativeCheck:
        """Compare `linearize` with fine differences of `step` at every knot of `trajectory`.

        Kinks, where the two one-sided differences differ and the Jacobian agrees, are told from wrong derivatives.
        """
        return check_jacobians(self, trajectory)

    def fully_solved(self) -> Dynamics | None:
        """Return the same system, its iterative solvers run until they converge.

        None where it has no such solver. `check_derivatives` asks for it where a derivative is off.
        """
        return None

    def faults(self) -> list[str]:
        """What makes the system impossible to simulate, a sentence each; mostly nothing."""
        return []

    def support_report(self) -> list[tuple[str, str]]:
        """What the system consists of, as (part, what serves it)."""
        return [(f"{self.nx} states, {self.nu} controls", type(self).__name__)]

    def steps(self, N: int) -> Array:
        """Step lengths for a horizon of `N`. Shape (N,). [s]  Raises ValueError when dt is of another length."""
        dt = np.asarray(self.dt, dtype=np.float64)
        if dt.ndim and dt.shape != (N,):
            raise ValueError(f"these dynamics have {len(dt)} steps of given length, but the horizon is {N}")
        return np.broadcast_to(dt, (N,))

    def checked_start(self, x0: ArrayLike, name: str = "x0") -> Array:
        """Return `x0` as a state (nx,), quaternions of unit length, or raise ValueError about `name`."""
        return self.space.normalized(as_array(name, x0, (self.nx,)))

    def checked_controls(self, U: ArrayLike) -> Array:
        """Return `U` as controls (N, nu) or raise ValueError."""
        return np.array(as_array("U", U, ("N", self.nu)))  # a copy: trajectories do not alias what they came from

    def check_trajectory(self, trajectory: Trajectory) -> None:
        """Raise ValueError for a `trajectory` that diverged, or of another system."""
        if trajectory.diverged:
            raise ValueError(f"the trajectory diverged at knot {trajectory.diverged_at}; there is nothing to linearize")
        if trajectory.X.shape[1] != self.nx or trajectory.U.shape[1] != self.nu:
            raise ValueError(
                f"the trajectory has {trajectory.X.shape[1]} states and {trajectory.U.shape[1]} controls, "
                f"but these dynamics have {self.nx} and {self.nu}"
            )


def _is_cached(entry: object) -> bool:
    return isinstance(entry, cached_property)


def _is_lock(value: object) -> bool:
    return isinstance(value, type(threading.Lock()))
