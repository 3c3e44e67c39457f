"""What a recording is at other times: straight lines between samples, and on the sphere arcs at a constant rate.

Notation
--------
    s_i                  times of the samples, i = 0 ... T-1 [s]
    a = (s - s_i) / (s_{i+1} - s_i)        share of the way from sample i to the next, s_i <= s <= s_{i+1}

    numbers              v = (1 - a) v_i + a v_{i+1}
    unit quaternions     q = q_i exp(a log(q_i^-1 q_{i+1})),  the sign of q_{i+1} taken so that the arc is the shorter

    velocities of poses without recorded ones, from those at t - h and t + h, both kept within the recording:
        v = (p_+ - p_-) / (t_+ - t_-),     w = log(q_+ q_-^-1) / (t_+ - t_-),  in the world's axes

Clip time and the horizon's: s = s_0 + offset + t / stretch. Velocities are 1/stretch times the recorded ones.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mjslq.rotation import conjugate, exp, log, product
from mjslq.validation import Array, choose, finite, positive

Beyond = Literal["hold", "refuse"]
CHOICES = ("hold", "refuse")
QUATERNION = ("qw", "qx", "qy", "qz")
"""How the names of a quaternion's entries end."""
SLACK = 1e-9
"""How far a time may be beyond the ends, in parts of the duration, and count as the end."""


@dataclass(frozen=True)
class Timing:
    """Which part of a clip a horizon sees, and how fast.

    Raises ValueError for numbers that are not finite, a stretch that is not above zero, or another word for `beyond`.
    """

    offset: float = 0.0
    """Time after the clip's first sample that the horizon's time 0 falls on. [s]"""
    stretch: float = 1.0
    """How much longer the motion takes than the recording: 2 is half the speed."""
    beyond: Beyond = "hold"
    """What is before the first and after the last sample: "hold" that pose, at rest, or "refuse" with a ValueError."""

    def __post_init__(self) -> None:
        finite("offset", self.offset)
        positive("stretch", self.stretch)
        choose("way to go beyond a clip", self.beyond, CHOICES)

    def within(self, samples: Array, t: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Times of the clip at the horizon's times `t` (k,), kept within its samples, and which were beyond. [s]"""
        s = samples[0] + self.offset + t / self.stretch
        slack = SLACK * max(samples[-1] - samples[0], abs(samples[0]), abs(samples[-1]))
        outside = (s < samples[0] - slack) | (s > samples[-1] + slack)
        if self.beyond == "refuse" and outside.any():
            n = int(np.argmax(outside))
            raise ValueError(
                f"the clip lasts from {samples[0]:g} to {samples[-1]:g} s, but {s[n]:g} s is asked for; shorten the "
                f'horizon, change offset or stretch, or hold the pose at its ends with beyond="hold"'
            )
        return np.clip(s, samples[0], samples[-1]), outside


def quaternion_groups(entries: Iterable[str]) -> list[tuple[str, ...]]:
    """The entries that are quaternions, four and four. Raises ValueError where some of the four are missing."""
    names = list(entries)
    owners = dict.fromkeys(name[:-3] for name in names if name[-3:-2] == "." and name[-2:] in QUATERNION)
    groups = [tuple(f"{owner}.{end}" for end in QUATERNION) for owner in owners]
    for owner, group in zip(owners, groups, strict=True):
        missing = [entry for entry in group if entry not in names]
        if missing:
            raise ValueError(f"the quaternion of qpos {owner!r} is not whole: {', '.join(missing)} missing")
    return groups


def numbers(samples: Array, values: Array, s: Array) -> Array:
    """Values (T, m) at the times `s` (k,) within the samples. Shape (k, m)."""
    i, a = _between(samples, s)
    straight: Array = (1.0 - a) * values[i] + a * values[i + 1]
    return straight


def quaternions(samples: Array, Q: Array, s: Array) -> Array:
    """Unit quaternions (T, 4) at the times `s` (k,) within the samples. Shape (k, 4)."""
    i, a = _between(samples, s)
    turn = product(conjugate(Q[i]), Q[i + 1])
    turn = np.where(turn[:, :1] < 0.0, -turn, turn)
    q = product(Q[i], exp(a * log(turn)))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    exact = (a == 0.0) | (a == 1.0)
    return np.where(exact, Q[np.where(a[:, 0] == 1.0, i + 1, i)], q)


def velocity(p_behind: Array, p_ahead: Array, elapsed: Array) -> Array:
    """Mean velocity between positions (k, 3). Shape (k, 3)."""
    mean: Array = (p_ahead - p_behind) / elapsed[:, None]
    return mean


def angular_velocity(q_behind: Array, q_ahead: Array, elapsed: Array) -> Array:
    """Mean angular velocity between unit quaternions (k, 4), in the world's axes. Shape (k, 3)."""
    turn = product(q_ahead, conjugate(q_behind))
    mean: Array = log(np.where(turn[:, :1] < 0.0, -turn, turn)) / elapsed[:, None]
    return mean


def continuous(Q: Array) -> Array:
    """Quaternions (T, 4) with signs such that neighbours lie on the same side."""
    flips = np.concatenate([[1.0], np.where((Q[1:] * Q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)])
    same: Array = np.cumprod(flips)[:, None] * Q
    return same


def _between(samples: Array, s: Array) -> tuple[NDArray[np.intp], Array]:
    """Sample before each time, and the share of the way to the next. Shapes (k,), (k, 1)."""
    i = np.clip(np.searchsorted(samples, s, side="right") - 1, 0, len(samples) - 2)
    return i, ((s - samples[i]) / (samples[i + 1] - samples[i]))[:, None]
