"""The table of methods: what each does, what it takes, and its options."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from mjslq.options import RECORDS, names
from mjslq.solvers.auto import Auto
from mjslq.solvers.constrained import Constrained
from mjslq.solvers.gradient import Gradient
from mjslq.solvers.method import Method
from mjslq.solvers.newton import Newton
from mjslq.solvers.slq import SLQ
from mjslq.solvers.trust_region import TrustRegion


@dataclass(frozen=True)
class MethodInfo:
    """An entry of the table of methods."""

    make: Callable[[Any], Method]
    """make(options) -> the method, for one solve."""
    summary: str
    """What it does, in a line."""
    needs: str
    """Derivatives that it uses."""
    record: type[Any]
    """The record of its options (`mjslq.options`)."""
    takes_states: bool = False
    """Whether it takes a guess of the states."""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    """Stopping options that differ from those of the others."""
    takes_constraints: bool = False
    """Whether it takes constraints beside the limits of the controls."""
    takes_free_start: bool = False
    """Whether it takes initial states that are free (`constraints.Initial`)."""
    takes_equalities: bool = True
    """Whether these may be equalities."""
    takes_unknowns: bool = True
    """Whether it takes free time and parameters."""
    takes_both: bool = False
    """Whether it is made for problems without constraints as well, if it takes some."""

    @property
    def options(self) -> dict[str, Any]:
        """Its own options, with their defaults."""
        return {field.name: field.default for field in fields(self.record)}


def _when_asked(module: str, name: str) -> Callable[[Any], Method]:
    """A method that is imported when it is used, so that others do not wait for what it imports."""

    def make(options: Any) -> Method:
        method: Method = getattr(importlib.import_module(f"mjslq.solvers.{module}"), name)(options)
        return method

    return make


METHODS = {
    "auto": MethodInfo(
        Auto, "Gauss-Newton first, second derivatives where it is slow, a multiplier where the model is poor",
        "first derivatives, second ones where needed", RECORDS["auto"], True, takes_free_start=True,
    ),
    "slq": MethodInfo(
        SLQ, "Gauss-Newton by LQ tracking sweeps, with a line search", "first derivatives", RECORDS["slq"], True,
        takes_free_start=True,
    ),
    "newton": MethodInfo(
        Newton, "Newton by LQ sweeps, made to descend, with a line search", "second derivatives",
        RECORDS["newton"], True,
    ),
    "trust-region": MethodInfo(
        TrustRegion, "second-order model, minimized over a ball whose size adapts", "second derivatives",
        RECORDS["trust-region"],
    ),
    "gradient": MethodInfo(
        Gradient, "steepest descent with exact line search", "first derivatives", RECORDS["gradient"]
    ),
    "constrained": MethodInfo(
        Constrained, "augmented Lagrangian about the sweeps of auto: for problems with constraints",
        "first derivatives, second ones where needed", RECORDS["constrained"], defaults={"max_iterations": 1000},
        takes_constraints=True, takes_free_start=True,
    ),
    "square-root-sweep": MethodInfo(
        _when_asked("square_root_sweep", "SquareRootSweep"),
        "constraints corrected by fixed percentages, by Potter's sweep, as McQuade's thesis has it",
        "first derivatives", RECORDS["square-root-sweep"], takes_constraints=True, takes_free_start=True,
        takes_unknowns=False,
    ),
    "pronto": MethodInfo(
        _when_asked("pronto", "Pronto"),
        "Newton over projected curves (Hauser): LQ directions, steps under a tracking controller",
        "first derivatives, second ones for order='newton'", RECORDS["pronto"], takes_constraints=True,
        takes_equalities=False, takes_unknowns=False, takes_both=True,
    ),
    "gopronto": MethodInfo(
        _when_asked("gopronto", "Gopronto"),
        "first-order steps under a tracking controller, no LQ problem in an iteration",
        "first derivatives, a few steps at a time", RECORDS["gopronto"], defaults={"max_iterations": 1000},
        takes_constraints=True, takes_equalities=False, takes_unknowns=False, takes_both=True,
    ),
}  # fmt: skip
ALIASES = {"ilqr": "slq"}
"""Other names that the field has for a method."""
CONSTRAINED = "constrained"
"""What "auto" stands for where there are constraints."""
PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "slq": {
        "sideris-bobrow": {"step": "open-loop", "acceleration": False, "rescue": False, "multiplier": None},
    },
}
"""Options by the name of a paper, for a method that is the paper's and nothing else."""


def methods() -> dict[str, MethodInfo]:
    """Methods by name: what each does, needs and can be told.

    Returns
    -------
    dict
        A record for each method, with `summary`, `needs` and `options` (name -> default) among its fields.

    Examples
    --------
    >>> mjslq.methods()["trust-region"].options["radius"]
    1.0
    """
    return dict(METHODS)


def option_names(method: str) -> list[str]:
    """Names of all options that `solve` takes for a method."""
    return names(ALIASES.get(method, method))


def settable(method: str) -> list[str]:
    """Names of all options that `solve` may take; for "auto" also those of "constrained", which it may choose."""
    routed = option_names(CONSTRAINED) if method == "auto" else []
    return list(dict.fromkeys([*option_names(method), *routed]))
