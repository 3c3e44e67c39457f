"""Joint positions of a result's model at any time of its motion.

Notation
--------
    q_n   joint positions at knot n. Shape (nq,)
    q(t) = q_n (+) s (q_{n+1} (-) q_n),   s = (t - t_n) / (t_{n+1} - t_n)

(+) and (-) are those of the configuration space (`mj_integratePos`, `mj_differentiatePos`), so that quaternions turn at
a constant rate between knots.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjslq.result import Result
from mjslq.validation import Array


class Motion:
    """The motion of a result up to the first knot that is not finite; callable with a time [s], returns q (nq,)."""

    def __init__(self, model: Any, result: Result) -> None:
        """Read the poses of `result` in `model`, which is that of its scene.

        Raises ValueError when the scene does not fit the model, or no knot is finite.
        """
        assert result.scene is not None
        qpos = result.scene.poses(result.trajectory.X)
        if qpos.shape[1] != model.nq:
            raise ValueError(
                f"the scene names {qpos.shape[1]} entries of the state as qpos, but its model has {model.nq}"
            )
        lost = np.flatnonzero(~np.isfinite(result.trajectory.X).all(axis=1))
        good = int(lost[0]) if len(lost) else len(qpos)
        if good == 0:
            raise ValueError("no state of the result is finite: there is nothing to draw")
        self._model = model
        self.times = result.trajectory.times[:good]
        """Time of each knot. Shape (n,). [s]"""
        self.qpos = qpos[:good]
        """Shape (n, nq)."""

    @property
    def duration(self) -> float:
        """Time of the last knot. [s]"""
        return float(self.times[-1])

    def __call__(self, time: float) -> Array:
        """Joint positions at `time` [s], held beyond the ends. Shape (nq,)."""
        last = len(self.times) - 1
        n = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, max(last - 1, 0)))
        q: Array = self.qpos[n].copy()
        if last == 0:
            return q
        span = self.times[n + 1] - self.times[n]
        share = float(np.clip((time - self.times[n]) / span, 0.0, 1.0))
        way = np.zeros(self._model.nv)
        mujoco.mj_differentiatePos(self._model, way, 1.0, q, self.qpos[n + 1])
        mujoco.mj_integratePos(self._model, q, way, share)
        return q
