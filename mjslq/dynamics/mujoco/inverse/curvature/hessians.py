"""Second derivatives of MuJoCo's discrete step, contracted with costates: the Python side.

Notation (`multipliers`; `kernel`: Z, Xd, Xc, Sc)
--------
    R, J_r        of a quaternion: its turning by h w in the step, exp(h w), and the rotation group's right Jacobian
                  at h w;  w = the velocity at the step's end
    theta, d      changes of the quaternion before the step, and of w

What comes after the accelerations: a position that is a plain number follows linearly, q' = q + h v'. A quaternion's
tangent direction is log(exp(- h w) exp(theta) exp(h (w + d))), to second order

    R' theta + e + (R' theta) x e / 2,      e = J_r h d + h^2 (dJ_r/dx d) d / 2      at x = h w,

of which the second derivatives, contracted with the costate l, are

    by theta, d    - h R [l] J_r / 2            by d, d    h^2 sym(d(J_r' l)/dx).
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq import rotation
from mjslq.dynamics.dynamics import Linearization
from mjslq.dynamics.mujoco.inverse import levels
from mjslq.dynamics.mujoco.inverse.curvature.cover import served_sensors
from mjslq.dynamics.mujoco.inverse.table.columns import DIFFERENCED, OPEN
from mjslq.dynamics.mujoco.inverse.table.job import SECOND_WORK
from mjslq.dynamics.mujoco.library import copied
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.dynamics.mujoco.inverse.jacobians import InverseJacobians


class InverseHessians:
    """Second derivatives for a covered model, with the tables, workers and mjData of its `InverseJacobians`."""

    def __init__(self, jacobians: InverseJacobians):
        self._jacobians, self._model = jacobians, jacobians.model
        self._table = jacobians.table
        model = self._model
        self._served = served_sensors(model, self._table)
        owner = np.repeat(np.arange(model.nsensor), model.sensor_dim)
        self.open_readings = self._served[owner] == OPEN
        """Readings whose second derivatives are left to differences of the whole. Shape (ny,)."""
        self._blank = self._blank_jobs()

    def hessians(
        self, X: Array, U: Array, ends: Array, along: Linearization, costates: Array, weights: Array | None
    ) -> Array:
        """Second derivatives by (x, u) at every knot; of the readings, those that are not open.

        Step n leads from X_n (N + 1, nx) under U_n (N, nu) to ends_n (N, nx), with Jacobians `along`. Shape
        (N + 1, ndx + nu, ndx + nu).
        """
        N, nv, cols = len(U), self._model.nv, int(self._table["columns"])
        turns = _Turns(self._table["quat_dof"], float(self._table["h"]), ends, self._model, costates)
        Z, Xd, Xc, Sc = np.zeros((N + 1, cols, cols)), *(np.zeros((N, nv, cols)) for _ in range(3))
        apart: Any = np.zeros(N + 1, np.int64)
        given = {
            "X": X, "U": U, "ends": ends, "A": along.A, "B": along.B, "pull": turns.pull,
            "Z": Z, "Xd": Xd, "Xc": Xc, "Sc": Sc, "apart": apart,
        }  # fmt: skip
        if weights is not None and (weights != 0.0).any():
            given["weights"] = weights
        self._run(N, {name: np.ascontiguousarray(array) for name, array in given.items()}, "weights" in given)
        H = Z
        for at, rates, part in self._accelerations(along, Xd, Xc, Sc, apart):
            product = part.swapaxes(1, 2) @ rates  # only the first columns of `part` are given
            H[at, : part.shape[2]] += product
            H[at, :, : part.shape[2]] += product.swapaxes(1, 2)
        turns.add(H, along)
        return 0.5 * (H + H.swapaxes(1, 2))  # the sums above are symmetric but for rounding

    def _accelerations(
        self, along: Linearization, Xd: Array, Xc: Array, Sc: Array, apart: Any
    ) -> list[tuple[Any, Array, Array]]:
        """Knots, S and X of either acceleration; X cut to the columns that have entries."""
        nv, h = self._model.nv, float(self._table["h"])
        Sd = np.concatenate([along.A[:, nv : 2 * nv], along.B[:, nv : 2 * nv]], axis=2)
        Sd[:, np.arange(nv), nv + np.arange(nv)] -= 1.0
        Sd /= h
        parts: list[tuple[Any, Array, Array]] = [(slice(0, len(Sd)), Sd, Xd)]
        rows = np.flatnonzero(apart)
        if rows.size:
            parts.append((rows, Sc[rows], Xc[rows]))
        return [(at, S, X if X[:, :, nv:].any() else X[:, :, :nv]) for at, S, X in parts]

    def _run(self, N: int, arrays: dict[str, Array], weighted: bool) -> None:
        workers = self._jacobians.workers
        knots = N + 1 if weighted else N
        chunks = np.linspace(0, knots, min(workers.count, max(knots, 1)) + 1).astype(int)
        jobs = copied(self._blank[: len(chunks) - 1])
        jobs["N"], jobs["first"], jobs["last"] = N, chunks[:-1], chunks[1:]
        for name, array in arrays.items():
            jobs[name] = array.ctypes.data
        feeling = weighted and bool((self._served == DIFFERENCED).any())
        workers.run(levels.second_derivatives(bool(self._table["constrained"]), feeling).address, jobs)

    def _blank_jobs(self) -> np.ndarray[Any, Any]:
        """Jobs as the Jacobians' kernel has them, and what this one needs besides."""
        jobs = copied(self._jacobians.blank)
        self._shared = np.ascontiguousarray(self._served, np.int64)
        jobs["sen_bent"] = self._shared.ctypes.data
        for job, work in zip(jobs, self._work, strict=True):
            for name, array in work.items():
                job[name] = array.ctypes.data
        return jobs

    @cached_property
    def _work(self) -> list[dict[str, Array]]:
        """Arrays for intermediate results, of each worker; places for the rows of sensors among them."""
        shapes = SECOND_WORK | {"C": ("ny", 2 * self._model.nv + self._model.na), "D": ("ny", "nu")}
        sizes = {
            name: [int(self._table[n]) if isinstance(n, str) else n for n in shape] for name, shape in shapes.items()
        }
        return [{name: np.zeros(size) for name, size in sizes.items()} for _ in range(self._jacobians.workers.count)]


class _Turns:
    """What quaternions do to a step's second derivatives; see the head of this file."""

    def __init__(self, first: Array, h: float, ends: Array, model: Any, costates: Array):
        nq, nv = model.nq, model.nv
        self._dofs, self._h = first[:, None] + np.arange(3), h
        self._x = h * ends[:, nq + self._dofs]
        """Turnings h w. Shape (N, quaternions, 3)."""
        self._costate = costates[1:, self._dofs]
        self._J = rotation.right_jacobian(self._x)
        by_velocity = costates[1:, nv : 2 * nv] + h * costates[1:, :nv]
        if len(first):
            turned = np.einsum("nkij,nki->nkj", self._J, self._costate)
            by_velocity[:, self._dofs] = costates[1:, nv + self._dofs] + h * turned
        self.pull = h * by_velocity
        """Derivative of lambda' x_{n+1} by the step's acceleration. Shape (N, nv)."""

    def add(self, H: Array, along: Linearization) -> None:
        """Add to the second derivatives by (x, u)."""
        h, nv = self._h, self.pull.shape[1]
        for k, dofs in enumerate(self._dofs):
            x, costate, J = self._x[:, k], self._costate[:, k], self._J[:, k]
            R = np.stack([rotation.rotate(rotation.exp(x), axis) for axis in np.eye(3)], axis=-1)
            mixed = -0.5 * h * R @ rotation.skew(costate) @ J
            d = np.concatenate([along.A[:, nv + dofs, :], along.B[:, nv + dofs, :]], axis=2)
            H[:-1] += d.swapaxes(1, 2) @ (h * h * rotation.right_jacobian_slope(x, costate)) @ d
            product = mixed @ d
            H[:-1, dofs] += product
            H[:-1, :, dofs] += product.swapaxes(1, 2)
