"""`Clip`: a recorded motion, of frames in the world, of a robot's joints, or of both.

Notation
--------
    s_i                 times of the T samples, increasing; need not begin at 0 nor be even [s]
    frames              name -> quantity -> samples: "position" (T, 3) [m], "orientation" (T, 4), unit quaternions
                        (w, x, y, z), "linear-velocity" (T, 3) [m/s], "angular-velocity" (T, 3) [rad/s], all of them
                        in the world's axes, each of them optional
    qpos, qvel          entry of the state -> samples (T,), as `Dynamics.state_names` calls them: "knee", "root.x",
                        "root.qw"; velocities "knee" (for "knee.vel"), "root.vx"
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mjslq.clips.resampling import Beyond, Timing, continuous, quaternion_groups
from mjslq.costs import Frame
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.records import QUANTITIES
from mjslq.knots import When
from mjslq.validation import Array, as_array, choose, frozen

if TYPE_CHECKING:
    from mjslq.clips.following import FrameSignal, JointSignal
    from mjslq.problem import Problem

SIZES = dict(zip(QUANTITIES, (3, 4, 3, 3), strict=True))
ROUNDING = 1e-3
"""How far the length of a recorded quaternion may be from 1, as of rounded digits."""
RESERVED = ("time", "qpos", "qvel")
"""What no frame can be called: columns of files begin with these."""


@dataclass(frozen=True, eq=False)
class Clip:
    """A recorded motion; `mjslq.clips.load` reads one, `Clip.record` makes one of a motion.

    Raises ValueError, in one sentence, for times that do not increase, samples of other shapes or not finite,
    quaternions that are not of unit length (to 1e-3; they are scaled), and unknown quantities.

    >>> from mjslq.robots import robot_spec
    >>> arm = mjslq.MujocoDynamics.from_spec(robot_spec("ur5"), timestep=0.01)
    >>> motion = arm.rollout(arm.initial_state, np.zeros((10, 6)))
    >>> clip = mjslq.Clip.record(motion, arm, frames=["forearm_link"])
    >>> clip.signal("forearm_link")(0.05).shape
    (3,)
    """

    times: Array
    """s_i. Shape (T,), T at least 2. [s]"""
    frames: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)
    """Samples by frame and quantity. Shapes (T, 3), (T, 4)."""
    qpos: Mapping[str, Array] = field(default_factory=dict)
    """Joint positions by entry of the state; a quaternion's four entries go together. Shape (T,). [rad or m]"""
    qvel: Mapping[str, Array] = field(default_factory=dict)
    """Joint velocities by entry of the state. Shape (T,). [rad/s or m/s]"""
    name: str = "clip"
    """For messages."""

    def __post_init__(self) -> None:
        times = as_array("times", self.times, ("T",))
        if len(times) < 2:
            raise ValueError(f"times must have at least 2 samples, got {len(times)}")
        late = np.flatnonzero(np.diff(times) <= 0.0)
        if late.size:
            n = int(late[0])
            raise ValueError(f"times must increase, but times[{n + 1}] = {times[n + 1]:g} follows {times[n]:g}")
        T, store = len(times), object.__setattr__
        frames: dict[str, dict[str, Array]] = {}
        for name, quantities in self.frames.items():
            _refuse_name(name)
            frames[name] = {}
            for of, samples in quantities.items():
                choose(f"quantity of frame {name!r}", of, QUANTITIES)
                array = as_array(f"{of} of {name!r}", samples, (T, SIZES[of]))  # type: ignore[index]
                if of == "orientation":
                    array = unit(f"orientation of {name!r}", array)
                frames[name][of] = frozen(np.array(array))
        if not any(frames.values()) and not self.qpos:
            raise ValueError("a clip must have at least one frame or joint")
        qpos = {name: as_array(f"qpos of {name!r}", samples, (T,)) for name, samples in self.qpos.items()}
        for group in quaternion_groups(qpos):
            Q = unit(f"qpos {group[0][:-3]!r}", np.stack([qpos[entry] for entry in group], axis=1))
            qpos |= dict(zip(group, Q.T, strict=True))
        qvel = {name: as_array(f"qvel of {name!r}", samples, (T,)) for name, samples in self.qvel.items()}
        store(self, "times", frozen(np.array(times)))
        store(self, "frames", frames)
        store(self, "qpos", {name: frozen(np.array(samples)) for name, samples in qpos.items()})
        store(self, "qvel", {name: frozen(np.array(samples)) for name, samples in qvel.items()})

    @classmethod
    def record(cls, motion: Any, dynamics: Dynamics, frames: Iterable[str] = (), name: str = "clip") -> Clip:
        """A clip of a motion: a sample at each knot, of the joints and of `frames`.

        Parameters
        ----------
        motion : Trajectory, or Result or ClosedLoop, which have one
        dynamics : Dynamics
            The system that moved. MuJoCo's needs no sensors for the frames; others have them among their outputs.
        frames : names
            Bodies, sites, geoms or cameras; all four quantities of each are recorded, or those that the engine reads.
        name : str
            What the clip is called.
        """
        from mjslq.clips.recording import record

        return cls(*record(motion, dynamics, tuple(frames)), name=name)

    def __repr__(self) -> str:
        kinds = f"{len(self.frames)} frames, {len(self.qpos)} joint positions"
        return f"Clip({self.name!r}, {len(self.times)} samples over {self.duration:g} s, {kinds})"

    @property
    def duration(self) -> float:
        """From the first sample to the last. [s]"""
        return float(self.times[-1] - self.times[0])

    def renamed(self, names: Mapping[str, str]) -> Clip:
        """The frames that `names` lists (name in the clip -> name in the model), called as the model calls them.

        Raises ValueError for names that the clip has not, listing those that it has.
        """
        for name in names:
            choose(f"frame of {self.name!r}", name, self.frames)
        if len(set(names.values())) < len(names):
            raise ValueError(f"names must lead to different frames of the model, got {', '.join(names.values())}")
        return dataclasses.replace(self, frames={new: self.frames[old] for old, new in names.items()})

    def resampled(self, times: ArrayLike, offset: float = 0.0, stretch: float = 1.0, beyond: Beyond = "hold") -> Clip:
        """The clip with samples at other times (k,), such as those of a horizon's knots. [s]

        Straight lines between samples, arcs for orientations; see `mjslq.clips.Timing` for the rest. Frames without
        recorded velocities get those of the new samples: differences of neighbours, one-sided at the ends of the clip.
        """
        from mjslq.clips import following

        return following.resampled(self, as_array("times", times, ("k",)), Timing(offset, stretch, beyond))

    def signal(
        self,
        frame: str,
        of: str = "position",
        offset: float = 0.0,
        stretch: float = 1.0,
        beyond: Beyond = "hold",
        step: float | None = None,
    ) -> FrameSignal:
        """The quantity `of` a `frame` as a function of time, for the `target` of a cost.

        The clip's time is `offset` + t / `stretch`; `beyond` says what holds beyond its ends. `step` is that of the
        differences which stand in for velocities that were not recorded [s]; the mean distance of the samples unless
        given. Raises ValueError for frames and quantities that the clip has not.
        """
        from mjslq.clips import following

        return following.frame_signal(self, frame, of, Timing(offset, stretch, beyond), step)

    def joint_signal(
        self, entries: Iterable[str], offset: float = 0.0, stretch: float = 1.0, beyond: Beyond = "hold"
    ) -> JointSignal:
        """Positions of the joints `entries` as a function of time, such as the targets of servos. Raises ValueError.

        `offset`, `stretch` and `beyond` as in `signal`.
        """
        from mjslq.clips import following

        return following.joint_signal(self, tuple(entries), Timing(offset, stretch, beyond))

    def costs(
        self,
        dynamics: Dynamics,
        weights: Mapping[Any, float] | None = None,
        *,
        names: Mapping[str, str] | None = None,
        loss: str | Mapping[Any, str] = "pseudo-huber",
        width: float | Mapping[Any, float] | None = None,
        when: When = "always",
        terminal: float = 1.0,
        offset: float = 0.0,
        stretch: float = 1.0,
        beyond: Beyond = "hold",
    ) -> list[Frame]:
        """Costs of the distance of a robot's frames from those of the clip, a term for each frame and quantity.

        Their targets are functions of time, so that a receding horizon moves along the clip.

        Parameters
        ----------
        dynamics : Dynamics
            The robot; it has to read the frames (`MujocoDynamics.from_path(..., frames=clip.frames)`).
        weights : mapping
            Weight of each quantity; "position" 100, "orientation" 10, "linear-velocity" 1, "angular-velocity" 0.1
            unless given. Those that it leaves out are not tracked.
        names : mapping
            Frames to track, name in the clip -> name in the model; all, by their own names, unless given.
        loss : str or mapping
            Loss of all quantities, or of each; see `mjslq.losses`.
        width : float or mapping
            Width of the losses other than "quadratic"; "position" 0.1 m, "orientation" 0.3 rad, "linear-velocity"
            1 m/s, "angular-velocity" 3 rad/s unless given.
        when : When
            Knots at which they act; see `mjslq.knots.When`.
        terminal : float
            With when="always": factor of the weights at the last knot, where the losses are values and not integrals
            over time. Small ones suit a receding horizon, whose last knots are never carried out.
        offset, stretch, beyond
            Which part of the clip, how fast, and what is beyond its ends: see `mjslq.clips.Timing`.

        Returns
        -------
        list of mjslq.costs.Frame
            Velocities that were not recorded are differences of the clip over a step of the horizon to either side.

        Raises
        ------
        ValueError
            For names that the clip or the model has not, frames that the engine does not read, quantities that no
            frame of the clip has, and losses and widths that do not go together.
        """
        from mjslq.clips import following

        clip = self if names is None else self.renamed(names)
        return following.costs(clip, dynamics, weights, loss, width, (when, terminal), Timing(offset, stretch, beyond))

    def states(
        self,
        dynamics: Dynamics,
        times: ArrayLike,
        offset: float = 0.0,
        stretch: float = 1.0,
        beyond: Beyond = "hold",
    ) -> Array:
        """States of the robot `dynamics` at `times`: one, shape (nx,), or several (k,), shape (k, nx). [s]

        `offset`, `stretch` and `beyond` as in `signal`. Joint positions are those of the clip, or the robot's initial
        ones where it has none; velocities the recorded ones, or differences over a step of the horizon to either side.
        Raises ValueError for a clip without joint positions, or with entries that are not the robot's.
        """
        from mjslq.clips import following

        at = as_array("times", times)
        X = following.states(self, dynamics, np.atleast_1d(at), Timing(offset, stretch, beyond))
        return X if at.ndim else X[0]

    def guess(self, problem: Problem, offset: float = 0.0, stretch: float = 1.0, beyond: Beyond = "hold") -> Array:
        """States at the knots of the horizon of `problem`, for `solve(problem, X0=...)`. Shape (N + 1, nx).

        `offset`, `stretch` and `beyond` as in `signal`. They need not obey the dynamics. Raises ValueError as `states`
        does.
        """
        steps = problem.dynamics.steps(problem.horizon)
        times = problem.t0 + np.concatenate([[0.0], np.cumsum(steps)])
        return self.states(problem.dynamics, times, offset, stretch, beyond)

    def save(self, path: str | os.PathLike[str], digits: int | None = None) -> None:
        """Write to `path`, .npz or .csv by its ending; see `mjslq.clips.files` for the formats.

        `digits` rounds the numbers of a CSV to so many decimals; every number is read back as it is unless given.
        Raises ValueError for another ending, and where the file cannot be written.
        """
        from mjslq.clips.files import save

        save(self, path, digits)


def unit(name: str, Q: Array) -> Array:
    """Quaternions (T, 4) scaled to unit length, their signs continuous. Raises ValueError for other lengths."""
    length = np.linalg.norm(Q, axis=1)
    wrong = np.abs(length - 1.0) > ROUNDING
    if wrong.any():
        n = int(np.argmax(wrong))
        raise ValueError(f"{name} must be unit quaternions (w, x, y, z), but sample {n} has the length {length[n]:.4g}")
    return continuous(np.where(np.abs(length - 1.0)[:, None] > 1e-12, Q / length[:, None], Q))


def _refuse_name(name: Any) -> None:
    if not isinstance(name, str) or not name:
        raise ValueError(f"a frame's name must be a text that is not empty, got {name!r}")
    if name in RESERVED or name.startswith(("qpos.", "qvel.")):
        raise ValueError(f"a frame cannot be called {name!r}: columns of files that begin so are something else")
