"""Derivatives of the forces of the equality constraints connect and weld, in closed form.

Notation
--------
    body 2, body 1       the first and the second object of the constraint (a body, or a site in one)
    x_k, q_k             anchor and orientation of object k, in the world; primes: seen from q_1
    p = (w, u)           q_1* q_2, the quaternion between the two; W = R_1' (w_2 - w_1) its rate of turning
    e                    the residual: x_2 - x_1, and of welds t u besides, with t the torquescale
    V, A                 velocity and acceleration of a body, at the acceleration that the rows see (`rigid`)

MuJoCo's rows have J v = de/dt, and as their aref contains - dJ/dt v,

    jar = e'' + b e' + k imp(|e|) e,       s = -D jar,       D proportional to imp / (1 - imp).

With S_i a dof that moves a body, and P_i, Q_i, R_i as in `rigid`, the body's velocity and acceleration change by

    dV = P_i - V x S_i,     dA = R_i - A x S_i - V x P_i with position,       S_i and Q_i - V x S_i with velocity,

from which follow those of e, e', e'': of the anchors as of any point, and of u by

    du = (w T + T x u) / 2,   dw = - T . u / 2      for a turning T of 2 against 1, seen from q_1,

applied once for u' (T = W) and once more for u''. The wrench on body 2 is the force of the first three rows and the
couple t R_1 (w s + u x s) / 2 of the others; `wrenches` has the rest.
"""

from __future__ import annotations

import math

from mjslq.dynamics.mujoco.inverse.rows.wrenches import add_force_change, from_center, mark_members
from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    compiled,
    cross3,
    cross_motion,
    dot3,
    head,
    inlined,
    join,
    quaternion_product,
    row3,
    row6,
    scale3,
    sub3,
    sub6,
    tail,
    turned,
    velocity_at,
)
from mjslq.dynamics.mujoco.inverse.table.columns import TIE_NUMBERS, WELD
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, integers, matrix, vector


@compiled
def add_tie(job, r, index, F):
    """F += d(J' s)/dq and d(J' s)/dv of the connect or weld constraint `index`, whose rows start at r.

    The outward sweep of `rigid` has been made at the acceleration that the rows see.
    """
    of_body = integers(job.eq_body, 2 * job.neq)
    bodies = (of_body[2 * index + 1], of_body[2 * index])
    prm = matrix(job.tie_prm, job.neq, TIE_NUMBERS)[index]
    x_1, q_1 = _place(job, bodies[0], prm, 7)
    x_2, q_2 = _place(job, bodies[1], prm, 0)
    points = (from_center(job, bodies[0], x_1), from_center(job, bodies[1], x_2))
    p = quaternion_product((q_1[0], -q_1[1], -q_1[2], -q_1[3]), q_2)
    scale = prm[14] if integers(job.eq_kind, job.neq)[index] == WELD else 0.0
    e = join(sub3(x_2, x_1), scale3(scale, (p[1], p[2], p[3])))
    mark_members(job, bodies)
    parent, member = integers(job.dof_parentid, job.nv), integers(job.member, job.nv)
    lastdof = integers(job.body_lastdof, job.nbody)
    for side in range(2):
        i = lastdof[bodies[side]]
        while i >= 0:
            # a dof that moves both bodies comes up twice: it is dealt with on the second side
            if side == 1 or member[i] == 1:
                _add_dof(job, r, i, member[i], bodies, points, q_1, p, e, scale, F)
            i = parent[i]


@compiled
def _add_dof(job, r, i, sides, bodies, points, q_1, p, e, scale, F):
    """Columns of the position and of the velocity of dof i."""
    first, second = _motion(job, i, bodies[0], points[0], sides & 1), _motion(job, i, bodies[1], points[1], sides & 2)
    u = (p[1], p[2], p[3])
    du, dw, by_pos, by_vel = _turning(job, bodies, first, second, q_1, p)
    de = join(sub3(second[1], first[1]), scale3(scale, du))
    de_v = join(sub3(second[3], first[3]), scale3(scale, by_pos[0]))
    de_a = join(sub3(second[5], first[5]), scale3(scale, by_pos[1]))
    ev_a = join(sub3(second[7], first[7]), scale3(scale, by_vel))
    s, ds, ds_v = _row_changes(job, r, scale != 0.0, e, de, de_v, de_a, ev_a)
    half = 0.5 * scale
    couple = scale3(half, turned(q_1, add3(scale3(p[0], tail(s)), cross3(u, tail(s)))))
    moved = add3(scale3(dw, tail(s)), cross3(du, tail(s)))
    pushed = add3(scale3(p[0], tail(ds)), cross3(u, tail(ds)))
    dcouple = add3(scale3(half, turned(q_1, add3(moved, pushed))), cross3(first[0], couple))
    W = join(couple, head(s))
    change = join(dcouple, head(ds))
    add_force_change(job, i, i, sides, bodies, points, W, change, (first[1], second[1]), F)
    pushed = add3(scale3(p[0], tail(ds_v)), cross3(u, tail(ds_v)))
    change = join(scale3(half, turned(q_1, pushed)), head(ds_v))
    still = (0.0, 0.0, 0.0)
    add_force_change(job, job.nv + i, i, 0, bodies, points, W, change, (still, still), F)


@compiled
def _row_changes(job, r, with_rotation, e, de, de_v, de_a, ev_a):
    """Forces s of the rows, their change with position and with velocity, as six numbers each."""
    size = 6 if with_rotation else 3
    KBIP = matrix(entry_address(job.data + job.at_efc_KBIP), r + size, 4)
    D, force = (
        vector(entry_address(job.data + job.at_efc_D), r + size),
        vector(entry_address(job.data + job.at_efc_force), r + size),
    )
    small = matrix(job.directions, 3, 6)
    k, b, imp, slope = KBIP[r, 0], KBIP[r, 1], KBIP[r, 2], KBIP[r, 3]
    length = math.sqrt(dot3(head(e), head(e)) + dot3(tail(e), tail(e)))
    by_length = (dot3(head(e), head(de)) + dot3(tail(e), tail(de))) / length if length > 0.0 else 0.0
    grows = slope / (imp * (1.0 - imp)) * by_length
    for n in range(6):
        small[0, n], small[1, n], small[2, n] = 0.0, 0.0, 0.0
    for n in range(size):
        djar = de_a[n] + b * de_v[n] + k * (imp * de[n] + slope * by_length * e[n])
        small[0, n] = force[r + n]
        small[1, n] = grows * force[r + n] - D[r + n] * djar
        small[2, n] = -D[r + n] * (ev_a[n] + b * de[n])
    return row6(small, 0), row6(small, 1), row6(small, 2)


@compiled
def _motion(job, i, body, x, moves):
    """What dof i does at the point x of a body, if it moves it.

    Turning, motion; change with position of angular velocity, velocity, angular acceleration, acceleration; and with
    velocity of the last two.
    """
    zero = (0.0, 0.0, 0.0)
    if moves == 0:
        return zero, zero, zero, zero, zero, zero, zero, zero
    S, P = row6(matrix(job.cdof, job.nv, 6), i), row6(matrix(job.dof_P, job.nv, 6), i)
    Q, R = row6(matrix(job.dof_Q, job.nv, 6), i), row6(matrix(job.dof_R, job.nv, 6), i)
    V, A = row6(matrix(job.body_vel, job.nbody, 6), body), row6(matrix(job.body_acc, job.nbody, 6), body)
    dV = sub6(P, cross_motion(V, S))
    dA = sub6(sub6(R, cross_motion(A, S)), cross_motion(V, P))
    dA_v = sub6(Q, cross_motion(V, S))
    motion, velocity = velocity_at(S, x), velocity_at(V, x)
    dv = add3(velocity_at(dV, x), cross3(head(V), motion))
    da = add3(add3(velocity_at(dA, x), cross3(head(A), motion)), add3(cross3(head(dV), velocity), cross3(head(V), dv)))
    da_v = add3(velocity_at(dA_v, x), add3(cross3(head(S), velocity), cross3(head(V), motion)))
    return head(S), motion, head(dV), dv, head(dA), da, head(dA_v), da_v


@compiled
def _turning(job, bodies, first, second, q_1, p):
    """Changes of (w, u) with dof i: du, dw, those of (u', u'') with position, that of u'' with velocity."""
    body_vel, body_acc = matrix(job.body_vel, job.nbody, 6), matrix(job.body_acc, job.nbody, 6)
    w_1 = row3(body_vel, bodies[0])
    apart = sub3(row3(body_vel, bodies[1]), w_1)
    rate = sub3(sub3(row3(body_acc, bodies[1]), row3(body_acc, bodies[0])), cross3(w_1, apart))
    back = (q_1[0], -q_1[1], -q_1[2], -q_1[3])
    # T, W, W' and their changes, all seen from q_1
    T, W, dW_dt = turned(back, sub3(second[0], first[0])), turned(back, apart), turned(back, rate)
    d_apart = sub3(second[2], first[2])
    dW = turned(back, sub3(d_apart, cross3(first[0], apart)))
    d_rate = sub3(sub3(sub3(second[4], first[4]), cross3(first[2], apart)), cross3(w_1, d_apart))
    dW_dt_q = turned(back, sub3(d_rate, cross3(first[0], rate)))
    v_rate = sub3(sub3(second[6], first[6]), add3(cross3(first[0], apart), cross3(w_1, sub3(second[0], first[0]))))
    dW_dt_v = turned(back, v_rate)
    w, u = p[0], (p[1], p[2], p[3])
    u_dot, w_dot = _rolled(w, u, W)
    du, dw = _rolled(w, u, T)
    # u' = roll(w, u; W) and u'' = roll(w', u'; W) + roll(w, u; W') are linear in each of (w, u) and W
    a, a_w = _rolled(dw, du, W)
    b, b_w = _rolled(w, u, dW)
    du_dot, dw_dot = add3(a, b), a_w + b_w
    c, _ = _rolled(dw_dot, du_dot, W)
    d, _ = _rolled(w_dot, u_dot, dW)
    f, _ = _rolled(dw, du, dW_dt)
    g, _ = _rolled(w, u, dW_dt_q)
    by_pos = (du_dot, add3(add3(c, d), add3(f, g)))
    # with velocity: dW = T, so (dw', du') = (dw, du)
    d, _ = _rolled(w_dot, u_dot, T)
    g, _ = _rolled(w, u, dW_dt_v)
    return du, dw, by_pos, add3(add3(a, d), g)


@inlined
def _rolled(w, u, T):
    """Rates of u and w of a quaternion that turns by T, seen from its start."""
    return scale3(0.5, add3(scale3(w, T), cross3(T, u))), -0.5 * dot3(T, u)


@compiled
def _place(job, body, prm, at):
    """Where an object is: its anchor and its orientation, of its place in the body (at prm[at])."""
    xpos, xquat = matrix(job.xpos, job.nbody, 3), matrix(job.xquat, job.nbody, 4)
    q = (xquat[body, 0], xquat[body, 1], xquat[body, 2], xquat[body, 3])
    place = turned(q, (prm[at], prm[at + 1], prm[at + 2]))
    own = (prm[at + 3], prm[at + 4], prm[at + 5], prm[at + 6])
    return add3(row3(xpos, body), place), quaternion_product(q, own)
