"""What the discrete integrator's metric does to the weights D of the constraint rows, and how that changes.

Notation
--------
    M~ = M + ...      the metric (`metric`), s its addition to the diagonal of M
    rho               (sum_i J_i^2 / (M_ii + s_i)) / (sum_i J_i^2 / M_ii), with J the first row of a contact, or the row

MuJoCo multiplies the approximate diagonal of each row by rho, so that D = D0 / rho (`impedance` has the rest of D).
Forces are proportional to D at fixed jar (those of dry friction that slides do not depend on it), and with

    dln(rho) = sum_i  x_i dJ_i + e_i dM_ii + w_i ds_i,
    x_i = 2 J_i (1 / ((M_ii + s_i) n~) - 1 / (M_ii n)),
    e_i = (J_i / M_ii)^2 / n + w_i,          w_i = -(J_i / (M_ii + s_i))^2 / n~,

n and n~ the two sums, the constraint forces change by -J' s dln(rho). Turning dof j beyond dof i changes

    dM_ii/dq_j = 2 (S_i x S_j)' I^C_j S_i.

Rows that are differenced by position see M and s frozen there: that part is analytic for them too.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.rows.constraints import (
    CONE,
    EQUALITY,
    FRICTIONLESS,
    LIMIT_JOINT,
    PYRAMIDAL,
    QUADRATIC,
    axis_turning,
    bend_of_length,
    is_differenced,
    read_row,
)
from mjslq.dynamics.mujoco.inverse.rows.contacts import add_row_change
from mjslq.dynamics.mujoco.inverse.rows.impedance import resolve, softness
from mjslq.dynamics.mujoco.inverse.spatial import compiled, cross_motion, dot6, inertia_times, inlined, row6
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, entry_count, flags, integers, matrix, vector


@inlined
def _group_size(job, kind, index):
    """Rows that share one weight: those of a contact."""
    if kind <= FRICTIONLESS:
        return 1
    contact = entry_address(job.data + job.at_contact) + index * job.at_contact_size
    dim = flags(contact + job.at_contact_dim, 1)[0]
    return 2 * (dim - 1) if kind == PYRAMIDAL else dim


@compiled
def weigh_rows(job):
    """Replace spring, damper, R and D of all rows, fresh from MuJoCo, by those of the discrete integrator."""
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    KBIP = matrix(entry_address(job.data + job.at_efc_KBIP), rows, 4)
    R, D = vector(entry_address(job.data + job.at_efc_R), rows), vector(entry_address(job.data + job.at_efc_D), rows)
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    r = np.int64(0)  # as in `add_rows`
    while r < rows:
        count = _group_size(job, kinds[r], ids[r])
        bare, full = _diagonals(job, dofs, values, read_row(job, r, dofs, values))
        for k in range(r, r + count):
            resolve(job, kinds[k], ids[k], KBIP[k])
        factor = softness(job, KBIP[r]) * (full / bare if bare > 0.0 else 1.0)
        for k in range(r, r + count):
            R[k] *= factor
            D[k] /= factor
        r += count


@inlined
def _diagonals(job, dofs, values, size):
    """Return n and n~ of a row."""
    M, T = matrix(job.M, job.nv, job.nv), matrix(job.T, job.nv, job.nv)
    bare, full = 0.0, 0.0
    for k in range(size):
        i, square = dofs[k], values[k] * values[k]
        bare += square / M[i, i]
        full += square / (M[i, i] - job.h * T[i, i])
    return bare, full


@compiled
def add_weight_changes(job, F):
    """F -= J' s dln(rho)/dz, but for what of it the differenced rows' own differences see."""
    rows = entry_count(job.data + job.at_nefc)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    change, total = vector(job.row_change, job.columns), vector(job.plus, job.nv)
    # forces that are linear in all that s depends on leave s a constant
    columns = job.columns if job.bends else job.nv
    prepared, r = False, np.int64(0)
    while r < rows:
        count = _group_size(job, kinds[r], ids[r])
        if _sum_forces(job, r, count, total) and _is_weighted(job, r):
            if not prepared:
                _prepare_inertias(job)
                prepared = True
            _write_change(job, r, count, kinds[r], ids[r], change)
            for i in range(job.nv):
                if total[i] != 0.0:
                    for c in range(columns):
                        F[i, c] -= total[i] * change[c]
        r += count


@compiled
def _sum_forces(job, first, count, total):
    """Write J' s of the rows whose force is proportional to D; return whether there are any."""
    states = flags(entry_address(job.data + job.at_efc_state), first + count)
    s = vector(entry_address(job.data + job.at_efc_force), first + count)
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    found = False
    for i in range(job.nv):
        total[i] = 0.0
    for r in range(first, first + count):
        # the rows of a sliding elliptic contact have their common state in its first
        if states[r] == QUADRATIC or states[first] == CONE:
            found = True
            for k in range(read_row(job, r, dofs, values)):
                total[dofs[k]] += s[r] * values[k]
    return found


@inlined
def _is_weighted(job, r):
    T, dofs, values = matrix(job.T, job.nv, job.nv), integers(job.dofs, job.nv), vector(job.values, job.nv)
    for k in range(read_row(job, r, dofs, values)):  # noqa: SIM110 -- a plain loop is what numba compiles well
        if T[dofs[k], dofs[k]] != 0.0:
            return True
    return False


@compiled
def _prepare_inertias(job):
    """Write dM_ii/dq_j; the subtrees' inertias are those of `mass_matrix`."""
    changes, cdof = matrix(job.mass_change, job.nv, job.nv), matrix(job.cdof, job.nv, 6)
    inertia, body = matrix(job.body_inertia, job.nbody, 10), integers(job.dof_bodyid, job.nv)
    parent, group = integers(job.dof_parentid, job.nv), integers(job.dof_group, job.nv)
    for j in range(job.nv):
        i = parent[group[j]]
        while i >= 0:
            S = row6(cdof, i)
            changes[i, j] = 2.0 * dot6(cross_motion(S, row6(cdof, j)), inertia_times(inertia, body[j], S))
            i = parent[i]


@compiled
def _write_change(job, r, count, kind, index, change):
    """dln(rho)/dz of one row or contact."""
    M, T = matrix(job.M, job.nv, job.nv), matrix(job.T, job.nv, job.nv)
    mass_change, slope = matrix(job.mass_change, job.nv, job.nv), matrix(job.metric_slope, job.nv, job.columns)
    dofs, values, x = integers(job.dofs, job.nv), vector(job.values, job.nv), vector(job.change, job.nv)
    size = read_row(job, r, dofs, values)
    bare, full = _diagonals(job, dofs, values, size)
    for c in range(job.columns):
        change[c] = 0.0
    for i in range(job.nv):
        x[i] = 0.0
    for n in range(size):
        i, J = dofs[n], values[n]
        by_M, by_full = J / M[i, i], J / (M[i, i] - job.h * T[i, i])
        x[i] = 2.0 * (by_full / full - by_M / bare)
        by_s = -by_full * by_full / full
        for j in range(i + 1, job.nv):
            change[j] += (by_M * by_M / bare + by_s) * mass_change[i, j]
        if job.bends:
            for c in range(job.columns):
                change[c] += by_s * slope[i, c]
    if is_differenced(job, kind, index):
        return
    if kind >= FRICTIONLESS:
        contact = entry_address(job.data + job.at_contact) + index * job.at_contact_size
        add_row_change(job, count, kind, contact, x, change)
    elif kind == EQUALITY:
        _add_bend(job, index, x, change)
    elif kind == LIMIT_JOINT and integers(job.dof_qadr, job.nv)[dofs[0]] < 0:
        group = integers(job.dof_group, job.nv)[dofs[0]]
        for c in range(3):
            dn = axis_turning(job, group, c)
            for k in range(3):
                change[group + c] -= dn[k] * x[group + k]


@inlined
def _add_bend(job, index, x, change):
    """Change of the second length's part of J, of an equality constraint of two lengths."""
    first = integers(job.eq_first, job.neq + 1)
    second, coef = integers(job.eq_dof, job.neq_coef), vector(job.eq_coef, job.neq_coef)
    bend = bend_of_length(job, index)
    for m in range(first[index], first[index + 1]):
        for k in range(first[index], first[index + 1]):
            change[second[m]] += bend * coef[m] * coef[k] * x[second[k]]
