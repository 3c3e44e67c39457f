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
    magnetometer, of a field B                                       R' (B x theta)

Subtrees of body b: with k = b for dofs before or at b, and the dof's own body for dofs beyond, the subtree's momentum
changes by dh_i = S_i x* h^C_k + I^C_k P_i with position and I^C_k S_i with velocity; its centre of mass moves by the
linear part of I^C_k S_i / mass.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.readings.accelerations import (
    add_acceleration,
    add_inertial_force,
    clear_lever,
    write_acceleration,
)
from mjslq.dynamics.mujoco.inverse.readings.contact_sensors import write_contacts
from mjslq.dynamics.mujoco.inverse.readings.frames import clear_rows, is_below, moves, pose
from mjslq.dynamics.mujoco.inverse.readings.limits import write_limit
from mjslq.dynamics.mujoco.inverse.readings.pressures import add_pressures
from mjslq.dynamics.mujoco.inverse.readings.rays import write_range
from mjslq.dynamics.mujoco.inverse.readings.stages import difference_stages
from mjslq.dynamics.mujoco.inverse.rigid import inward, outward
from mjslq.dynamics.mujoco.inverse.rows.constraints import evaluate_rows
from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    add6,
    compiled,
    cross3,
    cross_force,
    cross_motion,
    dot6,
    head,
    inertia_times,
    inlined,
    quaternion_product,
    row3,
    row6,
    scale3,
    sub3,
    sub6,
    tail,
    turned,
    velocity_at,
)  # fmt: skip
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.columns import ARMATURE, TENDON_NUMBERS
from mjslq.dynamics.mujoco.inverse.table.job import entry_count, integers, matrix, vector

_POS, _QUAT, _AXIS, _VEL, _TURN = (
    columns.FRAME_POS, columns.FRAME_QUAT, columns.FRAME_AXIS, columns.FRAME_VEL, columns.FRAME_TURN
)  # fmt: skip
_LOCAL_VEL, _LOCAL_TURN, _LOCAL_FIELD = columns.LOCAL_VEL, columns.LOCAL_TURN, columns.LOCAL_FIELD
_COM, _SUBTREE_VEL, _SUBTREE_TURN = columns.SUBTREE_COM, columns.SUBTREE_VEL, columns.SUBTREE_TURN


@compiled
def write_motions(job, C, D):
    """C and D of the sensors of positions, velocities and actuators, after the rigid bodies' sweep at the knot."""
    kinds, first = integers(job.sen_kind, job.nsensor), integers(job.sen_adr, job.nsensor)
    target = integers(job.sen_target, job.nsensor)
    for s in range(job.nsensor):
        kind, row, at = kinds[s], first[s], target[s]
        if kind == columns.CONSTANT:
            clear_rows(C, D, row, integers(job.sen_dim, job.nsensor)[s])
        elif kind == columns.KINETIC_ENERGY:
            _write_energy(job, row, C, D)
        elif columns.JOINT_POS <= kind <= columns.BALL_VEL:
            _write_scalar(job, kind, row, at, C, D)
        elif columns.FRAME_POS <= kind <= columns.LOCAL_FIELD:
            _write_frame(job, s, kind, row, C, D)
        elif _COM <= kind <= _SUBTREE_TURN:
            _write_subtree(job, s, kind, row, C, D)
        elif kind == columns.RANGE:
            write_range(job, s, row, C, D)


@compiled
def write_feelings(job, n, x, C, D):
    """C and D of the other sensors, of knot n, and limits of all readings; may leave mjData away from x."""
    kinds, first = integers(job.sen_kind, job.nsensor), integers(job.sen_adr, job.nsensor)
    on_contacts = np.int64(0)
    if job.sensors_accelerated:
        outward(job, vector(job.qvel, job.nv), vector(job.acc_c, job.nv))
        inward(job)
        if job.sensors_on_rows and entry_count(job.data + job.at_nefc) > 0:
            evaluate_rows(job, vector(job.acc_c, job.nv), 1)
    for s in range(job.nsensor):
        kind, row = kinds[s], first[s]
        if columns.FRAME_ACC <= kind <= columns.LOCAL_ACC:
            write_acceleration(job, s, kind, row, C, D)
        elif columns.LIMIT_POS <= kind <= columns.LIMIT_FORCE:
            write_limit(job, s, kind, row, C, D)
        elif kind == columns.CONTACT:
            on_contacts += 0 if write_contacts(job, s, row, C, D) else 1
        elif kind >= columns.FORCE:
            on_contacts += 0 if _write_force(job, s, kind, row, C, D) else 1
    if job.sensors_differenced or job.sensors_cut or on_contacts > 0:
        difference_stages(job, n, x, on_contacts, C, D)


@compiled
def _write_force(job, s, kind, row, C, D):
    """Force, torque, touch; False when a contact has no closed form."""
    count = np.int64(1 if kind == columns.TOUCH else 3)
    clear_rows(C, D, row, count)
    clear_lever(job)
    if kind != columns.TOUCH:
        add_inertial_force(job, s, kind, row, C)
    known = add_pressures(job, s, kind, row, C)
    add_acceleration(job, row, count, C, D)
    return known


@compiled
def _write_energy(job, row, C, D):
    """Kinetic energy: P_i . h^C by position, S_i . h^C by velocity, and what armature adds to that."""
    cdof, P = matrix(job.cdof, job.nv, 6), matrix(job.dof_P, job.nv, 6)
    momentum, body = matrix(job.body_momentum, job.nbody, 6), integers(job.dof_bodyid, job.nv)
    qvel, armature = vector(job.qvel, job.nv), vector(job.dof_armature, job.nv)
    clear_rows(C, D, row, 1)
    for i in range(job.nv):
        h = row6(momentum, body[i])
        C[row, i] = dot6(row6(P, i), h)
        C[row, job.nv + i] = dot6(row6(cdof, i), h) + armature[i] * qvel[i]
    first, dofs = integers(job.ten_first, job.ntendon + 1), integers(job.ten_dof, job.nten_coef)
    coefficients, prm = vector(job.ten_coef, job.nten_coef), matrix(job.ten_prm, job.ntendon, TENDON_NUMBERS)
    for t in range(job.ntendon):
        rate = 0.0
        for k in range(first[t], first[t + 1]):
            rate += coefficients[k] * qvel[dofs[k]]
        for k in range(first[t], first[t + 1]):
            C[row, job.nv + dofs[k]] += prm[t, ARMATURE] * coefficients[k] * rate


@compiled
def _write_scalar(job, kind, row, at, C, D):
    """Joints, fixed tendons, actuators."""
    nv = job.nv
    clear_rows(C, D, row, 4 if kind == columns.BALL_QUAT else 3 if kind == columns.BALL_VEL else 1)
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
    elif kind == columns.TENDON_FORCE:
        for i in range(job.nu):
            if integers(job.act_tendon, job.nu)[i] == at:
                _add_force(job, i, 1.0, row, C, D)
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


@compiled
def _write_frame(job, s, kind, row, C, D):
    """Frames: add what each dof does through the object, then what it does through the reference."""
    body, other = integers(job.sen_body, job.nsensor)[s], integers(job.sen_reference, job.nsensor)[s]
    prm = matrix(job.sen_prm, job.nsensor, columns.FRAME_NUMBERS)[s]
    vel, lastdof = matrix(job.body_vel, job.nbody, 6), integers(job.body_lastdof, job.nbody)
    x, p, q = pose(job, body, prm[:7])
    x_r, p_r, q_r = pose(job, other, prm[7:])
    V, V_r = row6(vel, body), row6(vel, other)
    apart = sub3(p, p_r)
    w = sub3(head(V), head(V_r))
    u = sub3(sub3(velocity_at(V, x), velocity_at(V_r, x_r)), cross3(head(V_r), apart))
    back = (q_r[0], -q_r[1], -q_r[2], -q_r[3])
    if kind in (_LOCAL_VEL, _LOCAL_TURN, _LOCAL_FIELD):
        back = (q[0], -q[1], -q[2], -q[3])
    at = integers(job.sen_target, job.nsensor)[s]
    axis = turned(q, (1.0 if at == 0 else 0.0, 1.0 if at == 1 else 0.0, 1.0 if at == 2 else 0.0))
    if kind == _LOCAL_FIELD:
        magnetic = vector(job.magnetic, 3)
        axis = (-magnetic[0], -magnetic[1], -magnetic[2])
    clear_rows(C, D, row, 4 if kind == _QUAT else 3)
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
        dq = quaternion_product(quaternion_product(back, (0.0, h * S[0], h * S[1], h * S[2])), q)
        for k in range(4):
            C[row + k, i] += dq[k]
        return
    by_q, velocity = zero, zero
    if kind == _POS:
        by_q = dp
    elif kind in (_AXIS, _LOCAL_FIELD):
        by_q = cross3(head(S), axis)
    elif kind in (_VEL, _LOCAL_VEL):
        by_q, velocity = dv, by_v
    else:
        by_q, velocity = dw, head(S)
    by_q, velocity = turned(back, by_q), turned(back, velocity)
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
    root, whole = integers(job.body_rootid, job.nbody), _subtree_momentum(job, body)
    cdof, rate = matrix(job.cdof, job.nv, 6), matrix(job.dof_P, job.nv, 6)
    dof_body, lastdof = integers(job.dof_bodyid, job.nv), integers(job.body_lastdof, job.nbody)
    clear_rows(C, D, row, 3)
    for i in range(job.nv):
        within = is_below(job, dof_body[i], body)
        if not within and not moves(job, i, lastdof[body]):
            continue
        k, S = dof_body[i] if within else body, row6(cdof, i)
        carried = inertia_times(inertia, k, S)
        change = add6(cross_force(S, row6(momentum, k)), inertia_times(inertia, k, row6(rate, i)))
        shift = scale3(1.0 / mass, tail(carried))
        by_q, by_v = shift, (0.0, 0.0, 0.0)
        if kind == _SUBTREE_VEL:
            by_q, by_v = scale3(1.0 / mass, tail(change)), shift
        elif kind == _SUBTREE_TURN:
            arm = sub3(row3(com, body), row3(com, root[dof_body[i]]))
            by_q = sub3(sub3(head(change), cross3(arm, tail(change))), cross3(shift, whole))
            by_v = sub3(head(carried), cross3(arm, tail(carried)))
        for c in range(3):
            C[row + c, i] = by_q[c]
            C[row + c, job.nv + i] = by_v[c]


@inlined
def _subtree_momentum(job, body):
    """Linear momentum of a subtree; the world's is the sum over all trees."""
    momentum, parent = matrix(job.body_momentum, job.nbody, 6), integers(job.body_parentid, job.nbody)
    if body > 0:
        return tail(row6(momentum, body))
    total = (0.0, 0.0, 0.0)
    for b in range(1, job.nbody):
        if parent[b] == 0:
            total = add3(total, tail(row6(momentum, b)))
    return total
