"""Second derivatives of - w' J' s, the constraint rows' part of the Lagrangian, w = w1 fixed.

Notation (`rows.constraints`: J, s, jar, H, b, D, k, imp)
--------
    y = J w        what the rows feel of w
    S              da_c/dz

The gradient has a closed form that costs no more than reading J once and walking each contact's dofs once,

    by a    J' H y,      by v    J' b H y,      by q    - w' d(J' s)/dq,

of which the position columns of the second derivatives are differences, by dofs that move rows that push: of the
poses' rows alone, without dynamics and without solver. By v and a, second derivatives vanish but for sliding elliptic
contacts (`cones`), and by v for the constraints connect and weld, which follow dJ/dt v.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.algebra import assign
from mjslq.dynamics.mujoco.inverse.curvature.cones import bend_cone
from mjslq.dynamics.mujoco.inverse.curvature.contacts import add_load, add_slopes, start_loads
from mjslq.dynamics.mujoco.inverse.rigid import outward
from mjslq.dynamics.mujoco.inverse.rows.constraints import (
    CONE,
    ELLIPTIC,
    EQUALITY,
    FRICTIONLESS,
    LIMIT_JOINT,
    LIMIT_TENDON,
    PYRAMIDAL,
    QUADRATIC,
    SATISFIED,
    add_bent_lengths,
    add_turning_axis,
    evaluate_rows,
    find_rows,
    read_row,
)
from mjslq.dynamics.mujoco.inverse.rows.differences import mj_comPos, mj_integratePos, mj_kinematics
from mjslq.dynamics.mujoco.inverse.rows.equalities import add_tie
from mjslq.dynamics.mujoco.inverse.rows.geometry import meets_in_points
from mjslq.dynamics.mujoco.inverse.spatial import compiled, inlined
from mjslq.dynamics.mujoco.inverse.table.columns import BY_LENGTHS, CONNECT, PLANE, SPHERE, WELD
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, entry_count, flags, integers, matrix, vector
from mjslq.dynamics.mujoco.kernels import copy_into

WIDTH, NARROW = 1e-5, 3e-9
"""Size of the differences, to both sides and to one. [rad], [m]"""


@compiled
def weigh_rows(job, M, G):
    """G = M + J' H J; the rows have been evaluated."""
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    states = flags(entry_address(job.data + job.at_efc_state), rows)
    D = vector(entry_address(job.data + job.at_efc_D), rows)
    dofs, values, jacobian = integers(job.dofs, job.nv), vector(job.values, job.nv), matrix(job.jacobian, 10, job.nv)
    assign(G, M)
    r = np.int64(0)
    while r < rows:
        if kinds[r] == ELLIPTIC and states[r] == CONE:
            contact = entry_address(job.data + job.at_contact) + ids[r] * job.at_contact_size
            dim = flags(contact + job.at_contact_dim, 1)[0]
            H = matrix(contact + job.at_contact_H, dim, dim)
            read_cone(job, r, dim)
            for k in range(dim):
                for c in range(dim):
                    for i in range(job.nv):
                        factor = H[k, c] * jacobian[k, i]
                        if factor != 0.0:
                            for j in range(job.nv):
                                G[i, j] += factor * jacobian[c, j]
            r += dim - 1
        elif states[r] == QUADRATIC:
            size = read_row(job, r, dofs, values)
            for m in range(size):
                factor = D[r] * values[m]
                for n in range(size):
                    G[dofs[m], dofs[n]] += factor * values[n]
        r += 1


@compiled
def read_cone(job, first, dim):
    """Write the rows of J of one contact into job.jacobian."""
    jacobian, dofs, values = matrix(job.jacobian, 10, job.nv), integers(job.dofs, job.nv), vector(job.values, job.nv)
    for k in range(dim):
        for i in range(job.nv):
            jacobian[k, i] = 0.0
        for m in range(read_row(job, first + k, dofs, values)):
            jacobian[k, dofs[m]] = values[m]


@compiled
def slope_of_rows(job, acc, w, slope):
    """Write the gradient of - w' J' s by q, v, a into the rows of `slope`; the rows have been evaluated."""
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    states = flags(entry_address(job.data + job.at_efc_state), rows)
    contacts = entry_address(job.data + job.at_contact)
    for k in range(3):
        for i in range(job.nv):
            slope[k, i] = 0.0
    bent, touching, r = np.int64(0), np.int64(0), np.int64(0)
    while r < rows:
        if kinds[r] >= FRICTIONLESS:
            contact = contacts + ids[r] * job.at_contact_size
            dim = flags(contact + job.at_contact_dim, 1)[0]
            count = np.int64(2 * (dim - 1) if kinds[r] == PYRAMIDAL else dim)
            if touching == 0:
                start_loads(job, acc, w)
            add_load(job, r, count, kinds[r], contact)
            touching = np.int64(1)
            r += count - 1
        elif states[r] == QUADRATIC:
            bent = _add_row_slope(job, r, kinds[r], ids[r], acc, w, slope, bent)
        r += 1
    if touching == 1:
        add_slopes(job, slope)
    if bent == 1:
        F = matrix(job.F, job.nv, job.columns)
        for i in range(job.nv):
            for j in range(job.nv):
                slope[0, j] -= w[i] * F[i, j]
                slope[1, j] -= w[i] * F[i, job.nv + j]


@compiled
def _add_row_slope(job, r, kind, index, acc, w, slope, bent):
    """Add one row's; what has no form of its own here is collected in F, which is cleared at its first use."""
    K = matrix(entry_address(job.data + job.at_efc_KBIP), r + 1, 4)[r]
    D = vector(entry_address(job.data + job.at_efc_D), r + 1)[r]
    jar = vector(entry_address(job.data + job.at_efc_vel), r + 1)[r]
    pos = vector(entry_address(job.data + job.at_efc_pos), r + 1)[r]
    margin = vector(entry_address(job.data + job.at_efc_margin), r + 1)[r]
    dofs, values, F = integers(job.dofs, job.nv), vector(job.values, job.nv), matrix(job.F, job.nv, job.columns)
    tied = kind == EQUALITY and integers(job.eq_kind, job.neq)[index] in (CONNECT, WELD)
    size, y = read_row(job, r, dofs, values), 0.0
    for m in range(size):
        y += values[m] * w[dofs[m]]
    by_pos, by_vel = 0.0, 0.0 if tied else D * K[1] * y
    if kind in (LIMIT_JOINT, LIMIT_TENDON, EQUALITY) and not tied:
        by_pos = D * y * (K[0] * (K[3] * (pos - margin) + K[2]) + K[3] / (K[2] * (1.0 - K[2])) * jar)
    for m in range(size):
        slope[0, dofs[m]] += by_pos * values[m]
        slope[1, dofs[m]] += by_vel * values[m]
        slope[2, dofs[m]] += D * y * values[m]
    lengths = kind == EQUALITY and integers(job.eq_kind, job.neq)[index] == BY_LENGTHS
    turns = kind == LIMIT_JOINT and integers(job.dof_qadr, job.nv)[dofs[0]] < 0
    if not (tied or lengths or turns):
        return bent
    if bent == 0:
        for i in range(job.nv):
            for j in range(2 * job.nv):
                F[i, j] = 0.0
    if tied:
        if not _is_second_row(job, r, index):
            add_tie(job, r, index, F)
    elif lengths:
        add_bent_lengths(job, index, D, K[1], jar, acc, dofs[:size], values, F)
    else:
        group = integers(job.dof_group, job.nv)[dofs[0]]
        add_turning_axis(job, group, D, K[1], jar, acc, dofs[:size], values, F)
    return np.int64(1)


@inlined
def _is_second_row(job, r, index):
    """Whether the row before is one of the same equality constraint."""
    kinds = flags(entry_address(job.data + job.at_efc_type), r + 1)
    return r > 0 and kinds[r - 1] == EQUALITY and flags(entry_address(job.data + job.at_efc_id), r)[r - 1] == index


@compiled
def bend_rows(job, x, Z, X, S):
    """Z, X += the second derivatives at the knot x, whose rows have been evaluated; leaves mjData elsewhere."""
    acc, w, nv = vector(job.acc_c, job.nv), vector(job.w1, job.nv), job.nv
    marked, way, slopes = integers(job.marked, nv), vector(job.change, nv), matrix(job.slopes, 6, nv)
    _mark(job, marked)
    _bend_cones(job, w, Z, X, S)
    if job.bodies_tied:
        _bend_ties(job, acc, w, Z)
    one_sided = _bends_sharply(job)
    eps, share = NARROW if one_sided else WIDTH, 1.0 / NARROW if one_sided else 0.5 / WIDTH
    if one_sided:
        slope_of_rows(job, acc, w, slopes[3:])
    for i in range(nv):
        way[i] = 0.0
    for i in range(nv):
        if marked[i] == 0:
            continue
        way[i] = 1.0
        _slope_beside(job, x, way, eps, acc, w, slopes[:3])
        if not one_sided:
            _slope_beside(job, x, way, -eps, acc, w, slopes[3:])
        way[i] = 0.0
        for c in range(nv):
            by_q, by_v = 0.5 * share * (slopes[0, c] - slopes[3, c]), share * (slopes[1, c] - slopes[4, c])
            Z[i, c] += by_q
            Z[c, i] += by_q
            Z[nv + c, i] += by_v
            Z[i, nv + c] += by_v
            X[c, i] += share * (slopes[2, c] - slopes[5, c])


@compiled
def _slope_beside(job, x, way, eps, acc, w, slope):
    """Write the gradient at the pose of x (+) eps way."""
    qpos = vector(job.qpos, job.nq)
    copy_into(x[: job.nq], qpos)
    mj_integratePos(job.model, qpos.ctypes.data, way.ctypes.data, eps)
    mj_kinematics(job.model, job.data)
    mj_comPos(job.model, job.data)
    if find_rows(job) > 0:
        evaluate_rows(job, acc, 1)
        if job.bodies_tied:
            outward(job, vector(job.qvel, job.nv), acc)
    slope_of_rows(job, acc, w, slope)


@compiled
def _bends_sharply(job):
    """Whether narrow differences to one side will do.

    A row's impedance bends within millimetres, and the gradient is exact to the last digits. Not so for contacts other
    than those with planes and between spheres: how these move is known to nine digits only (`geometry`: FLAT; `pairs`);
    nor for the constraints connect and weld, which may hold things far apart, where digits are lost.
    """
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    states = flags(entry_address(job.data + job.at_efc_state), rows)
    contacts, shape = entry_address(job.data + job.at_contact), integers(job.geom_kind, job.ngeom)
    for r in range(rows):
        if kinds[r] == EQUALITY and integers(job.eq_kind, job.neq)[ids[r]] in (CONNECT, WELD):
            return False
        if kinds[r] >= FRICTIONLESS and states[r] != SATISFIED:
            contact = contacts + ids[r] * job.at_contact_size
            geoms = flags(contact + job.at_contact_geom, 2)
            first, second = shape[geoms[0]], shape[geoms[1]]
            if not (first == PLANE and meets_in_points(job, contact)) and not (first == SPHERE and second == SPHERE):
                return False
    return True


@compiled
def _mark(job, marked):
    """Mark the dofs that move rows that push."""
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    states = flags(entry_address(job.data + job.at_efc_state), rows)
    contacts, lastdof = entry_address(job.data + job.at_contact), integers(job.body_lastdof, job.nbody)
    of_body, first = integers(job.eq_body, 2 * job.neq), integers(job.eq_first, job.neq + 1)
    dofs, values, second = integers(job.dofs, job.nv), vector(job.values, job.nv), integers(job.eq_dof, job.neq_coef)
    group, end = integers(job.dof_group, job.nv), integers(job.dof_groupend, job.nv)
    for i in range(job.nv):
        marked[i] = 0
    for r in range(rows):
        if states[r] == SATISFIED:
            continue
        if kinds[r] >= FRICTIONLESS:
            geoms = flags(contacts + ids[r] * job.at_contact_size + job.at_contact_geom, 2)
            body = integers(job.geom_bodyid, job.ngeom)
            _mark_between(job, lastdof[body[geoms[0]]], lastdof[body[geoms[1]]], marked)
            continue
        if kinds[r] == EQUALITY:
            if integers(job.eq_kind, job.neq)[ids[r]] in (CONNECT, WELD):
                _mark_between(job, lastdof[of_body[2 * ids[r]]], lastdof[of_body[2 * ids[r] + 1]], marked)
                continue
            for k in range(first[ids[r]], first[ids[r] + 1]):
                marked[second[k]] = 1
        for k in range(read_row(job, r, dofs, values)):
            for j in range(group[dofs[k]], end[dofs[k]]):
                marked[j] = 1


@inlined
def _mark_between(job, i, j, marked):
    """Mark the dofs that move one of two bodies alone, given the last dof of either: no others change how they lie."""
    parent = integers(job.dof_parentid, job.nv)
    while i != j:
        if i > j:
            marked[i] = 1
            i = parent[i]
        else:
            marked[j] = 1
            j = parent[j]


@compiled
def _bend_ties(job, acc, w, Z):
    """By velocities: the forces of the constraints connect and weld, which follow dJ/dt v, are quadratic in them."""
    qvel, F, nv = vector(job.qvel, job.nv), matrix(job.F, job.nv, job.columns), job.nv
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    for i in range(nv):
        v = qvel[i]
        for side in range(2):
            qvel[i] = v - 1.0 if side else v + 1.0
            outward(job, qvel, acc)
            for j in range(nv):
                for c in range(2 * nv):
                    F[j, c] = 0.0
            for r in range(rows):
                tied = kinds[r] == EQUALITY and integers(job.eq_kind, job.neq)[ids[r]] in (CONNECT, WELD)
                if tied and not _is_second_row(job, r, ids[r]):
                    add_tie(job, r, ids[r], F)
            for j in range(nv):
                for c in range(nv):
                    Z[nv + i, nv + c] += (0.5 if side else -0.5) * w[j] * F[j, nv + c]
        qvel[i] = v


@compiled
def _bend_cones(job, w, Z, X, S):
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    states = flags(entry_address(job.data + job.at_efc_state), rows)
    r = np.int64(0)
    while r < rows:
        if kinds[r] == ELLIPTIC and states[r] == CONE:
            contact = entry_address(job.data + job.at_contact) + ids[r] * job.at_contact_size
            dim = np.int64(flags(contact + job.at_contact_dim, 1)[0])
            read_cone(job, r, dim)
            bend_cone(job, r, dim, contact, w, Z, X, S)
            r += dim - 1
        r += 1
