"""`FunctionDynamics`: a system given as a function, an ordinary differential equation or a map.

Notation
--------
    x' = f(x, u, t, p)                         integrator "euler", "semi-implicit-euler" or "rk4"
    x_{n+1} = f(x_n, u_n, t_n, p)              integrator "map"
    u is constant over a step, t the time [s], p constants that are handed through unchanged

    euler                  x_{n+1} = x_n + h f(x_n, u_n)
    semi-implicit-euler    x = (q, v):  v_{n+1} = v_n + h f_v(q_n, v_n, u_n)
                                        q_{n+1} = q_n + h f_q(q_n, v_{n+1}, u_n)      (as MuJoCo's Euler)
    rk4                    the classical Runge-Kutta step of fourth order

Functions compiled with numba.njit run over the whole horizon without a Python call per step. Complex steps are held
against real differences at every linearization (`mjslq.complex_step`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Self

import numpy as np
from numba.core.dispatcher import Dispatcher
from numpy.typing import ArrayLike

from mjslq.dynamics import function_kernels as kernels
from mjslq.dynamics.dynamics import Adjoint, Curvature, Dynamics, Feedback, Linearization, Sides
from mjslq.dynamics.function_adjoint import adjoint_kernel, check_pullback
from mjslq.dynamics.function_arguments import (
    checked_hessian,
    checked_jacobian,
    limits_of,
    named_parameters,
    names_of,
    plain,
    probe,
    reading,
    takes_time,
    with_all_arguments,
)
from mjslq.dynamics.function_derivatives import Derivatives
from mjslq.dynamics.function_variation import FunctionVariation
from mjslq.dynamics.records import curvature_of, feedback_arguments
from mjslq.manifold import StateSpace
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array, choose, count, function

Integrator = Literal["map", "euler", "semi-implicit-euler", "rk4"]
_INTEGRATORS = {
    "map": kernels.MAP,
    "euler": kernels.EULER,
    "semi-implicit-euler": kernels.SEMI_IMPLICIT_EULER,
    "rk4": kernels.RK4,
}


class FunctionDynamics(Dynamics):
    """Dynamics from f(x, u), f(x, u, t) or f(x, u, t, p).

    Parameters
    ----------
    f : callable
        Returns x' (or the next state, for a map) as an array of shape (nx,). Plain Python, or compiled with
        `numba.njit`, then it must return a new float64 array, complex for complex x and u.
    nx, nu : int
        Number of states and of controls.
    dt : float or array
        Length of a step, or of each. Shape (N,). [s]
    integrator : str
        "map", "euler", "semi-implicit-euler" or "rk4".
    jacobian : str or callable
        "complex-step" (exact; f must be analytic: no abs, no real parts but in comparisons; where real differences
        disagree, they are taken from then on, with a warning), "finite-difference" (centred), or
        jacobian(x, u, t) -> (A, B) of the *discrete step*, shapes (nx, nx) and (nx, nu).
    hessian : callable, optional
        hessian(x, u, t, costate) -> (H_xx (nx, nx), H_ux (nu, nx), H_uu (nu, nu)), the second derivatives of
        costate' x_{n+1}, the *discrete step*; by differences of first derivatives unless given.
    pullback : callable, optional
        pullback(x, u, t, p, w) -> (f_x'w, f_u'w) as one row (nx + nu,), of f itself, not of the step; compiled, for
        compiled f. With it `adjoint`, and the methods that live on it, make no Jacobians.
    outputs : callable, optional
        y = outputs(x, u), outputs(x, u, t) or outputs(x, u, t, p), shape (ny,), recorded along rollouts; differentiated
        as `jacobian` says. Plain Python, or compiled with `numba.njit`.
    control_limits : tuple or array, optional
        (lower, upper), each a number or an array (nu,), or both as an array (nu, 2); -inf and inf where there is none.
        What an optimizer keeps to; f itself is called with whatever controls a rollout is given.
    parameters : mapping or array
        p, for constants that change between problems, which a compiled f need not be compiled again for, or that a
        problem may make unknown (`Problem.free_parameters`): numbers by name, p an array of them in this order; or an
        array, whose entries are called p[0], p[1], ...
    nv : int, optional
        Velocities among the states, the last ones, for "semi-implicit-euler"; nx // 2 unless given.
    state_names, control_names, output_names : sequence of str
        For plots and messages.
    scene : Scene, optional
        What a viewer draws.

    Raises
    ------
    ValueError
        When f does not return shape (nx,) at the origin, or an argument is out of place.

    Examples
    --------
    >>> def pendulum(x, u):
    ...     return np.array([x[1], u[0] - 9.81 * np.sin(x[0])])
    >>> dynamics = mjslq.FunctionDynamics(pendulum, nx=2, nu=1, dt=0.02, state_names=("angle", "speed"))
    >>> dynamics.rollout([0.1, 0.0], np.zeros((50, 1))).X.shape
    (51, 2)
    """

    def __init__(
        self,
        f: Callable[..., Any],
        nx: int,
        nu: int,
        dt: float | ArrayLike,
        *,
        integrator: Integrator = "rk4",
        jacobian: Literal["complex-step", "finite-difference"] | Callable[..., Any] = "complex-step",
        hessian: Callable[..., Any] | None = None,
        pullback: Callable[..., Any] | None = None,
        outputs: Callable[..., Any] | None = None,
        control_limits: tuple[ArrayLike, ArrayLike] | ArrayLike | None = None,
        parameters: Mapping[str, float] | ArrayLike = (),
        nv: int | None = None,
        state_names: Sequence[str] | None = None,
        control_names: Sequence[str] | None = None,
        output_names: Sequence[str] | None = None,
        scene: Scene | None = None,
    ) -> None:
        self.nx = self.ndx = count("nx", nx)
        self.space = StateSpace.plain(self.nx)
        self.nu = count("nu", nu)
        steps = as_array("dt", dt)
        if steps.ndim > 1 or (steps <= 0.0).any():
            raise ValueError(f"dt must be a positive number, or one per step, got shape {steps.shape}: {dt!r}")
        self.dt = np.array(steps) if steps.ndim else float(steps)
        self.integrator = choose("integrator", integrator, _INTEGRATORS)
        self.control_limits = limits_of(control_limits, self.nu)
        if not isinstance(self.dt, float):
            self._starts = np.cumsum(self.dt) - self.dt
        self.parameters, self.parameter_names = named_parameters(parameters)
        self._nv = self.nx // 2 if nv is None else count("nv", nv)
        self.nv = self._nv if 2 * self._nv == self.nx else 0
        if self._nv > self.nx:
            raise ValueError(f"nv must be at most nx = {self.nx}, got {nv}")
        if callable(jacobian):
            self._given_jacobian: Callable[..., Any] | None = jacobian
        else:
            self._given_jacobian = None
            choose("jacobian", jacobian, ("complex-step", "finite-difference"))
        self._given_hessian = None if hessian is None else function("hessian", hessian)
        self.compiled = isinstance(f, Dispatcher)
        self._f, self.functions = with_all_arguments(f, self.compiled, size=self.nx), (f, outputs)
        self._scene = scene
        probe(self._f, self.nx, self.nu, self.parameters)
        self._pullback = pullback
        if pullback is not None:
            check_pullback(pullback, self.compiled, self.nx, self.nu, self.parameters)
        self._read, self._reads_compiled, self.ny = reading(outputs, self.nx, self.nu, self.parameters)
        by_differences, step = jacobian == "finite-difference", float(np.ravel(self.dt)[0])
        self._steps, self._readings = self._derivatives(by_differences, by_differences)
        if self._given_jacobian is None:
            self._steps.try_out(self.nx, self.nu, self.nx, step)
        self._readings.try_out(self.nx, self.nu, self.ny, step)
        self.state_names = names_of("state_names", state_names, "x", self.nx)
        self.control_names = names_of("control_names", control_names, "u", self.nu)
        self.output_names = names_of("output_names", output_names, "y", self.ny)

    def __getstate__(self) -> dict[str, Any]:
        """See `Dynamics`; the functions travel as they were given, which is why pickle has to be able to import them.

        Those that were compiled travel whole.
        """
        state = super().__getstate__()
        for name in ("_f", "_read", "_steps", "_readings"):
            del state[name]
        return state | {"_by_differences": (self._steps.by_differences, self._readings.by_differences)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """See `Dynamics`."""
        by_differences = state["_by_differences"]
        super().__setstate__({name: value for name, value in state.items() if name != "_by_differences"})
        f, outputs = self.functions
        self._f = with_all_arguments(f, self.compiled, size=self.nx)
        self._read, self._reads_compiled, self.ny = reading(outputs, self.nx, self.nu, self.parameters)
        self._steps, self._readings = self._derivatives(*by_differences)

    def step(self, x: Array, u: Array, n: int = 0) -> tuple[Array, Array]:
        """One step in plain Python; see `Dynamics.step`."""
        if isinstance(self.dt, float):
            t, h = n * self.dt, self.dt
        else:
            t, h = float(self._starts[n]), float(self.dt[n])
        forward = kernels.next_state(plain(self._f), self._code, self._nv, x, u, t, h, self.parameters)
        y = plain(self._read)(x, u, t, self.parameters) if self.ny else np.zeros(0)
        return as_array("next state", forward, finite=False), y

    def rollouts(self, x0s: Array, U: Array, feedback: Feedback | None = None) -> list[Trajectory]:
        """Simulate several times, one after the other; see `Dynamics.rollouts`."""
        (m, N, nu), roll, found = U.shape, self._kernel(kernels.rollout), []
        arguments, nothing = self._arguments(N), np.empty((0, nu))
        none = Feedback(np.empty((0, self.nx)), np.empty((0, nu, self.nx)), nothing, nothing)
        law = none if feedback is None else feedback.contiguous()
        for x0, given in zip(x0s, U, strict=True):
            X = np.empty((N + 1, self.nx))
            X[0] = x0
            controls = np.ascontiguousarray(given) if m == 1 else given.copy()
            applied = nothing if feedback is None else np.empty((N, nu))
            with np.errstate(all="ignore"):
                bad = roll(*arguments, controls, *law, applied, X)
            found.append(self._trajectory(X, controls if feedback is None else applied, bad))
        return found

    def linearize(self, trajectory: Trajectory) -> Linearization:
        """Jacobians of every step of `trajectory`, and of the outputs."""
        return self.linearize_slice(trajectory, 0, trajectory.horizon)

    def linearize_slice(self, trajectory: Trajectory, first: int, last: int) -> Linearization:
        """Jacobians of some steps; see `Dynamics.linearize_slice`."""
        self.check_trajectory(trajectory)
        X, U, N = trajectory.X[first : last + 1], trajectory.U[first:last], last - first
        times, steps = (part[first:last] for part in self._time_grid(trajectory.horizon))
        A, B = np.empty((N, self.nx, self.nx)), np.empty((N, self.nx, self.nu))
        if self._given_jacobian is not None:
            for n, t in enumerate(times):
                A[n], B[n] = checked_jacobian(self._given_jacobian(X[n], U[n], t), self.nx, self.nu)
        else:
            self._steps.jacobians(times, steps, X, U, A, B)
        return Linearization(A, B, *self._linearize_outputs(X, U, np.append(times, times[-1] + steps[-1])))

    def adjoint(
        self,
        trajectory: Trajectory,
        q: Array,
        r: Array,
        K: Array | None = None,
        y: Array | None = None,
        sides: Sides | None = None,
    ) -> Adjoint:
        """Costates and gradient under feedback, by the pullback where there is one; see `Dynamics.adjoint`."""
        if self._pullback is None or (self.ny and y is not None and y.any()):
            return super().adjoint(trajectory, q, r, K, y, sides)
        self.check_trajectory(trajectory)
        N, costates, gradient = trajectory.horizon, np.array(q), np.array(r)
        K, sides, held = feedback_arguments(N, self.nu, self.nx, K, sides)
        f, *rest = self._arguments(N)
        X, U = trajectory.X, trajectory.U
        adjoint_kernel()(f, self._pullback, *rest, X, U, K, sides, costates, gradient, held)
        return Adjoint(costates, gradient, held)

    def variation(self, names: tuple[str, ...] = ()) -> FunctionVariation:
        """See `Dynamics.variation`."""
        if self._given_jacobian is not None or self._given_hessian is not None:
            raise ValueError("derivatives that are given are those of fixed steps and parameters; leave them out")
        return FunctionVariation(self, names)

    def by_stretch(self, X: Array, U: Array, ends: Array) -> tuple[Array, Array] | None:
        """By complex steps; see `Dynamics.by_stretch`."""
        (f, outputs), times = self.functions, self._knots(U)[0]
        S = self._steps.by_stretch(*self._time_grid(len(U)), X, U, takes_time(f))
        clock = self.ny > 0 and takes_time(outputs)
        G = self._readings.by_clock(times, X, self._knots(U)[1]) if clock else np.zeros((len(X), self.ny))
        return None if S is None else (S, G)

    def changed(self, dt: float | Array, parameters: Array, steps: Derivatives, readings: Derivatives) -> Self:
        """The same system with other `dt` and `parameters`, and `steps` and `readings`: derivatives that know these."""
        other = object.__new__(type(self))
        vars(other).update(vars(self))  # the compiled functions, too, which copies make anew
        other.dt, other.parameters, other._steps, other._readings = dt, parameters, steps, readings
        if not isinstance(dt, float):
            other._starts = np.cumsum(dt) - dt
        return other

    def copied_derivatives(self) -> tuple[Derivatives, Derivatives]:
        """Derivatives of steps and of outputs, for `changed`."""
        return copy.copy(self._steps), copy.copy(self._readings)

    def step_each(self, X: ArrayLike, U: ArrayLike) -> tuple[Array, Array]:
        """One step from each knot; see `Dynamics.step_each`."""
        states, controls = np.ascontiguousarray(X, dtype=np.float64), self.checked_controls(U)
        F = np.empty((len(controls), self.nx))
        with np.errstate(all="ignore"):
            self._kernel(kernels.step_each)(*self._arguments(len(controls)), states, controls, F)
        return F, np.array(self._trajectory(states, controls, -1).Y)

    @property
    def jacobian(self) -> str:
        """How first derivatives are taken: "given", "complex-step" or "finite-difference"."""
        if self._given_jacobian is not None:
            return "given"
        return "finite-difference" if self._steps.by_differences else "complex-step"

    @property
    def curvature_price(self) -> float:
        """One where the Hessian was given; else differences of first derivatives in half of the directions."""
        return 1.0 if self._given_hessian is not None else float(self.nx + self.nu)

    def hessian(
        self,
        trajectory: Trajectory,
        costates: Array,
        weights: Array | None = None,
        linearization: Linearization | None = None,
        ends: Array | None = None,
    ) -> Curvature:
        """Second derivatives of steps and outputs, contracted; see `Dynamics.hessian`."""
        N, size = trajectory.horizon, self.nx + self.nu
        if self._given_hessian is None and self._given_jacobian is not None:
            return super().hessian(trajectory, costates, weights, linearization, ends)
        if linearization is None:
            self.linearize(trajectory)  # which finds out whether complex steps serve
        X, U, H = trajectory.X, trajectory.U, np.zeros((N + 1, size, size))
        if self._given_hessian is not None:
            for n, t in enumerate(self._grid(N)[0]):
                H[n] = checked_hessian(self._given_hessian(X[n], U[n], t, costates[n + 1]), self.nx, self.nu)
        else:
            self._steps.hessians(*self._time_grid(N), X, U, np.ascontiguousarray(costates[1:]), H)
        if weights is not None and self.ny:
            H += self._output_hessians(X, U, weights)
        return curvature_of(H, self.nx)

    def scene(self) -> Scene | None:
        """What was given as `scene`."""
        return self._scene

    def support_report(self) -> list[tuple[str, str]]:
        """See `Dynamics.support_report`."""
        speed = "compiled: no Python call per step" if self.compiled else "plain Python: numba.njit makes it faster"
        step = "one step a call" if self.integrator == "map" else "control held over a step"
        parts = [(f"function of {self.nx} states and {self.nu} controls", speed)]
        return [*parts, (f"integrator {self.integrator}", step), ("Jacobians", self.jacobian)]

    def _derivatives(self, of_steps: bool, of_readings: bool) -> tuple[Derivatives, Derivatives]:
        """Derivatives of steps and of outputs, by differences or not."""
        (f, outputs), p = self.functions, self.parameters
        return (
            Derivatives("f", self._f, f, self.compiled, self._code, self._nv, p, of_steps),
            Derivatives(
                "outputs", self._read, outputs or self._read, self._reads_compiled, kernels.MAP, 0, p, of_readings
            ),
        )

    @property
    def _code(self) -> int:
        return _INTEGRATORS[self.integrator]

    def _kernel(self, python: Callable[..., Any]) -> Callable[..., Any]:
        return kernels.compiled(python) if self.compiled else python

    def _grid(self, N: int) -> tuple[Array, Array]:
        """Times at which the steps begin, and their lengths. Shapes (N,), (N,)."""
        if isinstance(self.dt, float):
            return np.arange(N) * np.float64(self.dt), np.full(N, self.dt)
        return self._starts[:N], self.dt[:N]

    def _time_grid(self, N: int) -> tuple[Array, Array]:
        self.steps(N)  # refuses a horizon of another length
        return self._grid(N)

    def _arguments(self, N: int) -> tuple[Any, ...]:
        return (self._f, self._code, self._nv, *self._time_grid(N), self.parameters)

    def _trajectory(self, X: Array, U: Array, bad: int) -> Trajectory:
        N = len(U)
        good = N + 1 if bad < 0 else bad
        Y = np.full((N + 1, self.ny), np.nan)
        if self.ny:
            times, held = self._knots(U)
            with np.errstate(all="ignore"):
                self._reader(kernels.read_all)(self._read, times, self.parameters, X, held, Y[:good])
        return Trajectory.unchecked(X, U, Y, self.dt, None if bad < 0 else bad)

    def _knots(self, U: Array) -> tuple[Array, Array]:
        """Times of the knots, and the controls there, zero at the last. Shapes (N + 1,), (N + 1, nu)."""
        N = len(U)
        held = np.zeros((N + 1, self.nu))
        held[:N] = U
        return np.append(self._grid(N)[0], self.steps(N).sum()), held

    def _reader(self, python: Callable[..., Any]) -> Callable[..., Any]:
        return kernels.compiled(python) if self._reads_compiled else python

    def _linearize_outputs(self, X: Array, U: Array, times: Array) -> tuple[Array, Array]:
        C, D = np.zeros((len(X), self.ny, self.nx)), np.zeros((len(X), self.ny, self.nu))
        if self.ny:
            held = np.vstack([U, np.zeros((1, self.nu))])
            self._readings.jacobians(times, np.ones(len(X)), X, held, C, D)
            D[-1] = 0.0
        return C, D

    def _output_hessians(self, X: Array, U: Array, weights: Array) -> Array:
        """Second derivatives of w_n'y_n at every knot. Shape (N + 1, nx + nu, nx + nu)."""
        H, (times, held) = np.zeros((len(X), self.nx + self.nu, self.nx + self.nu)), self._knots(U)
        self._readings.hessians(times, np.ones(len(X)), X, held, np.ascontiguousarray(weights), H)
        return H
