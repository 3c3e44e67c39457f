"""Derivatives of sensor readings: rows of C = dy/dx and D = dy/du.

Notation (spatial vectors: `spatial`; P_i, h^C, I^C: `rigid`)
--------
    p, R, v, w           place, orientation, velocity, angular velocity of a frame fixed in a body (the object)
    p_r, R_r, v_r, w_r   those of the reference frame; the world's when a sensor has none
    theta_i, dp_i        turning and motion of a frame per unit of dof i: S_i of a dof that moves its body, at p
    V                    velocity of the body; d V_i = P_i - V x S_i its change with dof i, at fixed dof velocities

Frames: with u = v - v_r - w_r x (p - p_r),

    position       R_r' (dp - dp_r - theta_r x (p - p_r))            orientation   1/2 q_r* (0, theta - theta_r) q
    axis a of R    R_r' ((theta - theta_r) x a)
    turn           R_r' (dw - dw_r - theta_r x (w - w_r))
    velocity       R_r' (dv - dv_r - dw_r x (p - p_r) - w_r x (dp - dp_r) - theta_r x u)
    in the object's own frame (velocimeter, gyro)                    R' (dv - theta x v),  R' (dw - theta x w)

Subtrees of body b: with k = b for dofs before or at b, and the dof's own body for dofs beyond, the subtree's momentum
changes by dh_i = S_i x* h^C_k + I^C_k P_i with position and I^C_k S_i with velocity; its centre of mass moves by the
linear part of I^C_k S_i / mass.
"""

from __future__ import annotations

from numba import types

from mjslq.dynamics.mujoco.inverse import columns
from mjslq.dynamics.mujoco.inverse.job import integers, matrix, vector
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
    row3,
    row6,
    scale3,
    sub3,
    sub6,
    tail,
    velocity_at,
)  # fmt: skip
from mjslq.dynamics.mujoco.kernels import _copy, mj_forward, mjd_transitionFD

_POS, _QUAT, _AXIS, _VEL, _TURN = (
    columns.FRAME_POS, columns.FRAME_QUAT, columns.FRAME_AXIS, columns.FRAME_VEL, columns.FRAME_TURN
)  # fmt: skip
_LOCAL_VEL, _LOCAL_TURN = columns.LOCAL_VEL, columns.LOCAL_TURN
_COM, _SUBTREE_VEL, _SUBTREE_TURN = columns.SUBTREE_COM, columns.SUBTREE_VEL, columns.SUBTREE_TURN


@compiled
def difference_sensors(job, n, C, D):
    """C and D of knot n by differences (no D at the last knot), from mjData that holds its state and control.

    The constraint solver starts from the solution at the knot itself, found from a cold start.
    """
    warmstart = vector(job.qacc_warmstart, job.nv)
    for i in range(job.nv):
        warmstart[i] = 0.0
    mj_forward(job.model, job.data)
    _copy(vector(job.qacc, job.nv), warmstart)
    at_end = n == job.N
    mjd_transitionFD(
        job.model,
        job.data,
        job.eps,
        types.uint8(job.centered),
        0,
        0,
        C.ctypes.data,
        types.intp(0) if at_end else D.ctypes.data,
    )


@compiled
def write_sensors(job, C, D):
    """Rows of C and D that have a closed form, after the rigid bodies' sweep at the knot."""
    kinds, first = integers(job.sen_kind, job.nsensor), integers(job.sen_adr, job.nsensor)
    target = integers(job.sen_target, job.nsensor)
    for s in range(job.nsensor):
        kind, row, at = kinds[s], first[s], target[s]
        if kind == columns.BY_DIFFERENCES:
            continue
        if kind <= columns.BALL_VEL:
            _write_scalar(job, kind, row, at, C, D)
        elif kind >= _COM:
            _write_subtree(job, s, kind, row, C, D)
        else:
            _write_frame(job, s, kind, row, C, D)


@compiled
def _write_scalar(job, kind, row, at, C, D):
    """Joints, fixed tendons, actuators."""
    nv = job.nv
    _clear(C, D, row, 4 if kind == columns.BALL_QUAT else 3 if kind == columns.BALL_VEL else 1)
    if kind == columns.JOINT_POS:
        C[row, at] = 1.0
    elif kind == columns.JOINT_VEL:
        C[row, nv + at] = 1.0
    elif kind in (columns.TENDON_POS, columns.TENDON_VEL):
        first, shift = integers(job.ten_first, job.ntendon + 1), 0 if kind == columns.TENDON_POS else nv
        dofs, coefficients = integers(job.ten_dof, job.nten_coef), vector(job.ten_coef, job.nten_coef)
        for k in range(first[at], first[at + 1]):
            C[row, shift + dofs[k]] += coefficients[k]
    elif kind in (columns.ACTUATOR_POS, columns.ACTUATOR_VEL):
        first, shift = integers(job.act_first, job.nu + 1), 0 if kind == columns.ACTUATOR_POS else nv
        dofs, coefficients = integers(job.act_dof, job.nact_coef), vector(job.act_coef, job.nact_coef)
        for k in range(first[at], first[at + 1]):
            C[row, shift + dofs[k]] += coefficients[k]
    elif kind == columns.ACTUATOR_FORCE:
        _add_force(job, at, 1.0, row, C, D)
    elif kind == columns.JOINT_FORCE:
        first, free = integers(job.act_first, job.nu + 1), vector(job.act_free, job.nv)
        dofs, coefficients = integers(job.act_dof, job.nact_coef), vector(job.act_coef, job.nact_coef)
        for i in range(job.nu):
            for k in range(first[i], first[i + 1]):
                if dofs[k] == at:
                    _add_force(job, i, coefficients[k] * free[at], row, C, D)
    elif kind == columns.BALL_VEL:
        for k in range(3):
            C[row + k, nv + at + k] = 1.0
    else:
        _write_ball(job, row, at, C)


@compiled
def _write_ball(job, row, dof, C):
    """Quaternion q of a ball joint: dq = 1/2 q (0, theta)."""
    qpos, q = vector(job.qpos, job.nq), integers(job.dof_qadr, job.nv)[dof]
    adr = -2 - q
    w, x, y, z = 0.5 * qpos[adr], 0.5 * qpos[adr + 1], 0.5 * qpos[adr + 2], 0.5 * qpos[adr + 3]
    C[row, dof], C[row, dof + 1], C[row, dof + 2] = -x, -y, -z
    C[row + 1, dof], C[row + 1, dof + 1], C[row + 1, dof + 2] = w, -z, y
    C[row + 2, dof], C[row + 2, dof + 1], C[row + 2, dof + 2] = z, w, -x
    C[row + 3, dof], C[row + 3, dof + 1], C[row + 3, dof + 2] = -y, x, w


@inlined
def _clear(C, D, row, size):
    for k in range(row, row + size):
        for c in range(C.shape[1]):
            C[k, c] = 0.0
        for c in range(D.shape[1]):
            D[k, c] = 0.0


@inlined
def _add_force(job, i, scale, row, C, D):
    """Add the derivative of actuator i's force, times a number, to a row."""
    force, act = matrix(job.act_force, job.nu, columns.FORCE_NUMBERS), integers(job.act_adr, job.nu)[i]
    first = integers(job.act_first, job.nu + 1)
    dofs, coefficients = integers(job.act_dof, job.nact_coef), vector(job.act_coef, job.nact_coef)
    for k in range(first[i], first[i + 1]):
        C[row, dofs[k]] += scale * force[i, 1] * coefficients[k]
        C[row, job.nv + dofs[k]] += scale * force[i, 2] * coefficients[k]
    D[row, i] += scale * force[i, 3]
    if act >= 0:
        C[row, 2 * job.nv + act] += scale * force[i, 4]


@inlined
def _quaternion_product(p, q):
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    )


@inlined
def _turned(q, a):
    """Turn a vector by a unit quaternion."""
    u = (q[1], q[2], q[3])
    t = scale3(2.0, cross3(u, a))
    return add3(add3(a, scale3(q[0], t)), cross3(u, t))


@inlined
def _pose(job, body, prm):
    """Place relative to the centre of mass of the tree, place in the world, and quaternion of a frame in a body."""
    xpos, xquat, com = (
        matrix(job.xpos, job.nbody, 3),
        matrix(job.xquat, job.nbody, 4),
        matrix(job.subtree_com, job.nbody, 3),
    )
    q = (xquat[body, 0], xquat[body, 1], xquat[body, 2], xquat[body, 3])
    p = add3(row3(xpos, body), _turned(q, (prm[0], prm[1], prm[2])))
    x = sub3(p, row3(com, integers(job.body_rootid, job.nbody)[body]))
    return x, p, _quaternion_product(q, (prm[3], prm[4], prm[5], prm[6]))


@compiled
def _write_frame(job, s, kind, row, C, D):
    """Frames: add what each dof does through the object, then what it does through the reference."""
    body, other = integers(job.sen_body, job.nsensor)[s], integers(job.sen_reference, job.nsensor)[s]
    prm = matrix(job.sen_prm, job.nsensor, columns.FRAME_NUMBERS)[s]
    vel, lastdof = matrix(job.body_vel, job.nbody, 6), integers(job.body_lastdof, job.nbody)
    x, p, q = _pose(job, body, prm[:7])
    x_r, p_r, q_r = _pose(job, other, prm[7:])
    V, V_r = row6(vel, body), row6(vel, other)
    apart = sub3(p, p_r)
    w = sub3(head(V), head(V_r))
    u = sub3(sub3(velocity_at(V, x), velocity_at(V_r, x_r)), cross3(head(V_r), apart))
    back = (q_r[0], -q_r[1], -q_r[2], -q_r[3])
    if kind in (_LOCAL_VEL, _LOCAL_TURN):
        back = (q[0], -q[1], -q[2], -q[3])
    at = integers(job.sen_target, job.nsensor)[s]
    axis = _turned(q, (1.0 if at == 0 else 0.0, 1.0 if at == 1 else 0.0, 1.0 if at == 2 else 0.0))
    _clear(C, D, row, 4 if kind == _QUAT else 3)
    parent, cdof, rate = integers(job.dof_parentid, job.nv), matrix(job.cdof, job.nv, 6), matrix(job.dof_P, job.nv, 6)
    i = lastdof[body]
    while i >= 0:
        S = row6(cdof, i)
        moved = sub6(row6(rate, i), cross_motion(V, S))
        dp = velocity_at(S, x)
        dv = sub3(add3(velocity_at(moved, x), cross3(head(V), dp)), cross3(head(V_r), dp))
        if kind == _LOCAL_VEL:
            dv = sub3(dv, cross3(head(S), u))
        dw = head(moved) if kind != _LOCAL_TURN else sub3(head(moved), cross3(head(S), w))
        _add_to_row(job, kind, row, i, 1.0, dp, S, dv, dw, axis, velocity_at(S, x), q, back, C)
        i = parent[i]
    i = lastdof[other]
    while i >= 0:
        S = row6(cdof, i)
        moved = sub6(row6(rate, i), cross_motion(V_r, S))
        dp, turn = velocity_at(S, x_r), head(S)
        dv = add3(velocity_at(moved, x_r), cross3(head(V_r), dp))
        dv = add3(add3(dv, cross3(head(moved), apart)), sub3(cross3(turn, u), cross3(head(V_r), dp)))
        dw = add3(head(moved), cross3(turn, w))
        by_v = add3(velocity_at(S, x_r), cross3(turn, apart))
        _add_to_row(job, kind, row, i, -1.0, add3(dp, cross3(turn, apart)), S, dv, dw, axis, by_v, q, back, C)
        i = parent[i]


@inlined
def _add_to_row(job, kind, row, i, sign, dp, S, dv, dw, axis, by_v, q, back, C):
    """Add one dof's effect through the object (sign 1) or the reference (sign -1)."""
    zero = (0.0, 0.0, 0.0)
    if kind == _QUAT:
        h = 0.5 * sign
        dq = _quaternion_product(_quaternion_product(back, (0.0, h * S[0], h * S[1], h * S[2])), q)
        for k in range(4):
            C[row + k, i] += dq[k]
        return
    by_q, velocity = zero, zero
    if kind == _POS:
        by_q = dp
    elif kind == _AXIS:
        by_q = cross3(head(S), axis)
    elif kind in (_VEL, _LOCAL_VEL):
        by_q, velocity = dv, by_v
    else:
        by_q, velocity = dw, head(S)
    by_q, velocity = _turned(back, by_q), _turned(back, velocity)
    for k in range(3):
        C[row + k, i] += sign * by_q[k]
        C[row + k, job.nv + i] += sign * velocity[k]


@compiled
def _write_subtree(job, s, kind, row, C, D):
    """Centre of mass of a subtree, its velocity, its angular momentum about it."""
    body = integers(job.sen_body, job.nsensor)[s]
    mass = vector(job.body_subtreemass, job.nbody)[body]
    inertia, momentum = matrix(job.body_inertia, job.nbody, 10), matrix(job.body_momentum, job.nbody, 6)
    com = matrix(job.subtree_com, job.nbody, 3)
    arm = sub3(row3(com, body), row3(com, integers(job.body_rootid, job.nbody)[body]))
    cdof, rate = matrix(job.cdof, job.nv, 6), matrix(job.dof_P, job.nv, 6)
    dof_body, lastdof = integers(job.dof_bodyid, job.nv), integers(job.body_lastdof, job.nbody)
    _clear(C, D, row, 3)
    for i in range(job.nv):
        within = _is_below(job, dof_body[i], body)
        if not within and not _moves(job, i, lastdof[body]):
            continue
        k, S = dof_body[i] if within else body, row6(cdof, i)
        carried = inertia_times(inertia, k, S)
        change = add6(cross_force(S, row6(momentum, k)), inertia_times(inertia, k, row6(rate, i)))
        shift = scale3(1.0 / mass, tail(carried))
        by_q, by_v = shift, (0.0, 0.0, 0.0)
        if kind == _SUBTREE_VEL:
            by_q, by_v = scale3(1.0 / mass, tail(change)), shift
        elif kind == _SUBTREE_TURN:
            whole = tail(row6(momentum, body))
            by_q = sub3(sub3(head(change), cross3(arm, tail(change))), cross3(shift, whole))
            by_v = sub3(head(carried), cross3(arm, tail(carried)))
        for c in range(3):
            C[row + c, i] = by_q[c]
            C[row + c, job.nv + i] = by_v[c]


@inlined
def _is_below(job, b, top):
    """Whether body b belongs to the subtree of body `top`."""
    parent = integers(job.body_parentid, job.nbody)
    while b > top:
        b = parent[b]
    return b == top


@inlined
def _moves(job, i, last):
    """Whether dof i is `last` or one of its ancestors."""
    parent = integers(job.dof_parentid, job.nv)
    while last > i:
        last = parent[last]
    return last == i
