"""How a contact moves when a dof does: its point, its distance, its frame.

Notation
--------
    n, p, dist           normal from geom 1 to geom 2, the point midway between the surfaces, the gap between them
    c_k, r_k             point in the core of geom k (a sphere's centre, a point of a capsule's axis, a corner) and the
                         radius about it: c_1 = p - n (r_1 + dist/2), c_2 = p + n (r_2 + dist/2)
    m_k                  motion of the material point of geom k at c_k; theta its turning, per unit of the dof
    (dp, ddist, phi)     motion of p, change of dist, turning of the contact's frame

Point on a static plane: dist = n . c_2 + const, so with dc = m_2 (n is fixed, geom 1 is the plane)

    ddist = n . dc,   dp = dc - n ddist / 2,   phi = spin n   (MuJoCo lets the tangents follow a capsule's axis).

Two round geoms: d = c_2 - c_1 = (dist + r_1 + r_2) n. A c_k inside a capsule's axis a_k slides along it, at a rate s_k
that keeps a_k . d = 0; at its ends it does not:

    dd = m_2 + s_2 a_2 - m_1 - s_1 a_1,   ddist = n . dd,   dn = (dd - n ddist) / |d|,
    dp = m_1 + s_1 a_1 + dn (r_1 + dist/2) + n ddist / 2,   phi = n x dn + spin n,

A sphere and a box: the same, with r_2 = 0 and c_2 free to slide along those axes of the box between whose faces it
lies (two on a face, one on an edge, none at a corner); they stand at right angles, so each has a rate of its own.
The spin follows from the rule by which MuJoCo finds the first tangent: the part across n of the y axis (the z axis,
when n is near y).
"""

from __future__ import annotations

import math

from mjslq.dynamics.mujoco.inverse.columns import BOX, CAPSULE, PLANE
from mjslq.dynamics.mujoco.inverse.job import flags, integers, matrix, vector
from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    compiled,
    cross3,
    dot3,
    head,
    inlined,
    row3,
    scale3,
    sub3,
    velocity_at,
)  # fmt: skip


@compiled
def contact_motion(job, contact, S, sides):
    """(dp, ddist, phi) of a contact for a dof S that moves geom 1 (sides & 1), geom 2 (sides & 2)."""
    geoms = flags(contact + job.at_contact_geom, 2)
    kinds, radius = integers(job.geom_kind, job.ngeom), vector(job.geom_radius, job.ngeom)
    n = row3(matrix(contact + job.at_contact_frame, 3, 3), 0)
    dist = vector(contact + job.at_contact_dist, 1)[0]
    c_2 = _core(job, contact, n, radius[geoms[1]] + 0.5 * dist)
    if kinds[geoms[0]] == PLANE:
        dc = _material(job, geoms[1], S, c_2)
        ddist = dot3(n, dc)
        spin = _spin_of_capsule(job, geoms[1], n, head(S)) if kinds[geoms[1]] == CAPSULE else 0.0
        return sub3(dc, scale3(0.5 * ddist, n)), ddist, scale3(spin, n)
    reach = radius[geoms[0]] + 0.5 * dist
    c_1 = _core(job, contact, n, -reach)
    zero = (0.0, 0.0, 0.0)
    m_1 = _material(job, geoms[0], S, c_1) if sides & 1 else zero
    m_2 = _material(job, geoms[1], S, c_2) if sides & 2 else zero
    dc_1 = m_1
    if kinds[geoms[1]] == BOX:
        dd = add3(sub3(m_2, m_1), _slide_on_box(job, geoms[1], c_1, c_2, head(S), sides, sub3(m_2, m_1)))
    else:
        s_1, s_2 = _slides(job, geoms, c_1, c_2, head(S), sides, sub3(m_2, m_1))
        dc_1 = add3(m_1, scale3(s_1, _axis(job, geoms[0])))
        dd = sub3(add3(m_2, scale3(s_2, _axis(job, geoms[1]))), dc_1)
    ddist = dot3(n, dd)
    dn = scale3(1.0 / (dist + radius[geoms[0]] + radius[geoms[1]]), sub3(dd, scale3(ddist, n)))
    dp = add3(add3(dc_1, scale3(reach, dn)), scale3(0.5 * ddist, n))
    return dp, ddist, add3(cross3(n, dn), scale3(_spin_of_frame(job, contact, n, dn), n))


@inlined
def _core(job, contact, n, reach):
    point = vector(contact + job.at_contact_pos, 3)
    return point[0] + reach * n[0], point[1] + reach * n[1], point[2] + reach * n[2]


@inlined
def _material(job, geom, S, c):
    """Motion of the point c of a geom."""
    root = integers(job.body_rootid, job.nbody)[integers(job.geom_bodyid, job.ngeom)[geom]]
    return velocity_at(S, sub3(c, row3(matrix(job.subtree_com, job.nbody, 3), root)))


@inlined
def _axis(job, geom):
    R = matrix(job.geom_xmat, job.ngeom, 9)
    return R[geom, 2], R[geom, 5], R[geom, 8]


@inlined
def _is_inside(job, geom, c):
    """Whether c lies between the ends of a capsule's axis."""
    if integers(job.geom_kind, job.ngeom)[geom] != CAPSULE:
        return False
    half = matrix(job.geom_size, job.ngeom, 3)[geom, 1]
    along = dot3(_axis(job, geom), sub3(c, row3(matrix(job.geom_xpos, job.ngeom, 3), geom)))
    return abs(along) < half * (1.0 - 1e-9)


@inlined
def _slides(job, geoms, c_1, c_2, theta, sides, apart):
    """Rates at which c_1 and c_2 slide along their capsules' axes."""
    d = sub3(c_2, c_1)
    a_1, a_2 = _axis(job, geoms[0]), _axis(job, geoms[1])
    e_1 = dot3(a_1, apart) + (dot3(cross3(theta, a_1), d) if sides & 1 else 0.0)
    e_2 = dot3(a_2, apart) + (dot3(cross3(theta, a_2), d) if sides & 2 else 0.0)
    inside_1, inside_2 = _is_inside(job, geoms[0], c_1), _is_inside(job, geoms[1], c_2)
    if inside_1 and inside_2:
        g = dot3(a_1, a_2)
        s_1 = (e_1 - g * e_2) / (1.0 - g * g)
        return s_1, g * s_1 - e_2
    return e_1 if inside_1 else 0.0, -e_2 if inside_2 else 0.0


@inlined
def _slide_on_box(job, geom, c_1, c_2, theta, sides, apart):
    """Motion of c_2 along the faces or edge of a box that it lies on."""
    R, size = matrix(job.geom_xmat, job.ngeom, 9), matrix(job.geom_size, job.ngeom, 3)
    from_center = sub3(c_2, row3(matrix(job.geom_xpos, job.ngeom, 3), geom))
    d, total = sub3(c_2, c_1), (0.0, 0.0, 0.0)
    for k in range(3):
        a = (R[geom, k], R[geom, 3 + k], R[geom, 6 + k])
        if abs(dot3(a, from_center)) < size[geom, k] * (1.0 - 1e-9):
            rate = -dot3(a, apart) - (dot3(cross3(theta, a), d) if sides & 2 else 0.0)
            total = add3(total, scale3(rate, a))
    return total


@inlined
def _spin_of_capsule(job, geom, n, theta):
    """Turning about n of a capsule's axis, as projected on the plane."""
    axis = _axis(job, geom)
    along = sub3(axis, scale3(dot3(axis, n), n))
    square = dot3(along, along)
    return dot3(cross3(theta, axis), cross3(n, axis)) / square if square > 1e-12 else 0.0


@inlined
def _spin_of_frame(job, contact, n, dn):
    """Turning about n of the tangents that MuJoCo makes of a normal."""
    t = row3(matrix(contact + job.at_contact_frame, 3, 3), 2)
    y = 1.0 if abs(n[1]) < 0.5 else 0.0
    along = y * n[1] + (1.0 - y) * n[2]
    return -along * dot3(dn, t) / math.sqrt(1.0 - along * along)
