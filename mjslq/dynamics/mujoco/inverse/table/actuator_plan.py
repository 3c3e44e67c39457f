"""What the kernel has to know about actuators whose forces have a closed form, in rows for the controls."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.plan import (
    BIAS,
    DYN,
    GAIN,
    JOINT,
    OFF,
    ON_JOINTS,
    SOLVER,
    TRN,
    disabled,
    gear_of,
    lists,
    ranges,
    tendon_dofs,
)


def actuator_table(model: mujoco.MjModel) -> dict[str, Any]:
    """Moment arms, gains, biases, limits, and the dynamics of activations, in rows for the controls."""
    of = np.repeat(np.arange(model.nactuator), model.actuator_ctrlnum)
    prm = np.zeros((model.nu, columns.ACTUATOR_NUMBERS))
    constant_gain = (model.actuator_gaintype[of] != GAIN.mjGAIN_MUSCLE)[:, None]
    affine_gain = (model.actuator_gaintype[of] == GAIN.mjGAIN_AFFINE)[:, None]
    affine_bias = (model.actuator_biastype[of] == BIAS.mjBIAS_AFFINE)[:, None]
    prm[:, columns.GAIN : columns.GAIN + 3] = model.actuator_gainprm[of, :3] * np.hstack(
        [constant_gain, affine_gain, affine_gain]
    )
    prm[:, columns.BIAS : columns.BIAS + 3] = model.actuator_biasprm[of, :3] * affine_bias
    prm[:, columns.TIME_CONSTANT] = np.maximum(model.actuator_dynprm[of, 0], mujoco.mjMINVAL)
    clamped = np.asarray(model.actuator_ctrllimited, bool) & (not disabled(model, OFF.mjDSBL_CLAMPCTRL))
    prm[:, columns.CTRL_RANGE : columns.CTRL_RANGE + 2] = ranges(clamped, model.actuator_ctrlrange)
    force_range = ranges(model.actuator_forcelimited, model.actuator_forcerange)
    prm[:, columns.FORCE_RANGE : columns.FORCE_RANGE + 2] = force_range[of]
    prm[:, columns.ACT_RANGE : columns.ACT_RANGE + 2] = ranges(model.actuator_actlimited, model.actuator_actrange)[of]
    groups = np.clip(model.actuator_group[of], 0, 31)
    on_site = model.actuator_trntype[of] == TRN.mjTRN_SITE
    sites = np.where(on_site, model.actuator_trnid[of, 0], -1)
    return {
        "act_prm": prm, "act_muscle": _muscles(model, of), "act_dynamics": model.actuator_dyntype[of],
        "act_adr": np.where(model.actuator_actnum > 0, model.actuator_actadr, -1)[of],
        "act_early": np.asarray(model.actuator_actearly, np.int64)[of],
        "act_enabled": ((model.opt.disableactuator >> groups) & 1) == 0,
        "act_site": sites, "act_body": np.where(on_site, model.site_bodyid[sites], -1) if model.nsite else sites,
        "act_gear": model.actuator_gear[model.actuator_outadr[of]],
    } | lists("act", [_moment(model, int(i)) for i in of])  # fmt: skip


def _muscles(model: mujoco.MjModel, of: Any) -> Any:
    """Parameters of muscles, for the controls of the actuators `of`: columns.MUSCLE_NUMBERS of them, else zeros."""
    prm = np.zeros((len(of), columns.MUSCLE_NUMBERS))
    for row, i in zip(prm, of, strict=True):
        out = model.actuator_outadr[i]
        row[columns.LENGTH_RANGE : columns.LENGTH_RANGE + 2] = model.actuator_lengthrange[out]
        for at, kind, muscle, given in (
            (columns.MUSCLE_GAIN, model.actuator_gaintype[i], GAIN.mjGAIN_MUSCLE, model.actuator_gainprm[i]),
            (columns.MUSCLE_BIAS, model.actuator_biastype[i], BIAS.mjBIAS_MUSCLE, model.actuator_biasprm[i]),
        ):
            if kind == muscle:
                row[at : at + 9] = given[:9]
                row[at + 2] = given[2] if given[2] >= 0 else given[3] / max(mujoco.mjMINVAL, model.actuator_acc0[out])
        if model.actuator_dyntype[i] == DYN.mjDYN_MUSCLE:
            row[columns.MUSCLE_TIMES : columns.MUSCLE_TIMES + 3] = model.actuator_dynprm[i, :3]
    return prm


def _moment(model: mujoco.MjModel, i: int) -> tuple[Any, Any]:
    """Dofs and coefficients of an actuator's constant moment arm; empty for one at a site."""
    kind, target, gear = model.actuator_trntype[i], model.actuator_trnid[i, 0], gear_of(model, i)
    if kind == TRN.mjTRN_TENDON:
        dofs, coefficients = tendon_dofs(model, target)
        return dofs, gear[0] * coefficients
    if kind in ON_JOINTS:
        size = {JOINT.mjJNT_FREE: 6, JOINT.mjJNT_BALL: 3}.get(model.jnt_type[target], 1)
        return model.jnt_dofadr[target] + np.arange(size), gear[:size]
    return np.zeros(0, np.int64), np.zeros(0)


def metric_table(model: mujoco.MjModel, table: dict[str, Any]) -> dict[str, Any]:
    """What the discrete integrator needs besides: which terms enter its metric, and which of them change."""
    nonlinear = [
        table["dof_damping"][:, 1:], table["spring_prm"][:, 2:], table["ball_prm"][:, 5:],
        table["ten_prm"][:, columns.STIFFNESS + 1 : columns.STIFFNESS + 3],
        table["ten_prm"][:, columns.DAMPING + 1 : columns.DAMPING + 3],
        table["act_prm"][:, columns.GAIN + 1 : columns.GAIN + 3],
    ]  # fmt: skip
    return {
        "coupled": int(model.opt.solver != SOLVER.mjSOL_PGS), "bends": int(any(part.any() for part in nonlinear)),
        "refsafe": int(not disabled(model, OFF.mjDSBL_REFSAFE)),
        "jnt_solref": model.jnt_solref, "ten_solref": model.tendon_solref_lim,
    }  # fmt: skip
