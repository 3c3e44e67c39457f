"""The metric M~ of the discrete integrator: springs, dampers and servos that are implicit in position and velocity.

Notation
--------
    K, D              positive stiffness and damping: every spring, damper and actuator contributes max(0, k) m m' and
                      max(0, d) m m', with m its moment arm and k, d the negative slopes of its force
    T = -(D + h K)    so that M~ = M - h T, as for the other implicit integrators
    -h K v            what the step adds to the forces f: its positions are those of its end
    E                 h (dT/dz) a - h (dK/dz) v, for fixed a and v
    s_i = -h T_ii     what M~ adds to the diagonal of M; ds/dz matters to the constraint rows (`weights`)

The step is M~ a = f - h K v - c + J' s with one acceleration, its own (MuJoCo's documentation, "Numerical
integration"). Moment arms are constant here, so that only k and d change: with polynomial springs and dampers, and
with the inputs of actuators whose gain depends on length or velocity. Ball joints have max(0, k(|phi|)) on each of
their axes, phi the rotation from rest. Joints clamp the sum of their own damping and their actuators', every other
contribution is clamped by itself. Actuators at their force limits contribute nothing; under the solver PGS neither
actuators nor tendons do, and the rest stands. A tendon whose dead band has no width counts at its rest as it does next
to it, although MuJoCo leaves it out at that one point.
"""

from __future__ import annotations

import math

from mjslq.dynamics.mujoco.inverse.forces.kinks import displacement, sign
from mjslq.dynamics.mujoco.inverse.spatial import compiled, inlined
from mjslq.dynamics.mujoco.inverse.table.columns import (
    ACTUATOR_NUMBERS,
    BAND,
    DAMPING,
    FORCE_NUMBERS,
    GAIN,
    STIFFNESS,
    TENDON_NUMBERS,
)
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix, vector
from mjslq.native.declare import external

mju_subQuat = external("mju_subQuat", "void(intp, intp, intp)")


@compiled
def add_metric(job, acc, F, T, E):
    """Write T, E and ds/dz, and F += d(-h K v)/dv; the actuators have been evaluated."""
    slope = matrix(job.metric_slope, job.nv, job.columns)
    for i in range(job.nv):
        for j in range(job.nv):
            T[i, j] = 0.0
        for c in range(job.columns):
            E[i, c] = slope[i, c] = 0.0
    _add_dofs(job, acc, F, T, E, slope)
    _add_balls(job, acc, F, T, E, slope)
    if job.coupled:
        _add_tendons(job, acc, F, T, E, slope)
        _add_actuators(job, acc, F, T, E, slope)


@inlined
def _curve(first, second, third, x):
    """Slope of the force first x + second x |x| + third x^3, and the slope's own."""
    return first + 2.0 * second * abs(x) + 3.0 * third * x * x, 2.0 * sign(x) * second + 6.0 * third * x


@inlined
def _spring_curve(first, second, third, x):
    """Slope of the force first x + second x^2 + third x^3, and the slope's own."""
    return first + x * (2.0 * second + 3.0 * third * x), 2.0 * second + 6.0 * third * x


@compiled
def _add_dofs(job, acc, F, T, E, slope):
    """Springs of hinges, slides and free translations, and the dampers of all dofs."""
    dof_damping, qvel = matrix(job.dof_damping, job.nv, 3), vector(job.qvel, job.nv)
    spring_dof, spring_qadr = integers(job.spring_dof, job.nspring), integers(job.spring_qadr, job.nspring)
    spring_prm, qpos = matrix(job.spring_prm, job.nspring, 4), vector(job.qpos, job.nq)
    h, nv = job.h, job.nv
    for i in range(nv):
        d, change = _curve(dof_damping[i, 0], dof_damping[i, 1], dof_damping[i, 2], qvel[i])
        if d > 0.0:
            T[i, i] -= d
            E[i, nv + i] -= h * change * acc[i]
            slope[i, nv + i] += h * change
    for s in range(job.nspring):
        i, prm = spring_dof[s], spring_prm[s]
        k, change = _spring_curve(prm[1], prm[2], prm[3], qpos[spring_qadr[s]] - prm[0])
        if k > 0.0:
            T[i, i] -= h * k
            F[i, nv + i] -= h * k
            E[i, i] -= h * change * (h * acc[i] + qvel[i])
            slope[i, i] += h * h * change


@compiled
def _add_balls(job, acc, F, T, E, slope):
    """Springs of ball joints and free rotations: d|phi| = phi . dq / |phi|."""
    ball_dof, ball_qadr = integers(job.ball_dof, job.nball), integers(job.ball_qadr, job.nball)
    ball_prm, qvel, phi = matrix(job.ball_prm, job.nball, 7), vector(job.qvel, job.nv), vector(job.small, 3)
    h, nv = job.h, job.nv
    for s in range(job.nball):
        d, prm = ball_dof[s], ball_prm[s]
        mju_subQuat(phi.ctypes.data, job.qpos + 8 * ball_qadr[s], job.ball_prm + 56 * s)
        size = math.sqrt(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
        k, change = _spring_curve(prm[4], prm[5], prm[6], size)
        if k <= 0.0:
            continue
        for i in range(d, d + 3):
            T[i, i] -= h * k
            F[i, nv + i] -= h * k
            for j in range(3):
                along = h * change * phi[j] / size if size > 1e-12 else 0.0
                E[i, d + j] -= along * (h * acc[i] + qvel[i])
                slope[i, d + j] += h * along


@compiled
def _add_tendons(job, acc, F, T, E, slope):
    ten_first, ten_dof = integers(job.ten_first, job.ntendon + 1), integers(job.ten_dof, job.nten_coef)
    ten_coef, ten_prm = vector(job.ten_coef, job.nten_coef), matrix(job.ten_prm, job.ntendon, TENDON_NUMBERS)
    dof_qadr, qpos, qvel = integers(job.dof_qadr, job.nv), vector(job.qpos, job.nq), vector(job.qvel, job.nv)
    h, nv = job.h, job.nv
    for t in range(job.ntendon):
        first, last, prm = ten_first[t], ten_first[t + 1], ten_prm[t]
        dofs, arms = ten_dof[first:last], ten_coef[first:last]
        length = 0.0
        for n in range(last - first):
            length += arms[n] * qpos[dof_qadr[dofs[n]]]
        velocity, rate = _along(dofs, arms, qvel), _along(dofs, arms, acc)
        d, d_change = _curve(prm[DAMPING], prm[DAMPING + 1], prm[DAMPING + 2], velocity)
        if d <= 0.0:
            d, d_change = 0.0, 0.0
        x, outside = displacement(length, prm[BAND], prm[BAND + 1])
        k, k_change = _spring_curve(prm[STIFFNESS], prm[STIFFNESS + 1], prm[STIFFNESS + 2], x)
        k, k_change = (outside * k, outside * k_change) if k > 0.0 else (0.0, 0.0)
        _add_term(job, dofs, arms, d, k, F, T)
        by_v, by_q = h * d_change, h * k_change
        if by_v == 0.0 and by_q == 0.0:
            continue
        for n in range(last - first):
            for m in range(last - first):
                i, j, c = dofs[n], dofs[m], arms[n] * arms[m]
                E[i, nv + j] -= c * by_v * rate
                E[i, j] -= c * by_q * (h * rate + velocity)
                slope[i, nv + j] += c * arms[n] * by_v
                slope[i, j] += c * arms[n] * h * by_q


@compiled
def _add_actuators(job, acc, F, T, E, slope):
    act_first, act_dof = integers(job.act_first, job.nu + 1), integers(job.act_dof, job.nact_coef)
    act_coef, act_prm = vector(job.act_coef, job.nact_coef), matrix(job.act_prm, job.nu, ACTUATOR_NUMBERS)
    act_adr, act_free = integers(job.act_adr, job.nu), vector(job.act_free, job.nv)
    act_input, act_force = matrix(job.act_input, job.nu, 3), matrix(job.act_force, job.nu, FORCE_NUMBERS)
    qvel, h, nv, na = vector(job.qvel, job.nv), job.h, job.nv, job.na
    for a in range(job.nu):
        first, last, prm = act_first[a], act_first[a + 1], act_prm[a]
        dofs, arms = act_dof[first:last], act_coef[first:last]
        if first == last or act_free[dofs[0]] == 0.0:
            continue
        k, d = max(0.0, -act_force[a, 1]), max(0.0, -act_force[a, 2])
        if k == 0.0 and d == 0.0:
            continue
        _add_term(job, dofs, arms, d, k, F, T)
        k_change, d_change = -prm[GAIN + 1] if k > 0.0 else 0.0, -prm[GAIN + 2] if d > 0.0 else 0.0
        if k_change == 0.0 and d_change == 0.0:
            continue
        velocity, rate = _along(dofs, arms, qvel), _along(dofs, arms, acc)
        force, inertia = h * (d_change * rate + k_change * (h * rate + velocity)), h * (d_change + h * k_change)
        for n in range(last - first):
            i, c = dofs[n], arms[n]
            E[i, 2 * nv + na + a] -= c * force * act_input[a, 1]
            slope[i, 2 * nv + na + a] += c * c * inertia * act_input[a, 1]
            if act_adr[a] >= 0:
                E[i, 2 * nv + act_adr[a]] -= c * force * act_input[a, 2]
                slope[i, 2 * nv + act_adr[a]] += c * c * inertia * act_input[a, 2]


@inlined
def _along(dofs, arms, x):
    """Return m' x."""
    total = 0.0
    for n in range(dofs.shape[0]):
        total += arms[n] * x[dofs[n]]
    return total


@compiled
def _add_term(job, dofs, arms, d, k, F, T):
    """T -= (d + h k) m m', and F -= h k m m' in the columns of the velocities."""
    for n in range(dofs.shape[0]):
        for m in range(dofs.shape[0]):
            i, j, c = dofs[n], dofs[m], arms[n] * arms[m]
            T[i, j] -= c * (d + job.h * k)
            F[i, job.nv + j] -= c * job.h * k
