"""`mjslq bench`: what an iteration costs on this machine, phase by phase, beside the engine's own calls.

For each problem: milliseconds of a rollout, of a linearization (each way there is), of a sweep (and of one without the
limits of the controls, where there are any), and of a whole iteration of `slq`: what each of the first ones adds to the
time of a solve, search and bookkeeping included. Beside them "bare": the `mjd_transitionFD`
(one-sided) and `mj_step` calls that an iterative LQR over the same horizon needs at least, and `mj_inverse`, called
knot by knot. Times are the least of several repeats, on one thread, and only ratios within one run mean anything
across machines. Errors of Jacobians are those of A against a fine reference (five-point differences), relative to its
largest entry: medians over knots.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np

from mjslq import problems
from mjslq.cores import usable_cores
from mjslq.dynamics.derivative_check import fine_reference
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.lq.box import solve_in_box
from mjslq.lq.riccati import solve as sweep
from mjslq.optimize import solve
from mjslq.problem import Problem
from mjslq.reports import bench_models as models
from mjslq.reports import train
from mjslq.solvers.iterate import Iterate
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

BUDGET = 0.6
"""Time spent on repeating one measurement, at most. [s]"""
ITERATIONS = 10
"""Iterations of the solve that is timed."""
METHOD = "slq"
"""The method that is timed."""
KNOTS = 10
"""Knots at which Jacobians are held against the fine reference."""

_KILOBYTES = 1e6 if sys.platform == "darwin" else 1e3
"""Units of ru_maxrss in a megabyte."""


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
    """Within the limits of the controls."""
    free_sweep: float
    """Without limits."""
    limited: int
    """Controls at their limits along the trajectory that is measured."""
    iteration: float
    rollouts_per_iteration: float
    bare: dict[str, float] = field(default_factory=dict)
    """mjd_transitionFD, mj_step and mj_inverse over the horizon; empty for other engines."""
    errors: dict[str, float] = field(default_factory=dict)
    """Of the Jacobians, by way of differentiation."""

    @property
    def ratio_to_bare(self) -> float | None:
        """A whole iteration over the bare calls of today's iLQR: differences of the step, and one rollout."""
        return self.iteration / (self.bare["mjd_transitionFD"] + self.bare["mj_step"]) if self.bare else None

    @property
    def ratio_to_calls(self) -> float | None:
        """A whole iteration over as many rollouts as it makes by `mj_step`, and one pass of `mj_inverse`."""
        if not self.bare:
            return None
        return self.iteration / (self.rollouts_per_iteration * self.bare["mj_step"] + self.bare["mj_inverse"])

    @property
    def ratio_of_jacobians(self) -> float | None:
        """Bare mjd_transitionFD over our best linearization."""
        return self.bare["mjd_transitionFD"] / min(self.linearize.values()) if self.bare else None

    def as_dict(self) -> dict[str, Any]:
        """Everything, the ratios included."""
        names = ("ratio_to_bare", "ratio_to_calls", "ratio_of_jacobians")
        return asdict(self) | {name: getattr(self, name) for name in names}


CASES: dict[str, Callable[[], Problem]] = {
    "hopper": lambda: problems.get("hopper"),
    "cart-pole within limits": models.cart_pole,
    "panda_reach": lambda: problems.get("panda_reach"),
    "panda_reach on pinocchio": lambda: problems.get("panda_reach", engine="pinocchio"),
    "solo12 in flight": models.solo12_in_flight,
    "solo12 on its feet": lambda: problems.get("solo12_stand"),
    "g1 on its feet": lambda: problems.get("g1_reach"),
    "box between moving plates": models.grasp,
    "four-bar linkages": models.linkages,
    "arm on four muscles": models.muscles,
    "walker that looks ahead": models.scanner,
    "double pendulum by RK4": models.runge_kutta,
}


def run(case: str) -> Row:
    """Measure one of `CASES`."""
    return measure(case, _on_one_thread(CASES[case]()))


def growth(name: str = "panda_reach", horizons: tuple[int, ...] = (100, 200, 500, 1000)) -> dict[int, float]:
    """Milliseconds of rollout, linearization and sweep together, by horizon."""
    return {N: _phases(problems.get(name, horizon=N, duration=0.01 * N)) for N in horizons}


def growth_with_states(links: tuple[int, ...] = (2, 4, 8, 16, 32)) -> dict[int, float]:
    """Milliseconds of rollout, linearization and sweep together, by the number of states of a chain of links."""
    return {2 * count: _phases(models.chain(count)) for count in links}


def growth_of_memory(name: str = "panda_reach", iterations: int = 1000) -> dict[int, float]:
    """Peak resident size in MB after some iterations and after many; empty where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return {}
    problem, found, done = problems.get(name), {}, 0
    for goal in (iterations // 10, iterations):
        while done < goal:
            result = solve(problem, METHOD, tol=0.0, max_iterations=20, keep_iterates=False)
            done += max(result.iterations, 1)
        found[goal] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _KILOBYTES
    return found


def speedup(name: str = "g1_reach") -> dict[int, float]:
    """How much faster a linearization gets by threads: 1, 2, 4, ... of the cores that may be used."""
    problem = problems.get(name)
    trajectory, model = problem.rollout(_start(problem)), _model(problem.dynamics)
    cores, counts = usable_cores(), [1]
    while 2 * counts[-1] <= cores:
        counts.append(2 * counts[-1])
    times = {}
    for threads in counts:
        dynamics = MujocoDynamics.from_model(model, threads=threads)
        times[threads] = milliseconds(partial(dynamics.linearize, trajectory))
    return {threads: times[1] / time for threads, time in times.items()}


GROWTH: dict[str, Callable[[], dict[int, float]]] = {
    "milliseconds by the horizon": growth,
    "milliseconds by the number of states": growth_with_states,
    "peak resident megabytes by iterations": growth_of_memory,
    "speed-up by threads": speedup,
    **train.GROWTH,
}
"""What is measured besides the cases: name -> measurement, a table of numbers by a number."""


def measure(case: str, problem: Problem) -> Row:
    """Measure `problem` along the trajectory that some iterations lead to."""
    result = solve(problem, METHOD, max_iterations=ITERATIONS, keep_iterates=False)
    trajectory, dynamics = result.trajectory, problem.dynamics
    U, ways = np.array(trajectory.U), _linearizations(dynamics, trajectory)
    here = Iterate(problem, trajectory)
    model, box = here.gauss_newton, here.box
    spent = [entry for entry in result.log if entry.outcome == "accepted"]
    start = milliseconds(lambda: solve(problem, METHOD, max_iterations=0, keep_iterates=False))
    whole = milliseconds(lambda: solve(problem, METHOD, max_iterations=ITERATIONS, keep_iterates=False))
    return Row(
        case=case,
        engine=type(dynamics).__name__.removesuffix("Dynamics").lower(),
        N=problem.horizon,
        nx=dynamics.nx,
        nu=dynamics.nu,
        rollout=milliseconds(lambda: dynamics.rollout(problem.x0, U)),
        linearize={mode: milliseconds(call) for mode, call in ways.items()},
        sweep=milliseconds(lambda: solve_in_box(model, box)),
        free_sweep=milliseconds(lambda: sweep(model)),
        limited=int(np.count_nonzero(result.active_limits)),
        iteration=(whole - start) / max(result.iterations, 1),
        rollouts_per_iteration=sum(entry.evaluations for entry in spent) / max(len(spent), 1),
        bare=_bare(dynamics, trajectory) if isinstance(dynamics, MujocoDynamics) else {},
        errors=_errors(dynamics, trajectory) if isinstance(dynamics, MujocoDynamics) else {},
    )


def _on_one_thread(problem: Problem) -> Problem:
    """The same problem; MuJoCo engines that use several threads are made anew."""
    if not isinstance(problem.dynamics, MujocoDynamics):
        return problem
    return dataclasses.replace(problem, dynamics=MujocoDynamics.from_model(_model(problem.dynamics), threads=1))


def _model(dynamics: Dynamics) -> Any:
    assert isinstance(dynamics, MujocoDynamics)
    return dynamics.model


def _start(problem: Problem) -> Array:
    return np.asarray(problem.U0, dtype=np.float64)


def _phases(problem: Problem) -> float:
    """Milliseconds of rollout, linearization and sweep together, along the problem's start."""
    problem = _on_one_thread(problem)
    trajectory, dynamics = problem.rollout(_start(problem)), problem.dynamics
    model, U = Iterate(problem, trajectory).gauss_newton, np.array(trajectory.U)
    calls = (
        lambda: dynamics.rollout(problem.x0, U),
        lambda: dynamics.linearize(trajectory),
        lambda: sweep(model),
    )
    return sum(milliseconds(call) for call in calls)


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


def _linearizations(dynamics: Any, trajectory: Trajectory) -> dict[str, Callable[[], Any]]:
    if not isinstance(dynamics, MujocoDynamics):
        return {"analytic": lambda: dynamics.linearize(trajectory)}
    alike = {"substeps": dynamics.substeps, "threads": 1}
    other = MujocoDynamics.from_model(dynamics.model, jacobian="transition", centered=False, **alike)
    ways = {"transition": lambda: other.linearize(trajectory)}
    if dynamics.jacobian != "transition":
        best = MujocoDynamics.from_model(dynamics.model, jacobian=dynamics.jacobian, **alike)
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

    def invert() -> None:
        for n in range(trajectory.horizon):
            place(n)
            mujoco.mj_inverse(model, data)

    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:  # mjd_transitionFD refuses it: the step's differences
        differentiate = _linearizations(dynamics, trajectory)["transition"]
    calls = {"mjd_transitionFD": differentiate, "mj_step": step, "mj_inverse": invert}
    return {name: milliseconds(call) for name, call in calls.items()}


def _errors(dynamics: MujocoDynamics, trajectory: Trajectory) -> dict[str, float]:
    """Median error of A over some knots in the middle, relative to each knot's largest entry."""
    first, dt = trajectory.horizon // 2, np.asarray(trajectory.dt)
    knots, steps = slice(first, first + KNOTS + 1), slice(first, first + KNOTS)
    part = Trajectory(trajectory.X[knots], trajectory.U[steps], trajectory.Y[knots], dt[steps])
    fine = fine_reference(dynamics, part).A
    scale = np.abs(fine).max(axis=(1, 2))
    found = {mode: call().A for mode, call in _linearizations(dynamics, part).items()}
    return {mode: float(np.median(np.abs(A - fine).max(axis=(1, 2)) / scale)) for mode, A in found.items()}
