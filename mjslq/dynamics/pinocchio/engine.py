"""`PinocchioDynamics`: a URDF robot on Pinocchio's rigid-body algorithms as a discrete-time system.

Notation
--------
    x = (q, v)                  nx = nq + nv     Pinocchio's configuration and velocity
    dx = (dq, dv)               ndx = 2 nv       tangent direction, as in pin.integrate and pin.difference
    u                           nu               joint torques [Nm] or forces [N]; a floating base has none
    y                           ny               positions and orientations of frames, read at x_n
    x_{n+1}                                      semi-implicit Euler (`simulator`), or Runge-Kutta of
                                                 fourth order (`runge_kutta`)

A floating base is a position, a quaternion (x, y, z, w), and velocities [linear, angular] both in the base's own
frame. (MuJoCo: (w, x, y, z), and the linear velocity in the world's frame.) All Jacobians are analytic: Pinocchio's
derivatives of the articulated-body algorithm (Carpentier and Mansard 2018) and of the frames.

There are no contacts, no joint limits and no dry friction here; `MujocoDynamics` has them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from mjslq.dynamics.dynamics import Dynamics, Feedback, Linearization, Output
from mjslq.dynamics.locked_joints import LockedJoints
from mjslq.dynamics.pinocchio import models
from mjslq.dynamics.pinocchio.algorithms import Ties
from mjslq.dynamics.pinocchio.mimic import Follower, lock_followers, tie
from mjslq.dynamics.pinocchio.outputs import ORIENTATION, Readings
from mjslq.dynamics.pinocchio.states import state_space
from mjslq.dynamics.variation import Variation
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array, choose, positive

if TYPE_CHECKING:
    from mjslq.dynamics.pinocchio.simulator import Simulator

Integrator = Literal["semi-implicit-euler", "rk4"]
_INTEGRATORS = ("semi-implicit-euler", "rk4")


class PinocchioDynamics(Dynamics):
    """A URDF robot on Pinocchio; make one with `from_path` or `from_model`, which take the same options.

    timestep
        Step length h. [s]
    locked_joints
        Names of joints to fix at zero, or a mapping from names to positions [rad or m].
    outputs
        Names of frames. "hand" is the position of the frame "hand" in the world, shape (3,) [m];
        "hand.orientation" its orientation, a unit quaternion (w, x, y, z).
    integrator
        "semi-implicit-euler" (as MuJoCo's Euler, damping implicit) or "rk4".
    armature
        Rotor inertia [kg m^2 or kg]: one number for all joints with one axis, or a mapping from names of joints to
        numbers; the model's own unless given.
    damping
        Joint damping [Nm s/rad or N s/m], given like armature; the model's own unless given.
    actuated
        Names of the joints that the controls act on, in the order of the controls; all but a floating base unless
        given.

    They raise ValueError when the model cannot be read or a name is not in it; the message lists those that are.

    Examples
    --------
    >>> arm = mjslq.PinocchioDynamics.from_path(mjslq.robot_path("ur5"), timestep=0.01, outputs=["tool0"])
    >>> arm.nx, arm.nu, arm.output_names
    (12, 6, ('tool0[0]', 'tool0[1]', 'tool0[2]'))
    """

    def __init__(
        self,
        model: Any,
        timestep: float,
        locked_joints: LockedJoints | None = None,
        outputs: Sequence[str] = (),
        *,
        integrator: Integrator = "semi-implicit-euler",
        armature: float | Mapping[str, float] | None = None,
        damping: float | Mapping[str, float] | None = None,
        actuated: Sequence[str] | None = None,
        name: str | None = None,
        scene: Callable[[PinocchioDynamics], Scene | None] | Scene | None = None,
        followers: dict[str, Follower] | None = None,
    ) -> None:
        self.dt = positive("timestep", timestep)
        self.integrator = choose("integrator", integrator, _INTEGRATORS)
        self.model = free = models.lock(model, locked_joints)
        """The pinocchio.Model, with joints locked and armature set; a copy of what was given. Not to be changed."""
        free.armature = models.per_joint(free, "armature", armature, free.armature)
        self.damping = models.per_joint(free, "damping", damping, free.damping)
        """Damping of each dof, that of its followers included. Shape (nv,). [Nm s/rad or N s/m]"""
        self._ties: Ties | None = None
        if followers:
            self.model, self._ties = tie(free, followers)
            self.damping = self._ties.reduced(self.damping)
        if not self.model.nv:
            raise ValueError("this model is not supported: it has no joints that are not locked, so nothing can move")
        models.refuse_massless(self.model)
        self._actuated, self.control_names = models.actuated_dofs(self.model, actuated)
        self._readings = Readings(free, outputs)
        self.nx, self.ndx, self.nv = self.model.nq + self.model.nv, 2 * self.model.nv, self.model.nv
        self.space = state_space(self.model)
        self.nu, self.ny = len(self._actuated), self._readings.ny
        self.control_limits = models.effort_limits(self.model, self._actuated)
        self.state_names = models.state_names(self.model)
        self.output_names = self._readings.names
        self.joint_ranges = models.joint_ranges(self.model)
        self.name = name or self.model.name or "model"
        """The robot's name, or its file's."""
        self._drawn_by = scene
        self._lock = threading.Lock()

    @classmethod
    def from_path(
        cls,
        path: str | Path,
        timestep: float,
        locked_joints: LockedJoints | None = None,
        outputs: Sequence[str] = (),
        *,
        floating_base: bool = False,
        packages: Any = None,
        **options: Any,
    ) -> PinocchioDynamics:
        """Read a URDF file; `floating_base` frees its root link, as a joint named "root". See the class for the rest.

        A viewer draws the robot as MuJoCo reads the same file, with meshes of `packages` as in
        `MujocoDynamics.from_path`. A joint that mimics a locked one is locked with it; one that mimics a free joint
        follows it exactly, and is no part of x and u.
        """
        if isinstance(path, pin.Model):
            raise ValueError("from_path takes the path of a .urdf file, got a pinocchio.Model; from_model takes that")
        model, (locked, followers) = models.load_urdf(path, floating_base), lock_followers(path, locked_joints)
        file = Path(path).expanduser().resolve()
        options.setdefault("name", file.stem)
        lines = {name: (follower.multiplier, follower.offset) for name, follower in followers.items()}
        options.setdefault("scene", partial(_scene_of_file, file, floating_base, locked, packages, lines))
        return cls(model, timestep, locked, outputs, followers=followers, **options)

    @classmethod
    def from_model(
        cls,
        model: Any,
        timestep: float,
        locked_joints: LockedJoints | None = None,
        outputs: Sequence[str] = (),
        **options: Any,
    ) -> PinocchioDynamics:
        """Copy a `pinocchio.Model`; see the class for the options. `scene` tells a viewer what to draw."""
        if not isinstance(model, pin.Model):
            raise ValueError(f"model must be a pinocchio.Model, got {type(model).__name__}; from_path takes a file")
        if list(model.mimicking_joints):
            name = model.names[model.mimicking_joints[0]]
            raise ValueError(
                f"joint {name!r} mimics another, which Pinocchio's articulated-body algorithm cannot; "
                f"PinocchioDynamics.from_path makes such a model of the URDF file"
            )
        return cls(model, timestep, locked_joints, outputs, **options)

    def __getstate__(self) -> dict[str, Any]:
        """See `Dynamics`; a model with mimicking joints does not survive Pinocchio's own pickling, and is made anew."""
        state = super().__getstate__()
        if self._ties is not None:
            state["model"], state["_ties"] = None, (self._ties.free, self._ties.followers)
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what `__getstate__` gave."""
        super().__setstate__(state)
        if isinstance(self._ties, tuple):
            self.model, self._ties = tie(*self._ties)

    def __repr__(self) -> str:
        return (
            f"PinocchioDynamics({self.name!r}, nx={self.nx}, ndx={self.ndx}, nu={self.nu}, ny={self.ny}, dt={self.dt})"
        )

    @property
    def initial_state(self) -> Array:
        """The neutral configuration at rest. Shape (nx,)."""
        return np.concatenate([pin.neutral(self.model), np.zeros(self.model.nv)])

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names that `outputs` may take."""
        return tuple(dict.fromkeys(frame.name for frame in self.model.frames))

    @property
    def outputs(self) -> dict[str, Output]:
        """Frames' positions and orientations by name."""
        return self._readings.outputs

    def frame_output(self, frame: str, of: str) -> str:
        """See `Dynamics.frame_output`."""
        name = {"position": frame, "orientation": frame + ORIENTATION}.get(of)
        if name is None:
            raise ValueError(f"the outputs of PinocchioDynamics are positions and orientations, not a frame's {of}")
        if name not in self.outputs:
            choose("frame", frame, self.frame_names)
            raise ValueError(f"no output reads the {of} of {frame!r}; make the engine with outputs=({name!r}, ...)")
        return name

    @property
    def places(self) -> frozenset[str]:
        """See `Dynamics.places`."""
        return frozenset(name for name, output in self.outputs.items() if not output.quaternion)

    def holding_controls(self, x: ArrayLike) -> Array:
        """Controls under which the robot keeps the configuration of `x` at rest, gravity balanced. Shape (nu,).

        What they cannot balance (the weight of a floating base) is left out.
        """
        q = self.checked_start(x)[: self.model.nq]
        weight: Array = pin.computeGeneralizedGravity(self.model, self.model.createData(), q)
        return weight[self._actuated]

    def rollouts(self, x0s: Array, U: Array, feedback: Feedback | None = None) -> list[Trajectory]:
        """Simulate several times, one after the other; see `Dynamics.rollouts`."""
        controls = list(U) if len(U) == 1 or feedback is not None else [u.copy() for u in U]
        with self._lock:
            return [self.simulator.simulate(x0, u, feedback) for x0, u in zip(x0s, controls, strict=True)]

    def step(self, x: Array, u: Array, n: int = 0) -> tuple[Array, Array]:
        """One step by the joint-space mass matrix; see `Dynamics.step`."""
        x, u = as_array("x", x, (self.nx,)), as_array("u", u, (self.nu,))
        model, data, h = self.model, self.model.createData(), float(self.dt)
        q, v = x[: model.nq].copy(), x[model.nq :].copy()
        implicit = h * self.damping if self.integrator == "semi-implicit-euler" else 0.0 * self.damping
        tau = np.zeros(model.nv)
        tau[self._actuated] = u

        def acceleration(i: int, q: Array, v: Array) -> Array:
            upper = np.triu(pin.crba(model, data, q))
            M = upper + np.triu(upper, 1).T + np.diag(implicit)
            return np.linalg.solve(M, tau - self.damping * v - pin.nonLinearEffects(model, data, q, v))

        y = self._readings.read_plainly(model, data, q)
        if self.integrator == "rk4":
            from mjslq.dynamics.pinocchio.runge_kutta import runge_kutta

            q, v, _ = runge_kutta(model, h, q, v, acceleration)
        else:
            v = v + h * acceleration(0, q, v)
            q = pin.integrate(model, q, h * v)
        return np.concatenate([q, v]), y

    def step_each(self, X: ArrayLike, U: ArrayLike) -> tuple[Array, Array]:
        """One step from each knot; see `Dynamics.step_each`."""
        states, controls = (np.array(array, dtype=np.float64, order="C") for array in (X, U))
        with self._lock:
            return self.simulator.step_each(states, controls)

    def variation(self, names: tuple[str, ...] = ()) -> Variation:
        """See `Dynamics.variation`: steps of any length; it has no parameters."""
        from mjslq.dynamics.pinocchio.variation import PinocchioVariation

        return PinocchioVariation(self)

    def by_stretch(self, X: Array, U: Array, ends: Array) -> tuple[Array, Array] | None:
        """Exact for semi-implicit Euler; see `Dynamics.by_stretch`."""
        from mjslq.dynamics.pinocchio.variation import euler_by_stretch

        if self.integrator != "semi-implicit-euler":
            return None
        with self._lock:
            return euler_by_stretch(self.simulator, X, U), np.zeros((len(X), self.ny))

    def linearize(self, trajectory: Trajectory) -> Linearization:
        """Jacobians of every step of `trajectory`, and of the outputs at every knot."""
        self.check_trajectory(trajectory)
        with self._lock:
            return self.simulator.linearize(trajectory)

    def scene(self) -> Scene | None:
        """Return the robot as MuJoCo reads it, and where its pose is in x; None where it cannot."""
        return self._scene

    def support_report(self) -> list[tuple[str, str]]:
        """List what the system consists of and what serves it, as (part, what serves it)."""
        free = [name for name in self.state_names if name.startswith(models.ROOT + ".")]
        damping = "implicit, as MuJoCo's Euler" if self.integrator == "semi-implicit-euler" else "in each stage"
        parts = [
            (
                f"{self.model.njoints - 1} joints, {self.model.nv} dofs",
                "articulated-body algorithm, analytic Jacobians",
            ),
            ("integrator", self.integrator),
        ]
        if free:
            parts.append(("floating base", "a free joint on the manifold"))
        if self.damping.any():
            parts.append(("joint damping", damping))
        if self._ties is not None:
            followers = len(self.model.mimicking_joints)
            parts.append((f"{followers} joints that mimic others", "follow exactly, analytic Jacobians"))
        parts += [(f"output {name}", "analytic Jacobian") for name in self.outputs]
        if np.asarray(self.model.upperDryFrictionLimit).any():
            parts.append(("dry friction", "left out: MujocoDynamics has it"))
        return parts

    @cached_property
    def _scene(self) -> Scene | None:
        return self._drawn_by(self) if callable(self._drawn_by) else self._drawn_by

    @cached_property
    def simulator(self) -> Simulator:
        """Whole-horizon loops and their memory, made when first asked for; one caller at a time."""
        from mjslq.dynamics.pinocchio.algorithms import ForwardDynamics, TiedDynamics
        from mjslq.dynamics.pinocchio.runge_kutta import RungeKutta4
        from mjslq.dynamics.pinocchio.simulator import SemiImplicitEuler

        h, rest = float(self.dt), (self.damping, self._actuated, self._readings)
        kind: type[Simulator] = RungeKutta4
        model = self.model
        if self.integrator == "semi-implicit-euler":
            kind, model = SemiImplicitEuler, self.model.copy()
            model.armature = self.model.armature + h * self.damping
        body = ForwardDynamics(model) if self._ties is None else TiedDynamics(model, self._ties)
        return kind(body, h, *rest)


def _scene_of_file(
    file: Path,
    floating_base: bool,
    locked: dict[str, float],
    packages: Any,
    lines: dict[str, tuple[float, float]],
    dynamics: PinocchioDynamics,
) -> Scene | None:
    return models.viewer_scene(file, dynamics.model, floating_base, locked, dynamics.name, packages, lines)
