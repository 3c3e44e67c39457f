"""Options of the methods: one frozen record each, read by `solve`, by problems, by the command line and by task files.

A name that no method has, or a value out of range, is refused wherever it was written, in one sentence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mjslq.validation import choose, positive

LINE_SEARCHES = ("quadratic-fit", "armijo", "goldstein", "wolfe", "exact")
STEPS = ("closed-loop", "open-loop")
MULTIPLIERS = ("control", "state")
MODIFICATIONS = ("multiplier", "blend", "stage")
COSTATES = ("sweep", "adjoint")
CURVATURES = ("auto", "always", "never")
HESSIANS = ("newton", "gauss-newton")


@dataclass(frozen=True)
class Stopping:
    """When a solve is over; every method takes these."""

    tol_direction: float = 1e-6
    """On the change of the controls that the method proposes, ||dU||, relative to ||U||; 0 leaves the test to the
    gradient."""
    tol_gradient: float = 1e-6
    """On the norm of the projected gradient dJ/dU, absolute; 0 leaves the test to the direction."""
    max_iterations: int = 300
    """Steps, tried ones that were rejected included."""
    deadline: float | None = None
    """Wall time after which the best iterate has to do. [s]"""
    lean: bool = False
    """Whether the last of `max_iterations` ends with its step: the gains are those of the iterate before it, and
    gradient and multipliers are not found. Half the time of a single iteration; for receding horizons."""

    def __post_init__(self) -> None:
        _check_flag("lean", self.lean)
        for name in ("tol_direction", "tol_gradient"):
            check_tolerance(name, getattr(self, name))
        limit = self.max_iterations
        if isinstance(limit, bool) or not isinstance(limit, (int, np.integer)) or limit < 0:
            raise ValueError(f"max_iterations must be a whole number of at least 0, got {limit!r}")
        if self.deadline is not None:
            positive("deadline", self.deadline)


@dataclass(frozen=True)
class Search:
    """How far to go along a direction, and how."""

    line_search: str = "quadratic-fit"
    """"quadratic-fit", "armijo", "goldstein", "wolfe" or "exact"; see `solvers.linesearch`."""
    step: str = "closed-loop"
    """"closed-loop": candidates are simulated under the sweep's feedback, which unstable systems need.
    "open-loop": the change of the controls is added as it is."""
    acceleration: bool = True
    """After a step that had to be shortened, search along the previous change of the controls, too."""

    def __post_init__(self) -> None:
        choose("line_search", self.line_search, LINE_SEARCHES)
        choose("step", self.step, STEPS)
        _check_flag("acceleration", self.acceleration)


@dataclass(frozen=True)
class AutoOptions:
    """Options of `auto`."""

    curvature: str = "auto"
    """"auto": second derivatives where Gauss-Newton is slow; "always", "never"."""

    def __post_init__(self) -> None:
        choose("curvature", self.curvature, CURVATURES)


@dataclass(frozen=True)
class ConstrainedOptions(AutoOptions):
    """Options of `constrained`, beside those of `auto`, whose sweeps it uses."""

    tol_violation: float = 1e-6
    """Largest violation of a constraint, in its own unit."""
    penalty: float = 0.1
    """The first penalty weight, relative to the size of the cost. Small ones leave room to pass an obstacle on the
    other side, large ones keep near the start."""

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("tol_violation", self.tol_violation)
        positive("penalty", self.penalty)


@dataclass(frozen=True)
class SLQOptions(Search):
    """Options of `slq`."""

    multiplier: str | None = None
    """"control" or "state": what a Levenberg-Marquardt multiplier keeps near the iterate (`lq.regularize`). Without
    it, one on the controls comes in only where the line search fails."""
    damping: float = 1e-3
    """The multiplier to start with, relative to the largest weight of the controls or states."""
    rescue: bool = True
    """Where the line search finds no step, try full steps with a growing multiplier."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.multiplier is not None:
            choose("multiplier", self.multiplier, MULTIPLIERS)
        positive("damping", self.damping)
        _check_flag("rescue", self.rescue)


@dataclass(frozen=True)
class NewtonOptions(Search):
    """Options of `newton`."""

    modification: str = "multiplier"
    """"multiplier", "blend" or "stage": how an indefinite Hessian is made positive definite."""
    costates: str = "sweep"
    """"sweep" or "adjoint": with which the curvature of the dynamics is weighed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        choose("modification", self.modification, MODIFICATIONS)
        choose("costates", self.costates, COSTATES)


@dataclass(frozen=True)
class TrustRegionOptions:
    """Options of `trust-region`."""

    radius: float = 1.0
    """Delta^0, the first radius, in the norm ||v||^2 = sum_n h_n v_n'v_n."""
    eta: tuple[float, float] = (0.25, 0.75)
    """Ratios from which on a step is accepted, and the ball enlarged; 0 < eta_1 < eta_2 < 1."""
    gamma: tuple[float, float] = (0.25, 2.0)
    """Factors by which the ball shrinks and grows; 0 < gamma_1 < 1 < gamma_2."""
    hessian: str = "newton"
    """"newton" or "gauss-newton": with or without the second derivatives of the dynamics."""
    step: str = "closed-loop"
    """"closed-loop": v under the sweep's feedback; "open-loop": u + v, the paper's."""

    def __post_init__(self) -> None:
        positive("radius", self.radius)
        _check_pair("eta", self.eta, lambda low, high: 0.0 < low < high < 1.0, "0 < eta_1 < eta_2 < 1")
        _check_pair("gamma", self.gamma, lambda low, high: 0.0 < low < 1.0 < high, "0 < gamma_1 < 1 < gamma_2")
        choose("hessian", self.hessian, HESSIANS)
        choose("step", self.step, STEPS)


@dataclass(frozen=True)
class GradientOptions:
    """`gradient` has no options of its own."""


RECORDS: dict[str, type[Any]] = {
    "auto": AutoOptions,
    "slq": SLQOptions,
    "newton": NewtonOptions,
    "trust-region": TrustRegionOptions,
    "gradient": GradientOptions,
    "constrained": ConstrainedOptions,
}
"""The record of each method."""
COMMON = ("tol", *(field.name for field in fields(Stopping)))
"""Options that every method takes; `tol` stands for both tolerances."""


def names(method: str) -> list[str]:
    """Names of all options that a method takes."""
    return [*(field.name for field in fields(RECORDS[choose("method", method, RECORDS)])), *COMMON]


def check(options: Mapping[str, Any]) -> None:
    """Refuse, by ValueError, names that no method has and values that none of those that have them takes."""
    known = dict.fromkeys(name for method in RECORDS for name in names(method))
    for name, value in options.items():
        choose("option", name, known)
        if name == "tol":
            check_tolerance(name, value)
        records: list[type[Any]] = [Stopping, *RECORDS.values()]
        for record in records:
            if name in (field.name for field in fields(record)):
                record(**{name: value})


def check_tolerance(name: str, value: Any) -> None:
    """Refuse, by ValueError, what is no number of at least 0."""
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not (number and 0.0 <= value < np.inf):
        raise ValueError(f"{name} must be a number of at least 0, got {value!r}")


def _check_flag(name: str, value: Any) -> None:
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be True or False, got {value!r}")


def _check_pair(name: str, given: Any, fits: Any, what: str) -> None:
    try:
        low, high = (float(value) for value in given)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not fits(low, high):
        raise ValueError(f"{name} must be a pair of numbers with {what}, got {given!r}")
