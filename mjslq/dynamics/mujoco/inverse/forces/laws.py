"""Derivatives of the forces that are not inertia's: springs, dampers, tendons, actuators and their activations.

Notation
--------
    f                 passive plus actuator force, in generalized coordinates
    T = df/dv         what an implicit integrator takes into its M^ = M - h T
    E = h d(T)/dz a   its change for a fixed acceleration a: none unless damping or gain is itself nonlinear
    z = (q, v, act, u)   columns of F = df/dz and of E, in this order

Forces (MuJoCo's documentation, "Polynomial forces", "Actuation model"):

    spring     -(k1 x + k2 x^2 + k3 x^3)                x: displacement, of a tendon outside its dead band
    damper     -(d1 v + d2 v |v| + d3 v^3)
    actuator   moment' clip(gain * input + bias)        gain, bias affine in the actuator's length and velocity,
                                                        or those of a muscle (`muscles`)
    input      clip(u), or the activation, or with actearly the next activation

Clipped quantities have zero derivative outside their range, and the inner one-sided derivative on its border, which
is also what mjd_transitionFD gives. Where other pieces meet, the derivative is the mean of the two sides (`kinks`).
"""

from __future__ import annotations

import math

import mujoco

from mjslq.dynamics.mujoco.inverse.forces.kinks import displacement, sign
from mjslq.dynamics.mujoco.inverse.forces.muscles import muscle_bias, muscle_gain, muscle_rate
from mjslq.dynamics.mujoco.inverse.spatial import (
    add3,
    compiled,
    cross3,
    cross_force,
    dot6,
    inlined,
    join,
    row3,
    row6,
    sub3,
)
from mjslq.dynamics.mujoco.inverse.table.columns import (
    ACT_RANGE,
    ACTUATOR_NUMBERS,
    BAND,
    BIAS,
    CTRL_RANGE,
    DAMPING,
    FORCE_NUMBERS,
    FORCE_RANGE,
    GAIN,
    MUSCLE_BIAS,
    MUSCLE_GAIN,
    MUSCLE_NUMBERS,
    STIFFNESS,
    TENDON_NUMBERS,
    TIME_CONSTANT,
)
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix, vector

_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
_FILTER = int(mujoco.mjtDyn.mjDYN_FILTER)
_MUSCLE = int(mujoco.mjtDyn.mjDYN_MUSCLE)


@compiled
def add_springs(job, F):
    """F += df/dq of the joints' springs."""
    spring_dof = integers(job.spring_dof, job.nspring)
    spring_qadr = integers(job.spring_qadr, job.nspring)
    spring_prm = matrix(job.spring_prm, job.nspring, 4)
    ball_dof = integers(job.ball_dof, job.nball)
    qpos = vector(job.qpos, job.nq)
    for s in range(spring_dof.shape[0]):
        i = spring_dof[s]
        x = qpos[spring_qadr[s]] - spring_prm[s, 0]
        F[i, i] -= spring_prm[s, 1] + x * (2.0 * spring_prm[s, 2] + x * 3.0 * spring_prm[s, 3])
    for s in range(ball_dof.shape[0]):
        add_ball_spring(job, s, F)


@compiled
def add_ball_spring(job, s, F):
    """Torque -g(t) phi with phi the rotation vector from rest, t its length, g(t) = k1 + k2 t + k3 t^2.

    dphi = J dq, with J = 1 + [phi]/2 + c [phi]^2 the inverse of the rotation group's right Jacobian.
    """
    ball_dof = integers(job.ball_dof, job.nball)
    ball_qadr = integers(job.ball_qadr, job.nball)
    ball_prm = matrix(job.ball_prm, job.nball, 7)
    qpos = vector(job.qpos, job.nq)
    d, adr = ball_dof[s], ball_qadr[s]
    r0, r1, r2, r3 = ball_prm[s, 0], ball_prm[s, 1], ball_prm[s, 2], ball_prm[s, 3]
    q0, q1, q2, q3 = qpos[adr], qpos[adr + 1], qpos[adr + 2], qpos[adr + 3]
    w = r0 * q0 + r1 * q1 + r2 * q2 + r3 * q3
    e = (
        r0 * q1 - r1 * q0 - r2 * q3 + r3 * q2,
        r0 * q2 + r1 * q3 - r2 * q0 - r3 * q1,
        r0 * q3 - r1 * q2 + r2 * q1 - r3 * q0,
    )
    sine = math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    t = 2.0 * math.atan2(sine, w)
    if t > math.pi:
        t -= 2.0 * math.pi
    ratio = t / sine if sine > 1e-12 else 2.0
    phi = (ratio * e[0], ratio * e[1], ratio * e[2])
    size = abs(t)
    small = size < 1e-3
    half = 1.0 if small else 0.5 * size
    c = 1.0 / 12.0 + t * t / 720.0 if small else (1.0 - half / math.tan(half)) / (t * t)
    g = ball_prm[s, 4] + size * (ball_prm[s, 5] + size * ball_prm[s, 6])
    # phi' J = phi', so that the change of the length t along dq is phi . dq / t
    slope = 0.0 if size < 1e-12 else (ball_prm[s, 5] + 2.0 * size * ball_prm[s, 6]) / size
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        F[d + i, d + i] -= g * (1.0 + c * (phi[i] * phi[i] - t * t)) + slope * phi[i] * phi[i]
        F[d + i, d + j] -= g * (-0.5 * phi[k] + c * phi[i] * phi[j]) + slope * phi[i] * phi[j]
        F[d + i, d + k] -= g * (0.5 * phi[j] + c * phi[i] * phi[k]) + slope * phi[i] * phi[k]


@compiled
def add_dampers(job, acc, F, T, E):
    """F += df/dv and T += df/dv of the joints' dampers, E += h dT a where the integrator takes them implicitly."""
    dof_damping = matrix(job.dof_damping, job.nv, 3)
    qvel = vector(job.qvel, job.nv)
    nv = job.nv
    for i in range(nv):
        d1, d2, d3, v = dof_damping[i, 0], dof_damping[i, 1], dof_damping[i, 2], qvel[i]
        slope = d1 + 2.0 * d2 * abs(v) + 3.0 * d3 * v * v
        T[i, i] -= slope
        F[i, nv + i] -= slope
        if job.implicit >= 1 and (d2 != 0.0 or d3 != 0.0):
            E[i, nv + i] -= job.h * (2.0 * d2 * sign(v) + 6.0 * d3 * v) * acc[i]


@compiled
def add_tendons(job, acc, F, T, E):
    """Do the same for the springs and dampers of fixed tendons, whose lengths are linear in the joints' positions."""
    dof_qadr = integers(job.dof_qadr, job.nv)
    ten_first = integers(job.ten_first, job.ntendon + 1)
    ten_dof = integers(job.ten_dof, job.nten_coef)
    ten_coef = vector(job.ten_coef, job.nten_coef)
    ten_prm = matrix(job.ten_prm, job.ntendon, TENDON_NUMBERS)
    qpos = vector(job.qpos, job.nq)
    qvel = vector(job.qvel, job.nv)
    nv = job.nv
    for t in range(ten_prm.shape[0]):
        first, last = ten_first[t], ten_first[t + 1]
        prm = ten_prm[t]
        length, velocity, rate = 0.0, 0.0, 0.0
        for k in range(first, last):
            i = ten_dof[k]
            length += ten_coef[k] * qpos[dof_qadr[i]]
            velocity += ten_coef[k] * qvel[i]
            rate += ten_coef[k] * acc[i]
        x, outside = displacement(length, prm[BAND], prm[BAND + 1])
        stiffness = outside * (prm[STIFFNESS] + x * (2.0 * prm[STIFFNESS + 1] + x * 3.0 * prm[STIFFNESS + 2]))
        d1, d2, d3 = prm[DAMPING], prm[DAMPING + 1], prm[DAMPING + 2]
        slope = d1 + 2.0 * d2 * abs(velocity) + 3.0 * d3 * velocity * velocity
        curvature = 0.0
        if job.implicit >= 2 and (d2 != 0.0 or d3 != 0.0):
            curvature = job.h * (2.0 * d2 * sign(velocity) + 6.0 * d3 * velocity) * rate
        for k in range(first, last):
            i, ci = ten_dof[k], ten_coef[k]
            for n in range(first, last):
                j, c = ten_dof[n], ci * ten_coef[n]
                F[i, j] -= c * stiffness
                F[i, nv + j] -= c * slope
                T[i, j] -= c * slope
                if curvature != 0.0:
                    E[i, nv + j] -= c * curvature


@inlined
def _clip(x, lower, upper):
    """The clipped number, and the derivative of clipping."""
    if x < lower:
        return lower, 0.0
    if x > upper:
        return upper, 0.0
    return x, 1.0


@compiled
def activate(job):
    """Inputs of the actuators with their derivatives by u and act, and those of the next activations.

    Writes act_input (input, its derivatives by u and act) and next_act (derivatives by u and act).
    """
    act_prm = matrix(job.act_prm, job.nu, ACTUATOR_NUMBERS)
    act_muscle = matrix(job.act_muscle, job.nu, MUSCLE_NUMBERS)
    act_adr = integers(job.act_adr, job.nu)
    act_dynamics = integers(job.act_dynamics, job.nu)
    act_early = integers(job.act_early, job.nu)
    act_enabled = integers(job.act_enabled, job.nu)
    act = vector(job.act, job.na)
    ctrl = vector(job.ctrl, job.nu)
    act_input = matrix(job.act_input, job.nu, 3)
    next_act = matrix(job.next_act, job.nu, 2)
    for i in range(job.nu):
        prm, k, kind = act_prm[i], act_adr[i], act_dynamics[i]
        u, by_u = _clip(ctrl[i], prm[CTRL_RANGE], prm[CTRL_RANGE + 1])
        if k < 0:
            act_input[i, 0], act_input[i, 1], act_input[i, 2] = u, by_u, 0.0
            continue
        tau = prm[TIME_CONSTANT]
        if kind == _INTEGRATOR:
            change, slope_u, slope_a = job.h * u, job.h, 0.0
        elif kind == _FILTER:
            change, slope_u, slope_a = job.h / tau * (u - act[k]), job.h / tau, -job.h / tau
        elif kind == _MUSCLE:
            rate, slope_u, slope_a = muscle_rate(act_muscle[i], u, act[k])
            change, slope_u, slope_a = job.h * rate, job.h * slope_u, job.h * slope_a
        else:
            part = 1.0 - math.exp(-job.h / tau)
            change, slope_u, slope_a = part * (u - act[k]), part, -part
        if act_enabled[i] == 0:
            change, slope_u, slope_a = 0.0, 0.0, 0.0
        following, inside = _clip(act[k] + change, prm[ACT_RANGE], prm[ACT_RANGE + 1])
        next_act[i, 0], next_act[i, 1] = inside * slope_u * by_u, inside * (1.0 + slope_a)
        if act_early[i] == 1:
            act_input[i, 0], act_input[i, 1], act_input[i, 2] = following, next_act[i, 0], next_act[i, 1]
        else:
            act_input[i, 0], act_input[i, 1], act_input[i, 2] = act[k], 0.0, 1.0


@compiled
def actuate(job):
    """Forces of the actuators.

    act_force = (force, d/dlength, d/dvelocity, d/du, d/dact, dgain/dvelocity, d2/dvelocity dlength, d2/dvelocity2).
    Clears act_free for the dofs whose joint clips what the actuators exert on it together.
    """
    dof_qadr = integers(job.dof_qadr, job.nv)
    act_first = integers(job.act_first, job.nu + 1)
    act_dof = integers(job.act_dof, job.nact_coef)
    act_coef = vector(job.act_coef, job.nact_coef)
    act_prm = matrix(job.act_prm, job.nu, ACTUATOR_NUMBERS)
    act_enabled = integers(job.act_enabled, job.nu)
    dof_force_range = matrix(job.dof_force_range, job.nv, 2)
    qpos = vector(job.qpos, job.nq)
    qvel = vector(job.qvel, job.nv)
    act_input = matrix(job.act_input, job.nu, 3)
    act_force = matrix(job.act_force, job.nu, FORCE_NUMBERS)
    act_muscle = matrix(job.act_muscle, job.nu, MUSCLE_NUMBERS)
    act_arm = integers(job.act_arm, job.nu)
    arm_motion = matrix(job.arm_motion, job.narm, 2)
    act_free = vector(job.act_free, job.nv)
    act_sum = vector(job.act_sum, job.nv)
    for j in range(job.nv):
        act_free[j] = 1.0
        act_sum[j] = 0.0
    for i in range(job.nu):
        prm = act_prm[i]
        length, velocity = 0.0, 0.0
        for k in range(act_first[i], act_first[i + 1]):
            j = act_dof[k]
            if dof_qadr[j] >= 0:
                length += act_coef[k] * qpos[dof_qadr[j]]
            velocity += act_coef[k] * qvel[j]
        if act_arm[i] >= 0:
            length, velocity = arm_motion[act_arm[i], 0], arm_motion[act_arm[i], 1]
        x, gain_l, gain_v, bias_l, bias_v = act_input[i, 0], prm[GAIN + 1], prm[GAIN + 2], prm[BIAS + 1], prm[BIAS + 2]
        gain = prm[GAIN] + gain_l * length + gain_v * velocity
        bias = prm[BIAS] + bias_l * length + bias_v * velocity
        gain_vl, gain_vv = 0.0, 0.0
        if act_muscle[i, MUSCLE_GAIN + 2] != 0.0:
            gain, gain_l, gain_v, gain_vl, gain_vv = muscle_gain(act_muscle[i], length, velocity)
        if act_muscle[i, MUSCLE_BIAS + 2] != 0.0:
            bias, bias_l = muscle_bias(act_muscle[i], length)
        force, inside = _clip(gain * x + bias, prm[FORCE_RANGE], prm[FORCE_RANGE + 1])
        if act_enabled[i] == 0:
            force, inside = 0.0, 0.0
        act_force[i, 0] = force
        act_force[i, 1] = inside * (gain_l * x + bias_l)
        act_force[i, 2] = inside * (gain_v * x + bias_v)
        act_force[i, 3] = inside * gain * act_input[i, 1]
        act_force[i, 4] = inside * gain * act_input[i, 2]
        act_force[i, 5] = inside * gain_v
        act_force[i, 6] = inside * gain_vl * x
        act_force[i, 7] = inside * gain_vv * x
        for k in range(act_first[i], act_first[i + 1]):
            act_sum[act_dof[k]] += act_coef[k] * force
    for j in range(job.nv):
        if act_sum[j] < dof_force_range[j, 0] or act_sum[j] > dof_force_range[j, 1]:
            act_free[j] = 0.0


@compiled
def add_actuators(job, acc, F, T, E):
    """F += df/dz, T += df/dv, E += h dT a of the actuators on joints and fixed tendons."""
    act_first = integers(job.act_first, job.nu + 1)
    act_dof = integers(job.act_dof, job.nact_coef)
    act_coef = vector(job.act_coef, job.nact_coef)
    act_adr = integers(job.act_adr, job.nu)
    act_input = matrix(job.act_input, job.nu, 3)
    act_force = matrix(job.act_force, job.nu, FORCE_NUMBERS)
    act_free = vector(job.act_free, job.nv)
    act_arm = integers(job.act_arm, job.nu)
    nv, na = job.nv, job.na
    for i in range(job.nu):
        if act_arm[i] >= 0:
            continue
        by_length, by_velocity, by_u, by_act = (
            act_force[i, 1],
            act_force[i, 2],
            act_force[i, 3],
            act_force[i, 4],
        )
        column_u, column_act = 2 * nv + na + i, 2 * nv + act_adr[i]
        pace = 0.0
        if job.implicit >= 2 and act_force[i, 5] != 0.0:
            for k in range(act_first[i], act_first[i + 1]):
                pace += job.h * act_coef[k] * acc[act_dof[k]]
        rate = act_force[i, 5] * pace
        for k in range(act_first[i], act_first[i + 1]):
            j = act_dof[k]
            c = act_coef[k] * act_free[j]
            F[j, column_u] += c * by_u
            if act_adr[i] >= 0:
                F[j, column_act] += c * by_act
            if by_length != 0.0 or by_velocity != 0.0:
                for n in range(act_first[i], act_first[i + 1]):
                    F[j, act_dof[n]] += c * act_coef[n] * by_length
                    F[j, nv + act_dof[n]] += c * act_coef[n] * by_velocity
                    T[j, act_dof[n]] += c * act_coef[n] * by_velocity
                    if act_force[i, 6] != 0.0 or act_force[i, 7] != 0.0:
                        E[j, act_dof[n]] += c * act_coef[n] * act_force[i, 6] * pace
                        E[j, nv + act_dof[n]] += c * act_coef[n] * act_force[i, 7] * pace
            if rate != 0.0:
                E[j, column_u] += c * rate * act_input[i, 1]
                if act_adr[i] >= 0:
                    E[j, column_act] += c * rate * act_input[i, 2]


@compiled
def add_site_actuators(job, F):
    """F += df/dz of actuators that push at a site: a wrench W that moves with the site's body.

    Their generalized force is S_j . W. Turning a dof i turns W, and with it all S_j beyond i: what is left is
    S_j . (S_i x* W) for the j before i.
    """
    body_lastdof = integers(job.body_lastdof, job.nbody)
    dof_parentid = integers(job.dof_parentid, job.nv)
    dof_group = integers(job.dof_group, job.nv)
    act_adr = integers(job.act_adr, job.nu)
    act_site = integers(job.act_site, job.nu)
    act_body = integers(job.act_body, job.nu)
    act_arm = integers(job.act_arm, job.nu)
    cdof = matrix(job.cdof, job.nv, 6)
    act_force = matrix(job.act_force, job.nu, FORCE_NUMBERS)
    nv, na = job.nv, job.na
    for i in range(job.nu):
        if act_site[i] < 0 or act_arm[i] >= 0:
            continue
        body, W = act_body[i], site_wrench(job, i)
        force = act_force[i, 0]
        last = body_lastdof[body]
        k = last
        while k >= 0:
            moment = dot6(row6(cdof, k), W)
            F[k, 2 * nv + na + i] += moment * act_force[i, 3]
            if act_adr[i] >= 0:
                F[k, 2 * nv + act_adr[i]] += moment * act_force[i, 4]
            turned = cross_force(row6(cdof, k), W)
            j = dof_parentid[dof_group[k]]
            while j >= 0:
                F[j, k] += force * dot6(row6(cdof, j), turned)
                j = dof_parentid[j]
            k = dof_parentid[k]


@compiled
def site_wrench(job, i):
    """Wrench of actuator i on the body of its site, per unit of force, about the tree's centre of mass."""
    body_rootid = integers(job.body_rootid, job.nbody)
    site, body = integers(job.act_site, job.nu)[i], integers(job.act_body, job.nu)[i]
    R, gear = matrix(job.site_xmat, job.nsite, 9)[site], matrix(job.act_gear, job.nu, 6)[i]
    push = _turn(R, gear[0], gear[1], gear[2])
    place, center = matrix(job.site_xpos, job.nsite, 3), matrix(job.subtree_com, job.nbody, 3)
    x = sub3(row3(place, site), row3(center, body_rootid[body]))
    return join(add3(_turn(R, gear[3], gear[4], gear[5]), cross3(x, push)), push)


@inlined
def _turn(R, x, y, z):
    """Rotation matrix, as a row of nine numbers, times a vector."""
    return (
        R[0] * x + R[1] * y + R[2] * z,
        R[3] * x + R[4] * y + R[5] * z,
        R[6] * x + R[7] * y + R[8] * z,
    )
