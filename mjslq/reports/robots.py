"""Robots of the catalogue from perturbed starts: how often the task is done, after how many iterations, in what time.

A start is moved as in `reports.starts`, feet and fingers staying where they are. A task counts as done at the first
iterate that meets it, in the task's own units, whether or not the solve has converged by then; a solve has as many
iterations as the case says, by default settings. Beside that: how many of the solves converged, how deep bodies sank
into each other, and whether any control has left its limits.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from mjslq import problems
from mjslq.costs import State
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.optimize import solve
from mjslq.problem import Problem
from mjslq.problems import box_push, solo12_flip
from mjslq.problems.panda_reach import OPTIMAL_COST
from mjslq.problems.solo12_stand import spring_legs
from mjslq.reports.starts import Case as Start
from mjslq.reports.starts import perturbed
from mjslq.reports.tables import table
from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

Met = Callable[[Problem, Trajectory], bool]


class Case(NamedTuple):
    """A task, how far its starts are moved, and what counts."""

    problem: str
    parameters: dict[str, Any]
    states: float
    """Standard deviation of the start's positions and velocities. [rad, m, rad/s, m/s]"""
    controls: float
    """Of the first controls, relative to their limits."""
    most: int
    """Iterations within which the task has to be done."""
    wanted: int
    """Starts of 20 from which it is to be done."""
    met: Met
    says: str
    """What `met` asks, in words."""
    guessed: bool = False
    """Whether the start is a guess of the states: the arm rests in a perturbed posture all along. Its controls cannot
    be moved, since without damping it blows up."""


def _upright(problem: Problem, trajectory: Trajectory) -> bool:
    away = np.abs(trajectory.X[-1])
    nv = problem.dynamics.nv
    return bool(away[:nv].max() < 0.05 and away[nv:].max() < 0.3)


def _waypoint(problem: Problem, trajectory: Trajectory) -> bool:
    goal = _final(problem)
    away = problem.dynamics.difference(goal, trajectory.X[-1])
    return bool(np.linalg.norm(away[:3]) < 0.02 and np.linalg.norm(away[3:6]) < 0.05 and np.abs(away[6:]).max() < 0.2)


def _panda(problem: Problem, trajectory: Trajectory) -> bool:
    return bool(problem.cost(trajectory) < OPTIMAL_COST * (1.0 + 1e-5))


def _stands(problem: Problem, trajectory: Trajectory) -> bool:
    goal = _final(problem)
    x, nq = trajectory.X[-1], trajectory.X.shape[1] - problem.dynamics.nv
    tilt = 2.0 * np.hypot(x[4], x[5])
    return bool(np.linalg.norm(x[:3] - goal[:3]) < 0.03 and tilt < 0.1 and np.abs(x[nq : nq + 6]).max() < 0.3)


def _final(problem: Problem) -> Array:
    """Target of the cost at the end."""
    found = next(term.target for term in problem.costs if isinstance(term, State) and term.when == "terminal")
    return np.asarray(found, dtype=np.float64)


def _jumps(problem: Problem, trajectory: Trajectory) -> bool:
    top = trajectory.X[trajectory.horizon // 2, 2]
    return bool(abs(top - problem.parameters["height"]) < 0.03) and _stands(problem, trajectory)


def _flips(problem: Problem, trajectory: Trajectory) -> bool:
    return bool(abs(solo12_flip.turned(trajectory) + 2.0 * np.pi) < 0.1) and _stands(problem, trajectory)


def _reaches(problem: Problem, trajectory: Trajectory) -> bool:
    target = [problem.parameters[name] for name in "xyz"]
    return bool(np.linalg.norm(trajectory.Y[-1, :3] - target) < 0.01)


def _pushed(problem: Problem, trajectory: Trajectory) -> bool:
    given = problem.parameters
    distance, angle = box_push.errors(trajectory, np.array([given["x"], given["y"], 0.05]), given["yaw"])
    return distance < 0.02 and angle < 0.1


_UP = "0.05 rad (m), 0.3 rad/s (m/s) from upright"
_STANDS = "base within 3 cm, 0.1 rad, 0.3 m/s"
_PUSHED = "box within 2 cm, 0.1 rad"
_PANDA = "cost within 1e-5 of 0.693630"
CASES: dict[str, Case] = {
    "cart-pole 5 N": Case("cart_pole", {}, 0.05, 0.1, 40, 20, _upright, _UP),
    "double pendulum": Case("double_pendulum", {}, 0.05, 0.1, 25, 20, _upright, _UP),
    "acrobot 10 Nm": Case("acrobot", {}, 0.05, 0.1, 150, 18, _upright, _UP),
    "quadrotor, 90 deg": Case("quadrotor", {}, 0.1, 0.05, 50, 20, _waypoint, "2 cm, 0.05 rad, 0.2 m/s"),
    "Panda, MuJoCo": Case("panda_reach", {}, 0.02, 0.0, 25, 20, _panda, _PANDA, True),
    "Panda, Pinocchio": Case("panda_reach", {"engine": "pinocchio"}, 0.02, 0.0, 25, 20, _panda, _PANDA, True),
    "Solo12 stand": Case("solo12_stand", {}, 0.02, 0.02, 100, 20, _stands, _STANDS),
    "Solo12 jump": Case("solo12_jump", {}, 0.02, 0.02, 120, 18, _jumps, "apex within 3 cm, " + _STANDS),
    "G1 reach": Case("g1_reach", {}, 0.01, 0.01, 20, 20, _reaches, "hand within 1 cm"),
    "G1 push 0.5 m/s": Case("g1_push", {}, 0.01, 0.01, 40, 18, _stands, _STANDS),
    "box push": Case("box_push", {}, 0.01, 0.02, 120, 18, _pushed, _PUSHED),
    "quadrotor upside down": Case("quadrotor", {"roll": 180.0}, 0.1, 0.05, 100, 0, _waypoint, "2 cm, 0.05 rad"),
    "G1 push 0.8 m/s": Case("g1_push", {"vx": 0.8}, 0.01, 0.01, 80, 0, _stands, _STANDS),
    "Solo12 jump, 2.7 Nm": Case(
        "solo12_jump", {"limit": 2.7, "height": 0.42}, 0.02, 0.02, 120, 0, _jumps, "apex within 3 cm, " + _STANDS
    ),
    "Solo12 jump, stiff": Case(
        "solo12_jump", {"contact": "stiff"}, 0.02, 0.02, 120, 0, _jumps, "apex within 3 cm, " + _STANDS
    ),
    "Solo12 flip": Case("solo12_flip", {}, 0.02, 0.02, 120, 0, _flips, "turned by 360 deg, " + _STANDS),
    "Solo12 flip, stiff": Case(
        "solo12_flip", {"contact": "stiff"}, 0.02, 0.02, 120, 0, _flips, "turned by 360 deg, " + _STANDS
    ),
    "box push, stiff": Case("box_push", {"contact": "stiff"}, 0.01, 0.02, 120, 0, _pushed, _PUSHED),
    "box push, untouched": Case(
        "box_push", {"start": "still", "foresight": 0.2}, 0.01, 0.0, 120, 0, _pushed, _PUSHED
    ),
    "box, 90 deg": Case("box_push", {"yaw": 1.5708}, 0.01, 0.02, 120, 0, _pushed, _PUSHED),
}  # fmt: skip
"""The tasks; those with a number wanted first, those beyond after them."""


@dataclass
class Row:
    """Outcomes of the starts of one case."""

    case: str
    done: list[int | None] = field(default_factory=list)
    """Iteration at which the task was done, for each start; None where it was not."""
    seconds: list[float] = field(default_factory=list)
    """Time of each solve. [s]"""
    endings: Counter[str] = field(default_factory=Counter)
    penetration: float = 0.0
    """The largest. [m]"""
    violation: float = 0.0
    """Largest distance of a control from its limits."""

    @property
    def solved(self) -> int:
        """Starts from which the task was done."""
        return sum(at is not None for at in self.done)

    @property
    def iterations(self) -> list[int]:
        """Iterations after which it was done."""
        return [at for at in self.done if at is not None]

    def as_dict(self) -> dict[str, Any]:
        """The numbers."""
        wanted, most = CASES[self.case].wanted, CASES[self.case].most
        numbers = {"done": self.done, "seconds": self.seconds, "endings": dict(self.endings)}
        told = {"penetration": self.penetration, "violation": self.violation, "says": CASES[self.case].says}
        return {"case": self.case, "solved": self.solved, "wanted": wanted, "within": most} | numbers | told


def measure(name: str, starts: int = 20, first: int = 0) -> Row:
    """Solve one of `CASES` from `starts` perturbed starts, those of the seeds `first`, `first` + 1, ..."""
    row, case = Row(name), CASES[name]
    for problem, guess in started(case, starts, first):
        result = solve(problem, guess=guess, max_iterations=case.most)
        row.done.append(first_met(case, problem, result))
        row.seconds.append(result.seconds)
        row.endings[result.status.value] += 1
        row.penetration = max(row.penetration, result.penetration)
        U = result.trajectory.U
        row.violation = max(row.violation, float(np.maximum(result.lower - U, U - result.upper).max()), 0.0)
    return row


def summary(rows: Sequence[Row]) -> Table:
    """Table with a row for each case."""
    titles = (
        "task",
        "done",
        "wanted",
        "within",
        "iterations",
        "at most",
        "seconds",
        "penetration",
        "ends",
        "done means",
    )
    found = table(*titles, title="perturbed starts, default settings: iterations until done, medians")
    for row in rows:
        case, at = CASES[row.case], row.iterations
        found.add_row(
            row.case, f"{row.solved} of {len(row.done)}", f"{case.wanted} of 20" if case.wanted else "-",
            str(case.most), f"{np.median(at):.0f}" if at else "-", str(max(at)) if at else "-",
            f"{np.median(row.seconds):.2f}", f"{1e3 * row.penetration:.1f} mm" if row.penetration else "-",
            ", ".join(f"{count} {ending}" for ending, count in row.endings.items()), case.says,
        )  # fmt: skip
    return found


def started(case: Case, starts: int, first: int = 0) -> Iterator[tuple[Problem, Array | None]]:
    """The problem of a case from perturbed starts, and a guess of the states where there is one."""
    problem = problems.get(case.problem, **case.parameters)
    moved: Array = np.full(problem.dynamics.ndx, case.states)
    if case.problem == "box_push":
        moved[[4, 5, 6]] = 0.0  # it lies on the floor
    elif case.problem.startswith(("solo12", "g1")):
        moved[:6] = 0.0  # the feet stand on it
    for seed in range(first, first + starts):
        if case.guessed:
            nv, rest = problem.dynamics.nv, np.tile(np.asarray(problem.x0), (problem.horizon + 1, 1))
            rest[:, :nv] += case.states * np.random.default_rng(seed).standard_normal(nv)
            yield problem, rest
            continue
        started = perturbed(problem, seed, Start(case.problem, {}, moved, case.controls))
        if isinstance(dynamics := problem.dynamics, MujocoDynamics) and case.problem.startswith("solo12"):
            x0 = np.asarray(started.x0)  # its legs are springs at the start, whatever the state
            legs = solo12_flip.kicking_legs if case.problem == "solo12_flip" else spring_legs
            started = dataclasses.replace(started, U0=legs(dynamics, x0, _final(problem), problem.horizon))
        yield started, None


def first_met(case: Case, problem: Problem, result: Result) -> int | None:
    """The first iteration at which the task is done, among those after which it stays so; None where the end is not."""
    if result.trajectory.diverged or not case.met(problem, result.trajectory):
        return None
    met = [not trajectory.diverged and case.met(problem, trajectory) for trajectory in result.iterates]
    failed = [i for i, good in enumerate(met) if not good]
    return min(result.iterations, failed[-1] + 1 if failed else 0)
