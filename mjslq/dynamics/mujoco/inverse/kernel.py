"""Jacobians of MuJoCo's discrete step through its inverse dynamics: one compiled loop over the horizon.

Notation
--------
    a_d = (v_next - v) / h       acceleration of the discrete step, read off the trajectory
    a_c                          acceleration that MuJoCo's constraint rows see: M a_c = M^ a_d
    M^                           M (Euler), M + h D (Euler with joint damping), M - h T (implicitfast, T = df/dv of
                                 `forces`), and + h dc/dv on dofs with gyroscopic terms (implicit, and
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

import functools
import zlib
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import types

from mjslq.dynamics.mujoco.inverse.algebra import add_product, factorize, solve
from mjslq.dynamics.mujoco.inverse.arms import add_arms, measure_arms
from mjslq.dynamics.mujoco.inverse.columns import ARMATURE, TENDON_NUMBERS
from mjslq.dynamics.mujoco.inverse.constraints import add_rows, evaluate_rows, find_rows, read_row
from mjslq.dynamics.mujoco.inverse.differences import add_differences, mj_comPos, mj_kinematics
from mjslq.dynamics.mujoco.inverse.fluid import add_fluid
from mjslq.dynamics.mujoco.inverse.force_differences import add_force_differences
from mjslq.dynamics.mujoco.inverse.forces import (
    activate,
    actuate,
    add_actuators,
    add_dampers,
    add_site_actuators,
    add_springs,
    add_tendons,
)
from mjslq.dynamics.mujoco.inverse.impedance import present_rows
from mjslq.dynamics.mujoco.inverse.job import JOB, integers, matrix, vector
from mjslq.dynamics.mujoco.inverse.metric import add_metric
from mjslq.dynamics.mujoco.inverse.rigid import (
    add_compensation_derivative,
    add_mass_derivative,
    inward,
    mass_matrix,
    outward,
    subtract_derivatives,
)
from mjslq.dynamics.mujoco.inverse.sensors import write_feelings, write_motions
from mjslq.dynamics.mujoco.inverse.spatial import compiled, inlined
from mjslq.dynamics.mujoco.inverse.weights import add_weight_changes, weigh_rows
from mjslq.dynamics.mujoco.kernels import (
    _address,
    _compiled,
    _copy,
    _number,
    _void,
    mj_forward,
    mj_resetData,
)

mjd_quatIntegrate = types.ExternalFunction(  # noqa: N816
    "mjd_quatIntegrate", _void(_address, _number, _address, _address, _address)
)


@inlined
def _fill(A, value):
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] = value


@inlined
def _assign(A, B):
    # not A[:, :] = B, whose check of shapes takes seconds to compile
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] = B[i, j]


@inlined
def _add(A, B):
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] += B[i, j]


@compiled
def _smooth_forces(job):
    """F, T and E of all smooth forces at the state and control in mjData, for the step's acceleration acc_d."""
    M_hat = matrix(job.M_hat, job.nv, job.nv)
    T = matrix(job.T, job.nv, job.nv)
    F = matrix(job.F, job.nv, job.columns)
    E = matrix(job.E, job.nv, job.columns)
    acc_d = vector(job.acc_d, job.nv)
    _fill(F, 0.0)
    _fill(E, 0.0)
    _fill(T, 0.0)
    add_springs(job, F)
    add_dampers(job, acc_d, F, T, E)
    if job.implicit == 1:
        for i in range(job.nv):
            M_hat[i, i] = -job.h * T[i, i]  # Euler takes the joints' damping implicitly, and nothing else
    add_tendons(job, acc_d, F, T, E)
    activate(job)
    if job.narm > 0:
        measure_arms(job)
    actuate(job)
    if job.narm > 0:
        add_arms(job, acc_d, F, T, E)
    add_actuators(job, acc_d, F, T, E)
    add_site_actuators(job, F)
    if job.compensated:
        add_compensation_derivative(job, F)
    if job.implicit == 3:
        add_metric(job, acc_d, F, T, E)
    if job.gyroscopic:
        _gyroscopic(job)
    if job.nfluid > 0:
        add_fluid(job, acc_d, F, T, E)


@compiled
def _find_spinning(job, rows):
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
        _fill(mixed, 0.0)
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
def _inertia(job):
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
    _assign(M_hat, M)
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
def _smooth_step(job):
    """da_d/dz of a step without constraint rows, into F; False when M^ is singular."""
    M_hat = matrix(job.M_hat, job.nv, job.nv)
    F = matrix(job.F, job.nv, job.columns)
    E = matrix(job.E, job.nv, job.columns)
    acc_d = vector(job.acc_d, job.nv)
    _rigid_bodies(job, acc_d)
    _inertia(job)
    _add(F, E)
    fine = factorize(M_hat)
    solve(M_hat, F)
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
    _inertia(job)
    fine = _continuous_acceleration(job, M, M_hat, G)
    fine = _differentiate_acceleration(job, x) and fine
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
    _assign(F, mixed)
    return fine


@compiled
def _differentiate_acceleration(job, x):
    """da_c/dz into F, and into acc_rate for the sensors; False when M + J' H J (discrete: M~ + J' H J) is singular."""
    M, G, F = matrix(job.M, job.nv, job.nv), matrix(job.G, job.nv, job.nv), matrix(job.F, job.nv, job.columns)
    acc_c = vector(job.acc_c, job.nv)
    if job.implicit == 3:
        weigh_rows(job)
    evaluate_rows(job, acc_c, 1)
    _assign(G, M)
    if job.implicit == 3:
        _assign(G, matrix(job.M_hat, job.nv, job.nv))
        _add(F, matrix(job.E, job.nv, job.columns))
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
        _assign(matrix(job.acc_rate, job.nv, job.columns), F)
    return fine


@compiled
def _continuous_acceleration(job, M, M_hat, G):
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
    _assign(G, M)
    fine = factorize(G)
    solve(G, acc_c)
    return fine


@compiled
def _write_step(job, v_next, A, B):
    """Rows of A and B from da_d/dz in F: velocities, positions, activations."""
    act_adr = integers(job.act_adr, job.nu)
    quat_dof = integers(job.quat_dof, job.nquat)
    next_act = matrix(job.next_act, job.nu, 2)
    F = matrix(job.F, job.nv, job.columns)
    nv, ndx = job.nv, 2 * job.nv + job.na
    for i in range(nv):
        for c in range(ndx):
            rate = job.h * F[i, c]
            A[nv + i, c] = rate
            A[i, c] = job.h * rate
        for c in range(job.nu):
            rate = job.h * F[i, ndx + c]
            B[nv + i, c] = rate
            B[i, c] = job.h * rate
        A[nv + i, nv + i] += 1.0
        A[i, nv + i] += job.h
        A[i, i] += 1.0
    for k in range(quat_dof.shape[0]):
        _turn_rows(job, quat_dof[k], v_next, A, B)
    for i in range(2 * nv, ndx):
        for c in range(ndx):
            A[i, c] = 0.0
        for c in range(job.nu):
            B[i, c] = 0.0
    for i in range(job.nu):
        k = act_adr[i]
        if k >= 0:
            A[2 * nv + k, 2 * nv + k] = next_act[i, 1]
            B[2 * nv + k, i] = next_act[i, 0]
    following, rows = integers(job.rest_next, job.nrest_next), matrix(job.rest_rows, job.na, job.columns)
    for n in range(following.shape[0]):
        k = following[n]
        for c in range(ndx):
            A[2 * nv + k, c] = rows[k, c]
        for c in range(job.nu):
            B[2 * nv + k, c] = rows[k, ndx + c]


@compiled
def _turn_rows(job, first, v_next, A, B):
    """Rows of the positions of a quaternion, exp(-h w) dq + J(h w) h dw, with w the next angular velocity."""
    nv, ndx = job.nv, 2 * job.nv + job.na
    small = vector(job.small, 21)
    by_quat, by_vel, vel = small[0:9], small[9:18], small[18:21]
    for i in range(3):
        vel[i] = v_next[first + i]
    mjd_quatIntegrate(vel.ctypes.data, job.h, by_quat.ctypes.data, by_vel.ctypes.data, 0)
    for i in range(3):
        b0, b1, b2 = job.h * by_vel[3 * i], job.h * by_vel[3 * i + 1], job.h * by_vel[3 * i + 2]
        for c in range(ndx):
            A[first + i, c] = b0 * A[nv + first, c] + b1 * A[nv + first + 1, c] + b2 * A[nv + first + 2, c]
        for c in range(job.nu):
            B[first + i, c] = b0 * B[nv + first, c] + b1 * B[nv + first + 1, c] + b2 * B[nv + first + 2, c]
        for j in range(3):
            A[first + i, first + j] += by_quat[3 * i + j]


@compiled
def _load(job, x, u):
    """Put state and control into mjData."""
    _copy(x[: job.nq], vector(job.qpos, job.nq))
    _copy(x[job.nq : job.nq + job.nv], vector(job.qvel, job.nv))
    _copy(x[job.nq + job.nv :], vector(job.act, job.na))
    _copy(u, vector(job.ctrl, job.nu))


@compiled
def _linearize_knot(job, x, v_next, A, B):
    """A and B of a step from x, whose control is in mjData too."""
    acc_d = vector(job.acc_d, job.nv)
    for i in range(job.nv):
        acc_d[i] = (v_next[i] - x[job.nq + i]) / job.h
    rows = find_rows(job) if job.constrained else 0
    if job.gyroscopic:
        _find_spinning(job, rows)
    _smooth_forces(job)
    if job.rest_model != 0:
        add_force_differences(job, x)
    plain = rows == 0 and not (job.sensors_accelerated and 0 < job.implicit < 3)
    fine = _smooth_step(job) if plain else _constrained_step(job, x)
    if plain and job.sensors_accelerated:
        _copy(acc_d, vector(job.acc_c, job.nv))
        _assign(matrix(job.acc_rate, job.nv, job.columns), matrix(job.F, job.nv, job.columns))
    _write_step(job, v_next, A, B)
    if not fine:
        _fill(A, np.nan)
        _fill(B, np.nan)


@compiled
def _visit_last_knot(job):
    """Prepare what the sensors' derivatives read, where there is no step."""
    nothing = vector(job.change, job.nv)
    for i in range(job.nv):
        nothing[i] = 0.0
    activate(job)
    actuate(job)
    outward(job, vector(job.qvel, job.nv), nothing)
    inward(job)


@compiled
def _feel_last_knot(job, x):
    """Do the same for sensors of accelerations and rows: the acceleration is the one that MuJoCo finds."""
    if not job.sensors_accelerated:
        _visit_last_knot(job)
        if job.sensors_on_rows and job.constrained:
            find_rows(job)
        return
    warmstart, qacc = vector(job.qacc_warmstart, job.nv), vector(job.qacc, job.nv)
    for i in range(job.nv):
        warmstart[i] = 0.0
    mj_forward(job.model, job.data)
    _copy(qacc, vector(job.acc_d, job.nv))
    rows = find_rows(job) if job.constrained else 0
    if job.gyroscopic:
        _find_spinning(job, rows)
    _smooth_forces(job)
    if job.rest_model != 0:
        add_force_differences(job, x)
    _copy(qacc, vector(job.acc_c, job.nv))
    mass_matrix(job, matrix(job.M, job.nv, job.nv))
    _inertia(job)
    if not _differentiate_acceleration(job, x):
        _fill(matrix(job.acc_rate, job.nv, job.columns), np.nan)


def _sources() -> int:
    """Checksum of all that the kernel is made of: numba by itself looks at this file's date alone."""
    folder, checksum = Path(__file__).parent, 1
    for path in [folder.parent / "kernels.py", *sorted(folder.glob("*.py"))]:
        checksum = zlib.crc32(path.read_bytes(), checksum)
    return checksum + 1


@functools.cache
def kernel(feels: bool) -> Any:
    """Compile the loop over the horizon; what feels no accelerations, contacts or limits does without half of it."""
    return _make_kernel(_sources(), feels)


def _make_kernel(stamp: int, feels: bool) -> Any:
    @_compiled(_void(_address, _address, types.int32, types.voidptr))
    def inverse(_model, _data, worker, jobs):
        """Jacobians A, B, C, D of the knots first ... last - 1; knot N has only C."""
        if stamp == 0:  # it never is; what a function refers to is part of its key on disk
            return
        job = numba.carray(jobs, worker + 1, JOB)[worker]
        nx, ndx, nu, ny = job.nq + job.nv + job.na, 2 * job.nv + job.na, job.nu, job.ny
        X, U, ends = matrix(job.X, job.N + 1, nx), matrix(job.U, job.N, nu), matrix(job.ends, job.N, nx)
        no_control = np.zeros(nu)
        mj_resetData(job.model, job.data)
        for n in range(job.first, job.last):
            C, D = matrix(job.C + 8 * n * ny * ndx, ny, ndx), matrix(job.D + 8 * n * ny * nu, ny, nu)
            _load(job, X[n], U[n] if n < job.N else no_control)
            mj_kinematics(job.model, job.data)
            mj_comPos(job.model, job.data)
            if n < job.N:
                A, B = matrix(job.A + 8 * n * ndx * ndx, ndx, ndx), matrix(job.B + 8 * n * ndx * nu, ndx, nu)
                _linearize_knot(job, X[n], ends[n, job.nq : job.nq + job.nv], A, B)
            elif ny > 0:
                if feels:
                    _feel_last_knot(job, X[n])
                else:
                    _visit_last_knot(job)
            if ny > 0:
                write_motions(job, C, D)
                if feels:
                    write_feelings(job, n, X[n], C, D)
                if n == job.N:
                    _fill(D, 0.0)

    return inverse
