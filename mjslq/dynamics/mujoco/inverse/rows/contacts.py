"""Position derivative of the forces of one contact, in closed form but for the motion of its features.

Body 2 is the one that the normal n points to, body 1 the other (the plane's, which may not move). How the contact's
point p, its distance and its frame move with dof i, (dp_i, ddist_i, phi_i), is geometry: `geometry`, and `pairs` for
pairs of geoms that meet in more than a point or without a formula.
The rest holds for any pair. A row's direction E = (couple, force) measures couple . w + force . (velocity at p) of body
2 less that of body 1, and with V = sum S_j x_j of a body, V_i the same before i's group,

    d(J x)_i = E (S_i x (V - V_i), at p)|_1^2 + force . (w_2 - w_1) x dp_i + (phi_i x E) (V at p)|_1^2,

needed for x = a and x = v. With jar and the factor D of the rows (imp = KBIP[2], imp' = KBIP[3]),

    djar = d(J a) + b d(J v) + k (imp' (pos - margin) + imp) ddist,      ds = -H djar + imp' / (imp (1 - imp)) ddist s.

The contact's wrench W on body 2 changes with ds, dp and phi, and what that does to all generalized forces is in
`wrenches`. The idea of freezing the contact's features is that of the open pull request
google-deepmind/mujoco_warp#1535.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.rows.geometry import contact_motion
from mjslq.dynamics.mujoco.inverse.rows.wrenches import add_force_change, from_center, mark_members
from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    add6,
    compiled,
    cross3,
    cross_motion,
    dot6,
    head,
    inlined,
    join,
    put6,
    row3,
    row6,
    scale6,
    sub3,
    sub6,
    tail,
    velocity_at,
)  # fmt: skip
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, flags, integers, matrix, vector

_PYRAMIDAL, _ELLIPTIC = 6, 7
_QUADRATIC, _CONE = 1, 4


@compiled
def add_contact(job, r, count, kind, contact, acc, F):
    """F += d(J' s)/dq of the contact at address `contact`, whose rows are r ... r + count - 1.

    Called for every row of pyramids: only the call for the first row does anything.
    """
    if flags(contact + job.at_contact_efc_address, 1)[0] != r or not pushes(job, r, count):
        return
    geoms = flags(contact + job.at_contact_geom, 2)
    body = integers(job.geom_bodyid, job.ngeom)
    bodies = (body[geoms[0]], body[geoms[1]])
    size = row_directions(job, contact, kind, count)
    W = contact_wrench(job, r, size)
    V_a = body_velocities(job, bodies[0], bodies[1], acc, matrix(job.before_a, job.nv, 6))
    V_v = body_velocities(job, bodies[0], bodies[1], vector(job.qvel, job.nv), matrix(job.before_v, job.nv, 6))
    points = contact_points(job, contact, bodies[0], bodies[1])
    parent, member = integers(job.dof_parentid, job.nv), integers(job.member, job.nv)
    lastdof = integers(job.body_lastdof, job.nbody)
    for side in range(2):
        i = lastdof[bodies[side]]
        while i >= 0:
            # a dof that moves both bodies comes up twice: it is dealt with on the second side
            if side == 1 or member[i] == 1:
                _add_dof(job, r, size, kind, contact, i, member[i], V_a, V_v, bodies, points, W, F)
            i = parent[i]


@compiled
def _add_dof(job, r, size, kind, contact, i, sides, V_a, V_v, bodies, points, W, F):
    """Change of all generalized forces with dof i, which moves body 1 (sides 1), body 2 (sides 2) or both (sides 3)."""
    S = row6(matrix(job.cdof, job.nv, 6), i)
    dp, ddist, phi = contact_motion(job, contact, S, sides)
    by_a = relative_rate(S, row6(matrix(job.before_a, job.nv, 6), i), V_a, sides, points, dp, phi)
    by_v = relative_rate(S, row6(matrix(job.before_v, job.nv, 6), i), V_v, sides, points, dp, phi)
    push = force_change(job, r, size, kind, contact, by_a, by_v, ddist)
    change = add6(push, join(cross3(phi, head(W)), cross3(phi, tail(W))))
    add_force_change(job, i, i, sides, bodies, points, W, change, (dp, dp), F)


@compiled
def add_row_change(job, count, kind, contact, x, change):
    """Add d(J x)/dq of a contact's first row to `change`."""
    geoms = flags(contact + job.at_contact_geom, 2)
    body, lastdof = integers(job.geom_bodyid, job.ngeom), integers(job.body_lastdof, job.nbody)
    parent, member = integers(job.dof_parentid, job.nv), integers(job.member, job.nv)
    before = matrix(job.before_a, job.nv, 6)
    row_directions(job, contact, kind, count)
    E = row6(matrix(job.directions, 10, 6), 0)
    V = body_velocities(job, body[geoms[0]], body[geoms[1]], x, before)
    points = contact_points(job, contact, body[geoms[0]], body[geoms[1]])
    for side in range(2):
        i = lastdof[body[geoms[side]]]
        while i >= 0:
            if side == 1 or member[i] == 1:
                S = row6(matrix(job.cdof, job.nv, 6), i)
                dp, _, phi = contact_motion(job, contact, S, member[i])
                change[i] += dot6(E, relative_rate(S, row6(before, i), V, member[i], points, dp, phi))
            i = parent[i]


@inlined
def pushes(job, r, count):
    """Whether any of the rows of a contact is active."""
    states = flags(entry_address(job.data + job.at_efc_state), r + count)
    for k in range(r, r + count):  # noqa: SIM110 -- a plain loop is what numba compiles well
        if states[k] != 0:
            return True
    return False


@compiled
def row_directions(job, contact, kind, count):
    """Rows' directions (couple, force) into job.directions; returns their number."""
    E, frame = matrix(job.directions, 10, 6), matrix(contact + job.at_contact_frame, 3, 3)
    dim = flags(contact + job.at_contact_dim, 1)[0]
    friction = vector(contact + job.at_contact_friction, 5)
    n, zero = row3(frame, 0), (0.0, 0.0, 0.0)
    if kind != _PYRAMIDAL:
        for k in range(dim):
            put6(E, k, join(zero, row3(frame, k)) if k < 3 else join(row3(frame, k - 3), zero))
        return dim
    for k in range(1, dim):
        way = join(zero, row3(frame, k)) if k < 3 else join(row3(frame, k - 3), zero)
        way = scale6(friction[k - 1], way)
        put6(E, 2 * k - 2, add6(join(zero, n), way))
        put6(E, 2 * k - 1, sub6(join(zero, n), way))
    return count


@compiled
def body_velocities(job, first, second, x, before):
    """V = sum S_j x_j of both bodies; V before each dof's group into `before`, who moves whom into job.member."""
    mark_members(job, (first, second))
    return _chain_velocity(job, first, x, before), _chain_velocity(job, second, x, before)


@compiled
def _chain_velocity(job, body, x, before):
    chain, group, cdof = integers(job.chain, job.nv), integers(job.dof_group, job.nv), matrix(job.cdof, job.nv, 6)
    parent = integers(job.dof_parentid, job.nv)
    size, i = 0, integers(job.body_lastdof, job.nbody)[body]
    while i >= 0:
        chain[size] = i
        size += 1
        i = parent[i]
    V = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    start, last = V, -1
    for k in range(size - 1, -1, -1):
        i = chain[k]
        if group[i] != last:
            start, last = V, group[i]
        put6(before, i, start)
        V = add6(V, scale6(x[i], row6(cdof, i)))
    return V


@inlined
def contact_points(job, contact, first, second):
    """The contact's point relative to the centre of mass of either body's tree."""
    point = vector(contact + job.at_contact_pos, 3)
    p = (point[0], point[1], point[2])
    return from_center(job, first, p), from_center(job, second, p)


@inlined
def contact_wrench(job, r, size):
    """What the contact exerts on body 2, as (couple, force) at its point."""
    E, s = matrix(job.directions, 10, 6), vector(entry_address(job.data + job.at_efc_force), r + size)
    W = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in range(size):
        W = add6(W, scale6(s[r + k], row6(E, k)))
    return W


@inlined
def relative_rate(S, before, V, sides, points, dp, phi):
    """Change with a dof of body 2's (angular velocity, velocity at p) less body 1's, seen from the turning frame."""
    angular, linear = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if sides & 1:
        moved = cross_motion(S, sub6(V[0], before))
        angular, linear = sub3(angular, head(moved)), sub3(linear, velocity_at(moved, points[0]))
    if sides & 2:
        moved = cross_motion(S, sub6(V[1], before))
        angular, linear = add3(angular, head(moved)), add3(linear, velocity_at(moved, points[1]))
    turn = sub3(head(V[1]), head(V[0]))
    slip = sub3(velocity_at(V[1], points[1]), velocity_at(V[0], points[0]))
    return join(add3(angular, cross3(turn, phi)), add3(linear, add3(cross3(turn, dp), cross3(slip, phi))))


@compiled
def force_change(job, r, size, kind, contact, by_a, by_v, ddist):
    """Sum of E ds over the rows, as (couple, force)."""
    E = matrix(job.directions, 10, 6)
    KBIP = matrix(entry_address(job.data + job.at_efc_KBIP), r + size, 4)
    D, s = (
        vector(entry_address(job.data + job.at_efc_D), r + size),
        vector(entry_address(job.data + job.at_efc_force), r + size),
    )
    pos = vector(entry_address(job.data + job.at_efc_pos), r + size)
    margin = vector(entry_address(job.data + job.at_efc_margin), r + size)
    states = flags(entry_address(job.data + job.at_efc_state), r + size)
    djar = vector(job.djar, 10)
    imp, slope = KBIP[r, 2], KBIP[r, 3]
    grows = slope / (imp * (1.0 - imp)) * ddist
    for k in range(size):
        row = row6(E, k)
        stiffness = KBIP[r + k, 0] * (slope * (pos[r + k] - margin[r + k]) + imp)
        djar[k] = dot6(row, by_a) + KBIP[r + k, 1] * dot6(row, by_v) + stiffness * ddist
    push = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if kind == _ELLIPTIC and states[r] == _CONE:
        H = matrix(contact + job.at_contact_H, size, size)
        for k in range(size):
            ds = grows * s[r + k]
            for c in range(size):
                ds -= H[k, c] * djar[c]
            push = add6(push, scale6(ds, row6(E, k)))
        return push
    for k in range(size):
        if states[r + k] == _QUADRATIC:
            push = add6(push, scale6(grows * s[r + k] - D[r + k] * djar[k], row6(E, k)))
    return push
