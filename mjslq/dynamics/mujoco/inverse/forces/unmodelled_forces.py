"""Smooth forces that have no closed form here, set apart from those that have one.

Forces add up, so that a model can be split in two: in one copy what has no closed form is switched off, and `plan`
makes the kernel's tables of that; in the other everything else is, and `differences` differentiates what is
left. Only parts that act on the motion count. Without a closed form are

    nonlinear springs of free joints;
    actuators with several inputs or outputs, with gain, bias or dynamics other than `GAINS`, `BIASES`, `DYNAMICS`, on
    bodies or on tendons with a force limit;
    actuators, and gravity compensation, on joints that clip a force in which these, tendons or sites share.

Between the two stand forces along a length that is no linear function of positions, whose law has a closed form but
whose moment arm has none (`arms`): tendons that are spatial, or run across branches with a damping that is nonlinear
and taken implicitly, and actuators on such tendons, on cranks, at sites, on ball and free joints.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.plan import (
    BIAS,
    DYN,
    GAIN,
    JOINT,
    ON_JOINTS,
    SCALAR,
    TRN,
    WRAP,
    implicit_level,
    joint_of,
    lone_dofs,
    tendon_dofs,
    tendons,
)

DYNAMICS = tuple(
    int(kind)
    for kind in (DYN.mjDYN_NONE, DYN.mjDYN_INTEGRATOR, DYN.mjDYN_FILTER, DYN.mjDYN_FILTEREXACT, DYN.mjDYN_MUSCLE)
)
AFFINE_GAINS = (int(GAIN.mjGAIN_FIXED), int(GAIN.mjGAIN_AFFINE))
AFFINE_BIASES = (int(BIAS.mjBIAS_NONE), int(BIAS.mjBIAS_AFFINE))
GAINS = (*AFFINE_GAINS, int(GAIN.mjGAIN_MUSCLE))
BIASES = (*AFFINE_BIASES, int(BIAS.mjBIAS_MUSCLE))
Mask = np.ndarray[Any, Any]


@dataclass(frozen=True)
class UnmodelledForces:
    """Parts of a model whose forces have no closed form: masks of its joints and actuators, and a switch."""

    clipped_gravcomp: bool
    """Whether gravity compensation takes part in forces that joints clip."""
    joints: Mask
    actuators: Mask
    moving_arm_tendons: Mask
    """Tendons whose springs and dampers have a closed form, but not their moment arms."""
    moving_arm_actuators: Mask
    """Actuators of that kind."""

    @property
    def is_passive(self) -> bool:
        """Whether forces other than the actuators' are among them."""
        return bool(self.clipped_gravcomp or self.joints.any())

    @property
    def exists(self) -> bool:
        """Whether there is anything without a closed form."""
        return self.is_passive or bool(self.actuators.any())


def unmodelled_forces(model: mujoco.MjModel) -> UnmodelledForces:
    """Find what has no closed form."""
    clipped_gravcomp = np.asarray(model.jnt_actfrclimited, bool) & np.asarray(model.jnt_actgravcomp, bool)
    clipped_gravcomp &= bool(model.body_gravcomp.any())
    nonlinear = model.jnt_stiffnesspoly.any(axis=1)
    open_, moving_arm_actuators = _open_actuators(model, clipped_gravcomp)
    return UnmodelledForces(
        clipped_gravcomp=bool(clipped_gravcomp.any()),
        joints=nonlinear & (model.jnt_type == JOINT.mjJNT_FREE),
        actuators=open_,
        moving_arm_tendons=np.array([_has_moving_arm(model, t) for t in range(model.ntendon)], bool),
        moving_arm_actuators=moving_arm_actuators,
    )


def is_spatial(model: mujoco.MjModel, t: int) -> bool:
    """Whether tendon t runs through sites and around geoms."""
    return bool(model.wrap_type[model.tendon_adr[t]] != WRAP.mjWRAP_JOINT)


def _has_moving_arm(model: mujoco.MjModel, t: int) -> bool:
    """Whether the passive forces of tendon t have a closed form along a moment arm that has none."""
    prm = tendons(model)["ten_prm"][t]
    if is_spatial(model, t):
        return bool(prm[columns.STIFFNESS : columns.ARMATURE].any())
    nonlinear = implicit_level(model) == 2 and prm[columns.DAMPING + 1 : columns.DAMPING + 3].any()
    return bool(nonlinear) and not on_one_branch(model, tendon_dofs(model, t)[0])


def on_one_branch(model: mujoco.MjModel, dofs: Any) -> bool:
    """Whether all of `dofs` lie on the way from one of them to the world, as far as an implicit integrator sees."""
    return len(dofs) == 0 or set(dofs.tolist()) <= coupled_dofs(model, int(np.max(dofs)))


def coupled_dofs(model: mujoco.MjModel, i: int) -> set[int]:
    """Dof i, and those on its way to the world that an implicit integrator couples it with."""
    return {i} if lone_dofs(model)[i] else ancestors(model, i)


def ancestors(model: mujoco.MjModel, i: int) -> set[int]:
    """Dof i, and all on its way to the world."""
    found: set[int] = set()
    while i >= 0:
        found.add(i)
        i = int(model.dof_parentid[i])
    return found


def _has_closed_law(model: mujoco.MjModel, i: int) -> bool:
    """Whether the force of actuator i is a known function of one length, velocity, control and activation."""
    return bool(
        model.actuator_ctrlnum[i] == 1 and model.actuator_outnum[i] == 1 and model.actuator_actnum[i] <= 1
        and model.actuator_dyntype[i] in DYNAMICS and model.actuator_gaintype[i] in GAINS
        and model.actuator_biastype[i] in BIASES and model.actuator_plugin[i] < 0
    )  # fmt: skip


def _has_closed_arm(model: mujoco.MjModel, i: int) -> bool:
    """Whether the length and moment arm of actuator i, as far as they matter, have a closed form."""
    kind, target = model.actuator_trntype[i], model.actuator_trnid[i]
    if joint_of(model, i) >= 0:
        return True
    if kind == TRN.mjTRN_TENDON:
        if is_spatial(model, target[0]):
            return False
        return (
            implicit_level(model) != 2
            or not _gain_feels_speed(model, i)
            or on_one_branch(model, tendon_dofs(model, target[0])[0])
        )
    if kind == TRN.mjTRN_JOINT or (kind == TRN.mjTRN_SITE and target[1] < 0):
        return not _feels_motion(model, i)
    return False


def _gain_feels_speed(model: mujoco.MjModel, i: int) -> bool:
    kind = model.actuator_gaintype[i]
    affine = kind == GAIN.mjGAIN_AFFINE and model.actuator_gainprm[i, 2] != 0.0
    return bool(affine or kind == GAIN.mjGAIN_MUSCLE)


def _feels_motion(model: mujoco.MjModel, i: int) -> bool:
    """Whether the force of actuator i depends on its length or velocity."""
    gain, bias = model.actuator_gaintype[i], model.actuator_biastype[i]
    return bool(
        (gain == GAIN.mjGAIN_AFFINE and model.actuator_gainprm[i, 1:3].any())
        or (bias == BIAS.mjBIAS_AFFINE and model.actuator_biasprm[i, 1:3].any())
        or gain == GAIN.mjGAIN_MUSCLE
        or bias == BIAS.mjBIAS_MUSCLE
    )


def _open_actuators(model: mujoco.MjModel, clipped_gravcomp: Mask) -> tuple[Mask, Mask]:
    """Actuators without a closed form, and those that lack it only for their moment arm.

    To the first belong all that share a clipped joint with what spreads over several dofs.
    """
    count = model.nactuator
    limited_tendon = np.zeros(count, bool)
    for i in np.flatnonzero(model.actuator_trntype == TRN.mjTRN_TENDON):
        limited_tendon[i] = model.tendon_actfrclimited[model.actuator_trnid[i, 0]]
    strange = np.isin(model.actuator_trntype, (TRN.mjTRN_BODY, TRN.mjTRN_SO3)) | limited_tendon
    found = strange | np.array([not _has_closed_law(model, i) for i in range(count)], bool)
    moving_arm_actuators = np.array([not _has_closed_arm(model, i) for i in range(count)], bool)
    limited = np.flatnonzero(model.jnt_actfrclimited)
    drives = [driven_dofs(model, i) for i in range(count)]
    direct = np.array([joint_of(model, i) >= 0 for i in range(count)], bool)
    while True:
        before = found.copy()
        for j in limited:
            first = int(model.jnt_dofadr[j])
            size = 1 if model.jnt_type[j] in SCALAR else 3 if model.jnt_type[j] == JOINT.mjJNT_BALL else 6
            here = np.array([bool(dofs & set(range(first, first + size))) for dofs in drives], bool)
            if clipped_gravcomp[j] or size > 1 or (here & (found | ~direct)).any():
                found |= here
        if (found == before).all():
            return found, moving_arm_actuators & ~found


def driven_dofs(model: mujoco.MjModel, i: int) -> set[int]:
    """Dofs that actuator i may exert a force on."""
    kind, target = model.actuator_trntype[i], model.actuator_trnid[i]
    if kind == TRN.mjTRN_TENDON:
        return touched_dofs(model, target[0])
    if kind in ON_JOINTS or (kind == TRN.mjTRN_SO3 and not _is_at_site(model, i)):
        joint = int(target[0])
        size = {JOINT.mjJNT_FREE: 6, JOINT.mjJNT_BALL: 3}.get(int(model.jnt_type[joint]), 1)
        return set(range(model.jnt_dofadr[joint], model.jnt_dofadr[joint] + size))
    if kind == TRN.mjTRN_BODY:
        return set(range(model.nv))
    return _relative_dofs(model, [int(model.site_bodyid[s]) if s >= 0 else 0 for s in target])


def _is_at_site(model: mujoco.MjModel, i: int) -> bool:
    """Whether an orientation servo turns a site relative to another one, and not a ball joint."""
    return bool(model.actuator_trnid[i, 1] >= 0)


def touched_dofs(model: mujoco.MjModel, t: int) -> set[int]:
    """Dofs that the length of tendon t depends on."""
    path = range(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t])
    if not is_spatial(model, t):
        return set(tendon_dofs(model, t)[0].tolist())
    bodies = []
    for k in path:
        kind, of = model.wrap_type[k], int(model.wrap_objid[k])
        if kind == WRAP.mjWRAP_SITE:
            bodies.append(int(model.site_bodyid[of]))
        elif kind in (WRAP.mjWRAP_SPHERE, WRAP.mjWRAP_CYLINDER):
            bodies.append(int(model.geom_bodyid[of]))
    return _relative_dofs(model, bodies)


def _relative_dofs(model: mujoco.MjModel, bodies: list[int]) -> set[int]:
    """Dofs that move the bodies relative to each other."""
    chains: list[set[int]] = []
    for b in bodies:
        while b > 0 and model.body_dofnum[b] == 0:
            b = int(model.body_parentid[b])
        last = int(model.body_dofadr[b] + model.body_dofnum[b] - 1) if b > 0 else -1
        chains.append(ancestors(model, last))
    return set().union(*chains) - chains[0].intersection(*chains[1:])


def covered_part(model: mujoco.MjModel, rest: UnmodelledForces) -> mujoco.MjModel:
    """Copy of the model without the forces without a closed form, and the passive ones of tendons with moving arms."""
    part = copy.copy(model)
    _disable_tendons(part, rest.moving_arm_tendons)
    _disable_springs(part, rest.joints)
    _disable_actuators(part, rest.actuators)
    if rest.clipped_gravcomp:
        part.body_gravcomp[:] = 0.0
    for i in np.flatnonzero(rest.actuators):
        if model.actuator_dyntype[i] not in DYNAMICS or model.actuator_actnum[i] > 1 or model.actuator_ctrlnum[i] != 1:
            part.actuator_dyntype[i], part.actuator_actnum[i] = DYN.mjDYN_NONE, 0
        for dof in driven_dofs(model, int(i)):
            part.jnt_actfrclimited[model.dof_jntid[dof]] = False
    return part


def rest_part(model: mujoco.MjModel, rest: UnmodelledForces) -> mujoco.MjModel:
    """Copy of the model with no other smooth forces than those without a closed form."""
    part = copy.copy(model)
    part.opt.density = part.opt.viscosity = 0.0
    _disable_springs(part, ~rest.joints)
    _disable_actuators(part, ~rest.actuators)
    _disable_tendons(part, np.ones(model.ntendon, bool))
    part.dof_damping[:] = part.dof_dampingpoly[:] = part.actuator_damping[:] = part.actuator_dampingpoly[:] = 0.0
    if not rest.clipped_gravcomp:
        part.body_gravcomp[:] = 0.0
    return part


def _disable_tendons(model: mujoco.MjModel, which: Mask) -> None:
    """Take springs and dampers away from some tendons, and dampers from what drives them."""
    model.tendon_stiffness[which] = model.tendon_stiffnesspoly[which] = 0.0
    model.tendon_damping[which] = model.tendon_dampingpoly[which] = 0.0
    for i in np.flatnonzero(model.actuator_trntype == TRN.mjTRN_TENDON):
        if which[model.actuator_trnid[i, 0]]:
            model.actuator_damping[i] = model.actuator_dampingpoly[i] = 0.0


def _disable_springs(model: mujoco.MjModel, which: Mask) -> None:
    """Take springs away from some joints."""
    model.jnt_stiffness[which] = model.jnt_stiffnesspoly[which] = 0.0


def _disable_actuators(model: mujoco.MjModel, which: Mask) -> None:
    """Take the force away from some actuators."""
    model.actuator_gaintype[which], model.actuator_biastype[which] = GAIN.mjGAIN_FIXED, BIAS.mjBIAS_NONE
    model.actuator_gainprm[which] = 0.0


def rest_table(model: mujoco.MjModel, rest: UnmodelledForces) -> dict[str, Any]:
    """What the kernel varies to differentiate the forces of the rest, and what it evaluates for that."""
    positions: set[int] = set(range(model.nv)) if rest.clipped_gravcomp else set()
    for j in np.flatnonzero(rest.joints):
        positions = positions | set(range(model.jnt_dofadr[j], model.jnt_dofadr[j] + 6))
    moved = [driven_dofs(model, int(i)) for i in np.flatnonzero(rest.actuators)]
    velocities = set[int]().union(*moved)
    positions |= velocities
    acts, controls, following = _signals(model, rest)
    return {
        "rest_q": _indices(positions), "nrest_q": len(positions), "rest_v": _indices(velocities),
        "nrest_v": len(velocities), "rest_act": acts, "nrest_act": len(acts), "rest_u": controls,
        "nrest_u": len(controls), "rest_next": following, "nrest_next": len(following),
        "rest_passive": int(rest.is_passive), "rest_acts": int(rest.actuators.any()),
        "rest_poses": int(rest.is_passive or any(not _is_plain(model, int(i)) for i in np.flatnonzero(rest.actuators))),
        "rest_touches": int((model.actuator_trntype[rest.actuators] == TRN.mjTRN_BODY).any()),
        "nout": model.nout, "nD": model.nD,
        "D_rownnz": model.D_rownnz, "D_rowadr": model.D_rowadr, "D_colind": model.D_colind,
        "ctrl_range": _control_ranges(model),
    }  # fmt: skip


def _is_plain(model: mujoco.MjModel, i: int) -> bool:
    """Whether the length of actuator i needs no kinematics."""
    fixed = model.actuator_trntype[i] == TRN.mjTRN_TENDON and not is_spatial(model, int(model.actuator_trnid[i, 0]))
    return bool(fixed) or joint_of(model, i) >= 0


def _indices(found: set[int]) -> Any:
    return np.array(sorted(found), np.int64)


def _signals(model: mujoco.MjModel, rest: UnmodelledForces) -> tuple[Any, Any, Any]:
    """Activations and controls of the actuators in the rest, and the activations whose dynamics have no closed form."""
    acts: list[int] = []
    controls: list[int] = []
    following: list[int] = []
    for i in np.flatnonzero(rest.actuators):
        own = [int(model.actuator_actadr[i]) + k for k in range(model.actuator_actnum[i])]
        closed = model.actuator_dyntype[i] in DYNAMICS and len(own) == 1 and model.actuator_ctrlnum[i] == 1
        acts += own
        following += [] if closed else own
        if not closed or model.actuator_actearly[i]:
            controls += [int(model.actuator_ctrladr[i]) + k for k in range(model.actuator_ctrlnum[i])]
    return np.array(acts, np.int64), np.array(controls, np.int64), np.array(following, np.int64)


def _control_ranges(model: mujoco.MjModel) -> Any:
    """Where the controls are clamped; without limits where they are not. Shape (nu, 2)."""
    clamped = np.asarray(model.actuator_ctrllimited, bool)
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL):
        clamped = np.zeros_like(clamped)
    return np.where(clamped[:, None], model.actuator_ctrlrange, [-1e300, 1e300])
