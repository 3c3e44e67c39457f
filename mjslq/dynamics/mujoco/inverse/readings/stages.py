"""Derivatives of sensors without a closed form: differences of their own stage of MuJoCo's pipeline.

Notation
--------
    z = (q, v, act, u)   what is varied, by a step to either side (or one) along each direction e
    y(z, a)              readings, with the acceleration a that MuJoCo's sensors see as an argument of its own
    a_c, acc_rate        that acceleration at the knot, and da_c/dz (`kernel`)

    dy/dz e = ( y(z (+) eps e, a_c + eps da_c/dz e) - y(z (-) eps e, a_c - eps da_c/dz e) ) / 2 eps

With a given, the constraint forces are explicit, as in inverse dynamics, so that no solver runs and no step is taken.
What reads positions alone is varied by q only, what reads velocities by q and v; and what a variation does not change
is not computed again: controls leave the pose and the velocities alone, velocities the pose.

Differences by a control stay within its limits, beyond which MuJoCo clamps it.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.readings.frames import clear_rows
from mjslq.dynamics.mujoco.inverse.rows.constraints import (
    evaluate_rows,
    find_rows,
    mj_comVel,
    mj_referenceConstraint,
    mj_tendon,
)
from mjslq.dynamics.mujoco.inverse.rows.differences import mj_comPos, mj_integratePos, mj_kinematics
from mjslq.dynamics.mujoco.inverse.spatial import compiled, inlined
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.job import entry_count, integers, matrix, vector
from mjslq.dynamics.mujoco.kernels import copy_into
from mjslq.native.declare import external

mj_camlight = external("mj_camlight", "void(intp, intp)")
mj_transmission = external("mj_transmission", "void(intp, intp)")
mj_makeM = external("mj_makeM", "void(intp, intp)")
mj_energyPos = external("mj_energyPos", "void(intp, intp)")
mj_energyVel = external("mj_energyVel", "void(intp, intp)")
mj_fwdVelocity = external("mj_fwdVelocity", "void(intp, intp)")
mj_fwdActuation = external("mj_fwdActuation", "void(intp, intp)")
mj_rnePostConstraint = external("mj_rnePostConstraint", "void(intp, intp)")
mj_subtreeVel = external("mj_subtreeVel", "void(intp, intp)")
mj_sensorPos = external("mj_sensorPos", "void(intp, intp)")
mj_sensorVel = external("mj_sensorVel", "void(intp, intp)")
mj_sensorAcc = external("mj_sensorAcc", "void(intp, intp)")

POSITION, VELOCITY, ACCELERATION = 1, 2, 3
"""Stages, as MuJoCo numbers them; those of positions and velocities own as many columns as there are dofs."""


@inlined
def _reach(job, s, on_contacts):
    """How far the differences of sensor s have to reach; 0 for none.

    Sensors on contacts know all but what positions do, which their readings' stage is then for.
    """
    kind = integers(job.sen_kind, job.nsensor)[s]
    if kind == columns.BY_DIFFERENCES or (on_contacts > 0 and kind >= columns.FORCE):
        return integers(job.sen_stage, job.nsensor)[s]
    return 0


@inlined
def _is_varied(job, s, start, on_contacts):
    """Whether sensor s wants the columns that stage `start` owns."""
    if start == POSITION or integers(job.sen_kind, job.nsensor)[s] == columns.BY_DIFFERENCES:
        return _reach(job, s, on_contacts) >= start
    return False


@compiled
def difference_stages(job, n, x, on_contacts, C, D):
    """Rows of the sensors without a closed form, with `on_contacts` of those on contacts too; limits of readings.

    Leaves mjData away from x.
    """
    dims, first = integers(job.sen_dim, job.nsensor), integers(job.sen_adr, job.nsensor)
    kinds, reach = integers(job.sen_kind, job.nsensor), np.int64(0)
    for s in range(job.nsensor):
        reach = max(reach, _reach(job, s, on_contacts))
        if kinds[s] == columns.BY_DIFFERENCES:
            clear_rows(C, D, first[s], dims[s])
    _evaluate(job, x, np.int64(-1), 0.0, max(reach, ACCELERATION * job.sensors_cut), np.int64(POSITION))
    copy_into(vector(job.sensordata, job.ny), vector(job.middle, job.ny))
    # what is varied last need not be put back
    for start in range(max(job.sensors_differenced, min(reach, POSITION)), 0, -1):
        begin, end = (start - 1) * job.nv, start * job.nv
        if start == ACCELERATION:
            end = job.columns if n < job.N else job.columns - job.nu
        for c in range(begin, end):
            _difference(job, x, c, reach, start, on_contacts, C, D)
    if job.sensors_cut:
        _cut(job, C, D)


@compiled
def _difference(job, x, c, reach, start, on_contacts, C, D):
    """Column c of the rows of sensors whose stage is `start` or later."""
    dims, first = integers(job.sen_dim, job.nsensor), integers(job.sen_adr, job.nsensor)
    ndx = C.shape[1]
    reading, plus, middle = vector(job.sensordata, job.ny), vector(job.reading, job.ny), vector(job.middle, job.ny)
    up, down = job.eps, -job.eps if job.centered else 0.0
    if c >= ndx:
        u, limits = vector(job.ctrl, job.nu)[c - ndx], matrix(job.ctrl_range, job.nu, 2)
        up = max(0.0, min(up, limits[c - ndx, 1] - u))
        down = min(0.0, max(down if up > 0.0 else -job.eps, limits[c - ndx, 0] - u))
    _evaluate(job, x, c, up, reach, start)
    copy_into(reading, plus)
    if down != 0.0 or job.centered:
        _evaluate(job, x, c, down, reach, start)
    else:
        copy_into(middle, reading)
    for s in range(job.nsensor):
        if _is_varied(job, s, start, on_contacts):
            for row in range(first[s], first[s] + dims[s]):
                change = (plus[row] - reading[row]) / (up - down)
                if c < ndx:
                    C[row, c] = change
                else:
                    D[row, c - ndx] = change


@compiled
def _evaluate(job, x, c, step, reach, start):
    """Readings of the stages from `start` to `reach`, with direction c (none: -1) varied by `step`; restores u."""
    nq, nv, na = job.nq, job.nv, job.na
    qpos, qvel, act, ctrl = (
        vector(job.qpos, nq), vector(job.qvel, nv), vector(job.act, na), vector(job.ctrl, job.nu)
    )  # fmt: skip
    copy_into(x[:nq], qpos)
    copy_into(x[nq : nq + nv], qvel)
    copy_into(x[nq + nv :], act)
    if reach == ACCELERATION:
        acc, acc_c, rate = vector(job.qacc, nv), vector(job.acc_c, nv), matrix(job.acc_rate, nv, job.columns)
        for i in range(nv):
            acc[i] = acc_c[i]
            if c >= 0:
                acc[i] += step * rate[i, c]
    u = 0.0
    if c >= 2 * nv + na:
        u = ctrl[c - 2 * nv - na]
        ctrl[c - 2 * nv - na] += step
    elif c >= 2 * nv:
        act[c - 2 * nv] += step
    elif c >= nv:
        qvel[c - nv] += step
    elif c >= 0:
        way = vector(job.change, nv)
        for i in range(nv):
            way[i] = 0.0
        way[c] = 1.0
        mj_integratePos(job.model, qpos.ctypes.data, way.ctypes.data, step)
    _run(job, reach, start)
    if c >= 2 * nv + na:
        ctrl[c - 2 * nv - na] = u


@compiled
def _run(job, reach, start):
    """MuJoCo's stages from `start` to `reach`, at the state, control and acceleration in mjData."""
    model, data = job.model, job.data
    if start == POSITION:
        mj_kinematics(model, data)
        mj_comPos(model, data)
        mj_camlight(model, data)
        if job.constrained and job.sensors_on_rows:
            find_rows(job)
        elif job.ntendon > 0:
            mj_tendon(model, data)
        if job.sensors_of_actuators:
            mj_transmission(model, data)
        if job.sensors_of_energy:
            mj_energyPos(model, data)
    if start <= VELOCITY and reach >= VELOCITY:
        _run_velocities(job, start)
    if start == POSITION or (start == VELOCITY and job.sensors_of_energy):
        mj_sensorPos(model, data)
    if reach == ACCELERATION:
        if job.sensors_of_actuators:
            mj_fwdActuation(model, data)
        if entry_count(data + job.at_nefc) > 0:
            evaluate_rows(job, vector(job.qacc, job.nv), 0)
        if job.sensors_of_bodies:
            mj_rnePostConstraint(model, data)
        mj_sensorAcc(model, data)


@compiled
def _run_velocities(job, start):
    model, data = job.model, job.data
    if job.sensors_of_actuators:
        mj_fwdVelocity(model, data)
    else:
        mj_comVel(model, data)
        if entry_count(data + job.at_nefc) > 0:
            mj_referenceConstraint(model, data)
    if job.sensors_of_energy:
        if start == POSITION:
            mj_makeM(model, data)
        mj_energyVel(model, data)
    if job.sensors_cut:
        mj_subtreeVel(model, data)
    mj_sensorVel(model, data)


@compiled
def _cut(job, C, D):
    """Readings at their limit do not change."""
    dims, first = integers(job.sen_dim, job.nsensor), integers(job.sen_adr, job.nsensor)
    limits, middle = matrix(job.sen_range, job.nsensor, 2), vector(job.middle, job.ny)
    for s in range(job.nsensor):
        for row in range(first[s], first[s] + dims[s]):
            if middle[row] <= limits[s, 0] or middle[row] >= limits[s, 1]:
                clear_rows(C, D, row, 1)
