"""Derivatives of what a rangefinder reads: the distance along a ray from a site to the surface that it meets.

Notation
--------
    o, z, t      origin and direction of the ray, its length; p = o + t z where it meets a geom
    n            normal of the geom there
    dp_i, dg_i   motion of the point p per unit of dof i, were it fixed in the site's body, and in the geom's

The ray's end stays on the surface, n . (dp_i + z dt - dg_i) = 0, so that dt_i = n . (dg_i - dp_i) / (n . z): what
moves both moves nothing. The bends of surfaces do not matter to first order. A ray that meets nothing reads -1.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.readings.frames import clear_rows
from mjslq.dynamics.mujoco.inverse.spatial import compiled, dot3, row3, row6, sub3, velocity_at
from mjslq.dynamics.mujoco.inverse.table.job import flags, integers, matrix, vector
from mjslq.native.declare import external

mj_ray = external("mj_ray", "float64(intp, intp, intp, intp, intp, uint8, int32, intp, intp)")
_GRAZING = 1e-9


@compiled
def write_range(job, s, row, C, D):
    """Row of a rangefinder's distance."""
    site, small = integers(job.sen_target, job.nsensor)[s], vector(job.small, 9)
    body = integers(job.site_bodyid, job.nsite)[site]
    at, turn = matrix(job.site_xpos, job.nsite, 3), matrix(job.site_xmat, job.nsite, 9)
    clear_rows(C, D, row, 1)
    for k in range(3):
        small[k], small[3 + k] = at[site, k], turn[site, 2 + 3 * k]
    hit = flags(job.small + 72, 1)
    t = mj_ray(
        job.model, job.data, job.small, job.small + 24, 0, 1, body, job.small + 72, job.small + 48
    )  # fmt: skip
    z, n = (small[3], small[4], small[5]), (small[6], small[7], small[8])
    slope = dot3(n, z)
    if t < 0.0 or hit[0] < 0 or abs(slope) < _GRAZING:
        return
    p = (small[0] + t * z[0], small[1] + t * z[1], small[2] + t * z[2])
    _add_motion(job, body, p, n, -1.0 / slope, C[row])
    _add_motion(job, integers(job.geom_bodyid, job.ngeom)[hit[0]], p, n, 1.0 / slope, C[row])


@compiled
def _add_motion(job, body, p, n, scale, row):
    """Add n . (motion of the point p of a body with each dof), times a number."""
    com, root = matrix(job.subtree_com, job.nbody, 3), integers(job.body_rootid, job.nbody)
    parent, cdof = integers(job.dof_parentid, job.nv), matrix(job.cdof, job.nv, 6)
    x, i = sub3(p, row3(com, root[body])), integers(job.body_lastdof, job.nbody)[body]
    while i >= 0:
        row[i] += scale * dot3(n, velocity_at(row6(cdof, i), x))
        i = parent[i]
