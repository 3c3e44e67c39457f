"""Cost terms: what a problem asks for, as sums over the knots of a trajectory.

Every term comes in two steps. What the user writes (`Tracking`, `State`, `Control`, `Sensor`, `Frame`, `Residual`,
`Function`) is a small frozen record. `bind` fits it to a system and a horizon, where sizes are checked and weights are
spread over the knots: a residual (`mjslq.residuals`) with a loss (`mjslq.losses`), which evaluates and expands over the
whole horizon at once (`mjslq.bound_costs`).

Notation
--------
    J = sum_n s_n l_n(x_n, u_n)      s_n = h_n, the step's length, for running terms, which are integrals over time;
                                      1 for terminal and initial terms and at single knots, which are values
    r(x, u, t) with weight W          l = 1/2 r'W r, or another loss of r's length: see `mjslq.losses`

`when` names the knots at which a term acts: "running", "terminal", "always" (both), "initial", or knots by index (one,
a slice, a list; from the end if negative) or by time [s] after the start of the horizon; see `mjslq.knots`.

`target` is a constant, an array with a row for each knot, or a function of time t -> target, which is called once for
each knot when the problem is made. On a horizon that begins at t0 (`Problem.at`, `mjslq.MPC`) functions see the time
t0 + t_n, those of `Residual` and `Function` like those of targets; arrays and `when` belong to the knots, and move
along with the horizon. See `mjslq.targets`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjslq import binding, residuals
from mjslq.bound_costs import BoundTerm as BoundTerm
from mjslq.bound_costs import FunctionCost, ResidualCost
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.records import QUANTITIES, OfFrame
from mjslq.knots import Knots, When, knots_of
from mjslq.losses import LossName, bind_loss, check_loss
from mjslq.quadratic import Expansion as Expansion
from mjslq.targets import Timed
from mjslq.time_costs import TimeCost
from mjslq.user_function import UserCost, UserFunction
from mjslq.validation import Array, choose, finite, per_step_matrices


class CostTerm(ABC):
    """A cost term as a user states it; `bind` fits it to a system and a horizon."""

    @abstractmethod
    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """Fit to a system and a horizon. Raises ValueError where sizes do not belong together."""


@dataclass(frozen=True)
class Tracking(CostTerm):
    """Quadratic tracking cost, literally Sideris and Bobrow's (3)-(4): plain sums, factor 1/2, no dt.

    sum_{n<N} 1/2 [(x_n - x_o)'Q (x_n - x_o) + (u_n - u_o)'R (u_n - u_o)] + 1/2 (x_N - x_o)'Q_final (x_N - x_o)

    Matrices are given as a number, a diagonal, a matrix or one matrix a step; Q and Q_final positive semidefinite,
    R positive definite.

    Examples
    --------
    >>> regulate = mjslq.costs.Tracking(Q=[1.0, 0.1], R=0.01, Q_final=100.0, x_target=[np.pi, 0.0])
    """

    Q: ArrayLike
    """Running state weight. Shape () | (ndx,) | (ndx, ndx) | (N, ndx, ndx)."""
    R: ArrayLike
    """Control weight. Shape () | (nu,) | (nu, nu) | (N, nu, nu)."""
    Q_final: ArrayLike
    """Terminal state weight. Shape () | (ndx,) | (ndx, ndx)."""
    x_target: ArrayLike | Timed | None = None
    """x_o: one state, one a knot, or t -> state; zero unless given. Shape (nx,) | (N + 1, nx)."""
    u_target: ArrayLike | Timed | None = None
    """u_o: one control, one a step, or t -> control; zero unless given. Shape (nu,) | (N, nu)."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        Q = per_step_matrices("Q", self.Q, N, dynamics.ndx, definite=False)
        Q_final = per_step_matrices("Q_final", self.Q_final, 1, dynamics.ndx, definite=False)
        R = per_step_matrices("R", self.R, N, dynamics.nu, definite=True)
        running, terminal = (knots_of(when, dynamics.steps(N)) for when in ("running", "terminal"))
        u_target = 0.0 if self.u_target is None else self.u_target
        path, end = (binding.bind_state(dynamics, self.x_target, at, "x_target") for at in (running, terminal))
        controls = binding.bind_control(dynamics, u_target, running, "u_target")
        return (
            *_plain_sum(path, Q, "Tracking, states"),
            *_plain_sum(end, Q_final, "Tracking, final state"),
            *_plain_sum(controls, R, "Tracking, controls"),
        )


@dataclass(frozen=True)
class State(CostTerm):
    """1/2 weight |x - target|^2, or another loss of x - target.

    Examples
    --------
    >>> upright = mjslq.costs.State([100.0, 1.0], target=[np.pi, 0.0], when="terminal")
    """

    weight: ArrayLike
    """A number, a diagonal or a matrix, positive semidefinite. Shape () | (ndx,) | (ndx, ndx)."""
    target: ArrayLike | Timed | None = None
    """One state, one a knot, one for each of the knots that `when` lists, or t -> state; zero unless given.
    Shape (nx,) | (N + 1, nx) | (k, nx)."""
    when: When = "running"
    """Where it acts; see `mjslq.knots.When`."""
    loss: LossName = field(default="quadratic", kw_only=True)
    """"quadratic", "smooth-abs", "huber" or "pseudo-huber"; see `mjslq.losses`."""
    width: float | None = field(default=None, kw_only=True)
    """Width of the other losses, in the residual's unit; 0.1 unless given."""
    terminal_weight: ArrayLike | None = field(default=None, kw_only=True)
    """With when="always": the weight of the terminal value; `weight` unless given. Shape as `weight`."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""

        def make(knots: Knots) -> residuals.BoundResidual:
            return binding.bind_state(dynamics, self.target, knots)

        return _bind("State", self, dynamics.steps(N), make, self.terminal_weight)


@dataclass(frozen=True)
class Control(CostTerm):
    """1/2 weight |u - target|^2, or another loss of u - target; an integral over time.

    Examples
    --------
    >>> effort = mjslq.costs.Control(1e-2)
    """

    weight: ArrayLike
    """A number, a diagonal or a matrix, positive semidefinite; with the other terms of a problem, all controls have to
    cost something. Shape () | (nu,) | (nu, nu)."""
    target: ArrayLike | Timed = 0.0
    """One control, one a step, one for each of the knots that `when` lists, or t -> control.
    Shape () | (nu,) | (N, nu) | (k, nu)."""
    when: When = "running"
    """Where it acts: "running", "initial", or some of the knots 0 ... N-1; see `mjslq.knots.When`."""
    loss: LossName = field(default="quadratic", kw_only=True)
    """"quadratic", "smooth-abs", "huber" or "pseudo-huber"; see `mjslq.losses`."""
    width: float | None = field(default=None, kw_only=True)
    """Width of the other losses, in the residual's unit; 0.1 unless given."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""

        def make(knots: Knots) -> residuals.BoundResidual:
            return binding.bind_control(dynamics, self.target, knots)

        return _bind("Control", self, dynamics.steps(N), make)


@dataclass(frozen=True)
class Sensor(CostTerm):
    """1/2 weight |reading - target|^2, or another loss, of an output of the engine: a MuJoCo sensor, or a frame.

    Readings that are unit quaternions are compared by the rotation vector [rad] between them and the target.

    Examples
    --------
    >>> reach = mjslq.costs.Sensor("hand", target=[0.4, 0.3, 0.5], weight=1e3, when="terminal", loss="smooth-abs")
    """

    name: str
    """The sensor's name."""
    target: ArrayLike | Timed
    """One reading, one a knot, one for each of the knots that `when` lists, or t -> reading.
    Shape () | (m,) | (N + 1, m) | (k, m)."""
    weight: ArrayLike = 1.0
    """A number, a diagonal or a matrix, positive semidefinite. Shape () | (m,) | (m, m); m = 3 for quaternions."""
    when: When = "running"
    """Where it acts; see `mjslq.knots.When`. At the terminal knot readings are taken with zero control."""
    loss: LossName = "quadratic"
    """"quadratic", "smooth-abs", "huber" or "pseudo-huber"; see `mjslq.losses`."""
    width: float | None = None
    """Width of the other losses, in the residual's unit; 0.1 unless given."""
    terminal_weight: ArrayLike | None = field(default=None, kw_only=True)
    """With when="always": the weight of the terminal value; `weight` unless given. Shape as `weight`."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""

        def make(knots: Knots) -> residuals.BoundResidual:
            return binding.bind_output(dynamics, self.name, self.target, knots)

        return _bind(f"Sensor {self.name!r}", self, dynamics.steps(N), make, self.terminal_weight)


@dataclass(frozen=True)
class Frame(CostTerm):
    """1/2 weight |quantity - target|^2, or another loss, of a frame: place, orientation or velocity of a body or site.

    The engine reads it by a sensor of the model, or one that was added by `MujocoDynamics.from_path(...,
    frames=["hand"])`; Pinocchio's by `outputs=("hand", "hand.orientation")`, without velocities. Positions [m] and
    velocities [m/s, rad/s] are in the world's axes, orientations unit quaternions (w, x, y, z), compared by the
    rotation vector [rad] between them and the target.

    Examples
    --------
    >>> reach = mjslq.costs.Frame("hand", target=[0.4, 0.3, 0.5], weight=1e3, when="terminal")
    """

    name: str
    """The frame's name."""
    target: ArrayLike | Timed
    """One value, one a knot, one for each of the knots that `when` lists, or t -> value.
    Shape () | (m,) | (N + 1, m) | (k, m); m = 4 for orientations, otherwise 3."""
    weight: ArrayLike = 1.0
    """A number, a diagonal or a matrix, positive semidefinite. Shape () | (3,) | (3, 3)."""
    when: When = "running"
    """Where it acts; see `mjslq.knots.When`."""
    of: OfFrame = field(default="position", kw_only=True)
    """"position", "orientation", "linear-velocity" or "angular-velocity"."""
    loss: LossName = field(default="quadratic", kw_only=True)
    """"quadratic", "smooth-abs", "huber" or "pseudo-huber"; see `mjslq.losses`."""
    width: float | None = field(default=None, kw_only=True)
    """Width of the other losses, in the residual's unit; 0.1 unless given."""
    terminal_weight: ArrayLike | None = field(default=None, kw_only=True)
    """With when="always": the weight of the terminal value; `weight` unless given. Shape as `weight`."""

    def output(self, dynamics: Dynamics) -> str:
        """Name of the output of `dynamics` that reads the frame. Raises ValueError."""
        return dynamics.frame_output(self.name, choose("quantity of a frame", self.of, QUANTITIES))

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        output = self.output(dynamics)

        def make(knots: Knots) -> residuals.BoundResidual:
            return binding.bind_output(dynamics, output, self.target, knots)

        return _bind(f"Frame {self.name!r}, {self.of}", self, dynamics.steps(N), make, self.terminal_weight)


@dataclass(frozen=True)
class Residual(CostTerm):
    """1/2 r'W r for any smooth residual r(x, u, t), or another loss of it; expanded by Gauss-Newton.

    Plain Python is called knot by knot. A function compiled by `numba.njit`, which must return a new float64 array or a
    number, complex for complex x and u, runs over the horizon without a Python call per knot.

    Examples
    --------
    >>> unit_circle = mjslq.costs.Residual(lambda x, u, t: x[0] ** 2 + x[1] ** 2 - 1.0, weight=10.0)
    """

    r: Callable[..., Any]
    """r(x, u, t) -> (m,); at the terminal knot u is zero. Analytic in x and u unless `jacobian` is given."""
    weight: ArrayLike = 1.0
    """W: a number, a diagonal or a matrix, positive semidefinite. Shape () | (m,) | (m, m)."""
    when: When = "running"
    """Where it acts; see `mjslq.knots.When`."""
    jacobian: Callable[..., Any] | None = None
    """jacobian(x, u, t) -> (dr/dx (m, nx), dr/du (m, nu)); by complex steps unless given, and by real differences, with
    a warning, where those show that r is not analytic."""
    parameters: ArrayLike | None = field(default=None, kw_only=True)
    """p, handed through to r(x, u, t, p) (and its derivatives) if given: for compiled functions whose constants change
    between problems, which then need not be compiled again. Shape (size,)."""
    loss: LossName = field(default="quadratic", kw_only=True)
    """"quadratic", "smooth-abs", "huber" or "pseudo-huber"; see `mjslq.losses`."""
    width: float | None = field(default=None, kw_only=True)
    """Width of the other losses, in the residual's unit; 0.1 unless given."""
    terminal_weight: ArrayLike | None = field(default=None, kw_only=True)
    """With when="always": the weight of the terminal value; `weight` unless given. Shape as `weight`."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        function = UserFunction("r", self.r, dynamics.nx, dynamics.nu, self.jacobian, self.parameters)

        def make(knots: Knots) -> residuals.BoundResidual:
            return residuals.FunctionResidual(dynamics, function, knots)

        label = f"Residual {getattr(self.r, '__name__', type(self.r).__name__)!r}"
        return _bind(label, self, dynamics.steps(N), make, self.terminal_weight)


@dataclass(frozen=True)
class Function(CostTerm):
    """Any smooth cost l(x, u, t); where its Hessian is indefinite, the part below zero is left out of the model.

    Plain Python is called knot by knot; a function compiled by `numba.njit`, which must return a number, complex for
    complex x and u, is not.

    Examples
    --------
    >>> power = mjslq.costs.Function(lambda x, u, t: (u[0] * x[1]) ** 2)
    """

    l: Callable[..., Any]  # noqa: E741  (the field's own name)
    """l(x, u, t) -> number; at the terminal knot u is zero. Analytic in x and u unless both derivatives are given."""
    when: When = "running"
    """Where it acts; see `mjslq.knots.When`."""
    gradient: Callable[..., Any] | None = None
    """gradient(x, u, t) -> (dl/dx (nx,), dl/du (nu,)); by complex steps unless given, and by real differences, with a
    warning, where those show that l is not analytic."""
    hessian: Callable[..., Any] | None = None
    """hessian(x, u, t) -> (nx + nu, nx + nu); by differences of the gradient unless given."""
    parameters: ArrayLike | None = field(default=None, kw_only=True)
    """p, handed through to l(x, u, t, p) (and its derivatives) if given: for compiled functions whose constants change
    between problems, which then need not be compiled again. Shape (size,)."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        steps = dynamics.steps(N)
        knots = knots_of(self.when, steps)
        function = UserCost("l", self.l, dynamics.nx, dynamics.nu, self.gradient, self.hessian, self.parameters)
        residual = residuals.FunctionResidual(dynamics, function, knots)
        label = f"Function {getattr(self.l, '__name__', type(self.l).__name__)!r}, {knots}"
        return (FunctionCost(residual, knots.scales(steps), label, knots.over_time),)


@dataclass(frozen=True)
class Time(CostTerm):
    """The duration T itself, times a weight: for problems whose final time is free, minimum time for one.

    Examples
    --------
    >>> hurry = mjslq.costs.Time(1.0)
    """

    weight: float = 1.0
    """Cost of a second; a number of any sign."""

    def bind(self, dynamics: Dynamics, N: int) -> tuple[BoundTerm, ...]:
        """See `CostTerm.bind`."""
        return (TimeCost(finite("weight", self.weight)),)


def _bind(
    kind: str,
    term: State | Control | Sensor | Frame | Residual,
    steps: Array,
    make: Callable[[Knots], residuals.BoundResidual],
    terminal_weight: ArrayLike | None = None,
) -> tuple[BoundTerm, ...]:
    """A loss of a residual at the knots where the term acts; two, where the terminal knot has a weight of its own."""
    check_loss(term.loss, term.width)
    parts = [("weight", term.weight, knots_of(term.when, steps))]
    if terminal_weight is not None:
        if term.when != "always":
            raise ValueError(
                f"terminal_weight is the weight of the terminal value with when='always', but when is {term.when!r}"
            )
        parts[0] = ("weight", term.weight, knots_of("running", steps))
        parts.append(("terminal_weight", terminal_weight, knots_of("terminal", steps)))
    bound = []
    for name, weight, knots in parts:
        residual = make(knots)
        W = per_step_matrices(name, weight, 1, residual.size, definite=False)
        if W.any():
            loss = bind_loss(term.loss, term.width, W, knots.scales(steps))
            bound.append(ResidualCost(residual, loss, f"{kind}, {knots}", knots.over_time))
    return tuple(bound)


def _plain_sum(residual: residuals.BoundResidual, W: Array, label: str) -> tuple[BoundTerm, ...]:
    """1/2 r'W r summed over the knots: nothing where W is zero."""
    if not W.any():
        return ()
    if (W[0] == W).all():
        W = W[:1]
    return (ResidualCost(residual, bind_loss("quadratic", None, W, np.ones(len(residual.knots))), label),)
