"""What the kernel of the inverse Jacobians has to know about a model's sensors.

A sensor's reading is a function of the state alone, or of state, control and acceleration; how far it reaches is its
stage in MuJoCo's pipeline. Those that costs are made of have derivatives in closed form (`motions`, `accelerations`,
`pressures`). The others are differenced within their stage (`stages`), where the acceleration moves along with what is
varied, so that no constraint solver runs. Which formula serves a sensor is settled here, by its kind (`columns`).
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.forces.unmodelled_forces import UnmodelledForces, is_spatial, unmodelled_forces
from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.plan import (
    EQ,
    OFF,
    ON_JOINTS,
    SCALAR,
    TRN,
    disabled,
    whole,
)

_SENSOR, _OBJECT, _DATA = whole(mujoco.mjtSensor), whole(mujoco.mjtObj), whole(mujoco.mjtDataType)
_STAGE, _ROW = whole(mujoco.mjtStage), whole(mujoco.mjtConstraint)
TYPES = {int(kind): name.removeprefix("mjSENS_").lower() for name, kind in mujoco.mjtSensor.__members__.items()}
"""Names of the types of sensors."""
_DISTANCE_ALONE = 1 << int(mujoco.mjtRayDataField.mjRAYDATA_DIST)
_CONSTANT = (_SENSOR.mjSENS_CLOCK, _SENSOR.mjSENS_INSIDESITE, _SENSOR.mjSENS_USER)
_ON_DOFS = {
    _SENSOR.mjSENS_JOINTPOS: columns.JOINT_POS,
    _SENSOR.mjSENS_JOINTVEL: columns.JOINT_VEL,
    _SENSOR.mjSENS_JOINTACTFRC: columns.JOINT_FORCE,
    _SENSOR.mjSENS_BALLQUAT: columns.BALL_QUAT,
    _SENSOR.mjSENS_BALLANGVEL: columns.BALL_VEL,
}
_ON_TENDONS = {
    _SENSOR.mjSENS_TENDONPOS: columns.TENDON_POS,
    _SENSOR.mjSENS_TENDONVEL: columns.TENDON_VEL,
    _SENSOR.mjSENS_TENDONACTFRC: columns.TENDON_FORCE,
}
_ON_ACTUATORS = {
    _SENSOR.mjSENS_ACTUATORPOS: columns.ACTUATOR_POS,
    _SENSOR.mjSENS_ACTUATORVEL: columns.ACTUATOR_VEL,
    _SENSOR.mjSENS_ACTUATORFRC: columns.ACTUATOR_FORCE,
}
_ON_FRAMES = {
    _SENSOR.mjSENS_FRAMEPOS: columns.FRAME_POS,
    _SENSOR.mjSENS_FRAMEQUAT: columns.FRAME_QUAT,
    _SENSOR.mjSENS_FRAMEXAXIS: columns.FRAME_AXIS,
    _SENSOR.mjSENS_FRAMEYAXIS: columns.FRAME_AXIS,
    _SENSOR.mjSENS_FRAMEZAXIS: columns.FRAME_AXIS,
    _SENSOR.mjSENS_FRAMELINVEL: columns.FRAME_VEL,
    _SENSOR.mjSENS_FRAMEANGVEL: columns.FRAME_TURN,
    _SENSOR.mjSENS_VELOCIMETER: columns.LOCAL_VEL,
    _SENSOR.mjSENS_GYRO: columns.LOCAL_TURN,
    _SENSOR.mjSENS_MAGNETOMETER: columns.LOCAL_FIELD,
    _SENSOR.mjSENS_FRAMELINACC: columns.FRAME_ACC,
    _SENSOR.mjSENS_FRAMEANGACC: columns.FRAME_SPIN,
    _SENSOR.mjSENS_ACCELEROMETER: columns.LOCAL_ACC,
    _SENSOR.mjSENS_FORCE: columns.FORCE,
    _SENSOR.mjSENS_TORQUE: columns.TORQUE,
    _SENSOR.mjSENS_TOUCH: columns.TOUCH,
}
_AXES = {_SENSOR.mjSENS_FRAMEXAXIS: 0, _SENSOR.mjSENS_FRAMEYAXIS: 1, _SENSOR.mjSENS_FRAMEZAXIS: 2}
_ON_SUBTREES = {
    _SENSOR.mjSENS_SUBTREECOM: columns.SUBTREE_COM,
    _SENSOR.mjSENS_SUBTREELINVEL: columns.SUBTREE_VEL,
    _SENSOR.mjSENS_SUBTREEANGMOM: columns.SUBTREE_TURN,
}
_ON_LIMITS = {
    _SENSOR.mjSENS_JOINTLIMITPOS: columns.LIMIT_POS,
    _SENSOR.mjSENS_JOINTLIMITVEL: columns.LIMIT_VEL,
    _SENSOR.mjSENS_JOINTLIMITFRC: columns.LIMIT_FORCE,
    _SENSOR.mjSENS_TENDONLIMITPOS: columns.LIMIT_POS,
    _SENSOR.mjSENS_TENDONLIMITVEL: columns.LIMIT_VEL,
    _SENSOR.mjSENS_TENDONLIMITFRC: columns.LIMIT_FORCE,
}
_ON_CONTACTS = (columns.FORCE, columns.TORQUE, columns.TOUCH, columns.CONTACT)
_SIDES = {
    _OBJECT.mjOBJ_UNKNOWN: columns.ANY,
    _OBJECT.mjOBJ_GEOM: columns.GEOM,
    _OBJECT.mjOBJ_BODY: columns.BODY,
    _OBJECT.mjOBJ_XBODY: columns.SUBTREE,
    _OBJECT.mjOBJ_SITE: columns.INSIDE,
}
_BODILY = (
    _SENSOR.mjSENS_ACCELEROMETER, _SENSOR.mjSENS_FORCE, _SENSOR.mjSENS_TORQUE, _SENSOR.mjSENS_FRAMELINACC,
    _SENSOR.mjSENS_FRAMEANGACC,
)  # fmt: skip


def sensor_kind(model: mujoco.MjModel, s: int, rest: UnmodelledForces) -> int:
    """Kind of sensor s; BY_DIFFERENCES when there is no closed form for it, or for the force it reads."""
    kind, target = int(model.sensor_type[s]), int(model.sensor_objid[s])
    if disabled(model, OFF.mjDSBL_SENSOR) or (kind in _CONSTANT and not model.sensor_intprm[s].any()):
        return columns.CONSTANT  # an enclosed insidesite is a distance
    if kind == _SENSOR.mjSENS_E_KINETIC:
        return columns.BY_DIFFERENCES if _has_spatial_tendon(model) else columns.KINETIC_ENERGY
    if kind == _SENSOR.mjSENS_RANGEFINDER:
        plain = model.sensor_objtype[s] == _OBJECT.mjOBJ_SITE and model.sensor_intprm[s, 0] == _DISTANCE_ALONE
        return columns.RANGE if plain else columns.BY_DIFFERENCES
    if kind == _SENSOR.mjSENS_CONTACT:
        return columns.CONTACT if _is_plain_contact(model, s) else columns.BY_DIFFERENCES
    for table, is_known in (
        (_ON_DOFS, _knows_dof),
        (_ON_TENDONS, _knows_tendon),
        (_ON_ACTUATORS, _knows_actuator),
        (_ON_LIMITS, _knows_limit),
    ):
        if kind in table:
            return table[kind] if is_known(model, kind, target, rest) else columns.BY_DIFFERENCES
    if kind in _ON_FRAMES:
        return _ON_FRAMES[kind] if _knows_frame(model, s) else columns.BY_DIFFERENCES
    return _ON_SUBTREES.get(kind, columns.BY_DIFFERENCES)


def sensors(model: mujoco.MjModel) -> dict[str, Any]:
    """Kinds, addresses, targets and frames of the sensors."""
    count = model.nsensor
    rest = unmodelled_forces(model)
    kinds = np.array([sensor_kind(model, s, rest) for s in range(count)], np.int64)
    target, body, reference = np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros(count, np.int64)
    prm = np.zeros((count, columns.FRAME_NUMBERS))
    for s, kind in enumerate(kinds):
        of, to = int(model.sensor_objid[s]), int(model.sensor_type[s])
        target[s] = of
        if to in _ON_DOFS:
            target[s] = model.jnt_dofadr[of]
        elif to in _ON_SUBTREES:
            body[s] = of
        elif to in _ON_LIMITS:
            on_joint = model.sensor_objtype[s] == _OBJECT.mjOBJ_JOINT
            reference[s] = _ROW.mjCNSTR_LIMIT_JOINT if on_joint else _ROW.mjCNSTR_LIMIT_TENDON
        elif kind != columns.BY_DIFFERENCES and to in _ON_FRAMES:
            target[s] = _AXES.get(to, of)
            frame = _frame(model, int(model.sensor_objtype[s]), of)
            other = _frame(model, int(model.sensor_reftype[s]), int(model.sensor_refid[s]))
            assert frame is not None and other is not None
            body[s], reference[s] = frame[0], other[0]
            prm[s] = np.concatenate([frame[1], frame[2], other[1], other[2]])
    return {
        "nsensor": count, "sen_kind": kinds, "sen_adr": model.sensor_adr, "sen_dim": model.sensor_dim,
        "sen_target": target, "sen_body": body, "sen_reference": reference, "sen_prm": prm,
        "body_subtreemass": model.body_subtreemass, "magnetic": model.opt.magnetic,
        "site_type": model.site_type, "site_size": model.site_size,
    } | _stages(model, kinds) | _contact_fields(model) | _cutoffs(model, kinds) | _pulled_tendons(model)  # fmt: skip


def _stages(model: mujoco.MjModel, kinds: Any) -> dict[str, Any]:
    """How far each sensor reaches, and what has to be done for them all together."""
    stages = np.array(model.sensor_needstage, np.int64)
    stages[model.sensor_type == _SENSOR.mjSENS_E_KINETIC] = _STAGE.mjSTAGE_VEL  # which MuJoCo evaluates with positions
    differenced, far = kinds == columns.BY_DIFFERENCES, stages == _STAGE.mjSTAGE_ACC
    by_acceleration = np.isin(kinds, [columns.FRAME_ACC, columns.FRAME_SPIN, columns.LOCAL_ACC, columns.LIMIT_FORCE])
    by_acceleration |= differenced | np.isin(kinds, _ON_CONTACTS)
    on_rows = np.isin(model.sensor_type, [*_ON_LIMITS, _SENSOR.mjSENS_CONTACT]) | np.isin(kinds, _ON_CONTACTS)
    on_rows |= differenced & far
    energies = np.isin(model.sensor_type, [_SENSOR.mjSENS_E_POTENTIAL, _SENSOR.mjSENS_E_KINETIC])
    cut = bool(_cutoffs(model, kinds)["sensors_cut"])
    pulls = np.isin(model.sensor_type, [*_ON_ACTUATORS, *_ON_TENDONS, _SENSOR.mjSENS_JOINTACTFRC])
    pulls |= np.isin(model.sensor_type, [_SENSOR.mjSENS_FORCE, _SENSOR.mjSENS_TORQUE]) & _has_spatial_tendon(model)
    feels = np.isin(model.sensor_type, _BODILY)
    return {
        "sen_stage": stages,
        "sensors_differenced": int(stages[differenced].max(initial=0)),
        "sensors_accelerated": int((by_acceleration & far).any()),
        "sensors_on_rows": int(on_rows.any()),
        "sensors_of_energy": int(energies.any()),
        "sensors_of_bodies": int(feels.any()),
        "sensors_of_actuators": int((pulls & (differenced | cut)).any()),
    }


def _contact_fields(model: mujoco.MjModel) -> dict[str, Any]:
    """What the contact sensors match and report."""
    sides = np.zeros((model.nsensor, 4), np.int64)
    for s in np.flatnonzero(model.sensor_type == _SENSOR.mjSENS_CONTACT):
        sides[s] = (
            _SIDES.get(int(model.sensor_objtype[s]), columns.ANY), model.sensor_objid[s],
            _SIDES.get(int(model.sensor_reftype[s]), columns.ANY), model.sensor_refid[s],
        )  # fmt: skip
    return {
        "sen_sides": sides,
        "sen_fields": model.sensor_intprm[:, 0] if model.nsensor else np.zeros(0),
        "sen_reduction": model.sensor_intprm[:, 1] if model.nsensor else np.zeros(0),
    }


def _cutoffs(model: mujoco.MjModel, kinds: Any) -> dict[str, Any]:
    """Lower and upper limits of readings that have a closed form, infinite where there are none."""
    real, positive = model.sensor_datatype == _DATA.mjDATATYPE_REAL, model.sensor_datatype == _DATA.mjDATATYPE_POSITIVE
    limited = (model.sensor_cutoff > 0) & (real | positive)
    limited &= ~np.isin(kinds, [columns.BY_DIFFERENCES, columns.CONSTANT, columns.CONTACT])
    upper = np.where(limited, model.sensor_cutoff, np.inf)
    return {
        "sen_range": np.column_stack([np.where(real, -upper, -np.inf), upper]),
        "sensors_cut": int(limited.any()),
    }


def _pulled_tendons(model: mujoco.MjModel) -> dict[str, Any]:
    """Tendons that the controls' actuators pull; -1 where they pull none."""
    of = np.repeat(np.arange(model.nactuator), model.actuator_ctrlnum)
    on_tendon = model.actuator_trntype[of] == TRN.mjTRN_TENDON
    return {"act_tendon": np.where(on_tendon, model.actuator_trnid[of, 0], -1)}


def _has_spatial_tendon(model: mujoco.MjModel) -> bool:
    return any(is_spatial(model, t) for t in range(model.ntendon))


def _open_actuators(model: mujoco.MjModel, rest: UnmodelledForces) -> Any:
    """Mark the actuators whose rows the kernel does not fill: their force or its moment arm has no closed form."""
    has_rows = model.nactuator == model.nu == model.nout  # actuators, controls and forces are numbered alike
    marked: Any = rest.actuators | rest.moving_arm_actuators | (not has_rows)
    return marked


def _knows_dof(model: mujoco.MjModel, kind: int, joint: int, rest: UnmodelledForces) -> bool:
    if kind != _SENSOR.mjSENS_JOINTACTFRC:
        return True
    on_site = (model.actuator_trntype == TRN.mjTRN_SITE).any()
    return not (_open_actuators(model, rest).any() or on_site or model.jnt_actgravcomp[joint])


def _knows_tendon(model: mujoco.MjModel, kind: int, tendon: int, rest: UnmodelledForces) -> bool:
    pulls = (model.actuator_trntype == TRN.mjTRN_TENDON) & (model.actuator_trnid[:, 0] == tendon)
    plain = not (pulls & _open_actuators(model, rest)).any()
    return not is_spatial(model, tendon) and (plain or kind != _SENSOR.mjSENS_TENDONACTFRC)


def _knows_actuator(model: mujoco.MjModel, kind: int, i: int, rest: UnmodelledForces) -> bool:
    if kind == _SENSOR.mjSENS_ACTUATORFRC:
        return not _open_actuators(model, rest)[i]
    of, target = model.actuator_trntype[i], int(model.actuator_trnid[i, 0])
    if not model.nactuator == model.nu == model.nout:
        return False
    if of == TRN.mjTRN_TENDON:
        return not is_spatial(model, target)
    return bool(of in ON_JOINTS and model.jnt_type[target] in SCALAR)


def _knows_limit(model: mujoco.MjModel, kind: int, target: int, rest: UnmodelledForces) -> bool:
    if _ON_LIMITS[kind] == columns.LIMIT_POS:
        return True
    if kind in (_SENSOR.mjSENS_JOINTLIMITVEL, _SENSOR.mjSENS_JOINTLIMITFRC):
        return bool(model.jnt_type[target] in SCALAR)
    return not is_spatial(model, target)


def _knows_frame(model: mujoco.MjModel, s: int) -> bool:
    kind, target = int(model.sensor_type[s]), int(model.sensor_objid[s])
    frame = _frame(model, int(model.sensor_objtype[s]), target)
    other = _frame(model, int(model.sensor_reftype[s]), int(model.sensor_refid[s]))
    if frame is None or other is None:
        return False
    if kind == _SENSOR.mjSENS_TOUCH:
        return bool(model.site_type[target] != mujoco.mjtGeom.mjGEOM_MESH)
    if kind not in (_SENSOR.mjSENS_FORCE, _SENSOR.mjSENS_TORQUE):
        return True
    # connect and weld constraints, and spatial tendons, pull at bodies too
    tied = np.isin(model.eq_type, [EQ.mjEQ_CONNECT, EQ.mjEQ_WELD]).any()
    return not (tied or frame[0] == 0 or _has_spatial_tendon(model))


def _is_plain_contact(model: mujoco.MjModel, s: int) -> bool:
    """Whether what a contact sensor reports has a closed form: all but where a net force acts, and its torque."""
    fields, reduction = int(model.sensor_intprm[s, 0]), int(model.sensor_intprm[s, 1])
    if fields >= 1 << columns.FIELDS or not {int(model.sensor_objtype[s]), int(model.sensor_reftype[s])} <= set(_SIDES):
        return False
    return reduction != columns.NET_FORCE or not fields & (1 << columns.CONTACT_TORQUE | 1 << columns.POINT)


def _frame(model: mujoco.MjModel, kind: int, index: int) -> tuple[int, Any, Any] | None:
    """Body, place and orientation in it of a frame, the world for none at all; None for what no one body carries."""
    if kind == _OBJECT.mjOBJ_UNKNOWN or index < 0:
        return 0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    if kind == _OBJECT.mjOBJ_XBODY:
        return index, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    if kind == _OBJECT.mjOBJ_BODY:
        return index, model.body_ipos[index], model.body_iquat[index]
    if kind == _OBJECT.mjOBJ_GEOM:
        return int(model.geom_bodyid[index]), model.geom_pos[index], model.geom_quat[index]
    if kind == _OBJECT.mjOBJ_SITE:
        return int(model.site_bodyid[index]), model.site_pos[index], model.site_quat[index]
    if kind == _OBJECT.mjOBJ_CAMERA and model.cam_mode[index] == mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
        return int(model.cam_bodyid[index]), model.cam_pos[index], model.cam_quat[index]
    return None
