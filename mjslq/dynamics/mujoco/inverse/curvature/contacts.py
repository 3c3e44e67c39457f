"""Gradient of a contact's part of - w' J' s by position, w and the accelerations held.

What dof i does to the generalized forces of a contact is a change of its wrench W on body 2 and, of the dofs beyond i,
a turning of it (`rows.contacts`, `rows.wrenches`). Summed up with w over all dofs, only the velocities V that the two
bodies would have if the dofs moved with w are left: with V_i the same before i's group,

    w' dF_i = V . dW - (V - V_i) . (S_i x* W)        for body 2; for body 1 with the other sign.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.rows.contacts import (
    body_velocities,
    contact_points,
    contact_wrench,
    force_change,
    pushes,
    relative_rate,
    row_directions,
)
from mjslq.dynamics.mujoco.inverse.rows.geometry import contact_motion
from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    add6,
    compiled,
    cross3,
    cross_force,
    dot6,
    head,
    inlined,
    join,
    row6,
    sub6,
    tail,
)
from mjslq.dynamics.mujoco.inverse.table.job import flags, integers, matrix, vector


@compiled
def add_contact_slope(job, r, count, kind, contact, acc, w, slope):
    """Slope += the gradient by position of the contact at address `contact`, whose rows are r ... r + count - 1.

    Called for every row of pyramids: only the call for the first row does anything.
    """
    if flags(contact + job.at_contact_efc_address, 1)[0] != r or not pushes(job, r, count):
        return
    geoms, body = flags(contact + job.at_contact_geom, 2), integers(job.geom_bodyid, job.ngeom)
    first, second = body[geoms[0]], body[geoms[1]]
    size = row_directions(job, contact, kind, count)
    W = contact_wrench(job, r, size)
    V_a = body_velocities(job, first, second, acc, matrix(job.before_a, job.nv, 6))
    V_v = body_velocities(job, first, second, vector(job.qvel, job.nv), matrix(job.before_v, job.nv, 6))
    V_w = body_velocities(job, first, second, w, matrix(job.before_w, job.nv, 6))
    points = contact_points(job, contact, first, second)
    parent, member = integers(job.dof_parentid, job.nv), integers(job.member, job.nv)
    lastdof = integers(job.body_lastdof, job.nbody)
    for side in range(2):
        i = lastdof[second if side else first]
        while i >= 0:
            # a dof that moves both bodies comes up twice: it is dealt with on the second side
            if side == 1 or member[i] == 1:
                slope[i] -= _effect(job, r, size, kind, contact, i, member[i], V_a, V_v, V_w, points, W)
            i = parent[i]


@compiled
def _effect(job, r, size, kind, contact, i, sides, V_a, V_v, V_w, points, W):
    """W' dF_i, for a dof that moves body 1 (sides 1), body 2 (sides 2) or both (sides 3)."""
    S = row6(matrix(job.cdof, job.nv, 6), i)
    dp, ddist, phi = contact_motion(job, contact, S, sides)
    by_a = relative_rate(S, row6(matrix(job.before_a, job.nv, 6), i), V_a, sides, points, dp, phi)
    by_v = relative_rate(S, row6(matrix(job.before_v, job.nv, 6), i), V_v, sides, points, dp, phi)
    push = force_change(job, r, size, kind, contact, by_a, by_v, ddist)
    change = add6(push, join(cross3(phi, head(W)), cross3(phi, tail(W))))
    before = row6(matrix(job.before_w, job.nv, 6), i)
    effect = _work(S, before, V_w[1], sides & 2, points[1], dp, W, change)
    return effect - _work(S, before, V_w[0], sides & 1, points[0], dp, W, change)


@inlined
def _work(S, before, V, moves, x, dp, W, change):
    """V . dW - (V - V_i) . (S_i x* W) of one body, the wrenches taken about the tree's centre of mass."""
    force, dforce = tail(W), tail(change)
    couple = add3(add3(head(change), cross3(dp, force)), cross3(x, dforce))
    work = dot6(V, join(couple, dforce))
    if moves:
        work -= dot6(sub6(V, before), cross_force(S, join(add3(head(W), cross3(x, force)), force)))
    return work
