"""Second derivatives of lambda_{n+1}' x_{n+1} + w_n' y_n along a trajectory: one compiled loop over the knots.

At each knot: the kinematics, by MuJoCo; the multipliers of the equations of motion (`multipliers`); the second
derivatives of the Lagrangian phi, in blocks that `hessians` puts together:

    Z        phi_zz, and the readings' second derivatives. Shape (columns, columns)
    Xd, Xc   phi_az for the accelerations a_d and a_c, with phi_aa S / 2 added. Shape (nv, columns)
    Sc       da_c/dz. Shape (nv, columns)

    H = Z + Xd' S_d + Xc' S_c + transposes of the last two.

Xc and Sc are there only at knots that are marked as having an a_c apart from a_d.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mjslq.dynamics.mujoco.inverse.acceleration import (
    complete_inertia,
    continuous_acceleration,
    find_spinning,
    smooth_forces,
)
from mjslq.dynamics.mujoco.inverse.algebra import fill
from mjslq.dynamics.mujoco.inverse.curvature.laws import (
    bend_actuators,
    bend_dampers,
    bend_site_actuators,
    bend_springs,
    bend_tendons,
    pull_at_sites,
)
from mjslq.dynamics.mujoco.inverse.curvature.multipliers import (
    first_multiplier,
    read_rates,
    second_multiplier,
    write_constrained_rates,
)
from mjslq.dynamics.mujoco.inverse.curvature.readings import bend_readings
from mjslq.dynamics.mujoco.inverse.curvature.rigid import add_second_derivatives, inward_test, outward_test
from mjslq.dynamics.mujoco.inverse.curvature.rows import bend_rows, weigh_rows
from mjslq.dynamics.mujoco.inverse.kernel import load
from mjslq.dynamics.mujoco.inverse.rigid import inward, mass_matrix, outward
from mjslq.dynamics.mujoco.inverse.rows.constraints import evaluate_rows, find_rows
from mjslq.dynamics.mujoco.inverse.rows.differences import mj_comPos, mj_kinematics
from mjslq.dynamics.mujoco.inverse.spatial import compiled, cross_motion, inertia_times, put6, row6
from mjslq.dynamics.mujoco.inverse.table.job import JOB, integers, matrix, vector
from mjslq.dynamics.mujoco.kernels import copy_into, mj_resetData
from mjslq.native.memory import carray


@compiled
def _bend_bodies(job, w, acc, sign_c, Xc, sign_d, Xd, Z):
    """Rigid bodies and actuators at sites: w' (M a + c)."""
    outward(job, vector(job.qvel, job.nv), acc)
    outward_test(job, w)
    pull_at_sites(job)
    inward(job)
    inward_test(job)
    add_second_derivatives(job, 1.0, 1.0, Z, sign_c, Xc, sign_d, Xd)
    bend_site_actuators(job, Z)


@compiled
def _bend_mass(job, w, Xc, Xd, Z):
    """W' M (a_d - a_c): no velocities and no weights."""
    still, change = vector(job.masked, job.nv), vector(job.change, job.nv)
    acc_c, acc_d = vector(job.acc_c, job.nv), vector(job.acc_d, job.nv)
    for i in range(job.nv):
        still[i], change[i] = 0.0, acc_d[i] - acc_c[i]
    weight = job.gravity
    job.gravity = job.weightless
    outward(job, still, change)
    job.gravity = weight
    outward_test(job, w)
    inward(job)
    inward_test(job)
    add_second_derivatives(job, 1.0, 0.0, Z, -1.0, Xc, 1.0, Xd)


@compiled
def _bend_compensation(job, w, Xd, Z):
    """Weights that are carried: what bodies of other masses would weigh."""
    gravity, gravcomp = vector(job.gravity, 3), vector(job.body_gravcomp, job.nbody)
    cdof, dof_R = matrix(job.cdof, job.nv, 6), matrix(job.dof_R, job.nv, 6)
    cinert, inertia = matrix(job.cinert, job.nbody, 10), matrix(job.body_inertia, job.nbody, 10)
    force, lift = matrix(job.body_force, job.nbody, 6), (0.0, 0.0, 0.0, -gravity[0], -gravity[1], -gravity[2])
    fill(matrix(job.body_Y, job.nbody, 6), 0.0)
    fill(matrix(job.body_momentum, job.nbody, 6), 0.0)
    fill(matrix(job.dof_P, job.nv, 6), 0.0)
    fill(matrix(job.dof_Q, job.nv, 6), 0.0)
    for i in range(job.nv):
        put6(dof_R, i, cross_motion(lift, row6(cdof, i)))
    for b in range(job.nbody):
        for k in range(10):
            inertia[b, k] = gravcomp[b] * cinert[b, k]
        put6(force, b, inertia_times(inertia, b, lift))
    outward_test(job, w)
    inward(job)
    inward_test(job)
    add_second_derivatives(job, -1.0, 0.0, Z, 0.0, Xd, 0.0, Xd)


@compiled
def _bend_spin(job, w2, Xd, Z):
    """H w2' (dc/dv) a_d of dofs whose bias force is taken implicitly: half of c(v + a_d) less half of c(v - a_d)."""
    marked, w = integers(job.spinning, job.nv), vector(job.masked, job.nv)
    qvel, acc_d = vector(job.qvel, job.nv), vector(job.acc_d, job.nv)
    vel, none = vector(job.change, job.nv), vector(job.plus, job.nv)
    Zg, Xg, Sd = (
        matrix(job.Zg, job.columns, job.columns), matrix(job.Xg, job.nv, job.columns),
        matrix(job.Sd, job.nv, job.columns),
    )  # fmt: skip
    nv = job.nv
    for i in range(nv):
        w[i] = w2[i] if marked[i] == 1 else 0.0
        none[i] = 0.0
    for side in range(2):
        sign = 1.0 if side == 0 else -1.0
        for i in range(nv):
            vel[i] = qvel[i] + sign * acc_d[i]
        fill(Zg, 0.0)
        outward(job, vel, none)
        outward_test(job, w)
        inward(job)
        inward_test(job)
        add_second_derivatives(job, 0.5 * sign * job.h, 0.5 * sign * job.h, Zg, 0.0, Xg, 0.0, Xg)
        # c depends on a_d as it does on v, up to the sign
        for i in range(nv):
            for j in range(nv):
                Z[i, j] += Zg[i, j]
                Z[i, nv + j] += Zg[i, nv + j]
                Z[nv + i, j] += Zg[nv + i, j]
                Z[nv + i, nv + j] += Zg[nv + i, nv + j]
                Xd[i, j] += sign * Zg[nv + i, j]
                Xd[i, nv + j] += sign * Zg[nv + i, nv + j]
                half = 0.5 * Zg[nv + i, nv + j]
                if half != 0.0:
                    for c in range(job.columns):
                        Xd[i, c] += half * Sd[j, c]


@compiled
def _bend_step(job, x, v_next, A, B, pull, Z, Xd, Xc, Sc, apart, rows):
    """Z, Xd, and where there are rows Xc and Sc, of a step from x; False where the equations are singular."""
    M, G = matrix(job.M, job.nv, job.nv), matrix(job.G, job.nv, job.nv)
    acc_d, acc_c, w1, w2 = (
        vector(job.acc_d, job.nv), vector(job.acc_c, job.nv), vector(job.w1, job.nv), vector(job.w2, job.nv)
    )  # fmt: skip
    count, apart[0] = 0, 0
    for i in range(job.nv):
        acc_d[i] = (v_next[i] - x[job.nq + i]) / job.h
    if rows is not None and job.constrained:
        count = find_rows(job)
    if job.gyroscopic:
        find_spinning(job, count)
    smooth_forces(job, x, None)
    mass_matrix(job, M)
    complete_inertia(job)
    fine = True
    if rows is not None and count > 0:
        read_rates(job, A, B)
        fine = continuous_acceleration(job, M, matrix(job.M_hat, job.nv, job.nv), G)
        if job.implicit > 0:
            apart[0] = 1
            write_constrained_rates(job, G, Sc)
    elif job.gyroscopic:
        read_rates(job, A, B)
    fine = second_multiplier(job, pull) and fine
    copy_into(w2, w1)
    if rows is not None and count > 0:
        evaluate_rows(job, acc_c, 1)
        weigh_rows(job, M, G)
        fine = first_multiplier(job, G) and fine
    if apart[0] == 1:
        _bend_bodies(job, w1, acc_c, 1.0, Xc, 0.0, Xd, Z)
        _bend_mass(job, w2, Xc, Xd, Z)
    else:
        _bend_bodies(job, w1, acc_d, 0.0, Xd, 1.0, Xd, Z)
    if job.compensated:
        _bend_compensation(job, w1, Xd, Z)
    bend_springs(job, w1, Z)
    bend_dampers(job, w1, w2, acc_d, Z, Xd)
    bend_tendons(job, w1, w2, acc_d, Z, Xd)
    bend_actuators(job, w1, w2, acc_d, Z, Xd)
    if job.gyroscopic:
        _bend_spin(job, w2, Xd, Z)
    if rows is not None and count > 0:
        if apart[0] == 1:
            bend_rows(job, x, Z, Xc, Sc)
        else:
            bend_rows(job, x, Z, Xd, matrix(job.Sd, job.nv, job.columns))
    return fine


def make_loop(constrained: bool, feeling: bool) -> Callable[..., Any]:
    """The loop over the knots; with constraint rows, and with sensors by differences."""
    rows, felt = 1 if constrained else None, 1 if feeling else None

    def bend(_model, _data, worker, jobs):
        """Blocks of the knots first ... last - 1; knot N has only Z, of its readings."""
        job = carray(jobs, worker + 1, JOB)[worker]
        nx, ndx, nu, ny, nv, cols = job.nq + job.nv + job.na, 2 * job.nv + job.na, job.nu, job.ny, job.nv, job.columns
        X, U, ends = matrix(job.X, job.N + 1, nx), matrix(job.U, job.N, nu), matrix(job.ends, job.N, nx)
        no_control, apart = vector(job.no_control, nu), integers(job.apart, job.N + 1)
        mj_resetData(job.model, job.data)
        for n in range(job.first, job.last):
            Z = matrix(job.Z + 8 * n * cols * cols, cols, cols)
            load(job, X[n], U[n] if n < job.N else no_control)
            mj_kinematics(job.model, job.data)
            mj_comPos(job.model, job.data)
            if job.weights != 0:
                bend_readings(job, X[n], vector(job.weights + 8 * n * ny, ny), Z, felt)
            if n < job.N:
                at, at_A, at_B = 8 * n * nv * cols, job.A + 8 * n * ndx * ndx, job.B + 8 * n * ndx * nu
                fine = _bend_step(
                    job, X[n], ends[n, job.nq : job.nq + nv], matrix(at_A, ndx, ndx), matrix(at_B, ndx, nu),
                    vector(job.pull + 8 * n * nv, nv), Z, matrix(job.Xd + at, nv, cols), matrix(job.Xc + at, nv, cols),
                    matrix(job.Sc + at, nv, cols), apart[n : n + 1], rows,
                )  # fmt: skip
                if not fine:
                    fill(Z, np.nan)

    return bend
