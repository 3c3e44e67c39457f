"""Constraints: what a trajectory has to obey, as intervals of residuals at the knots where they act.

    lower <= r(x_n, u_n, t_n) <= upper

    State       r = x                    Sensor      r = a reading of the engine, or of a Frame
    Path        r = w(x, u, t) <= 0      Terminal    r = m(x_N) = 0
    Initial     r = q(x_0) = 0, with x_0, or some of its entries, unknown
    Control     limits of the controls, which hold exactly and at every step, beside those of the problem's `bounds`

As with costs, what the user writes is a small frozen record, and `bind` fits it to a system and a horizon
(`mjslq.bound_constraints`). `when` names knots as it does for costs (`mjslq.knots`), but nothing is weighed with the
length of a step: each knot has to obey. Between the knots nothing is asked for.

Limits may be functions of time, as targets of costs may (`mjslq.targets`): on a horizon that begins at t0 they, and the
functions of `Path`, see the time t0 + t_n, while arrays and `when` belong to the knots.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mjslq import binding, residuals
from mjslq.bound_constraints import BoundConstraint, EndResidual, EntriesResidual
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.records import QUANTITIES, OfFrame, frame_sensor
from mjslq.intervals import Interval
from mjslq.knots import When, knots_of
from mjslq.lq.box import Box
from mjslq.lq.problem import Mask
from mjslq.targets import Timed
from mjslq.user_function import UserFunction
from mjslq.validation import Array, choose, function

RESERVED = "controls"
"""What results call the multipliers of the limits of the controls."""


@dataclass(frozen=True, kw_only=True)
class Constraint(ABC):
    """A constraint as a user states it; `bind` fits it to a system and a horizon."""

    name: str | None = None
    """What messages and results call it; the kind unless given, such as "path", or the sensor's name; numbered from
    the second one on."""

    @property
    def kind(self) -> str:
        """What it is called where it has no name."""
        return type(self).__name__.lower()

    @abstractmethod
    def bind(self, dynamics: Dynamics, N: int, name: str) -> BoundConstraint | Box | None:
        """Fit to a system and a horizon: limits of the controls as a `Box`, None for no limits at all.

        Raises ValueError.
        """

    def frees(self, dynamics: Dynamics) -> Mask | None:
        """Tangent directions of the initial state that it makes unknown; None for none. Shape (ndx,)."""
        return None


@dataclass(frozen=True)
class State(Constraint):
    """Limits of the entries of the state, lower <= x <= upper.

    A quaternion's entries are limited as the numbers that they are; most often they have no limits.

    >>> track = mjslq.constraints.State(lower=[-0.25, -np.inf], upper=[0.25, np.inf], name="track")
    """

    lower: ArrayLike | Timed | None = None
    """A number, one an entry, one a knot and entry, or a function of time t -> limits; -inf where there is none, None
    for none at all. Shape () | (nx,) | (N + 1, nx) | (k, nx)."""
    upper: ArrayLike | Timed | None = None
    """The same, inf where there is none."""
    when: When = "always"
    """Where it holds; see `mjslq.knots.When`."""

    def bind(self, dynamics: Dynamics, N: int, name: str) -> BoundConstraint:
        """See `Constraint.bind`."""
        knots = knots_of(self.when, dynamics.steps(N))
        interval = Interval(self.lower, self.upper, dynamics.nx, knots, N + 1, dynamics.state_names)
        lower, upper = interval()
        if interval.moves:  # which entries are limited may depend on time
            every = EntriesResidual(dynamics, np.arange(dynamics.nx), knots)
            return BoundConstraint(name, every, lower, upper, interval)
        limited = np.flatnonzero((np.isfinite(lower) | np.isfinite(upper)).any(axis=0))
        residual = EntriesResidual(dynamics, limited, knots)
        return BoundConstraint(name, residual, lower[:, limited], upper[:, limited])


@dataclass(frozen=True)
class Control(Constraint):
    """Limits of the controls, lower <= u <= upper, at every step; the problem's `bounds` hold beside them.

    >>> effort = mjslq.constraints.Control(lower=-2.0, upper=2.0, name="effort")
    """

    lower: ArrayLike | Timed | None = None
    """A number, one a control, one a step and control, or a function of time t -> limits; -inf where there is none,
    None for none at all. Shape () | (nu,) | (N, nu)."""
    upper: ArrayLike | Timed | None = None
    """The same, inf where there is none."""

    def bind(self, dynamics: Dynamics, N: int, name: str) -> Box:
        """See `Constraint.bind`."""
        return Box(*self._interval(dynamics, N)())

    def at(self, t0: float, dynamics: Dynamics, N: int) -> Box | None:
        """The limits over `N` steps of `dynamics` from `t0` [s]; None if they do not depend on time. ValueError."""
        interval = self._interval(dynamics, N)
        return Box(*interval(t0)) if interval.moves else None

    def _interval(self, dynamics: Dynamics, N: int) -> Interval:
        steps = knots_of("running", dynamics.steps(N))
        return Interval(self.lower, self.upper, dynamics.nu, steps, N, dynamics.control_names)


@dataclass(frozen=True)
class Sensor(Constraint):
    """Limits of an output of the engine: a MuJoCo sensor, such as a distance, or a frame's position.

    >>> clearance = mjslq.constraints.Sensor("hand_to_box", lower=0.02)  # [m]
    """

    sensor: str
    """The sensor's name."""
    lower: ArrayLike | Timed | None = None
    """A number, one an entry of the reading, one a knot and entry, or a function of time t -> limits; -inf where there
    is none, None for none at all. Shape () | (m,) | (N + 1, m) | (k, m)."""
    upper: ArrayLike | Timed | None = None
    """The same, inf where there is none."""
    when: When = "always"
    """Where it holds; see `mjslq.knots.When`. At the terminal knot readings are taken with zero control."""

    @property
    def kind(self) -> str:
        """See `Constraint.kind`."""
        return str(self.sensor)

    def bind(self, dynamics: Dynamics, N: int, name: str) -> BoundConstraint:
        """See `Constraint.bind`."""
        columns, quaternion = dynamics.outputs[choose("sensor", self.sensor, dynamics.outputs)]
        if quaternion:
            raise ValueError(
                f"sensor {self.sensor!r} reads an orientation, whose entries have no limits of their own; limit what "
                f"you mean by it with constraints.Path"
            )
        knots = knots_of(self.when, dynamics.steps(N))
        residual = binding.bind_output(dynamics, self.sensor, np.zeros(columns.stop - columns.start), knots)
        names = dynamics.output_names[columns]
        interval = Interval(self.lower, self.upper, residual.size, knots, N + 1, names)
        return BoundConstraint(name, residual, *interval(), interval if interval.moves else None)


@dataclass(frozen=True)
class Frame(Constraint):
    """Limits of a frame's position or velocities, in the world's axes; see `mjslq.costs.Frame` for frames.

    >>> above = mjslq.constraints.Frame("hand", lower=[-np.inf, -np.inf, 0.05])
    """

    frame: str
    """The frame's name: a body, site, geom or camera; with Pinocchio a frame of the model."""
    lower: ArrayLike | Timed | None = None
    """As in `Sensor`. Shape () | (3,) | (N + 1, 3) | (k, 3)."""
    upper: ArrayLike | Timed | None = None
    """The same, inf where there is none."""
    when: When = "always"
    """Where it holds; see `mjslq.knots.When`."""
    of: OfFrame = field(default="position", kw_only=True)
    """"position", "linear-velocity" or "angular-velocity"."""

    @property
    def kind(self) -> str:
        """See `Constraint.kind`."""
        return frame_sensor(self.frame, self.of)

    def bind(self, dynamics: Dynamics, N: int, name: str) -> BoundConstraint:
        """See `Constraint.bind`."""
        output = dynamics.frame_output(self.frame, choose("quantity of a frame", self.of, QUANTITIES))
        return Sensor(output, self.lower, self.upper, self.when).bind(dynamics, N, name)


@dataclass(frozen=True)
class Path(Constraint):
    """w(x, u, t) <= 0, or = 0, for any smooth function w.

    Plain Python is called knot by knot; a function compiled by `numba.njit` is not. See `mjslq.costs.Residual` for
    what such functions have to return.

    >>> outside = mjslq.constraints.Path(lambda x, u, t: 1.0 - x[0] ** 2 - x[1] ** 2)  # of the unit circle
    """

    w: Callable[..., Any]
    """w(x, u, t) -> (m,) or a number; at the terminal knot u is zero. Analytic in x and u unless `jacobian` is given.
    """
    equality: bool = False
    """Whether w has to be zero; otherwise it must not be positive."""
    when: When = "running"
    """Where it holds; see `mjslq.knots.When`. With at="end", the steps whose ends are meant."""
    at: Literal["start", "end"] = "start"
    """"start": w(x_n, u_n, t_n). "end": w(x_{n+1}, u_n, t_{n+1}), the end of step n with the control that led there.
    """
    jacobian: Callable[..., Any] | None = field(default=None, kw_only=True)
    """jacobian(x, u, t) -> (dw/dx (m, nx), dw/du (m, nu)); by complex step unless given."""
    parameters: ArrayLike | None = field(default=None, kw_only=True)
    """p, handed through to w(x, u, t, p) and jacobian(x, u, t, p) if given. Shape (size,)."""

    def bind(self, dynamics: Dynamics, N: int, name: str) -> BoundConstraint:
        """See `Constraint.bind`."""
        w = UserFunction("w", self.w, dynamics.nx, dynamics.nu, self.jacobian, self.parameters)
        steps = dynamics.steps(N)
        knots = knots_of(self.when, steps)
        residual: residuals.BoundResidual
        if choose("at", self.at, ("start", "end")) == "end":
            if len(knots.steps) < len(knots):
                raise ValueError(f'when must name steps with at="end", 0 to {N - 1}: no step begins at knot {N}')
            residual = EndResidual(dynamics, w, knots, np.cumsum(steps)[knots.indices])
        else:
            residual = residuals.FunctionResidual(dynamics, w, knots)
        return _function_constraint(name, residual, self.equality)


@dataclass(frozen=True)
class Terminal(Constraint):
    """m(x_N) = 0, or <= 0, for any smooth function m of the final state.

    >>> rest = mjslq.constraints.Terminal(lambda x: x[1])  # no speed at the end
    """

    m: Callable[..., Any]
    """m(x) -> (m,) or a number. Analytic in x unless `jacobian` is given."""
    equality: bool = True
    """Whether m has to be zero; otherwise it must not be positive."""
    jacobian: Callable[..., Any] | None = field(default=None, kw_only=True)
    """jacobian(x) -> dm/dx (m, nx); by complex step unless given."""

    def bind(self, dynamics: Dynamics, N: int, name: str) -> BoundConstraint:
        """See `Constraint.bind`."""
        return _of_state("m", self.m, self.jacobian, dynamics, N, "terminal", name, self.equality)


@dataclass(frozen=True)
class Initial(Constraint):
    """An initial state that is not given: q(x_0) = 0, or <= 0, or entries of x_0 that are free.

    The problem's own x0 is what the search starts from, and what entries that are not free stay at. The multiplier nu
    of q and the costate of the first knot belong together, lambda_0 = -(dq/dx)'nu on the free entries (McQuade 1989,
    (2.35)).

    >>> thrown = mjslq.constraints.Initial(free=[1])  # the first speed is to be found
    """

    q: Callable[..., Any] | None = None
    """q(x) -> (m,) or a number; None where entries are free without more. Analytic in x unless `jacobian` is given."""
    free: str | int | Sequence[str | int] | None = None
    """Entries of x_0 that are unknown, by name (`Dynamics.state_names`) or index: all of them unless given. The entries
    of a quaternion, and those of a pose on which a step acts as a whole, are free together or not at all."""
    equality: bool = True
    """Whether q has to be zero; otherwise it must not be positive."""
    jacobian: Callable[..., Any] | None = field(default=None, kw_only=True)
    """jacobian(x) -> dq/dx (m, nx); by complex step unless given."""

    def bind(self, dynamics: Dynamics, N: int, name: str) -> BoundConstraint | None:
        """See `Constraint.bind`."""
        if self.q is None:
            if self.free is None:
                raise ValueError("give q(x), the entries of the initial state that are free, or both")
            return None
        return _of_state("q", self.q, self.jacobian, dynamics, N, "initial", name, self.equality)

    def frees(self, dynamics: Dynamics) -> Mask:
        """See `Constraint.frees`. Raises ValueError."""
        space, names = dynamics.space, dynamics.state_names
        given: Any = range(space.nx) if self.free is None else self.free
        wanted = np.zeros(space.nx, np.bool_)
        for entry in given if isinstance(given, Iterable) and not isinstance(given, str) else [given]:
            if isinstance(entry, str):
                wanted[names.index(choose("free: state", entry, names))] = True
            elif isinstance(entry, (int, np.integer)) and not isinstance(entry, bool) and -space.nx <= entry < space.nx:
                wanted[entry] = True
            else:
                raise ValueError(f"free must name entries of the state, 0 to {space.nx - 1} or names, got {entry!r}")
        if not wanted.any():
            raise ValueError("free must name at least one entry of the state")
        directions = np.zeros(space.ndx, np.bool_)
        directions[space.plain_dx] = wanted[space.plain_x]
        for part in space.parts:
            for entries, dx in zip(part.x, part.dx, strict=True):
                if wanted[entries].any() and not wanted[entries].all():
                    together = ", ".join(names[i] for i in np.sort(entries))
                    raise ValueError(f"free must name all of the entries {together} or none: they turn together")
                directions[dx] = wanted[entries].all()
        return directions


@dataclass(frozen=True)
class _OfState:
    """m(x) as a function of (x, u, t)."""

    m: Callable[..., Any]

    def __call__(self, x: Array, u: Array, t: float) -> Any:
        return self.m(x)


@dataclass(frozen=True)
class _JacobianOfState:
    """dm/dx as derivatives by x and u."""

    jacobian: Callable[..., Any]
    nu: int

    def __call__(self, x: Array, u: Array, t: float) -> tuple[Any, Array]:
        by_x = np.atleast_2d(np.asarray(self.jacobian(x), dtype=np.float64))
        return by_x, np.zeros((len(by_x), self.nu))


class BoundConstraints(NamedTuple):
    """All constraints of a problem on its horizon."""

    residuals: tuple[BoundConstraint, ...]
    boxes: tuple[Box, ...]
    """Limits of the controls."""
    free: Mask | None
    """Tangent directions of the initial state that are unknown; None for none. Shape (ndx,)."""


def bind_all(given: Any, dynamics: Dynamics, N: int) -> BoundConstraints:
    """Fit all constraints of a problem. Raises ValueError."""
    if not isinstance(given, (Constraint, Sequence)):
        raise ValueError(f"constraints must be a list of mjslq.constraints, got {type(given).__name__}")
    constraints = [given] if isinstance(given, Constraint) else list(given)
    bound: list[BoundConstraint] = []
    boxes: list[Box] = []
    free: Mask | None = None
    for i, constraint in enumerate(constraints):
        if not isinstance(constraint, Constraint):
            raise ValueError(f"constraints[{i}] must be one of mjslq.constraints, got {type(constraint).__name__}")
    for i, (constraint, name) in enumerate(zip(constraints, _names(constraints), strict=True)):
        try:
            found, frees = constraint.bind(dynamics, N, name), constraint.frees(dynamics)
        except ValueError as error:
            raise ValueError(f"constraints[{i}] ({type(constraint).__name__} {name!r}): {error}") from None
        if isinstance(found, Box):
            boxes.append(found)
        elif found is not None:
            bound.append(found)
        if frees is not None:
            free = frees if free is None else free | frees
    return BoundConstraints(tuple(bound), tuple(boxes), free)


def _names(constraints: Sequence[Constraint]) -> list[str]:
    """A name for each, the given ones as they are. Raises ValueError where two are the same."""
    taken: set[str] = {RESERVED}
    for i, constraint in enumerate(constraints):
        name = constraint.name
        if name is None:
            continue
        if not isinstance(name, str) or not name:
            raise ValueError(f"constraints[{i}]: name must be a text that is not empty, got {name!r}")
        if name in taken:
            why = "belongs to the limits of the controls" if name == RESERVED else "is another constraint's, too"
            raise ValueError(f"constraints[{i}]: name {name!r} {why}; give each constraint a name of its own")
        taken.add(name)
    names = []
    for constraint in constraints:
        name, kind, number = constraint.name, constraint.kind, 1
        while name is None:
            trial = kind if number == 1 else f"{kind} {number}"
            name, number = (None if trial in taken else trial), number + 1
        taken.add(name)
        names.append(name)
    return names


def _of_state(
    letter: str, f: Any, jacobian: Any, dynamics: Dynamics, N: int, when: When, name: str, equality: bool
) -> BoundConstraint:
    """A constraint on a function of one knot's state alone."""
    function(f"{letter}(x)", f)
    of_state = None if jacobian is None else _JacobianOfState(function("jacobian", jacobian), dynamics.nu)
    wrapped = UserFunction(letter, _OfState(f), dynamics.nx, dynamics.nu, of_state)
    residual = residuals.FunctionResidual(dynamics, wrapped, knots_of(when, dynamics.steps(N)))
    return _function_constraint(name, residual, equality)


def _function_constraint(name: str, residual: residuals.BoundResidual, equality: bool) -> BoundConstraint:
    if not isinstance(equality, bool):
        raise ValueError(f"equality must be True or False, got {equality!r}")
    upper = np.zeros((len(residual.knots), residual.size))
    return BoundConstraint(name, residual, upper if equality else np.full_like(upper, -np.inf), upper)
