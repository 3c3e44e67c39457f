"""`Scene`: a compiled MuJoCo model and how to read its pose out of a state, without any engine behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjslq.validation import Array


@dataclass(frozen=True)
class Marker:
    """A place where a cost wants a frame or a sensor to be."""

    name: str
    """Of the frame or sensor."""
    position: tuple[float, float, float]
    """In the world. [m]"""


@dataclass(frozen=True)
class Scene:
    """What a viewer needs to draw a trajectory; kept inside saved results.

    Examples
    --------
    >>> problem = mjslq.problems.get("hopper")
    >>> scene, motion = problem.scene(), problem.rollout(problem.U0)
    >>> scene.poses(motion.X).shape == (problem.horizon + 1, len(scene.columns))
    True
    """

    model: bytes
    """The compiled model in MuJoCo's binary format (MJB). Made to be drawn: the boxes around parts of meshes that
    speed up collisions, half the size of many robots, may be zero in it."""
    columns: tuple[int, ...]
    """Entries of the state x that are the model's qpos, in its order. Length nq."""
    name: str = "model"
    """The model's name, for titles."""
    lines: tuple[tuple[float, float], ...] = ()
    """(m, o) of each entry of qpos, which is m x + o, as of joints that mimic others; empty where all are (1, 0)."""
    markers: tuple[Marker, ...] = ()
    """Targets of the problem's costs."""

    def poses(self, X: Array) -> Array:
        """Joint positions qpos of the model along the states `X` (N + 1, nx). Shape (N + 1, nq)."""
        poses = np.asarray(X)[:, list(self.columns)]
        if self.lines:
            multiplier, offset = np.array(self.lines).T
            poses = multiplier * poses + offset
        return np.ascontiguousarray(poses)
