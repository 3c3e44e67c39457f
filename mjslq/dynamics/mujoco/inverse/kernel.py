"""Jacobians of MuJoCo's discrete step through its inverse dynamics: one compiled loop over the horizon.

At each knot: the kinematics, by MuJoCo; the derivatives of the step's acceleration (`acceleration`); from these the
rows of A and B; and the sensors' rows of C and D (`readings`).

    dv_next = dv + h da_d,   q_next = q (+) h v_next

Where a control is held over several steps (`substeps`), dq, dv and da_d are derivatives by the state and control at
the knot: da_d = (derivatives at this step) (dq, dv, dact, du), with what the steps before have made of dq, dv and dact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

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
from mjslq.dynamics.mujoco.kernels import copy_into, mj_forward, mj_resetData
from mjslq.native.declare import external
from mjslq.native.memory import carray

mjd_quatIntegrate = external("mjd_quatIntegrate", "void(intp, float64, intp, intp, intp)")


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
def _chain_step(job, v_next, P):
    """Take P = (A, B), of the steps since the knot, through one more, whose derivatives are in F and next_act."""
    quat_dof = integers(job.quat_dof, job.nquat)
    act_adr, next_act = integers(job.act_adr, job.nu), matrix(job.next_act, job.nu, 2)
    following, rows = integers(job.rest_next, job.nrest_next), matrix(job.rest_rows, job.na, job.columns)
    F, chained = matrix(job.F, job.nv, job.columns), matrix(job.chained, job.columns, job.columns)
    nv, ndx = job.nv, 2 * job.nv + job.na
    _times(F, P, chained[:nv])
    for n in range(following.shape[0]):
        k = following[n]
        _times(rows[k : k + 1], P, chained[nv + n : nv + n + 1])
    for i in range(nv):
        for c in range(job.columns):
            P[nv + i, c] += job.h * chained[i, c]
    i, k = 0, 0
    while i < nv:
        if k < quat_dof.shape[0] and quat_dof[k] == i:
            _turn_chained_rows(job, i, v_next, P)
            i, k = i + 3, k + 1
        else:
            for c in range(job.columns):
                P[i, c] += job.h * P[nv + i, c]
            i += 1
    for i in range(job.nu):
        k = act_adr[i]
        if k >= 0:
            for c in range(job.columns):
                P[2 * nv + k, c] *= next_act[i, 1]
            P[2 * nv + k, ndx + i] += next_act[i, 0]
    for n in range(following.shape[0]):
        copy_into(chained[nv + n], P[2 * nv + following[n]])


@compiled
def _times(F, P, out):
    """Derivatives F by (dx, du) at a step, times (dx, du) by those at the knot: F_x P + (0, F_u)."""
    rows, (ndx, columns) = F.shape[0], P.shape
    for i in range(rows):
        for c in range(columns):
            out[i, c] = F[i, c] if c >= ndx else 0.0
    whole = ndx - ndx % 4
    for j in range(0, whole, 4):  # four rows of P at once, which are then in the cache: half the time
        for i in range(rows):
            f0, f1, f2, f3 = F[i, j], F[i, j + 1], F[i, j + 2], F[i, j + 3]
            for c in range(columns):
                out[i, c] += f0 * P[j, c] + f1 * P[j + 1, c] + f2 * P[j + 2, c] + f3 * P[j + 3, c]
    for j in range(whole, ndx):
        for i in range(rows):
            for c in range(columns):
                out[i, c] += F[i, j] * P[j, c]


@compiled
def _turn_chained_rows(job, first, v_next, P):
    """Rows of the positions of a quaternion as in `_turn_rows`, with dq and dw by what is at the knot."""
    small = vector(job.small, 21)
    by_quat, by_vel, vel, nv = small[0:9], small[9:18], small[18:21], job.nv
    for i in range(3):
        vel[i] = v_next[first + i]
    mjd_quatIntegrate(vel.ctypes.data, job.h, by_quat.ctypes.data, by_vel.ctypes.data, 0)
    for c in range(job.columns):
        q0, q1, q2 = P[first, c], P[first + 1, c], P[first + 2, c]
        v0, v1, v2 = job.h * P[nv + first, c], job.h * P[nv + first + 1, c], job.h * P[nv + first + 2, c]
        for i in range(3):
            turned = by_quat[3 * i] * q0 + by_quat[3 * i + 1] * q1 + by_quat[3 * i + 2] * q2
            P[first + i, c] = turned + by_vel[3 * i] * v0 + by_vel[3 * i + 1] * v1 + by_vel[3 * i + 2] * v2


@compiled
def _split(P, A, B):
    """Copy P = (A, B) into A and B."""
    ndx, nu = B.shape
    for i in range(ndx):
        for c in range(ndx):
            A[i, c] = P[i, c]
        for c in range(nu):
            B[i, c] = P[i, ndx + c]


@compiled
def _join(A, B, P):
    """Copy A and B into P = (A, B)."""
    ndx, nu = B.shape
    for i in range(ndx):
        for c in range(ndx):
            P[i, c] = A[i, c]
        for c in range(nu):
            P[i, ndx + c] = B[i, c]


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
def _linearize_step(job, s, x, v_next, A, B, rows, odd):
    """A and B of the steps 0 ... s since the knot, the last of them from x, which is in mjData with its control."""
    acc_d, count, ndx = vector(job.acc_d, job.nv), 0, 2 * job.nv + job.na
    P = matrix(job.product, ndx, job.columns)
    for i in range(job.nv):
        acc_d[i] = (v_next[i] - x[job.nq + i]) / job.h
    if rows is not None and job.constrained:
        count = find_rows(job)
    if job.gyroscopic:
        find_spinning(job, count)
    smooth_forces(job, x, odd)
    fine = smooth_step(job) if rows is None else step_with_rows(job, x, count)
    if s == 0:
        _write_step(job, v_next, A, B)
        if job.substeps > 1:
            _join(A, B, P)
    else:
        _chain_step(job, v_next, P)
    if not fine:
        fill(A, np.nan)
        fill(P, np.nan)
        fill(B, np.nan)
    elif 0 < s == job.substeps - 1:
        _split(P, A, B)


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


def make_loop(constrained: bool, feeling: bool, whole: bool) -> Callable[..., Any]:
    """The loop over the horizon, with as much to it as the switches say (`levels`)."""
    # numba leaves out what stands behind an argument that is None, or a switch from out here that is False
    rows, odd = 1 if constrained else None, 1 if whole else None

    def inverse(_model, _data, worker, jobs):
        """Jacobians A, B, C, D of the knots first ... last - 1; knot N has only C."""
        job = carray(jobs, worker + 1, JOB)[worker]
        nx, ndx, nu, ny = job.nq + job.nv + job.na, 2 * job.nv + job.na, job.nu, job.ny
        U, no_control, between = matrix(job.U, job.N, nu), vector(job.no_control, nu), job.substeps - 1
        mj_resetData(job.model, job.data)
        for n in range(job.first, job.last):
            C, D = matrix(job.C + 8 * n * ny * ndx, ny, ndx), matrix(job.D + 8 * n * ny * nu, ny, nu)
            A, B = matrix(job.A + 8 * n * ndx * ndx, ndx, ndx), matrix(job.B + 8 * n * ndx * nu, ndx, nu)
            for s in range(job.substeps if n < job.N else 1):
                S = job.S + 8 * (n * between + s) * nx  # of the state at the end of this step, unless it is the last
                x = vector(S - 8 * nx if s > 0 else job.X + 8 * n * nx, nx)
                load(job, x, U[n] if n < job.N else no_control)
                mj_kinematics(job.model, job.data)
                mj_comPos(job.model, job.data)
                if n < job.N:
                    end = vector(S if s < between else job.ends + 8 * n * nx, nx)
                    _linearize_step(job, s, x, end[job.nq : job.nq + job.nv], A, B, rows, odd)
                elif ny > 0:
                    if feeling:
                        _feel_last_knot(job, x, odd)
                    else:
                        _visit_last_knot(job)
                if ny > 0 and s == 0:  # outputs are read at the knot
                    write_motions(job, C, D)
                    if feeling:
                        write_feelings(job, n, x, C, D)
                    if n == job.N:
                        fill(D, 0.0)

    return inverse
