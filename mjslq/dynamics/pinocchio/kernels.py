"""What has to happen between two calls of Pinocchio, compiled: the control law, the Euler step, the gathering.

Notation
--------
    q (nq,), v (nv,)           where the simulation stands      a (nv,)    its acceleration
    tau (nv,)                  joint torques: controls less damping
    X (N + 1, nq + nv)         states so far                    U (N, nu)  controls, open loop or given to the law
    actuated (nu,)             the velocities that the controls act on
    law                        X_ref (N + 1, nq + nv), K (N, nu, 2 nv), lower, upper (N, nu), applied (N, nu): u_n =
                               clip(U_n - K_n difference(X_ref_n, x_n), lower_n, upper_n), written into `applied`;
                               without feedback K and `applied` have no rows
"""

from __future__ import annotations

from numba import njit, types

_real, _whole, _flag = types.float64, types.int64, types.boolean
_vector, _matrix = _real[::1], _real[:, ::1]
_given_vector, _given_matrix, _given_cube = (types.Array(_real, ndim, "C", readonly=True) for ndim in (1, 2, 3))
_given_indices = types.Array(_whole, 1, "C", readonly=True)
_law = (_given_matrix, _given_cube, _given_matrix, _given_matrix, _matrix)
ABSURD = 1e10
"""Magnitude of a position or velocity from which a simulation has blown up; MuJoCo draws the line there too."""


_control = (_whole, _flag, _matrix, _given_matrix, _vector, *_law, _given_vector, _given_indices, _vector)


@njit(types.void(*_control), cache=True)
def control(n, plain, X, U, dq, X_ref, K, lower, upper, applied, damping, actuated, tau):
    """Write the torques of step n, and under feedback its controls.

    `dq` is difference(q_ref, q), looked at only where it is not `plain` subtraction.
    """
    nv, nu = tau.size, actuated.size
    nq = X.shape[1] - nv
    for j in range(nv):
        tau[j] = -damping[j] * X[n, nq + j]
    for i in range(nu):
        u = U[n, i]
        if K.shape[0] > 0:
            total = 0.0
            for j in range(nv):
                d = X[n, j] - X_ref[n, j] if plain else dq[j]
                total += K[n, i, j] * d + K[n, i, nv + j] * (X[n, nq + j] - X_ref[n, nq + j])
            u -= total
            if u < lower[n, i]:  # and not min and max, which may lose a NaN
                u = lower[n, i]
            elif u > upper[n, i]:
                u = upper[n, i]
            applied[n, i] = u
        tau[actuated[i]] += u


_euler = (_whole, _real, _flag, _given_vector, _vector, _vector, _vector, _matrix)


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


@njit(_flag(*_euler[:2], *_euler[3:], *_control[3:4], *_law, *_control[-3:]), cache=True)
def euler_and_control(n, h, a, q, v, dq, X, U, X_ref, K, lower, upper, applied, damping, actuated, tau):
    """The Euler step n of plain positions, then the torques of step n + 1: one call instead of two."""
    good = euler(n, h, True, a, q, v, dq, X)
    if good and n + 1 < U.shape[0]:
        control(n + 1, True, X, U, dq, X_ref, K, lower, upper, applied, damping, actuated, tau)
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
