"""Derivatives of the forces that a fluid exerts on bodies, in closed form.

Notation
--------
    piece                a body's box of inertia, or an ellipsoid that stands for a geom
    l = X (V - w)        velocity of a piece relative to the wind w, in the piece's own frame (angular part first)
    X                    from spatial vectors to that frame; V = sum S_i v_i, A = sum S_i a_i, V_i, A_i before i's group
    g(l)                 torque and force of the fluid in that frame (MuJoCo's documentation, "Fluid forces")
    B = dg/dl            and B^, what an implicit integrator takes of it: B but for a guard against division by zero
                         that slow and small ellipsoids meet, made symmetric by implicitfast unless it treats the body
                         as free and without joints, like implicit
    W = X' g, K = X' B X

Turning a dof i changes l by X P_i, with P_i = (V_i - w) x S_i, and X A by X R_i, with R_i = A_i x S_i. So

    dW/dq_i = S_i x* W + K P_i,   dW/dv_i = K S_i,

and a dof j feels S_j . dW, less S_j . (S_i x* W) if it moves with i; sums over subtrees do for all pieces at once.
With U = X' B^ X A, the same holds for E, the change of T a, with (U, X' B2 X) in place of (W, K), where
B2 = d(B^ X A)/dl, and another X' B^ X R_i in dU/dq_i.

B2 is taken by steps into the imaginary direction, which are exact.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.complex_numbers import divide, root
from mjslq.dynamics.mujoco.inverse.forces.kinks import sign
from mjslq.dynamics.mujoco.inverse.spatial import (
    add6,
    compiled,
    cross3,
    cross_force,
    cross_motion,
    dot6,
    inlined,
    join,
    put6,
    row3,
    row6,
    scale6,
    sub3,
)
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix, vector
from mjslq.native.memory import carray, pointer

_SHADOW, _MASS, _INERTIA, _ANGULAR = (
    columns.FLUID_SHADOW, columns.FLUID_MASS, columns.FLUID_INERTIA, columns.FLUID_ANGULAR
)  # fmt: skip
_MAGNUS, _KUTTA, _AREA, _WIDEST, _STOKES, _STOKES_TURN, _DENSITY = range(columns.FLUID_REST, columns.FLUID_REST + 7)
_TINY, _STEP = 1e-290, 1e-20
_GUARD = float(mujoco.mjMINVAL)
_NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def _complex(address, rows):
    return carray(pointer(address), (rows, 6), np.complex128)


@compiled
def add_fluid(job, acc, F, T, E):
    """F += df/dz, T += df/dv, E += h d(T a)/dz of the fluid's forces."""
    _sweep(job, acc)
    K, hat, bend = (
        matrix(job.fluid_K, job.nbody, 36),
        matrix(job.fluid_hat, job.nbody, 36),
        matrix(job.fluid_bend, job.nbody, 36),
    )
    W, U = matrix(job.fluid_W, job.nbody, 6), matrix(job.fluid_U, job.nbody, 6)
    cdof, P, R = matrix(job.cdof, job.nv, 6), matrix(job.dof_P, job.nv, 6), matrix(job.dof_R, job.nv, 6)
    for b in range(job.nbody):
        for k in range(36):
            K[b, k], hat[b, k], bend[b, k] = 0.0, 0.0, 0.0
        for k in range(6):
            W[b, k], U[b, k] = 0.0, 0.0
    for n in range(job.nfluid):
        _add_piece(job, n, K, hat, bend, W, U)
    parent = integers(job.body_parentid, job.nbody)
    for b in range(job.nbody - 1, 0, -1):
        if parent[b] > 0:
            for k in range(36):
                K[parent[b], k] += K[b, k]
                hat[parent[b], k] += hat[b, k]
                bend[parent[b], k] += bend[b, k]
            for k in range(6):
                W[parent[b], k] += W[b, k]
                U[parent[b], k] += U[b, k]
    _carry(job, K, W, True, P, 1.0, F, 0)
    _carry(job, K, W, False, cdof, 1.0, F, job.nv)
    if job.implicit == 2:
        _carry(job, hat, U, False, cdof, 1.0, T, 0)
        _carry(job, hat, U, False, R, job.h, E, 0)
        _carry(job, bend, U, True, P, job.h, E, 0)
        _carry(job, bend, U, False, cdof, job.h, E, job.nv)


@compiled
def _sweep(job, acc):
    """V - w and A of the bodies into body_vel and body_acc, P and R of the dofs."""
    parent, first, count = (
        integers(job.body_parentid, job.nbody),
        integers(job.body_dofadr, job.nbody),
        integers(job.body_dofnum, job.nbody),
    )
    group, cdof = integers(job.dof_group, job.nv), matrix(job.cdof, job.nv, 6)
    qvel, wind = vector(job.qvel, job.nv), vector(job.wind, 3)
    V, A = matrix(job.body_vel, job.nbody, 6), matrix(job.body_acc, job.nbody, 6)
    P, R = matrix(job.dof_P, job.nv, 6), matrix(job.dof_R, job.nv, 6)
    put6(V, 0, (0.0, 0.0, 0.0, -wind[0], -wind[1], -wind[2]))
    put6(A, 0, _NOTHING)
    for b in range(1, job.nbody):
        v, a = row6(V, parent[b]), row6(A, parent[b])
        before_v, before_a = v, a
        for i in range(first[b], first[b] + count[b]):
            if group[i] == i:
                before_v, before_a = v, a
            S = row6(cdof, i)
            put6(P, i, cross_motion(before_v, S))
            put6(R, i, cross_motion(before_a, S))
            v, a = add6(v, scale6(qvel[i], S)), add6(a, scale6(acc[i], S))
        put6(V, b, v)
        put6(A, b, a)


@compiled
def _add_piece(job, n, K, hat, bend, W, U):
    """Add a piece's K, X' B^ X, X' B2 X, W, U to those of its body."""
    b, g = integers(job.fluid_body, job.nfluid)[n], integers(job.fluid_geom, job.nfluid)[n]
    prm = matrix(job.fluid_prm, job.nfluid, columns.FLUID_NUMBERS)[n]
    X, by_l, by_hat, by_bend = (
        matrix(job.fluid_X, 6, 6), matrix(job.fluid_B, 6, 6), matrix(job.fluid_B + 288, 6, 6),
        matrix(job.fluid_B + 576, 6, 6),
    )  # fmt: skip
    local = matrix(job.fluid_local, 4, 6)
    com = row3(matrix(job.subtree_com, job.nbody, 3), integers(job.body_rootid, job.nbody)[b])
    if g >= 0:
        _frame(X, sub3(row3(matrix(job.geom_xpos, job.ngeom, 3), g), com), matrix(job.geom_xmat, job.ngeom, 9)[g])
    else:
        _frame(X, sub3(row3(matrix(job.xipos, job.nbody, 3), b), com), matrix(job.ximat, job.nbody, 9)[b])
    V, A = matrix(job.body_vel, job.nbody, 6), matrix(job.body_acc, job.nbody, 6)
    for r in range(6):
        local[0, r], local[1, r] = 0.0, 0.0
        for c in range(6):
            local[0, r] += X[r, c] * V[b, c]
            local[1, r] += X[r, c] * A[b, c]
            by_l[r, c], by_hat[r, c], by_bend[r, c] = 0.0, 0.0, 0.0
    if g >= 0:
        last = integers(job.body_lastdof, job.nbody)[b]
        free = last >= 0 and integers(job.dof_gyroscopic, job.nv)[last] == 1
        _ellipsoid(job, prm, local, by_l, by_hat, by_bend, job.symmetric == 1 and not free)
    else:
        _box(prm, local, by_l, by_hat, by_bend)
    for c in range(6):
        for r in range(6):
            W[b, c] += X[r, c] * local[2, r]
            U[b, c] += X[r, c] * local[3, r]
    _add_congruent(X, by_l, K[b])
    if job.implicit == 2:
        _add_congruent(X, by_hat, hat[b])
        _add_congruent(X, by_bend, bend[b])


@inlined
def _frame(X, x, R):
    """X of a frame at x with the axes R."""
    for r in range(3):
        axis = (R[r], R[3 + r], R[6 + r])
        put6(X, r, join(axis, (0.0, 0.0, 0.0)))
        put6(X, 3 + r, join(cross3(x, axis), axis))


@compiled
def _add_congruent(X, B, out):
    """Add X' B X to six rows of six, one after the other."""
    for r in range(6):
        for c in range(6):
            if B[r, c] != 0.0:
                for i in range(6):
                    factor = X[r, i] * B[r, c]
                    for j in range(6):
                        out[6 * i + j] += factor * X[c, j]


@compiled
def _carry(job, K, W, turns, field, scale, out, first):
    """Add scale (K f_i + S_i x* W), f_i a row of `field`, as felt by all dofs, to the columns first + i."""
    body, parent = integers(job.dof_bodyid, job.nv), integers(job.dof_parentid, job.nv)
    group, end = integers(job.dof_group, job.nv), integers(job.dof_groupend, job.nv)
    cdof = matrix(job.cdof, job.nv, 6)
    for i in range(job.nv):
        b, S, f = body[i], row6(cdof, i), row6(field, i)
        column, row = _NOTHING, _NOTHING
        for k in range(6):
            line = (K[b, 6 * k], K[b, 6 * k + 1], K[b, 6 * k + 2], K[b, 6 * k + 3], K[b, 6 * k + 4], K[b, 6 * k + 5])
            row = add6(row, scale6(cdof[i, k], line))
            change = dot6(line, f)
            column = add6(column, _unit(k, change))
        if turns:
            column = add6(column, cross_force(S, row6(W, b)))
        for j in range(i + 1, end[i]):
            out[i, first + j] += scale * dot6(row, row6(field, j))
        j = i
        while j >= 0:
            out[i, first + j] += scale * dot6(row, row6(field, j))
            if group[j] != group[i]:
                out[j, first + i] += scale * dot6(row6(cdof, j), column)
            j = parent[j]


@inlined
def _unit(k, x):
    return (
        x if k == 0 else 0.0, x if k == 1 else 0.0, x if k == 2 else 0.0,
        x if k == 3 else 0.0, x if k == 4 else 0.0, x if k == 5 else 0.0,
    )  # fmt: skip


@compiled
def _box(prm, local, by_l, by_hat, by_bend):
    """Write g, B^ X A and their derivatives of a box: -(c + d |l|) l in each coordinate."""
    for r in range(6):
        x, drag = local[0, r], prm[6 + r]
        local[2, r] = -(prm[r] + drag * abs(x)) * x
        by_l[r, r] = by_hat[r, r] = -prm[r] - 2.0 * drag * abs(x)
        local[3, r] = by_hat[r, r] * local[1, r]
        by_bend[r, r] = -2.0 * drag * sign(x) * local[1, r]


@compiled
def _ellipsoid(job, prm, local, by_l, by_hat, by_bend, symmetric):
    """Write g, B^ X A and their derivatives of an ellipsoid."""
    work = _complex(job.fluid_complex, 8)
    x, g, B = work[0], work[1], work[2:8]
    for r in range(6):
        x[r] = local[0, r]
    _force(prm, x, g)
    _slope(prm, x, B, _TINY)
    for r in range(6):
        for k in range(6):
            by_l[r, k] = B[r, k].real
    for c in range(6 if job.implicit == 2 else 0):
        x[c] += 1j * _STEP
        _slope(prm, x, B, _GUARD)
        x[c] = local[0, c]
        for r in range(6):
            for k in range(6):
                entry = 0.5 * (B[r, k] + B[k, r]) if symmetric else B[r, k]
                by_hat[r, k] = entry.real
                by_bend[r, c] += entry.imag / _STEP * local[1, k]
    for r in range(6):
        local[2, r], local[3, r] = g[r].real, 0.0
        for k in range(6):
            local[3, r] += by_hat[r, k] * local[1, k]


@inlined
def _at_least(x):
    """Keep a denominator away from zero: without velocity the numerators vanish."""
    return x if abs(x) > _TINY else _TINY + 0j


@inlined
def _shadow(prm, v):
    """Sums of a v^2, a^2 v^2 and v^2, with a the squared products of two semiaxes."""
    near, far, square = 0j, 0j, 0j
    for i in range(3):
        near += prm[_SHADOW + i] * v[i] * v[i]
        far += prm[_SHADOW + i] ** 2 * v[i] * v[i]
        square += v[i] * v[i]
    return near, far, square


@compiled
def _force(prm, x, g):
    """g(x): added mass, Magnus and Kutta lift, drag."""
    w, v = x[0:3], x[3:6]
    near, far, square = _shadow(prm, v)
    speed, spin = root(square), 0j
    for i in range(3):
        spin += (prm[_ANGULAR + i] * w[i]) ** 2
    area = math.pi * root(divide(far, _at_least(near)))
    lift = divide(prm[_KUTTA] * near, _at_least(speed * far)) * area
    drag = prm[_STOKES] + speed * (prm[_AREA] * area + prm[_WIDEST])
    turning = prm[_STOKES_TURN] + prm[_DENSITY] * root(spin)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        g[i] = (prm[_INERTIA + j] - prm[_INERTIA + k]) * w[j] * w[k] - turning * w[i]
        g[i] += (prm[_MASS + j] - prm[_MASS + k]) * v[j] * v[k]
        g[3 + i] = prm[_MASS + j] * v[j] * w[k] - prm[_MASS + k] * v[k] * w[j]
        g[3 + i] += prm[_MAGNUS] * (w[j] * v[k] - w[k] * v[j]) - drag * v[i]
        g[3 + i] += lift * (near - prm[_SHADOW + i] * square) * v[i]


@compiled
def _slope(prm, x, B, guard):
    """B = dg/dx, the quadratic drag of turning divided by no less than `guard`."""
    w, v = x[0:3], x[3:6]
    near, far, square = _shadow(prm, v)
    speed, spin = root(square), 0j
    for i in range(3):
        spin += (prm[_ANGULAR + i] * w[i]) ** 2
        for j in range(6):
            B[i, j] = B[3 + i, j] = 0j
    area = math.pi * root(divide(far, _at_least(near)))
    whole = divide(prm[_AREA] * area + prm[_WIDEST], _at_least(speed))
    spread = divide(prm[_AREA] * speed * math.pi, _at_least(root(near * near * near * far)))
    lift = divide(math.pi * prm[_KUTTA], _at_least(root(far * near * square)))
    swirl = root(spin)
    turning = divide(prm[_DENSITY], swirl if abs(swirl) > guard else guard + 0j)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        B[i, j] += (prm[_INERTIA + j] - prm[_INERTIA + k]) * w[k]
        B[i, k] += (prm[_INERTIA + j] - prm[_INERTIA + k]) * w[j]
        B[i, 3 + j] += (prm[_MASS + j] - prm[_MASS + k]) * v[k]
        B[i, 3 + k] += (prm[_MASS + j] - prm[_MASS + k]) * v[j]
        B[3 + i, j] += (prm[_MAGNUS] - prm[_MASS + k]) * v[k]
        B[3 + i, k] += (prm[_MASS + j] - prm[_MAGNUS]) * v[j]
        B[3 + i, 3 + j] += (prm[_MASS + j] - prm[_MAGNUS]) * w[k]
        B[3 + i, 3 + k] += (prm[_MAGNUS] - prm[_MASS + k]) * w[j]
        B[i, i] -= prm[_STOKES_TURN] + turning * spin
        side = near - prm[_SHADOW + i] * square  # sum of (a_k - a_i) v_k^2
        B[3 + i, 3 + i] += lift * side * near - prm[_STOKES] - whole * square
        for m in range(3):
            a = prm[_SHADOW + m]
            B[i, m] -= turning * w[i] * prm[_ANGULAR + m] ** 2 * w[m]
            widening = spread * a * v[m] * (a * near - far)
            inner = divide(a * a * near, _at_least(far)) - a + divide(near, _at_least(square))
            B[3 + i, 3 + m] -= (whole * v[m] + widening) * v[i]
            B[3 + i, 3 + m] += lift * v[i] * v[m] * (2.0 * near * (a - prm[_SHADOW + i]) - side * inner)
