"""Second derivatives of w' tau for a rigid-body tree's inverse dynamics tau = M(q) a + c(q, v), w fixed: exact.

Notation (that of `inverse.rigid`: S, v, a, group, P, Q, R, I, h, f, 2 B, Y)
--------
    W             velocity that a body would have if the dofs moved with w: W = sum S_j w_j
    W_i           W x S_i, with the W before dof i's group: how the W of all bodies beyond changes with q_i
    y             (2 B)' W = (Y w + n x w + 2 p x l, 0) for W = (w, l), h = (n, p)
    N             the symmetric form of W . (v x* I u + u x* I v); N s = - J s, with J the rate of change that a motion
                  W would give the inertia I: the ten numbers (Y of W, I W's linear part, 0)
    I^C, f^C, ... sums over the subtree of the dof's body

With motions seen from the moving bodies, where inertias are constant,

    w' tau = sum over bodies of W . (I a + v x* I v).

Moving dof i changes W by W_i, v by P_i and a by R_i + P_i x v on all bodies beyond it; moving a dof j beyond i as well
changes these changes to W_i x S_j, P_i x S_j and R_i x S_j + P_i x P_j + (P_i x S_j) x v. Collected for a dof j by

    A_j = S_j x* f + I R_j + 2 B P_j             B_j = I W_j + S_j x* I W
    C_j = (2 B)' W_j + P_j x* I W + S_j x* y + N P_j
    D_j = S_j x* I W + N S_j                     E_j = I Q_j + 2 B S_j

(sums over the subtree of j) the second derivatives are, for i an ancestor of j,

    q_i q_j    W_i . A_j + R_i . B_j + P_i . C_j           v_i v_j    S_i . D_j
    q_i v_j    W_i . E_j + P_i . D_j                       q_j v_i    Q_i . B_j + S_i . C_j
    q_i a_j    W_i . I S_j                                 q_j a_i    S_i . B_j

and 0 by a, a and by v, a. Within a group q_i q_j and v_i v_j are the mean of both orders, which is what a second
difference along mj_integratePos gives; q_i v_j and q_i a_j are the formulas on the left.

The first derivatives are W_i . f + R_i . I W + P_i . y by q_i, S_i . y + Q_i . I W by v_i, S_i . I W by a_i. Tensors of
this kind, not contracted, are in Singh, Russell and Wensing 2023, "On second-order derivatives of rigid-body dynamics".
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.rigid import coriolis_matrix, symmetric_times
from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    add6,
    compiled,
    cross3,
    cross_force,
    cross_motion,
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
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix


@compiled
def outward_test(job, w):
    """After `rigid.outward`: W_i of the dofs; W, I W, y, Y of W of the bodies, with the inertias in body_inertia."""
    body_parentid = integers(job.body_parentid, job.nbody)
    body_dofadr, body_dofnum = integers(job.body_dofadr, job.nbody), integers(job.body_dofnum, job.nbody)
    dof_groupend = integers(job.dof_groupend, job.nv)
    cdof, dof_W = matrix(job.cdof, job.nv, 6), matrix(job.dof_W, job.nv, 6)
    inertia, Y = matrix(job.body_inertia, job.nbody, 10), matrix(job.body_Y, job.nbody, 6)
    body_W, body_IW = matrix(job.body_W, job.nbody, 6), matrix(job.body_IW, job.nbody, 6)
    body_y, body_YW = matrix(job.body_y, job.nbody, 3), matrix(job.body_YW, job.nbody, 6)
    momentum = matrix(job.body_momentum, job.nbody, 6)
    put6(body_W, 0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    for b in range(1, job.nbody):
        W = row6(body_W, body_parentid[b])
        first, end = body_dofadr[b], body_dofadr[b] + body_dofnum[b]
        while first < end:
            last, after = dof_groupend[first], W
            for i in range(first, last):
                S = row6(cdof, i)
                put6(dof_W, i, cross_motion(W, S))
                after = add6(after, scale6(w[i], S))
            W, first = after, last
        put6(body_W, b, W)
        put6(body_IW, b, inertia_times(inertia, b, W))
        coriolis_matrix(body_YW, b, inertia, W)
        y = coriolis_transposed(Y, momentum, b, W)
        body_y[b, 0], body_y[b, 1], body_y[b, 2] = y


@inlined
def coriolis_transposed(Y, momentum, b, W):
    """(2 B)' W; its linear part is zero."""
    n, p = row3(momentum, b), (momentum[b, 3], momentum[b, 4], momentum[b, 5])
    return add3(add3(symmetric_times(Y, b, head(W)), cross3(n, head(W))), scale3(2.0, cross3(p, tail(W))))


@inlined
def coriolis_times(Y, momentum, b, s):
    """2 B s."""
    n, p = row3(momentum, b), (momentum[b, 3], momentum[b, 4], momentum[b, 5])
    return join(sub3(symmetric_times(Y, b, head(s)), cross3(n, head(s))), scale3(-2.0, cross3(p, head(s))))


@inlined
def test_form_times(YW, IW, b, s):
    """N s."""
    p = (IW[b, 3], IW[b, 4], IW[b, 5])
    return join(scale3(-1.0, add3(symmetric_times(YW, b, head(s)), cross3(p, tail(s)))), cross3(p, head(s)))


@compiled
def inward_test(job):
    """Sum I W, y and Y of W over the subtrees."""
    body_parentid = integers(job.body_parentid, job.nbody)
    body_IW, body_YW = matrix(job.body_IW, job.nbody, 6), matrix(job.body_YW, job.nbody, 6)
    body_y = matrix(job.body_y, job.nbody, 3)
    for b in range(job.nbody - 1, 0, -1):
        parent = body_parentid[b]
        if parent > 0:
            for k in range(6):
                body_IW[parent, k] += body_IW[b, k]
                body_YW[parent, k] += body_YW[b, k]
            for k in range(3):
                body_y[parent, k] += body_y[b, k]


@compiled
def add_second_derivatives(job, sign, sign_v, Z, sign_c, Xc, sign_d, Xd):
    """Z += the second derivatives by (q, v), X += those by a (rows) and q (columns), after all sweeps.

    Each times a sign: sign those by q, v; sign_v those by v, v; sign_c and sign_d those of Xc and Xd.
    """
    dof_bodyid, dof_parentid = integers(job.dof_bodyid, job.nv), integers(job.dof_parentid, job.nv)
    dof_group, dof_groupend = integers(job.dof_group, job.nv), integers(job.dof_groupend, job.nv)
    cdof, dof_W = matrix(job.cdof, job.nv, 6), matrix(job.dof_W, job.nv, 6)
    dof_P, dof_Q, dof_R = matrix(job.dof_P, job.nv, 6), matrix(job.dof_Q, job.nv, 6), matrix(job.dof_R, job.nv, 6)
    body_momentum, body_force = matrix(job.body_momentum, job.nbody, 6), matrix(job.body_force, job.nbody, 6)
    body_Y, body_inertia = matrix(job.body_Y, job.nbody, 6), matrix(job.body_inertia, job.nbody, 10)
    body_IW, body_YW = matrix(job.body_IW, job.nbody, 6), matrix(job.body_YW, job.nbody, 6)
    body_y = matrix(job.body_y, job.nbody, 3)
    nv = job.nv
    for j in range(nv):
        b = dof_bodyid[j]
        S, P, W = row6(cdof, j), row6(dof_P, j), row6(dof_W, j)
        IW = row6(body_IW, b)
        SxIW = cross_force(S, IW)
        by_W = add6(inertia_times(body_inertia, b, row6(dof_R, j)), coriolis_times(body_Y, body_momentum, b, P))
        by_W = add6(by_W, cross_force(S, row6(body_force, b)))
        by_R = add6(inertia_times(body_inertia, b, W), SxIW)
        by_P = add6(cross_force(P, IW), test_form_times(body_YW, body_IW, b, P))
        rest = add3(coriolis_transposed(body_Y, body_momentum, b, W), cross3(head(S), row3(body_y, b)))
        by_P = add6(by_P, join(rest, (0.0, 0.0, 0.0)))
        by_S = add6(SxIW, test_form_times(body_YW, body_IW, b, S))
        column_v = add6(inertia_times(body_inertia, b, row6(dof_Q, j)), coriolis_times(body_Y, body_momentum, b, S))
        IS = inertia_times(body_inertia, b, S)
        i = dof_groupend[j] - 1
        while i >= 0:
            Si, Pi, Wi = row6(cdof, i), row6(dof_P, i), row6(dof_W, i)
            within = dof_group[i] == dof_group[j]
            share = 0.5 * sign if within else sign
            qq = share * (dot6(Wi, by_W) + dot6(row6(dof_R, i), by_R) + dot6(Pi, by_P))
            vv = (0.5 * sign_v if within else sign_v) * dot6(Si, by_S)
            qv = sign * (dot6(Wi, column_v) + dot6(Pi, by_S))
            qa = dot6(Wi, IS)
            Z[i, j] += qq
            Z[j, i] += qq
            Z[nv + i, nv + j] += vv
            Z[nv + j, nv + i] += vv
            Z[i, nv + j] += qv
            Z[nv + j, i] += qv
            Xc[j, i] += sign_c * qa
            Xd[j, i] += sign_d * qa
            if not within:
                qv = sign * (dot6(row6(dof_Q, i), by_R) + dot6(Si, by_P))
                qa = dot6(Si, by_R)
                Z[j, nv + i] += qv
                Z[nv + i, j] += qv
                Xc[i, j] += sign_c * qa
                Xd[i, j] += sign_d * qa
            i = dof_parentid[i]
