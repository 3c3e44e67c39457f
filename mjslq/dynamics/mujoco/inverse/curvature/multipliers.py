"""From the costates of a step to the multipliers of its equations of motion.

Notation (`inverse.acceleration`: a_d, a_c, M, M^, T, f, J' s, E; `job`: pull)
--------
    lambda        costate of x_{n+1};  pull = d(lambda' x_{n+1})/da_d
    w1, w2        multipliers of the two equations that define the accelerations of a step with constraint rows,

                      G1 = M a_c + c - f - J' s = 0,      G2 = M^ a_d - M a_c = 0

Lambda' x_{n+1} does not change when w1' G1 + w2' G2 is added. With the w that take the accelerations' changes out of
the sum to first order,

    w2 = - M^^-T pull,      w1 = (M + J' H J)^-1 M w2,

its second derivative is that of the Lagrangian phi = w1' G1 + w2' G2 (and of what the positions do, `hessians`), w
fixed, along the accelerations' first-order changes S_d = da_d/dz, S_c = da_c/dz:

    H = phi_zz + phi_za S + (phi_za S)' + S' phi_aa S.

Without rows there is one equation, M^ a_d + c - f = 0, and one multiplier, w1 = w2; so there is under an integrator
that takes nothing implicitly, where a_c = a_d. S_d is in A and B, and S_c follows from G2,

    M S_c = M^ S_d + d(M x)/dz - E,      x = a_d - a_c.
"""

from __future__ import annotations

from mjslq.dynamics.mujoco.inverse.algebra import add_product, factorize, fill, solve
from mjslq.dynamics.mujoco.inverse.rigid import add_mass_derivative
from mjslq.dynamics.mujoco.inverse.spatial import compiled
from mjslq.dynamics.mujoco.inverse.table.job import matrix, vector


@compiled
def solve_transposed(A, x):
    """X = A^-T x for one vector, with the factors A = U L of `algebra.factorize`."""
    n = A.shape[0]
    for k in range(n - 1, -1, -1):
        x[k] /= A[k, k]
        for j in range(k):
            x[j] -= A[k, j] * x[k]
    for k in range(n):
        for i in range(k + 1, n):
            x[i] -= A[k, i] * x[k]


@compiled
def read_rates(job, A, B):
    """Write S_d, which A and B have in their rows of velocities."""
    Sd, nv, ndx = matrix(job.Sd, job.nv, job.columns), job.nv, 2 * job.nv + job.na
    for i in range(nv):
        for c in range(ndx):
            Sd[i, c] = A[nv + i, c] / job.h
        Sd[i, nv + i] -= 1.0 / job.h
        for c in range(job.nu):
            Sd[i, ndx + c] = B[nv + i, c] / job.h


@compiled
def write_constrained_rates(job, M_factors, Sc):
    """Write S_c; the subtrees' inertias are those that `mass_matrix` leaves."""
    Sd, E = matrix(job.Sd, job.nv, job.columns), matrix(job.E, job.nv, job.columns)
    x, acc_c, acc_d = vector(job.change, job.nv), vector(job.acc_c, job.nv), vector(job.acc_d, job.nv)
    fill(Sc, 0.0)
    add_product(matrix(job.M_hat, job.nv, job.nv), Sd, Sc)
    for i in range(job.nv):
        x[i] = acc_d[i] - acc_c[i]
        for c in range(job.columns):
            Sc[i, c] -= E[i, c]
    add_mass_derivative(job, x, 1.0, Sc)
    solve(M_factors, Sc)


@compiled
def second_multiplier(job, pull):
    """w2, of M_hat, which is factorized; False when it is singular."""
    M_hat, w2 = matrix(job.M_hat, job.nv, job.nv), vector(job.w2, job.nv)
    fine = factorize(M_hat)
    for i in range(job.nv):
        w2[i] = -pull[i]
    solve_transposed(M_hat, w2)
    return fine


@compiled
def first_multiplier(job, G):
    """w1, of G = M + J' H J, which is factorized; False when it is singular."""
    M, w2 = matrix(job.M, job.nv, job.nv), vector(job.w2, job.nv)
    w1 = matrix(job.w1, job.nv, 1)
    for i in range(job.nv):
        w1[i, 0] = 0.0
        for j in range(job.nv):
            w1[i, 0] += M[i, j] * w2[j]
    fine = factorize(G)
    solve(G, w1)
    return fine
