"""Gradient of the contacts' part of - w' J' s by position, velocity and acceleration: one sweep for all contacts.

Notation (`rows.contacts`, `rows.geometry`: p, E, W, H, b, dp, ddist, phi; `rows`: w, y = J w, jar)
--------
    V(x)          velocity of a body if the dofs moved with x, x = w, a, v;  V_i(x) the same before dof i's group
    U(x)          V(x) of body 2 less that of body 1, at the contact's point:  J x = E . U(x)

The rows know of a dof i only by what it does to U(w), U(a), U(v), to the distance, and to point and frame. With

    K_a = - sum_r (H y)_r E_r,    K_v = - sum_r b_r (H y)_r E_r,    e = sum_r (imp' / (imp (1 - imp)) y_r s_r
                                                                           - (H y)_r k (imp' (pos - margin) + imp))
    d(w' J' s)_i = W . dU(w) + K_a . dU(a) + K_v . dU(v) + e ddist_i.

Seen from geom 1, a dof that moves body 2 alone does dU(x) = S_i x (V(x) - V_i(x)) at p, V of body 2, and what dp and
phi do to U; one that moves body 1 alone the opposite of it, with the same V; one that moves both does nothing. So every
contact loads its bodies, 2 with one sign and 1 with the other, with four covectors: W, K_a, K_v and the sum c of all
that depends on S_i alone. Summed over subtrees, each dof's share is

    by q    - S_i . (c - V_i(w) x* W - V_i(a) x* K_a - V_i(v) x* K_v),     by v    - S_i . K_v,     by a    - S_i . K_a.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.rows.constraints import CONE, ELLIPTIC, QUADRATIC
from mjslq.dynamics.mujoco.inverse.rows.contacts import contact_wrench, pushes, row_directions
from mjslq.dynamics.mujoco.inverse.rows.geometry import contact_motion
from mjslq.dynamics.mujoco.inverse.rows.wrenches import from_center
from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    add6,
    compiled,
    cross3,
    cross_force,
    dot3,
    dot6,
    head,
    inlined,
    join,
    put6,
    row6,
    scale6,
    sub3,
    sub6,
    tail,
    velocity_at,
)
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, flags, integers, matrix, vector


@compiled
def start_loads(job, acc, w):
    """Clear the loads; write V(w), V(a), V(v) of the bodies, and V_i of the dofs."""
    parent, group_end = integers(job.body_parentid, job.nbody), integers(job.dof_groupend, job.nv)
    first_dof, number = integers(job.body_dofadr, job.nbody), integers(job.body_dofnum, job.nbody)
    cdof, V, loads = matrix(job.cdof, job.nv, 6), matrix(job.body_V, job.nbody, 18), matrix(job.loads, job.nbody, 24)
    qvel = vector(job.qvel, job.nv)
    before_w, before_a = matrix(job.before_w, job.nv, 6), matrix(job.before_a, job.nv, 6)
    before_v, zero = matrix(job.before_v, job.nv, 6), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for b in range(job.nbody):
        for k in range(24):
            loads[b, k] = 0.0
        own = parent[b]
        V_w, V_a, V_v = row6(V, own), row6(V[:, 6:], own), row6(V[:, 12:], own)
        if b == 0:
            V_w, V_a, V_v = zero, zero, zero
        i, end = first_dof[b], first_dof[b] + number[b]
        while i < end:
            start_w, start_a, start_v, last = V_w, V_a, V_v, group_end[i]
            while i < last:
                S = row6(cdof, i)
                put6(before_w, i, start_w)
                put6(before_a, i, start_a)
                put6(before_v, i, start_v)
                V_w, V_a = add6(V_w, scale6(w[i], S)), add6(V_a, scale6(acc[i], S))
                V_v = add6(V_v, scale6(qvel[i], S))
                i += 1
        put6(V, b, V_w)
        put6(V[:, 6:], b, V_a)
        put6(V[:, 12:], b, V_v)


@compiled
def add_load(job, r, count, kind, contact):
    """Load the two bodies of the contact at address `contact`, whose rows are r ... r + count - 1."""
    if not pushes(job, r, count):
        return
    geoms, body = flags(contact + job.at_contact_geom, 2), integers(job.geom_bodyid, job.ngeom)
    first, second = body[geoms[0]], body[geoms[1]]
    V, loads, point = matrix(job.body_V, job.nbody, 18), matrix(job.loads, job.nbody, 24), contact + job.at_contact_pos
    p = (vector(point, 3)[0], vector(point, 3)[1], vector(point, 3)[2])
    x_1, x_2 = from_center(job, first, p), from_center(job, second, p)
    size = row_directions(job, contact, kind, count)
    W = contact_wrench(job, r, size)
    U_w = _apart(V[:, :6], first, second, x_1, x_2)
    U_a = _apart(V[:, 6:12], first, second, x_1, x_2)
    U_v = _apart(V[:, 12:], first, second, x_1, x_2)
    K_a, K_v, e = _covectors(job, r, size, kind, contact, U_w)
    c = matrix(job.small, 1, 6)
    for k in range(6):
        way = (1.0 if k % 3 == 0 else 0.0, 1.0 if k % 3 == 1 else 0.0, 1.0 if k % 3 == 2 else 0.0)
        none = (0.0, 0.0, 0.0)
        # a turning about p, or a motion of p
        S = join(way, cross3(x_2, way)) if k < 3 else join(none, way)
        dp, ddist, phi = contact_motion(job, contact, S, np.int64(2))
        moved = _work(W, U_w, dp, phi) + _work(K_a, U_a, dp, phi) + _work(K_v, U_v, dp, phi)
        c[0, k] = moved + e * ddist
    whole = row6(c, 0)
    for side in range(2):
        b, x, sign = second if side else first, x_2 if side else x_1, 1.0 if side else -1.0
        W_b, K_ab, K_vb, c_b = _about(W, x), _about(K_a, x), _about(K_v, x), _about(whole, x)
        shift = sub3(x_2, x)  # V of body 2, about the centre of the other body's tree
        c_b = add6(c_b, cross_force(_seen(row6(V, second), shift), W_b))
        c_b = add6(c_b, cross_force(_seen(row6(V[:, 6:], second), shift), K_ab))
        c_b = add6(c_b, cross_force(_seen(row6(V[:, 12:], second), shift), K_vb))
        for k in range(6):
            loads[b, k] += sign * W_b[k]
            loads[b, 6 + k] += sign * K_ab[k]
            loads[b, 12 + k] += sign * K_vb[k]
            loads[b, 18 + k] += sign * c_b[k]


@inlined
def _apart(V, first, second, x_1, x_2):
    """Angular velocity and velocity at the contact's point, of body 2 less those of body 1."""
    V_1, V_2 = row6(V, first), row6(V, second)
    return join(sub3(head(V_2), head(V_1)), sub3(velocity_at(V_2, x_2), velocity_at(V_1, x_1)))


@inlined
def _about(f, x):
    """Take a force (couple, force) at x about the tree's centre of mass."""
    return join(add3(head(f), cross3(x, tail(f))), tail(f))


@inlined
def _seen(V, shift):
    """Take a motion about another origin; `shift` leads from there to the old one, seen backwards."""
    return join(head(V), velocity_at(V, shift))


@inlined
def _work(f, U, dp, phi):
    """Work of a covector on what a motion of the point and a turning of the frame do to U."""
    turn, slip = head(U), tail(U)
    return dot3(head(f), cross3(turn, phi)) + dot3(tail(f), add3(cross3(turn, dp), cross3(slip, phi)))


@compiled
def _covectors(job, r, size, kind, contact, U):
    """K_a, K_v and e."""
    E, KBIP = matrix(job.directions, 10, 6), matrix(entry_address(job.data + job.at_efc_KBIP), r + size, 4)
    D = vector(entry_address(job.data + job.at_efc_D), r + size)
    s = vector(entry_address(job.data + job.at_efc_force), r + size)
    pos = vector(entry_address(job.data + job.at_efc_pos), r + size)
    margin = vector(entry_address(job.data + job.at_efc_margin), r + size)
    states = flags(entry_address(job.data + job.at_efc_state), r + size)
    sliding = kind == ELLIPTIC and states[r] == CONE
    H, y = matrix(contact + job.at_contact_H, size, size), vector(job.djar, 10)
    for k in range(size):
        y[k] = dot6(row6(E, k), U)
    K_a, K_v, e = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0
    imp, slope = KBIP[r, 2], KBIP[r, 3]
    for k in range(size):
        pull = 0.0
        if sliding:
            for c in range(size):
                pull += H[k, c] * y[c]
        elif states[r + k] == QUADRATIC:
            pull = D[r + k] * y[k]
        else:
            continue
        K_a = sub6(K_a, scale6(pull, row6(E, k)))
        K_v = sub6(K_v, scale6(pull * KBIP[r + k, 1], row6(E, k)))
        e += slope / (imp * (1.0 - imp)) * y[k] * s[r + k]
        e -= pull * KBIP[r + k, 0] * (slope * (pos[r + k] - margin[r + k]) + imp)
    return K_a, K_v, e


@compiled
def add_slopes(job, slope):
    """Add the loads' shares to the gradient by q, v, a in the rows of `slope`; uses the loads up."""
    parent, body = integers(job.body_parentid, job.nbody), integers(job.dof_bodyid, job.nv)
    cdof, loads = matrix(job.cdof, job.nv, 6), matrix(job.loads, job.nbody, 24)
    before_w, before_a = matrix(job.before_w, job.nv, 6), matrix(job.before_a, job.nv, 6)
    before_v = matrix(job.before_v, job.nv, 6)
    for b in range(job.nbody - 1, 0, -1):
        if parent[b] > 0:
            for k in range(24):
                loads[parent[b], k] += loads[b, k]
    for i in range(job.nv):
        S, load = row6(cdof, i), loads[body[i] : body[i] + 1]
        W, K_a, K_v = row6(load, 0), row6(load[:, 6:], 0), row6(load[:, 12:], 0)
        c = sub6(row6(load[:, 18:], 0), cross_force(row6(before_w, i), W))
        c = sub6(sub6(c, cross_force(row6(before_a, i), K_a)), cross_force(row6(before_v, i), K_v))
        slope[0, i] -= dot6(S, c)
        slope[1, i] -= dot6(S, K_v)
        slope[2, i] -= dot6(S, K_a)
