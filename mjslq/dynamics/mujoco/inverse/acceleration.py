"""Derivatives of the step's acceleration at one knot, by the implicit function theorem on the inverse dynamics.

Notation
--------
    a_d = (v_next - v) / h       acceleration of the discrete step, read off the trajectory
    a_c                          acceleration that MuJoCo's constraint rows see: M a_c = M^ a_d
    M^                           M (Euler), M + h D (Euler with joint damping), M - h T (implicitfast, T = df/dv of
                                 `laws`), and + h dc/dv on dofs with gyroscopic terms (implicit, and
                                 free bodies without joints under implicitfast)
    tau = M a + c                inverse dynamics of the rigid bodies (`rigid`)
    f, F = df/dz, E              other smooth forces, and E = h (d(T - dc/dv)/dz) a_d
    J' s                         constraint forces, s = s(J a_c - aref) (`constraints`)
    z = (q, v, act, u)           what is differentiated by, in tangent directions

The step satisfies M^ a_d = M a_c = f - c + J' s. By the implicit function theorem, without constraint rows

    da_d/dz = M^^-1 (F - dtau/dz + E)            at a = a_d,

because d(M^ a_d)/dz = d(M a_d)/dz - E + M^ da_d/dz; and with them, with H = -ds/d(J a_c),

    (M + J' H J) da_c/dz = F - dtau/dz + (d(J' s)/dz at fixed a_c)            at a = a_c,
    M^ da_d/dz = M da_c/dz + d(M x)/dz at x = a_c - a_d, + E.

The discrete integrator's step M~ a = f - h K v - c + J' s (M~: `metric`) has one acceleration, a = a_d = a_c, and

    (M~ + J' H J) da/dz = F - dtau/dz + E + (d(J' s)/dz at fixed a)            at a = a_d,

with rows of its own (`impedance`, `weights`); + h dc/dv on free bodies without joints that no row touches.
Then dv_next = dv + h da_d, and the positions follow from q_next = q (+) h v_next. Nothing is solved by iteration and
no step is repeated, so the derivatives do not see the constraint solver's noise.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.algebra import add_matrix, add_product, assign, factorize, fill, solve
from mjslq.dynamics.mujoco.inverse.forces.arms import add_arms, measure_arms
from mjslq.dynamics.mujoco.inverse.forces.differences import add_force_differences
from mjslq.dynamics.mujoco.inverse.forces.fluid import add_fluid
from mjslq.dynamics.mujoco.inverse.forces.laws import (
    activate,
    actuate,
    add_actuators,
    add_dampers,
    add_site_actuators,
    add_springs,
    add_tendons,
)
from mjslq.dynamics.mujoco.inverse.rigid import (
    add_compensation_derivative,
    add_mass_derivative,
    inward,
    mass_matrix,
    outward,
    subtract_derivatives,
)
from mjslq.dynamics.mujoco.inverse.rows.constraints import add_rows, evaluate_rows, read_row
from mjslq.dynamics.mujoco.inverse.rows.differences import add_differences
from mjslq.dynamics.mujoco.inverse.rows.impedance import present_rows
from mjslq.dynamics.mujoco.inverse.rows.metric import add_metric
from mjslq.dynamics.mujoco.inverse.rows.weights import add_weight_changes, weigh_rows
from mjslq.dynamics.mujoco.inverse.spatial import compiled
from mjslq.dynamics.mujoco.inverse.table.columns import ARMATURE, TENDON_NUMBERS
from mjslq.dynamics.mujoco.inverse.table.job import integers, matrix, vector
from mjslq.dynamics.mujoco.kernels import copy_into


@compiled
def smooth_forces(job, x, odd):
    """F, T and E of all smooth forces at the state x and control in mjData, for the step's acceleration acc_d."""
    M_hat = matrix(job.M_hat, job.nv, job.nv)
    T = matrix(job.T, job.nv, job.nv)
    F = matrix(job.F, job.nv, job.columns)
    E = matrix(job.E, job.nv, job.columns)
    acc_d = vector(job.acc_d, job.nv)
    fill(F, 0.0)
    fill(E, 0.0)
    fill(T, 0.0)
    add_springs(job, F)
    add_dampers(job, acc_d, F, T, E)
    if job.implicit == 1:
        for i in range(job.nv):
            M_hat[i, i] = -job.h * T[i, i]  # Euler takes the joints' damping implicitly, and nothing else
    add_tendons(job, acc_d, F, T, E)
    activate(job)
    if odd is not None and job.narm > 0:
        measure_arms(job)
    actuate(job)
    if odd is not None and job.narm > 0:
        add_arms(job, acc_d, F, T, E)
    add_actuators(job, acc_d, F, T, E)
    add_site_actuators(job, F)
    if job.compensated:
        add_compensation_derivative(job, F)
    if odd is not None and job.implicit == 3:
        add_metric(job, acc_d, F, T, E)
    if job.gyroscopic:
        _gyroscopic(job)
    if odd is not None and job.nfluid > 0:
        add_fluid(job, acc_d, F, T, E)
    if odd is not None and job.rest_model != 0:
        add_force_differences(job, x)


@compiled
def find_spinning(job, rows):
    """Mark the dofs with gyroscopic terms; the discrete integrator has none on bodies that a row touches."""
    spinning, tree = integers(job.spinning, job.nv), integers(job.dof_treeid, job.nv)
    dofs, values, given = integers(job.dofs, job.nv), vector(job.values, job.nv), integers(job.dof_gyroscopic, job.nv)
    for i in range(job.nv):
        spinning[i] = given[i]
    if job.implicit == 3:
        for r in range(rows):
            for k in range(read_row(job, r, dofs, values)):
                for i in range(job.nv):
                    if tree[i] == tree[dofs[k]]:
                        spinning[i] = 0


@compiled
def _gyroscopic(job):
    """G = h dc/dv, and E -= h (d(dc/dv)/dz) a_d, in the rows of the dofs whose bias force is taken implicitly.

    c is a quadratic form in v, so that (dc/dv) a is half the difference of c(v + a) and c(v - a), exactly, and its
    derivatives half the difference of theirs.
    """
    marked = integers(job.spinning, job.nv)
    qvel, acc_d, vel, acc = (
        vector(job.qvel, job.nv), vector(job.acc_d, job.nv), vector(job.change, job.nv), vector(job.acc_c, job.nv)
    )  # fmt: skip
    G, M = matrix(job.G, job.nv, job.nv), matrix(job.M, job.nv, job.nv)
    E, mixed = matrix(job.E, job.nv, job.columns), matrix(job.mixed, job.nv, job.columns)
    nv = job.nv
    for sign in (0.0, 1.0, -1.0):
        fill(mixed, 0.0)
        for i in range(nv):
            vel[i], acc[i] = qvel[i] + sign * acc_d[i], 0.0
        outward(job, vel, acc)
        inward(job)
        subtract_derivatives(job, mixed, M)
        for i in range(nv):
            if sign == 0.0:
                for j in range(nv):
                    G[i, j] = -job.h * mixed[i, nv + j] if marked[i] == 1 else 0.0
            elif marked[i] == 1:
                for c in range(2 * nv):
                    E[i, c] += 0.5 * sign * job.h * mixed[i, c]


@compiled
def complete_inertia(job):
    """Complete M by the tendons' armature, and make M^ of it."""
    dof_parentid = integers(job.dof_parentid, job.nv)
    ten_first = integers(job.ten_first, job.ntendon + 1)
    ten_dof = integers(job.ten_dof, job.nten_coef)
    ten_coef = vector(job.ten_coef, job.nten_coef)
    ten_prm = matrix(job.ten_prm, job.ntendon, TENDON_NUMBERS)
    M = matrix(job.M, job.nv, job.nv)
    M_hat = matrix(job.M_hat, job.nv, job.nv)
    T, G = matrix(job.T, job.nv, job.nv), matrix(job.G, job.nv, job.nv)
    for t in range(ten_prm.shape[0]):
        if ten_prm[t, ARMATURE] != 0.0:
            for k in range(ten_first[t], ten_first[t + 1]):
                for n in range(ten_first[t], ten_first[t + 1]):
                    moment = ten_coef[k] * ten_coef[n]
                    M[ten_dof[k], ten_dof[n]] += ten_prm[t, ARMATURE] * moment
    if job.implicit == 1:
        for i in range(job.nv):
            damping = M_hat[i, i]
            for j in range(job.nv):
                M_hat[i, j] = M[i, j]
            M_hat[i, i] += damping
        return
    assign(M_hat, M)
    if job.implicit == 2:
        # MuJoCo keeps of T what fits into the pattern of M: pairs of dofs on one branch
        lone = integers(job.dof_lone, job.nv)
        for i in range(job.nv):
            M_hat[i, i] -= job.h * T[i, i]
            j = dof_parentid[i] if lone[i] == 0 else -1
            while j >= 0:
                M_hat[i, j] -= job.h * T[i, j]
                M_hat[j, i] -= job.h * T[j, i]
                j = dof_parentid[j]
    if job.implicit == 3:
        for i in range(job.nv):
            for j in range(job.nv):
                M_hat[i, j] -= job.h * T[i, j]
    if job.gyroscopic:
        for i in range(job.nv):
            for j in range(job.nv):
                M_hat[i, j] += G[i, j]


@compiled
def _rigid_bodies(job, acc):
    """F -= dtau/dz at the acceleration `acc`, and M."""
    outward(job, vector(job.qvel, job.nv), acc)
    inward(job)
    subtract_derivatives(job, matrix(job.F, job.nv, job.columns), matrix(job.M, job.nv, job.nv))


@compiled
def smooth_step(job):
    """da_d/dz of a step without constraint rows, into F; False when M^ is singular."""
    M_hat = matrix(job.M_hat, job.nv, job.nv)
    F = matrix(job.F, job.nv, job.columns)
    E = matrix(job.E, job.nv, job.columns)
    acc_d = vector(job.acc_d, job.nv)
    _rigid_bodies(job, acc_d)
    complete_inertia(job)
    add_matrix(F, E)
    fine = factorize(M_hat)
    solve(M_hat, F)
    return fine


@compiled
def step_with_rows(job, x, count):
    """da_d/dz of a step with `count` constraint rows, into F, and what sensors of accelerations want to know."""
    plain = count == 0 and not (job.sensors_accelerated and 0 < job.implicit < 3)
    fine = smooth_step(job) if plain else _constrained_step(job, x)
    if plain and job.sensors_accelerated:
        copy_into(vector(job.acc_d, job.nv), vector(job.acc_c, job.nv))
        assign(matrix(job.acc_rate, job.nv, job.columns), matrix(job.F, job.nv, job.columns))
    return fine


@compiled
def _constrained_step(job, x):
    """da_d/dz of a step with constraint rows, into F; False when M^ or M + J' H J is singular."""
    M, M_hat, G = matrix(job.M, job.nv, job.nv), matrix(job.M_hat, job.nv, job.nv), matrix(job.G, job.nv, job.nv)
    F, E = matrix(job.F, job.nv, job.columns), matrix(job.E, job.nv, job.columns)
    mixed = matrix(job.mixed, job.nv, job.columns)
    acc_c, acc_d = vector(job.acc_c, job.nv), vector(job.acc_d, job.nv)
    nv = job.nv
    mass_matrix(job, M)
    complete_inertia(job)
    fine = continuous_acceleration(job, M, M_hat, G)
    fine = differentiate_acceleration(job, x) and fine
    if job.implicit == 0 or job.implicit == 3:
        return fine
    change = vector(job.change, nv)
    for i in range(nv):
        change[i] = acc_c[i] - acc_d[i]
        for c in range(job.columns):
            mixed[i, c] = E[i, c]
    add_product(M, F, mixed)
    add_mass_derivative(job, change, 1.0, mixed)
    fine = factorize(M_hat) and fine
    solve(M_hat, mixed)
    assign(F, mixed)
    return fine


@compiled
def differentiate_acceleration(job, x):
    """da_c/dz into F, and into acc_rate for the sensors; False when M + J' H J (discrete: M~ + J' H J) is singular."""
    M, G, F = matrix(job.M, job.nv, job.nv), matrix(job.G, job.nv, job.nv), matrix(job.F, job.nv, job.columns)
    acc_c = vector(job.acc_c, job.nv)
    if job.implicit == 3:
        weigh_rows(job)
    evaluate_rows(job, acc_c, 1)
    assign(G, M)
    if job.implicit == 3:
        assign(G, matrix(job.M_hat, job.nv, job.nv))
        add_matrix(F, matrix(job.E, job.nv, job.columns))
        present_rows(job)
        add_weight_changes(job, F)
    outward(job, vector(job.qvel, job.nv), acc_c)
    inward(job)
    subtract_derivatives(job, F, matrix(job.mixed, job.nv, job.nv))  # not into T, which rows are weighed by
    if add_rows(job, acc_c, F, G):
        add_differences(job, x, acc_c, F)
    fine = factorize(G)
    solve(G, F)
    if job.sensors_accelerated:
        assign(matrix(job.acc_rate, job.nv, job.columns), F)
    return fine


@compiled
def continuous_acceleration(job, M, M_hat, G):
    """a_c = M^-1 M^ a_d; False when M is singular."""
    acc_c, acc_d = matrix(job.acc_c, job.nv, 1), vector(job.acc_d, job.nv)
    for i in range(job.nv):
        acc_c[i, 0] = acc_d[i]
    if job.implicit == 0 or job.implicit == 3:
        return True
    for i in range(job.nv):
        acc_c[i, 0] = 0.0
        for j in range(job.nv):
            acc_c[i, 0] += M_hat[i, j] * acc_d[j]
    assign(G, M)
    fine = factorize(G)
    solve(G, acc_c)
    return fine
