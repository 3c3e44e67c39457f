"""`mjslq bench`: what an iteration costs on this machine, phase by phase, beside the engine's own calls.

For each problem: milliseconds of a rollout, of a linearization (each way there is), of a sweep, and of a whole SLQ
iteration, as it is measured in a solve. Beside them "bare": the `mjd_transitionFD` (one-sided) and `mj_step` calls
that an iterative LQR over the same horizon needs at least, called knot by knot. Times are the least of several
repeats, and only ratios within one run mean anything across machines.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from mjslq import problems
from mjslq._solve import solve
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.lq.riccati import LQProblem
from mjslq.lq.riccati import solve as sweep
from mjslq.problem import Problem
from mjslq.solvers._iterate import Iterate
from mjslq.trajectory import Trajectory

BUDGET = 0.6
"""Time spent on repeating one measurement, at most. [s]"""
ITERATIONS = 10
"""Iterations of the solve that is timed."""


@dataclass(frozen=True)
class Row:
    """One problem measured. Times in [ms]."""

    case: str
    engine: str
    N: int
    nx: int
    nu: int
    rollout: float
    linearize: dict[str, float]
    """By way of differentiation."""
    sweep: float
    iteration: float
    rollouts_per_iteration: float
    bare: dict[str, float] = field(default_factory=dict)
    """mjd_transitionFD and mj_step over the horizon; empty for other engines."""

    @property
    def ratio_to_bare(self) -> float | None:
        """A whole iteration over the bare calls of today's iLQR."""
        return self.iteration / sum(self.bare.values()) if self.bare else None

    @property
    def ratio_of_jacobians(self) -> float | None:
        """Bare mjd_transitionFD over our best linearization."""
        return self.bare["mjd_transitionFD"] / min(self.linearize.values()) if self.bare else None

    def as_dict(self) -> dict[str, Any]:
        """Everything, the ratios included."""
        return asdict(self) | {"ratio_to_bare": self.ratio_to_bare, "ratio_of_jacobians": self.ratio_of_jacobians}


CASES: dict[str, Callable[[], Problem]] = {
    "hopper": lambda: problems.get("hopper"),
    "panda_reach": lambda: problems.get("panda_reach"),
    "panda_reach, pinocchio": lambda: problems.get("panda_reach", engine="pinocchio"),
    "solo12 in flight": lambda: _solo12_in_flight(),
    "solo12 on its feet": lambda: problems.get("solo12_stand"),
    "g1 on its feet": lambda: problems.get("g1_reach"),
}


def run(case: str) -> Row:
    """Measure one of `CASES`."""
    return measure(case, CASES[case]())


def growth(name: str = "panda_reach", horizons: tuple[int, ...] = (100, 200, 500, 1000)) -> dict[int, float]:
    """Milliseconds of rollout, linearization and sweep together, by horizon."""
    found = {}
    for N in horizons:
        row = measure(name, problems.get(name, horizon=N, duration=0.01 * N), iterate=False)
        found[N] = row.rollout + min(row.linearize.values()) + row.sweep
    return found


def measure(case: str, problem: Problem, *, iterate: bool = True) -> Row:
    """Measure `problem` along the trajectory that some iterations lead to."""
    result = solve(problem, max_iterations=ITERATIONS if iterate else 2, keep_iterates=False)
    trajectory, dynamics = result.trajectory, problem.dynamics
    U = np.array(trajectory.U)
    lq = _lq_problem(problem, trajectory)
    spent = [entry for entry in result.log if entry.alpha > 0.0]
    seconds = min(_once(problem) for _ in range(3)) if iterate else float("nan")
    return Row(
        case=case,
        engine=type(dynamics).__name__.removesuffix("Dynamics").lower(),
        N=problem.horizon,
        nx=dynamics.nx,
        nu=dynamics.nu,
        rollout=milliseconds(lambda: dynamics.rollout(problem.x0, U)),
        linearize={mode: milliseconds(call) for mode, call in _linearizations(dynamics, trajectory).items()},
        sweep=milliseconds(lambda: sweep(lq)),
        iteration=1e3 * seconds,
        rollouts_per_iteration=sum(entry.evaluations for entry in spent) / max(len(spent), 1),
        bare=_bare(dynamics, trajectory) if isinstance(dynamics, MujocoDynamics) else {},
    )


def milliseconds(call: Callable[[], Any]) -> float:
    """Least time of `call` over repeats within the budget, after one to warm up. [ms]"""
    call()
    best, end = np.inf, time.perf_counter() + BUDGET
    while True:
        begin = time.perf_counter()
        call()
        now = time.perf_counter()
        best = min(best, now - begin)
        if now > end:
            return 1e3 * best


def _once(problem: Problem) -> float:
    """Seconds an iteration of a solve, all included."""
    begin = time.perf_counter()
    result = solve(problem, max_iterations=ITERATIONS, keep_iterates=False)
    return (time.perf_counter() - begin) / max(result.iterations, 1)


def _lq_problem(problem: Problem, trajectory: Trajectory) -> LQProblem:
    here = Iterate(problem, trajectory)
    A, B = here.linearization.A, here.linearization.B
    Q, R, M, q, r = here.expansion
    return LQProblem(A, B, Q, R, M, q, r, np.zeros(A.shape[:2]))


def _linearizations(dynamics: Any, trajectory: Trajectory) -> dict[str, Callable[[], Any]]:
    if not isinstance(dynamics, MujocoDynamics):
        return {"analytic": lambda: dynamics.linearize(trajectory)}
    other = MujocoDynamics.from_model(dynamics.model, jacobian="transition", centered=False, threads=1)
    ways = {"transition": lambda: other.linearize(trajectory)}
    if dynamics.jacobian != "transition":
        best = MujocoDynamics.from_model(dynamics.model, jacobian=dynamics.jacobian, threads=1)
        ways[dynamics.jacobian] = lambda: best.linearize(trajectory)
    return ways


def _bare(dynamics: MujocoDynamics, trajectory: Trajectory) -> dict[str, float]:
    """mjd_transitionFD and mj_step at every knot, by MuJoCo's own bindings."""
    import mujoco

    model, data = dynamics.model, mujoco.MjData(dynamics.model)
    nq, nv = model.nq, model.nv
    A, B = np.zeros((dynamics.ndx, dynamics.ndx)), np.zeros((dynamics.ndx, dynamics.nu))

    def place(n: int) -> None:
        data.qpos[:], data.qvel[:] = trajectory.X[n, :nq], trajectory.X[n, nq : nq + nv]
        data.act[:], data.ctrl[:] = trajectory.X[n, nq + nv :], trajectory.U[n]

    def differentiate() -> None:
        for n in range(trajectory.horizon):
            place(n)
            mujoco.mjd_transitionFD(model, data, 1e-6, False, A, B, None, None)

    def step() -> None:
        place(0)
        for u in trajectory.U:
            data.ctrl[:] = u
            mujoco.mj_step(model, data)

    return {"mjd_transitionFD": milliseconds(differentiate), "mj_step": milliseconds(step)}


def _solo12_in_flight() -> Problem:
    """The quadruped thrown up from a metre's height: no contact within the horizon."""
    import dataclasses

    problem = problems.get("solo12_stand", horizon=40)
    x0 = np.array(problem.x0)
    x0[2], x0[problem.dynamics.nx - problem.dynamics.ndx // 2 + 2] = 1.0, 2.0
    return dataclasses.replace(problem, x0=x0)
