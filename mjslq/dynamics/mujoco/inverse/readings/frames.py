"""Frames fixed in bodies, and bodies' and dofs' order in the tree, for sensors."""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.spatial import add3, inlined, quaternion_product, row3, sub3, turned
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix


@inlined
def clear_rows(C, D, row, size):
    """Set rows of C and D to zero."""
    for k in range(row, row + size):
        for c in range(C.shape[1]):
            C[k, c] = 0.0
        for c in range(D.shape[1]):
            D[k, c] = 0.0


@inlined
def pose(job, body, prm):
    """Place relative to the centre of mass of the tree, place in the world, and quaternion of a frame in a body."""
    xpos, xquat, com = (
        matrix(job.xpos, job.nbody, 3),
        matrix(job.xquat, job.nbody, 4),
        matrix(job.subtree_com, job.nbody, 3),
    )
    q = (xquat[body, 0], xquat[body, 1], xquat[body, 2], xquat[body, 3])
    p = add3(row3(xpos, body), turned(q, (prm[0], prm[1], prm[2])))
    x = sub3(p, row3(com, integers(job.body_rootid, job.nbody)[body]))
    return x, p, quaternion_product(q, (prm[3], prm[4], prm[5], prm[6]))


@inlined
def is_below(job, b, top):
    """Whether body b belongs to the subtree of body `top`."""
    parent = integers(job.body_parentid, job.nbody)
    while b > top:
        b = parent[b]
    return b == top


@inlined
def moves(job, i, last):
    """Whether dof i is `last` or one of its ancestors."""
    parent = integers(job.dof_parentid, job.nv)
    while last > i:
        last = parent[last]
    return last == i
