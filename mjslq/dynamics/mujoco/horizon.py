"""`Horizon`: the compiled kernels' Python side. It holds mjData, fills in jobs, and makes trajectories of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.dynamics import Linearization
from mjslq.dynamics.mujoco import kernels
from mjslq.dynamics.mujoco.checks import refuse_callbacks
from mjslq.dynamics.mujoco.library import Workers, copied, quiet
from mjslq.trajectory import Trajectory
from mjslq.validation import Array


class Horizon:
    """A model with one mjData per thread. Not for several callers at once."""

    def __init__(self, model: mujoco.MjModel, threads: int):
        refuse_callbacks()
        self.model = model
        self.nx, self.ndx = model.nq + model.nv + model.na, 2 * model.nv + model.na
        self.workers = Workers(threads)
        self._data = [mujoco.MjData(model) for _ in range(threads)]

    def rollout(self, x0: Array, U: Array) -> Trajectory:
        """Run open loop; see `MujocoDynamics.rollout`."""
        return self._simulate(x0, U, [{}])[0]

    def rollout_candidates(
        self, reference: Trajectory, K: Array, k: Array, alphas: Sequence[float], x0: Array
    ) -> list[Trajectory]:
        """Run closed loop with each step size of `alphas`, as many at once as there are threads."""
        law = {"X_ref": reference.X, "U_ref": reference.U, "K": K, "k": k}
        found: list[Trajectory] = []
        for start in range(0, len(alphas), self.workers.count):
            together = alphas[start : start + self.workers.count]
            found += self._simulate(x0, reference.U, [law | {"alpha": float(alpha)} for alpha in together])
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
        model, data = self.model, self._data[0]
        mujoco.mj_resetData(model, data)
        data.time = n * model.opt.timestep
        data.qpos, data.qvel, data.act = np.split(x, [model.nq, model.nq + model.nv])
        data.ctrl = u
        with quiet():
            mujoco.mj_step(model, data)
        if data.warning.number.any():
            return np.full(self.nx, np.nan), data.sensordata.copy()
        return np.concatenate([data.qpos, data.qvel, data.act]), data.sensordata.copy()

    def _simulate(self, x0: Array, U: Array, laws: list[dict[str, Any]]) -> list[Trajectory]:
        """Simulate under each control law, one a thread; the laws are at most as many as the workers."""
        N, number, dt = len(U), len(laws), float(self.model.opt.timestep)
        X, Y = np.full((number, N + 1, self.nx), np.nan), np.full((number, N + 1, self.model.nsensordata), np.nan)
        X[:, 0], controls, bad_knots = x0, np.repeat(U[None], number, axis=0), np.zeros(number, np.int64)
        jobs = self._jobs(number, N, {})
        for i, law in enumerate(laws):
            _fill(jobs[i], {"X": X[i], "U": controls[i], "Y": Y[i], "bad_knot": bad_knots[i : i + 1], **law})
        self._run(kernels.simulate, jobs)
        found = []
        for x, u, y, knot in zip(X, controls, Y, bad_knots.tolist(), strict=True):
            if knot <= N:
                x[knot:], y[knot:], u[knot:] = np.nan, np.nan, U[knot:]
            found.append(Trajectory(x, u, y, dt, diverged_at=knot if knot <= N else None))
        return found

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
        jobs = np.zeros(len(self._data), kernels.JOB)
        sizes = {"nq": model.nq, "nv": model.nv, "na": model.na, "nu": model.nu, "ny": model.nsensordata}
        _fill(jobs, {"model": model._address, **sizes})
        for job, data in zip(jobs, self._data, strict=True):
            views = {
                "qpos": data.qpos, "qvel": data.qvel, "act": data.act, "ctrl": data.ctrl, "qacc": data.qacc,
                "warmstart": data.qacc_warmstart, "sensors": data.sensordata, "warnings": data.warning.number,
            }  # fmt: skip
            _fill(job, {"data": data._address, **views})
        return jobs


def _fill(job: Any, fields: dict[str, Any]) -> None:
    """Set fields of a job, or of all jobs of an array: arrays by address, numbers as they are."""
    for name, value in fields.items():
        job[name] = value.__array_interface__["data"][0] if isinstance(value, np.ndarray) else value
