"""`Simulator`: the compiled kernels' Python side. It holds mjData, fills in jobs, and makes trajectories of arrays."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.dynamics import Feedback, Linearization
from mjslq.dynamics.mujoco import kernels
from mjslq.dynamics.mujoco.checks import refuse_callbacks
from mjslq.dynamics.mujoco.library import Workers, copied, quiet
from mjslq.trajectory import Trajectory
from mjslq.validation import Array


class Simulator:
    """A model with one mjData per thread. Not for several callers at once."""

    def __init__(self, model: mujoco.MjModel, threads: int):
        refuse_callbacks()
        self.model = model
        self.nx, self.ndx = model.nq + model.nv + model.na, 2 * model.nv + model.na
        self.workers = Workers(threads)
        self.data = [mujoco.MjData(model) for _ in range(threads)]

    def rollouts(self, x0s: Array, U: Array, feedback: Feedback | None) -> list[Trajectory]:
        """Simulate several times, shared out among the threads; see `Dynamics.rollouts`."""
        (m, N, nu), dt, U = U.shape, float(self.model.opt.timestep), np.ascontiguousarray(U)
        X = [np.empty((N + 1, self.nx)) for _ in range(m)]  # one by one, so that keeping one does not keep all
        Y = [np.empty((N + 1, self.model.nsensordata)) for _ in range(m)]
        for x, x0 in zip(X, x0s, strict=True):
            x[0] = x0
        if feedback is None:
            applied, law = list(U) if m == 1 else [u.copy() for u in U], {}
        else:
            applied = [np.empty((N, nu)) for _ in range(m)]
            law = feedback.contiguous()._asdict()
            law["X_ref"] = law.pop("X")
        tables = {"X": _addresses(X), "Y": _addresses(Y), "U": _addresses(U), "applied": _addresses(applied)}
        bad_knots, workers = np.empty(m, np.int64), min(m, self.workers.count)
        jobs = self._jobs(workers, N, {**tables, **law, "bad_knots": bad_knots, "last": m, "stride": workers})
        jobs["first"] = np.arange(workers)
        self._run(kernels.simulate, jobs)
        found = []
        for x, u, y, given, knot in zip(X, applied, Y, U, bad_knots.tolist(), strict=True):
            if knot <= N:
                x[knot:], y[knot:] = np.nan, np.nan
                if feedback is not None:
                    u[knot:] = given[knot:]
            found.append(Trajectory.unchecked(x, u, y, dt, knot if knot <= N else None))
        return found

    def linearize_transition(self, trajectory: Trajectory, eps: float, centered: bool) -> Linearization:
        """Take differences of the step, the knots shared out among the threads."""
        N, nu, ny, ndx = trajectory.horizon, self.model.nu, self.model.nsensordata, self.ndx
        result = Linearization(
            np.zeros((N, ndx, ndx)), np.zeros((N, ndx, nu)), np.zeros((N + 1, ny, ndx)), np.zeros((N + 1, ny, nu))
        )
        shared = {"X": trajectory.X, "U": trajectory.U, **result._asdict(), "eps": eps, "centered": centered}
        knots = N + 1 if ny else N
        chunks = np.linspace(0, knots, min(self.workers.count, max(knots, 1)) + 1).astype(int)
        jobs = self._jobs(len(chunks) - 1, N, shared)
        jobs["first"], jobs["last"] = chunks[:-1], chunks[1:]
        self._run(kernels.transition, jobs)
        return result

    def step(self, x: Array, u: Array, n: int) -> tuple[Array, Array]:
        """Take one plain mj_step."""
        refuse_callbacks()
        model, data = self.model, self.data[0]
        mujoco.mj_resetData(model, data)
        data.time = n * model.opt.timestep
        data.qpos, data.qvel, data.act = np.split(x, [model.nq, model.nq + model.nv])
        data.ctrl = u
        with quiet():
            mujoco.mj_step(model, data)
        if data.warning.number.any():
            return np.full(self.nx, np.nan), data.sensordata.copy()
        return np.concatenate([data.qpos, data.qvel, data.act]), data.sensordata.copy()

    def _run(self, kernel: Any, jobs: np.ndarray[Any, Any]) -> None:
        refuse_callbacks()
        self.workers.run(kernels.address(kernel), jobs)

    def _jobs(self, number: int, N: int, fields: dict[str, Any]) -> np.ndarray[Any, Any]:
        """Make `number` jobs with the model's own entries and `fields`: arrays by address, numbers as they are.

        The caller keeps the arrays alive until the kernel is done.
        """
        jobs = copied(self._blank[:number])
        _fill(jobs, {"N": N, **fields})
        return jobs

    @cached_property
    def _blank(self) -> np.ndarray[Any, Any]:
        """A job for each thread, with what never changes filled in."""
        model = self.model
        jobs = np.zeros(len(self.data), kernels.JOB)
        sizes = {"nq": model.nq, "nv": model.nv, "na": model.na, "nu": model.nu, "ny": model.nsensordata}
        _fill(jobs, {"model": model._address, **sizes})
        for job, data in zip(jobs, self.data, strict=True):
            views = {
                "qpos": data.qpos, "qvel": data.qvel, "act": data.act, "ctrl": data.ctrl, "qacc": data.qacc,
                "warmstart": data.qacc_warmstart, "sensors": data.sensordata, "warnings": data.warning.number,
            }  # fmt: skip
            _fill(job, {"data": data._address, **views})
        return jobs


def _addresses(arrays: Iterable[Array]) -> np.ndarray[Any, Any]:
    """Where the numbers of each array are."""
    return np.array([array.__array_interface__["data"][0] for array in arrays], np.int64)


def _fill(job: Any, fields: dict[str, Any]) -> None:
    """Set fields of a job, or of all jobs of an array: arrays by address, numbers as they are."""
    for name, value in fields.items():
        job[name] = value.__array_interface__["data"][0] if isinstance(value, np.ndarray) else value
