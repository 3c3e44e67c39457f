"""Reading models: MJCF and URDF text, MuJoCo's binary files, and what a URDF needs before MuJoCo can use it.

MuJoCo compiles URDF, with gaps that are closed here before it sees the text:

    meshes               are found, or left out with a warning: see `meshes`;
    inertias             come from <inertial> alone: links without one weigh nothing (MuJoCo asks for a little, so
                         1e-12 kg), and tensors that are not positive definite are raised to 1e-12 kg m^2;
                         a joint that moves nothing but such links is refused;
    the base             is fixed to the world, as the format has it, or floats on a free joint;
    actuators            are added: URDF has none. Each joint with one axis gets a motor of its own name, gear 1,
                         whose control is the joint's torque [Nm] or force [N], with the joint's effort limit as
                         control range. Joints that mimic another one get none: MuJoCo ties them by an equality.
"""

from __future__ import annotations

import struct
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.checks import refuse_callbacks
from mjslq.dynamics.mujoco.frames import Wanted, add_frames
from mjslq.dynamics.mujoco.library import quiet
from mjslq.dynamics.mujoco.meshes import Packages, resolve_meshes

Made = TypeVar("Made")
_LEAST_INERTIA = 1e-12
_COMPILER = {
    "strippath": "false", "fusestatic": "false", "discardvisual": "false", "balanceinertia": "true",
    "boundmass": str(_LEAST_INERTIA), "boundinertia": str(_LEAST_INERTIA),
}  # fmt: skip
_CONSTRUCTORS: dict[str, tuple[str, tuple[type, ...]]] = {
    "from_path": ("the path of an .xml, .urdf or .mjb file", (str, Path)),
    "from_xml": ("MJCF text", (str,)),
    "from_spec": ("an mujoco.MjSpec", (mujoco.MjSpec,)),
    "from_model": ("a compiled mujoco.MjModel", (mujoco.MjModel,)),
}
"""What the constructors of `MujocoDynamics` take, in words and as types."""
_MJB_MARK, _MJB_HEAD = 54321, struct.Struct("<4i")
"""First number of an MJB file, and its head: mark, size of numbers, count of sizes, version."""
_LEAST_MOVED = 1e-10
"""Inertia [kg m^2 or kg] below which a joint of a URDF moves nothing."""
_TENSOR = ((0, 0, "ixx"), (1, 1, "iyy"), (2, 2, "izz"), (0, 1, "ixy"), (0, 2, "ixz"), (1, 2, "iyz"))


def load_model(path: str | Path, packages: Packages = None, frames: Wanted = None) -> mujoco.MjModel:
    """Compile the model file `path` (.xml, .urdf, .mjb); `packages` as in `urdf_spec`, `frames` to add sensors for.

    Raises ValueError, in one sentence, when there is no such file or MuJoCo cannot make a model of it.
    """
    file = existing_file(path)
    if file.suffix.lower() == ".mjb":
        _refuse_other_version(file)
        if frames is not None:
            raise ValueError(f"{file.name} is binary, so that it takes no sensors for frames; give its .xml")
        return _explained(file, lambda: mujoco.MjModel.from_binary_path(str(file)))
    root = _xml_root(file)
    spec = load_spec(file, packages)
    add_frames(spec, frames)
    model = compiled(spec, file)
    if root.tag == "robot":
        _refuse_massless(model, root, file)
    return model


def load_spec(path: str | Path, packages: Packages = None) -> mujoco.MjSpec:
    """Read the MJCF or URDF file `path` into a specification that can still be edited; errors as `load_model`."""
    file = existing_file(path)
    root = _xml_root(file)
    if root.tag == "robot":
        return urdf_spec(file, packages=packages)
    return _explained(file, lambda: mujoco.MjSpec.from_file(str(file)))


def model_of_text(text: str, frames: Wanted = None) -> mujoco.MjModel:
    """Compile MJCF text; errors and `frames` as `load_model`."""
    check_kind("from_xml", text)
    spec = _explained("the XML text", lambda: mujoco.MjSpec.from_string(text))
    add_frames(spec, frames)
    return compiled(spec, "the XML text")


def compiled(spec: mujoco.MjSpec, source: object = "the model") -> mujoco.MjModel:
    """Compile `spec`; raises ValueError in one sentence that names `source`."""
    return _explained(source, spec.compile)


def check_kind(constructor: str, given: object) -> None:
    """Raise ValueError, which names the right constructor, when `given` is for another one."""
    takes, kinds = _CONSTRUCTORS[constructor]
    if isinstance(given, mujoco.MjModel):
        kind, right = "a compiled MjModel", "from_model"
    elif isinstance(given, mujoco.MjSpec):
        kind, right = "an MjSpec", "from_spec"
    elif isinstance(given, Path) or (isinstance(given, str) and "<" not in given):
        kind, right = f"the path {str(given)!r}", "from_path"
    elif isinstance(given, str):
        kind, right = "XML text", "from_xml"
    else:
        kind, right = type(given).__name__, ""
    if right != constructor or not isinstance(given, kinds):
        remedy = f"; use MujocoDynamics.{right}" if right else ""
        raise ValueError(f"{constructor} takes {takes}, got {kind}{remedy}")


def existing_file(path: str | Path) -> Path:
    """Return `path` as an absolute path of an existing file, or raise ValueError."""
    file = Path(path).expanduser()
    if not file.is_file():
        kind = "is a folder" if file.is_dir() else "does not exist"
        raise ValueError(f"model file {str(path)!r} {kind}; give the path of an .xml, .urdf or .mjb file")
    return file.resolve()


def urdf_spec(
    path: str | Path,
    *,
    floating: bool = False,
    motors: bool = True,
    floor: bool = False,
    armature: float = 0.0,
    packages: Packages = None,
    self_contacts: bool = True,
    silent: bool = False,
) -> mujoco.MjSpec:
    """Read a URDF file into a specification that can still be edited.

    Parameters
    ----------
    path
        The file.
    floating
        Give the root link a free joint, named "root", instead of fixing it to the world.
    motors
        Add a motor to every hinge and slide joint that does not mimic another one.
    floor
        Add a ground plane at height zero, and a light.
    armature
        Rotor inertia added to every hinge and slide joint. [kg m^2 or kg]  Small robots need some for stable steps.
    packages
        Where package://name/... is: a folder that holds packages or is one, several, or a mapping from names to
        folders. Folders above the file, ROS_PACKAGE_PATH and AMENT_PREFIX_PATH are looked through besides.
    self_contacts
        Let the robot's links touch each other. Links of URDF files often overlap where they are joined, which pushes
        them apart; without, they touch the floor and other objects alone.
    silent
        Do not warn of meshes that are left out.

    Returns
    -------
    mujoco.MjSpec
        Add sensors, keyframes and whatever else is wanted, then hand it to `MujocoDynamics.from_spec`.

    Raises
    ------
    ValueError
        When the file does not exist, is no URDF, or MuJoCo cannot read it.
    """
    file = existing_file(path)
    root = _xml_root(file)
    if root.tag != "robot":
        raise ValueError(f"{file.name} is no URDF file: its outermost element is <{root.tag}>, not <robot>")
    _set_compiler(root)
    resolve_meshes(root, file, packages, silent)
    _mend_inertias(root)
    text = ElementTree.tostring(root, encoding="unicode")
    spec = _explained(file, lambda: mujoco.MjSpec.from_string(text))
    _set_massless(spec)
    if floating:
        _set_afloat(spec, file)
    followers = {joint.get("name") for joint in root.findall("joint") if joint.find("mimic") is not None}
    for joint in spec.joints:
        if joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            joint.armature = armature
            if motors and joint.name not in followers:
                _add_motor(spec, joint)
    if not self_contacts:
        for geom in spec.geoms:
            geom.conaffinity = 0
    if floor:
        _add_floor(spec)
    return spec


def _explained(source: object, make: Callable[[], Made]) -> Made:
    """Call `make`; turn MuJoCo's complaint into one sentence."""
    name = source.name if isinstance(source, Path) else source
    refuse_callbacks()  # compiling runs them
    try:
        with quiet(), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            made = make()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split()).removeprefix("Error: ").removeprefix("XML Error: ")
        raise ValueError(f"MuJoCo cannot make a model of {name}: {reason or 'no reason given'}") from None
    for warning in said:
        text = " ".join(str(warning.message).split()).removeprefix("WARNING: ").removeprefix("Warning: ")
        warnings.warn(f"MuJoCo on {name}: {text}", stacklevel=3)
    return made


def _refuse_other_version(file: Path) -> None:
    """Raise ValueError, which names both versions, for a binary model of another MuJoCo."""
    with file.open("rb") as stream:
        head = stream.read(_MJB_HEAD.size)
    if len(head) < _MJB_HEAD.size or _MJB_HEAD.unpack(head)[0] != _MJB_MARK:
        raise ValueError(f"MuJoCo cannot make a model of {file.name}: it is no binary model (.mjb)")
    theirs, ours = _MJB_HEAD.unpack(head)[3], mujoco.mj_version()
    if theirs != ours:
        raise ValueError(
            f"{file.name} was written by MuJoCo {_version(theirs)} and MuJoCo {_version(ours)} is installed, which "
            f"reads only its own .mjb files; save it anew from the .xml"
        )


def _version(number: int) -> str:
    """What an mjVERSION_HEADER stands for: 4000000 is 4.0.0, and before that 332 was 3.3.2."""
    parts = (number // 10**6, number // 1000 % 1000, number % 1000)
    if number < 10**6:
        parts = (number // 100, number // 10 % 10, number % 10)
    return ".".join(map(str, parts))


def _refuse_massless(model: mujoco.MjModel, root: ElementTree.Element, file: Path) -> None:
    """Raise ValueError for a joint that moves no mass, which has no acceleration, and name the links that lack some."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_crb(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    for j in np.flatnonzero(np.diagonal(M) < _LEAST_MOVED):
        joint = model.joint(int(model.dof_jntid[j]))
        bare = [link.get("name", "") for link in root.iter("link") if link.find("inertial") is None]
        moved = [name for name in bare if name and _carries(model, int(joint.bodyid[0]), name)]
        links = f" (without <inertial>: {', '.join(moved)})" if moved else ""
        raise ValueError(
            f"{file.name}: joint {joint.name!r} moves no mass{links}; give its link an <inertial>, make the joint "
            f"fixed, or give it armature by mjslq.dynamics.mujoco.files.urdf_spec(path, armature=)"
        )


def _carries(model: mujoco.MjModel, body: int, name: str) -> bool:
    """Whether the body `name` is `body` or hangs on it."""
    at = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    while at > 0 and at != body:
        at = int(model.body_parentid[at])
    return at == body


def _xml_root(file: Path) -> ElementTree.Element:
    try:
        return ElementTree.parse(file).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"MuJoCo cannot make a model of {file.name}: it is no valid XML ({error})") from None
    except UnicodeDecodeError:
        raise ValueError(f"MuJoCo cannot make a model of {file.name}: it is no text file") from None


def _set_compiler(root: ElementTree.Element) -> None:
    """Compiler settings that real robots need; those the file brings along stay."""
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    for name, value in _COMPILER.items():
        compiler.attrib.setdefault(name, value)


def _mend_inertias(root: ElementTree.Element) -> None:
    """Raise the eigenvalues of inertia tensors to `_LEAST_INERTIA`, and forget about the inertia of no mass."""
    for link in root.iter("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        mass, tensor = inertial.find("mass"), inertial.find("inertia")
        if mass is None or tensor is None or float(mass.get("value", 0.0)) <= 0.0:
            link.remove(inertial)
            continue
        I = np.zeros((3, 3))  # noqa: E741
        for i, j, name in _TENSOR:
            I[i, j] = I[j, i] = float(tensor.get(name, 0.0))
        values, axes = np.linalg.eigh(I)
        if values[0] < _LEAST_INERTIA:
            I = (axes * np.maximum(values, _LEAST_INERTIA)) @ axes.T  # noqa: E741
            for i, j, name in _TENSOR:
                tensor.set(name, repr(float(I[i, j])))


def _set_afloat(spec: mujoco.MjSpec, file: Path) -> None:
    """Give the root link a free joint."""
    base = spec.worldbody.first_body()
    if base is None or spec.worldbody.next_body(base) is not None:
        raise ValueError(f"{file.name} cannot float: its root link is the world, or is not a single one")
    if any(joint.parent == base for joint in spec.joints):
        raise ValueError(f"{file.name} cannot float: its root link is the world")
    base.add_freejoint(name="root")


def _set_massless(spec: mujoco.MjSpec) -> None:
    """Let no geom weigh anything: masses and inertias of a URDF are those of its <inertial> elements."""
    for geom in spec.geoms:
        geom.mass = 0.0
    for mesh in spec.meshes:
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # flat meshes have no volume


def _add_motor(spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
    """Let a control be the force or torque on `joint`, limited by its effort."""
    motor = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    lower, upper = joint.actfrcrange
    if lower < upper:
        motor.ctrlrange = [lower, upper]
        motor.ctrllimited = True
        joint.actfrclimited = False  # the same limit, where a solver can see it


def _add_floor(spec: mujoco.MjSpec) -> None:
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.add_texture(
        name="floor", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.82, 0.84, 0.87], rgb2=[0.74, 0.77, 0.81], width=256, height=256,
    )  # fmt: skip
    material = spec.add_material(name="floor", texrepeat=[1.0, 1.0], texuniform=True, reflectance=0.05)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(name="floor", type=plane, size=[0.0, 0.0, 0.05], material="floor")
    spec.worldbody.add_light(pos=[0.0, 0.0, 4.0], dir=[0.2, 0.3, -1.0], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
