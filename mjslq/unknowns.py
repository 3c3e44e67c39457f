"""Unknowns of a problem beside its controls: the final time and parameters of the system, each within limits.

    T_min <= T <= T_max,    lower_j <= p_j <= upper_j

`Unknowns.pose` makes of a problem with such the same one without: on a system that has them as constant states, which
the first step's control sets (`dynamics.augmented`). All methods solve that one; `Problem.lifted` is it.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.bound_costs import KnotTerm
from mjslq.dynamics.augmented import Augmented
from mjslq.dynamics.dynamics import Dynamics
from mjslq.lift import Lift
from mjslq.lq.box import Box
from mjslq.step_lengths import warn_of_constants
from mjslq.time_costs import UnusedControls
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose, frozen

if TYPE_CHECKING:
    from mjslq.problem import Problem

TIME = "final time"
"""What results call the final time among the unknowns."""
_TARGETS = ("target", "x_target", "u_target", "lower", "upper")
"""Fields of terms that may be functions of time."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Names, limits and first values of what is unknown."""

    names: tuple[str, ...]
    """The final time first, if it is free."""
    lower: Array
    """Shape (np,)."""
    upper: Array
    """Shape (np,)."""
    timed: bool
    """Whether the final time is free."""

    @staticmethod
    def of(dynamics: Dynamics, N: int, free_time: Any, free_parameters: Any) -> Unknowns | None:
        """What a user wrote down; None where nothing is free. Raises ValueError."""
        if not isinstance(free_parameters, Mapping):
            raise ValueError(
                f"free_parameters must be a mapping from names to (lower, upper), got {type(free_parameters).__name__}"
            )
        pairs = {} if free_time is None else {TIME: _time(free_time)}
        for name, pair in free_parameters.items():
            if not dynamics.parameter_names:
                raise ValueError(
                    f"free_parameters: the system has no parameter {name!r}, nor any other; name them when it is made, "
                    f"as in FunctionDynamics(..., parameters={{{str(name)!r}: 1.0}})"
                )
            try:
                choose("parameter", name, dynamics.parameter_names)
            except ValueError as error:
                raise ValueError(f"free_parameters: {error}") from None
            pairs[name] = _pair(f"free_parameters[{name!r}]", pair, "(lower, upper)")
        if not pairs:
            return None
        if len(pairs) < len(free_parameters) + (free_time is not None):
            raise ValueError(f"free_parameters: {TIME!r} is what the final time is called; choose another name")
        limits = np.array(list(pairs.values()))
        made = Unknowns(tuple(pairs), frozen(limits[:, 0].copy()), frozen(limits[:, 1].copy()), free_time is not None)
        try:
            made.system(dynamics, N).at(made.start(dynamics, N))
        except ValueError as error:
            raise ValueError(f"{'free_time' if made.timed else 'free_parameters'}: {error}") from None
        return made

    def check(self, problem: Problem) -> None:
        """Refuse what belongs to given times, at which there may be no knot once the final time is free.

        Raises ValueError, and warns of functions that hold the length of a step as a number (`mjslq.step_lengths`).
        """
        if not self.timed:
            return
        named: list[tuple[str, Any]] = [(f"costs[{i}]", term) for i, term in enumerate(problem.costs)]
        named += [(f"constraints[{i}]", term) for i, term in enumerate(problem.constraints)]
        for what, term in named:
            for name in _TARGETS:
                if callable(getattr(term, name, None)):
                    raise ValueError(
                        f"{what}: {name} is a function of time, but the final time is free, and with it the times of "
                        f"the knots; give an array with a row for each knot, or a costs.Residual, which sees the time"
                    )
        acting = [(term.label, term.knots) for term in problem.bound_terms if isinstance(term, KnotTerm)]
        acting += [(c.name, c.residual.knots) for c in problem.bound_constraints]
        for what, knots in acting:
            if knots.by_time:
                raise ValueError(
                    f"{what}: when names times, but the final time is free, and with it the times of the knots; name "
                    f"knots by their indices"
                )
        warn_of_constants(problem.dynamics, problem.horizon, named)

    def fixed(self, problem: Problem, values: Mapping[str, float]) -> Problem:
        """The problem with its unknowns at given values, by name. Raises ValueError."""
        for name in values:
            choose("name of an unknown", name, self.names)
        start = self.start(problem.dynamics, problem.horizon)
        found = np.array([values.get(name, value) for name, value in zip(self.names, start, strict=True)], np.float64)
        for name, value, low, high in zip(self.names, found, self.lower, self.upper, strict=True):
            if not low <= value <= high:
                raise ValueError(f"{name} must be within [{low:g}, {high:g}], got {value:g}")
        engine = self.system(problem.dynamics, problem.horizon).at(found)
        return replace(problem, dynamics=engine, free_time=None, free_parameters={})

    def system(self, dynamics: Dynamics, N: int) -> Augmented:
        """The system that has them as states."""
        return Augmented(dynamics, N, self.names, self.lower, self.upper, self.timed)

    def start(self, dynamics: Dynamics, N: int) -> Array:
        """First values: those of the system as it was given, within the limits. Shape (np,)."""
        return np.clip(self.system(dynamics, N).nominal, self.lower, self.upper)

    def pose(self, problem: Problem) -> Problem:
        """The problem on the augmented system."""
        N = problem.horizon
        system = self.system(problem.dynamics, N)
        shares = np.concatenate([[0.0], np.cumsum(problem.dynamics.steps(N)) / system.duration])
        lift, made = Lift(system, shares), copy.copy(problem)
        store = object.__setattr__
        for name in ("lifted", "_prepared"):
            made.__dict__.pop(name, None)
        terms = [term.lifted(lift) for term in problem.bound_terms]
        free = problem.free_start
        fields: dict[str, Any] = {
            "unknowns": None,
            "dynamics": system,
            "x0": frozen(system.state(np.asarray(problem.x0))),
            "box": self._box(problem.box),
            "bound_constraints": tuple(c.lifted(lift) for c in problem.bound_constraints),
            "free_start": None if free is None else np.append(free, np.zeros(len(self.names), np.bool_)),
            "U0": frozen(self.controls(np.asarray(problem.U0), np.clip(system.nominal, self.lower, self.upper))),
            "_terms": (*terms, UnusedControls(lift)),
        }
        for name, value in fields.items():
            store(made, name, value)
        return made

    def held(self, lifted: Problem, time: float) -> Problem:
        """The problem on the augmented system with its final time held. [s]"""
        lower, upper = (np.array(side) for side in lifted.box)
        lower[0, -len(self.names)] = upper[0, -len(self.names)] = time
        made = copy.copy(lifted)
        object.__setattr__(made, "box", Box(lower, upper))
        return made

    def controls(self, U: Array, values: Array) -> Array:
        """Controls (N, nu) and values (np,) as controls of the augmented system. Shape (N, nu + np)."""
        W = np.zeros((len(U), len(values)))
        W[0] = values
        return np.hstack([U, W])

    def values_of(self, problem: Problem, guess: Any) -> Array:
        """Values to start from: those of a guess, as far as it has some, within the limits. Shape (np,)."""
        values = self.start(problem.dynamics, problem.horizon)
        dt = guess_dt(guess)
        if self.timed and dt is not None:
            values[0] = float(dt.sum())
        found = getattr(guess, "unknowns", {})
        values = np.array([found.get(name, value) for name, value in zip(self.names, values, strict=True)])
        return np.clip(values, self.lower, self.upper)

    def begins_held(self, guess: Any) -> bool:
        """Whether a search begins with the final time held: where it is free, and no result is given to start from."""
        return self.timed and bool(self.lower[0] < self.upper[0]) and not hasattr(guess, "multipliers")

    def extended(
        self, problem: Problem, trajectory: Trajectory, values: Mapping[str, float] | None = None
    ) -> Trajectory:
        """A trajectory of the problem as its user sees it, as one of the augmented system.

        Its duration is the trajectory's unless values are given; parameters, which a trajectory does not tell, are the
        first values.
        """
        system = problem.lifted.dynamics
        assert isinstance(system, Augmented)
        found = self.values_of(problem, trajectory)
        if values is not None:
            found = np.array([values[name] for name in self.names])
        return system.extended(trajectory, found)

    def _box(self, box: Box) -> Box:
        """Limits of the first step's values; the others have no effect and no limits."""
        N, size = len(box.lower), len(self.names)
        lower, upper = np.full((N, size), -np.inf), np.full((N, size), np.inf)
        lower[0], upper[0] = self.lower, self.upper
        return Box(np.hstack([box.lower, lower]), np.hstack([box.upper, upper]))


def guess_dt(guess: Any) -> Array | None:
    """Step lengths of a guess that is a trajectory, a policy or a result; None of others. Shape (steps,)."""
    dt = getattr(guess, "dt", getattr(getattr(guess, "trajectory", None), "dt", None))
    return None if dt is None else np.asarray(dt)


def _time(given: Any) -> tuple[float, float]:
    lower, upper = _pair("free_time", given, "(T_min, T_max)")
    if lower <= 0.0:
        raise ValueError(f"free_time: T_min must be above zero, got {lower:g}")
    return lower, upper


def _pair(name: str, given: Any, words: str) -> tuple[float, float]:
    try:
        lower, upper = (float(limit) for limit in given)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a pair {words}, got {given!r}") from None
    if not lower <= upper or (np.isinf(lower) and np.isinf(upper) and lower == upper):
        raise ValueError(f"{name} must be a pair {words} with the lower one first, got {given!r}")
    return lower, upper
