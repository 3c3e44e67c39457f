"""Functions that know the length of a step as a number of their own, which a free final time does not reach.

Where the final time is free all steps stretch alike, and functions see that in the time t. A number does not stretch:

    parameters=[dt]                         an entry of what is handed through to a function
    lambda x, u: x[0] + dt * x[1]           a variable of the surroundings, or a default, whose name says so

Numbers are told by their value, which is exactly the length of a step, and variables by their names besides. What is
written out in a function, x[0] + 0.05 * x[1], is not found.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from mjslq.dynamics.dynamics import Dynamics

NAMES = frozenset(
    ("dt", "h", "ts", "step", "timestep", "time_step", "step_length", "step_size", "stepsize", "delta_t", "deltat")
)
"""Names, in small letters, under which the length of a step goes."""


def warn_of_constants(dynamics: Dynamics, N: int, terms: Iterable[tuple[str, Any]] | None) -> None:
    """Warn of functions of a system and of terms, (what, term of `costs` or `constraints`), that hold a step's length.

    Only where all steps are equally long: others are not one number. None for terms where the time is not free.
    """
    steps = dynamics.steps(N)
    if terms is None or (steps != steps[0]).any():
        return
    length = float(steps[0])
    places = [*((f"{what}: {place}") for what, term in terms for place in _places_of(term, length))]
    places += [f"dynamics: {place}" for place in _places_in_dynamics(dynamics, length)]
    if places:
        warnings.warn(
            f"{'; '.join(places)} {'are' if len(places) > 1 else 'is'} {length:g}, the length of a step as it was "
            f"given, and will not stretch with the final time, which is free; let the function read the time t, or "
            f"pose the problem anew at the time that was found",
            stacklevel=4,
        )


def _places_in_dynamics(dynamics: Dynamics, length: float) -> Iterator[str]:
    for name, value in zip(dynamics.parameter_names, getattr(dynamics, "parameters", ()), strict=False):
        if value == length and (name.lower() in NAMES or name.startswith("p[")):
            yield f"the parameter {name}"
    for given in getattr(dynamics, "functions", ()):
        yield from _variables(given, length)


def _places_of(term: Any, length: float) -> Iterator[str]:
    fields = dict(vars(term))
    numbers = fields.pop("parameters", None)
    if numbers is not None:
        for i in np.flatnonzero(np.ravel(np.asarray(numbers, dtype=np.float64)) == length):
            yield f"parameters[{i}]"
    for value in fields.values():
        if callable(value):
            yield from _variables(value, length)


def _variables(given: Callable[..., Any], length: float) -> Iterator[str]:
    """Variables of a function's surroundings, and defaults, that hold the length of a step under such a name."""
    plain = getattr(given, "py_func", given)
    if not inspect.isfunction(plain):
        return
    around = inspect.getclosurevars(plain)
    defaults = {name: each.default for name, each in inspect.signature(plain).parameters.items()}
    for name, value in {**around.globals, **around.nonlocals, **defaults}.items():
        if name.lower() in NAMES and isinstance(value, (int, float, np.number)) and float(value) == length:
            yield f"{name} in {plain.__name__}"
