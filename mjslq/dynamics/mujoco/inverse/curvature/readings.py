"""Second derivatives of sensor readings, contracted with weights.

A force F = R_r w (w the weights, R_r the reference's orientation, at rest) on a point p of a body, or on an axis a,
does the work F . S_j at p, F . (theta_j x a) with dof j. A dof i before j turns all of that:

    place   F . (theta_i x S_j at p)         axis   F . (theta_i x (theta_j x a))

Centres of mass of subtrees are places, the mean of their bodies': with k the dof's body or the subtree's, whichever is
further out, F . (theta_i x linear part of I^C_k S_j) / mass. Readings that are linear in the state have none. Of all
other readings of motions the position columns are differences of their first derivatives (`readings.motions`); by
velocities alone they are linear.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.readings.frames import is_below, moves, pose
from mjslq.dynamics.mujoco.inverse.readings.motions import write_motions
from mjslq.dynamics.mujoco.inverse.rigid import inward, outward
from mjslq.dynamics.mujoco.inverse.rows.differences import mj_comPos, mj_integratePos, mj_kinematics
from mjslq.dynamics.mujoco.inverse.spatial import (
    compiled,
    cross3,
    dot3,
    head,
    inertia_times,
    row6,
    scale3,
    tail,
    turned,
    velocity_at,
)
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.columns import CLOSED, DIFFERENCED
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix, vector
from mjslq.dynamics.mujoco.kernels import copy_into

WIDTH = 1e-5
"""Size of the differences. [rad], [m]"""


@compiled
def bend_readings(job, x, weights, Z, feeling):
    """Z += the second derivatives of weights' y at the knot in mjData, which is left as it was."""
    served, row = integers(job.sen_bent, job.nsensor), integers(job.sen_adr, job.nsensor)
    kinds, dim = integers(job.sen_kind, job.nsensor), integers(job.sen_dim, job.nsensor)
    some = False
    for s in range(job.nsensor):
        if served[s] == CLOSED and kinds[s] == columns.SUBTREE_COM:
            _bend_center(job, s, weights[row[s] : row[s] + 3], Z)
        elif served[s] == CLOSED:
            _bend_frame(job, s, kinds[s], weights[row[s] : row[s] + 3], Z)
        elif served[s] == DIFFERENCED:
            for k in range(row[s], row[s] + dim[s]):
                some = some or weights[k] != 0.0
    if feeling is not None and some:
        _bend_by_differences(job, x, weights, Z)


@compiled
def _bend_frame(job, s, kind, weights, Z):
    body, other = integers(job.sen_body, job.nsensor)[s], integers(job.sen_reference, job.nsensor)[s]
    prm = matrix(job.sen_prm, job.nsensor, columns.FRAME_NUMBERS)[s]
    place, _, q = pose(job, body, prm[:7])
    _, _, q_r = pose(job, other, prm[7:])
    F = turned(q_r, (weights[0], weights[1], weights[2]))
    at = integers(job.sen_target, job.nsensor)[s]
    axis = turned(q, (1.0 if at == 0 else 0.0, 1.0 if at == 1 else 0.0, 1.0 if at == 2 else 0.0))
    parent, cdof = integers(job.dof_parentid, job.nv), matrix(job.cdof, job.nv, 6)
    j = integers(job.body_lastdof, job.nbody)[body]
    while j >= 0:
        S = row6(cdof, j)
        _turn_along(job, j, F, velocity_at(S, place) if kind == columns.FRAME_POS else cross3(head(S), axis), Z)
        j = parent[j]


@compiled
def _turn_along(job, j, F, motion, Z):
    """Z += F . (theta_i x motion) for the motion of dof j and all dofs i up to its group's last."""
    group, parent = integers(job.dof_group, job.nv), integers(job.dof_parentid, job.nv)
    cdof, i = matrix(job.cdof, job.nv, 6), integers(job.dof_groupend, job.nv)[j] - 1
    while i >= 0:
        share = 0.5 if group[i] == group[j] else 1.0
        value = share * dot3(F, cross3(head(row6(cdof, i)), motion))
        Z[i, j] += value
        Z[j, i] += value
        i = parent[i]


@compiled
def _bend_center(job, s, weights, Z):
    """Centre of mass of a subtree; the world's is that of all trees."""
    body, parent = integers(job.sen_body, job.nsensor)[s], integers(job.body_parentid, job.nbody)
    mass = vector(job.body_subtreemass, job.nbody)[body]
    inertia, cinert = matrix(job.body_inertia, job.nbody, 10), matrix(job.cinert, job.nbody, 10)
    dof_body, lastdof = integers(job.dof_bodyid, job.nv), integers(job.body_lastdof, job.nbody)
    cdof, F = matrix(job.cdof, job.nv, 6), (weights[0], weights[1], weights[2])
    for b in range(job.nbody):
        for k in range(10):
            inertia[b, k] = cinert[b, k]
    for b in range(job.nbody - 1, 0, -1):
        if parent[b] > 0:
            for k in range(10):
                inertia[parent[b], k] += inertia[b, k]
    for j in range(job.nv):
        within = is_below(job, dof_body[j], body)
        if within or moves(job, j, lastdof[body]):
            k = dof_body[j] if within else body
            motion = scale3(1.0 / mass, tail(inertia_times(inertia, k, row6(cdof, j))))
            _turn_along(job, j, F, motion, Z)


@compiled
def _bend_by_differences(job, x, weights, Z):
    qpos, way, nv, ndx = vector(job.qpos, job.nq), vector(job.change, job.nv), job.nv, 2 * job.nv + job.na
    served, row = integers(job.sen_bent, job.nsensor), integers(job.sen_adr, job.nsensor)
    dim = integers(job.sen_dim, job.nsensor)
    C, D = matrix(job.C, job.ny, ndx), matrix(job.D, job.ny, job.nu)
    still = vector(job.plus, nv)
    for i in range(nv):
        way[i], still[i] = 0.0, 0.0
    for i in range(nv):
        way[i] = 1.0
        for side in range(2):
            eps = WIDTH if side == 0 else -WIDTH
            copy_into(x[: job.nq], qpos)
            mj_integratePos(job.model, qpos.ctypes.data, way.ctypes.data, eps)
            mj_kinematics(job.model, job.data)
            mj_comPos(job.model, job.data)
            outward(job, vector(job.qvel, nv), still)
            inward(job)
            write_motions(job, C, D)
            for s in range(job.nsensor):
                for r in range(row[s], row[s] + dim[s] if served[s] == DIFFERENCED else row[s]):
                    share = 0.5 * weights[r] / eps
                    for c in range(nv):
                        Z[i, c] += 0.5 * share * C[r, c]
                        Z[c, i] += 0.5 * share * C[r, c]
                        Z[nv + c, i] += share * C[r, nv + c]
                        Z[i, nv + c] += share * C[r, nv + c]
        way[i] = 0.0
    copy_into(x[: job.nq], qpos)
    mj_kinematics(job.model, job.data)
    mj_comPos(job.model, job.data)
