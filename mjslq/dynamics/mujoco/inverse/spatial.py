"""Spatial vectors as plain tuples of six numbers, for compiled code.

Notation
--------
    s = (a, b)        a motion: angular part first, linear part last, as MuJoCo keeps it in cdof and cvel
    f = (n, p)        a force: moment first, force last
    v x s             motion cross product            v x* f       force cross product, its negative transpose
    I                 ten numbers, MuJoCo's cinert: Ixx Iyy Izz Ixy Ixz Iyz, m c, m

All vectors of one kinematic tree stand in one frame: the world's axes, about the tree's centre of mass.
Tuples live in registers, so nothing is allocated. (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 2.)
"""

from __future__ import annotations

from mjslq.native.declare import helper

compiled = helper()
inlined = helper(forceinline=True)


@inlined
def row3(A, i):
    """Three numbers at the head of row i."""
    return A[i, 0], A[i, 1], A[i, 2]


@inlined
def row6(A, i):
    """Row i of an array with six columns."""
    return A[i, 0], A[i, 1], A[i, 2], A[i, 3], A[i, 4], A[i, 5]


@inlined
def put6(A, i, s):
    """Write row i."""
    A[i, 0], A[i, 1], A[i, 2], A[i, 3], A[i, 4], A[i, 5] = s


@inlined
def head(s):
    """Angular part of a motion, moment of a force."""
    return s[0], s[1], s[2]


@inlined
def tail(s):
    """Linear part of a motion, force of a force."""
    return s[3], s[4], s[5]


@inlined
def add3(a, b):
    """Sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def sub3(a, b):
    """Difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def scale3(c, a):
    """Product with a number."""
    return c * a[0], c * a[1], c * a[2]


@inlined
def dot3(a, b):
    """Inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross3(a, b):
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def join(a, b):
    """Six numbers of two threes."""
    return a[0], a[1], a[2], b[0], b[1], b[2]


@inlined
def add6(s, t):
    """Sum."""
    return s[0] + t[0], s[1] + t[1], s[2] + t[2], s[3] + t[3], s[4] + t[4], s[5] + t[5]


@inlined
def sub6(s, t):
    """Difference."""
    return s[0] - t[0], s[1] - t[1], s[2] - t[2], s[3] - t[3], s[4] - t[4], s[5] - t[5]


@inlined
def scale6(c, s):
    """Product with a number."""
    return c * s[0], c * s[1], c * s[2], c * s[3], c * s[4], c * s[5]


@inlined
def dot6(s, t):
    """Power of a force on a motion."""
    return s[0] * t[0] + s[1] * t[1] + s[2] * t[2] + s[3] * t[3] + s[4] * t[4] + s[5] * t[5]


@inlined
def cross_motion(v, s):
    """V x s."""
    w = head(v)
    return join(cross3(w, head(s)), add3(cross3(w, tail(s)), cross3(tail(v), head(s))))


@inlined
def cross_force(v, f):
    """V x* f."""
    w = head(v)
    return join(add3(cross3(w, head(f)), cross3(tail(v), tail(f))), cross3(w, tail(f)))


@inlined
def inertia_times(inertia, k, s):
    """Row k of the inertias times a motion: a momentum, or a force."""
    h = (inertia[k, 6], inertia[k, 7], inertia[k, 8])
    a, b, mass = head(s), tail(s), inertia[k, 9]
    turn = (
        inertia[k, 0] * a[0] + inertia[k, 3] * a[1] + inertia[k, 4] * a[2],
        inertia[k, 3] * a[0] + inertia[k, 1] * a[1] + inertia[k, 5] * a[2],
        inertia[k, 4] * a[0] + inertia[k, 5] * a[1] + inertia[k, 2] * a[2],
    )
    return join(add3(turn, cross3(h, b)), sub3(scale3(mass, b), cross3(h, a)))


@inlined
def velocity_at(s, x):
    """Velocity of the point x (relative to the tree's centre of mass) that moves with s."""
    return add3(tail(s), cross3(head(s), x))


@inlined
def quaternion_product(p, q):
    """The turning q, then p."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


@inlined
def turned(q, a):
    """Turn a vector by a unit quaternion."""
    u = (q[1], q[2], q[3])
    t = scale3(2.0, cross3(u, a))
    return add3(add3(a, scale3(q[0], t)), cross3(u, t))
