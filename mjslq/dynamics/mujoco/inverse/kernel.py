"""Jacobians of MuJoCo's discrete step through its inverse dynamics: one compiled loop over the horizon.

At each knot: the kinematics, by MuJoCo; the derivatives of the step's acceleration (`acceleration`); from these the
rows of A and B; and the sensors' rows of C and D (`readings`).

    dv_next = dv + h da_d,   q_next = q (+) h v_next
"""

from __future__ import annotations

import functools
import zlib
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import types

from mjslq.dynamics.mujoco.inverse.acceleration import (
    complete_inertia,
    differentiate_acceleration,
    find_spinning,
    smooth_forces,
    smooth_step,
    step_with_rows,
)
from mjslq.dynamics.mujoco.inverse.algebra import fill
from mjslq.dynamics.mujoco.inverse.forces.laws import activate, actuate
from mjslq.dynamics.mujoco.inverse.readings.motions import write_feelings, write_motions
from mjslq.dynamics.mujoco.inverse.rigid import inward, mass_matrix, outward
from mjslq.dynamics.mujoco.inverse.rows.constraints import find_rows
from mjslq.dynamics.mujoco.inverse.rows.differences import mj_comPos, mj_kinematics
from mjslq.dynamics.mujoco.inverse.spatial import compiled
from mjslq.dynamics.mujoco.inverse.table.job import JOB, integers, matrix, vector
from mjslq.dynamics.mujoco.kernels import (
    address_t,
    c_function,
    copy_into,
    mj_forward,
    mj_resetData,
    number_t,
    void_t,
)

mjd_quatIntegrate = types.ExternalFunction(
    "mjd_quatIntegrate", void_t(address_t, number_t, address_t, address_t, address_t)
)


@compiled
def _write_step(job, v_next, A, B):
    """Rows of A and B from da_d/dz in F: velocities, positions, activations."""
    act_adr = integers(job.act_adr, job.nu)
    quat_dof = integers(job.quat_dof, job.nquat)
    next_act = matrix(job.next_act, job.nu, 2)
    F = matrix(job.F, job.nv, job.columns)
    nv, ndx = job.nv, 2 * job.nv + job.na
    for i in range(nv):
        for c in range(ndx):
            rate = job.h * F[i, c]
            A[nv + i, c] = rate
            A[i, c] = job.h * rate
        for c in range(job.nu):
            rate = job.h * F[i, ndx + c]
            B[nv + i, c] = rate
            B[i, c] = job.h * rate
        A[nv + i, nv + i] += 1.0
        A[i, nv + i] += job.h
        A[i, i] += 1.0
    for k in range(quat_dof.shape[0]):
        _turn_rows(job, quat_dof[k], v_next, A, B)
    for i in range(2 * nv, ndx):
        for c in range(ndx):
            A[i, c] = 0.0
        for c in range(job.nu):
            B[i, c] = 0.0
    for i in range(job.nu):
        k = act_adr[i]
        if k >= 0:
            A[2 * nv + k, 2 * nv + k] = next_act[i, 1]
            B[2 * nv + k, i] = next_act[i, 0]
    following, rows = integers(job.rest_next, job.nrest_next), matrix(job.rest_rows, job.na, job.columns)
    for n in range(following.shape[0]):
        k = following[n]
        for c in range(ndx):
            A[2 * nv + k, c] = rows[k, c]
        for c in range(job.nu):
            B[2 * nv + k, c] = rows[k, ndx + c]


@compiled
def _turn_rows(job, first, v_next, A, B):
    """Rows of the positions of a quaternion, exp(-h w) dq + J(h w) h dw, with w the next angular velocity."""
    nv, ndx = job.nv, 2 * job.nv + job.na
    small = vector(job.small, 21)
    by_quat, by_vel, vel = small[0:9], small[9:18], small[18:21]
    for i in range(3):
        vel[i] = v_next[first + i]
    mjd_quatIntegrate(vel.ctypes.data, job.h, by_quat.ctypes.data, by_vel.ctypes.data, 0)
    for i in range(3):
        b0, b1, b2 = job.h * by_vel[3 * i], job.h * by_vel[3 * i + 1], job.h * by_vel[3 * i + 2]
        for c in range(ndx):
            A[first + i, c] = b0 * A[nv + first, c] + b1 * A[nv + first + 1, c] + b2 * A[nv + first + 2, c]
        for c in range(job.nu):
            B[first + i, c] = b0 * B[nv + first, c] + b1 * B[nv + first + 1, c] + b2 * B[nv + first + 2, c]
        for j in range(3):
            A[first + i, first + j] += by_quat[3 * i + j]


@compiled
def load(job, x, u):
    """Put state and control into mjData."""
    copy_into(x[: job.nq], vector(job.qpos, job.nq))
    copy_into(x[job.nq : job.nq + job.nv], vector(job.qvel, job.nv))
    copy_into(x[job.nq + job.nv :], vector(job.act, job.na))
    copy_into(u, vector(job.ctrl, job.nu))


@compiled
def _linearize_knot(job, x, v_next, A, B, rows, odd):
    """A and B of a step from x, whose control is in mjData too."""
    acc_d, count = vector(job.acc_d, job.nv), 0
    for i in range(job.nv):
        acc_d[i] = (v_next[i] - x[job.nq + i]) / job.h
    if rows is not None and job.constrained:
        count = find_rows(job)
    if job.gyroscopic:
        find_spinning(job, count)
    smooth_forces(job, x, odd)
    fine = smooth_step(job) if rows is None else step_with_rows(job, x, count)
    _write_step(job, v_next, A, B)
    if not fine:
        fill(A, np.nan)
        fill(B, np.nan)


@compiled
def _visit_last_knot(job):
    """Prepare what the sensors' derivatives read, where there is no step."""
    nothing = vector(job.change, job.nv)
    for i in range(job.nv):
        nothing[i] = 0.0
    activate(job)
    actuate(job)
    outward(job, vector(job.qvel, job.nv), nothing)
    inward(job)


@compiled
def _feel_last_knot(job, x, odd):
    """Do the same for sensors of accelerations and rows: the acceleration is the one that MuJoCo finds."""
    if not job.sensors_accelerated:
        _visit_last_knot(job)
        if job.sensors_on_rows and job.constrained:
            find_rows(job)
        return
    warmstart, qacc = vector(job.qacc_warmstart, job.nv), vector(job.qacc, job.nv)
    for i in range(job.nv):
        warmstart[i] = 0.0
    mj_forward(job.model, job.data)
    copy_into(qacc, vector(job.acc_d, job.nv))
    rows = find_rows(job) if job.constrained else 0
    if job.gyroscopic:
        find_spinning(job, rows)
    smooth_forces(job, x, odd)
    copy_into(qacc, vector(job.acc_c, job.nv))
    mass_matrix(job, matrix(job.M, job.nv, job.nv))
    complete_inertia(job)
    if not differentiate_acceleration(job, x):
        fill(matrix(job.acc_rate, job.nv, job.columns), np.nan)


def sources() -> int:
    """Checksum of all that the kernels here are made of: numba by itself looks at this file's date alone."""
    folder, checksum = Path(__file__).parent, 1
    for path in [folder.parent / "kernels.py", *sorted(folder.rglob("*.py"))]:
        checksum = zlib.crc32(path.read_bytes(), checksum)
    return checksum + 1


SMOOTH, CONSTRAINED, FEELING, WHOLE = range(4)
"""How much there is to a kernel, each level with all of those before it: rigid bodies, springs, dampers, actuators with
constant moment arms and sensors of motion; constraints, contacts among them; sensors of accelerations, contacts and
limits, and those without a closed form; fluids, moving moment arms, forces without a closed form, the discrete
integrator's metric."""


@functools.cache
def kernel(level: int) -> Any:
    """Compile the loop over the horizon, or find it on disk; what a model does not need would take long to compile."""
    return _make_kernel(sources(), level >= CONSTRAINED, level >= FEELING, level >= WHOLE)


def _make_kernel(stamp: int, constrained: bool, feeling: bool, whole: bool) -> Any:
    # numba leaves out what stands behind an argument that is None, or a switch from out here that is False
    rows, odd = 1 if constrained else None, 1 if whole else None

    @c_function(void_t(address_t, address_t, types.int32, types.voidptr))
    def inverse(_model, _data, worker, jobs):
        """Jacobians A, B, C, D of the knots first ... last - 1; knot N has only C."""
        if stamp == 0:  # it never is; what a function refers to is part of its key on disk
            return
        job = numba.carray(jobs, worker + 1, JOB)[worker]
        nx, ndx, nu, ny = job.nq + job.nv + job.na, 2 * job.nv + job.na, job.nu, job.ny
        X, U, ends = matrix(job.X, job.N + 1, nx), matrix(job.U, job.N, nu), matrix(job.ends, job.N, nx)
        no_control = np.zeros(nu)
        mj_resetData(job.model, job.data)
        for n in range(job.first, job.last):
            C, D = matrix(job.C + 8 * n * ny * ndx, ny, ndx), matrix(job.D + 8 * n * ny * nu, ny, nu)
            load(job, X[n], U[n] if n < job.N else no_control)
            mj_kinematics(job.model, job.data)
            mj_comPos(job.model, job.data)
            if n < job.N:
                A, B = matrix(job.A + 8 * n * ndx * ndx, ndx, ndx), matrix(job.B + 8 * n * ndx * nu, ndx, nu)
                _linearize_knot(job, X[n], ends[n, job.nq : job.nq + job.nv], A, B, rows, odd)
            elif ny > 0:
                if feeling:
                    _feel_last_knot(job, X[n], odd)
                else:
                    _visit_last_knot(job)
            if ny > 0:
                write_motions(job, C, D)
                if feeling:
                    write_feelings(job, n, X[n], C, D)
                if n == job.N:
                    fill(D, 0.0)

    return inverse
