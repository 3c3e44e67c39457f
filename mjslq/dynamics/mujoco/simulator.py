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
    """A model with one mjData per thread, whose controls are held over `substeps` steps. Not for several callers."""

    def __init__(self, model: mujoco.MjModel, threads: int, substeps: int = 1):
        refuse_callbacks()
        self.model, self.substeps = model, substeps
        self.dt = substeps * float(model.opt.timestep)
        self.nx, self.ndx = model.nq + model.nv + model.na, 2 * model.nv + model.na
        self.workers = Workers(threads)
        self.data = [mujoco.MjData(model) for _ in range(threads)]

    def rollouts(self, x0s: Array, U: Array, feedback: Feedback | None) -> list[Trajectory]:
        """Simulate several times, shared out among the threads; see `Dynamics.rollouts`."""
        (m, N, nu), U = U.shape, np.ascontiguousarray(U)
        X = [np.empty((N + 1, self.nx)) for _ in range(m)]  # one by one, so that keeping one does not keep all
        Y = [np.empty((N + 1, self.model.nsensordata)) for _ in range(m)]
        S = [self._substates(N) for _ in range(m)]
        for x, x0 in zip(X, x0s, strict=True):
            x[0] = x0
        if feedback is None:
            applied, law = list(U) if m == 1 else [u.copy() for u in U], {}
        else:
            applied = [np.empty((N, nu)) for _ in range(m)]
            law = feedback.contiguous()._asdict()
            law["X_ref"] = law.pop("X")
        arrays: dict[str, Iterable[Array]] = {"X": X, "Y": Y, "S": S, "U": U, "applied": applied}
        tables = {name: _addresses(parts) for name, parts in arrays.items()}
        bad_knots, workers = np.empty(m, np.int64), min(m, self.workers.count)
        jobs = self._jobs(workers, N, {**tables, **law, "bad_knots": bad_knots, "last": m, "stride": workers})
        jobs["first"] = np.arange(workers)
        self._run(kernels.simulate, jobs)
        found = []
        for x, u, y, between, given, knot in zip(X, applied, Y, S, U, bad_knots.tolist(), strict=True):
            if knot <= N:
                x[knot:], y[knot:], between[max(knot - 1, 0) :] = np.nan, np.nan, np.nan
                if feedback is not None:
                    u[knot:] = given[knot:]
            bad = knot if knot <= N else None
            found.append(Trajectory.unchecked(x, u, y, self.dt, bad, between if self.substeps > 1 else None))
        return found

    def step_each(self, X: Array, U: Array) -> tuple[Array, Array, Array]:
        """One step from each knot, X (N + 1, nx), U (N, nu), the knots shared out among the threads.

        Returns where they end (N, nx), the states between (N, k - 1, nx) and the outputs (N + 1, ny).
        """
        N, X, U = len(U), np.ascontiguousarray(X), np.ascontiguousarray(U)
        F, S, Y = np.empty((N, self.nx)), self._substates(N), np.empty((N + 1, self.model.nsensordata))
        self._run_knots(kernels.step_each, N + 1, N, {"X": X, "U": U, "F": F, "S": S, "Y": Y, "dt": self.dt})
        return F, S, Y

    def substates(self, X: Array, U: Array) -> Array:
        """States between the knots, simulated from each knot. Shape (N, k - 1, nx)."""
        return self.step_each(X, U)[1] if self.substeps > 1 else self._substates(len(U))

    def transition(self, X: Array, U: Array, eps: float, S: Array | None = None, outputs: bool = True) -> Linearization:
        """One-sided differences of the step by mjd_transitionFD, to the side that eps's sign says.

        States X (M, nx) or (M + 1, nx) under U (M, nu); the outputs at a last state without a step are read without
        control. With states between S (M, k - 1, nx) the Jacobians are those of the held control, else of a single
        simulator step. The knots are shared out among the threads.
        """
        knots, M, nu, ny, ndx = len(X), len(U), self.model.nu, self.model.nsensordata if outputs else 0, self.ndx
        result = Linearization(
            np.zeros((M, ndx, ndx)), np.zeros((M, ndx, nu)), np.zeros((knots, ny, ndx)), np.zeros((knots, ny, nu))
        )
        S = np.empty((M, 0, self.nx)) if S is None else S
        states = {name: np.ascontiguousarray(array) for name, array in (("X", X), ("U", U), ("S", S))}
        numbers = {"eps": eps, "centered": False, "substeps": S.shape[1] + 1, "ny": ny}
        self._run_knots(kernels.transition, knots if ny else M, M, states | numbers | result._asdict())
        return result

    def known_substates(self, trajectory: Trajectory) -> Array:
        """The states between the knots of `trajectory`, simulated anew where it does not have them."""
        S = trajectory.substates
        if S is not None and S.shape[1] == self.substeps - 1:
            return S
        return self.substates(trajectory.X, trajectory.U)

    def shares(self, knots: int) -> np.ndarray[Any, Any]:
        """First knot of each worker's share of `knots`, and behind them the number of all."""
        return np.linspace(0, knots, min(self.workers.count, max(knots, 1)) + 1).astype(int)

    def _run_knots(self, kernel: Any, knots: int, N: int, fields: dict[str, Any]) -> None:
        """Share out `knots` among the threads."""
        shares = self.shares(knots)
        jobs = self._jobs(len(shares) - 1, N, fields)
        jobs["first"], jobs["last"] = shares[:-1], shares[1:]
        self._run(kernel, jobs)

    def _substates(self, N: int) -> Array:
        return np.empty((N, self.substeps - 1, self.nx))

    def step(self, x: Array, u: Array, n: int) -> tuple[Array, Array]:
        """Take one step by plain calls to mj_step."""
        refuse_callbacks()
        model, data = self.model, self.data[0]
        mujoco.mj_resetData(model, data)
        data.time = n * self.dt
        data.qpos, data.qvel, data.act = np.split(x, [model.nq, model.nq + model.nv])
        data.ctrl = u
        with quiet():
            mujoco.mj_step(model, data)
            y = data.sensordata.copy()
            for _ in range(self.substeps - 1):
                mujoco.mj_step(model, data)
        if data.warning.number.any():
            return np.full(self.nx, np.nan), y
        return np.concatenate([data.qpos, data.qvel, data.act]), y

    def _run(self, kernel: Any, jobs: np.ndarray[Any, Any]) -> None:
        refuse_callbacks()
        self.workers.run(kernel.address, jobs)

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
        sizes["substeps"] = self.substeps
        _fill(jobs, {"model": model._address, **sizes})
        self._work = [np.empty(kernels.work_size(self.ndx, model.nu)) for _ in self.data]
        for job, data, work in zip(jobs, self.data, self._work, strict=True):
            views = {
                "qpos": data.qpos, "qvel": data.qvel, "act": data.act, "ctrl": data.ctrl, "qacc": data.qacc,
                "warmstart": data.qacc_warmstart, "sensors": data.sensordata, "warnings": data.warning.number,
            }  # fmt: skip
            _fill(job, {"data": data._address, "work": work, **views})
        return jobs


def _addresses(arrays: Iterable[Array]) -> np.ndarray[Any, Any]:
    """Where the numbers of each array are."""
    return np.array([array.__array_interface__["data"][0] for array in arrays], np.int64)


def _fill(job: Any, fields: dict[str, Any]) -> None:
    """Set fields of a job, or of all jobs of an array: arrays by address, numbers as they are."""
    for name, value in fields.items():
        job[name] = value.__array_interface__["data"][0] if isinstance(value, np.ndarray) else value
