"""Compiled loops over the horizon: simulate and linearize with libmujoco, without Python between the steps.

Each kernel is a C function (model, data, worker, jobs) for `Workers.run`: it reads everything from its row of
`jobs`, a structured array of addresses and sizes that Python fills in (see `JOB`), and writes its results into
the arrays named there. Only MuJoCo's documented functions are called, and arrays of mjData are reached through
the addresses of the views that its Python bindings give out, so nothing here depends on the layout of a struct.

Notation
--------
    x = (qpos, qvel, act), u = ctrl, y = sensordata         N steps, each of k = substeps calls to mj_step
    X (N + 1, nx), U (N, nu), Y (N + 1, ny)                 K (N, nu, ndx), lower, upper (N, nu): see `Feedback`
    S (N, k - 1, nx)                                        states between the knots
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.library import library_path
from mjslq.native.declare import external, helper
from mjslq.native.kernel import c_function
from mjslq.native.memory import carray, pointer
from mjslq.native.symbols import provide


def _load_library() -> None:
    import llvmlite.binding

    llvmlite.binding.load_library_permanently(library_path())


provide("mj", _load_library)
LOOP = "void(intp, intp, int32, voidptr)"
"""Signature of a kernel: (model, data, worker, jobs), of which MuJoCo's batch hands on the last two."""
mj_resetData = external("mj_resetData", "void(intp, intp)")
mj_step = external("mj_step", "void(intp, intp)")
mj_forward = external("mj_forward", "void(intp, intp)")
mj_differentiatePos = external("mj_differentiatePos", "void(intp, intp, float64, intp, intp)")
mj_setState = external("mj_setState", "void(intp, intp, intp, int32)")
mjd_transitionFD = external("mjd_transitionFD", "void(intp, intp, float64, uint8, intp, intp, intp, intp)")

ABSURD = float(mujoco.mjMAXVAL)
"""Magnitude from which MuJoCo calls a number bad."""
TIME = int(mujoco.mjtState.mjSTATE_TIME)
WARNINGS = int(mujoco.mjtWarning.mjNWARNING)

_SIZES = ("N", "first", "last", "stride", "substeps", "nq", "nv", "na", "nu", "ny", "centered")
_ARRAYS = (
    "model", "data", "qpos", "qvel", "act", "ctrl", "qacc", "warmstart", "sensors", "warnings",
    "X", "U", "Y", "S", "F", "applied", "X_ref", "K", "lower", "upper", "A", "B", "C", "D", "bad_knots", "work",
)  # fmt: skip
JOB = np.dtype([(name, np.int64) for name in _SIZES + _ARRAYS] + [("eps", np.float64), ("dt", np.float64)])
"""What a kernel needs to know: sizes, addresses of arrays (0: absent), numbers."""


def work_size(ndx: int, nu: int) -> int:
    """Numbers in `work`, which is for intermediate results."""
    return max(1, 2 * ndx * (ndx + nu))


@helper(forceinline=True)
def _vector(address, size):
    return carray(pointer(address), (size,), np.float64)


@helper(forceinline=True)
def _matrix(address, rows, columns):
    return carray(pointer(address), (rows, columns), np.float64)


@helper(forceinline=True)
def _integers(address, size):
    return carray(pointer(address), (size,), np.int64)


@helper(forceinline=True)
def copy_into(source, target):
    """Copy numbers, as many as `target` has room for."""
    for i in range(target.shape[0]):
        target[i] = source[i]


@helper(forceinline=True)
def _sane(values):
    """Whether every entry is a number that MuJoCo would not call bad."""
    for value in values:  # noqa: SIM110 -- a plain loop is what numba compiles well
        if not abs(value) < ABSURD:
            return False
    return True


@helper(forceinline=True)
def _warned(job):
    """Whether MuJoCo has counted any warning; the counters stand in pairs with other information."""
    counters = carray(pointer(job.warnings), (2 * WARNINGS,), np.int32)
    for i in range(0, 2 * WARNINGS - 1, 2):  # noqa: SIM110
        if counters[i] != 0:
            return True
    return False


@helper(forceinline=True)
def _load(job, x):
    """Put the state x into mjData."""
    copy_into(x[: job.nq], _vector(job.qpos, job.nq))
    copy_into(x[job.nq : job.nq + job.nv], _vector(job.qvel, job.nv))
    copy_into(x[job.nq + job.nv :], _vector(job.act, job.na))


@helper(forceinline=True)
def _store(job, x):
    """Read the state x out of mjData."""
    copy_into(_vector(job.qpos, job.nq), x[: job.nq])
    copy_into(_vector(job.qvel, job.nv), x[job.nq : job.nq + job.nv])
    copy_into(_vector(job.act, job.na), x[job.nq + job.nv :])


@helper(forceinline=True)
def _feedback(job, n, x, given, deviation, u):
    """Write clip(given - K difference(x_ref, x), lower, upper) into u."""
    nx, ndx = job.nq + job.nv + job.na, 2 * job.nv + job.na
    lower, upper = _vector(job.lower + 8 * n * job.nu, job.nu), _vector(job.upper + 8 * n * job.nu, job.nu)
    x_ref = _vector(job.X_ref + 8 * n * nx, nx)
    K = _matrix(job.K + 8 * n * job.nu * ndx, job.nu, ndx)
    mj_differentiatePos(job.model, deviation.ctypes.data, 1.0, x_ref.ctypes.data, x.ctypes.data)
    for i in range(job.nv, ndx):
        deviation[i] = x[job.nq + i - job.nv] - x_ref[job.nq + i - job.nv]
    for i in range(job.nu):
        total = given[i]
        for j in range(ndx):
            total -= K[i, j] * deviation[j]
        if total < lower[i]:  # and not min and max, which may lose a NaN
            total = lower[i]
        elif total > upper[i]:
            total = upper[i]
        u[i] = total


@helper(forceinline=True)
def _hold(job, S, end, y):
    """Step k times under the control in mjData, from the state there.

    Writes the states between to the address S, the last one to the address `end`, and the outputs at the start into y.
    Returns whether all is well.
    """
    nx, sensors = job.nq + job.nv + job.na, _vector(job.sensors, job.ny)
    for s in range(job.substeps):
        mj_step(job.model, job.data)
        if s == 0:
            copy_into(sensors, y)
        x = _vector(S + 8 * s * nx if s < job.substeps - 1 else end, nx)
        _store(job, x)
        if _warned(job) or not _sane(x):
            return False
    return True


@helper(forceinline=True)
def _roll_out(job, X, U, applied, Y, S, deviation):
    """Simulate from X[0] under U; return the first bad knot, N + 1 for none. All arrays hold up to there."""
    ctrl, sensors, N = _vector(job.ctrl, job.nu), _vector(job.sensors, job.ny), job.N
    nx = job.nq + job.nv + job.na
    mj_resetData(job.model, job.data)
    _load(job, X[0])
    for n in range(N):
        if job.K != 0:
            _feedback(job, n, X[n], U[n], deviation, applied[n])
        if not (_sane(applied[n]) and _sane(X[n])):
            return n
        copy_into(applied[n], ctrl)
        if not _hold(job, S + 8 * n * (job.substeps - 1) * nx, X[n + 1].ctypes.data, Y[n]):
            return n + 1 if _sane(Y[n]) else n
        if not _sane(Y[n]):
            return n
    for i in range(job.nu):
        ctrl[i] = 0.0
    mj_forward(job.model, job.data)
    copy_into(sensors, Y[N])
    return N if _warned(job) or not _sane(Y[N]) else N + 1


@c_function("mujoco-simulate", LOOP)
def simulate(_model, _data, worker, jobs):
    """Roll out number `first`, `first` + `stride`, ... below `last`, each from its X[0] under its U.

    X, U, Y, S and `applied` are tables of addresses, one for each rollout. Where K is given the law makes `applied` of
    U; where it is not, `applied` holds what U holds.
    """
    job = carray(jobs, worker + 1, JOB)[worker]
    nx, N, deviation = job.nq + job.nv + job.na, job.N, _vector(job.work, 2 * job.nv + job.na)
    Xs, Us, Ys = _integers(job.X, job.last), _integers(job.U, job.last), _integers(job.Y, job.last)
    Ss = _integers(job.S, job.last)
    controls, bad_knots = _integers(job.applied, job.last), _integers(job.bad_knots, job.last)
    i = job.first
    while i < job.last:  # range() raises where the stride is zero, and kernels raise nothing
        X, Y = _matrix(Xs[i], N + 1, nx), _matrix(Ys[i], N + 1, job.ny)
        U, applied = _matrix(Us[i], N, job.nu), _matrix(controls[i], N, job.nu)
        bad_knots[i] = _roll_out(job, X, U, applied, Y, Ss[i], deviation)
        i += job.stride


@c_function("mujoco-step-each", LOOP)
def step_each(_model, _data, worker, jobs):
    """One step from each of the knots first ... last - 1, each from a clean mjData: F, S and Y; of knot N only Y.

    F and S are NaN where the step goes wrong.
    """
    job = carray(jobs, worker + 1, JOB)[worker]
    nx, nu, ny, between = job.nq + job.nv + job.na, job.nu, job.ny, job.substeps - 1
    X, U, Y = _matrix(job.X, job.N + 1, nx), _matrix(job.U, job.N, nu), _matrix(job.Y, job.N + 1, ny)
    ctrl, sensors, time = _vector(job.ctrl, nu), _vector(job.sensors, ny), _vector(job.work, 1)
    warmstart = _vector(job.warmstart, job.nv)
    mj_resetData(job.model, job.data)
    for n in range(job.first, job.last):
        for i in range(job.nv):  # all that a step leaves behind for the next, besides the state
            warmstart[i] = 0.0
        time[0] = n * job.dt
        mj_setState(job.model, job.data, time.ctypes.data, TIME)
        _load(job, X[n])
        if n == job.N:
            for i in range(nu):
                ctrl[i] = 0.0
            mj_forward(job.model, job.data)
            copy_into(sensors, Y[n])
            return
        copy_into(U[n], ctrl)
        S, end = job.S + 8 * n * between * nx, job.F + 8 * n * nx
        if not (_sane(X[n]) and _sane(U[n]) and _hold(job, S, end, Y[n])):
            for i in range(nx):
                _vector(end, nx)[i] = np.nan
            for i in range(between * nx):
                _vector(S, between * nx)[i] = np.nan
            mj_resetData(job.model, job.data)


@helper(forceinline=True)
def _settle(job, x):
    """Put x into mjData, and the constraint solver's solution there, found from a cold start, into its warm start."""
    qacc, warmstart = _vector(job.qacc, job.nv), _vector(job.warmstart, job.nv)
    _load(job, x)
    for i in range(job.nv):
        warmstart[i] = 0.0
    mj_forward(job.model, job.data)
    copy_into(qacc, warmstart)


@helper(forceinline=True)
def _chain(A_1, B_1, A, B, product):
    """A becomes A_1 A and B becomes A_1 B + B_1; `product` (ndx, ndx + nu) is for intermediate results."""
    ndx, nu = B.shape
    for i in range(ndx):
        for c in range(ndx):
            product[i, c] = 0.0
        for c in range(nu):
            product[i, ndx + c] = B_1[i, c]
        for j in range(ndx):
            weight = A_1[i, j]
            for c in range(ndx):
                product[i, c] += weight * A[j, c]
            for c in range(nu):
                product[i, ndx + c] += weight * B[j, c]
    for i in range(ndx):
        for c in range(ndx):
            A[i, c] = product[i, c]
        for c in range(nu):
            B[i, c] = product[i, ndx + c]


@c_function("mujoco-transition", LOOP)
def transition(_model, _data, worker, jobs):
    """Jacobians A, B, C, D of the knots first ... last - 1 by differences of the step (mjd_transitionFD).

    Those of several simulator steps in a row are A_k ... A_1, and B_k + A_k (B_{k-1} + A_{k-1} (... B_1)).

    Knot N has no step: only its C is computed, at zero control. The constraint solver starts from the solution
    at the knot itself, found from a cold start, so that a knot's Jacobians do not depend on its neighbours.
    """
    job = carray(jobs, worker + 1, JOB)[worker]
    nx, ndx, nu, ny, last = job.nq + job.nv + job.na, 2 * job.nv + job.na, job.nu, job.ny, job.substeps - 1
    U, ctrl = _matrix(job.U, job.N, nu), _vector(job.ctrl, nu)
    centered, product = np.uint8(job.centered), _matrix(job.work, ndx, ndx + nu)
    A_1 = _matrix(job.work + 8 * ndx * (ndx + nu), ndx, ndx)
    B_1 = _matrix(job.work + 8 * ndx * (2 * ndx + nu), ndx, nu)
    mj_resetData(job.model, job.data)
    for n in range(job.first, job.last):
        for i in range(nu):
            ctrl[i] = U[n, i] if n < job.N else 0.0
        _settle(job, _vector(job.X + 8 * n * nx, nx))
        C = job.C + 8 * n * ny * ndx if ny > 0 else 0
        if n == job.N:
            if ny > 0:
                mjd_transitionFD(job.model, job.data, job.eps, centered, 0, 0, C, 0)
            return
        A, B, D = job.A + 8 * n * ndx * ndx, job.B + 8 * n * ndx * nu, job.D + 8 * n * ny * nu if ny > 0 else 0
        mjd_transitionFD(job.model, job.data, job.eps, centered, A, B, C, D)
        for s in range(last):
            _settle(job, _vector(job.S + 8 * (n * last + s) * nx, nx))
            mjd_transitionFD(job.model, job.data, job.eps, centered, A_1.ctypes.data, B_1.ctypes.data, 0, 0)
            _chain(A_1, B_1, _matrix(A, ndx, ndx), _matrix(B, ndx, nu), product)
