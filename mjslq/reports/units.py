"""Units of the states and controls of a compiled MuJoCo model, for tables and plots."""

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
