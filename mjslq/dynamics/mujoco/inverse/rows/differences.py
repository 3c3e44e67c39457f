"""Position derivatives of constraint forces for which there is no closed form here, by differences of positions alone.

At fixed velocity and acceleration the forces J' s of the rows in question are a function of the pose, which costs the
kinematics, the collisions and the rows themselves to evaluate; no dynamics and no solver. Only dofs of the trees that
such rows touch are varied.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.rows.constraints import (
    EQUALITY,
    SATISFIED,
    evaluate_rows,
    find_rows,
    is_differenced,
    mj_comVel,
    read_row,
    refer_rows,
)
from mjslq.dynamics.mujoco.inverse.rows.pairs import WIDTH
from mjslq.dynamics.mujoco.inverse.rows.weights import weigh_rows
from mjslq.dynamics.mujoco.inverse.spatial import compiled
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, entry_count, flags, integers, vector
from mjslq.dynamics.mujoco.kernels import copy_into
from mjslq.native.declare import external

mj_kinematics = external("mj_kinematics", "void(intp, intp)")
mj_comPos = external("mj_comPos", "void(intp, intp)")
mj_integratePos = external("mj_integratePos", "void(intp, intp, intp, float64)")


@compiled
def add_differences(job, x, acc, F):
    """F += d(J' s)/dq of the differenced rows at the state x, whose rows have been evaluated.

    Leaves mjData at the pose of x.
    """
    marked = integers(job.marked, job.nv)
    _mark(job, marked)
    plus, minus, way = vector(job.plus, job.nv), vector(job.minus, job.nv), vector(job.change, job.nv)
    eps = WIDTH * job.eps
    apart = 2.0 * eps if job.centered else eps
    for i in range(job.nv):
        way[i] = 0.0
    if not job.centered:
        _sum_forces(job, minus)
    for i in range(job.nv):
        if marked[i] == 0:
            continue
        way[i] = 1.0
        _evaluate_pose(job, x, way, eps, acc)
        _sum_forces(job, plus)
        if job.centered:
            _evaluate_pose(job, x, way, -eps, acc)
            _sum_forces(job, minus)
        way[i] = 0.0
        for j in range(job.nv):
            F[j, i] += (plus[j] - minus[j]) / apart
    _evaluate_pose(job, x, way, 0.0, acc)
    if job.bodies_tied and job.implicit == 3:
        _add_velocity_differences(job, marked, plus, minus, F)


@compiled
def _add_velocity_differences(job, marked, plus, minus, F):
    """F += J' D daref/dv of the differenced equality constraints."""
    qvel = vector(job.qvel, job.nv)
    for i in range(job.nv):
        if marked[i] == 0:
            continue
        v = qvel[i]
        for side in range(2):
            qvel[i] = v + 1.0 if side == 0 else v - 1.0
            _pulls_at_velocity(job, plus if side == 0 else minus)
        qvel[i] = v
        for j in range(job.nv):
            F[j, job.nv + i] += 0.5 * (plus[j] - minus[j])


@compiled
def _pulls_at_velocity(job, total):
    """Sum J' D aref of the differenced equality constraints at the velocity in mjData."""
    mj_comVel(job.model, job.data)
    refer_rows(job)
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    aref = vector(entry_address(job.data + job.at_efc_aref), rows)
    D = vector(entry_address(job.data + job.at_efc_D), rows)
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    for j in range(job.nv):
        total[j] = 0.0
    for r in range(rows):
        if kinds[r] == EQUALITY and is_differenced(job, kinds[r], ids[r]):
            for k in range(read_row(job, r, dofs, values)):
                total[dofs[k]] += D[r] * aref[r] * values[k]


@compiled
def _evaluate_pose(job, x, way, eps, acc):
    """Make and evaluate the rows at the pose of x (+) eps way."""
    qpos = vector(job.qpos, job.nq)
    copy_into(x[: job.nq], qpos)
    if eps != 0.0:
        mj_integratePos(job.model, qpos.ctypes.data, way.ctypes.data, eps)
    mj_kinematics(job.model, job.data)
    mj_comPos(job.model, job.data)
    if find_rows(job) > 0:
        if job.implicit == 3:
            weigh_rows(job)
        evaluate_rows(job, acc, 0)


@compiled
def _sum_forces(job, total):
    """Sum J' s of the differenced rows."""
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    s = vector(entry_address(job.data + job.at_efc_force), rows)
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    for j in range(job.nv):
        total[j] = 0.0
    for r in range(rows):
        if s[r] != 0.0 and is_differenced(job, kinds[r], ids[r]):
            for k in range(read_row(job, r, dofs, values)):
                total[dofs[k]] += s[r] * values[k]


@compiled
def _mark(job, marked):
    """Mark the dofs that matter to differenced rows that push."""
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    states = flags(entry_address(job.data + job.at_efc_state), rows)
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    tree = integers(job.dof_treeid, job.nv)
    for i in range(job.nv):
        marked[i] = 0
    for r in range(rows):
        if states[r] == SATISFIED or not is_differenced(job, kinds[r], ids[r]):
            continue
        for k in range(read_row(job, r, dofs, values)):
            for i in range(job.nv):
                if tree[i] == tree[dofs[k]]:
                    marked[i] = 1
