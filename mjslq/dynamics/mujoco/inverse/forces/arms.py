"""Derivatives of forces along lengths that are no linear function of positions: spatial tendons, cranks, sites.

Notation
--------
    J, G                 moment arm (force s along the length is J' s on the dofs), and its derivative G_ji = dJ_j/dq_i
    L                    derivative of the length by position; J, but for turned sites and ball joints
    s(length, J v, u)    the force: a tendon's spring and damper, an actuator's (`laws`), with derivatives s_l, s_v
    T_ji = s_v J_j J_i   what an implicit integrator takes, for i ~ j on one branch
    r_j = sum over i ~ j of J_i a_i

    dF_j/dq_i = G_ji s + J_j (s_l L_i + s_v (G' v)_i),     dF_j/dv_i = J_j s_v J_i,     dF_j/du = J_j s_u
    d(T a)_j/dq_i = G_ji s_v r_j + J_j (s_vl L_i + s_vv (G' v)_i) r_j + J_j s_v sum over k ~ j of G_ki a_k
    d(T a)_j/dv_i = J_j s_vv J_i r_j,                      d(T a)_j/du = J_j s_vu r_j

J comes from MuJoCo (mj_tendon, mj_transmission). Of tendons that are straight between sites L = J, and a piece of
length d along the unit vector n, whose ends move apart by e_i with dof i, adds to G_ji

    (e_j . e_i - (n . e_j) (n . e_i)) / d + n . (de_j/dq_i),

where the motion dp_j of an end turns with i if i comes before j, and is (turning of j) x dp_i otherwise. For all other
arms, G and L are differences of J and the length: of positions alone, however many forces there are.
"""

from __future__ import annotations

import math

from mjslq.dynamics.mujoco.inverse.forces.kinks import displacement, sign
from mjslq.dynamics.mujoco.inverse.rows.constraints import mj_tendon
from mjslq.dynamics.mujoco.inverse.rows.differences import mj_comPos, mj_integratePos, mj_kinematics
from mjslq.dynamics.mujoco.inverse.spatial import (
    compiled,
    cross3,
    dot3,
    inlined,
    row3,
    row6,
    scale3,
    sub3,
    velocity_at,
)  # fmt: skip
from mjslq.dynamics.mujoco.inverse.table.columns import BAND, DAMPING, FORCE_NUMBERS, STIFFNESS, TENDON_NUMBERS
from mjslq.dynamics.mujoco.inverse.table.job import flags, integers, matrix, vector
from mjslq.dynamics.mujoco.kernels import copy_into
from mjslq.native.declare import external

mj_transmission = external("mj_transmission", "void(intp, intp)")


@compiled
def measure_arms(job):
    """J, G and L of all arms, and their lengths and velocities."""
    dofs, qvel = integers(job.arm_dof, job.narm_dof), vector(job.qvel, job.nv)
    first, J = integers(job.arm_first, job.narm + 1), vector(job.arm_J, job.narm_dof)
    motion = matrix(job.arm_motion, job.narm, 2)
    _read(job, J, motion, 0)
    L = vector(job.arm_L, job.narm_dof)
    for a in range(job.narm):
        motion[a, 1] = 0.0
        for k in range(first[a], first[a + 1]):
            motion[a, 1] += J[k] * qvel[dofs[k]]
            L[k] = J[k]
    G = vector(job.arm_G, job.narm_square)
    for k in range(job.narm_square):
        G[k] = 0.0
    for piece in range(job.npiece):
        _add_piece(job, piece)
    if job.narm_q > 0:
        _difference(job)


@compiled
def _add_piece(job, piece):
    """G of a straight piece of tendon."""
    a = integers(job.piece_arm, job.npiece)[piece]
    sites, com = matrix(job.site_xpos, job.nsite, 3), matrix(job.subtree_com, job.nbody, 3)
    start, end = integers(job.piece_from, job.npiece)[piece], integers(job.piece_to, job.npiece)[piece]
    share, way = vector(job.piece_share, job.npiece)[piece], sub3(row3(sites, end), row3(sites, start))
    length = math.sqrt(dot3(way, way))
    if length < 1e-15:
        return
    n = scale3(1.0 / length, way)
    body, root = integers(job.site_bodyid, job.nsite), integers(job.body_rootid, job.nbody)
    first, dofs = integers(job.arm_first, job.narm + 1), integers(job.arm_dof, job.narm_dof)
    member, group = integers(job.member, job.nv), integers(job.dof_group, job.nv)
    cdof, size = matrix(job.cdof, job.nv, 6), first[a + 1] - first[a]
    dofs = dofs[first[a] : first[a + 1]]
    G = matrix(job.arm_G + 8 * integers(job.arm_at, job.narm)[a], size, size)
    ends = (matrix(job.piece_start, job.nv, 3), matrix(job.piece_end, job.nv, 3))
    for i in range(job.nv):
        member[i] = 0
    _move_end(job, body[start], sub3(row3(sites, start), row3(com, root[body[start]])), 1, ends[0])
    _move_end(job, body[end], sub3(row3(sites, end), row3(com, root[body[end]])), 2, ends[1])
    for y in range(size):
        i = dofs[y]
        apart = sub3(_motion(ends[1], member, i, 2), _motion(ends[0], member, i, 1))
        for x in range(size):
            j = dofs[x]
            e = sub3(_motion(ends[1], member, j, 2), _motion(ends[0], member, j, 1))
            bend = (dot3(e, apart) - dot3(n, e) * dot3(n, apart)) / length
            for side in range(2):
                if member[i] & member[j] & (side + 1):
                    moves, sign = ends[side], 2.0 * side - 1.0
                    if group[i] <= group[j]:
                        bend += sign * dot3(n, cross3(row3(cdof, i), row3(moves, j)))
                    else:
                        bend += sign * dot3(n, cross3(row3(cdof, j), row3(moves, i)))
            G[x, y] += share * bend


@compiled
def _move_end(job, b, x, mark, moves):
    """Motion with each dof of a point of body b at x, and marks for the dofs that move it."""
    member, parent, cdof = integers(job.member, job.nv), integers(job.dof_parentid, job.nv), matrix(job.cdof, job.nv, 6)
    i = integers(job.body_lastdof, job.nbody)[b]
    while i >= 0:
        member[i] |= mark
        moves[i, 0], moves[i, 1], moves[i, 2] = velocity_at(row6(cdof, i), x)
        i = parent[i]


@inlined
def _motion(moves, member, i, mark):
    return row3(moves, i) if member[i] & mark else (0.0, 0.0, 0.0)


@compiled
def _difference(job):
    """G and L, column by column; afterwards mjData is at its pose again."""
    varied, qpos, pose = integers(job.arm_q, job.narm_q), vector(job.qpos, job.nq), vector(job.arm_pose, job.nq)
    copy_into(qpos, pose)
    dofs, first = integers(job.arm_dof, job.narm_dof), integers(job.arm_first, job.narm + 1)
    at, G, L = integers(job.arm_at, job.narm), vector(job.arm_G, job.narm_square), vector(job.arm_L, job.narm_dof)
    J, plus, minus = (
        vector(job.arm_J, job.narm_dof), vector(job.arm_plus, job.narm_dof), vector(job.arm_minus, job.narm_dof)
    )  # fmt: skip
    motion, ahead, behind = (
        matrix(job.arm_motion, job.narm, 2), matrix(job.arm_ahead, job.narm, 2), matrix(job.arm_behind, job.narm, 2)
    )  # fmt: skip
    straight, apart = integers(job.arm_straight, job.narm), 2.0 * job.eps if job.centered else job.eps
    if not job.centered:
        minus, behind = J, motion
    for v in range(job.narm_q):
        _pose(job, varied[v], job.eps)
        _read(job, plus, ahead, 1)
        if job.centered:
            _pose(job, varied[v], -job.eps)
            _read(job, minus, behind, 1)
        for a in range(job.narm):
            size = first[a + 1] - first[a] if straight[a] == 0 else 0
            for i in range(size):
                if dofs[first[a] + i] == varied[v]:
                    L[first[a] + i] = (ahead[a, 0] - behind[a, 0]) / apart
                    for j in range(size):
                        G[at[a] + j * size + i] = (plus[first[a] + j] - minus[first[a] + j]) / apart
    _pose(job, 0, 0.0)


@compiled
def _pose(job, i, step):
    """Turn dof i by a step from the pose kept in arm_pose."""
    way = vector(job.change, job.nv)
    for j in range(job.nv):
        way[j] = 0.0
    way[i] = 1.0
    copy_into(vector(job.arm_pose, job.nq), vector(job.qpos, job.nq))
    if step != 0.0:
        mj_integratePos(job.model, job.qpos, way.ctypes.data, step)
    mj_kinematics(job.model, job.data)
    mj_comPos(job.model, job.data)
    if job.ntendon > 0:
        mj_tendon(job.model, job.data)


@compiled
def _read(job, J, motion, moved):
    """Lengths into the first column of `motion`, and moment arms, at the pose in mjData."""
    if job.ntendon > 0 and not moved:
        mj_tendon(job.model, job.data)
    if job.arms_act:
        mj_transmission(job.model, job.data)
    first, dofs = integers(job.arm_first, job.narm + 1), integers(job.arm_dof, job.narm_dof)
    tendon, out, row = integers(job.arm_tendon, job.narm), integers(job.arm_out, job.narm), vector(job.values, job.nv)
    for i in range(job.nv):
        row[i] = 0.0
    for a in range(job.narm):
        if tendon[a] >= 0:
            motion[a, 0] = vector(job.ten_length, job.ntendon)[tendon[a]]
            _spread(tendon[a], job.ten_J_rownnz, job.ten_J_rowadr, job.ten_J_colind, job.ten_J, row)
        else:
            motion[a, 0] = vector(job.actuator_length, job.nout)[out[a]]
            _spread(out[a], job.moment_rownnz, job.moment_rowadr, job.moment_colind, job.actuator_moment, row)
        for k in range(first[a], first[a + 1]):
            J[k] = row[dofs[k]]
        for k in range(first[a], first[a + 1]):
            row[dofs[k]] = 0.0


@compiled
def _spread(r, sizes, starts, places, entries, row):
    """Write the entries of row r of a sparse matrix."""
    size, start = flags(sizes, r + 1)[r], flags(starts, r + 1)[r]
    place, entry = flags(places, start + size), vector(entries, start + size)
    for k in range(start, start + size):
        row[place[k]] = entry[k]


@inlined
def tendon_force(prm, length, velocity):
    """Force of a tendon's spring and damper, its derivatives by length and velocity, and by velocity twice."""
    x, outside = displacement(length, prm[BAND], prm[BAND + 1])
    k1, k2, k3 = prm[STIFFNESS], prm[STIFFNESS + 1], prm[STIFFNESS + 2]
    d1, d2, d3 = prm[DAMPING], prm[DAMPING + 1], prm[DAMPING + 2]
    size = abs(velocity)
    force = -x * (k1 + x * (k2 + x * k3)) - velocity * (d1 + size * (d2 + size * d3))
    slope = -outside * (k1 + x * (2.0 * k2 + x * 3.0 * k3))
    drag = -(d1 + size * (2.0 * d2 + size * 3.0 * d3))
    return force, slope, drag, -2.0 * d2 * sign(velocity) - 6.0 * d3 * velocity


@compiled
def add_arms(job, acc, F, T, E):
    """F += df/dz, T += df/dv, E += h d(T a)/dz of the forces along all arms."""
    tendon, row, prm = (
        integers(job.arm_tendon, job.narm),
        integers(job.arm_row, job.narm),
        matrix(job.arm_prm, job.narm, TENDON_NUMBERS),
    )
    force, motion = matrix(job.act_force, job.nu, FORCE_NUMBERS), matrix(job.arm_motion, job.narm, 2)
    first, J = integers(job.arm_first, job.narm + 1), vector(job.arm_J, job.narm_dof)
    dofs, L = integers(job.arm_dof, job.narm_dof), vector(job.arm_L, job.narm_dof)
    for a in range(job.narm):
        if tendon[a] >= 0:
            s, s_l, s_v, s_vv = tendon_force(prm[a], motion[a, 0], motion[a, 1])
            s_vl = 0.0
        else:
            i = row[a]
            s, s_l, s_v, s_vl, s_vv = force[i, 0], force[i, 1], force[i, 2], force[i, 6], force[i, 7]
        start, end = first[a], first[a + 1]
        _add_arm(job, a, acc, s, s_l, s_v, s_vl, s_vv, dofs[start:end], J[start:end], L[start:end], F, T, E)
        if tendon[a] < 0:
            _add_signals(job, a, acc, dofs[start:end], J[start:end], F, E)


@compiled
def _add_arm(job, a, acc, s, s_l, s_v, s_vl, s_vv, dofs, J, L, F, T, E):
    """Columns of positions and velocities."""
    size, nv = dofs.shape[0], job.nv
    at = integers(job.arm_at, job.narm)[a]
    G = matrix(job.arm_G + 8 * at, size, size)
    qvel = vector(job.qvel, nv)
    for i in range(size):
        c, rate = dofs[i], 0.0
        for k in range(size):
            rate += G[k, i] * qvel[dofs[k]]
        pull, bend = s_l * L[i] + s_v * rate, s_vl * L[i] + s_vv * rate
        for j in range(size):
            F[dofs[j], c] += G[j, i] * s + J[j] * pull
            F[dofs[j], nv + c] += J[j] * s_v * J[i]
            T[dofs[j], c] += J[j] * s_v * J[i]
        if job.implicit == 2:
            for j in range(size):
                r, turned = _branch_rate(job, a, j, acc, dofs, J), 0.0
                for k in range(size):
                    if _same_branch(job, at, size, j, k):
                        turned += G[k, i] * acc[dofs[k]]
                E[dofs[j], c] += job.h * (G[j, i] * s_v * r + J[j] * (bend * r + s_v * turned))
                E[dofs[j], nv + c] += job.h * J[j] * s_vv * J[i] * r


@compiled
def _add_signals(job, a, acc, dofs, J, F, E):
    """Columns of an actuator's control and activation."""
    i = integers(job.arm_row, job.narm)[a]
    force, given = matrix(job.act_force, job.nu, FORCE_NUMBERS), matrix(job.act_input, job.nu, 3)
    act = integers(job.act_adr, job.nu)[i]
    control = 2 * job.nv + job.na + i
    for j in range(dofs.shape[0]):
        slope = 0.0
        if job.implicit == 2 and force[i, 5] != 0.0:
            slope = job.h * force[i, 5] * _branch_rate(job, a, j, acc, dofs, J)
        F[dofs[j], control] += J[j] * force[i, 3]
        E[dofs[j], control] += J[j] * slope * given[i, 1]
        if act >= 0:
            F[dofs[j], 2 * job.nv + act] += J[j] * force[i, 4]
            E[dofs[j], 2 * job.nv + act] += J[j] * slope * given[i, 2]


@inlined
def _same_branch(job, at, size, j, k):
    return integers(job.arm_branch, at + size * size)[at + j * size + k] == 1


@compiled
def _branch_rate(job, a, j, acc, dofs, J):
    """r_j."""
    size, total = dofs.shape[0], 0.0
    at = integers(job.arm_at, job.narm)[a]
    for k in range(size):
        if _same_branch(job, at, size, j, k):
            total += J[k] * acc[dofs[k]]
    return total
