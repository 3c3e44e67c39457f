"""Jacobians of MuJoCo's discrete step through its inverse dynamics: the Python side.

The mathematics stands at the head of `kernel`; which models are covered, in `cover`.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.dynamics.dynamics import Linearization
from mjslq.dynamics.mujoco.inverse import levels
from mjslq.dynamics.mujoco.inverse.forces.unmodelled_forces import (
    covered_part,
    rest_part,
    rest_table,
    unmodelled_forces,
)
from mjslq.dynamics.mujoco.inverse.readings.outputs import sensors
from mjslq.dynamics.mujoco.inverse.table.actuator_plan import actuator_table, metric_table
from mjslq.dynamics.mujoco.inverse.table.arm_plan import arm_table
from mjslq.dynamics.mujoco.inverse.table.fluid_plan import fluid_table
from mjslq.dynamics.mujoco.inverse.table.job import INDICES, JOB, VIEWS, WORK
from mjslq.dynamics.mujoco.inverse.table.layout import offsets
from mjslq.dynamics.mujoco.inverse.table.plan import arrays, plan, row_model
from mjslq.dynamics.mujoco.library import copied
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.dynamics.mujoco.simulator import Simulator


class InverseJacobians:
    """Linearizes trajectories of a covered model, with the workers and mjData of a `Simulator`."""

    def __init__(self, simulator: Simulator, eps: float, centered: bool):
        self._simulator, self.workers, self.model = simulator, simulator.workers, simulator.model
        model = simulator.model
        rest = unmodelled_forces(model)
        self._rest = rest_part(model, rest) if rest.exists else None
        part = covered_part(model, rest)
        table = plan(part) | arrays(actuator_table(part))
        self.table = table | arrays(
            metric_table(part, table)
            | sensors(model)
            | fluid_table(model)
            | arm_table(model, rest)
            | rest_table(model, rest)
            | {"eps": eps, "centered": int(centered), "substeps": simulator.substeps}
        )
        self._row_model = row_model(simulator.model)
        self._work = [self._workspace() for _ in range(simulator.workers.count)]
        self.blank = self._blank_jobs()
        """A job for each worker, with all that is the same at every call."""

    def retime(self, h: float) -> None:
        """Take a changed step length of the simulator's model."""
        self.table["h"][...] = h
        self.blank["h"] = h
        for model in (self._row_model, self._rest):
            if model is not None:
                model.opt.timestep = h

    def linearize(self, X: Array, U: Array, substates: Array, ends: Array) -> Linearization:
        """Jacobians of every step and of the outputs, the knots shared out among the workers.

        Step n leads from X_n, shape (N + 1, nx), under U_n (N, nu), through substates_n (N, k - 1, nx), to ends_n
        (N, nx).
        """
        simulator, N = self._simulator, len(U)
        nu, ny, ndx = simulator.model.nu, simulator.model.nsensordata, simulator.ndx
        result = Linearization(
            np.empty((N, ndx, ndx)), np.empty((N, ndx, nu)), np.zeros((N + 1, ny, ndx)), np.zeros((N + 1, ny, nu))
        )
        knots = N + 1 if ny else N
        shares = simulator.shares(knots)
        jobs = copied(self.blank[: len(shares) - 1])
        jobs["N"], jobs["first"], jobs["last"] = N, shares[:-1], shares[1:]
        states = {"X": X, "U": U, "S": substates, "ends": ends}
        given = {name: np.ascontiguousarray(array) for name, array in states.items()}
        for name, array in {**result._asdict(), **given}.items():
            jobs[name] = array.ctypes.data
        simulator.workers.run(levels.jacobians(self._level).address, jobs)
        return result

    def _blank_jobs(self) -> np.ndarray[Any, Any]:
        """A job for each worker, with all that is the same at every call filled in."""
        jobs = np.zeros(len(self._work), JOB)
        model = self._simulator.model
        jobs["model"], jobs["row_model"] = model._address, self._row_model._address
        jobs["rest_model"] = self._rest._address if self._rest else 0
        for name in ("ten_J_rownnz", "ten_J_rowadr", "ten_J_colind"):
            jobs[name] = getattr(model, name).ctypes.data
        for name, value in self.table.items():
            jobs[name] = value.ctypes.data if value.ndim else value
        for name, at in offsets().items():
            jobs["at_" + name.replace(".", "_")] = at
        for job, data, work in zip(jobs, self._simulator.data, self._work, strict=True):
            job["data"] = data._address
            for name in VIEWS:
                job[name] = getattr(data, name).ctypes.data
            for name, array in work.items():
                job[name] = array.ctypes.data
        return jobs

    @cached_property
    def _level(self) -> int:
        """How much of the kernel the model needs; see there."""

        def any_of(*names: str) -> bool:
            return any(bool(self.table[name]) for name in names)

        if any_of("narm", "nfluid") or self._rest is not None or self.table["implicit"] == 3:
            return levels.WHOLE
        if any_of("sensors_accelerated", "sensors_on_rows", "sensors_differenced", "sensors_cut"):
            return levels.FEELING
        return levels.CONSTRAINED if any_of("constrained") else levels.SMOOTH

    def _workspace(self) -> dict[str, Any]:
        """Arrays for intermediate results of one worker."""
        sizes = [[int(self.table[n]) if isinstance(n, str) else n for n in shape] for shape in WORK.values()]
        indices = {name: np.zeros(int(self.table["nv"]), np.int64) for name in INDICES}
        return dict(zip(WORK, map(np.zeros, sizes), strict=True)) | indices
