"""Second derivatives of the forces of springs, dampers, tendons and actuators, contracted with multipliers.

Notation (`forces.laws`: the laws themselves; `multipliers`: w1, w2, a_d)
--------
    f(z), T = df/dv      passive and actuator forces, z = (q, v, act, u)
    phi = - w1' f - h w2' T a_d       what they are in the Lagrangian; T only where the integrator takes it implicitly
    c                    moment arm of a tendon or an actuator, its force F(length, velocity, input) on the dofs c F
    y1, y2, rate         c . w1, c . w2, c . a_d

so that each law is a function of a few numbers: its second derivative by them, times y1 or h y2 rate, and c c'.
"""

from __future__ import annotations

import math

from mjslq.dynamics.mujoco.inverse.forces.laws import add_ball_spring, site_wrench
from mjslq.dynamics.mujoco.inverse.spatial import (
    add6,
    compiled,
    dot6,
    put6,
    row6,
    scale6,
)
from mjslq.dynamics.mujoco.inverse.table.columns import (
    ACTUATOR_NUMBERS,
    BAND,
    DAMPING,
    FORCE_NUMBERS,
    FORCE_RANGE,
    GAIN,
    STIFFNESS,
    TENDON_NUMBERS,
)
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix, vector

_TURN = 1e-5
"""Size of the differences of the first derivatives of a ball joint's spring. [rad]"""


@compiled
def bend_springs(job, w1, Z):
    """Springs of joints."""
    spring_dof, spring_qadr = integers(job.spring_dof, job.nspring), integers(job.spring_qadr, job.nspring)
    spring_prm, qpos = matrix(job.spring_prm, job.nspring, 4), vector(job.qpos, job.nq)
    for s in range(job.nspring):
        i = spring_dof[s]
        x = qpos[spring_qadr[s]] - spring_prm[s, 0]
        Z[i, i] += w1[i] * (2.0 * spring_prm[s, 2] + 6.0 * spring_prm[s, 3] * x)
    for s in range(job.nball):
        _bend_ball_spring(job, s, w1, Z)


@compiled
def _bend_ball_spring(job, s, w1, Z):
    """Differences of w1' df/dq along the three axes; their mean with the transpose."""
    d, adr = integers(job.ball_dof, job.nball)[s], integers(job.ball_qadr, job.nball)[s]
    qpos, F = vector(job.qpos, job.nq), matrix(job.F, job.nv, job.columns)
    q0, q1, q2, q3 = qpos[adr], qpos[adr + 1], qpos[adr + 2], qpos[adr + 3]
    sine, cosine = math.sin(0.5 * _TURN), math.cos(0.5 * _TURN)
    for k in range(3):
        for side in range(2):
            t = sine if side == 0 else -sine
            x, y, z = (t if k == 0 else 0.0), (t if k == 1 else 0.0), (t if k == 2 else 0.0)
            qpos[adr] = q0 * cosine - q1 * x - q2 * y - q3 * z
            qpos[adr + 1] = q1 * cosine + q0 * x + q2 * z - q3 * y
            qpos[adr + 2] = q2 * cosine + q0 * y + q3 * x - q1 * z
            qpos[adr + 3] = q3 * cosine + q0 * z + q1 * y - q2 * x
            for i in range(3):
                for j in range(3):
                    F[d + i, d + j] = 0.0
            add_ball_spring(job, s, F)
            share = -0.25 / _TURN if side == 0 else 0.25 / _TURN
            for j in range(3):
                slope = 0.0
                for i in range(3):
                    slope += w1[d + i] * F[d + i, d + j]
                Z[d + k, d + j] += share * slope
                Z[d + j, d + k] += share * slope
    qpos[adr], qpos[adr + 1], qpos[adr + 2], qpos[adr + 3] = q0, q1, q2, q3


@compiled
def bend_dampers(job, w1, w2, acc_d, Z, Xd):
    """Dampers of joints."""
    dof_damping, qvel, nv = matrix(job.dof_damping, job.nv, 3), vector(job.qvel, job.nv), job.nv
    for i in range(nv):
        d2, d3, v = dof_damping[i, 1], dof_damping[i, 2], qvel[i]
        if d2 != 0.0 or d3 != 0.0:
            bend = math.copysign(2.0, v) * d2 + 6.0 * d3 * v
            Z[nv + i, nv + i] += w1[i] * bend
            if job.implicit >= 1:
                Z[nv + i, nv + i] += job.h * w2[i] * 6.0 * d3 * acc_d[i]
                Xd[i, nv + i] += job.h * w2[i] * bend


@compiled
def bend_tendons(job, w1, w2, acc_d, Z, Xd):
    """Springs and dampers of fixed tendons."""
    dof_qadr, ten_dof = integers(job.dof_qadr, job.nv), integers(job.ten_dof, job.nten_coef)
    ten_first, ten_coef = integers(job.ten_first, job.ntendon + 1), vector(job.ten_coef, job.nten_coef)
    ten_prm = matrix(job.ten_prm, job.ntendon, TENDON_NUMBERS)
    qpos, qvel, nv = vector(job.qpos, job.nq), vector(job.qvel, job.nv), job.nv
    for t in range(job.ntendon):
        prm, first, last = ten_prm[t], ten_first[t], ten_first[t + 1]
        length, velocity, rate, y1, y2 = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(first, last):
            i, c = ten_dof[k], ten_coef[k]
            length += c * qpos[dof_qadr[i]]
            velocity += c * qvel[i]
            rate += c * acc_d[i]
            y1 += c * w1[i]
            y2 += c * w2[i]
        x = max(length - prm[BAND + 1], 0.0) + min(length - prm[BAND], 0.0)
        by_length = y1 * (2.0 * prm[STIFFNESS + 1] + 6.0 * prm[STIFFNESS + 2] * x) if x != 0.0 else 0.0
        d2, d3 = prm[DAMPING + 1], prm[DAMPING + 2]
        bend = math.copysign(2.0, velocity) * d2 + 6.0 * d3 * velocity
        by_velocity, mixed = y1 * bend, 0.0
        if job.implicit >= 2:
            by_velocity += job.h * y2 * 6.0 * d3 * rate
            mixed = job.h * y2 * bend
        if by_length == 0.0 and by_velocity == 0.0 and mixed == 0.0:
            continue
        for k in range(first, last):
            for n in range(first, last):
                i, j, square = ten_dof[k], ten_dof[n], ten_coef[k] * ten_coef[n]
                Z[i, j] += by_length * square
                Z[nv + i, nv + j] += by_velocity * square
                Xd[i, nv + j] += mixed * square


@compiled
def bend_actuators(job, w1, w2, acc_d, Z, Xd):
    """Actuators on joints and fixed tendons whose gain depends on length or velocity; all others are affine."""
    act_first, act_dof = integers(job.act_first, job.nu + 1), integers(job.act_dof, job.nact_coef)
    act_coef, act_prm = vector(job.act_coef, job.nact_coef), matrix(job.act_prm, job.nu, ACTUATOR_NUMBERS)
    act_adr, act_input = integers(job.act_adr, job.nu), matrix(job.act_input, job.nu, 3)
    act_free, nv, na = vector(job.act_free, job.nv), job.nv, job.na
    for i in range(job.nu):
        prm = act_prm[i]
        gain_l, gain_v = prm[GAIN + 1], prm[GAIN + 2]
        if gain_l == 0.0 and gain_v == 0.0:
            continue
        if not prm[FORCE_RANGE] <= _unclipped(job, i) <= prm[FORCE_RANGE + 1]:
            continue
        y1, y2, rate = 0.0, 0.0, 0.0
        for k in range(act_first[i], act_first[i + 1]):
            j, c = act_dof[k], act_coef[k]
            y1 += c * act_free[j] * w1[j]
            y2 += c * act_free[j] * w2[j]
            rate += c * acc_d[j]
        if job.implicit < 2:
            y2 = 0.0
        for k in range(act_first[i], act_first[i + 1]):
            j, c = act_dof[k], act_coef[k]
            for way in range(2):
                if way == 1 and act_adr[i] < 0:
                    continue
                column = 2 * nv + na + i if way == 0 else 2 * nv + act_adr[i]
                slope = c * act_input[i, 1 + way]
                Z[j, column] -= y1 * gain_l * slope
                Z[column, j] -= y1 * gain_l * slope
                Z[nv + j, column] -= y1 * gain_v * slope
                Z[column, nv + j] -= y1 * gain_v * slope
                Xd[j, column] -= job.h * y2 * gain_v * slope


@compiled
def _unclipped(job, i):
    """Force of an actuator before its limits; inf where it is switched off."""
    act_first, act_dof = integers(job.act_first, job.nu + 1), integers(job.act_dof, job.nact_coef)
    act_coef, prm = vector(job.act_coef, job.nact_coef), matrix(job.act_prm, job.nu, ACTUATOR_NUMBERS)[i]
    dof_qadr, qpos, qvel = integers(job.dof_qadr, job.nv), vector(job.qpos, job.nq), vector(job.qvel, job.nv)
    if integers(job.act_enabled, job.nu)[i] == 0:
        return math.inf
    length, velocity = 0.0, 0.0
    for k in range(act_first[i], act_first[i + 1]):
        j = act_dof[k]
        if dof_qadr[j] >= 0:
            length += act_coef[k] * qpos[dof_qadr[j]]
        velocity += act_coef[k] * qvel[j]
    x = matrix(job.act_input, job.nu, 3)[i, 0]
    gain = prm[GAIN] + prm[GAIN + 1] * length + prm[GAIN + 2] * velocity
    return gain * x + prm[GAIN + 3] + prm[GAIN + 4] * length + prm[GAIN + 5] * velocity


@compiled
def pull_at_sites(job):
    """body_force -= the wrenches of actuators at sites: they move with their bodies, as inertia forces do."""
    act_site, act_body = integers(job.act_site, job.nu), integers(job.act_body, job.nu)
    act_force = matrix(job.act_force, job.nu, FORCE_NUMBERS)
    body_force = matrix(job.body_force, job.nbody, 6)
    for i in range(job.nu):
        if act_site[i] >= 0:
            b = act_body[i]
            put6(body_force, b, add6(row6(body_force, b), scale6(-act_force[i, 0], site_wrench(job, i))))


@compiled
def bend_site_actuators(job, Z):
    """Z -= the change of the wrenches with u and act times that of W with position."""
    act_site, act_body = integers(job.act_site, job.nu), integers(job.act_body, job.nu)
    body_lastdof, dof_parentid = integers(job.body_lastdof, job.nbody), integers(job.dof_parentid, job.nv)
    act_adr, act_force = integers(job.act_adr, job.nu), matrix(job.act_force, job.nu, FORCE_NUMBERS)
    dof_W, nv, na = matrix(job.dof_W, job.nv, 6), job.nv, job.na
    for i in range(job.nu):
        if act_site[i] < 0:
            continue
        W = site_wrench(job, i)
        j = body_lastdof[act_body[i]]
        while j >= 0:
            moment = dot6(row6(dof_W, j), W)
            for way in range(2):
                if way == 0 or act_adr[i] >= 0:
                    column = 2 * nv + na + i if way == 0 else 2 * nv + act_adr[i]
                    Z[j, column] -= moment * act_force[i, 3 + way]
                    Z[column, j] -= moment * act_force[i, 3 + way]
            j = dof_parentid[j]
