"""`Problem`: a system, a horizon, a start and a cost, checked as a whole when it is made.

    minimize   J(U) = sum_n l_n(x_n, u_n)   subject to   x_{n+1} = f_n(x_n, u_n),  x_0 given,  u within limits

(Sideris and Bobrow 2005, (1)-(2)), and to constraints lower <= r(x_n, u_n, t_n) <= upper. The controls U are the
unknowns, what `constraints.Initial` frees of x_0, and the final time and parameters where these are free
(`mjslq.unknowns`); the states follow by rollout.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjslq import constraints as kinds
from mjslq.bound_constraints import BoundConstraint
from mjslq.bounds import Bounds
from mjslq.costs import BoundTerm, CostTerm, Expansion
from mjslq.dynamics.dynamics import Dynamics, Linearization
from mjslq.lq.adjoint import adjoint
from mjslq.lq.box import Box
from mjslq.lq.problem import Mask
from mjslq.markers import markers
from mjslq.options import check as check_options
from mjslq.residuals import Slopes
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.unknowns import Unknowns
from mjslq.validation import Array, as_array, count, describe, finite, frozen, function, instance, refrozen

LONGEST = 10_000_000
"""Steps of a horizon, at most: one of more is a mistake, and would ask for terabytes."""


@dataclass(frozen=True, eq=False)
class Problem:
    """An optimal control problem over a fixed horizon.

    Raises ValueError when sizes do not belong together; the message names the argument.

    >>> cart = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0]]), nx=2, nu=1, dt=0.1)
    >>> problem = mjslq.Problem(cart, 20, [0.0, 0.0], [mjslq.costs.Control(0.1), mjslq.costs.State(1.0, [1.0, 0.0])])
    >>> round(problem.cost(problem.rollout([0.0])), 6)
    1.0
    """

    dynamics: Dynamics
    """The system."""
    horizon: int
    """Number of steps N."""
    x0: ArrayLike
    """Initial state; what `constraints.Initial` makes free of it is where the search starts. Shape (nx,)."""
    costs: Sequence[CostTerm]
    """Terms of the cost, added up."""
    constraints: Sequence[kinds.Constraint] = field(default=(), kw_only=True)
    """What the trajectory has to obey; see `mjslq.constraints`. Methods that take none refuse the problem."""
    bounds: Bounds | None = None
    """Limits of the controls; the engine's own (`Bounds()`) unless given. `Bounds(u=None)` lifts them. Limits of the
    states, `Bounds(x=...)`, become the constraint "bounds"."""
    free_time: tuple[float, float] | None = field(default=None, kw_only=True)
    """(T_min, T_max): the final time is unknown, between these, and all steps are stretched alike. The search starts
    from the duration of the system's own steps, and "auto" and "constrained" hold the time there until the motion is a
    good one (`solvers.held_time`). Numbers that functions hold do not stretch; see `step_lengths`. [s]"""
    free_parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict, kw_only=True)
    """Parameters of the system that are unknown (`Dynamics.parameter_names`), by name, with their limits (lower,
    upper). The search starts from their values in the system."""
    name: str = "problem"
    """For titles and messages."""
    U0: ArrayLike | None = None
    """Controls to start from, clipped to the limits; the engine's `initial_control`, zero for most, unless given.
    Shape (nu,) | (N, nu)."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options that `solve` takes for this problem unless told otherwise, such as its stopping tolerance, as far as
    the method has them. A name that no method has is refused."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """What the problem was made with, for the record."""
    describe: Callable[[Trajectory], dict[str, str]] | None = None
    """Problem-specific summary lines of a trajectory: name -> text."""
    drawing: Scene | None = None
    """What a viewer draws; the engine's own scene unless given."""
    box: Box = field(init=False, repr=False)
    """Limits of the controls at each step, -inf and inf where there are none. Arrays of shape (N, nu)."""
    bound_constraints: tuple[BoundConstraint, ...] = field(init=False, repr=False, default=())
    """The constraints on this horizon, but for those of the controls alone, which `box` has."""
    free_start: Mask | None = field(init=False, repr=False, default=None)
    """Tangent directions of the initial state that are unknown; None for none. Shape (ndx,)."""
    t0: float = field(init=False, default=0.0)
    """Time at which the horizon begins: functions of time in costs and constraints see t0 + t_n; see `at`. [s]"""
    unknowns: Unknowns | None = field(init=False, repr=False, default=None)
    """What is unknown beside controls and initial state; None for nothing."""
    _terms: tuple[BoundTerm, ...] = field(init=False, repr=False, default=())
    _unpenalized: Problem | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        if not isinstance(self.dynamics, Dynamics):
            raise ValueError(f"dynamics must be an engine (MujocoDynamics, ...), got {type(self.dynamics).__name__}")
        dynamics, N = self.dynamics, count("horizon", self.horizon)
        if N > LONGEST:
            raise ValueError(f"horizon must be at most {LONGEST} steps, got {describe(N)}")
        dynamics.steps(N)
        store = object.__setattr__  # the way to fill a frozen record
        store(self, "x0", frozen(np.array(dynamics.checked_start(self.x0))))
        store(self, "unknowns", Unknowns.of(dynamics, N, self.free_time, self.free_parameters))
        U0 = dynamics.initial_control if self.U0 is None else as_array("U0", self.U0)
        if U0.shape not in ((dynamics.nu,), (N, dynamics.nu)):
            raise ValueError(f"U0 must have shape ({dynamics.nu},) or ({N}, {dynamics.nu}), got {U0.shape}")
        bounds = Bounds() if self.bounds is None else self.bounds
        if not isinstance(bounds, Bounds):
            raise ValueError(f"bounds must be mjslq.Bounds, got {type(bounds).__name__}")
        store(self, "box", bounds.bind(dynamics, N))
        self._bind_constraints(bounds, N)
        store(self, "U0", frozen(self.box.clip(np.broadcast_to(U0, (N, dynamics.nu)))))
        check_options(self.options)
        self._check_labels()
        if not isinstance(self.costs, (CostTerm, Sequence)):
            raise ValueError(f"costs must be a list of terms of mjslq.costs, got {type(self.costs).__name__}")
        terms = [self.costs] if isinstance(self.costs, CostTerm) else list(self.costs)
        if not terms:
            raise ValueError("costs must name at least one term, or there is nothing to minimize")
        bound: list[BoundTerm] = []
        for i, term in enumerate(terms):
            if not isinstance(term, CostTerm):
                raise ValueError(f"costs[{i}] must be a term of mjslq.costs, got {type(term).__name__}")
            try:
                bound.extend(term.bind(dynamics, N))
            except ValueError as error:
                raise ValueError(f"costs[{i}] ({type(term).__name__}): {error}") from None
        store(self, "costs", tuple(terms))
        store(self, "_terms", tuple(bound))
        if self.unknowns is not None:
            self.unknowns.check(self)

    def __getstate__(self) -> dict[str, Any]:
        """What pickle carries: not what is made when first asked for."""
        return {name: value for name, value in vars(self).items() if name not in ("lifted", "_prepared")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(refrozen(state))

    def _check_labels(self) -> None:
        """Check what is there for titles, records and viewers."""
        instance("name", self.name, str, "a text")
        instance("parameters", self.parameters, Mapping, "a table of values by name")
        if self.describe is not None:
            function("describe", self.describe)
        if self.drawing is not None:
            instance("drawing", self.drawing, Scene, "a mjslq.Scene")

    def _check(self, trajectory: Trajectory) -> None:
        """Refuse what is no trajectory of this system and horizon."""
        instance("trajectory", trajectory, Trajectory, "a mjslq.Trajectory")
        found, own = (trajectory.X.shape, trajectory.U.shape), (self.horizon, self.dynamics.nx, self.dynamics.nu)
        if found != ((own[0] + 1, own[1]), (own[0], own[2])):
            raise ValueError(
                f"trajectory must have {own[0]} steps, {own[1]} states and {own[2]} controls, got {len(trajectory.U)}, "
                f"{found[0][1]} and {found[1][1]}"
            )

    def _bind_constraints(self, bounds: Bounds, N: int) -> None:
        """Fit the constraints to the horizon; those of controls alone make the box smaller."""
        given, store = self.constraints, object.__setattr__
        bound, boxes, free = kinds.bind_all(given, self.dynamics, N)
        store(self, "free_start", free)
        if bounds.x is not None:
            bound = (*bound, bounds.bind_states(self.dynamics, N, [constraint.name for constraint in bound]))
        store(self, "constraints", (given,) if isinstance(given, kinds.Constraint) else tuple(given))
        store(self, "bound_constraints", bound)
        for box in boxes:
            store(self, "box", self.box.within(box, self.dynamics.control_names))

    def at(self, x0: ArrayLike, t0: float = 0.0) -> Problem:
        """The same problem from the initial state `x0` (nx,), on a horizon that begins at the time `t0` [s].

        Functions of time see t0 + t_n: `costs.Residual` and `Function`, `constraints.Path`, and targets and limits that
        are functions. Arrays with a row for each knot, and `when`, belong to the knots and move along. Shares
        everything that does not depend on x0 and t0: nothing is bound anew.

        Raises ValueError for a state that is not one, and where a function of time fails at its new times.
        """
        moved, store = self._copied(), object.__setattr__
        store(moved, "x0", frozen(np.array(self.dynamics.checked_start(x0))))
        if finite("t0", t0) == self.t0:
            return moved
        store(moved, "t0", float(t0))
        terms = tuple(term.at(moved.t0) for term in self._terms)
        if any(later is not term for later, term in zip(terms, self._terms, strict=True)):
            store(moved, "_terms", terms)
            moved.__dict__.pop("_prepared", None)
        store(moved, "bound_constraints", tuple(c.at(moved.t0) for c in self.bound_constraints))
        store(moved, "box", self._box_at(moved.t0))
        return moved

    def with_constraints(self, constraints: tuple[BoundConstraint, ...]) -> Problem:
        """The same problem with `constraints` in place of its `bound_constraints`."""
        made = self._copied()
        object.__setattr__(made, "bound_constraints", constraints)
        return made

    def _copied(self) -> Problem:
        """A copy with the same terms of the cost, and what is prepared for these."""
        made = copy.copy(self)
        if "_prepared" in vars(self):
            made.__dict__["_prepared"] = self._prepared
        return made

    def _box_at(self, t0: float) -> Box:
        """Limits of the controls on a horizon that begins at `t0` [s]."""
        controls = [c for c in self.constraints if isinstance(c, kinds.Control)]
        moving = [c.at(t0, self.dynamics, self.horizon) for c in controls]
        if all(box is None for box in moving):
            return self.box
        box = (Bounds() if self.bounds is None else self.bounds).bind(self.dynamics, self.horizon)
        for control, later in zip(controls, moving, strict=True):
            own = control.bind(self.dynamics, self.horizon, "") if later is None else later
            box = box.within(own, self.dynamics.control_names)
        return box

    def start(self, x: Array) -> Array:
        """The initial state with its free entries taken from `x` (nx,). Shape (nx,)."""
        if self.free_start is None:
            return np.asarray(self.x0)
        away = self.dynamics.difference(np.asarray(self.x0), x)
        return self.dynamics.integrate(np.asarray(self.x0), np.where(self.free_start, away, 0.0))

    @cached_property
    def lifted(self) -> Problem:
        """The problem that methods solve: itself, or with free time or parameters the one that has them as states."""
        return self if self.unknowns is None else self.unknowns.pose(self)

    def fixed(self, values: Mapping[str, float]) -> Problem:
        """The same problem with its free time and parameters at `values` by name, such as `Result.unknowns`.

        Those that are not named stay at their first values. For whatever takes a fixed horizon: `MPC`, simulation.
        Raises ValueError for names that are not free and values beyond their limits.
        """
        return self if self.unknowns is None else self.unknowns.fixed(self, values)

    @property
    def bound_terms(self) -> tuple[BoundTerm, ...]:
        """The terms of the cost on this horizon."""
        return self._terms

    def on(self, dynamics: Dynamics) -> Problem:
        """The same problem on `dynamics`, which differ from its own in nothing but the derivatives that they give."""
        moved = copy.copy(self)
        object.__setattr__(moved, "dynamics", dynamics)
        return moved

    def rollout(self, U: ArrayLike) -> Trajectory:
        """Simulate from x0 under the controls `U` (N, nu), by the system's own steps and parameters, free or not."""
        return self.dynamics.rollout(self.x0, self.checked_controls(U))

    def violation(self, trajectory: Trajectory) -> float:
        """Largest violation of a limit or constraint along `trajectory`; 0 if all are met, infinite if it diverged."""
        self._check(trajectory)
        if self.unknowns is not None:
            return self.lifted.violation(self.unknowns.extended(self, trajectory))
        if trajectory.diverged:
            return math.inf
        controls = float(np.abs(trajectory.U - self.box.clip(trajectory.U)).max(initial=0.0))
        worst = (float(c.violation(trajectory).max(initial=0.0)) for c in self.bound_constraints)
        return max(controls, *worst) if self.bound_constraints else controls

    def violations(self, trajectory: Trajectory) -> dict[str, Array]:
        """Violation of each constraint at each knot of `trajectory`, by name; zero where it does not act. (N + 1,)."""
        if self.unknowns is not None:
            return self.lifted.violations(self.unknowns.extended(self, trajectory))
        return {c.name: c.over_knots(c.violation(trajectory)) for c in self.bound_constraints}

    def penalized(self, terms: Sequence[BoundTerm]) -> Problem:
        """The same problem with more `terms` in its cost; `unpenalized` leads back."""
        made = copy.copy(self.unpenalized)
        object.__setattr__(made, "_terms", (*made._terms, *terms))
        object.__setattr__(made, "_unpenalized", self.unpenalized)
        return made

    def with_terms(self, terms: Sequence[BoundTerm]) -> Problem:
        """The same problem with more `terms` that belong to it."""
        made = copy.copy(self)
        object.__setattr__(made, "_terms", (*self._terms, *terms))
        return made

    @property
    def unpenalized(self) -> Problem:
        """The problem as it was stated, without the terms that `penalized` added."""
        return self if self._unpenalized is None else self._unpenalized

    def cost(self, trajectory: Trajectory) -> float:
        """Total cost J of `trajectory`; infinite where it diverged. Raises ValueError for one of another problem."""
        self._check(trajectory)
        return self.total(self.costs_of_terms(trajectory))

    def costs_of_terms(self, trajectory: Trajectory) -> list[float]:
        """Cost of each bound term along `trajectory`; infinite where it diverged."""
        if self.unknowns is not None:
            return self.lifted.costs_of_terms(self.unknowns.extended(self, trajectory))[: len(self._terms)]
        if trajectory.diverged:
            return [math.inf] * len(self._terms)
        with np.errstate(over="ignore", invalid="ignore"):
            return [term.cost(trajectory) for term in self._terms]

    def total(self, costs_of_terms: Sequence[float]) -> float:
        """Total cost J of what `costs_of_terms` found; infinite where it is not finite."""
        total = float(sum(costs_of_terms))
        return total if math.isfinite(total) else math.inf

    def named(self, costs_of_terms: Sequence[float]) -> dict[str, float]:
        """The `costs_of_terms` by what a term is and where it acts; equal ones are numbered from the second on."""
        return dict(zip(self._labels(), costs_of_terms, strict=False))  # penalties may come after

    def residual_sizes(self, trajectory: Trajectory) -> dict[str, Array]:
        """Length |r| of each residual along `trajectory`, named as by `named`; NaN where it does not act. (N + 1,)

        User's functions (`costs.Residual`, `costs.Function`) are left out; none for a trajectory that diverged.
        """
        if trajectory.diverged:
            return {}
        sizes = {
            label: term.residual_sizes(trajectory) for label, term in zip(self._labels(), self._terms, strict=True)
        }
        return {label: size for label, size in sizes.items() if size is not None}

    def _labels(self) -> list[str]:
        """What each term is and where it acts; equal ones are numbered from the second on."""
        found: list[str] = []
        for term in self._terms:
            label, number = term.label, 1
            while label in found:
                number += 1
                label = f"{term.label} ({number})"
            found.append(label)
        return found

    def expand(self, trajectory: Trajectory, linearization: Linearization | None = None) -> Expansion:
        """Gauss-Newton expansion of the cost about `trajectory`, whose `linearization` is made unless given."""
        if linearization is None:
            linearization = self.dynamics.linearize(trajectory)
        expansion = Expansion(*(part.copy() for part in self._prepared))
        for term in self._terms:
            term.expand(trajectory, linearization, expansion)
        return expansion

    def slopes(self, trajectory: Trajectory) -> Slopes:
        """Gradients of the cost by states, controls and outputs along `trajectory`, without Jacobians of the steps."""
        dynamics = self.dynamics
        slopes = Slopes.zeros(self.horizon, dynamics.ndx, dynamics.nu, dynamics.ny)
        for term in self._terms:
            term.slopes(trajectory, slopes)
        return slopes

    def complete(self, trajectory: Trajectory, expansion: Expansion) -> tuple[Expansion, Array]:
        """Expansion about `trajectory` with the whole Hessian, from `expansion`, the Gauss-Newton one, and dJ/dy.

        Outputs enter the Hessian with their own second derivatives, contracted with dJ/dy, shape (N + 1, ny), which
        `Dynamics.hessian` takes as `weights`.
        """
        full = Expansion(*(part.copy() for part in expansion))
        weights = np.zeros((self.horizon + 1, self.dynamics.ny))
        for term in self._terms:
            term.complete(trajectory, full, weights)
        return full, weights

    def complete_ends(self, trajectory: Trajectory, linearization: Linearization, full: Expansion) -> Array:
        """Add to `full` what `complete` cannot: terms of the ends of the steps of `trajectory`, w(x_{n+1}, u_n).

        By the `linearization` of the steps. Returns what weighs the second derivatives of the steps beside the
        costates. Shape (N + 1, ndx).
        """
        costates = np.zeros((self.horizon + 1, self.dynamics.ndx))
        for term in self._terms:
            term.complete_ends(trajectory, linearization, full, costates)
        return costates

    def gradient(self, trajectory: Trajectory) -> Array:
        """Gradient dJ/dU along `trajectory` (Sideris and Bobrow 2005, (8)-(10)). Shape (N, nu).

        With free time or parameters: with these held at the trajectory's duration and the first values.
        """
        if self.unknowns is not None:
            return self.lifted.gradient(self.unknowns.extended(self, trajectory))[:, : self.dynamics.nu]
        self._check(trajectory)
        linearization = self.dynamics.linearize(trajectory)
        expansion = self.expand(trajectory, linearization)
        return adjoint(linearization.A, linearization.B, expansion.q, expansion.r)[1]

    @cached_property
    def _prepared(self) -> Expansion:
        """What the expansion has in it along every trajectory."""
        expansion = Expansion.zeros(self.horizon, self.dynamics.ndx, self.dynamics.nu)
        for term in self._terms:
            term.prepare(expansion)
        return expansion

    def scene(self) -> Scene | None:
        """What a viewer draws for this problem."""
        scene = self.dynamics.scene() if self.drawing is None else self.drawing
        marked = markers(self.costs, self.dynamics)
        return replace(scene, markers=marked) if scene is not None and marked else scene

    def checked_controls(self, U: ArrayLike, name: str = "U0") -> Array:
        """Return `U` as (N, nu); one control (nu,) is held over the horizon. Raises ValueError about `name`."""
        shape = (self.horizon, self.dynamics.nu)
        array = as_array(name, U)
        if array.shape not in (shape, shape[1:]):
            raise ValueError(f"{name} must have shape {shape} or {shape[1:]}, got {array.shape}")
        return np.array(np.broadcast_to(array, shape), order="C")
