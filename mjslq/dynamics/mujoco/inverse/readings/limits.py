"""Derivatives of what sensors read of the limits of joints and tendons: distance, its velocity, force.

A limit has one row with a constant J, which is also the gradient of its distance; its force s is as in `constraints`.
What the acceleration does to s goes into the lever of `accelerations`.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.mujoco.inverse.readings.accelerations import add_acceleration, clear_lever
from mjslq.dynamics.mujoco.inverse.readings.frames import clear_rows
from mjslq.dynamics.mujoco.inverse.rows.constraints import QUADRATIC, read_row
from mjslq.dynamics.mujoco.inverse.spatial import compiled
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.job import entry_address, entry_count, flags, integers, matrix, vector


@compiled
def write_limit(job, s, kind, row, C, D):
    """Distance, velocity or force of a joint's or tendon's limit."""
    wanted, index = integers(job.sen_reference, job.nsensor)[s], integers(job.sen_target, job.nsensor)[s]
    rows = np.int64(entry_count(job.data + job.at_nefc))
    kinds = flags(entry_address(job.data + job.at_efc_type), rows)
    ids = flags(entry_address(job.data + job.at_efc_id), rows)
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    clear_rows(C, D, row, 1)
    clear_lever(job)
    for r in range(rows):
        if kinds[r] == wanted and ids[r] == index:
            size = read_row(job, r, dofs, values)
            for k in range(size):
                if kind == columns.LIMIT_POS:
                    C[row, dofs[k]] = values[k]
                elif kind == columns.LIMIT_VEL:
                    C[row, job.nv + dofs[k]] = values[k]
            if kind == columns.LIMIT_FORCE:
                _write_limit_force(job, r, size, row, C)
                add_acceleration(job, row, np.int64(1), C, D)
            return


@compiled
def _write_limit_force(job, r, size, row, C):
    rows = r + 1
    KBIP = matrix(entry_address(job.data + job.at_efc_KBIP), rows, 4)
    D, jar = (
        vector(entry_address(job.data + job.at_efc_D), rows),
        vector(entry_address(job.data + job.at_efc_vel), rows),
    )
    pos = vector(entry_address(job.data + job.at_efc_pos), rows)
    margin = vector(entry_address(job.data + job.at_efc_margin), rows)
    dofs, values = integers(job.dofs, job.nv), vector(job.values, job.nv)
    lever = matrix(job.lever, job.nv, 3)
    if flags(entry_address(job.data + job.at_efc_state), rows)[r] != QUADRATIC:
        return
    k, b, imp, slope = KBIP[r, 0], KBIP[r, 1], KBIP[r, 2], KBIP[r, 3]
    stiffness = k * (slope * (pos[r] - margin[r]) + imp) + slope / (imp * (1.0 - imp)) * jar[r]
    for n in range(size):
        C[row, dofs[n]] -= D[r] * stiffness * values[n]
        C[row, job.nv + dofs[n]] -= D[r] * b * values[n]
        lever[dofs[n], 0] -= D[r] * values[n]
