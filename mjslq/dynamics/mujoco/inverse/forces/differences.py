"""Derivatives of the smooth forces that have no closed form here, by differences of those forces alone.

Notation
--------
    f                    passive and actuator forces of the model of the rest (`unmodelled_forces`)
    T = df/dv            what an implicit integrator takes of it, as MuJoCo computes it (its qDeriv); implicitfast keeps
                         the lower triangle and mirrors it
    F = df/dz, E = h (dT/dz) a

MuJoCo's own functions evaluate f and T for the model of the rest, in the mjData of the whole model: no inertia, no
collision, no solver. A change of position needs the lengths and moment arms of actuators, and mostly the kinematics,
one of velocity only forces, one of activation or control only the actuators' forces. Activations with
dynamics of their own are advanced beside that, by an Euler step of the model of the rest, in which nothing is damped
and nothing to be factorized.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.rows.constraints import find_rows, mj_tendon
from mjslq.dynamics.mujoco.inverse.rows.differences import mj_comPos, mj_integratePos, mj_kinematics
from mjslq.dynamics.mujoco.inverse.spatial import compiled
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix, vector
from mjslq.dynamics.mujoco.kernels import copy_into
from mjslq.native.declare import external

mj_transmission = external("mj_transmission", "void(intp, intp)")
mj_passive = external("mj_passive", "void(intp, intp)")
mj_fwdActuation = external("mj_fwdActuation", "void(intp, intp)")
mj_Euler = external("mj_Euler", "void(intp, intp)")
mjd_smooth_vel = external("mjd_smooth_vel", "void(intp, intp, int32)")
mju_mulMatVecSparse = external("mju_mulMatVecSparse", "void(intp, intp, intp, int32, intp, intp, intp, intp)")

_POSITION, _VELOCITY, _ACTIVATION, _CONTROL = range(4)


@compiled
def add_force_differences(job, x):
    """F += df/dz, T += df/dv, E += h d(T a)/dz of the rest, and rows of next activations, at the state x in mjData."""
    F, E = matrix(job.F, job.nv, job.columns), matrix(job.E, job.nv, job.columns)
    _evaluate(job, x, _POSITION, vector(job.rest_minus, job.columns))
    if job.implicit == 2:
        _add_damping(job, matrix(job.T, job.nv, job.nv))
    first = 0
    for kind in range(4):
        if kind == _POSITION:
            varied, size = integers(job.rest_q, job.nrest_q), job.nv
        elif kind == _VELOCITY:
            varied, size = integers(job.rest_v, job.nrest_v), job.nv
        elif kind == _ACTIVATION:
            varied, size = integers(job.rest_act, job.nrest_act), job.na
        else:
            varied, size = integers(job.rest_u, job.nrest_u), job.nu
        for k in range(varied.shape[0]):
            _add_column(job, x, kind, varied[k], first + varied[k], F, E)
        first += size
        if varied.shape[0] > 0:
            _evaluate(job, x, kind, vector(job.rest_minus, job.columns))


@compiled
def _add_column(job, x, kind, i, column, F, E):
    """Column of one variable; afterwards rest_minus holds the values at x again unless differences are centred."""
    plus, minus = vector(job.rest_plus, job.columns), vector(job.rest_minus, job.columns)
    up, down = _steps(job, kind, i)
    if up + down == 0.0:
        return
    control = vector(job.ctrl, job.nu)[i] if kind == _CONTROL else 0.0
    _shift(job, kind, i, control, up)
    _evaluate(job, x, kind, plus)
    if down > 0.0 or job.centered:
        _shift(job, kind, i, control, -down)
        _evaluate(job, x, kind, minus)
    if kind == _CONTROL:
        vector(job.ctrl, job.nu)[i] = control
    nv = job.nv
    for j in range(nv):
        F[j, column] += (plus[j] - minus[j]) / (up + down)
        E[j, column] += job.h * (plus[nv + j] - minus[nv + j]) / (up + down)
    following, rows = integers(job.rest_next, job.nrest_next), matrix(job.rest_rows, job.na, job.columns)
    for k in range(following.shape[0]):
        a = following[k]
        rows[a, column] = (plus[2 * nv + a] - minus[2 * nv + a]) / (up + down)
    if down > 0.0 and not job.centered:
        _evaluate(job, x, kind, minus)


@compiled
def _steps(job, kind, i):
    """How far to go up and down: controls stay within their limits, beyond which nothing changes."""
    up, down = job.eps, job.eps if job.centered else 0.0
    if kind == _CONTROL:
        u, limits = vector(job.ctrl, job.nu)[i], matrix(job.ctrl_range, job.nu, 2)
        if u < limits[i, 0] or u > limits[i, 1]:
            return 0.0, 0.0
        if u + job.eps > limits[i, 1]:
            up, down = 0.0, job.eps
        if u - down < limits[i, 0]:
            down = 0.0
    return up, down


@compiled
def _shift(job, kind, i, control, step):
    """Change one variable in mjData, a control from the value `control`."""
    if kind == _POSITION:
        way = vector(job.change, job.nv)
        for j in range(job.nv):
            way[j] = 0.0
        way[i] = 1.0
        mj_integratePos(job.model, job.qpos, way.ctypes.data, step)
    elif kind == _VELOCITY:
        vector(job.qvel, job.nv)[i] += step
    elif kind == _ACTIVATION:
        vector(job.act, job.na)[i] += step
    else:
        vector(job.ctrl, job.nu)[i] = control + step


@compiled
def _evaluate(job, x, kind, out):
    """Put (f, T a, next activations) into `out` after a change of this kind; then put x back into mjData."""
    model, data, nv = job.rest_model, job.data, job.nv
    if kind == _POSITION:
        if job.rest_poses:
            mj_kinematics(job.model, data)
            mj_comPos(job.model, data)
        if job.rest_touches:
            find_rows(job)
        elif job.ntendon > 0:
            mj_tendon(job.model, data)
        if job.rest_acts:
            mj_transmission(model, data)
    if kind <= _VELOCITY:
        _measure_velocities(job)
        if job.rest_passive:
            mj_passive(model, data)
    if job.rest_acts:
        mj_fwdActuation(model, data)
    passive, actuator = vector(job.qfrc_passive, nv), vector(job.qfrc_actuator, nv)
    for i in range(nv):
        out[i] = (passive[i] if job.rest_passive else 0.0) + (actuator[i] if job.rest_acts else 0.0)
        out[nv + i] = 0.0
    if job.implicit == 2:
        mjd_smooth_vel(model, data, 0)
        _damp(job, vector(job.acc_d, nv), out)
    if job.nrest_next > 0:
        mj_Euler(model, data)
        act = vector(job.act, job.na)
        for k in range(job.na):
            out[2 * nv + k] = act[k]
    copy_into(x[: job.nq], vector(job.qpos, job.nq))
    copy_into(x[job.nq : job.nq + nv], vector(job.qvel, nv))
    copy_into(x[job.nq + nv :], vector(job.act, job.na))


@compiled
def _measure_velocities(job):
    """Velocities of tendons and actuators."""
    if job.ntendon > 0:
        mju_mulMatVecSparse(
            job.ten_velocity, job.ten_J, job.qvel, np.int32(job.ntendon),
            job.ten_J_rownnz, job.ten_J_rowadr, job.ten_J_colind, np.intp(0),
        )  # fmt: skip
    if job.rest_acts:
        mju_mulMatVecSparse(
            job.actuator_velocity, job.actuator_moment, job.qvel, np.int32(job.nout),
            job.moment_rownnz, job.moment_rowadr, job.moment_colind, np.intp(0),
        )  # fmt: skip


@compiled
def _damp(job, acc, out):
    """out[nv:] += T a."""
    size, first = integers(job.D_rownnz, job.nv), integers(job.D_rowadr, job.nv)
    dofs, entries = integers(job.D_colind, job.nD), vector(job.qDeriv, job.nD)
    lone = integers(job.dof_lone, job.nv)
    nv = job.nv
    for i in range(nv):
        for k in range(first[i], first[i] + size[i]):
            j = dofs[k]
            if lone[i] == 1 and j != i:
                continue
            if job.symmetric == 0 or j <= i:
                out[nv + i] += entries[k] * acc[j]
            if job.symmetric == 1 and j < i:
                out[nv + j] += entries[k] * acc[i]


@compiled
def _add_damping(job, T):
    """Add what MuJoCo takes implicitly to T."""
    size, first = integers(job.D_rownnz, job.nv), integers(job.D_rowadr, job.nv)
    dofs, entries = integers(job.D_colind, job.nD), vector(job.qDeriv, job.nD)
    for i in range(job.nv):
        for k in range(first[i], first[i] + size[i]):
            j = dofs[k]
            if job.symmetric == 0 or j <= i:
                T[i, j] += entries[k]
            if job.symmetric == 1 and j < i:
                T[j, i] += entries[k]
