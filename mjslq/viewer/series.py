"""The curves of a result, in groups that fit a plot: states, controls, outputs and costs, named, with units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.validation import Array
from mjslq.viewer.motion import finite_knots

PER_PLOT = 8
"""Curves in one plot at most."""

COLORS = ("#2f6fb3", "#d6592b", "#2b8f6d", "#b04a8c", "#c29a1c", "#5b5fc7", "#7a8794", "#8c5a3c")
"""One a curve, told apart by lightness too. Length `PER_PLOT`."""


@dataclass(frozen=True)
class Group:
    """Curves that share a unit and a plot."""

    title: str
    """What the choice is called, unit included."""
    kind: str
    """"states", "controls" or "outputs"."""
    columns: tuple[int, ...]
    """Columns of the trajectory's X, U or Y."""
    labels: tuple[str, ...]
    """Name of each column."""
    unit: str
    """Unit of all of them; empty when unknown."""


def groups(result: Result, kind: str, model: Any = None) -> list[Group]:
    """Return the plots of `kind` ("states", "controls" or "outputs"); `model` gives the units of its coordinates."""
    size = _array(result.trajectory, kind).shape[1]
    letter = {"states": "x", "controls": "u", "outputs": "y"}[kind]
    given = tuple(result.names.get(kind, ()))
    labels = given if len(given) == size else tuple(f"{letter}[{i}]" for i in range(size))
    if kind == "states" and model is not None and result.scene is not None:
        kinds = _state_kinds(model, result.scene.columns, size)
    elif kind == "controls" and model is not None and model.nu == size:
        kinds = _control_kinds(model)
    else:
        kinds = [(kind, "")] * size
    found = []
    for name, unit in dict.fromkeys(kinds):
        members = [i for i in range(size) if kinds[i] == (name, unit)]
        for start in range(0, len(members), PER_PLOT):
            columns = members[start : start + PER_PLOT]
            title = f"{name} [{unit}]" if unit else name
            if len(members) > PER_PLOT:
                title += f", {start + 1} to {start + len(columns)} of {len(members)}"
            found.append(Group(title, kind, tuple(columns), tuple(labels[i] for i in columns), unit))
    return found


def curves(trajectory: Trajectory, group: Group) -> tuple[Array, Array]:
    """Return times (n,) [s] and values (n, k) of a group, as far as they are finite.

    Controls are held over their step, so each is given at both its ends: n = 2 N.
    """
    good = max(finite_knots(trajectory), 1)
    values = _array(trajectory, group.kind)[:, list(group.columns)]
    if group.kind == "controls":
        steps = min(max(good - 1, 1), len(values))
        times = np.stack([trajectory.times[:steps], trajectory.times[1 : steps + 1]], axis=1).ravel()
        return times, np.repeat(values[:steps], 2, axis=0)
    finite = np.isfinite(values[:good]).all(axis=1)
    return trajectory.times[:good][finite], values[:good][finite]


def values_at(trajectory: Trajectory, group: Group, time: float) -> Array:
    """Return the values (k,) of a group at `time` [s]; NaN where the trajectory holds none."""
    times = trajectory.times
    values = _array(trajectory, group.kind)[:, list(group.columns)]
    if group.kind == "controls":
        step = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(values) - 1))
        return np.asarray(values[step])
    return np.array([np.interp(time, times, column) for column in values.T])


def value_range(values: Array, room: float = 0.08) -> tuple[float, float]:
    """Return limits for an axis that hold all finite `values` with some room; never empty."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    span = high - low
    if span <= 1e-9 * max(abs(low), abs(high), 1e-9):
        span = abs(low) or 1.0
    return low - room * span, high + room * span


def thinned(times: Array, values: Array, most: int) -> tuple[Array, Array]:
    """Return at most about `most` of the points, keeping the extremes of every stretch that is dropped."""
    if len(times) <= most:
        return times, values
    keep = {0, len(times) - 1}
    for stretch in np.array_split(np.arange(len(times)), max(most // (2 * values.shape[1]), 2)):
        keep.update(stretch[np.argmin(values[stretch], axis=0)])
        keep.update(stretch[np.argmax(values[stretch], axis=0)])
    index = np.array(sorted(keep))
    return times[index], values[index]


def costs(result: Result) -> tuple[Array, Array]:
    """Return iterations and costs of the log, where the cost is finite. Shapes (n,)."""
    entries = [(entry.iteration, entry.cost) for entry in result.log if np.isfinite(entry.cost)]
    return np.array([i for i, _ in entries], dtype=float), np.array([c for _, c in entries], dtype=float)


def _array(trajectory: Trajectory, kind: str) -> Array:
    return {"states": trajectory.X, "controls": trajectory.U, "outputs": trajectory.Y}[kind]


def _state_kinds(model: Any, columns: tuple[int, ...], size: int) -> list[tuple[str, str]]:
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


def _control_kinds(model: Any) -> list[tuple[str, str]]:
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
