"""What has to happen between two calls of Pinocchio, compiled: the control law, the Euler step, the gathering.

Notation
--------
    q (nq,), v (nv,)           where the simulation stands      a (nv,)    its acceleration
    tau (nv,)                  joint torques: controls less damping
    X (N + 1, nq + nv)         states so far                    U (N, nu)  controls
    actuated (nu,)             the velocities that the controls act on
    law                        X_ref (N + 1, nq + nv), K (N, nu, 2 nv), limits (2, N, nu): U_n is replaced by
                               clip(U_n - K_n difference(X_ref_n, x_n), limits[0, n], limits[1, n])

A call costs some 50 ns for every array among its arguments, and more for read-only ones, whose types numba looks up
anew each time: what is called at each step takes few of them, and none that is read-only.
"""

from __future__ import annotations

from numba import njit, types

_real, _whole, _flag = types.float64, types.int64, types.boolean
_vector, _matrix, _cube, _indices = _real[::1], _real[:, ::1], _real[:, :, ::1], _whole[::1]
_law = (_matrix, _cube, _cube)

ABSURD = 1e10
"""Magnitude of a position or velocity from which a simulation has blown up; MuJoCo draws the line there too."""


_control = (_whole, _matrix, _matrix, _vector, _indices, _vector)


@njit(types.void(*_control), cache=True)
def control(n, X, U, damping, actuated, tau):
    """Write the torques of step n."""
    nv = tau.size
    nq = X.shape[1] - nv
    for j in range(nv):
        tau[j] = -damping[j] * X[n, nq + j]
    for i in range(actuated.size):
        tau[actuated[i]] += U[n, i]


@njit(types.void(_whole, _flag, _matrix, _matrix, _vector, *_law), cache=True)
def follow(n, plain, X, U, dq, X_ref, K, limits):
    """Replace the controls of step n by those of the law; `dq` is difference(q_ref, q) unless that is `plain`."""
    nv = dq.size
    nq = X.shape[1] - nv
    for i in range(U.shape[1]):
        total = 0.0
        for j in range(nv):
            d = X[n, j] - X_ref[n, j] if plain else dq[j]
            total += K[n, i, j] * d + K[n, i, nv + j] * (X[n, nq + j] - X_ref[n, nq + j])
        u, lower, upper = U[n, i] - total, limits[0, n, i], limits[1, n, i]
        U[n, i] = lower if u < lower else upper if u > upper else u  # min and max may lose a NaN


_euler = (_whole, _real, _flag, _vector, _vector, _vector, _vector, _matrix)


@njit(_flag(*_euler), cache=True)
def euler(n, h, plain, a, q, v, dq, X):
    """Semi-implicit Euler: v, dq = h v, and where positions are `plain` vectors q; False when the step blew up."""
    nq, good = q.size, True
    for j in range(v.size):
        v[j] += h * a[j]
        dq[j] = h * v[j]
        X[n + 1, nq + j] = v[j]
        good = good and abs(v[j]) < ABSURD
        if plain:
            q[j] += dq[j]
            X[n + 1, j] = q[j]
            good = good and abs(q[j]) < ABSURD
    return good


_both = (*_euler[:2], *_euler[3:], _matrix)


@njit(_flag(*_both, *_control[3:]), cache=True)
def euler_and_control(n, h, a, q, v, dq, X, U, damping, actuated, tau):
    """The Euler step n of plain positions, then the torques of step n + 1: one call instead of two."""
    good = euler(n, h, True, a, q, v, dq, X)
    if good and n + 1 < U.shape[0]:
        control(n + 1, X, U, damping, actuated, tau)
    return good


@njit(_flag(*_both, *_law, *_control[3:]), cache=True)
def euler_and_follow(n, h, a, q, v, dq, X, U, X_ref, K, limits, damping, actuated, tau):
    """The same under feedback."""
    good = euler(n, h, True, a, q, v, dq, X)
    if good and n + 1 < U.shape[0]:
        follow(n + 1, True, X, U, dq, X_ref, K, limits)
        control(n + 1, X, U, damping, actuated, tau)
    return good


@njit(cache=True)
def gather(n, h, a_q, a_v, a_tau, J, damping, actuated, A, B, J_all):
    """Velocity rows of A[n] = [h a_q, 1 + h a_v] and B[n] = h a_tau S, with a_v less a_tau D; J into J_all[n]."""
    nv = a_q.shape[0]
    for i in range(nv):
        for j in range(nv):
            A[n, nv + i, j] = h * a_q[i, j]
            A[n, nv + i, nv + j] = h * (a_v[i, j] - a_tau[i, j] * damping[j])
        A[n, nv + i, nv + i] += 1.0
        for j in range(actuated.size):
            B[n, nv + i, j] = h * a_tau[i, actuated[j]]
    for i in range(J.shape[0]):
        for j in range(6):
            J_all[n, i, j] = J[i, j]


@njit(cache=True)
def position_jacobian(J, p, moved_by, C):
    """C = J_v + J_w x p in the columns of the dofs that move the point p (M, 3). Shapes (M, nv, 6), (M, 3, nv)."""
    for n in range(J.shape[0]):
        for i in range(J.shape[1]):
            if moved_by[i]:
                v, w = J[n, i, :3], J[n, i, 3:]
                C[n, 0, i] = v[0] + w[1] * p[n, 2] - w[2] * p[n, 1]
                C[n, 1, i] = v[1] + w[2] * p[n, 0] - w[0] * p[n, 2]
                C[n, 2, i] = v[2] + w[0] * p[n, 1] - w[1] * p[n, 0]
