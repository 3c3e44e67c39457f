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
from mjslq.costs import Control, State
from mjslq.dynamics.derivative_check import fine_reference
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.lq.box import solve_in_box
from mjslq.lq.riccati import solve as sweep
from mjslq.optimize import solve
from mjslq.problem import Problem
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
    "cart-pole within limits": lambda: _cart_pole(),
    "panda_reach": lambda: problems.get("panda_reach"),
    "panda_reach on pinocchio": lambda: problems.get("panda_reach", engine="pinocchio"),
    "solo12 in flight": lambda: _solo12_in_flight(),
    "solo12 on its feet": lambda: problems.get("solo12_stand"),
    "g1 on its feet": lambda: problems.get("g1_reach"),
    "box between moving plates": lambda: _grasp(),
    "four-bar linkages": lambda: _linkages(),
}


def run(case: str) -> Row:
    """Measure one of `CASES`."""
    return measure(case, _on_one_thread(CASES[case]()))


def growth(name: str = "panda_reach", horizons: tuple[int, ...] = (100, 200, 500, 1000)) -> dict[int, float]:
    """Milliseconds of rollout, linearization and sweep together, by horizon."""
    return {N: _phases(problems.get(name, horizon=N, duration=0.01 * N)) for N in horizons}


def growth_with_states(links: tuple[int, ...] = (2, 4, 8, 16, 32)) -> dict[int, float]:
    """Milliseconds of rollout, linearization and sweep together, by the number of states of a chain of links."""
    return {2 * count: _phases(_chain(count)) for count in links}


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


_CART_POLE = """
<mujoco><option timestep=".02" integrator="implicitfast"/><worldbody>
  <body><joint name="rail" type="slide" axis="1 0 0"/><geom type="box" size=".15 .1 .08" mass="1"/>
    <body><joint name="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02" mass=".1"/>
    </body></body></worldbody>
  <actuator><motor joint="rail" ctrlrange="-5 5"/></actuator></mujoco>
"""


def _cart_pole() -> Problem:
    """A pole swung up by a force of at most 5 N."""
    dynamics = MujocoDynamics.from_xml(_CART_POLE, threads=1)
    upright = [0.0, np.pi, 0.0, 0.0]
    arrive = State([500.0, 500.0, 50.0, 50.0], upright, when="terminal")
    running = [State([1.0, 1.0, 0.1, 0.1], upright), Control(0.01)]
    return Problem(dynamics, 150, np.zeros(4), [*running, arrive], name="cart-pole")


_GRASP = """
<mujoco><option timestep=".005" integrator="implicitfast"/><worldbody>
  <body pos="0 0 .05"><joint name="lift" type="slide" axis="0 0 1"/><geom type="box" size=".1 .1 .02" mass="1"/></body>
  <body pos="-.08 0 .12"><joint name="left" type="slide" axis="1 0 0"/>
    <geom type="box" size=".02 .06 .03" mass=".5"/></body>
  <body pos=".08 0 .12"><joint name="right" type="slide" axis="-1 0 0"/>
    <geom type="box" size=".02 .06 .03" mass=".5"/></body>
  <body pos="0 0 .11"><freejoint/><geom type="box" size=".06 .05 .04" mass=".5"/></body></worldbody>
  <actuator><position joint="lift" kp="4000" kv="60"/><position joint="left" kp="1000" kv="40"/>
    <position joint="right" kp="1000" kv="40"/></actuator></mujoco>
"""


def _grasp() -> Problem:
    """A box on a plate that moves up and down, between two plates that press on it: every body in contact moves."""
    dynamics = MujocoDynamics.from_xml(_GRASP, threads=1)
    x0 = dynamics.initial_state
    goal = x0.copy()
    goal[[0, 5]] += 0.05
    weight = np.concatenate([np.full(9, 10.0), np.full(9, 0.1)])
    held = np.array([0.0, 0.01, 0.01])
    return Problem(dynamics, 100, x0, [State(weight, goal), Control(1.0, held)], name="grasp", U0=held)


def _linkages() -> Problem:
    """Four linkages of four bars each, closed by connect constraints, driven at one crank each."""
    bars = ties = motors = ""
    for k in range(4):
        bars += f"""
          <body pos="0 {0.2 * k} 1"><joint name="crank{k}" axis="0 1 0" damping=".05"/>
            <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02"/>
            <body pos="0 0 -.2"><joint axis="0 1 0" damping=".05"/>
              <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
              <body name="end{k}" pos=".3 0 0"><joint axis="0 1 0" damping=".05"/>
                <geom type="capsule" fromto="0 0 0 0 0 .2" size=".02"/></body></body></body>"""
        ties += f'<connect body1="end{k}" body2="world" anchor="0 0 .2"/>'
        motors += f'<motor joint="crank{k}"/>'
    dynamics = MujocoDynamics.from_xml(
        f"""<mujoco><option timestep=".005" integrator="implicitfast"><flag contact="disable"/></option>
        <worldbody>{bars}</worldbody><equality>{ties}</equality><actuator>{motors}</actuator></mujoco>""",
        threads=1,
    )
    goal = np.concatenate([np.tile([0.3, -0.3, 0.3], 4), np.zeros(12)])
    return Problem(dynamics, 100, dynamics.initial_state, [State(1.0, goal), Control(0.1)], name="linkages")


def _chain(links: int) -> Problem:
    """A hanging chain of links with a motor at every hinge, which is to come to rest bent."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = 0.01, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    body = spec.worldbody
    for i in range(links):
        body = body.add_body(pos=[0.0, 0.0, -0.2 if i else 0.0])
        joint = body.add_joint(name=f"hinge{i}", axis=[0.0, 1.0, 0.0], damping=[0.1, 0.0, 0.0])
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0.0, 0.0, 0.0, 0.0, 0.0, -0.2], size=[0.02, 0.0, 0.0])
        motor = spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint.name)
        motor.set_to_motor()
    dynamics = MujocoDynamics.from_spec(spec, threads=1)
    goal = np.concatenate([np.full(links, 0.1), np.zeros(links)])
    return Problem(dynamics, 100, np.zeros(2 * links), [State(1.0, goal), Control(0.01)], name="chain")


def _solo12_in_flight() -> Problem:
    """The quadruped thrown up from a metre's height: no contact within the horizon."""
    problem = problems.get("solo12_stand", horizon=40)
    x0 = np.array(problem.x0)
    x0[2], x0[problem.dynamics.nx - problem.dynamics.ndx // 2 + 2] = 1.0, 2.0
    return dataclasses.replace(problem, x0=x0)
