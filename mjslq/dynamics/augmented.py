"""`Augmented`: a system whose duration and parameters are unknowns, as constant states that the first control sets.

Notation
--------
    p                    values: the final time T first, if it is free, then parameters. Shape (np,)
    f_n(x, u; p)         step n of the engine, whose length is T / T_0 times its own, T_0 the engine's own duration
    z_n = (x_n, p_n)     states. Shape (nx + np,)
    v_n = (u_n, w_n)     controls. Shape (nu + np,)

    z_1     = (f_0(x_0, u_0; w_0), w_0)
    z_{n+1} = (f_n(x_n, u_n; p_n), p_n),   n = 1 ... N-1

The first step's w_0 are the values, so that limits of the values are limits of controls, which every method keeps to
exactly; all other w_n have no effect, and p_0 has none.

    A_n = ( f_x  f_p )    B_n = ( f_u  0 )    n >= 1        A_0 = ( f_x  0 )    B_0 = ( f_u  f_p )
          (  0    I  )          (  0   0 )                        (  0   0 )          (  0    I  )

In a rollout under feedback the values are known before it begins: w_0 depends on x_0 alone, and what the law says of
p_n - p_ref goes into the controls. So every rollout and linearization is the engine's own, at these values.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from mjslq.dynamics.dynamics import Curvature, Dynamics, Feedback, Linearization
from mjslq.dynamics.variation import SHARE, Variation, derivative, places, size_of
from mjslq.manifold import StateSpace
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import Array


class Augmented(Dynamics):
    """See the head of this file; made by a `Problem` with free time or parameters."""

    def __init__(
        self, inner: Dynamics, N: int, names: tuple[str, ...], lower: Array, upper: Array, timed: bool
    ) -> None:
        self.inner, self.names, self.timed = inner, names, timed
        """The engine, the names of the values, and whether the first of them is the final time."""
        self.varied: Variation = inner.variation(names[timed:])
        steps = inner.steps(N)
        self.duration = float(steps.sum())
        """T_0. [s]"""
        self.nominal = np.concatenate([[self.duration], self.varied.nominal]) if timed else self.varied.nominal
        """The values of the engine as it was given."""
        self._N, self._lower, self._upper = N, lower, upper
        size = len(names)
        self.nx, self.ndx, self.nu = inner.nx + size, inner.ndx + size, inner.nu + size
        self.nv, self.ny, self.dt = inner.nv, inner.ny, inner.dt
        space, entries = inner.space, np.arange(size)
        self.space = StateSpace(
            self.nx, self.ndx, np.append(space.plain_x, inner.nx + entries),
            np.append(space.plain_dx, inner.ndx + entries), space.parts,
        )  # fmt: skip
        self.state_names = (*inner.state_names, *names)
        self.control_names = (*inner.control_names, *names)
        self.output_names, self.contact, self.foresight = inner.output_names, inner.contact, inner.foresight
        free = np.tile([-np.inf, np.inf], (size, 1))
        self.control_limits = np.vstack([inner.control_limits, free])
        self._lock = threading.Lock()

    def at(self, values: Array) -> Dynamics:
        """The engine with these values (np,): not to be kept, the next call sets others."""
        stretch = float(values[0]) / self.duration if self.timed else 1.0
        return self.varied.at(stretch, np.asarray(values[self.timed :], dtype=np.float64))

    def stripped(self, trajectory: Trajectory) -> Trajectory:
        """States, controls and outputs of the engine."""
        return Trajectory.unchecked(
            trajectory.X[:, : self.inner.nx], trajectory.U[:, : self.inner.nu], trajectory.Y, np.asarray(trajectory.dt),
            trajectory.diverged_at, trajectory.substates,
        )  # fmt: skip

    def state(self, x: Array) -> Array:
        """A state of the engine (nx,) as the first one of this system. Shape (nx + np,)."""
        return np.concatenate([x, self.nominal])

    def extended(self, trajectory: Trajectory, values: Array, W: Array | None = None) -> Trajectory:
        """A trajectory of the engine under values (np,), as one of this system; W (N, np) are the w_n."""
        N = trajectory.horizon
        W = np.zeros((N, len(values))) if W is None else np.array(W)
        P = np.tile(values, (N + 1, 1))
        W[0], P[0] = values, self.nominal
        if trajectory.diverged_at is not None:
            P[trajectory.diverged_at :] = np.nan
        return Trajectory.unchecked(
            np.hstack([trajectory.X, P]), np.hstack([trajectory.U, W]), trajectory.Y, np.asarray(trajectory.dt),
            trajectory.diverged_at, trajectory.substates,
        )  # fmt: skip

    def rollouts(self, x0s: Array, U: Array, feedback: Feedback | None = None) -> list[Trajectory]:
        """Simulate several times, each with its own values; see `Dynamics.rollouts`."""
        nx, nu, ndx = self.inner.nx, self.inner.nu, self.inner.ndx
        values, controls, law = U[:, 0, nu:].copy(), U[:, :, :nu].copy(), None
        if feedback is not None:
            X, K, lower, upper = feedback
            first = self.difference(X[0], x0s)
            values = np.clip(values - first @ K[0, nu:].T, lower[0, nu:], upper[0, nu:])
            controls[:, 1:] -= np.einsum("nij,mj->mni", K[1:, :nu, ndx:], values - X[1, nx:])
            law = Feedback(X[:, :nx], K[:, :nu, :ndx], lower[:, :nu], upper[:, :nu]).contiguous()
        found: list[Trajectory] = []
        with self._lock:
            if (values == values[0]).all():
                found = self.at(values[0]).rollouts(x0s[:, :nx], controls, law)
            else:
                for x0, p, u in zip(x0s, values, controls, strict=True):
                    found += self.at(p).rollouts(x0[None, :nx], u[None], law)
        return [self.extended(t, p, W) for t, p, W in zip(found, values, U[:, :, nu:], strict=True)]

    def step(self, x: Array, u: Array, n: int = 0) -> tuple[Array, Array]:
        """One step; see `Dynamics.step`."""
        values = u[self.inner.nu :] if n == 0 else x[self.inner.nx :]
        with self._lock:
            forward, y = self.at(values).step(x[: self.inner.nx], u[: self.inner.nu], n)
        return np.concatenate([forward, values]), y

    def linearize(self, trajectory: Trajectory) -> Linearization:
        """Jacobians of every step, and of the outputs."""
        self.check_trajectory(trajectory)
        return self._linearized(trajectory, trajectory.X[1:], along=True)

    def linearize_slice(self, trajectory: Trajectory, first: int, last: int) -> Linearization:
        """Jacobians of some steps: those of all, of which the rest is left out."""
        A, B, C, D = self.linearize(trajectory)
        knots, steps = slice(first, last + 1), slice(first, last)
        return Linearization(A[steps], B[steps], C[knots], D[knots])

    def linearize_steps(self, X: Array, U: Array, F: Array) -> Linearization:
        """Jacobians of steps that need not follow each other; see `Dynamics`."""
        N = len(U)
        trajectory = Trajectory.unchecked(X, U, np.zeros((len(X), 0)), np.asarray(self.inner.steps(N)))
        return self._linearized(trajectory, F, along=False)

    def hessian(
        self,
        trajectory: Trajectory,
        costates: Array,
        weights: Array | None = None,
        linearization: Linearization | None = None,
        ends: Array | None = None,
    ) -> Curvature:
        """The engine's own second derivatives, those by the values by differences; see `Dynamics.hessian`."""
        from mjslq.dynamics.augmented_curvature import augmented_hessian

        with self._lock:
            return augmented_hessian(self, trajectory, costates, weights, ends)

    @property
    def curvature_price(self) -> float:
        """See `Dynamics.curvature_price`."""
        return self.inner.curvature_price + 2.0 * len(self.names)

    @property
    def threads(self) -> int:
        """Those of the engine."""
        return self.inner.threads

    def foreseeing(self, foresight: float) -> Dynamics:
        """See `Dynamics.foreseeing`."""
        inner = self.inner.foreseeing(foresight)
        return Augmented(inner, self._N, self.names, self._lower, self._upper, self.timed)

    def fully_solved(self) -> Dynamics | None:
        """See `Dynamics.fully_solved`."""
        inner = self.inner.fully_solved()
        if inner is None or len(self.names) > self.timed:  # its parameters are the model's, not this problem's
            return None
        return Augmented(inner, self._N, self.names, self._lower, self._upper, self.timed)

    def scene(self) -> Scene | None:
        """What the engine draws."""
        return self.inner.scene()

    def scene_at(self, values: Array) -> Scene | None:
        """What the engine draws under these values (np,)."""
        with self._lock:
            return self.at(values).scene()

    def support_report(self) -> list[tuple[str, str]]:
        """What the engine says, and how derivatives by the values are taken."""
        parts = self.inner.support_report()
        return [*parts, *((name, "an unknown, a constant state") for name in self.names)]

    def faults(self) -> list[str]:
        """Those of the engine."""
        return self.inner.faults()

    def values_at(self, X: Array, U: Array) -> Array:
        """The values that each knot is under. Shape (N + 1, np)."""
        P = np.array(X[:, self.inner.nx :])
        P[0] = U[0, self.inner.nu :]
        return P

    def sensitivities(self, values: Array, X: Array, U: Array, ends: Array) -> tuple[Array, Array]:
        """Derivatives of steps from x_n to `ends` (N, nx), and of outputs, by the values: of the engine's X and U.

        Shapes (N, ndx, np), (N + 1, ny, np).
        """
        size, N = len(values), len(U)
        S, G = np.zeros((N, self.inner.ndx, size)), np.zeros((N + 1, self.inner.ny, size))
        for j in range(size):
            exact = self.at(values).by_stretch(X, U, ends) if self.timed and j == 0 else None
            if exact is not None:
                S[:, :, 0], G[:, :, 0] = exact[0] / values[0], exact[1] / values[0]
                continue
            place = places(values[j], SHARE * self.scale(values, j), *self.limits(j))
            S[:, :, j], G[:, :, j] = derivative(self._beside(values, j, X, U, ends), place)
        return S, G

    def scale(self, values: Array, j: int) -> float:
        """What differences by a value are relative to."""
        return size_of(float(values[j]), float(self._lower[j]), float(self._upper[j]))

    def limits(self, j: int) -> tuple[float, float]:
        """Within which differences by a value are taken: any time above zero will do."""
        return (0.0, np.inf) if self.timed and j == 0 else (float(self._lower[j]), float(self._upper[j]))

    def _beside(self, values: Array, j: int, X: Array, U: Array, ends: Array) -> Callable[[float], tuple[Array, Array]]:
        """Steps and outputs at values moved along entry j, steps as directions from `ends`."""

        def moved(offset: float) -> tuple[Array, Array]:
            p = values.copy()
            p[j] += offset
            F, Y = self.at(p).step_each(X, U)
            return self.inner.difference(ends, F), Y

        return moved

    def _linearized(self, trajectory: Trajectory, ends: Array, along: bool) -> Linearization:
        """Jacobians at every knot, under values that may differ from knot to knot."""
        X, U, inner = trajectory.X, trajectory.U, self.inner
        P, N, size = self.values_at(X, U), len(U), len(self.names)
        A, B = np.zeros((N, self.ndx, self.ndx)), np.zeros((N, self.ndx, self.nu))
        C, D = np.zeros((N + 1, self.ny, self.ndx)), np.zeros((N + 1, self.ny, self.nu))
        plain, ends = self.stripped(trajectory), np.ascontiguousarray(ends[:, : inner.nx])
        x, u = np.ascontiguousarray(plain.X), np.ascontiguousarray(plain.U)
        for p in np.unique(P, axis=0):
            at = (p == P).all(axis=1)
            with self._lock:
                engine = self.at(p)
                found = engine.linearize(_contiguous(plain)) if along else engine.linearize_steps(x, u, ends)
                S, G = self.sensitivities(p, x, u, ends)
            steps = at[:-1]
            A[steps, : inner.ndx, : inner.ndx], B[steps, : inner.ndx, : inner.nu] = found.A[steps], found.B[steps]
            C[at, :, : inner.ndx], D[at, :, : inner.nu] = found.C[at], found.D[at]
            A[steps, : inner.ndx, inner.ndx :], C[at, :, inner.ndx :] = S[steps], G[at]
        values = np.arange(size)
        A[1:, inner.ndx + values, inner.ndx + values] = 1.0
        B[0, :, inner.nu :], D[0, :, inner.nu :] = A[0, :, inner.ndx :], C[0, :, inner.ndx :]
        B[0, inner.ndx + values, inner.nu + values] = 1.0
        A[0, :, inner.ndx :], C[0, :, inner.ndx :] = 0.0, 0.0
        return Linearization(A, B, C, D)

    def step_each(self, X: ArrayLike, U: ArrayLike) -> tuple[Array, Array]:
        """One step from each knot; see `Dynamics.step_each`."""
        states, controls = np.asarray(X, dtype=np.float64), np.asarray(U, dtype=np.float64)
        P, N = self.values_at(states, controls), len(controls)
        F, Y = np.empty((N, self.nx)), np.empty((N + 1, self.ny))
        x, u = states[:, : self.inner.nx].copy(), controls[:, : self.inner.nu].copy()
        with self._lock:
            for p in np.unique(P, axis=0):
                at = (p == P).all(axis=1)
                ends, outputs = self.at(p).step_each(x, u)
                F[at[:-1], : self.inner.nx], Y[at] = ends[at[:-1]], outputs[at]
        F[:, self.inner.nx :] = P[:-1]
        return F, Y


def _contiguous(trajectory: Trajectory) -> Trajectory:
    X, U, Y = (np.ascontiguousarray(array) for array in (trajectory.X, trajectory.U, trajectory.Y))
    return Trajectory.unchecked(X, U, Y, np.asarray(trajectory.dt), trajectory.diverged_at, trajectory.substates)
