"""Constraint rows of the discrete integrator: spring and damper of each row taken at the step's end.

Notation (of a row: `constraints`; r = pos - margin)
--------
    k, b, I, I'       efc_KBIP; kappa = k I
    R0                the row's regularization without all this, (1 - I) / I times its approximate diagonal
    rho               correction of that diagonal by the metric (`weights`)
    C                 bound of (1 - I) / I from below that MuJoCo's largest impedance sets

At its end the step has velocity J v + h J a and position r + h (J v + h J a). Solved for J a, the row
J a + b (...) + kappa (...) = -R0 s becomes one with

    g = 1 + h b + h^2 kappa,     aref = -((b + h kappa) J v + kappa r) / g,     R = rho R0 max(1 / g, C I / (1 - I)),

all rows of a contact sharing R's factors of its first. The flag refsafe resolves limits and contacts that are given
by time constant and damping ratio zeta, where h^2 kappa > 1:

    kappa = 1 / h^2,     b = max(0, min(2 zeta / (h sqrt(I)), ((1 - I) / (I C) - 2) / h)).

For its derivatives the row is presented as one of continuous time, with k*, b*, I*, I'* in efc_KBIP that give

    daref/d(J v) = -b*      daref/dr = -k* (I'* r + I*)      dlnD/dr = I'* / (I* (1 - I*)) = L,

so that all formulas of `constraints` and `contacts` hold as they stand. One of the four is free: I* is I, or so near
to 1 that I'* r + I* = I* (1 + (1 - I*) L r), which k* is divided by, stays away from 0.
"""

from __future__ import annotations

import math

import mujoco

from mjslq.dynamics.mujoco.inverse.spatial import compiled, inlined
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, entry_count, flags, matrix, vector

_LIMIT_JOINT, _LIMIT_TENDON, _FRICTIONLESS = 3, 4, 5
_LEAST = (1.0 - mujoco.mjMAXIMP) / mujoco.mjMAXIMP


@inlined
def growth(job, K):
    """Return g of a row with the numbers K of efc_KBIP."""
    return 1.0 + job.h * (K[1] + job.h * K[0] * K[2])


@inlined
def softness(job, K):
    """Return R / (rho R0) of a row."""
    return max(1.0 / growth(job, K), _LEAST * K[2] / (1.0 - K[2]))


@compiled
def resolve(job, kind, index, K):
    """Replace the spring and damper of a limit or contact row that the time step cannot resolve."""
    if kind < _LIMIT_JOINT or job.h * job.h * K[0] * K[2] <= 1.0 or job.refsafe == 0:
        return
    if kind == _LIMIT_JOINT:
        address = job.jnt_solref + 16 * index
    elif kind == _LIMIT_TENDON:
        address = job.ten_solref + 16 * index
    else:
        address = entry_address(job.data + job.at_contact) + index * job.at_contact_size + job.at_contact_solref
    reference = vector(address, 2)
    if reference[0] <= 0.0:
        return
    K[0] = 1.0 / (job.h * job.h * K[2])
    bound = ((1.0 - K[2]) / (K[2] * _LEAST) - 2.0) / job.h
    K[1] = max(0.0, min(2.0 * reference[1] / (job.h * math.sqrt(K[2])), bound))


@compiled
def fold_references(job):
    """Make MuJoCo's aref of continuous time, and J v, which is in efc_vel, into those of the step's end."""
    rows = entry_count(job.data + job.at_nefc)
    KBIP = matrix(entry_address(job.data + job.at_efc_KBIP), rows, 4)
    aref = vector(entry_address(job.data + job.at_efc_aref), rows)
    velocity = vector(entry_address(job.data + job.at_efc_vel), rows)
    for r in range(rows):
        K = KBIP[r]
        aref[r] = (aref[r] - job.h * K[0] * K[2] * velocity[r]) / growth(job, K)


@compiled
def present_rows(job):
    """Rewrite efc_KBIP to the numbers that stand for the rows' derivatives; the rows have been evaluated."""
    rows = entry_count(job.data + job.at_nefc)
    KBIP = matrix(entry_address(job.data + job.at_efc_KBIP), rows, 4)
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    aref = vector(entry_address(job.data + job.at_efc_aref), rows)
    pos = vector(entry_address(job.data + job.at_efc_pos), rows)
    margin = vector(entry_address(job.data + job.at_efc_margin), rows)
    for n in range(rows):
        _present(job, kinds[n], pos[n] - margin[n], aref[n], KBIP[n])


@inlined
def _present(job, kind, r, aref, K):
    h, b, imp, slope = job.h, K[1], K[2], K[3]
    kappa, g = K[0] * imp, growth(job, K)
    kappa_change, b_change = K[0] * slope, 0.0
    bounded = (1.0 - imp) / imp <= _LEAST * g * (1.0 + 1e-12)
    if kind >= _LIMIT_JOINT and job.refsafe and abs(h * h * kappa - 1.0) < 1e-12:
        kappa_change, b_change = 0.0, -0.5 * b * slope / imp
        if bounded:
            b_change = -slope / (imp * imp * _LEAST * h) if b > 0.0 else 0.0
    damping = b + h * kappa
    velocity = -(g * aref + kappa * r) / damping if damping > 0.0 else 0.0
    g_change = h * (b_change + h * kappa_change)
    stiffness = (kappa + (b_change + h * kappa_change) * velocity + kappa_change * r + g_change * aref) / g
    by_pos = 0.0 if bounded else slope / (imp * (1.0 - imp)) + g_change / g
    rest = min(1.0 - imp, 0.5 / max(abs(by_pos * r), 0.5))
    K[1], K[2], K[3] = damping / g, 1.0 - rest, by_pos * rest * (1.0 - rest)
    K[0] = stiffness / (K[2] + K[3] * r)
