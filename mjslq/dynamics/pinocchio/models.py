"""Pinocchio models of URDF files, with joints locked, and the same robot for a viewer.

Continuous joints are read as plain angles, as MuJoCo has them, and not as a cosine and a sine.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from mjslq.dynamics.locked_joints import LockedJoints, lock_spec, locked_positions
from mjslq.scene import Scene
from mjslq.validation import Array, as_array, choose

ROOT = "root"
"""Name of a floating base's joint, here and in MuJoCo."""

_POSITIONS = {
    "JointModelFreeFlyer": (".x", ".y", ".z", ".qx", ".qy", ".qz", ".qw"),
    "JointModelSpherical": (".qx", ".qy", ".qz", ".qw"),
}
_VELOCITIES = {
    "JointModelFreeFlyer": (".vx", ".vy", ".vz", ".wx", ".wy", ".wz"),
    "JointModelSpherical": (".wx", ".wy", ".wz"),
}


def load_urdf(path: str | Path, floating_base: bool) -> Any:
    """Read a URDF file; raises ValueError in one sentence when there is none, or Pinocchio cannot read it."""
    file, root = read_urdf(path)
    _turn_continuous(root)
    text = ElementTree.tostring(root, encoding="unicode")
    base = (pin.JointModelFreeFlyer(), ROOT) if floating_base else ()
    try:
        return pin.buildModelFromXML(text, *base)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"Pinocchio cannot make a model of {file.name}: {reason}") from None


def read_urdf(path: str | Path) -> tuple[Path, ElementTree.Element]:
    """A URDF file, and its outermost element."""
    file = Path(path).expanduser()
    if not file.is_file():
        kind = "is a folder" if file.is_dir() else "does not exist"
        raise ValueError(f"model file {str(path)!r} {kind}; give the path of a .urdf file")
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise ValueError(f"Pinocchio cannot make a model of {file.name}: it is no valid XML ({error})") from None
    if root.tag != "robot":
        raise ValueError(f"{file.name} is no URDF file: its outermost element is <{root.tag}>, not <robot>")
    return file, root


def lock(model: Any, joints: LockedJoints | None) -> Any:
    """Return `model` with joints fixed at zero, or at the positions given; ValueError lists the joints there are."""
    positions = locked_positions(joints)
    if not positions:
        return model.copy()
    q, indices = pin.neutral(model), []
    for name, position in positions.items():
        index = model.getJointId(choose("joint to lock", name, list(model.names)[1:]))
        if position and (model.nqs[index], model.nvs[index]) != (1, 1):
            raise ValueError(f"joint {name!r} can be locked only as it is: it has more than one axis")
        if position:
            q[model.idx_qs[index]] = position
        indices.append(index)
    return pin.buildReducedModel(model, indices, q)


def per_joint(model: Any, name: str, value: float | Mapping[str, float] | None, current: Array) -> Array:
    """One number a dof: `value` at all joints with one axis, or at those named; `current` elsewhere. Shape (nv,)."""
    numbers = np.array(current, dtype=np.float64)
    single = {model.names[j]: model.idx_vs[j] for j in range(1, model.njoints) if model.nvs[j] == 1}
    given = value if isinstance(value, Mapping) else dict.fromkeys(single if value is not None else (), value)
    for joint, number in given.items():
        i = single[choose(f"joint in {name}", joint, single)]
        numbers[i] = as_array(name, number, ())  # type: ignore[arg-type]  # no None gets here
        if numbers[i] < 0.0:
            raise ValueError(f"{name} of joint {joint!r} must not be negative, got {number}")
    return numbers


def actuated_dofs(model: Any, joints: Sequence[str] | None) -> tuple[Array, tuple[str, ...]]:
    """Velocities that the controls act on, and their names: those of `joints`, or all but a floating base's."""
    if joints is None:
        free = model.njoints > 1 and model.joints[1].shortname() == "JointModelFreeFlyer"
        indices = list(range(2 if free else 1, model.njoints))
    else:
        indices = [model.getJointId(choose("joint to actuate", name, list(model.names)[1:])) for name in joints]
    dofs: list[int] = []
    names: list[str] = []
    for j in indices:
        dofs += range(model.idx_vs[j], model.idx_vs[j] + model.nvs[j])
        names += [model.names[j]] if model.nvs[j] == 1 else [f"{model.names[j]}[{i}]" for i in range(model.nvs[j])]
    if len(set(dofs)) < len(dofs):
        raise ValueError("actuated must name each joint once")
    return np.array(dofs, dtype=np.int64), tuple(names)


def effort_limits(model: Any, dofs: Array) -> Array:
    """Least and largest torque or force on each of `dofs`, by the file's efforts. Shape (nu, 2).

    -inf and inf where the file gives none, or zero, which URDF files write for "unknown".
    """
    limits = np.stack([model.lowerEffortLimit, model.upperEffortLimit], axis=-1)[dofs]
    given = (limits[:, 0] < limits[:, 1]) & (np.abs(limits) < 1e300).all(axis=1)
    return np.where(given[:, None], limits, [-np.inf, np.inf])


def state_names(model: Any) -> tuple[str, ...]:
    """Names of x: positions "elbow", "root.qx"; velocities "elbow.vel", "root.wx"."""
    positions: list[str] = []
    velocities: list[str] = []
    for j in range(1, model.njoints):
        name, kind = model.names[j], model.joints[j].shortname()
        positions += _endings(name, _POSITIONS.get(kind), "", model.nqs[j])
        velocities += _endings(name, _VELOCITIES.get(kind), ".vel", model.nvs[j])
    return (*positions, *velocities)


def joint_ranges(model: Any) -> dict[str, tuple[float, float]]:
    """Ranges of the joints with one axis that have one."""
    found = {}
    for j in range(1, model.njoints):
        if model.nqs[j] == model.nvs[j] == 1:
            lower, upper = (
                float(side[model.idx_qs[j]]) for side in (model.lowerPositionLimit, model.upperPositionLimit)
            )
            if lower < upper and max(abs(lower), abs(upper)) < 1e300:
                found[model.names[j]] = (lower, upper)
    return found


def refuse_massless(model: Any) -> None:
    """Raise ValueError when a joint moves no mass, which has no acceleration."""
    inertia = np.diagonal(pin.crba(model, model.createData(), pin.neutral(model)))
    for j in range(1, model.njoints):
        if not (inertia[model.idx_vs[j] : model.idx_vs[j] + model.nvs[j]] > 0.0).all():
            moved = {int(i) for i in model.subtrees[j]}
            links = [f.name for f in model.frames if f.type == pin.FrameType.BODY and int(f.parentJoint) in moved]
            named = f" (links without inertia: {', '.join(links)})" if links else ""
            raise ValueError(f"joint {model.names[j]!r} moves no mass{named}; lock it, or give it armature")


def viewer_scene(
    path: Path,
    model: Any,
    floating_base: bool,
    locked: dict[str, float],
    name: str,
    packages: Any = None,
    lines: Mapping[str, tuple[float, float]] | None = None,
) -> Scene | None:
    """The robot as MuJoCo reads it, its joints matched by name; None where MuJoCo cannot read the file.

    `lines` are multiplier and offset of joints that mimic others, whose entries of q they share.
    Meshes that are left out are not warned of: nothing hangs on them here but looks.
    """
    import mujoco

    from mjslq.dynamics.mujoco.files import compiled, urdf_spec

    try:
        spec = urdf_spec(path, floating=floating_base, motors=False, packages=packages, silent=True)
        lock_spec(spec, locked)
        drawn = compiled(spec, path)
    except ValueError:
        return None
    columns: list[int] = []
    placed: list[tuple[float, float]] = []
    for j in range(drawn.njnt):
        joint = drawn.joint(j).name
        if not model.existJointName(joint):
            return None
        start = int(model.idx_qs[model.getJointId(joint)])
        order = (0, 1, 2, 6, 3, 4, 5) if drawn.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE else (0,)
        columns += [start + i for i in order]
        placed += [(lines or {}).get(joint, (1.0, 0.0))] * len(order)
    data = np.empty(mujoco.mj_sizeModel(drawn), np.uint8)
    mujoco.mj_saveModel(drawn, None, data)
    return Scene(data.tobytes(), tuple(columns), name, tuple(placed) if lines else ())


def _turn_continuous(root: ElementTree.Element) -> None:
    for joint in root.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit", {"effort": "0", "velocity": "0"})
            limit.attrib.update(lower="-1e10", upper="1e10")


def _endings(name: str, endings: tuple[str, ...] | None, single: str, size: int) -> list[str]:
    if endings is not None:
        return [name + ending for ending in endings]
    return [name + single] if size == 1 else [f"{name}{single}[{i}]" for i in range(size)]
