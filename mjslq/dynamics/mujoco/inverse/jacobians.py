"""Jacobians of MuJoCo's discrete step through its inverse dynamics: the Python side.

The mathematics stands at the head of `kernel`; which models are covered, in `cover`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.dynamics._base import Linearization
from mjslq.dynamics.mujoco import kernels
from mjslq.dynamics.mujoco.inverse.job import INDICES, JOB, VIEWS, WORK
from mjslq.dynamics.mujoco.inverse.layout import offsets
from mjslq.dynamics.mujoco.inverse.outputs import sensors
from mjslq.dynamics.mujoco.inverse.plan import arrays, plan
from mjslq.trajectory import Trajectory

if TYPE_CHECKING:
    import mujoco

    from mjslq.dynamics.mujoco.horizon import Horizon


class InverseJacobians:
    """Linearizes trajectories of a covered model, with the workers and mjData of a `Horizon`."""

    def __init__(self, horizon: Horizon, eps: float, centered: bool):
        self._horizon = horizon
        self._table = (
            plan(horizon.model) | arrays(sensors(horizon.model)) | arrays({"eps": eps, "centered": int(centered)})
        )
        feelings = ("sensors_accelerated", "sensors_on_rows", "sensors_differenced", "sensors_cut")
        self._feels = any(bool(self._table[name]) for name in feelings)
        self._work = [self._workspace() for _ in range(horizon.workers.count)]
        self._offsets = {"at_" + name.replace(".", "_"): at for name, at in offsets().items()}

    def linearize(self, trajectory: Trajectory) -> Linearization:
        """Jacobians of every step and of the outputs, the knots shared out among the workers."""
        from mjslq.dynamics.mujoco.inverse.kernel import kernel

        horizon, N = self._horizon, trajectory.horizon
        nu, ny, ndx = horizon.model.nu, horizon.model.nsensordata, horizon.ndx
        result = Linearization(
            np.empty((N, ndx, ndx)), np.empty((N, ndx, nu)), np.zeros((N + 1, ny, ndx)), np.zeros((N + 1, ny, nu))
        )
        knots = N + 1 if ny else N
        chunks = np.linspace(0, knots, min(horizon.workers.count, max(knots, 1)) + 1).astype(int)
        jobs = np.zeros(len(chunks) - 1, JOB)
        jobs["N"], jobs["first"], jobs["last"] = N, chunks[:-1], chunks[1:]
        jobs["model"] = horizon.model._address
        arrays = {**result._asdict(), "X": np.ascontiguousarray(trajectory.X), "U": np.ascontiguousarray(trajectory.U)}
        for name, value in {**self._table, **self._offsets, **arrays}.items():
            jobs[name] = value.ctypes.data if np.ndim(value) else value
        for job, data, work in zip(jobs, horizon._data, self._work, strict=False):
            _point_at(job, data, work)
        horizon.workers.run(kernels.address(kernel(self._feels)), jobs)
        return result

    def _workspace(self) -> dict[str, Any]:
        """Arrays for intermediate results of one worker."""
        sizes = [[int(self._table[n]) if isinstance(n, str) else n for n in shape] for shape in WORK.values()]
        indices = {name: np.zeros(int(self._table["nv"]), np.int64) for name in INDICES}
        return dict(zip(WORK, map(np.zeros, sizes), strict=True)) | indices


def _point_at(job: Any, data: mujoco.MjData, work: dict[str, Any]) -> None:
    """Enter the addresses of one mjData, of its arrays, and of a workspace."""
    job["data"] = data._address
    for name in VIEWS:
        job[name] = getattr(data, name).ctypes.data
    for name, array in work.items():
        job[name] = array.ctypes.data
