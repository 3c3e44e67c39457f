"""From how many starts a problem is solved: perturbed initial states and controls, default settings.

    x_0 <- x_0 (+) s_x e,    U_0 <- [ U_0 + s_u w ],    e from the normal distribution, w half noise, half a slow curve

[.] clips to the limits. s_u is told relative to half the range of the controls, or to their size at the start where
there is none. An arm without damping blows up under such controls: where `wander` is given, the start is that of a
servo which follows a random curve of positions, x_0 + wander w, instead.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mjslq import problems
from mjslq.dynamics.dynamics import Feedback
from mjslq.optimize import solve
from mjslq.problem import Problem
from mjslq.result import Result
from mjslq.starts import servo
from mjslq.validation import Array


class Case(NamedTuple):
    """A problem of the catalogue, and how far its starts are moved."""

    problem: str
    parameters: dict[str, Any] = {}  # noqa: RUF012 (never written to)
    states: float | Array = 0.05
    """s_x."""
    controls: float = 0.1
    """s_u."""
    wander: float = 0.0
    """Of the servo's targets; 0 for controls with noise instead. [rad or m]"""


CASES = {
    "cart-pole 5 N": Case("cart_pole"),
    "cart-pole without limit": Case("cart_pole", {"limit": 0.0}),
    "cart-pole 2.5 N": Case("cart_pole", {"limit": 2.5}),
    "double pendulum 8 and 4 Nm": Case("double_pendulum"),
    "acrobot 10 Nm": Case("acrobot"),
    "panda_reach with effort limits": Case("panda_reach", {"limits": True}, wander=0.1),
}


@dataclass(frozen=True)
class Row:
    """Outcomes of the starts of one case."""

    case: str
    results: list[Result]

    @property
    def solved(self) -> int:
        """Starts from which the solve converged."""
        return sum(result.success for result in self.results)

    @property
    def iterations(self) -> Array:
        """Iterations from each start."""
        return np.array([result.iterations for result in self.results])

    @property
    def costs(self) -> Array:
        """Cost reached from each start."""
        return np.array([result.cost for result in self.results])

    @property
    def seconds(self) -> float:
        """Median time of a solve. [s]"""
        return float(np.median([result.seconds for result in self.results]))

    @property
    def failures(self) -> str:
        """How the others ended."""
        endings = Counter(result.status.value for result in self.results if not result.success)
        return ", ".join(f"{count} {status}" for status, count in endings.items())

    def as_dict(self) -> dict[str, Any]:
        """The numbers."""
        numbers = {"iterations": self.iterations.tolist(), "costs": self.costs.tolist(), "seconds": self.seconds}
        return {"case": self.case, "solved": self.solved, **numbers, "violation": self.violation}

    @property
    def violation(self) -> float:
        """Largest distance of a control from its limits, over all results."""
        beyond = [np.maximum(r.lower - r.trajectory.U, r.trajectory.U - r.upper).max() for r in self.results]
        return max(0.0, float(max(beyond)))


def measure(name: str, starts: int = 20, method: str = "auto", *, first: int = 0, **options: Any) -> Row:
    """Solve one of `CASES` from `starts` perturbed starts, those of the seeds `first`, `first` + 1, ..."""
    case = CASES[name]
    problem = problems.get(case.problem, **case.parameters)
    seeds = range(first, first + starts)
    return Row(name, [solve(perturbed(problem, s, case), method, keep_iterates=False, **options) for s in seeds])


def perturbed(problem: Problem, seed: int, case: Case) -> Problem:
    """`problem` from another start, as the head of this file says."""
    rng, dynamics, N = np.random.default_rng(1000 + seed), problem.dynamics, problem.horizon
    x0 = np.asarray(problem.x0)
    moved = problem.at(dynamics.integrate(x0, case.states * rng.standard_normal(dynamics.ndx)))
    if case.wander:
        return dataclasses.replace(moved, U0=_followed(moved, case.wander * _curve(rng, N + 1, dynamics.nv)))
    reach, U0 = 0.5 * (problem.box.upper - problem.box.lower), np.array(problem.U0)
    size = np.where(np.isfinite(reach), reach, np.maximum(np.abs(U0), 1.0))
    return dataclasses.replace(moved, U0=U0 + case.controls * size * _curve(rng, N, dynamics.nu))


def _followed(problem: Problem, positions: Array) -> Array:
    """Controls of a servo that follows a curve of positions (N + 1, nv) about the initial state. Shape (N, nu)."""
    dynamics, policy = problem.dynamics, servo(problem)
    assert policy.K is not None
    X = dynamics.integrate(policy.X, np.pad(positions, ((0, 0), (0, dynamics.ndx - dynamics.nv))))
    feedback = Feedback(X, policy.K, problem.box.lower, problem.box.upper)
    return np.array(dynamics.rollouts(np.asarray(problem.x0)[None], policy.U[None].copy(), feedback)[0].U)


def _curve(rng: np.random.Generator, length: int, size: int) -> Array:
    """Half white noise, and three slow waves. Shape (length, size)."""
    t = np.linspace(0.0, np.pi, length)[:, None]
    waves = [rng.standard_normal((1, size)) * np.sin(k * t + rng.uniform(0.0, 6.3, (1, size))) for k in (1, 2, 3)]
    curve: Array = 0.5 * rng.standard_normal((length, size)) + sum(waves) / 1.5
    return curve
