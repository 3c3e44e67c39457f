"""`Horizon`: the compiled kernels' Python side. It holds mjData, fills in jobs, and makes trajectories of arrays."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjslq._validation import Array
from mjslq.dynamics import _mujoco_kernels as kernels
from mjslq.dynamics._base import Linearization
from mjslq.dynamics._mujoco_checks import refuse_callbacks
from mjslq.dynamics._mujoco_library import Workers, quiet
from mjslq.trajectory import Trajectory


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
        return self._simulate(x0, U, {})

    def rollout_feedback(self, reference: Trajectory, K: Array, k: Array, alpha: float, x0: Array) -> Trajectory:
        """Run closed loop; see `MujocoDynamics.rollout_feedback`."""
        law = {"X_ref": reference.X, "U_ref": reference.U, "K": K, "k": k, "alpha": alpha}
        return self._simulate(x0, reference.U, law)

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

    def _simulate(self, x0: Array, U: Array, law: dict[str, Any]) -> Trajectory:
        N = len(U)
        X, Y = np.full((N + 1, self.nx), np.nan), np.full((N + 1, self.model.nsensordata), np.nan)
        X[0], U = x0, np.array(U)
        U_given, bad_knot = U.copy(), np.zeros(1, np.int64)
        jobs = self._jobs(1, N, {"X": X, "U": U, "Y": Y, "bad_knot": bad_knot, **law})
        self._run(kernels.simulate, jobs)
        dt, bad = float(self.model.opt.timestep), int(bad_knot[0])
        if bad > N:
            return Trajectory(X, U, Y, dt)
        X[bad:], Y[bad:], U[bad:] = np.nan, np.nan, U_given[bad:]
        return Trajectory(X, U, Y, dt, diverged_at=bad)

    def _run(self, kernel: Any, jobs: np.ndarray[Any, Any]) -> None:
        refuse_callbacks()
        self.workers.run(kernels.address(kernel), jobs)

    def _jobs(self, number: int, N: int, fields: dict[str, Any]) -> np.ndarray[Any, Any]:
        """Fill in `number` jobs with the model's own entries and `fields`: arrays by address, numbers as they are.

        The caller keeps the arrays alive until the kernel is done.
        """
        model = self.model
        jobs = np.zeros(number, kernels.JOB)
        jobs["N"], jobs["model"] = N, model._address
        jobs["nq"], jobs["nv"], jobs["na"], jobs["nu"], jobs["ny"] = (
            model.nq, model.nv, model.na, model.nu, model.nsensordata
        )  # fmt: skip
        for job, data in zip(jobs, self._data, strict=False):
            job["data"] = data._address
            views = {
                "qpos": data.qpos, "qvel": data.qvel, "act": data.act, "ctrl": data.ctrl, "qacc": data.qacc,
                "warmstart": data.qacc_warmstart, "sensors": data.sensordata, "warnings": data.warning.number,
            }  # fmt: skip
            for name, view in views.items():
                job[name] = view.ctypes.data
        for name, value in fields.items():
            jobs[name] = value.ctypes.data if isinstance(value, np.ndarray) else value
        return jobs
