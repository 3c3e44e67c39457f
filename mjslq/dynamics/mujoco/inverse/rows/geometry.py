"""How a contact moves when its geoms do: its point, its distance, its frame.

Notation
--------
    n, p, dist           normal from geom 1 to geom 2, the point midway between the surfaces, the gap between them
    x_1, x_2             the surfaces' points: x_1 = p - n dist/2, x_2 = p + n dist/2
    W_k                  radii of curvature of geom k at x_k, a symmetric 2 x 2 matrix in the contact's tangent plane
    (theta, v)           motion of geom 2 against geom 1: its turning, and the velocity of its point at p
    (ddist, dp, dn)      what follows, seen from geom 1; with its own motion added, (dp, ddist, phi) in the world,
                         phi the turning of the contact's frame

A surface answers a turning of its normal by moving the point where it has that normal: dx = W dn, W a sphere's radius,
0 at a corner, infinite along an edge and on a face. Two surfaces face each other along n:

    dx_1 = W_1 dn,   dx_2 = v + theta x (x_2 - p) - W_2 (dn - theta x n),   x_2 - x_1 = dist n,

of which the part across n and the part along it are

    (dist + W_1 + W_2) dn = (v + theta x (x_2 - p)) + W_2 (theta x n),      ddist = n . (v + theta x (x_2 - p)),

and dp = W_1 dn + dist dn / 2 + n ddist / 2. On a static plane dn = 0. Infinite radii are taken as FLAT.

All this is linear in (theta, v): a table of six rows, made once a contact, holds it. Where MuJoCo finds contacts by
iteration, or more of them than one point that faces another, the tables are made by differences (`pairs`).

phi = n x dn + spin n, and the spin follows from the rule by which MuJoCo finds the first tangent: the part across n of
the y axis (the z axis, when n is near y); capsules on planes have their own axis' part instead.
"""

from __future__ import annotations

import math

from mjslq.dynamics.mujoco.inverse.rows.pairs import MOST, fill_by_differences, first_of_pair
from mjslq.dynamics.mujoco.inverse.rows.wrenches import from_center
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
from mjslq.dynamics.mujoco.inverse.table.columns import BOX, CAPSULE, CYLINDER, ELLIPSOID, MESH, PLANE, SPHERE
from mjslq.dynamics.mujoco.inverse.table.job import flags, integers, matrix, vector

FLAT = 1e7
"""What stands for an infinite radius of curvature. [m]"""
_ON = 1e-9
"""How near to the end of a side, relatively, a point counts as on the end."""


@compiled
def contact_motion(job, contact, S, sides):
    """(dp, ddist, phi) of a contact for a dof S that moves geom 1 (sides & 1), geom 2 (sides & 2)."""
    geoms = flags(contact + job.at_contact_geom, 2)
    kinds, body = integers(job.geom_kind, job.ngeom), integers(job.geom_bodyid, job.ngeom)
    n = row3(matrix(contact + job.at_contact_frame, 3, 3), 0)
    point = vector(contact + job.at_contact_pos, 3)
    # a dof that moves both geoms moves them as one
    mover = geoms[0] if sides & 1 else geoms[1]
    theta, v = head(S), velocity_at(S, from_center(job, body[mover], (point[0], point[1], point[2])))
    ddist, dp, dn = 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if sides & 1:
        dp, dn = v, cross3(theta, n)
    if sides != 3:
        table, sign = _find_table(job, contact), 1.0 if sides & 2 else -1.0
        for k in range(6):
            rate = sign * (theta[k] if k < 3 else v[k - 3])
            ddist += rate * table[k, 0]
            dp = add3(dp, scale3(rate, (table[k, 1], table[k, 2], table[k, 3])))
            dn = add3(dn, scale3(rate, (table[k, 4], table[k, 5], table[k, 6])))
    if kinds[geoms[0]] == PLANE and kinds[geoms[1]] == CAPSULE:
        spin = _spin_of_capsule(job, geoms[1], n, theta)
    else:
        spin = _spin_of_frame(job, contact, n, dn)
    return dp, ddist, add3(cross3(n, dn), scale3(spin, n))


@compiled
def _find_table(job, contact):
    """Table (6, 7) of a contact. Those of the last contact and of all contacts of the last pair of geoms are kept."""
    own = matrix(job.tables + 8 * 42 * MOST, 6, 7)
    if _is_kept(job, 0, contact):
        return own
    first = first_of_pair(job, contact)
    k = (contact - first) // job.at_contact_size
    if not (_is_kept(job, 1, first) and k < MOST):
        if meets_in_points(job, contact) and _fill_by_curvature(job, contact, own):
            _keep(job, 0, contact)
            return own
        fill_by_differences(job, first)
        _keep(job, 1, first)
    return matrix(job.tables + 8 * 42 * min(k, MOST - 1), 6, 7)


@compiled
def _is_kept(job, place, contact):
    """Whether the tables kept in a place are those of this contact, told by its geoms, its point and its distance."""
    kept, geoms = matrix(job.tabulated, 2, 6)[place], flags(contact + job.at_contact_geom, 2)
    point, dist = vector(contact + job.at_contact_pos, 3), vector(contact + job.at_contact_dist, 1)[0]
    same = kept[0] == point[0] and kept[1] == point[1] and kept[2] == point[2] and kept[3] == dist
    return same and kept[4] == geoms[0] + 1 and kept[5] == geoms[1] + 1


@compiled
def _keep(job, place, contact):
    kept, geoms = matrix(job.tabulated, 2, 6)[place], flags(contact + job.at_contact_geom, 2)
    point = vector(contact + job.at_contact_pos, 3)
    kept[0], kept[1], kept[2], kept[3] = point[0], point[1], point[2], vector(contact + job.at_contact_dist, 1)[0]
    kept[4], kept[5] = geoms[0] + 1, geoms[1] + 1  # no geom leaves a place that is still empty


@inlined
def meets_in_points(job, contact):
    """Whether every contact of two geoms is exactly one point of either that faces the other."""
    geoms, kinds = flags(contact + job.at_contact_geom, 2), integers(job.geom_kind, job.ngeom)
    first, second = kinds[geoms[0]], kinds[geoms[1]]
    if first == PLANE:
        return second in (SPHERE, CAPSULE, BOX, MESH, ELLIPSOID)
    if first == SPHERE:
        return second in (SPHERE, CAPSULE, BOX, CYLINDER)
    return first == CAPSULE and second == CAPSULE


@compiled
def _fill_by_curvature(job, contact, table):
    """Write what (ddist, dp, dn) are per unit of (theta, v); False where the surfaces' radii cancel the distance."""
    geoms = flags(contact + job.at_contact_geom, 2)
    frame = matrix(contact + job.at_contact_frame, 3, 3)
    n, t, b = row3(frame, 0), row3(frame, 1), row3(frame, 2)
    point, dist = vector(contact + job.at_contact_pos, 3), vector(contact + job.at_contact_dist, 1)[0]
    p, apart = (point[0], point[1], point[2]), scale3(0.5 * dist, n)
    W_1 = _radii(job, geoms[0], n, sub3(p, apart), t, b)
    W_2 = _radii(job, geoms[1], scale3(-1.0, n), add3(p, apart), t, b)
    tt, tb, bb = W_1[0] + W_2[0] + dist, W_1[1] + W_2[1], W_1[2] + W_2[2] + dist
    determinant = tt * bb - tb * tb
    if not (tt + bb > 1e-6 and determinant > 1e-12):
        return False
    on_plane = integers(job.geom_kind, job.ngeom)[geoms[0]] == PLANE
    for k in range(6):
        one = (1.0 if k % 3 == 0 else 0.0, 1.0 if k % 3 == 1 else 0.0, 1.0 if k % 3 == 2 else 0.0)
        zero = (0.0, 0.0, 0.0)
        theta = one if k < 3 else zero
        motion = cross3(theta, apart) if k < 3 else one
        turned = cross3(theta, n)
        u_t, u_b = dot3(t, turned), dot3(b, turned)
        r_t = dot3(t, motion) + W_2[0] * u_t + W_2[1] * u_b
        r_b = dot3(b, motion) + W_2[1] * u_t + W_2[2] * u_b
        d_t, d_b = (bb * r_t - tb * r_b) / determinant, (tt * r_b - tb * r_t) / determinant
        x_t, x_b = W_1[0] * d_t + W_1[1] * d_b, W_1[1] * d_t + W_1[2] * d_b
        if on_plane:
            d_t, d_b, x_t, x_b = 0.0, 0.0, r_t, r_b
        ddist = dot3(n, motion)
        across = add3(scale3(x_t + 0.5 * dist * d_t, t), scale3(x_b + 0.5 * dist * d_b, b))
        dp, dn = add3(across, scale3(0.5 * ddist, n)), add3(scale3(d_t, t), scale3(d_b, b))
        table[k, 0] = ddist
        for c in range(3):
            table[k, 1 + c], table[k, 4 + c] = dp[c], dn[c]
    return True


@compiled
def _radii(job, geom, n, x, t, b):
    """W of a geom at its point x with the outward normal n, as W_tt, W_tb, W_bb."""
    kind = integers(job.geom_kind, job.ngeom)[geom]
    size, R = matrix(job.geom_size, job.ngeom, 3), matrix(job.geom_xmat, job.ngeom, 9)
    r = sub3(x, row3(matrix(job.geom_xpos, job.ngeom, 3), geom))
    axis = (R[geom, 2], R[geom, 5], R[geom, 8])
    if kind == PLANE:
        return FLAT, 0.0, FLAT
    if kind == SPHERE:
        return size[geom, 0], 0.0, size[geom, 0]
    if kind == CAPSULE:
        # x lies a radius beyond the axis
        inside = abs(dot3(axis, sub3(r, scale3(size[geom, 0], n)))) < size[geom, 1] * (1.0 - _ON)
        W = _along(FLAT if inside else 0.0, axis, t, b)
        return W[0] + size[geom, 0], W[1], W[2] + size[geom, 0]
    if kind == ELLIPSOID:
        return _radii_of_ellipsoid(R[geom], size[geom], n, t, b)
    if kind == CYLINDER:
        return _radii_of_cylinder(size[geom], axis, n, r, t, b)
    tt, tb, bb = 0.0, 0.0, 0.0
    if kind == BOX:
        for k in range(3):
            side = (R[geom, k], R[geom, 3 + k], R[geom, 6 + k])
            if abs(dot3(side, r)) < size[geom, k] * (1.0 - _ON):
                W = _along(FLAT, side, t, b)
                tt, tb, bb = tt + W[0], tb + W[1], bb + W[2]
    return tt, tb, bb


@inlined
def _along(radius, a, t, b):
    """W of a radius in one direction."""
    a_t, a_b = dot3(a, t), dot3(a, b)
    return radius * a_t * a_t, radius * a_t * a_b, radius * a_b * a_b


@inlined
def _radii_of_ellipsoid(R, size, n, t, b):
    """W = A A / |A n| - (A A n) (A A n)' / |A n|^3, with A the half axes."""
    tt, tb, bb, n_t, n_b, square = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        side, s = (R[k], R[3 + k], R[6 + k]), size[k] * size[k]
        a_n, a_t, a_b = dot3(side, n), dot3(side, t), dot3(side, b)
        tt, tb, bb = tt + s * a_t * a_t, tb + s * a_t * a_b, bb + s * a_b * a_b
        n_t, n_b, square = n_t + s * a_n * a_t, n_b + s * a_n * a_b, square + s * a_n * a_n
    length = math.sqrt(square)
    return (tt - n_t * n_t / square) / length, (tb - n_t * n_b / square) / length, (bb - n_b * n_b / square) / length


@inlined
def _radii_of_cylinder(size, axis, n, r, t, b):
    """Around its side and along it; flat on a cap; along the rim."""
    along = dot3(axis, r)
    outward = sub3(r, scale3(along, axis))
    if abs(along) < size[1] * (1.0 - _ON):
        W = _along(FLAT, axis, t, b)
        return W[0] + size[0], W[1], W[2] + size[0]
    if math.sqrt(dot3(outward, outward)) < size[0] * (1.0 - _ON):
        return FLAT, 0.0, FLAT
    across = sub3(n, scale3(dot3(axis, n), axis))
    square = dot3(across, across)
    return _along(size[0] / (square * math.sqrt(square)) if square > 1e-12 else FLAT, cross3(axis, across), t, b)


@inlined
def _spin_of_capsule(job, geom, n, theta):
    """Turning about n of a capsule's axis, as projected on the plane."""
    R = matrix(job.geom_xmat, job.ngeom, 9)
    axis = (R[geom, 2], R[geom, 5], R[geom, 8])
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
