"""Derivatives of the constraint forces J' s, with the acceleration that the rows see held fixed.

Notation
--------
    jar = J a - aref                     the rows' argument; aref = -b J v - k imp (pos - margin), and of the equality
                                         constraints connect and weld - dJ/dt v besides
    s(jar), H = -ds/djar                 forces and their slope, from MuJoCo: D on rows in the quadratic state, the
                                         cone's own block on sliding elliptic contacts, 0 on the others
    k, b, imp, imp'                      efc_KBIP;  R = 1/D is proportional to (1 - imp) / imp

By velocity and acceleration everything is explicit: d(J' s)/da = -J' H J, d(J' s)/dv = -J' H b J.
By position, for rows whose J is constant (limits of scalar joints and fixed tendons, where dpos/dq = J):

    ds = -D (k (imp' (pos - margin) + imp) + dlnD/dpos jar) J dq,     dlnD/dpos = imp' / (imp (1 - imp));

friction of joints and tendons has none. Where J changes, there are besides - D dJ (a + b v) in ds, and dJ' s:

    equality of two lengths    l_1 = P(l_2), of joints or fixed tendons: J = J_1 - P' J_2, dJ = - P'' J_2 (J_2 dq)'
    limit of a ball joint      pos = range - t, with t >= 0 the angle and n the axis of its rotation: J = -n',
                               dn = ([n] + cot(t/2) (1 - n n')) dq / 2

Contacts are in `contacts`, the equality constraints connect and weld in `equalities`. What remains (signed distance
fields, whose contacts do not depend on the geoms' poses alone, rows of spatial tendons, and under the discrete
integrator connect and weld) is differenced, in positions alone, and only at knots where such rows push: `differences`.
"""

from __future__ import annotations

import math

import numpy as np

from mjslq.dynamics.mujoco.inverse.rows.contacts import add_contact
from mjslq.dynamics.mujoco.inverse.rows.equalities import add_tie
from mjslq.dynamics.mujoco.inverse.rows.impedance import fold_references
from mjslq.dynamics.mujoco.inverse.spatial import add3, compiled, cross3, dot3, inlined, scale3, sub3
from mjslq.dynamics.mujoco.inverse.table.columns import BY_LENGTHS, CONNECT, FIELD, PLANE, UNKNOWN, WELD
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, entry_count, flags, integers, matrix, vector
from mjslq.native.declare import external

mj_tendon = external("mj_tendon", "void(intp, intp)")
mj_collision = external("mj_collision", "void(intp, intp)")
mj_makeConstraint = external("mj_makeConstraint", "void(intp, intp)")
mj_comVel = external("mj_comVel", "void(intp, intp)")
mj_referenceConstraint = external("mj_referenceConstraint", "void(intp, intp)")
mj_mulJacVec = external("mj_mulJacVec", "void(intp, intp, intp, intp)")
mj_constraintUpdate = external("mj_constraintUpdate", "void(intp, intp, intp, intp, int32)")

# mjtConstraint and mjtConstraintState
EQUALITY, FRICTION_DOF, FRICTION_TENDON, LIMIT_JOINT, LIMIT_TENDON, FRICTIONLESS, PYRAMIDAL, ELLIPTIC = range(8)
SATISFIED, QUADRATIC, LINEAR_LOW, LINEAR_HIGH, CONE = range(5)


@compiled
def find_rows(job):
    """Make the constraint rows at the pose in mjData; return how many there are."""
    if job.ntendon > 0:
        mj_tendon(job.model, job.data)
    mj_collision(job.model, job.data)
    mj_makeConstraint(job.row_model, job.data)
    return entry_count(job.data + job.at_nefc)


@compiled
def evaluate_rows(job, acc, with_cones):
    """Forces and states of the rows at the acceleration `acc`, and contact.H if wanted.

    Afterwards efc_vel, of no more use, holds jar.
    """
    if job.bodies_tied:
        mj_comVel(job.model, job.data)
    refer_rows(job)
    rows = entry_count(job.data + job.at_nefc)
    jar_address = entry_address(job.data + job.at_efc_vel)
    mj_mulJacVec(job.model, job.data, jar_address, acc.ctypes.data)
    jar, aref = vector(jar_address, rows), vector(entry_address(job.data + job.at_efc_aref), rows)
    for r in range(rows):
        jar[r] -= aref[r]
    mj_constraintUpdate(job.model, job.data, jar_address, 0, with_cones)


@compiled
def refer_rows(job):
    """Find J v and aref."""
    mj_referenceConstraint(job.row_model, job.data)
    if job.implicit == 3:
        fold_references(job)


@compiled
def read_row(job, r, dofs, values):
    """Collect the entries of row r of J; return how many there are."""
    J = entry_address(job.data + job.at_efc_J)
    count = 0
    if job.sparse == 0:
        row = vector(J + 8 * r * job.nv, job.nv)
        for i in range(job.nv):
            if row[i] != 0.0:
                dofs[count], values[count] = i, row[i]
                count += 1
        return count
    size = flags(entry_address(job.data + job.at_efc_J_rownnz), r + 1)[r]
    first = flags(entry_address(job.data + job.at_efc_J_rowadr), r + 1)[r]
    columns = flags(entry_address(job.data + job.at_efc_J_colind), first + size)
    row = vector(J + 8 * first, size)
    for k in range(size):
        dofs[k], values[k] = columns[first + k], row[k]
    return size


@compiled
def is_differenced(job, kind, index):
    """Whether the position derivative of a row is taken by differences; `index` is its efc_id."""
    if kind in (FRICTION_TENDON, LIMIT_TENDON):
        return integers(job.ten_constant, index + 1)[index] == 0
    if kind == EQUALITY:
        return integers(job.eq_kind, job.neq)[index] == UNKNOWN
    if kind < FRICTIONLESS:
        return False
    contact = entry_address(job.data + job.at_contact) + index * job.at_contact_size
    geoms, geom_kind = flags(contact + job.at_contact_geom, 2), integers(job.geom_kind, job.ngeom)
    return geom_kind[geoms[1]] == FIELD and geom_kind[geoms[0]] != PLANE


@compiled
def add_rows(job, acc, F, G):
    """F += d(J' s)/dz by velocity and (of covered rows) by position, G += J' H J; the rows have been evaluated.

    Returns whether rows that push are left to differences.
    """
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    states = flags(entry_address(job.data + job.at_efc_state), rows)
    D = vector(entry_address(job.data + job.at_efc_D), rows)
    KBIP = matrix(entry_address(job.data + job.at_efc_KBIP), rows, 4)
    pos = vector(entry_address(job.data + job.at_efc_pos), rows)
    margin = vector(entry_address(job.data + job.at_efc_margin), rows)
    jar = vector(entry_address(job.data + job.at_efc_vel), rows)
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    nv, rest = job.nv, False
    r = np.int64(0)  # a literal zero would have all that it is passed to compiled once more
    while r < rows:
        kind = kinds[r]
        if kind == ELLIPTIC and states[r] == CONE:
            contact = entry_address(job.data + job.at_contact) + ids[r] * job.at_contact_size
            _add_cone(job, r, contact, KBIP, F, G)
        elif states[r] == QUADRATIC:
            k, b, imp, slope = KBIP[r, 0], KBIP[r, 1], KBIP[r, 2], KBIP[r, 3]
            stiffness = 0.0
            tied = kind == EQUALITY and integers(job.eq_kind, job.neq)[ids[r]] in (CONNECT, WELD)
            if kind in (LIMIT_JOINT, LIMIT_TENDON, EQUALITY) and not tied and not is_differenced(job, kind, ids[r]):
                stiffness = k * (slope * (pos[r] - margin[r]) + imp) + slope / (imp * (1.0 - imp)) * jar[r]
            size = read_row(job, r, dofs, values)
            # what follows the velocity through dJ/dt too has that derivative elsewhere
            turns = tied or (kind == EQUALITY and job.implicit == 3 and is_differenced(job, kind, ids[r]))
            by_pos, by_vel = D[r] * stiffness, 0.0 if turns else D[r] * b
            for x in range(size):
                i = dofs[x]
                for y in range(size):
                    j, square = dofs[y], values[x] * values[y]
                    G[i, j] += D[r] * square
                    F[i, nv + j] -= by_vel * square
                    F[i, j] -= by_pos * square
            if tied and (r == 0 or kinds[r - 1] != EQUALITY or ids[r - 1] != ids[r]):
                add_tie(job, r, ids[r], F)
            elif kind == EQUALITY and integers(job.eq_kind, job.neq)[ids[r]] == BY_LENGTHS:
                add_bent_lengths(job, ids[r], D[r], b, jar[r], acc, dofs[:size], values, F)
            elif kind == LIMIT_JOINT and integers(job.dof_qadr, nv)[dofs[0]] < 0:
                add_turning_axis(
                    job, integers(job.dof_group, nv)[dofs[0]], D[r], b, jar[r], acc, dofs[:size], values, F
                )
        pushes = states[r] != SATISFIED
        rest = rest or (pushes and is_differenced(job, kind, ids[r]))
        if kind >= FRICTIONLESS:
            contact = entry_address(job.data + job.at_contact) + ids[r] * job.at_contact_size
            dim = flags(contact + job.at_contact_dim, 1)[0]
            count = 2 * (dim - 1) if kind == PYRAMIDAL else dim
            if not is_differenced(job, kind, ids[r]):
                add_contact(job, r, count, kind, contact, acc, F)
            if kind == ELLIPTIC and states[r] == CONE:
                r += count - 1
        r += 1
    return rest


@compiled
def add_bent_lengths(job, index, D, b, jar, acc, dofs, values, F):
    """F += the part that the change of J has, of an equality constraint with a polynomial P of a second length."""
    first = integers(job.eq_first, job.neq + 1)
    second, coef = integers(job.eq_dof, job.neq_coef), vector(job.eq_coef, job.neq_coef)
    qvel, rate = vector(job.qvel, job.nv), 0.0
    for m in range(first[index], first[index + 1]):
        rate += coef[m] * (acc[second[m]] + b * qvel[second[m]])
    bend = bend_of_length(job, index)
    for m in range(first[index], first[index + 1]):
        for k in range(dofs.shape[0]):
            F[dofs[k], second[m]] -= D * values[k] * bend * rate * coef[m]
        for k in range(first[index], first[index + 1]):
            F[second[k], second[m]] -= bend * D * jar * coef[k] * coef[m]


@compiled
def add_turning_axis(job, group, D, b, jar, acc, dofs, values, F):
    """F += the part that the change of J = -n' has, of the limit of a ball joint whose dofs start at `group`."""
    qvel = vector(job.qvel, job.nv)
    x = (
        acc[group] + b * qvel[group],
        acc[group + 1] + b * qvel[group + 1],
        acc[group + 2] + b * qvel[group + 2],
    )
    for c in range(3):
        dn = axis_turning(job, group, c)
        change = D * dot3(dn, x)
        for k in range(dofs.shape[0]):
            F[dofs[k], group + c] += values[k] * change
        for k in range(3):
            F[group + k, group + c] += D * jar * dn[k]


@inlined
def axis_turning(job, group, c):
    """Change of the axis n of a ball joint's rotation with dof c of its three, which start at `group`."""
    qpos, at = vector(job.qpos, job.nq), -2 - integers(job.dof_qadr, job.nv)[group]
    sine = math.sqrt(qpos[at + 1] ** 2 + qpos[at + 2] ** 2 + qpos[at + 3] ** 2)
    sign = 1.0 if qpos[at] >= 0.0 else -1.0
    n = (sign * qpos[at + 1] / sine, sign * qpos[at + 2] / sine, sign * qpos[at + 3] / sine)
    way = (1.0 if c == 0 else 0.0, 1.0 if c == 1 else 0.0, 1.0 if c == 2 else 0.0)
    across = sub3(way, scale3(dot3(n, way), n))
    return scale3(0.5, add3(cross3(n, way), scale3(sign * qpos[at] / sine, across)))


@inlined
def bend_of_length(job, index):
    """Return -P''(x) of the polynomial P of an equality constraint, at its second length x."""
    first = integers(job.eq_first, job.neq + 1)
    second, coef = integers(job.eq_dof, job.neq_coef), vector(job.eq_coef, job.neq_coef)
    qpos, at = vector(job.qpos, job.nq), integers(job.dof_qadr, job.nv)
    prm = matrix(job.eq_prm, job.neq, 6)[index]
    x = -prm[5]
    for m in range(first[index], first[index + 1]):
        x += coef[m] * qpos[at[second[m]]]
    return -(2.0 * prm[2] + x * (6.0 * prm[3] + x * 12.0 * prm[4]))


@compiled
def _add_cone(job, first, contact, KBIP, F, G):
    """G += J' H J and F -= J' H b J of one sliding elliptic contact."""
    dim = flags(contact + job.at_contact_dim, 1)[0]
    H = matrix(contact + job.at_contact_H, dim, dim)
    jacobian = matrix(job.jacobian, 10, job.nv)
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    for r in range(dim):
        for i in range(job.nv):
            jacobian[r, i] = 0.0
        for x in range(read_row(job, first + r, dofs, values)):
            jacobian[r, dofs[x]] = values[x]
    for r in range(dim):
        for c in range(dim):
            for i in range(job.nv):
                factor = H[r, c] * jacobian[r, i]
                if factor != 0.0:
                    for j in range(job.nv):
                        G[i, j] += factor * jacobian[c, j]
                        F[i, job.nv + j] -= factor * KBIP[first + c, 1] * jacobian[c, j]
