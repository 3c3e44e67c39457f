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

The relative velocity of the bodies, in a contact's axes, is what rows measure: d(J v), as in `contacts`.

Contacts whose geometry has no closed form leave what positions do to differences within the sensor's stage, at that
knot: `stages`. The rest holds for them too.
"""

from __future__ import annotations

from numba import types

from mjslq.dynamics.mujoco.inverse.readings.accelerations import add_acceleration, clear_lever
from mjslq.dynamics.mujoco.inverse.readings.frames import clear_rows, is_below, moves, pose
from mjslq.dynamics.mujoco.inverse.rows.constraints import (
    CONE,
    ELLIPTIC,
    FRICTIONLESS,
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
from mjslq.dynamics.mujoco.kernels import _address, _number

mju_rayGeom = types.ExternalFunction(  # noqa: N816
    "mju_rayGeom", _number(_address, _address, _address, _address, _address, types.int32, _address)
)

mj_insideSite = types.ExternalFunction(  # noqa: N816
    "mj_insideSite", types.int32(_address, _address, types.int32, _address)
)

_PLAIN, _WORLD, _AT_SITE = range(3)


@inlined
def _contact(job, j):
    return entry_address(job.data + job.at_contact) + j * job.at_contact_size


@inlined
def _bodies(job, contact):
    geoms, body = flags(contact + job.at_contact_geom, 2), integers(job.geom_bodyid, job.ngeom)
    return body[geoms[0]], body[geoms[1]]


@compiled
def _rows_of(job, contact):
    """First row of a contact that pushes (-1 for one that does not), its type, their number."""
    r = types.int64(flags(contact + job.at_contact_efc_address, 1)[0])
    if r < 0:
        return r, types.int32(0), 0
    kind = flags(entry_address(job.data + job.at_efc_type), r + 1)[r]
    dim = flags(contact + job.at_contact_dim, 1)[0]
    count = 2 * (dim - 1) if kind == PYRAMIDAL else dim
    return r if pushes(job, r, count) else types.int64(-1), kind, count


@compiled
def add_pressures(job, s, kind, row, C):
    """Add what the contacts do that a sensor for touch, force or torque feels.

    False if one has no closed form by position, where its columns are worth nothing.
    """
    weights, plain = matrix(job.covectors, 3, 18), kind == columns.TOUCH
    seen, readings = types.int64(_PLAIN if plain else _AT_SITE), types.int64(1 if plain else 3)
    unknown = types.int64(0)
    for j in range(entry_count(job.data + job.at_ncon)):
        contact = _contact(job, j)
        r, of, count = _rows_of(job, contact)
        if r < 0:
            continue
        size = row_directions(job, contact, of, count)
        sign = _touches(job, s, contact, r, size) if kind == columns.TOUCH else _presses(job, s, contact)
        if sign == 0.0:
            continue
        if is_differenced(job, of, types.int32(j)):
            unknown += 1
        if kind == columns.TOUCH:
            put6(weights, 0, join((0.0, 0.0, 0.0), row3(matrix(contact + job.at_contact_frame, 3, 3), 0)))
        else:
            _weigh_at_site(job, s, kind, sign, contact)
        _add_contact(job, s, seen, row, readings, r, of, count, contact, C)
    return unknown == 0


@compiled
def _touches(job, s, contact, r, size):
    """Whether a touch sensor counts a contact: 1 or 0."""
    body = integers(job.sen_body, job.nsensor)[s]
    site = integers(job.sen_target, job.nsensor)[s]
    first, second = _bodies(job, contact)
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
        types.int32(integers(job.site_type, job.nsite)[site]),
        0,
    )
    return 1.0 if meets >= 0.0 else 0.0


@compiled
def _presses(job, s, contact):
    """Sign with which a contact enters the force that a subtree exerts on its parent; 0 for one that does not."""
    body = integers(job.sen_body, job.nsensor)[s]
    first, second = _bodies(job, contact)
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
def _add_contact(job, s, way, row, count, r, of, rows, contact, C):
    """Add the change of `count` readings, whose weights are set, with all dofs that move either body of a contact."""
    first, second = _bodies(job, contact)
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
                if way != _PLAIN:
                    push = add6(push, join(cross3(phi, head(W)), cross3(phi, tail(W))))
                motion = _apart(S, sides, points)
                for k in range(count):
                    C[row + k, i] += dot6(row6(weights, k), push)
                    if way == _AT_SITE:
                        C[row + k, i] += _turn_with_site(job, s, i, k, S, dp, W, contact)
                    C[row + k, job.nv + i] -= dot6(row6(weights[:, 12:], k), motion)
                    lever[i, k] -= dot6(row6(weights[:, 6:], k), motion)
            i = parent[i]


@inlined
def _apart(S, sides, points):
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


@compiled
def _matches(job, s, contact):
    """Whether a contact sensor counts a contact: 1, -1 if with the opposite normal, 0 if not."""
    asked = _asked_sides(job, s)
    if asked[0] == columns.INSIDE and not mj_insideSite(
        job.model, job.data, types.int32(asked[1]), contact + job.at_contact_pos
    ):
        return 0
    geoms = flags(contact + job.at_contact_geom, 2)
    if _is_side(job, geoms[0], asked[0], asked[1]) and _is_side(job, geoms[1], asked[2], asked[3]):
        return 1
    return -1 if _is_side(job, geoms[1], asked[0], asked[1]) and _is_side(job, geoms[0], asked[2], asked[3]) else 0


@inlined
def _asked_sides(job, s):
    """What sensor s asks of the two sides of a contact: (type, index) of each."""
    sides = integers(job.sen_sides, 4 * job.nsensor)
    return sides[4 * s], sides[4 * s + 1], sides[4 * s + 2], sides[4 * s + 3]


@inlined
def _is_side(job, geom, asked, index):
    body = integers(job.geom_bodyid, job.ngeom)[geom]
    if asked == columns.GEOM:
        return index == geom
    if asked == columns.BODY:
        return index == body
    return asked != columns.SUBTREE or is_below(job, body, index)


@compiled
def write_contacts(job, s, row, C, D):
    """Slots of a contact sensor; False when a contact in one of them has no closed form by position."""
    fields, reduction = integers(job.sen_fields, job.nsensor)[s], integers(job.sen_reduction, job.nsensor)[s]
    dim, width, unknown = integers(job.sen_dim, job.nsensor)[s], 0, types.int64(0)
    for field in range(columns.FIELDS):
        width += _width(field) * ((fields >> field) & 1)
    clear_rows(C, D, row, dim)
    clear_lever(job)
    for j in range(entry_count(job.data + job.at_ncon)):
        contact = _contact(job, j)
        way = _matches(job, s, contact)
        slot = 0 if reduction == columns.NET_FORCE else _slot(job, s, j, reduction)
        if way == 0 or slot * width >= dim:
            continue
        if is_differenced(job, types.int32(FRICTIONLESS), types.int32(j)):
            unknown += 1
        at = row + slot * width
        for field in range(columns.FIELDS):
            if (fields >> field) & 1:
                if field in (columns.CONTACT_FORCE, columns.CONTACT_TORQUE):
                    _write_contact_force(job, s, field, way, reduction, at, contact, C, D)
                elif field != columns.FOUND and reduction != columns.NET_FORCE:
                    _write_geometry(job, field, way, at, contact, C)
                at += _width(field)
    if reduction == columns.NET_FORCE and (fields >> columns.CONTACT_FORCE) & 1:
        add_acceleration(job, row + (fields & 1), types.int64(3), C, D)
    return unknown == 0


@inlined
def _width(field):
    return 1 if field in (columns.FOUND, columns.DISTANCE) else 3


@compiled
def _slot(job, s, j, reduction):
    """Which of the matching contacts the j-th is, in the sensor's order."""
    own, count = _rank(job, _contact(job, j), reduction), 0
    for k in range(entry_count(job.data + job.at_ncon)):
        other = _rank(job, _contact(job, k), reduction)
        if (other < own or (other == own and k < j)) and _matches(job, s, _contact(job, k)) != 0:
            count += 1
    return count


@compiled
def _rank(job, contact, reduction):
    """What a contact sensor sorts by: nothing, the distance, or the force, strongest first."""
    if reduction == columns.NEAREST:
        return vector(contact + job.at_contact_dist, 1)[0]
    if reduction != columns.STRONGEST:
        return 0.0
    r, of, rows = _rows_of(job, contact)
    if r < 0:
        return 0.0
    W = contact_wrench(job, r, row_directions(job, contact, of, rows))
    return -dot3(tail(W), tail(W))


@compiled
def _write_contact_force(job, s, field, way, reduction, row, contact, C, D):
    """Force or torque in the contact's axes, as seen from the side asked for; of a net force, its share."""
    r, of, rows = _rows_of(job, contact)
    if r < 0:
        return
    weights, frame = matrix(job.covectors, 3, 18), matrix(contact + job.at_contact_frame, 3, 3)
    zero, net = (0.0, 0.0, 0.0), reduction == columns.NET_FORCE
    for k in range(3):
        axis = row3(frame, k)
        if net:
            sign = 1.0 * way
            axis = (sign if k == 0 else 0.0, sign if k == 1 else 0.0, sign if k == 2 else 0.0)
        elif k == 2 and way < 0:
            axis = scale3(-1.0, axis)
        put6(weights, k, join(zero, axis) if field == columns.CONTACT_FORCE else join(axis, zero))
    if not net:
        clear_lever(job)
    _add_contact(job, s, types.int64(_WORLD if net else _PLAIN), row, types.int64(3), r, of, rows, contact, C)
    if not net:
        add_acceleration(job, row, types.int64(3), C, D)


@compiled
def _write_geometry(job, field, way, row, contact, C):
    """Distance, place, normal, first tangent of a contact, or the velocity of body 2 from body 1 in its axes."""
    first, second = _bodies(job, contact)
    lastdof, parent = integers(job.body_lastdof, job.nbody), integers(job.dof_parentid, job.nv)
    frame, cdof = matrix(contact + job.at_contact_frame, 3, 3), matrix(job.cdof, job.nv, 6)
    before, member = matrix(job.before_v, job.nv, 6), integers(job.member, job.nv)
    V = body_velocities(job, first, second, vector(job.qvel, job.nv), before)
    points = contact_points(job, contact, first, second)
    for side in range(2):
        i = lastdof[second if side == 1 else first]
        while i >= 0:
            sides = member[i]
            if side == 1 or sides == 1:
                S = row6(cdof, i)
                dp, ddist, phi = contact_motion(job, contact, S, sides)
                if field == columns.DISTANCE:
                    C[row, i] = ddist
                elif field <= columns.TANGENT:
                    axis = row3(frame, 0 if field == columns.NORMAL else 1)
                    change = dp if field == columns.POINT else scale3(1.0 * way, cross3(phi, axis))
                    C[row, i], C[row + 1, i], C[row + 2, i] = change
                else:
                    rate, motion = (
                        relative_rate(S, row6(before, i), V, sides, points, dp, phi),
                        _apart(S, sides, points),
                    )
                    turns = field == columns.CONTACT_TURN
                    for k in range(3):
                        axis = scale3(-1.0 if k == 2 and way < 0 else 1.0, row3(frame, k))
                        C[row + k, i] = dot3(axis, head(rate) if turns else tail(rate))
                        C[row + k, job.nv + i] = dot3(axis, head(motion) if turns else tail(motion))
            i = parent[i]
