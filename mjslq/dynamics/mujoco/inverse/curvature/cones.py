"""Second derivatives of the forces of sliding elliptic contacts by the rows' argument, exact.

Notation
--------
    s = - dC/djar     forces of the rows of a contact, C = D_m e^2 / 2,   e = N - mu T
    N = mu jar_0,  T = |u|,  u_i = f_i jar_i (i > 0),  n = u / T,  D_m = D_0 / (mu^2 (1 + mu^2))
    y = J w           what the rows feel of w

With e_k, e_kl, e_klm the derivatives of e by jar, that of - w' J' s = y' dC/djar are

    K_kl = sum_m y_m C_klm = D_m (h_k e_l + h_l e_k + e_y e_kl + e t_kl),

    e_y = sum e_m y_m,   h_k = sum e_km y_m,   t_kl = sum e_klm y_m,   and with P = 1 - n n', v_i = f_i y_i

    e_0 = mu,   e_i = - mu f_i n_i,   e_ij = - mu f_i f_j P_ij / T,
    t_ij = mu f_i f_j (P_ij n.v + (P v)_i n_j + n_i (P v)_j) / T^2.
"""

from __future__ import annotations

import math

from mjslq.dynamics.mujoco.inverse.rows.constraints import read_row
from mjslq.dynamics.mujoco.inverse.spatial import compiled
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, integers, matrix, vector


@compiled
def feel(job, first, dim, w, y):
    """Y = J w of the rows first ... first + dim - 1."""
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    for k in range(dim):
        y[k] = 0.0
        for m in range(read_row(job, first + k, dofs, values)):
            y[k] += values[m] * w[dofs[m]]


@compiled
def bend_cone(job, first, dim, contact, w, Z, X, S):
    """Z, X += J' K J, by velocities times b; the contact's rows of J stand in job.jacobian."""
    jacobian, rates, K = (
        matrix(job.jacobian, 10, job.nv),
        matrix(job.cone_rates, 6, job.columns),
        matrix(job.cone, 6, 6),
    )
    KBIP = matrix(entry_address(job.data + job.at_efc_KBIP), first + dim, 4)
    nv = job.nv
    _write_curvature(job, first, dim, contact, w, K)
    for k in range(dim):
        for c in range(job.columns):
            rates[k, c] = 0.0
        for i in range(nv):
            if jacobian[k, i] != 0.0:
                for c in range(job.columns):
                    rates[k, c] += 0.5 * jacobian[k, i] * S[i, c]
        # the rows' argument is J a + b J v
        for i in range(nv):
            rates[k, nv + i] += KBIP[first + k, 1] * jacobian[k, i]
    for k in range(dim):
        for m in range(dim):
            for i in range(nv):
                factor = K[k, m] * jacobian[k, i]
                if factor == 0.0:
                    continue
                for c in range(job.columns):
                    X[i, c] += factor * rates[m, c]
                by_v = factor * KBIP[first + k, 1] * KBIP[first + m, 1]
                for j in range(nv):
                    Z[nv + i, nv + j] += by_v * jacobian[m, j]


@compiled
def _write_curvature(job, first, dim, contact, w, K):
    friction, mu = vector(contact + job.at_contact_friction, 5), vector(contact + job.at_contact_H - 8, 1)[0]
    jar = vector(entry_address(job.data + job.at_efc_vel), first + dim)
    y, small = vector(job.djar, 10), matrix(job.directions, 3, 6)
    n, P_v, h = small[0], small[1], small[2]
    feel(job, first, dim, w, y)
    square = 0.0
    for i in range(1, dim):
        square += (friction[i - 1] * jar[first + i]) ** 2
    T = math.sqrt(square)
    e, n_v = mu * (jar[first] - T), 0.0
    D_m = vector(entry_address(job.data + job.at_efc_D), first + 1)[first] / (mu * mu * (1.0 + mu * mu))
    for i in range(1, dim):
        n[i] = friction[i - 1] * jar[first + i] / T
        n_v += n[i] * friction[i - 1] * y[i]
    h[0] = 0.0
    for i in range(1, dim):
        P_v[i] = friction[i - 1] * y[i] - n[i] * n_v
        h[i] = -mu * friction[i - 1] * P_v[i] / T
    e_y = mu * y[0] - mu * n_v
    for k in range(dim):
        e_k = mu if k == 0 else -mu * friction[k - 1] * n[k]
        for m in range(dim):
            e_m = mu if m == 0 else -mu * friction[m - 1] * n[m]
            K[k, m] = D_m * (h[k] * e_m + h[m] * e_k)
            if k > 0 and m > 0:
                scale, P = mu * friction[k - 1] * friction[m - 1] / T, (1.0 if k == m else 0.0) - n[k] * n[m]
                third = scale / T * (P * n_v + P_v[k] * n[m] + n[k] * P_v[m])
                K[k, m] += D_m * (e * third - e_y * scale * P)
