"""Reading models: MJCF and URDF text, MuJoCo's binary files, and what a URDF needs before MuJoCo can use it.

MuJoCo compiles URDF, with gaps that are closed here before it sees the text:

    package://name/...   is looked up in the folders above the file (ROS is not asked);
    meshes               that MuJoCo cannot read (it has no Collada decoder) are left out: a visual one costs looks,
                         a collision one its contacts;
    inertias             come from <inertial> alone: links without one weigh nothing (MuJoCo asks for a little, so
                         1e-12 kg), and tensors that are not positive definite are raised to 1e-12 kg m^2;
    the base             is fixed to the world, as the format has it, or floats on a free joint;
    actuators            are added: URDF has none. Each joint with one axis gets a motor of its own name, gear 1,
                         whose control is the joint's torque [Nm] or force [N], with the joint's effort limit as
                         control range. Joints that mimic another one get none: MuJoCo ties them by an equality.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.checks import refuse_callbacks
from mjslq.dynamics.mujoco.library import quiet

Made = TypeVar("Made")
_LEAST_INERTIA = 1e-12
_COMPILER = {
    "strippath": "false", "fusestatic": "false", "discardvisual": "false", "balanceinertia": "true",
    "boundmass": str(_LEAST_INERTIA), "boundinertia": str(_LEAST_INERTIA),
}  # fmt: skip
_TENSOR = ((0, 0, "ixx"), (1, 1, "iyy"), (2, 2, "izz"), (0, 1, "ixy"), (0, 2, "ixz"), (1, 2, "iyz"))


def load_model(path: str | Path) -> mujoco.MjModel:
    """Compile the model file `path` (.xml, .urdf, .mjb).

    Raises ValueError, in one sentence, when there is no such file or MuJoCo cannot make a model of it.
    """
    file = existing_file(path)
    if file.suffix.lower() == ".mjb":
        return _explained(file, lambda: mujoco.MjModel.from_binary_path(str(file)))
    return compiled(load_spec(file), file)


def load_spec(path: str | Path) -> mujoco.MjSpec:
    """Read the MJCF or URDF file `path` into a specification that can still be edited; errors as `load_model`."""
    file = existing_file(path)
    root = _xml_root(file)
    if root.tag == "robot":
        return urdf_spec(file)
    return _explained(file, lambda: mujoco.MjSpec.from_file(str(file)))


def model_of_text(text: str) -> mujoco.MjModel:
    """Compile MJCF text; errors as `load_model`."""
    return compiled(_explained("the XML text", lambda: mujoco.MjSpec.from_string(text)), "the XML text")


def compiled(spec: mujoco.MjSpec, source: object = "the model") -> mujoco.MjModel:
    """Compile `spec`; raises ValueError in one sentence that names `source`."""
    return _explained(source, spec.compile)


def existing_file(path: str | Path) -> Path:
    """Return `path` as an absolute path of an existing file, or raise ValueError."""
    file = Path(path).expanduser()
    if not file.is_file():
        kind = "is a folder" if file.is_dir() else "does not exist"
        raise ValueError(f"model file {str(path)!r} {kind}; give the path of an .xml, .urdf or .mjb file")
    return file.resolve()


def urdf_spec(
    path: str | Path, *, floating: bool = False, motors: bool = True, floor: bool = False, armature: float = 0.0
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
    _resolve_meshes(root, file)
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
    if floor:
        _add_floor(spec)
    return spec


def _explained(source: object, make: Callable[[], Made]) -> Made:
    """Call `make`; turn MuJoCo's complaint into one sentence."""
    name = source.name if isinstance(source, Path) else source
    refuse_callbacks()  # compiling runs them
    try:
        with quiet():
            return make()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split()).removeprefix("Error: ").removeprefix("XML Error: ")
        raise ValueError(f"MuJoCo cannot make a model of {name}: {reason or 'no reason given'}") from None


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


def _resolve_meshes(root: ElementTree.Element, file: Path) -> None:
    """Make mesh paths absolute, and drop what MuJoCo cannot read or what is not there."""
    for link in root.iter("link"):
        for element in link.findall("visual") + link.findall("collision"):
            element.attrib.pop("name", None)  # often given twice, which MuJoCo complains of
            mesh = element.find("geometry/mesh")
            if mesh is None:
                continue
            found = _mesh_file(mesh.get("filename", ""), file)
            if found is None or not _is_readable(found):
                link.remove(element)
            else:
                mesh.set("filename", str(found))


def _mesh_file(name: str, file: Path) -> Path | None:
    """Where a mesh lies: beside the URDF, or in the package named in its address."""
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        above = file.parents
        places = [a / rest for a in above if a.name == package] + [a / package / rest for a in above]
    else:
        places = [file.parent / name.removeprefix("file://")]
    return next((place for place in places if place.is_file()), None)


def _is_readable(mesh: Path) -> bool:
    """Whether MuJoCo can decode a mesh file: OBJ, MSH and binary STL, whose length follows from its head."""
    if mesh.suffix.lower() != ".stl":
        return mesh.suffix.lower() in (".obj", ".msh")
    with mesh.open("rb") as stream:
        head = stream.read(84)
    return len(head) == 84 and mesh.stat().st_size == 84 + 50 * struct.unpack("<I", head[80:])[0]


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
