"""Action and reaction between two bodies: how the generalized forces of a wrench change with a dof.

Notation
--------
    body 2, body 1       body 2 feels the wrench W = (couple, force), body 1 its opposite; each at a point of its own
    x                    that point, relative to the centre of mass of the body's tree
    sides                which bodies a dof i moves: 1, 2, or 3 for both
    dforce, dcouple      change of the wrench at its point; dx: motion of the point

Taken about the tree's centre of mass, W changes by dW = (dcouple + dx x force + x x dforce, dforce), and the
generalized force S_j . W of a dof j that moves body 2 by

    S_j . dW for j before i's group, or not beyond i at all,      S_j . (dW - S_i x* W) for the others;

for dofs that move body 1 the same with the other sign.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    compiled,
    cross3,
    cross_force,
    dot6,
    head,
    inlined,
    join,
    row3,
    row6,
    sub3,
    sub6,
    tail,
)
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix


@compiled
def mark_members(job, bodies):
    """Write into job.member which of the two bodies each dof moves, as `sides`."""
    member, parent = integers(job.member, job.nv), integers(job.dof_parentid, job.nv)
    for i in range(job.nv):
        member[i] = 0
    for side in range(2):
        i = integers(job.body_lastdof, job.nbody)[bodies[side]]
        while i >= 0:
            member[i] |= side + 1
            i = parent[i]


@inlined
def from_center(job, body, point):
    """A point relative to the centre of mass of a body's tree."""
    return sub3(point, row3(matrix(job.subtree_com, job.nbody, 3), integers(job.body_rootid, job.nbody)[body]))


@compiled
def add_force_change(job, column, i, sides, bodies, points, W, change, moves, F):
    """Add to a column of F what dof i (sides 0: nothing moves) and the `change` of the wrench W do to all forces.

    `points` and `moves` have the point x and its motion dx of body 1 and of body 2.
    """
    lastdof, parent = integers(job.body_lastdof, job.nbody), integers(job.dof_parentid, job.nv)
    group, cdof = integers(job.dof_group, job.nv), matrix(job.cdof, job.nv, 6)
    force, dforce = tail(W), tail(change)
    for side in range(2):
        x, sign = points[side], 2.0 * side - 1.0
        couple = add3(add3(head(change), cross3(moves[side], force)), cross3(x, dforce))
        whole = join(couple, dforce)
        turned = sub6(whole, cross_force(row6(cdof, i), join(add3(head(W), cross3(x, force)), force)))
        beyond = group[i] if sides & (side + 1) else job.nv
        j = lastdof[bodies[side]]
        while j >= 0:
            F[j, column] += sign * dot6(row6(cdof, j), turned if group[j] >= beyond else whole)
            j = parent[j]
