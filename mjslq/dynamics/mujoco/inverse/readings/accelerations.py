"""Derivatives of sensors that feel accelerations: accelerometers, and the rigid bodies' part of force and torque.

Notation (spatial vectors: `spatial`; P_i, Q_i, R_i, Y, I^C, h^C = (n, p), f^C: `rigid`)
--------
    a_c                  acceleration at which MuJoCo reads its sensors, and acc_rate = da_c/dz (`kernel`)
    V, a                 spatial velocity and acceleration of the sensor's body; the world's is -gravity
    p, x                 the sensor's place, and the same relative to the centre of mass of the tree
    dp_i                 motion of p with dof i, S_i at x; theta_i its turning

A dof i that moves the body changes, at fixed dof velocities and accelerations,

    dV_i = P_i - V x S_i,     da_i = R_i - a x S_i - V x P_i,     and with its velocity    da_i = Q_i - V x S_i.

A point accelerates with alpha = a at x + w x (V at x), and an accelerometer reads R' alpha:

    dalpha_i = da_i at x + a_ang x dp_i + w_i x (V at x) + w x (dV_i at x + w x dp_i),   less theta_i x alpha within R'.

What a body exerts on its parent is f = f^C - (contacts with its subtree); with k = b for dofs before or at b, and the
dof's own body for dofs beyond,

    df_i = 2 B P_i + I^C_k R_i + S_i x* f^C_k,    2 B S_i + I^C_k Q_i by velocity,    I^C_k S_i by acceleration.

The part of a_c's own change is sum_j lever_j da_c,j/dz, with lever_j the derivative by the acceleration of dof j: it is
added at the end, for all that one sensor feels at once.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.readings.frames import clear_rows, is_below, moves, pose
from mjslq.dynamics.mujoco.inverse.rigid import symmetric_times
from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    add6,
    compiled,
    cross3,
    cross_force,
    cross_motion,
    head,
    inertia_times,
    inlined,
    join,
    row6,
    scale3,
    sub3,
    sub6,
    tail,
    turned,
    velocity_at,
)  # fmt: skip
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix


@compiled
def clear_lever(job):
    """Start with a sensor that feels no acceleration."""
    lever = matrix(job.lever, job.nv, 3)
    for j in range(job.nv):
        lever[j, 0] = lever[j, 1] = lever[j, 2] = 0.0


@compiled
def add_acceleration(job, row, count, C, D):
    """C, D += lever' da_c/dz in `count` rows."""
    lever, rate = matrix(job.lever, job.nv, 3), matrix(job.acc_rate, job.nv, job.columns)
    ndx = C.shape[1]
    for j in range(job.nv):
        for k in range(count):
            arm = lever[j, k]
            if arm != 0.0:
                for c in range(ndx):
                    C[row + k, c] += arm * rate[j, c]
                for c in range(job.nu):
                    D[row + k, c] += arm * rate[j, ndx + c]


@inlined
def put_dof(job, row, i, back, by_q, by_v, by_a, C):
    """Enter what dof i does, turned into the sensor's frame, into three rows and the lever."""
    lever = matrix(job.lever, job.nv, 3)
    by_q, by_v, by_a = turned(back, by_q), turned(back, by_v), turned(back, by_a)
    for k in range(3):
        C[row + k, i] += by_q[k]
        C[row + k, job.nv + i] += by_v[k]
        lever[i, k] += by_a[k]


@compiled
def write_acceleration(job, s, kind, row, C, D):
    """Acceleration of a frame: of its origin (in the world's axes, or its own), or angular."""
    body = integers(job.sen_body, job.nsensor)[s]
    vel, acc = matrix(job.body_vel, job.nbody, 6), matrix(job.body_acc, job.nbody, 6)
    P, Q, R = matrix(job.dof_P, job.nv, 6), matrix(job.dof_Q, job.nv, 6), matrix(job.dof_R, job.nv, 6)
    parent, cdof = integers(job.dof_parentid, job.nv), matrix(job.cdof, job.nv, 6)
    x, _, q = pose(job, body, matrix(job.sen_prm, job.nsensor, columns.FRAME_NUMBERS)[s][:7])
    V, a = row6(vel, body), row6(acc, body)
    w, at_x = head(V), velocity_at(V, x)
    alpha = add3(velocity_at(a, x), cross3(w, at_x))
    local = kind == columns.LOCAL_ACC
    back = (q[0], -q[1], -q[2], -q[3]) if local else (1.0, 0.0, 0.0, 0.0)
    clear_rows(C, D, row, 3)
    clear_lever(job)
    i = integers(job.body_lastdof, job.nbody)[body]
    while i >= 0:
        S = row6(cdof, i)
        own = cross_motion(V, S)
        moved = sub6(row6(P, i), own)
        by_q = sub6(sub6(row6(R, i), cross_motion(a, S)), cross_motion(V, row6(P, i)))
        by_v = sub6(row6(Q, i), own)
        if kind == columns.FRAME_SPIN:
            put_dof(job, row, i, back, head(by_q), head(by_v), head(S), C)
        else:
            dp = velocity_at(S, x)
            turning = add3(velocity_at(moved, x), cross3(w, dp))
            change = add3(velocity_at(by_q, x), cross3(head(a), dp))
            change = add3(change, add3(cross3(head(moved), at_x), cross3(w, turning)))
            if local:
                change = sub3(change, cross3(head(S), alpha))
            drag = add3(velocity_at(by_v, x), add3(cross3(head(S), at_x), cross3(w, dp)))
            put_dof(job, row, i, back, change, drag, dp, C)
        i = parent[i]
    add_acceleration(job, row, np.int64(3), C, D)


@inlined
def _coriolis(job, k, s):
    """2 B s of the subtree of body k."""
    momentum = row6(matrix(job.body_momentum, job.nbody, 6), k)
    a = head(s)
    turn = sub3(symmetric_times(matrix(job.body_Y, job.nbody, 6), k, a), cross3(head(momentum), a))
    return join(turn, scale3(-2.0, cross3(tail(momentum), a)))


@compiled
def add_inertial_force(job, s, kind, row, C):
    """Force or torque that the inertia of a subtree exerts on its parent, at the sensor and in its axes."""
    body = integers(job.sen_body, job.nsensor)[s]
    force, inertia = matrix(job.body_force, job.nbody, 6), matrix(job.body_inertia, job.nbody, 10)
    P, Q, R = matrix(job.dof_P, job.nv, 6), matrix(job.dof_Q, job.nv, 6), matrix(job.dof_R, job.nv, 6)
    dof_body, cdof = integers(job.dof_bodyid, job.nv), matrix(job.cdof, job.nv, 6)
    last = integers(job.body_lastdof, job.nbody)[body]
    x, _, q = pose(job, body, matrix(job.sen_prm, job.nsensor, columns.FRAME_NUMBERS)[s][:7])
    back = (q[0], -q[1], -q[2], -q[3])
    whole = row6(force, body)
    couple = sub3(head(whole), cross3(x, tail(whole)))
    for i in range(job.nv):
        within, carries = is_below(job, dof_body[i], body), moves(job, i, last)
        if not (within or carries):
            continue
        k, S = dof_body[i] if within else body, row6(cdof, i)
        by_q = add6(_coriolis(job, k, row6(P, i)), inertia_times(inertia, k, row6(R, i)))
        by_q = add6(by_q, cross_force(S, row6(force, k)))
        by_v = add6(_coriolis(job, k, S), inertia_times(inertia, k, row6(Q, i)))
        by_a = inertia_times(inertia, k, S)
        if kind == columns.FORCE:
            change = tail(by_q)
            if carries:
                change = sub3(change, cross3(head(S), tail(whole)))
            put_dof(job, row, i, back, change, tail(by_v), tail(by_a), C)
        else:
            change = sub3(head(by_q), cross3(x, tail(by_q)))
            if carries:
                change = sub3(change, add3(cross3(velocity_at(S, x), tail(whole)), cross3(head(S), couple)))
            drag = sub3(head(by_v), cross3(x, tail(by_v)))
            put_dof(job, row, i, back, change, drag, sub3(head(by_a), cross3(x, tail(by_a))), C)
