"""`MujocoDynamics`: a MuJoCo model as a discrete-time system.

Notation
--------
    x = (qpos, qvel, act)      nx = nq + nv + na           state; joint positions may hold quaternions
    dx                         ndx = 2 nv + na             tangent direction, as in mj_differentiatePos
    u = ctrl                   nu                          controls, clamped to ctrlrange by MuJoCo itself
    y = sensordata             ny = nsensordata            outputs: all the model's sensors, read at (x_n, u_n)
    x_{n+1} = mj_step(... mj_step(x_n, u_n) ..., u_n)      k = substeps times, so that dt = k opt.timestep

Whole horizons run in compiled loops that call libmujoco directly (`kernels`). A rollout starts from a
clean mjData at time zero with a cold constraint solver, so equal inputs give equal results, bit for bit, and the
same ones as a plain loop over mj_step on a new mjData.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mjslq.contact import Contact
from mjslq.cores import usable_cores
from mjslq.dynamics.dynamics import Curvature, Dynamics, Feedback, Linearization, Output
from mjslq.dynamics.mujoco import contacts
from mjslq.dynamics.mujoco.constructors import Constructors
from mjslq.dynamics.mujoco.keyframes import Keyframes
from mjslq.dynamics.records import curvature_of
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array, choose, count, nonnegative, positive

if TYPE_CHECKING:
    import mujoco

    from mjslq.dynamics.mujoco.inverse.curvature.hessians import InverseHessians
    from mjslq.dynamics.mujoco.inverse.jacobians import InverseJacobians
    from mjslq.dynamics.mujoco.inverse.runge_kutta import RungeKuttaJacobians
    from mjslq.dynamics.mujoco.simulator import Simulator
    from mjslq.dynamics.mujoco.variation import MujocoVariation, Parameter


SMOOTH_PRICE, CONSTRAINED_PRICE = 2.0, 10.0
"""Linearizations that second derivatives in closed form cost, about: of smooth models, of those with contacts, ..."""


class MujocoDynamics(Constructors, Keyframes, Dynamics):
    """A MuJoCo model; make one with `from_path`, `from_xml`, `from_spec` or `from_model`.

    All four take the same options:

    timestep
        Length of a simulator step in place of the model's own. [s]
    integrator
        MuJoCo's integrator in place of the model's own: "Euler", "implicit", "implicitfast", "discrete" or "RK4".
    substeps
        How many simulator steps a control is held for, k: a step of the horizon takes dt = k timestep. States between
        the knots are kept as `Trajectory.substates`; outputs are read, and differentiated, at the knots alone.
    jacobian
        How `linearize` works: "inverse" differentiates the inverse dynamics of the step, analytically wherever
        possible, and covers most models (those with the integrator RK4 by chaining its four stages); "transition"
        takes differences of the step, by mjd_transitionFD or, with RK4, by plain simulation, many times slower, and
        covers all; "auto" is "inverse" wherever that covers the model. What "inverse" differences is single forces,
        rows and readings, without a step; so it was the faster on every model measured, from 1.4 times (adhesive
        bodies, wrapped tendons, integral controllers) to 60 times, with differences to both sides. `support_report`
        says which, and why.
    threads
        How many threads `linearize` may use; None for one per usable core.
    eps, centered
        Size of the differences where some are taken, and whether they are taken to both sides (twice the time, far
        smaller error: about 1e-7 in contact, 1e-9 without); with RK4 they always are. To both sides, "transition" takes
        eps / 100 where a kink is nearer than eps.
    contact
        "model", "smooth", "stiff" or a `mjslq.Contact`: parameters of all contacts in place of the model's own.
    foresight
        Distance from which on bodies feel each other in derivatives, and in these alone; see `contacts`. [m]

    parameters : mapping
        Numbers of the model that a problem may make unknown (`Problem.free_parameters`), by names of your own:
        quantities such as "body/pole/mass" or "geom/foot/friction/0", or pairs (set, value) of a function
        set(model, value) and the value now; see `variation`.

    All but `from_model` also take

    frames
        Sites, bodies, geoms or cameras to add sensors for, which `costs.Frame` and `constraints.Frame` find: a list of
        names, or the `frames` of a `mjslq.Clip`, for position, orientation and both velocities of each, or a mapping
        from names to some of these ("position", "orientation", "linear-velocity", "angular-velocity"). Models need no
        sensors of their own.

    They raise ValueError when the model cannot be read, or is not supported.

    >>> from mjslq.robots import robot_spec
    >>> arm = mjslq.MujocoDynamics.from_spec(robot_spec("ur5"), timestep=0.01, substeps=2)
    >>> arm.nx, arm.nu, arm.dt
    (12, 6, 0.02)
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        timestep: float | None = None,
        integrator: str | None = None,
        substeps: int = 1,
        jacobian: str = "auto",
        threads: int | None = None,
        eps: float = 1e-6,
        centered: bool = True,
        contact: str | Contact = "model",
        foresight: float = 0.0,
        parameters: Mapping[str, Any] | None = None,
        name: str | None = None,
    ):
        from mjslq.dynamics.mujoco import names
        from mjslq.dynamics.mujoco.checks import integrator_named, refuse_unsupported
        from mjslq.dynamics.mujoco.inverse.cover import choose_jacobian
        from mjslq.dynamics.mujoco.states import state_space

        refuse_unsupported(model)
        self.model = copy.copy(model)
        """The compiled model, a copy of what was given. Not to be changed."""
        if timestep is not None:
            self.model.opt.timestep = positive("timestep", timestep)
        if integrator is not None:
            self.model.opt.integrator = integrator_named(integrator)
        self.contact: Contact = Contact.of(contact)
        """How hard bodies touch."""
        self._given, self.model = self.model, contacts.with_contact(self.model, self.contact)
        self.foresight = nonnegative("foresight", foresight)
        self.parameters: dict[str, Parameter] = {}
        """What a problem may make unknown."""
        if parameters is not None:
            from mjslq.dynamics.mujoco.variation import parameters_of

            self.parameters = parameters_of(parameters, self.model)
        self.parameter_names = tuple(self.parameters)
        self.nx, self.ndx, self.nv = model.nq + model.nv + model.na, 2 * model.nv + model.na, model.nv
        self.nu, self.ny = model.nu, model.nsensordata
        self.substeps = count("substeps", substeps)
        """How many simulator steps a control is held for."""
        self.dt = self.substeps * float(self.model.opt.timestep)
        self.state_names = names.state_names(model)
        self.control_names = names.control_names(model)
        self.output_names = names.output_names(model)
        self.joint_ranges = names.joint_ranges(model)
        self.name = name or names.model_name(model) or "model"
        """The model's name, or its file's."""
        self.jacobian = choose_jacobian(self.model, choose("jacobian", jacobian, ("auto", *_JACOBIANS)))
        """How `linearize` works: "inverse" or "transition"."""
        self.control_limits = names.control_limits(self.model)
        self._threads = usable_cores() if threads is None else count("threads", threads)
        self._eps, self._centered = positive("eps", eps), bool(centered)
        self.space = state_space(model)
        self._lock = threading.Lock()

    def __repr__(self) -> str:
        return f"MujocoDynamics({self.name!r}, nx={self.nx}, ndx={self.ndx}, nu={self.nu}, ny={self.ny}, dt={self.dt})"

    @property
    def initial_state(self) -> Array:
        """The model's reference configuration qpos0, at rest, activations zero. Shape (nx,)."""
        return np.concatenate([self.model.qpos0, np.zeros(self.model.nv + self.model.na)])

    @property
    def initial_control(self) -> Array:
        """See `Dynamics.initial_control`: zero, but the identity where an orientation is set by a quaternion."""
        from mjslq.dynamics.mujoco.states import reset_controls

        return reset_controls(self.model)

    @property
    def outputs(self) -> dict[str, Output]:
        """Sensors by name."""
        from mjslq.dynamics.mujoco import names

        return names.outputs(self.model)

    def frame_output(self, frame: str, of: str) -> str:
        """See `Dynamics.frame_output`."""
        from mjslq.dynamics.mujoco.frames import frame_output

        return frame_output(self.model, frame, of)

    @property
    def places(self) -> frozenset[str]:
        """See `Dynamics.places`."""
        from mjslq.dynamics.mujoco import names

        return names.places(self.model)

    def rollouts(self, x0s: Array, U: Array, feedback: Feedback | None = None) -> list[Trajectory]:
        """Simulate several times, on several threads; see `Dynamics.rollouts`."""
        with self._lock:
            return self.simulator.rollouts(x0s, U, feedback)

    @property
    def threads(self) -> int:
        """How many threads rollouts and Jacobians are shared out among."""
        return self._threads

    def limit_threads(self, number: int) -> None:
        """See `Dynamics.limit_threads`."""
        self._threads = min(self._threads, count("threads", number))

    def step(self, x: Array, u: Array, n: int = 0) -> tuple[Array, Array]:
        """One step by plain calls to mj_step from a clean mjData; see `Dynamics.step`.

        The state is NaN when MuJoCo warns of bad numbers or full buffers.
        """
        with self._lock:
            return self.simulator.step(as_array("x", x, (self.nx,)), as_array("u", u, (self.nu,)), n)

    def step_each(self, X: ArrayLike, U: ArrayLike) -> tuple[Array, Array]:
        """One step from each knot, on several threads; see `Dynamics.step_each`."""
        states, controls = np.asarray(X, dtype=np.float64), np.asarray(U, dtype=np.float64)
        with self._lock:
            F, _, Y = self.simulator.step_each(states, controls)
        return F, Y

    def variation(self, names: tuple[str, ...] = ()) -> MujocoVariation:
        """See `Dynamics.variation`."""
        from mjslq.dynamics.mujoco.variation import MujocoVariation

        return MujocoVariation(self, names)

    def with_model(self, change: Callable[[mujoco.MjModel], None]) -> MujocoDynamics:
        """The same system on a copy of the model that the function `change` has changed, with memory of its own."""
        from mjslq.dynamics.mujoco.inverse.cover import choose_jacobian

        other = copy.copy(self)
        other._given = copy.copy(self._given)
        change(other._given)
        other.model = contacts.with_contact(other._given, self.contact)
        if self.jacobian == "inverse":
            other.jacobian = choose_jacobian(other.model, "auto")
        return other

    def retime(self, timestep: float) -> None:
        """Take another simulator step, `timestep` [s], for engines whose model nobody else has."""
        if timestep == self.model.opt.timestep:
            return
        self.model.opt.timestep = self._given.opt.timestep = timestep
        self.dt = self.substeps * timestep
        made = vars(self)
        if "simulator" in made:
            self.simulator.dt = self.dt
        if "_inverse" in made:
            self._inverse.retime(timestep)
        for name in ("_runge_kutta", "_inverse_hessians", "_foreseeing", "_scene"):
            made.pop(name, None)

    def linearize(self, trajectory: Trajectory) -> Linearization:
        """Jacobians of every step of `trajectory`, and of the outputs at every knot."""
        self.check_trajectory(trajectory)
        if self.foresight:
            return contacts.foreseen(self._foreseeing, trajectory)
        with self._lock:
            return _JACOBIANS[self.jacobian](self, trajectory)

    def linearize_steps(self, X: Array, U: Array, F: Array) -> Linearization:
        """Jacobians of steps that need not follow each other; see `Dynamics`."""
        from mjslq.dynamics.mujoco.inverse.table.continuous import is_runge_kutta

        if self.jacobian != "inverse":
            return super().linearize_steps(X, U, F)
        with self._lock:
            substates = self.simulator.substates(X, U)
            if is_runge_kutta(self.model):
                return self._runge_kutta.linearize(X, U, substates)
            return self._inverse.linearize(X, U, substates, F)

    @property
    def curvature_price(self) -> float:
        """See `Dynamics.curvature_price`: a few linearizations where there is a closed form, more with contacts."""
        if self._inverse_hessians is None:
            return super().curvature_price
        from mjslq.dynamics.mujoco.inverse.table.plan import can_be_constrained

        return CONSTRAINED_PRICE if can_be_constrained(self.model) else SMOOTH_PRICE

    def hessian(
        self,
        trajectory: Trajectory,
        costates: Array,
        weights: Array | None = None,
        linearization: Linearization | None = None,
        ends: Array | None = None,
    ) -> Curvature:
        """Second derivatives contracted with costates, in closed form for most models; see `Dynamics.hessian`.

        By differences of `linearize` where the model has parts without a closed form, or sensors without one that
        have weights; `support_report` says so.
        """
        inverse = self._inverse_hessians
        if inverse is None:
            return super().hessian(trajectory, costates, weights, linearization, ends)
        if linearization is None:
            linearization = self.linearize(trajectory)
        X, U, ends = trajectory.X, trajectory.U, trajectory.X[1:] if ends is None else ends
        with self._lock:
            H = inverse.hessians(X, U, ends, linearization, costates, weights)
        if weights is not None and weights[:, inverse.open_readings].any():
            rest = np.where(inverse.open_readings, weights, 0.0)
            parts = super().hessian(trajectory, np.zeros_like(costates), rest, linearization, ends)
            for whole, part in zip(found := curvature_of(H, self.ndx), parts, strict=True):
                whole += part
            return found
        return curvature_of(H, self.ndx)

    def scene(self) -> Scene:
        """Return the compiled model, and where its pose is in x, for a viewer."""
        return self._scene

    def fully_solved(self) -> MujocoDynamics | None:
        """See `Dynamics.fully_solved`: with a constraint solver that does not stop at the model's tolerance."""
        from mjslq.dynamics.mujoco.checks import with_converged_solver

        model = with_converged_solver(self.model)
        return None if model is None else MujocoDynamics(model, substeps=self.substeps, jacobian="transition")

    def faults(self) -> list[str]:
        """What makes the model impossible to simulate, a sentence each; see `Dynamics`."""
        from mjslq.dynamics.mujoco.checks import massless_joints

        return massless_joints(self.model)

    def support_report(self) -> list[tuple[str, str]]:
        """List the model's parts and what serves each of them, as (part, what serves it)."""
        from mjslq.dynamics.mujoco.report import report

        differences = "differences of the step" + (" to both sides" if self._centered else "")
        parts = report(self.model, differences, self.jacobian)
        if self.substeps > 1:
            parts.insert(1, (f"{self.substeps} substeps", f"of {self.model.opt.timestep:g} s, the control held"))
        if self.contact.kind != "model":
            parts.insert(1, ("contacts", str(self.contact)))
        parts += [("not to be simulated", fault) for fault in self.faults()]
        return parts

    @cached_property
    def _scene(self) -> Scene:
        from mjslq.dynamics.mujoco.drawing import drawn_scene

        return drawn_scene(self._given, self.name)

    @cached_property
    def simulator(self) -> Simulator:
        """Whole-horizon loops and their memory, made when first asked for; one caller at a time."""
        from mjslq.dynamics.mujoco.simulator import Simulator

        return Simulator(self.model, self._threads, self.substeps)

    def foreseeing(self, foresight: float) -> MujocoDynamics:
        """The same system whose derivatives foresee contacts from the distance `foresight`; 0 for true ones. [m]"""
        other = copy.copy(self)
        other.foresight = nonnegative("foresight", foresight)
        return other

    @cached_property
    def _foreseeing(self) -> MujocoDynamics:
        return MujocoDynamics(
            contacts.foreseeing(self.model, self.foresight), substeps=self.substeps, jacobian=self.jacobian,
            threads=self._threads, eps=self._eps, centered=self._centered,
        )  # fmt: skip

    @cached_property
    def _inverse(self) -> InverseJacobians:
        from mjslq.dynamics.mujoco.inverse.jacobians import InverseJacobians

        return InverseJacobians(self.simulator, self._eps, self._centered)

    @cached_property
    def _runge_kutta(self) -> RungeKuttaJacobians:
        from mjslq.dynamics.mujoco.inverse.runge_kutta import RungeKuttaJacobians

        return RungeKuttaJacobians(self.model, self.space, self._threads, self._eps, self._centered)

    @cached_property
    def _inverse_hessians(self) -> InverseHessians | None:
        """Second derivatives in closed form; None where the model has parts without one, or several steps a knot."""
        from mjslq.dynamics.mujoco.inverse.curvature.cover import reasons
        from mjslq.dynamics.mujoco.inverse.table.continuous import is_runge_kutta

        if self.jacobian != "inverse" or self.substeps > 1 or is_runge_kutta(self.model) or reasons(self.model):
            return None
        from mjslq.dynamics.mujoco.inverse.curvature.hessians import InverseHessians

        return InverseHessians(self._inverse)

    def _linearize_inverse(self, trajectory: Trajectory) -> Linearization:
        from mjslq.dynamics.mujoco.inverse.table.continuous import is_runge_kutta

        substates = self.simulator.known_substates(trajectory)
        if is_runge_kutta(self.model):
            return self._runge_kutta.linearize(trajectory.X, trajectory.U, substates)
        return self._inverse.linearize(trajectory.X, trajectory.U, substates, trajectory.X[1:])

    def _linearize_transition(self, trajectory: Trajectory) -> Linearization:
        from mjslq.dynamics.mujoco.step_differences import linearize_by_differences

        system = (self.simulator, self.space, self.control_limits)
        return linearize_by_differences(*system, trajectory, self._eps, self._centered)


_JACOBIANS: dict[str, Callable[[MujocoDynamics, Trajectory], Linearization]] = {
    "inverse": MujocoDynamics._linearize_inverse,
    "transition": MujocoDynamics._linearize_transition,
}
