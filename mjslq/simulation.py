"""Closed loops in simulation: a controller on a plant that may differ from its model, with delay and disturbances.

    x(t) is measured once a period and handed to the controller; its answer acts from t + delay on, until the next one

The plant is a MuJoCo model, stepped by mj_step at its own timestep, or any engine. Before the first control acts, the
problem's first control does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from mjslq.dynamics.dynamics import Dynamics
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array, choose, instance, nonnegative, positive

if TYPE_CHECKING:
    from mjslq.mpc import MPC, Statistics

WHOLE = 1e-6
"""Share of a step by which a time may miss a whole number of steps."""


@dataclass(frozen=True)
class Push:
    """A force on a body of a MuJoCo plant, at its centre of mass, in the world's frame.

    Examples
    --------
    >>> push = mjslq.simulation.Push("pelvis", force=[80.0, 0.0, 0.0], at=0.5, duration=0.2)
    """

    body: str
    """Name of the body."""
    force: ArrayLike
    """Shape (3,). [N]"""
    at: float
    """When it begins. [s]"""
    duration: float = 0.1
    """How long it lasts. [s]"""
    torque: ArrayLike = (0.0, 0.0, 0.0)
    """Shape (3,). [Nm]"""


@dataclass(frozen=True)
class Kick:
    """A sudden change of the state, of any plant.

    Examples
    --------
    >>> kick = mjslq.simulation.Kick(dx=[0.0, 0.5], at=0.3)
    """

    dx: ArrayLike
    """Tangent direction along which the state jumps. Shape (ndx,)."""
    at: float
    """When. [s]"""


Disturbance = Push | Kick


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Motion of a plant under a controller, and the controller's statistics.

    Examples
    --------
    >>> dynamics = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0]]), nx=2, nu=1, dt=0.1)
    >>> terms = [mjslq.costs.Control(0.1), mjslq.costs.State(1.0, when="always")]
    >>> loop = mjslq.MPC(mjslq.Problem(dynamics, 20, [1.0, 0.0], terms)).run(duration=0.5)
    >>> loop.trajectory.horizon, loop.statistics.plans
    (5, 5)
    """

    trajectory: Trajectory
    """States at the control periods and the controls that the controller answered them with."""
    statistics: Statistics
    """Time and ending of the plans."""


class Plant(Protocol):
    """Interface of a simulated plant: a state, and `advance`, which takes one timestep."""

    timestep: float
    """[s]"""
    x: Array
    """State."""
    bodies: tuple[str, ...]
    """Names of the bodies that can be pushed."""

    def advance(self, u: Array, t: float, pushes: Sequence[Push]) -> bool:
        """One timestep from time t under the control u; whether all went well."""
        ...


def run(
    mpc: MPC,
    plant: Any = None,
    duration: float = 1.0,
    x0: ArrayLike | None = None,
    disturbances: Sequence[Disturbance] = (),
    delay: float = 0.0,
) -> ClosedLoop:
    """Control a plant from time zero on.

    Parameters
    ----------
    mpc : MPC
        The controller, which is reset first.
    plant : mujoco.MjModel or Dynamics
        What is controlled; the problem's own engine unless given. Its states and controls are those of the problem. A
        MuJoCo plant is stepped at its own timestep, of which the control period has to be a whole number.
    duration : float
        Of the whole run. [s]
    x0 : array
        State that the plant begins with; the problem's own unless given. Shape (nx,).
    disturbances : sequence of Push and Kick
        What happens to the plant, unknown to the controller.
    delay : float
        Time from a measurement until the control that answers it acts. [s]

    Returns
    -------
    ClosedLoop
        A plant that blows up is a trajectory that `diverged`, which ends there.

    Raises
    ------
    ValueError
        For a plant of other states or controls than the problem's, for times that are no whole number of its steps,
        and for disturbances that it cannot have.

    Examples
    --------
    >>> dynamics = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0]]), nx=2, nu=1, dt=0.1)
    >>> terms = [mjslq.costs.Control(0.1), mjslq.costs.State(1.0, when="always")]
    >>> controller = mjslq.MPC(mjslq.Problem(dynamics, 20, [1.0, 0.0], terms))
    >>> kick = mjslq.simulation.Kick(dx=[0.0, 1.0], at=0.2)
    >>> loop = mjslq.simulation.run(controller, duration=6.0, disturbances=[kick])
    >>> bool(np.abs(loop.trajectory.X[-1]).max() < 0.05)
    True
    """
    problem, period = mpc.problem, mpc.period
    made = plant_of(problem.dynamics if plant is None else plant, problem.dynamics)
    substeps = _whole("the control period", period, made.timestep)
    wait = _whole("the delay", nonnegative("delay", delay), made.timestep, least=0)
    M = _whole("the duration", positive("duration", duration), period)
    pushes, kicks = _sorted(disturbances, made, problem.dynamics.ndx)
    made.x = problem.dynamics.checked_start(problem.x0 if x0 is None else x0)
    mpc.reset()
    X, U = np.empty((M + 1, problem.dynamics.nx)), np.empty((M, problem.dynamics.nu))
    acting, waiting = np.asarray(problem.U0)[0], deque[tuple[int, Array]]()
    for k in range(M):
        X[k] = made.x
        U[k] = mpc.step(X[k], k * period)
        waiting.append((k * substeps + wait, U[k]))
        for i in range(k * substeps, (k + 1) * substeps):
            while waiting and waiting[0][0] <= i:
                acting = waiting.popleft()[1]
            t = i * made.timestep
            for kick in [kick for kick in kicks if t - 0.5 * made.timestep <= kick.at < t + 0.5 * made.timestep]:
                made.x = problem.dynamics.integrate(made.x, np.asarray(kick.dx, np.float64))
            if not made.advance(acting, t, pushes):
                X[k + 1] = np.nan
                return ClosedLoop(Trajectory(X[: k + 2], U[: k + 1], dt=period, diverged_at=k + 1), mpc.statistics)
    X[M] = made.x
    return ClosedLoop(Trajectory(X, U, dt=period), mpc.statistics)


class _EnginePlant:
    """Any engine, step by step."""

    bodies: tuple[str, ...] = ()

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics, self.timestep = dynamics, float(np.ravel(dynamics.dt)[0])
        self.x = np.zeros(dynamics.nx)

    def advance(self, u: Array, t: float, pushes: Sequence[Push]) -> bool:
        """One step."""
        self.x = self.dynamics.step(self.x, u)[0]
        return bool(np.isfinite(self.x).all())


class _MujocoPlant:
    """A MuJoCo model, by plain calls of mj_step."""

    def __init__(self, model: Any) -> None:
        import mujoco

        self.model, self.data = model, mujoco.MjData(model)
        self.timestep = float(model.opt.timestep)
        self.bodies = tuple(model.body(i).name for i in range(1, model.nbody))

    @property
    def x(self) -> Array:
        """The state (qpos, qvel, act)."""
        return np.concatenate([self.data.qpos, self.data.qvel, self.data.act])

    @x.setter
    def x(self, x: Array) -> None:
        nq, nv = self.model.nq, self.model.nv
        self.data.qpos, self.data.qvel, self.data.act = np.split(x, [nq, nq + nv])

    def advance(self, u: Array, t: float, pushes: Sequence[Push]) -> bool:
        """One timestep under the forces that act at its beginning."""
        import mujoco

        self.data.ctrl, self.data.xfrc_applied[:] = u, 0.0
        for push in pushes:
            if push.at - WHOLE * self.timestep <= t < push.at + push.duration - WHOLE * self.timestep:
                self.data.body(push.body).xfrc_applied += np.concatenate([push.force, push.torque])
        mujoco.mj_step(self.model, self.data)
        bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
        return not any(self.data.warning[int(warning)].number for warning in bad)


def plant_of(given: Any, model: Dynamics) -> Plant:
    """A MuJoCo model or an engine as a plant for a problem of the engine `model`; raises ValueError for others."""
    m = getattr(given, "model", given)
    plant: Plant
    if hasattr(m, "opt") and hasattr(m, "nq"):
        sizes, plant = (m.nq + m.nv + m.na, m.nu), _MujocoPlant(m)
    elif isinstance(given, Dynamics):
        sizes, plant = (given.nx, given.nu), _EnginePlant(given)
    else:
        raise ValueError(f"plant must be a mujoco.MjModel or an engine, got {type(given).__name__}")
    if sizes != (model.nx, model.nu):
        raise ValueError(
            f"the plant has {sizes[0]} states and {sizes[1]} controls, but the problem has {model.nx} and {model.nu}"
        )
    return plant


def _sorted(disturbances: Sequence[Disturbance], plant: Plant, ndx: int) -> tuple[list[Push], list[Kick]]:
    """Pushes and kicks apart, each checked."""
    pushes, kicks = [], []
    for i, given in enumerate(instance("disturbances", disturbances, Sequence, "a list of Push and Kick")):
        name = f"disturbances[{i}]"
        if isinstance(given, Push) and plant.bodies:
            choose("body", given.body, plant.bodies)
            as_array(f"{name}.force", given.force, (3,)), as_array(f"{name}.torque", given.torque, (3,))
            positive(f"{name}.duration", given.duration)
            pushes.append(given)
        elif isinstance(given, Push):
            raise ValueError(f"{name} is a push on a body, which only MuJoCo plants have; use a Kick")
        elif isinstance(given, Kick):
            as_array(f"{name}.dx", given.dx, (ndx,))
            kicks.append(given)
        else:
            raise ValueError(f"{name} must be a Push or a Kick, got {type(given).__name__}")
        nonnegative(f"{name}.at", given.at)
    return pushes, kicks


def _whole(what: str, time: float, step: float, least: int = 1) -> int:
    """How many steps there are in a time."""
    number = round(time / step)
    if abs(time / step - number) > WHOLE * max(number, 1) or number < least:
        raise ValueError(f"{what}, {time:g} s, must be a whole number of steps of {step:g} s")
    return number
