"""How the contacts of two geoms move, by differences in the geoms' relative pose.

What a pair of geoms touch each other with depends on six numbers alone, however many dofs move them. Geom 2 is turned
about and moved along the world's axes, geom 1 stays, and MuJoCo's own narrow phase for the pair (the function
that it keeps in mjCOLLISIONFUNC) is asked again, and nothing else: no kinematics, no broad phase, no other pair. The
result is the table of `geometry`, for all contacts of the pair at once.

Contacts of the moved geoms are matched with those at the knot by nearness. Where a contact is found on one side of the
difference only (a corner that comes or goes), the difference is taken to this side; where on neither, its features are
frozen: the normal stays with geom 1, the point with geom 2.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.spatial import compiled, cross3, dot3, inlined, row3, sub3
from mjslq.dynamics.mujoco.inverse.table.columns import CYLINDER, ELLIPSOID
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, entry_count, flags, integers, matrix, vector
from mjslq.native.declare import intrinsic

MOST = int(mujoco.mjMAXCONPAIR)
"""Contacts that two geoms can have."""
_DIST, _POS, _NORMAL, _PRECONTACT = 0, 1, 4, 10
WIDTH = 0.1
"""Width of differences of positions alone, in units of the job's eps: no solver's noise is in them, kinks are near."""
_COARSER = 10.0
"""Width of those of contacts that MuJoCo finds by iteration, in units of that: its tolerance is noise in them."""
_REACH, _TURN = 1e3, 1e4
"""How far a contact, and its normal, may move and still be the same, in units of the width."""


def _call(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    from llvmlite import ir

    i64, i32 = ir.IntType(64), ir.IntType(32)
    kind = ir.FunctionType(i32, [i64, i64, i64, i32, i32, ir.DoubleType()])
    return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])


_collide = intrinsic(_call, "int32(int64, int64, int64, int64, int32, int32, float64)")
"""Call one of MuJoCo's collision functions, given by its address: (function, model, data, found, g1, g2, margin)."""


@compiled
def first_of_pair(job, contact):
    """Address of the first contact of the geoms of this one; they follow on each other."""
    geoms, size = flags(contact + job.at_contact_geom, 2), job.at_contact_size
    start = entry_address(job.data + job.at_contact)
    while contact > start and _same_geoms(job, contact - size, geoms):
        contact -= size
    return contact


@inlined
def _same_geoms(job, contact, geoms):
    other = flags(contact + job.at_contact_geom, 2)
    return other[0] == geoms[0] and other[1] == geoms[1]


@compiled
def fill_by_differences(job, first):
    """Write the tables of all contacts of a pair of geoms, the first at address `first`, into job.tables."""
    geoms, size, count = flags(first + job.at_contact_geom, 2), job.at_contact_size, 1
    end = entry_address(job.data + job.at_contact) + size * entry_count(job.data + job.at_ncon)
    while count < MOST and first + count * size < end and _same_geoms(job, first + count * size, geoms):
        count += 1
    xpos, xmat = matrix(job.geom_xpos, job.ngeom, 3)[geoms[1]], matrix(job.geom_xmat, job.ngeom, 9)[geoms[1]]
    point = vector(first + job.at_contact_pos, 3)
    pivot, place = (point[0], point[1], point[2]), (xpos[0], xpos[1], xpos[2])
    pose = vector(job.small, 9)
    for k in range(9):
        pose[k] = xmat[k]
    kinds = integers(job.geom_type, job.ngeom)
    function = entry_address(job.collision_functions + 8 * (kinds[geoms[0]] * job.geom_types + kinds[geoms[1]]))
    margin = vector(first + job.at_contact_includemargin, 1)[0] + _gap(job, geoms)
    found = matrix(job.found, 2 * MOST, _PRECONTACT)
    eps = _width(job, geoms)
    for k in range(6):
        plus, minus = 0, 0
        for side in range(2 if job.centered else 1):
            _move(k, -eps if side else eps, pivot, place, pose, xpos, xmat)
            into = job.found + 8 * MOST * _PRECONTACT * side
            touching = _collide(function, job.model, job.data, into, np.int32(geoms[0]), np.int32(geoms[1]), margin)
            plus, minus = (plus, touching) if side else (touching, minus)
        for c in range(count):
            contact, table = first + c * size, matrix(job.tables + 8 * 42 * c, 6, 7)
            _difference(job, contact, eps, found[:plus], found[MOST : MOST + minus], table[k])
            if _is_missing(table[k]):
                _freeze(job, contact, k, pivot, table[k])
    for k in range(9):
        xmat[k] = pose[k]
    xpos[0], xpos[1], xpos[2] = place
    for c in range(count):
        _shift(job, first + c * size, pivot, matrix(job.tables + 8 * 42 * c, 6, 7))


@inlined
def _gap(job, geoms):
    """What the narrow phase is asked for beyond the contact's own margin."""
    pairs, gaps = integers(job.pair_geoms, 2 * job.npair), vector(job.pair_gap, job.npair)
    for k in range(job.npair):
        one, other = pairs[2 * k], pairs[2 * k + 1]
        if (one == geoms[0] and other == geoms[1]) or (one == geoms[1] and other == geoms[0]):
            return gaps[k]
    own = vector(job.geom_gap, job.ngeom)
    return own[geoms[0]] + own[geoms[1]]


@compiled
def _move(k, eps, pivot, place, pose, xpos, xmat):
    """Turn a geom about the axis k through the pivot, or move it along the axis k - 3."""
    r = sub3(place, pivot)
    for c in range(9):
        xmat[c] = pose[c]
    xpos[0], xpos[1], xpos[2] = place
    if k >= 3:
        xpos[k - 3] += eps
        return
    i, j, sine, cosine = (k + 1) % 3, (k + 2) % 3, math.sin(eps), math.cos(eps)
    along, across = _entry(r, i), _entry(r, j)
    xpos[i] = _entry(pivot, i) + cosine * along - sine * across
    xpos[j] = _entry(pivot, j) + sine * along + cosine * across
    for c in range(3):
        xmat[3 * i + c] = cosine * pose[3 * i + c] - sine * pose[3 * j + c]
        xmat[3 * j + c] = sine * pose[3 * i + c] + cosine * pose[3 * j + c]


@inlined
def _width(job, geoms):
    """Width of the differences for a pair of geoms."""
    kinds = integers(job.geom_kind, job.ngeom)
    one, other = kinds[geoms[0]], kinds[geoms[1]]
    round_ = one in (ELLIPSOID, CYLINDER) or other in (ELLIPSOID, CYLINDER)
    return WIDTH * job.eps * (_COARSER if round_ else 1.0)


@inlined
def _entry(a, i):
    """Entry i of three numbers; an index into a tuple may raise an exception, which kernels must not."""
    return a[0] if i == 0 else a[1] if i == 1 else a[2]


@compiled
def _difference(job, contact, eps, plus, minus, row):
    """Write a row of a contact's table: (ddist, dp, dn), or nan where the contact is found on neither side."""
    dist, pos = vector(contact + job.at_contact_dist, 1), vector(contact + job.at_contact_pos, 3)
    frame = vector(contact + job.at_contact_frame, 9)
    p, m = _nearest(plus, pos, frame, eps), _nearest(minus, pos, frame, eps)
    apart = 1.0 / ((eps if p >= 0 else 0.0) + (eps if m >= 0 else 0.0))
    for c in range(7):
        here = dist[0] if c == 0 else pos[c - 1] if c < 4 else frame[c - 4]
        row[c] = ((plus[p, c] if p >= 0 else here) - (minus[m, c] if m >= 0 else here)) * apart


@compiled
def _nearest(found, pos, frame, eps):
    """Which of the contacts found is the one at `pos`; -1 when none is within reach."""
    best, least, most = -1, (_REACH * eps) ** 2, (_TURN * eps) ** 2
    for k in range(found.shape[0]):
        square, turned = 0.0, 0.0
        for c in range(3):
            square += (found[k, _POS + c] - pos[c]) ** 2
            turned += (found[k, _NORMAL + c] - frame[c]) ** 2
        if square < least and turned < most:
            best, least = k, square
    return best


@inlined
def _is_missing(row):
    return not math.isfinite(row[0])


@compiled
def _freeze(job, contact, k, pivot, row):
    """Write a row of the table of a contact whose normal stays with geom 1 and whose point stays with geom 2."""
    point, n = vector(contact + job.at_contact_pos, 3), row3(matrix(contact + job.at_contact_frame, 3, 3), 0)
    one = (1.0 if k % 3 == 0 else 0.0, 1.0 if k % 3 == 1 else 0.0, 1.0 if k % 3 == 2 else 0.0)
    motion = cross3(one, sub3((point[0], point[1], point[2]), pivot)) if k < 3 else one
    ddist = dot3(n, motion)
    row[0] = ddist
    for c in range(3):
        row[1 + c], row[4 + c] = motion[c] - 0.5 * ddist * n[c], 0.0


@compiled
def _shift(job, contact, pivot, table):
    """Make a table for turning about the pivot one for turning about the contact's point."""
    point = vector(contact + job.at_contact_pos, 3)
    for k in range(3):
        one = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
        # a turning about p moves the pivot
        moved = cross3(one, sub3(pivot, (point[0], point[1], point[2])))
        for c in range(7):
            table[k, c] += moved[0] * table[3, c] + moved[1] * table[4, c] + moved[2] * table[5, c]
