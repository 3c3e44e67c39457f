"""Derivatives of a rigid-body tree's inverse dynamics, tau = M(q) a + c(q, v), exact and in one sweep.

Notation (spatial vectors: `_mujoco_inverse_spatial`)
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

import numba

from mjslq.dynamics._mujoco_inverse_spatial import (
    add3,
    add6,
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


@inlined
def _coriolis_matrix(Y, b, I, v):
    """Write Y of body b into its row, as Yxx Yyy Yzz Yxy Yxz Yyz."""
    w0, w1, w2 = head(v)
    l0, l1, l2 = tail(v)
    xx, yy, zz, xy, xz, yz = I[b, 0], I[b, 1], I[b, 2], I[b, 3], I[b, 4], I[b, 5]
    c0, c1, c2 = I[b, 6], I[b, 7], I[b, 8]
    twice = 2.0 * (c0 * l0 + c1 * l1 + c2 * l2)
    Y[b, 0] = 2.0 * (w1 * xz - w2 * xy) - 2.0 * c0 * l0 + twice
    Y[b, 1] = 2.0 * (w2 * xy - w0 * yz) - 2.0 * c1 * l1 + twice
    Y[b, 2] = 2.0 * (w0 * yz - w1 * xz) - 2.0 * c2 * l2 + twice
    Y[b, 3] = (w1 * yz - w2 * yy) + (w2 * xx - w0 * xz) - c0 * l1 - c1 * l0
    Y[b, 4] = (w1 * zz - w2 * yz) + (w0 * xy - w1 * xx) - c0 * l2 - c2 * l0
    Y[b, 5] = (w2 * xz - w0 * zz) + (w0 * yy - w1 * xy) - c1 * l2 - c2 * l1


@inlined
def _symmetric_times(Y, b, a):
    """Y a."""
    return (
        Y[b, 0] * a[0] + Y[b, 3] * a[1] + Y[b, 4] * a[2],
        Y[b, 3] * a[0] + Y[b, 1] * a[1] + Y[b, 5] * a[2],
        Y[b, 4] * a[0] + Y[b, 5] * a[1] + Y[b, 2] * a[2],
    )


@numba.njit(cache=True, error_model="numpy", nogil=True)
def outward(m, cdof, cinert, qvel, qacc, gravity, w):
    """Velocities, accelerations, forces from the roots to the leaves; fills P, Q, R of the dofs, I, h, f, Y of bodies."""
    put6(w.vel, 0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    put6(w.acc, 0, (0.0, 0.0, 0.0, -gravity[0], -gravity[1], -gravity[2]))
    for b in range(1, m.nbody):
        parent = m.body_parentid[b]
        v, a = row6(w.vel, parent), row6(w.acc, parent)
        first, end = m.body_dofadr[b], m.body_dofadr[b] + m.body_dofnum[b]
        while first < end:
            last = m.dof_groupend[first]
            after_v, after_a = v, a
            for i in range(first, last):
                after_v = add6(after_v, scale6(qvel[i], row6(cdof, i)))
            for i in range(first, last):
                S = row6(cdof, i)
                P, own = cross_motion(v, S), cross_motion(after_v, S)
                put6(w.P, i, P)
                put6(w.Q, i, add6(P, own))
                put6(w.R, i, add6(cross_motion(a, S), cross_motion(v, P)))
                # a dof alone in its group adds nothing to its own rate of change: own is P, up to S x S = 0
                after_a = add6(after_a, add6(scale6(qacc[i], S), scale6(qvel[i], own)))
            v, a, first = after_v, after_a, last
        put6(w.vel, b, v)
        put6(w.acc, b, a)
        h = inertia_times(cinert, b, v)
        put6(w.momentum, b, h)
        put6(w.force, b, add6(inertia_times(cinert, b, a), cross_force(v, h)))
        for k in range(10):
            w.inertia[b, k] = cinert[b, k]
        _coriolis_matrix(w.Y, b, cinert, v)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def inward(m, w):
    """Sum inertias, momenta, forces and Y over the subtrees."""
    for b in range(m.nbody - 1, 0, -1):
        parent = m.body_parentid[b]
        if parent > 0:
            for k in range(6):
                w.momentum[parent, k] += w.momentum[b, k]
                w.force[parent, k] += w.force[b, k]
                w.Y[parent, k] += w.Y[b, k]
            for k in range(10):
                w.inertia[parent, k] += w.inertia[b, k]


@numba.njit(cache=True, error_model="numpy", nogil=True)
def subtract_derivatives(m, cdof, w, Rq, Rv, M):
    """Rq -= dtau/dq, Rv -= dtau/dv; M is written, in the entries of dofs on one branch (armature included)."""
    for i in range(m.nv):
        b = m.dof_bodyid[i]
        S, P, R, Q = row6(cdof, i), row6(w.P, i), row6(w.R, i), row6(w.Q, i)
        n, p = row3(w.momentum, b), (w.momentum[b, 3], w.momentum[b, 4], w.momentum[b, 5])
        IS = inertia_times(w.inertia, b, S)
        # S' 2B has an angular part only
        row = add3(add3(_symmetric_times(w.Y, b, head(S)), cross3(n, head(S))), scale3(2.0, cross3(p, tail(S))))
        turned = sub3(_symmetric_times(w.Y, b, head(P)), cross3(n, head(P)))
        column_q = add6(join(turned, scale3(-2.0, cross3(p, head(P)))), inertia_times(w.inertia, b, R))
        column_q = add6(column_q, cross_force(S, row6(w.force, b)))
        turned = sub3(_symmetric_times(w.Y, b, head(S)), cross3(n, head(S)))
        column_v = add6(join(turned, scale3(-2.0, cross3(p, head(S)))), inertia_times(w.inertia, b, Q))
        for j in range(i + 1, m.dof_groupend[i]):
            Rq[i, j] -= dot3(row, row3(w.P, j)) + dot6(IS, row6(w.R, j))
            Rv[i, j] -= dot3(row, row3(cdof, j)) + dot6(IS, row6(w.Q, j))
        j = i
        while j >= 0:
            Sj = row6(cdof, j)
            Rq[i, j] -= dot3(row, row3(w.P, j)) + dot6(IS, row6(w.R, j))
            Rv[i, j] -= dot3(row, head(Sj)) + dot6(IS, row6(w.Q, j))
            M[i, j] = M[j, i] = dot6(IS, Sj)
            if m.dof_group[j] != m.dof_group[i]:
                Rq[j, i] -= dot6(Sj, column_q)
                Rv[j, i] -= dot6(Sj, column_v)
            j = m.dof_parentid[j]
        M[i, i] += m.dof_armature[i]


@numba.njit(cache=True, error_model="numpy", nogil=True)
def add_field_derivative(m, cdof, sign, w, Rq):
    """Rq += sign d(sum_b J_b' I_b a_b)/dq for accelerations that a body's own motion does not change.

    Before the call, `w.R` holds a x S for the acceleration a before each dof, `w.inertia` and `w.force` the sums over
    subtrees of I_b and I_b a_b. With a = sum S_j x_j this is d(M x)/dq; with a uniform one, a weight's derivative.
    """
    for i in range(m.nv):
        b = m.dof_bodyid[i]
        S = row6(cdof, i)
        IS = inertia_times(w.inertia, b, S)
        column = add6(inertia_times(w.inertia, b, row6(w.R, i)), cross_force(S, row6(w.force, b)))
        for j in range(i + 1, m.dof_groupend[i]):
            Rq[i, j] += sign * dot6(IS, row6(w.R, j))
        j = i
        while j >= 0:
            Rq[i, j] += sign * dot6(IS, row6(w.R, j))
            if m.dof_group[j] != m.dof_group[i]:
                Rq[j, i] += sign * dot6(row6(cdof, j), column)
            j = m.dof_parentid[j]


@numba.njit(cache=True, error_model="numpy", nogil=True)
def add_mass_derivative(m, cdof, cinert, x, sign, w, Rq):
    """Rq += sign d(M x)/dq at fixed x; uses up the forces and R of the dofs, keeps the subtrees' inertias."""
    put6(w.acc, 0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    for b in range(1, m.nbody):
        a = row6(w.acc, m.body_parentid[b])
        first, end = m.body_dofadr[b], m.body_dofadr[b] + m.body_dofnum[b]
        while first < end:
            last = m.dof_groupend[first]
            after = a
            for i in range(first, last):
                put6(w.R, i, cross_motion(a, row6(cdof, i)))
                after = add6(after, scale6(x[i], row6(cdof, i)))
            a, first = after, last
        put6(w.acc, b, a)
        put6(w.force, b, inertia_times(cinert, b, a))
    _sum_forces(m, w)
    add_field_derivative(m, cdof, sign, w, Rq)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def add_compensation_derivative(m, cdof, cinert, gravity, w, Rq):
    """Rq += d(gravity compensation)/dq: each body's weight, times its gravcomp, carried where its mass is.

    Uses up the subtrees' inertias and forces, and R of the dofs.
    """
    lift = (0.0, 0.0, 0.0, -gravity[0], -gravity[1], -gravity[2])
    for b in range(m.nbody):
        for k in range(10):
            w.inertia[b, k] = m.body_gravcomp[b] * cinert[b, k]
        put6(w.force, b, inertia_times(w.inertia, b, lift))
    for b in range(m.nbody - 1, 0, -1):
        parent = m.body_parentid[b]
        if parent > 0:
            for k in range(10):
                w.inertia[parent, k] += w.inertia[b, k]
    _sum_forces(m, w)
    for i in range(m.nv):
        put6(w.R, i, cross_motion(lift, row6(cdof, i)))
    add_field_derivative(m, cdof, 1.0, w, Rq)


@inlined
def _sum_forces(m, w):
    for b in range(m.nbody - 1, 0, -1):
        parent = m.body_parentid[b]
        if parent > 0:
            for k in range(6):
                w.force[parent, k] += w.force[b, k]

