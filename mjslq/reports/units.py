"""Units of the states, controls and sensors of a compiled MuJoCo model, for tables and plots."""

from __future__ import annotations

from typing import Any

import mujoco


def model_from_mjb(data: bytes) -> Any:
    """Return the `mujoco.MjModel` stored in the MJB bytes `data`; ValueError when they hold none."""
    try:
        return mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": data})
    except (ValueError, mujoco.FatalError) as error:
        version = mujoco.__version__
        raise ValueError(f"the result's scene is not a model that MuJoCo {version} reads ({error})") from None


def state_kinds(model: Any, columns: tuple[int, ...], size: int) -> list[tuple[str, str]]:
    """Return (kind, unit) of each state: positions where the scene reads them, velocities if their number fits."""
    position_units, velocity_units, length = [], [], length_unit(model)
    for joint in range(model.njnt):
        joint_type = mujoco.mjtJoint(model.jnt_type[joint])
        lengths, quaternions, angles = {
            mujoco.mjtJoint.mjJNT_FREE: (3, 4, 0),
            mujoco.mjtJoint.mjJNT_BALL: (0, 4, 0),
            mujoco.mjtJoint.mjJNT_SLIDE: (1, 0, 0),
            mujoco.mjtJoint.mjJNT_HINGE: (0, 0, 1),
        }[joint_type]
        position_units += [("positions", length)] * lengths + [("quaternions", "")] * quaternions
        position_units += [("positions", "rad")] * angles
        turns = 3 if quaternions else angles
        velocity_units += [("velocities", f"{length}/s")] * lengths + [("velocities", "rad/s")] * turns
    kinds = [("other states", "")] * size
    for column, entry in zip(columns, position_units, strict=False):
        kinds[column] = entry
    rest = [i for i in range(size) if i not in set(columns)]
    if len(rest) in (model.nv, model.nv + model.na):
        for column, entry in zip(rest, velocity_units, strict=False):
            kinds[column] = entry
    return kinds


def length_unit(model: Any) -> str:
    """Return the unit that a model counts lengths in: [m], or what its custom text "length_unit" says."""
    text = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, "length_unit")
    if text < 0:
        return "m"
    start = model.text_adr[text]
    return bytes(model.text_data[start : start + model.text_size[text]]).rstrip(b"\0").decode()


def control_kinds(model: Any) -> list[tuple[str, str]]:
    """Return (kind, unit) of each control: a force or torque where an actuator passes it on as it is."""
    kinds: list[tuple[str, str]] = []
    for actuator in range(model.nactuator):
        joint = int(model.actuator_trnid[actuator, 0])
        plain = (
            model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
            and model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
            and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
            and model.actuator_gainprm[actuator, 0] == 1.0
            and model.actuator_gear[model.actuator_outadr[actuator], 0] == 1.0
        )
        units = {mujoco.mjtJoint.mjJNT_SLIDE: "N", mujoco.mjtJoint.mjJNT_HINGE: "Nm"}
        unit = units.get(mujoco.mjtJoint(model.jnt_type[joint]), "") if plain else ""
        kind = ({"N": "forces", "Nm": "torques"}.get(unit, "controls"), unit)
        kinds += [kind] * int(model.actuator_ctrlnum[actuator])
    return kinds


def sensor_kinds(model: Any) -> list[tuple[str, str]]:
    """Return (kind, unit) of each reading of the sensors; "sensors" without a unit where the type does not tell."""
    length, types = length_unit(model), mujoco.mjtSensor
    of_joint = {types.mjSENS_JOINTPOS: ("positions", ""), types.mjSENS_JOINTVEL: ("velocities", "/s")}
    known = {
        (types.mjSENS_TOUCH, types.mjSENS_FORCE, types.mjSENS_ACTUATORFRC): ("forces", "N"),
        (types.mjSENS_TORQUE,): ("torques", "Nm"),
        (types.mjSENS_FRAMEPOS, types.mjSENS_SUBTREECOM): ("positions", length),
        (types.mjSENS_FRAMELINVEL, types.mjSENS_VELOCIMETER, types.mjSENS_SUBTREELINVEL): ("velocities", f"{length}/s"),
        (types.mjSENS_FRAMEANGVEL, types.mjSENS_GYRO, types.mjSENS_BALLANGVEL): ("angular velocities", "rad/s"),
        (types.mjSENS_ACCELEROMETER, types.mjSENS_FRAMELINACC): ("accelerations", f"{length}/s\u00b2"),
        (types.mjSENS_FRAMEANGACC,): ("angular accelerations", "rad/s\u00b2"),
        (types.mjSENS_FRAMEQUAT, types.mjSENS_BALLQUAT): ("quaternions", ""),
        (types.mjSENS_FRAMEXAXIS, types.mjSENS_FRAMEYAXIS, types.mjSENS_FRAMEZAXIS): ("directions", ""),
        (types.mjSENS_RANGEFINDER, types.mjSENS_TENDONPOS, types.mjSENS_GEOMDIST): ("distances", length),
    }
    by_type = {entry: kind for entries, kind in known.items() for entry in entries}
    kinds: list[tuple[str, str]] = []
    for sensor in range(model.nsensor):
        kind = mujoco.mjtSensor(model.sensor_type[sensor])
        found = by_type.get(kind, ("sensors", ""))
        if kind in of_joint:
            turns = mujoco.mjtJoint(model.jnt_type[model.sensor_objid[sensor]]) == mujoco.mjtJoint.mjJNT_HINGE
            name, rate = of_joint[kind]
            found = (name, ("rad" if turns else length) + rate)
        kinds += [found] * int(model.sensor_dim[sensor])
    return kinds


def position_limits(model: Any, columns: tuple[int, ...], size: int) -> tuple[list[float], list[float]]:
    """Return the ranges of the joints with one axis, by the entry of the state; infinite for all other entries."""
    lower, upper = [-float("inf")] * size, [float("inf")] * size
    one_axis = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
    for joint in range(model.njnt):
        if model.jnt_limited[joint] and mujoco.mjtJoint(model.jnt_type[joint]) in one_axis:
            entry = columns[int(model.jnt_qposadr[joint])]
            lower[entry], upper[entry] = (float(end) for end in model.jnt_range[joint])
    return lower, upper
