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
    actuator   moment' clip(gain * input + bias)        gain, bias affine in the actuator's length and velocity
    input      clip(u), or the activation, or with actearly the next activation

Clipped quantities have zero derivative outside their range, and the inner one-sided derivative on its border, which
is also what mjd_transitionFD gives.
"""

from __future__ import annotations

import math

import mujoco
import numba

from mjslq.dynamics._mujoco_inverse_spatial import (
    add3,
    cross3,
    cross_force,
    dot6,
    inlined,
    join,
    row3,
    row6,
    sub3,
)

_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
_FILTER = int(mujoco.mjtDyn.mjDYN_FILTER)

# columns of m.act_prm
GAIN, BIAS, TIME_CONSTANT, CTRL_RANGE, FORCE_RANGE, ACT_RANGE, ACTUATOR_NUMBERS = 0, 3, 6, 7, 9, 11, 13
# columns of m.ten_prm
BAND, STIFFNESS, DAMPING, ARMATURE, TENDON_NUMBERS = 0, 2, 5, 8, 9


@numba.njit(cache=True, error_model="numpy", nogil=True)
def add_springs(m, qpos, F):
    """F += df/dq of the joints' springs."""
    for s in range(m.spring_dof.shape[0]):
        i = m.spring_dof[s]
        x = qpos[m.spring_qadr[s]] - m.spring_prm[s, 0]
        F[i, i] -= m.spring_prm[s, 1] + x * (2.0 * m.spring_prm[s, 2] + x * 3.0 * m.spring_prm[s, 3])
    for s in range(m.ball_dof.shape[0]):
        _add_ball_spring(m, qpos, s, F)


@inlined
def _add_ball_spring(m, qpos, s, F):
    """Torque -g(t) phi with phi the rotation vector from rest, t its length, g(t) = k1 + k2 t + k3 t^2.

    dphi = J dq, with J = 1 + [phi]/2 + c [phi]^2 the inverse of the rotation group's right Jacobian.
    """
    d, adr = m.ball_dof[s], m.ball_qadr[s]
    r0, r1, r2, r3 = m.ball_prm[s, 0], m.ball_prm[s, 1], m.ball_prm[s, 2], m.ball_prm[s, 3]
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
    g = m.ball_prm[s, 4] + size * (m.ball_prm[s, 5] + size * m.ball_prm[s, 6])
    # phi' J = phi', so that the change of the length t along dq is phi . dq / t
    slope = 0.0 if size < 1e-12 else (m.ball_prm[s, 5] + 2.0 * size * m.ball_prm[s, 6]) / size
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        F[d + i, d + i] -= g * (1.0 + c * (phi[i] * phi[i] - t * t)) + slope * phi[i] * phi[i]
        F[d + i, d + j] -= g * (-0.5 * phi[k] + c * phi[i] * phi[j]) + slope * phi[i] * phi[j]
        F[d + i, d + k] -= g * (0.5 * phi[j] + c * phi[i] * phi[k]) + slope * phi[i] * phi[k]


@numba.njit(cache=True, error_model="numpy", nogil=True)
def add_dampers(m, qvel, acc, F, T, E):
    """F += df/dv and T += df/dv of the joints' dampers, E += h dT a where the integrator takes them implicitly."""
    nv = m.nv
    for i in range(nv):
        d1, d2, d3, v = m.dof_damping[i, 0], m.dof_damping[i, 1], m.dof_damping[i, 2], qvel[i]
        slope = d1 + 2.0 * d2 * abs(v) + 3.0 * d3 * v * v
        T[i, i] -= slope
        F[i, nv + i] -= slope
        if m.implicit >= 1 and (d2 != 0.0 or d3 != 0.0):
            E[i, nv + i] -= m.h * (2.0 * math.copysign(d2, d2 * v) + 6.0 * d3 * v) * acc[i]


@numba.njit(cache=True, error_model="numpy", nogil=True)
def add_tendons(m, qpos, qvel, acc, F, T, E):
    """Do the same for the springs and dampers of fixed tendons, whose lengths are linear in the joints' positions."""
    nv = m.nv
    for t in range(m.ten_prm.shape[0]):
        first, last = m.ten_first[t], m.ten_first[t + 1]
        prm = m.ten_prm[t]
        length, velocity, rate = 0.0, 0.0, 0.0
        for k in range(first, last):
            i = m.ten_dof[k]
            length += m.ten_coef[k] * qpos[m.dof_qadr[i]]
            velocity += m.ten_coef[k] * qvel[i]
            rate += m.ten_coef[k] * acc[i]
        x = 0.0
        if length > prm[BAND + 1]:
            x = length - prm[BAND + 1]
        elif length < prm[BAND]:
            x = length - prm[BAND]
        stiffness = 0.0
        if x != 0.0:
            stiffness = prm[STIFFNESS] + x * (2.0 * prm[STIFFNESS + 1] + x * 3.0 * prm[STIFFNESS + 2])
        d1, d2, d3 = prm[DAMPING], prm[DAMPING + 1], prm[DAMPING + 2]
        slope = d1 + 2.0 * d2 * abs(velocity) + 3.0 * d3 * velocity * velocity
        curvature = 0.0
        if m.implicit >= 2 and (d2 != 0.0 or d3 != 0.0):
            curvature = m.h * (2.0 * math.copysign(d2, d2 * velocity) + 6.0 * d3 * velocity) * rate
        for k in range(first, last):
            i, ci = m.ten_dof[k], m.ten_coef[k]
            for n in range(first, last):
                j, c = m.ten_dof[n], ci * m.ten_coef[n]
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


@numba.njit(cache=True, error_model="numpy", nogil=True)
def activate(m, act, ctrl, w):
    """Inputs of the actuators with their derivatives by u and act, and those of the next activations.

    Writes w.input (input, its derivatives by u and act) and w.next_act (derivatives by u and act).
    """
    for i in range(m.nu):
        prm, k, kind = m.act_prm[i], m.act_adr[i], m.act_dynamics[i]
        u, by_u = _clip(ctrl[i], prm[CTRL_RANGE], prm[CTRL_RANGE + 1])
        if k < 0:
            w.input[i, 0], w.input[i, 1], w.input[i, 2] = u, by_u, 0.0
            continue
        tau = prm[TIME_CONSTANT]
        if kind == _INTEGRATOR:
            change, slope_u, slope_a = m.h * u, m.h, 0.0
        elif kind == _FILTER:
            change, slope_u, slope_a = m.h / tau * (u - act[k]), m.h / tau, -m.h / tau
        else:
            part = 1.0 - math.exp(-m.h / tau)
            change, slope_u, slope_a = part * (u - act[k]), part, -part
        if m.act_enabled[i] == 0:
            change, slope_u, slope_a = 0.0, 0.0, 0.0
        following, inside = _clip(act[k] + change, prm[ACT_RANGE], prm[ACT_RANGE + 1])
        w.next_act[i, 0], w.next_act[i, 1] = inside * slope_u * by_u, inside * (1.0 + slope_a)
        if m.act_early[i] == 1:
            w.input[i, 0], w.input[i, 1], w.input[i, 2] = following, w.next_act[i, 0], w.next_act[i, 1]
        else:
            w.input[i, 0], w.input[i, 1], w.input[i, 2] = act[k], 0.0, 1.0


@numba.njit(cache=True, error_model="numpy", nogil=True)
def actuate(m, qpos, qvel, w):
    """Forces of the actuators: w.act_force = (force, d/dlength, d/dvelocity, d/du, d/dact, dgain/dvelocity).

    Clears w.act_free for the dofs whose joint clips what the actuators exert on it together.
    """
    for j in range(m.nv):
        w.act_free[j] = 1.0
        w.act_sum[j] = 0.0
    for i in range(m.nu):
        prm = m.act_prm[i]
        length, velocity = 0.0, 0.0
        for k in range(m.act_first[i], m.act_first[i + 1]):
            j = m.act_dof[k]
            if m.dof_qadr[j] >= 0:
                length += m.act_coef[k] * qpos[m.dof_qadr[j]]
            velocity += m.act_coef[k] * qvel[j]
        gain = prm[GAIN] + prm[GAIN + 1] * length + prm[GAIN + 2] * velocity
        bias = prm[BIAS] + prm[BIAS + 1] * length + prm[BIAS + 2] * velocity
        x = w.input[i, 0]
        force, inside = _clip(gain * x + bias, prm[FORCE_RANGE], prm[FORCE_RANGE + 1])
        if m.act_enabled[i] == 0:
            force, inside = 0.0, 0.0
        w.act_force[i, 0] = force
        w.act_force[i, 1] = inside * (prm[GAIN + 1] * x + prm[BIAS + 1])
        w.act_force[i, 2] = inside * (prm[GAIN + 2] * x + prm[BIAS + 2])
        w.act_force[i, 3] = inside * gain * w.input[i, 1]
        w.act_force[i, 4] = inside * gain * w.input[i, 2]
        w.act_force[i, 5] = inside * prm[GAIN + 2]
        for k in range(m.act_first[i], m.act_first[i + 1]):
            w.act_sum[m.act_dof[k]] += m.act_coef[k] * force
    for j in range(m.nv):
        if w.act_sum[j] < m.dof_force_range[j, 0] or w.act_sum[j] > m.dof_force_range[j, 1]:
            w.act_free[j] = 0.0


@numba.njit(cache=True, error_model="numpy", nogil=True)
def add_actuators(m, acc, w, F, T, E):
    """F += df/dz, T += df/dv, E += h dT a of the actuators on joints and fixed tendons."""
    nv, na = m.nv, m.na
    for i in range(m.nu):
        by_length, by_velocity, by_u, by_act = w.act_force[i, 1], w.act_force[i, 2], w.act_force[i, 3], w.act_force[i, 4]
        column_u, column_act = 2 * nv + na + i, 2 * nv + m.act_adr[i]
        rate = 0.0
        if m.implicit >= 2 and w.act_force[i, 5] != 0.0:
            for k in range(m.act_first[i], m.act_first[i + 1]):
                rate += m.h * w.act_force[i, 5] * m.act_coef[k] * acc[m.act_dof[k]]
        for k in range(m.act_first[i], m.act_first[i + 1]):
            j = m.act_dof[k]
            c = m.act_coef[k] * w.act_free[j]
            F[j, column_u] += c * by_u
            if m.act_adr[i] >= 0:
                F[j, column_act] += c * by_act
            if by_length != 0.0 or by_velocity != 0.0:
                for n in range(m.act_first[i], m.act_first[i + 1]):
                    F[j, m.act_dof[n]] += c * m.act_coef[n] * by_length
                    F[j, nv + m.act_dof[n]] += c * m.act_coef[n] * by_velocity
                    T[j, m.act_dof[n]] += c * m.act_coef[n] * by_velocity
            if rate != 0.0:
                E[j, column_u] += c * rate * w.input[i, 1]
                if m.act_adr[i] >= 0:
                    E[j, column_act] += c * rate * w.input[i, 2]


@numba.njit(cache=True, error_model="numpy", nogil=True)
def add_site_actuators(m, cdof, site_xpos, site_xmat, subtree_com, w, F):
    """F += df/dz of actuators that push at a site: a wrench W that moves with the site's body.

    Their generalized force is S_j . W. Turning a dof i turns W, and with it all S_j beyond i: what is left is
    S_j . (S_i x* W) for the j before i.
    """
    nv, na = m.nv, m.na
    for i in range(m.nu):
        site = m.act_site[i]
        if site < 0:
            continue
        body, R, gear = m.act_body[i], site_xmat[site], m.act_gear[i]
        push = _turn(R, gear[0], gear[1], gear[2])
        x = sub3(row3(site_xpos, site), row3(subtree_com, m.body_rootid[body]))
        W = join(add3(_turn(R, gear[3], gear[4], gear[5]), cross3(x, push)), push)
        force = w.act_force[i, 0]
        last = m.body_lastdof[body]
        k = last
        while k >= 0:
            moment = dot6(row6(cdof, k), W)
            F[k, 2 * nv + na + i] += moment * w.act_force[i, 3]
            if m.act_adr[i] >= 0:
                F[k, 2 * nv + m.act_adr[i]] += moment * w.act_force[i, 4]
            turned = cross_force(row6(cdof, k), W)
            j = m.dof_parentid[m.dof_group[k]]
            while j >= 0:
                F[j, k] += force * dot6(row6(cdof, j), turned)
                j = m.dof_parentid[j]
            k = m.dof_parentid[k]


@inlined
def _turn(R, x, y, z):
    """Rotation matrix, as a row of nine numbers, times a vector."""
    return (
        R[0] * x + R[1] * y + R[2] * z,
        R[3] * x + R[4] * y + R[5] * z,
        R[6] * x + R[7] * y + R[8] * z,
    )
