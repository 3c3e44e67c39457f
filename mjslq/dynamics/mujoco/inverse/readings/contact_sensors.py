"""Derivatives of contact sensors: which contacts they match, in which order, and the fields they report.

Forces and torques are those of `pressures`; distance, point, normal and tangent move as in `geometry`; the relative
velocity of the bodies, in a contact's axes, is what rows measure: d(J v), as in `contacts`.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.readings.accelerations import add_acceleration, clear_lever
from mjslq.dynamics.mujoco.inverse.readings.frames import clear_rows, is_below
from mjslq.dynamics.mujoco.inverse.readings.pressures import (
    IN_CONTACT,
    IN_WORLD,
    add_contact_reading,
    bodies_of,
    contact_at,
    motion_apart,
    rows_of,
)
from mjslq.dynamics.mujoco.inverse.rows.constraints import (
    FRICTIONLESS,
    is_differenced,
)
from mjslq.dynamics.mujoco.inverse.rows.contacts import (
    body_velocities,
    contact_points,
    contact_wrench,
    relative_rate,
    row_directions,
)
from mjslq.dynamics.mujoco.inverse.rows.geometry import contact_motion
from mjslq.dynamics.mujoco.inverse.spatial import (
    compiled,
    cross3,
    dot3,
    head,
    inlined,
    join,
    put6,
    row3,
    row6,
    scale3,
    tail,
)  # fmt: skip
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.job import entry_count, flags, integers, matrix, vector
from mjslq.native.declare import external

mj_insideSite = external("mj_insideSite", "int32(intp, intp, int32, intp)")


@compiled
def _matches(job, s, contact):
    """Whether a contact sensor counts a contact: 1, -1 if with the opposite normal, 0 if not."""
    asked = _asked_sides(job, s)
    if asked[0] == columns.INSIDE and not mj_insideSite(
        job.model, job.data, np.int32(asked[1]), contact + job.at_contact_pos
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
    dim, width, unknown = integers(job.sen_dim, job.nsensor)[s], 0, np.int64(0)
    for field in range(columns.FIELDS):
        width += _width(field) * ((fields >> field) & 1)
    clear_rows(C, D, row, dim)
    clear_lever(job)
    for j in range(entry_count(job.data + job.at_ncon)):
        contact = contact_at(job, j)
        way = _matches(job, s, contact)
        slot = 0 if reduction == columns.NET_FORCE else _slot(job, s, j, reduction)
        if way == 0 or slot * width >= dim:
            continue
        if is_differenced(job, np.int32(FRICTIONLESS), np.int32(j)):
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
        add_acceleration(job, row + (fields & 1), np.int64(3), C, D)
    return unknown == 0


@inlined
def _width(field):
    return 1 if field in (columns.FOUND, columns.DISTANCE) else 3


@compiled
def _slot(job, s, j, reduction):
    """Which of the matching contacts the j-th is, in the sensor's order."""
    own, count = _rank(job, contact_at(job, j), reduction), 0
    for k in range(entry_count(job.data + job.at_ncon)):
        other = _rank(job, contact_at(job, k), reduction)
        if (other < own or (other == own and k < j)) and _matches(job, s, contact_at(job, k)) != 0:
            count += 1
    return count


@compiled
def _rank(job, contact, reduction):
    """What a contact sensor sorts by: nothing, the distance, or the force, strongest first."""
    if reduction == columns.NEAREST:
        return vector(contact + job.at_contact_dist, 1)[0]
    if reduction != columns.STRONGEST:
        return 0.0
    r, of, rows = rows_of(job, contact)
    if r < 0:
        return 0.0
    W = contact_wrench(job, r, row_directions(job, contact, of, rows))
    return -dot3(tail(W), tail(W))


@compiled
def _write_contact_force(job, s, field, way, reduction, row, contact, C, D):
    """Force or torque in the contact's axes, as seen from the side asked for; of a net force, its share."""
    r, of, rows = rows_of(job, contact)
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
    add_contact_reading(job, s, np.int64(IN_WORLD if net else IN_CONTACT), row, np.int64(3), r, of, rows, contact, C)
    if not net:
        add_acceleration(job, row, np.int64(3), C, D)


@compiled
def _write_geometry(job, field, way, row, contact, C):
    """Distance, place, normal, first tangent of a contact, or the velocity of body 2 from body 1 in its axes."""
    first, second = bodies_of(job, contact)
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
                        motion_apart(S, sides, points),
                    )
                    turns = field == columns.CONTACT_TURN
                    for k in range(3):
                        axis = scale3(-1.0 if k == 2 and way < 0 else 1.0, row3(frame, k))
                        C[row + k, i] = dot3(axis, head(rate) if turns else tail(rate))
                        C[row + k, job.nv + i] = dot3(axis, head(motion) if turns else tail(motion))
            i = parent[i]
