"""Options of the methods: one frozen record each, read by `solve`, by problems, by the command line and by task files.

A name that no method has, or a value out of range, is refused wherever it was written, in one sentence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mjslq.validation import choose, describe, flag, positive

LINE_SEARCHES = ("quadratic-fit", "armijo", "goldstein", "wolfe", "exact")
STEPS = ("closed-loop", "open-loop")
MULTIPLIERS = ("control", "state")
MODIFICATIONS = ("multiplier", "blend", "stage")
COSTATES = ("sweep", "adjoint")
CURVATURES = ("auto", "always", "never")
HESSIANS = ("newton", "gauss-newton")
GAINS = ("lqr", "subproblem", "none")
LIMITS = ("barrier", "clip")
ORDERS = ("first", "gauss-newton", "newton")
GLOBALIZERS = ("blend", "gauss-newton", "gopronto", "none")
VARIANTS = ("quasi-newton", "gradient", "conjugate", "heavy-ball", "nesterov")
STEP_RULES = ("interpolated", "armijo", "fixed", "diminishing")


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
    gradient and multipliers of control limits are not found. Half the time of a single iteration; for receding
    horizons, in which the last iterate is what the next plan goes on from, whether or not it is the best one."""

    def __post_init__(self) -> None:
        flag("lean", self.lean)
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
        flag("acceleration", self.acceleration)


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
    penalty: float = 0.01
    """The first penalty weight, relative to the size of the cost. Small ones leave room to pass an obstacle on the
    other side, large ones keep near the start."""

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("tol_violation", self.tol_violation)
        positive("penalty", self.penalty)


@dataclass(frozen=True)
class SquareRootSweepOptions:
    """Options of `square-root-sweep`."""

    tol_violation: float = 1e-6
    """Largest violation of a constraint, in its own unit."""
    cost_decrease: float = 0.1
    """c_J, the share of the cost that an iteration is to take away, at most 1; the largest one that is tried."""
    terminal_share: float = 1.0
    """c_m and c_q, the share of the error of terminal and initial equalities that an iteration corrects, at most 1."""
    path_share: float = 1.0
    """c_w, the share of other violations that it corrects, at most 1."""
    threshold: float = 1.0
    """Share of a limit from which on it counts as violated at first, at least 1 (the thesis has 1.1 once)."""
    cost_row: bool = True
    """Whether to ask for a decrease of the cost; otherwise only the constraints are met."""
    degradation: float = 0.1
    """Share of the cost by which it may rise where violations fall."""
    first: tuple[str, ...] = ()
    """Constraints that alone are corrected until the first step, equalities beside them; none for all."""
    overlap: float = 1.0
    """Share of a control limit's correction where a row of state and control acts at the same step, at most 1."""
    step: str = "closed-loop"
    """"closed-loop": rollouts under the sweep's feedback; "open-loop": the changes of the controls as they are."""
    weights: tuple[float, ...] | None = None
    """R of the changes of the controls, one a control; ones unless given."""

    def __post_init__(self) -> None:
        positive("tol_violation", self.tol_violation)
        for name in ("cost_decrease", "terminal_share", "path_share", "overlap"):
            if positive(name, getattr(self, name)) > 1.0:
                raise ValueError(f"{name} must not be above 1, got {getattr(self, name)!r}")
        if positive("threshold", self.threshold) < 1.0:
            raise ValueError(f"threshold must be at least 1, got {self.threshold!r}")
        flag("cost_row", self.cost_row)
        choose("step", self.step, STEPS)
        check_tolerance("degradation", self.degradation)
        if isinstance(self.first, str) or not all(isinstance(name, str) for name in _listed("first", self.first)):
            raise ValueError(f"first must be a list of names of constraints, got {self.first!r}")
        if self.weights is not None:
            for weight in _listed("weights", self.weights):
                positive("weights", weight)


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
        flag("rescue", self.rescue)


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
    """Options of `gradient`."""

    line_search: str = "exact"
    """"quadratic-fit", "armijo", "goldstein", "wolfe" or "exact"; see `solvers.linesearch`."""

    def __post_init__(self) -> None:
        choose("line_search", self.line_search, LINE_SEARCHES)


@dataclass(frozen=True)
class CurveOptions:
    """What `pronto` and `gopronto` have in common."""

    gains: Any = "lqr"
    """Of the projection operator: "lqr", a regulator on the linearization, made anew when it stops to stabilize;
    "subproblem", those of each direction's LQ problem (`pronto` alone); "none"; or a Policy or array (N, nu, ndx)."""
    regulator: Any = None
    """Weights of the regulator: (Q, R) or (Q, R, Q_N), each a number, a diagonal or a matrix; those of the cost's own
    second-order model unless given."""
    limits: str = "barrier"
    """"barrier" or "clip": how the limits of the controls are kept. Those of `constraints` always are by barriers."""
    barrier: float = 1e-3
    """Share of the cost that the barriers may cost at the end."""

    def __post_init__(self) -> None:
        gains = getattr(self.gains, "K", self.gains)  # of a Policy
        if isinstance(gains, str):
            choose("gains", gains, GAINS)
        elif not (isinstance(gains, np.ndarray) and gains.ndim == 3 and np.isfinite(gains).all()):
            there = ", ".join(repr(name) for name in GAINS)
            raise ValueError(
                f"gains must be one of {there}, a Policy with gains or an array (N, nu, ndx), got {gains!r}"
            )
        object.__setattr__(self, "gains", gains)
        object.__setattr__(self, "regulator", _weights(self.regulator))
        choose("limits", self.limits, LIMITS)
        positive("barrier", self.barrier)


@dataclass(frozen=True)
class ProntoOptions(CurveOptions):
    """Options of `pronto`."""

    order: str = "gauss-newton"
    """"first", "gauss-newton" or "newton": second derivatives in the LQ problem."""
    globalize: str = "blend"
    """"blend", "gauss-newton", "gopronto" or "none": what "newton" does where its LQ problem is not convex."""

    def __post_init__(self) -> None:
        super().__post_init__()
        choose("order", self.order, ORDERS)
        choose("globalize", self.globalize, GLOBALIZERS)


@dataclass(frozen=True)
class GoprontoOptions(CurveOptions):
    """Options of `gopronto`."""

    variant: str = "quasi-newton"
    """"gradient", "conjugate", "heavy-ball", "nesterov" (the paper's four) or "quasi-newton"."""
    step_rule: str = "interpolated"
    """"armijo": halving; "interpolated": halving, then the minimum of a parabola; "fixed"; "diminishing"."""
    step_size: float = 1e-3
    """Of fixed steps, and the first of diminishing ones, step_size / (k + 1)^0.6."""
    momentum: float = 0.9
    """Share of the last step that "heavy-ball" adds."""
    restarts: bool = True
    """Whether conjugate directions and momentum start anew where their tests fail."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.gains, str) and self.gains == "subproblem":
            raise ValueError("gains='subproblem' is for pronto: 'gopronto' solves no LQ problem in an iteration")
        choose("variant", self.variant, VARIANTS)
        choose("step_rule", self.step_rule, STEP_RULES)
        positive("step_size", self.step_size)
        momentum = self.momentum
        number = isinstance(momentum, (int, float, np.integer, np.floating)) and not isinstance(momentum, bool)
        if not (number and 0.0 <= momentum < 1.0):
            raise ValueError(f"momentum must be a number of at least 0 and below 1, got {momentum!r}")
        flag("restarts", self.restarts)


RECORDS: dict[str, type[Any]] = {
    "auto": AutoOptions,
    "slq": SLQOptions,
    "newton": NewtonOptions,
    "trust-region": TrustRegionOptions,
    "gradient": GradientOptions,
    "constrained": ConstrainedOptions,
    "square-root-sweep": SquareRootSweepOptions,
    "pronto": ProntoOptions,
    "gopronto": GoprontoOptions,
}
"""The record of each method."""
COMMON = ("tol", *(field.name for field in fields(Stopping)))
"""Options that every method takes; `tol` stands for both tolerances."""


def names(method: str) -> list[str]:
    """Names of all options that a method takes."""
    return [*(field.name for field in fields(RECORDS[choose("method", method, RECORDS)])), *COMMON]


def check(options: Mapping[str, Any]) -> None:
    """Refuse, by ValueError, names that no method has and values that none of those that have them takes."""
    if not isinstance(options, Mapping):
        raise ValueError(f"options must be a table of values by name, got {describe(options)}")
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


def _check_pair(name: str, given: Any, fits: Any, what: str) -> None:
    try:
        low, high = (float(value) for value in given)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not fits(low, high):
        raise ValueError(f"{name} must be a pair of numbers with {what}, got {given!r}")


def _listed(name: str, given: Any) -> list[Any]:
    """What a list or tuple holds. Raises ValueError."""
    if not isinstance(given, (list, tuple)):
        raise ValueError(f"{name} must be a list, got {given!r}")
    return list(given)


def _weights(given: Any) -> tuple[Any, ...] | None:
    """Weights of a regulator as nested tuples of numbers; whether they fit a system is for the solve to say."""
    if given is None:
        return None
    what = "regulator must be a pair (Q, R) or (Q, R, Q_N) of numbers, diagonals or matrices"
    if isinstance(given, (str, bytes)) or not hasattr(given, "__len__") or len(given) not in (2, 3):
        raise ValueError(f"{what}, got {given!r}")
    try:
        parts = [np.asarray(part, dtype=np.float64) for part in given]
    except (TypeError, ValueError):
        raise ValueError(f"{what}, got {given!r}") from None
    if any(part.ndim > 2 or not np.isfinite(part).all() or (part.ndim < 2 and (part < 0.0).any()) for part in parts):
        raise ValueError(f"{what}, finite and not negative, got {given!r}")
    return tuple(_tuples(part.tolist()) for part in parts)


def _tuples(part: Any) -> Any:
    return tuple(_tuples(entry) for entry in part) if isinstance(part, list) else part
