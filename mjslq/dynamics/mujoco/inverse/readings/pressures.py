"""Derivatives of what sensors read of constraint forces: touch, contacts, the contacts' part of force, torque.

Notation (rows, s, H, jar, KBIP: `constraints`; E, W, dp, ddist, phi and the fixed-acceleration ds: `contacts`)
--------
    z = (q, v, act, u)   as a change of the reading goes through the rows' forces s, in full
    g                    weights of one reading on what the contact exerts on body 2, (couple, force) at its point
    S_i|_1^2             motion of body 2 less that of body 1, at that point, with dof i

The rows' forces change with ds = -H djar and with the change of H, and with velocity and acceleration djar is explicit:

    reading_i = g . E ds_i   by position (`contacts`),      -e . S_i   by velocity,      -h . S_i   by acceleration,
    h = E' H (E g),     e = E' b H (E g),

where the part by acceleration goes into the lever of `accelerations`. Readings in the contact's own frame see no more
than that. In the world's axes, or at a site, (couple, force) turns by phi besides; a torque's arm moves with dp, and
a site's axes by theta, as do those of the inertia's part.

Contacts whose geometry has no closed form leave what positions do to differences within the sensor's stage, at that
knot: `stages`. The rest holds for them too.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.readings.frames import is_below, moves, pose
from mjslq.dynamics.mujoco.inverse.rows.constraints import (
    CONE,
    ELLIPTIC,
    PYRAMIDAL,
    QUADRATIC,
    is_differenced,
)
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
    dot3,
    dot6,
    head,
    inlined,
    join,
    put6,
    row3,
    row6,
    scale3,
    scale6,
    sub3,
    tail,
    turned,
    velocity_at,
)  # fmt: skip
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, entry_count, flags, integers, matrix, vector
from mjslq.native.declare import external

mju_rayGeom = external("mju_rayGeom", "float64(intp, intp, intp, intp, intp, int32, intp)")

IN_CONTACT, IN_WORLD, AT_SITE = range(3)
"""Whose axes a reading of forces is in."""


@inlined
def contact_at(job, j):
    """Address of contact j."""
    return entry_address(job.data + job.at_contact) + j * job.at_contact_size


@inlined
def bodies_of(job, contact):
    """Bodies 1 and 2 of a contact."""
    geoms, body = flags(contact + job.at_contact_geom, 2), integers(job.geom_bodyid, job.ngeom)
    return body[geoms[0]], body[geoms[1]]


@compiled
def rows_of(job, contact):
    """First row of a contact that pushes (-1 for one that does not), its type, their number."""
    r = np.int64(flags(contact + job.at_contact_efc_address, 1)[0])
    if r < 0:
        return r, np.int32(0), 0
    kind = flags(entry_address(job.data + job.at_efc_type), r + 1)[r]
    dim = flags(contact + job.at_contact_dim, 1)[0]
    count = 2 * (dim - 1) if kind == PYRAMIDAL else dim
    return r if pushes(job, r, count) else np.int64(-1), kind, count


@compiled
def add_pressures(job, s, kind, row, C):
    """Add what the contacts do that a sensor for touch, force or torque feels.

    False if one has no closed form by position, where its columns are worth nothing.
    """
    weights, plain = matrix(job.covectors, 3, 18), kind == columns.TOUCH
    seen, readings = np.int64(IN_CONTACT if plain else AT_SITE), np.int64(1 if plain else 3)
    unknown = np.int64(0)
    for j in range(entry_count(job.data + job.at_ncon)):
        contact = contact_at(job, j)
        r, of, count = rows_of(job, contact)
        if r < 0:
            continue
        size = row_directions(job, contact, of, count)
        sign = _touches(job, s, contact, r, size) if kind == columns.TOUCH else _presses(job, s, contact)
        if sign == 0.0:
            continue
        if is_differenced(job, of, np.int32(j)):
            unknown += 1
        if kind == columns.TOUCH:
            put6(weights, 0, join((0.0, 0.0, 0.0), row3(matrix(contact + job.at_contact_frame, 3, 3), 0)))
        else:
            _weigh_at_site(job, s, kind, sign, contact)
        add_contact_reading(job, s, seen, row, readings, r, of, count, contact, C)
    return unknown == 0


@compiled
def _touches(job, s, contact, r, size):
    """Whether a touch sensor counts a contact: 1 or 0."""
    body = integers(job.sen_body, job.nsensor)[s]
    site = integers(job.sen_target, job.nsensor)[s]
    first, second = bodies_of(job, contact)
    W = contact_wrench(job, r, size)
    n = row3(matrix(contact + job.at_contact_frame, 3, 3), 0)
    if body not in (first, second) or dot3(tail(W), n) <= 0.0:
        return 0.0
    ray, sign = vector(job.small, 3), -1.0 if body == second else 1.0
    for k in range(3):
        ray[k] = sign * n[k]
    meets = mju_rayGeom(
        job.site_xpos + 24 * site,
        job.site_xmat + 72 * site,
        job.site_size + 24 * site,
        contact + job.at_contact_pos,
        job.small,
        np.int32(integers(job.site_type, job.nsite)[site]),
        0,
    )
    return 1.0 if meets >= 0.0 else 0.0


@compiled
def _presses(job, s, contact):
    """Sign with which a contact enters the force that a subtree exerts on its parent; 0 for one that does not."""
    body = integers(job.sen_body, job.nsensor)[s]
    first, second = bodies_of(job, contact)
    inside_1, inside_2 = is_below(job, first, body), is_below(job, second, body)
    if inside_1 == inside_2:
        return 0.0
    return -1.0 if inside_2 else 1.0


@compiled
def _weigh_at_site(job, s, kind, sign, contact):
    """Weights of a force or torque in a site's axes, about the site."""
    weights = matrix(job.covectors, 3, 18)
    body = integers(job.sen_body, job.nsensor)[s]
    _, p, q = pose(job, body, matrix(job.sen_prm, job.nsensor, columns.FRAME_NUMBERS)[s][:7])
    point = vector(contact + job.at_contact_pos, 3)
    arm = sub3((point[0], point[1], point[2]), p)
    for k in range(3):
        axis = scale3(sign, turned(q, (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)))
        if kind == columns.FORCE:
            put6(weights, k, join((0.0, 0.0, 0.0), axis))
        else:
            put6(weights, k, join(axis, cross3(axis, arm)))


@compiled
def _weigh_by_rows(job, r, size, of, contact, count):
    """Make h and e of g, for `count` readings."""
    weights, E = matrix(job.covectors, 3, 18), matrix(job.directions, 10, 6)
    KBIP = matrix(entry_address(job.data + job.at_efc_KBIP), r + size, 4)
    D = vector(entry_address(job.data + job.at_efc_D), r + size)
    states = flags(entry_address(job.data + job.at_efc_state), r + size)
    H = matrix(contact + job.at_contact_H, size, size)
    slides = of == ELLIPTIC and states[r] == CONE
    for k in range(count):
        g, zero = row6(weights, k), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        h, e = zero, zero
        for a in range(size):
            slope = 0.0
            if slides:
                for b in range(size):
                    slope += H[a, b] * dot6(row6(E, b), g)
            elif states[r + a] == QUADRATIC:
                slope = D[r + a] * dot6(row6(E, a), g)
            h = add6(h, scale6(slope, row6(E, a)))
            e = add6(e, scale6(slope * KBIP[r + a, 1], row6(E, a)))
        put6(weights[:, 6:], k, h)
        put6(weights[:, 12:], k, e)


@compiled
def add_contact_reading(job, s, way, row, count, r, of, rows, contact, C):
    """Add the change of `count` readings, whose weights are set, with all dofs that move either body of a contact."""
    first, second = bodies_of(job, contact)
    size = row_directions(job, contact, of, rows)
    _weigh_by_rows(job, r, size, of, contact, count)
    W = contact_wrench(job, r, size)
    V_a = body_velocities(job, first, second, vector(job.acc_c, job.nv), matrix(job.before_a, job.nv, 6))
    V_v = body_velocities(job, first, second, vector(job.qvel, job.nv), matrix(job.before_v, job.nv, 6))
    points = contact_points(job, contact, first, second)
    parent, member = integers(job.dof_parentid, job.nv), integers(job.member, job.nv)
    lastdof, cdof = integers(job.body_lastdof, job.nbody), matrix(job.cdof, job.nv, 6)
    before_a, before_v = matrix(job.before_a, job.nv, 6), matrix(job.before_v, job.nv, 6)
    weights, lever = matrix(job.covectors, 3, 18), matrix(job.lever, job.nv, 3)
    for side in range(2):
        i = lastdof[second if side == 1 else first]
        while i >= 0:
            sides = member[i]
            if side == 1 or sides == 1:  # a dof that moves both bodies comes up twice
                S = row6(cdof, i)
                dp, ddist, phi = contact_motion(job, contact, S, sides)
                by_a = relative_rate(S, row6(before_a, i), V_a, sides, points, dp, phi)
                by_v = relative_rate(S, row6(before_v, i), V_v, sides, points, dp, phi)
                push = force_change(job, r, size, of, contact, by_a, by_v, ddist)
                if way != IN_CONTACT:
                    push = add6(push, join(cross3(phi, head(W)), cross3(phi, tail(W))))
                motion = motion_apart(S, sides, points)
                for k in range(count):
                    C[row + k, i] += dot6(row6(weights, k), push)
                    if way == AT_SITE:
                        C[row + k, i] += _turn_with_site(job, s, i, k, S, dp, W, contact)
                    C[row + k, job.nv + i] -= dot6(row6(weights[:, 12:], k), motion)
                    lever[i, k] -= dot6(row6(weights[:, 6:], k), motion)
            i = parent[i]


@inlined
def motion_apart(S, sides, points):
    """Motion of body 2 less that of body 1 with a dof, at the contact's point."""
    angular, linear = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if sides & 1:
        angular, linear = sub3(angular, head(S)), sub3(linear, velocity_at(S, points[0]))
    if sides & 2:
        angular, linear = add3(angular, head(S)), add3(linear, velocity_at(S, points[1]))
    return join(angular, linear)


@compiled
def _turn_with_site(job, s, i, k, S, dp, W, contact):
    """Change of reading k by the motion of the site's axes and of a torque's arm."""
    body, g = integers(job.sen_body, job.nsensor)[s], row6(matrix(job.covectors, 3, 18), k)
    carries = moves(job, i, integers(job.body_lastdof, job.nbody)[body])
    if integers(job.sen_kind, job.nsensor)[s] == columns.FORCE:
        return -dot3(tail(g), cross3(head(S), tail(W))) if carries else 0.0
    if not carries:
        return dot3(head(g), cross3(dp, tail(W)))
    x, p, _ = pose(job, body, matrix(job.sen_prm, job.nsensor, columns.FRAME_NUMBERS)[s][:7])
    point = vector(contact + job.at_contact_pos, 3)
    couple = add3(head(W), cross3(sub3((point[0], point[1], point[2]), p), tail(W)))
    arm = sub3(dp, velocity_at(S, x))
    return dot3(head(g), sub3(cross3(arm, tail(W)), cross3(head(S), couple)))
