"""Derivatives of a rigid-body tree's inverse dynamics, tau = M(q) a + c(q, v), exact and in one sweep.

Notation (spatial vectors: `spatial`)
--------
    S_i                  motion of dof i per unit of its velocity, cdof[i]
    v, a                 velocity and acceleration on the parent's side of a joint; the world accelerates with -gravity
    group                dofs that share a parent's side: the axes of a ball joint, the rotations of a free joint;
                         every other dof (a free joint's translations too) is a group of its own
    P_i, R_i             P_i = v x S_i,   R_i = a x S_i + v x P_i
    Q_i                  (v + the group's own velocity) x S_i + P_i
    I, h = I v, f        inertia of a body, its momentum, its force f = I a + v x* h
    I^C, h^C, f^C        sums over the subtree of the dof's body

Derivatives (Singh, Russell, Wensing, "Efficient analytical derivatives of rigid-body dynamics using spatial vector
algebra", RA-L 2022), dq taken in the tangent directions of mj_integratePos. For j an ancestor of i, or in its group,

    dtau_i/dq_j = S_i' (2 B P_j + I^C R_j)      dtau_i/dv_j = S_i' (2 B S_j + I^C Q_j)      M_ij = S_i' I^C S_j

and the other way round, for j in another group,

    dtau_j/dq_i = S_j' (2 B P_i + I^C R_i + S_i x* f^C)      dtau_j/dv_i = S_j' (2 B S_i + I^C Q_i)

with 2 B = (v x*) I - I (v x) + (h) xbar*, summed over the subtree. Worked out in blocks most of it cancels: with
v = (w, l), I = (J, m c, m), h = (n, p) it is

    2 B (a, b) = (Y a - n x a, -2 p x a),     Y = w x J + (w x J)' - mc l' - l mc' + 2 (mc . l) 1   (symmetric)

so that twelve numbers per body stand for its 36 entries, six of which are the momentum.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    add6,
    compiled,
    cross3,
    cross_force,
    cross_motion,
    dot3,
    dot6,
    head,
    inertia_times,
    inlined,
    join,
    put6,
    row3,
    row6,
    scale3,
    scale6,
    sub3,
    tail,
)
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix, vector


@inlined
def coriolis_matrix(Y, b, inertia, v):
    """Write Y of body b into its row, as Yxx Yyy Yzz Yxy Yxz Yyz."""
    w0, w1, w2 = head(v)
    l0, l1, l2 = tail(v)
    xx, yy, zz, xy, xz, yz = row6(inertia, b)
    c0, c1, c2 = inertia[b, 6], inertia[b, 7], inertia[b, 8]
    twice = 2.0 * (c0 * l0 + c1 * l1 + c2 * l2)
    Y[b, 0] = 2.0 * (w1 * xz - w2 * xy) - 2.0 * c0 * l0 + twice
    Y[b, 1] = 2.0 * (w2 * xy - w0 * yz) - 2.0 * c1 * l1 + twice
    Y[b, 2] = 2.0 * (w0 * yz - w1 * xz) - 2.0 * c2 * l2 + twice
    Y[b, 3] = (w1 * yz - w2 * yy) + (w2 * xx - w0 * xz) - c0 * l1 - c1 * l0
    Y[b, 4] = (w1 * zz - w2 * yz) + (w0 * xy - w1 * xx) - c0 * l2 - c2 * l0
    Y[b, 5] = (w2 * xz - w0 * zz) + (w0 * yy - w1 * xy) - c1 * l2 - c2 * l1


@inlined
def symmetric_times(Y, b, a):
    """Y a."""
    return (
        Y[b, 0] * a[0] + Y[b, 3] * a[1] + Y[b, 4] * a[2],
        Y[b, 3] * a[0] + Y[b, 1] * a[1] + Y[b, 5] * a[2],
        Y[b, 4] * a[0] + Y[b, 5] * a[1] + Y[b, 2] * a[2],
    )


@compiled
def outward(job, vel, acc):
    """Go from the roots to the leaves: P, Q, R of the dofs, v, a, h, f, I, Y of the bodies."""
    body_parentid = integers(job.body_parentid, job.nbody)
    body_dofadr = integers(job.body_dofadr, job.nbody)
    body_dofnum = integers(job.body_dofnum, job.nbody)
    dof_groupend = integers(job.dof_groupend, job.nv)
    gravity = vector(job.gravity, 3)
    cdof = matrix(job.cdof, job.nv, 6)
    cinert = matrix(job.cinert, job.nbody, 10)
    body_vel = matrix(job.body_vel, job.nbody, 6)
    body_acc = matrix(job.body_acc, job.nbody, 6)
    body_momentum = matrix(job.body_momentum, job.nbody, 6)
    body_force = matrix(job.body_force, job.nbody, 6)
    body_Y = matrix(job.body_Y, job.nbody, 6)
    body_inertia = matrix(job.body_inertia, job.nbody, 10)
    dof_P = matrix(job.dof_P, job.nv, 6)
    dof_Q = matrix(job.dof_Q, job.nv, 6)
    dof_R = matrix(job.dof_R, job.nv, 6)
    put6(body_vel, 0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    put6(body_acc, 0, (0.0, 0.0, 0.0, -gravity[0], -gravity[1], -gravity[2]))
    for b in range(1, job.nbody):
        parent = body_parentid[b]
        v, a = row6(body_vel, parent), row6(body_acc, parent)
        first, end = body_dofadr[b], body_dofadr[b] + body_dofnum[b]
        while first < end:
            last = dof_groupend[first]
            after_v, after_a = v, a
            for i in range(first, last):
                after_v = add6(after_v, scale6(vel[i], row6(cdof, i)))
            for i in range(first, last):
                S = row6(cdof, i)
                P, own = cross_motion(v, S), cross_motion(after_v, S)
                put6(dof_P, i, P)
                put6(dof_Q, i, add6(P, own))
                put6(dof_R, i, add6(cross_motion(a, S), cross_motion(v, P)))
                # a dof alone in its group adds nothing to its own rate of change: own is P, up to S x S = 0
                after_a = add6(after_a, add6(scale6(acc[i], S), scale6(vel[i], own)))
            v, a, first = after_v, after_a, last
        put6(body_vel, b, v)
        put6(body_acc, b, a)
        h = inertia_times(cinert, b, v)
        put6(body_momentum, b, h)
        put6(body_force, b, add6(inertia_times(cinert, b, a), cross_force(v, h)))
        for k in range(10):
            body_inertia[b, k] = cinert[b, k]
        coriolis_matrix(body_Y, b, cinert, v)


@compiled
def inward(job):
    """Sum inertias, momenta, forces and Y over the subtrees."""
    body_parentid = integers(job.body_parentid, job.nbody)
    body_momentum = matrix(job.body_momentum, job.nbody, 6)
    body_force = matrix(job.body_force, job.nbody, 6)
    body_Y = matrix(job.body_Y, job.nbody, 6)
    body_inertia = matrix(job.body_inertia, job.nbody, 10)
    for b in range(job.nbody - 1, 0, -1):
        parent = body_parentid[b]
        if parent > 0:
            for k in range(6):
                body_momentum[parent, k] += body_momentum[b, k]
                body_force[parent, k] += body_force[b, k]
                body_Y[parent, k] += body_Y[b, k]
            for k in range(10):
                body_inertia[parent, k] += body_inertia[b, k]


@compiled
def mass_matrix(job, M):
    """Write M, in the entries of dofs on one branch (armature included)."""
    body_parentid = integers(job.body_parentid, job.nbody)
    dof_bodyid = integers(job.dof_bodyid, job.nv)
    dof_parentid = integers(job.dof_parentid, job.nv)
    dof_armature = vector(job.dof_armature, job.nv)
    cdof = matrix(job.cdof, job.nv, 6)
    cinert = matrix(job.cinert, job.nbody, 10)
    body_inertia = matrix(job.body_inertia, job.nbody, 10)
    for b in range(job.nbody):
        for k in range(10):
            body_inertia[b, k] = cinert[b, k]
    for b in range(job.nbody - 1, 0, -1):
        parent = body_parentid[b]
        if parent > 0:
            for k in range(10):
                body_inertia[parent, k] += body_inertia[b, k]
    for i in range(job.nv):
        IS = inertia_times(body_inertia, dof_bodyid[i], row6(cdof, i))
        j = i
        while j >= 0:
            M[i, j] = M[j, i] = dot6(IS, row6(cdof, j))
            j = dof_parentid[j]
        M[i, i] += dof_armature[i]


@compiled
def subtract_derivatives(job, F, M):
    """F -= dtau/dz; M is written, in the entries of dofs on one branch (armature included)."""
    dof_bodyid = integers(job.dof_bodyid, job.nv)
    dof_parentid = integers(job.dof_parentid, job.nv)
    dof_group = integers(job.dof_group, job.nv)
    dof_groupend = integers(job.dof_groupend, job.nv)
    dof_armature = vector(job.dof_armature, job.nv)
    cdof = matrix(job.cdof, job.nv, 6)
    body_momentum = matrix(job.body_momentum, job.nbody, 6)
    body_force = matrix(job.body_force, job.nbody, 6)
    body_Y = matrix(job.body_Y, job.nbody, 6)
    body_inertia = matrix(job.body_inertia, job.nbody, 10)
    dof_P = matrix(job.dof_P, job.nv, 6)
    dof_Q = matrix(job.dof_Q, job.nv, 6)
    dof_R = matrix(job.dof_R, job.nv, 6)
    nv = job.nv
    for i in range(nv):
        b = dof_bodyid[i]
        S, P, R, Q = row6(cdof, i), row6(dof_P, i), row6(dof_R, i), row6(dof_Q, i)
        n, p = row3(body_momentum, b), (body_momentum[b, 3], body_momentum[b, 4], body_momentum[b, 5])
        IS = inertia_times(body_inertia, b, S)
        # S' 2B has an angular part only
        row = add3(add3(symmetric_times(body_Y, b, head(S)), cross3(n, head(S))), scale3(2.0, cross3(p, tail(S))))
        turned = sub3(symmetric_times(body_Y, b, head(P)), cross3(n, head(P)))
        column_q = add6(join(turned, scale3(-2.0, cross3(p, head(P)))), inertia_times(body_inertia, b, R))
        column_q = add6(column_q, cross_force(S, row6(body_force, b)))
        turned = sub3(symmetric_times(body_Y, b, head(S)), cross3(n, head(S)))
        column_v = add6(join(turned, scale3(-2.0, cross3(p, head(S)))), inertia_times(body_inertia, b, Q))
        for j in range(i + 1, dof_groupend[i]):
            F[i, j] -= dot3(row, row3(dof_P, j)) + dot6(IS, row6(dof_R, j))
            F[i, nv + j] -= dot3(row, row3(cdof, j)) + dot6(IS, row6(dof_Q, j))
        j = i
        while j >= 0:
            Sj = row6(cdof, j)
            F[i, j] -= dot3(row, row3(dof_P, j)) + dot6(IS, row6(dof_R, j))
            F[i, nv + j] -= dot3(row, head(Sj)) + dot6(IS, row6(dof_Q, j))
            M[i, j] = M[j, i] = dot6(IS, Sj)
            if dof_group[j] != dof_group[i]:
                F[j, i] -= dot6(Sj, column_q)
                F[j, nv + i] -= dot6(Sj, column_v)
            j = dof_parentid[j]
        M[i, i] += dof_armature[i]


@compiled
def add_field_derivative(job, sign, F):
    """F += sign d(sum_b J_b' I_b a_b)/dq for accelerations that a body's own motion does not change.

    Before the call, `dof_R` holds a x S for the acceleration a before each dof, `body_inertia` and `body_force` the
    sums over subtrees of I_b and I_b a_b. With a = sum S_j x_j this is d(M x)/dq; with a uniform one, the derivative
    of weights.
    """
    dof_bodyid = integers(job.dof_bodyid, job.nv)
    dof_parentid = integers(job.dof_parentid, job.nv)
    dof_group = integers(job.dof_group, job.nv)
    dof_groupend = integers(job.dof_groupend, job.nv)
    cdof = matrix(job.cdof, job.nv, 6)
    body_force = matrix(job.body_force, job.nbody, 6)
    body_inertia = matrix(job.body_inertia, job.nbody, 10)
    dof_R = matrix(job.dof_R, job.nv, 6)
    for i in range(job.nv):
        b = dof_bodyid[i]
        S = row6(cdof, i)
        IS = inertia_times(body_inertia, b, S)
        column = add6(inertia_times(body_inertia, b, row6(dof_R, i)), cross_force(S, row6(body_force, b)))
        for j in range(i + 1, dof_groupend[i]):
            F[i, j] += sign * dot6(IS, row6(dof_R, j))
        j = i
        while j >= 0:
            F[i, j] += sign * dot6(IS, row6(dof_R, j))
            if dof_group[j] != dof_group[i]:
                F[j, i] += sign * dot6(row6(cdof, j), column)
            j = dof_parentid[j]


@compiled
def add_mass_derivative(job, x, sign, F):
    """F += sign d(M x)/dq at fixed x; uses up the forces and R of the dofs, keeps the subtrees' inertias."""
    body_parentid = integers(job.body_parentid, job.nbody)
    body_dofadr = integers(job.body_dofadr, job.nbody)
    body_dofnum = integers(job.body_dofnum, job.nbody)
    dof_groupend = integers(job.dof_groupend, job.nv)
    cdof = matrix(job.cdof, job.nv, 6)
    cinert = matrix(job.cinert, job.nbody, 10)
    body_acc = matrix(job.body_acc, job.nbody, 6)
    body_force = matrix(job.body_force, job.nbody, 6)
    dof_R = matrix(job.dof_R, job.nv, 6)
    put6(body_acc, 0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    for b in range(1, job.nbody):
        a = row6(body_acc, body_parentid[b])
        first, end = body_dofadr[b], body_dofadr[b] + body_dofnum[b]
        while first < end:
            last = dof_groupend[first]
            after = a
            for i in range(first, last):
                put6(dof_R, i, cross_motion(a, row6(cdof, i)))
                after = add6(after, scale6(x[i], row6(cdof, i)))
            a, first = after, last
        put6(body_acc, b, a)
        put6(body_force, b, inertia_times(cinert, b, a))
    _sum_forces(job)
    add_field_derivative(job, sign, F)


@compiled
def add_compensation_derivative(job, F):
    """F += d(gravity compensation)/dq: each body's weight, times its gravcomp, carried where its mass is.

    Uses up the subtrees' inertias and forces, and R of the dofs.
    """
    body_parentid = integers(job.body_parentid, job.nbody)
    gravity = vector(job.gravity, 3)
    body_gravcomp = vector(job.body_gravcomp, job.nbody)
    cdof = matrix(job.cdof, job.nv, 6)
    cinert = matrix(job.cinert, job.nbody, 10)
    body_force = matrix(job.body_force, job.nbody, 6)
    body_inertia = matrix(job.body_inertia, job.nbody, 10)
    dof_R = matrix(job.dof_R, job.nv, 6)
    lift = (0.0, 0.0, 0.0, -gravity[0], -gravity[1], -gravity[2])
    for b in range(job.nbody):
        for k in range(10):
            body_inertia[b, k] = body_gravcomp[b] * cinert[b, k]
        put6(body_force, b, inertia_times(body_inertia, b, lift))
    for b in range(job.nbody - 1, 0, -1):
        parent = body_parentid[b]
        if parent > 0:
            for k in range(10):
                body_inertia[parent, k] += body_inertia[b, k]
    _sum_forces(job)
    for i in range(job.nv):
        put6(dof_R, i, cross_motion(lift, row6(cdof, i)))
    add_field_derivative(job, 1.0, F)


@compiled
def _sum_forces(job):
    body_parentid = integers(job.body_parentid, job.nbody)
    body_force = matrix(job.body_force, job.nbody, 6)
    for b in range(job.nbody - 1, 0, -1):
        parent = body_parentid[b]
        if parent > 0:
            for k in range(6):
                body_force[parent, k] += body_force[b, k]
