"""A clip as something to follow: functions of time, costs, states, samples at other times."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.clips import resampling
from mjslq.clips.recording import velocity_entry
from mjslq.clips.resampling import Timing
from mjslq.costs import Frame
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.records import QUANTITIES, OfFrame
from mjslq.knots import When
from mjslq.losses import SHAPES
from mjslq.targets import Signal
from mjslq.validation import Array, as_array, choose, nonnegative, positive

if TYPE_CHECKING:
    from mjslq.clips.clip import Clip

WEIGHTS = dict(zip(QUANTITIES, (100.0, 10.0, 1.0, 0.1), strict=True))
"""Of the quantities of a frame, where none are given."""
WIDTHS = dict(zip(QUANTITIES, (0.1, 0.3, 1.0, 3.0), strict=True))
"""Of their losses. [m, rad, m/s, rad/s]"""
POSE_OF = {"linear-velocity": "position", "angular-velocity": "orientation"}
"""What velocities that were not recorded are differences of."""


@dataclass(frozen=True)
class FrameSignal(Signal):
    """A quantity of a frame as a function of the horizon's time."""

    of: str
    """"position", "orientation", "linear-velocity" or "angular-velocity"."""
    samples: Array
    """Times of the samples. Shape (T,). [s]"""
    values: Array
    """Of the quantity, or of the pose whose differences stand in for it. Shape (T, 3) | (T, 4)."""
    timing: Timing
    step: float | None = None
    """Of the differences; None where the quantity itself was recorded. [s]"""

    def over(self, times: Array) -> Array:
        """See `Signal.over`. Shape (k, 3) | (k, 4). Raises ValueError beyond the ends, where these are refused."""
        s, outside = self.timing.within(self.samples, times)
        if self.of == "orientation":
            return resampling.quaternions(self.samples, self.values, s)
        if self.of == "position":
            return resampling.numbers(self.samples, self.values, s)
        if self.step is None:
            speed = resampling.numbers(self.samples, self.values, s) / self.timing.stretch
        else:
            speed = self._differences(times)
        return np.where(outside[:, None], 0.0, speed)

    def _differences(self, times: Array) -> Array:
        """Velocities by the poses a step before and after, or at the ends of the recording."""
        held = Timing(self.timing.offset, self.timing.stretch)
        (behind, _), (ahead, _) = (held.within(self.samples, times + h) for h in (-self.step, self.step))  # type: ignore[operator]
        elapsed = self.timing.stretch * np.maximum(ahead - behind, np.finfo(float).tiny)
        if self.of == "linear-velocity":
            first, last = (resampling.numbers(self.samples, self.values, s) for s in (behind, ahead))
            return resampling.velocity(first, last, elapsed)
        first, last = (resampling.quaternions(self.samples, self.values, s) for s in (behind, ahead))
        return resampling.angular_velocity(first, last, elapsed)


@dataclass(frozen=True)
class JointSignal(Signal):
    """Joint positions as a function of the horizon's time."""

    samples: Array
    """Times of the samples. Shape (T,). [s]"""
    values: Array
    """Shape (T, m)."""
    quaternions: tuple[tuple[int, ...], ...]
    """Columns that are quaternions, four and four."""
    timing: Timing

    def over(self, times: Array) -> Array:
        """See `Signal.over`. Raises ValueError beyond the ends, where these are refused."""
        s, _ = self.timing.within(self.samples, times)
        found = resampling.numbers(self.samples, self.values, s)
        for columns in self.quaternions:
            found[:, columns] = resampling.quaternions(self.samples, self.values[:, columns], s)
        return found


def frame_signal(clip: Clip, frame: str, of: str, timing: Timing, step: float | None) -> FrameSignal:
    """See `Clip.signal`."""
    quantities = clip.frames[choose(f"frame of {clip.name!r}", frame, clip.frames)]
    choose("quantity of a frame", of, QUANTITIES)
    if of in quantities:
        return FrameSignal(of, clip.times, quantities[of], timing)
    pose = POSE_OF.get(of)
    if pose is None or pose not in quantities:
        raise ValueError(f"{clip.name!r} has no {of} of {frame!r}; it has: {', '.join(quantities)}")
    h = clip.duration / (len(clip.times) - 1) * timing.stretch if step is None else positive("step", step)
    return FrameSignal(of, clip.times, quantities[pose], timing, h)


def joint_signal(clip: Clip, entries: tuple[str, ...], timing: Timing) -> JointSignal:
    """See `Clip.joint_signal`."""
    for entry in entries:
        choose(f"joint position of {clip.name!r}", entry, clip.qpos)
    groups = tuple(tuple(entries.index(entry) for entry in group) for group in resampling.quaternion_groups(entries))
    values = np.stack([clip.qpos[entry] for entry in entries], axis=1) if entries else np.zeros((len(clip.times), 0))
    return JointSignal(clip.times, values, groups, timing)


def costs(
    clip: Clip,
    dynamics: Dynamics,
    weights: Mapping[Any, float] | None,
    loss: str | Mapping[Any, str],
    width: float | Mapping[Any, float] | None,
    acting: tuple[When, float],
    timing: Timing,
) -> list[Frame]:
    """See `Clip.costs`; `acting` are the knots, and the factor at the last one."""
    when, factor = acting[0], nonnegative("terminal", acting[1])
    losses = dict.fromkeys(QUANTITIES, loss) if isinstance(loss, str) else _by_quantity("loss", loss)
    widths = _by_quantity("width", width) if isinstance(width, Mapping) else dict.fromkeys(QUANTITIES, width)
    step = float(np.min(dynamics.dt))
    terms = []
    for name, of, weight in tracked(clip, weights):
        kind = losses.get(of, "quadratic")
        d = widths.get(of)
        if d is None and kind in SHAPES:
            d = WIDTHS[of]
        dynamics.frame_output(name, of)  # told here, with the name
        signal = frame_signal(clip, name, of, timing, step)
        last = None if factor == 1.0 else factor * weight
        term = Frame(name, signal, weight, when, of=of, loss=kind, width=d, terminal_weight=last)  # type: ignore[arg-type]
        terms.append(term)
    return terms


def tracked(clip: Clip, weights: Mapping[Any, float] | None = None) -> list[tuple[str, OfFrame, float]]:
    """Frames and quantities of a clip that have a weight, and which; see `Clip.costs`. Raises ValueError."""
    wanted: Mapping[OfFrame, float] = WEIGHTS if weights is None else _by_quantity("weights", weights)
    found = []
    for of, given in wanted.items():
        weight = nonnegative(f"weight of {of!r}", given)
        having = [name for name, samples in clip.frames.items() if of in samples or POSE_OF.get(of) in samples]
        if not having and weights is not None:
            raise ValueError(f"{clip.name!r} has no {of} of any frame")
        found += [(name, of, weight) for name in having if weight]
    if not found:
        raise ValueError(f"there is nothing to track: {clip.name!r} has no frames, or all weights are zero")
    return found


def states(clip: Clip, dynamics: Dynamics, times: Array, timing: Timing) -> Array:
    """See `Clip.states`; times (k,)."""
    if not clip.qpos:
        raise ValueError(f"{clip.name!r} has no joint positions (qpos), so that it gives no states")
    nv = dynamics.nv
    nq = dynamics.nx - dynamics.ndx + nv
    names = list(dynamics.state_names)
    where = [names.index(choose("joint position of the robot", entry, names[:nq])) for entry in clip.qpos]
    start = np.asarray(getattr(dynamics, "initial_state", np.zeros(dynamics.nx)))

    def positions(times: Array, timing: Timing) -> Array:
        X = np.tile(start, (len(times), 1))
        X[:, where] = joint_signal(clip, tuple(clip.qpos), timing).over(times)
        return dynamics.space.normalized(X)

    X, (_, outside) = positions(times, timing), timing.within(clip.times, times)
    held, h = Timing(timing.offset, timing.stretch), float(np.min(dynamics.dt))
    (behind, _), (ahead, _) = (held.within(clip.times, times + d) for d in (-h, h))
    elapsed = timing.stretch * np.maximum(ahead - behind, np.finfo(float).tiny)
    ends = (positions(times + d, held) for d in (-h, h))
    V = dynamics.difference(*ends)[:, :nv] / elapsed[:, None]
    for entry, samples in clip.qvel.items():
        column = velocity_entry(entry, names[nq : nq + nv])
        s, _ = timing.within(clip.times, times)
        V[:, column] = resampling.numbers(clip.times, samples[:, None], s)[:, 0] / timing.stretch
    X[:, nq : nq + nv] = np.where(outside[:, None], 0.0, V)
    return X


def resampled(clip: Clip, times: Array, timing: Timing) -> Clip:
    """See `Clip.resampled`."""
    if len(times) < 2 or (np.diff(times) <= 0.0).any():
        raise ValueError("times must be at least two, and increase")
    step = float(np.diff(times).mean())
    frames: dict[str, dict[str, Array]] = {}
    for name, samples in clip.frames.items():
        had = [of for of in QUANTITIES if of in samples or POSE_OF.get(of) in samples]
        frames[name] = {of: frame_signal(clip, name, of, timing, step).over(times) for of in had}
    qpos = joint_signal(clip, tuple(clip.qpos), timing).over(times)
    s, outside = timing.within(clip.times, times)
    qvel = {}
    for entry, speeds in clip.qvel.items():
        rates = resampling.numbers(clip.times, speeds[:, None], s)[:, 0] / timing.stretch
        qvel[entry] = np.where(outside, 0.0, rates)
    joints = dict(zip(clip.qpos, qpos.T, strict=True))
    return dataclasses.replace(clip, times=times, frames=frames, qpos=joints, qvel=qvel)


def _by_quantity(name: str, given: Any) -> dict[Any, Any]:
    if not isinstance(given, Mapping):
        as_array(name, given)
        raise ValueError(f"{name} must be a mapping from quantities of frames, such as {QUANTITIES[0]!r}, to numbers")
    for of in given:
        choose(f"quantity in {name}", of, QUANTITIES)
    return dict(given)
