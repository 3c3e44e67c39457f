"""The engine of a task: its model found, frames and distances that the task names added as sensors.

model = "arm.xml"               a file beside the task
model = "panda"                 a robot of example-robot-data (`mjslq.robots`)
model = "menagerie:unitree_g1"  a robot of the package mujoco-menagerie, which downloads it on first use;
"menagerie:unitree_g1/scene" for one of its files
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from mjslq.clips import following
from mjslq.dynamics.records import frame_sensor
from mjslq.tasks.clips import Clips, tracked
from mjslq.tasks.reading import Source, TaskError
from mjslq.tasks.schema import ClipCost, DistanceConstraint, Engine, FrameConstraint, FrameCost, TaskFile
from mjslq.validation import choose

if TYPE_CHECKING:
    import mujoco

    from mjslq.dynamics.mujoco import MujocoDynamics
    from mjslq.dynamics.pinocchio import PinocchioDynamics

MENAGERIE = "menagerie:"
_FILES = (".xml", ".urdf", ".mjb")
_ONLY = {
    "mujoco": ("substeps", "jacobian", "threads", "contact", "foresight", "floor", "self_contacts"),
    "pinocchio": ("locked_joints",),
}
"""Keys of [engine] that one engine alone has."""
_PINOCCHIO = {"position": "", "orientation": ".orientation"}
"""What Pinocchio's engine calls the outputs of a frame."""


def distance_sensor(first: str, second: str) -> str:
    """Name of the sensor that reads the distance of two geoms or bodies."""
    return f"{first} to {second}"


def make(
    task: TaskFile, folder: Path, source: Source, clips: Clips = MappingProxyType({})
) -> MujocoDynamics | PinocchioDynamics:
    """Make the engine of a task file in `folder`, whose clips are read. Raises `TaskError`."""
    engine = task.engine
    for kind, keys in _ONLY.items():
        for key in keys:
            if kind != engine.kind and getattr(engine, key) is not None:
                raise TaskError(source.sentence(("engine", key), f"is for kind = {kind!r}, not {engine.kind!r}"))
    with source.at("model"):
        file = file_of(task.model, folder)
    if engine.kind == "pinocchio":
        return _pinocchio(task, file, clips, source)
    return _mujoco(task, file, folder, clips, source)


def names_a_file(model: str) -> bool:
    """Whether `model` is a path, and not a robot's name."""
    is_path = Path(model).suffix.lower() in _FILES or "/" in model or "\\" in model
    return is_path and not model.startswith(MENAGERIE)


def file_of(model: str, folder: Path) -> Path:
    """The file that `model` names."""
    if model.startswith(MENAGERIE):
        return _menagerie(model.removeprefix(MENAGERIE))
    if names_a_file(model):
        file = Path(model).expanduser()
        return file if file.is_absolute() else folder / file
    from mjslq.robots import robot_path

    return robot_path(model)


def _menagerie(name: str) -> Path:
    """The file of a robot of MuJoCo Menagerie, NAME or NAME/ENTRY, downloaded on first use."""
    try:
        import mujoco_menagerie
    except ImportError:
        raise ValueError(
            "robots of MuJoCo Menagerie need the package mujoco-menagerie: pip install 'mjslq[menagerie]'"
        ) from None
    name, _, entry = name.partition("/")
    robot = mujoco_menagerie.get(choose("robot of MuJoCo Menagerie", name, mujoco_menagerie.names()))
    if entry:
        choose(f"file of {name}", entry, robot.entry_names)
    try:
        return Path(robot.xml(entry or None))
    except (mujoco_menagerie.MenagerieError, OSError) as error:
        raise ValueError(f"{name!r} could not be fetched: {' '.join(str(error).split())}") from None


def _mujoco(
    task: TaskFile, file: Path, folder: Path, clips: Clips, source: Source
) -> MujocoDynamics | PinocchioDynamics:
    import mujoco

    from mjslq.dynamics.mujoco import MujocoDynamics
    from mjslq.dynamics.mujoco.frames import add_frame_sensor

    engine = task.engine
    names = ("timestep", "substeps", "integrator", "jacobian", "threads", "parameters", "contact", "foresight")
    options = {name: value for name in names if (value := getattr(engine, name)) is not None}
    options["name"] = file.stem
    with source.at("model"):
        spec = _spec(engine, file, folder, source)
    if isinstance(spec, mujoco.MjModel):
        _refuse_frames(task, clips, source)
        with source.at("engine"):
            return MujocoDynamics.from_model(spec, **options)
    for place, _, frame, of in _frames(task, clips, source):
        with source.at(*place):
            add_frame_sensor(spec, frame, of)
    for i, constraint in enumerate(task.constraints):
        if isinstance(constraint, DistanceConstraint):
            with source.at("constraints", i, "between"):
                _add_distance(spec, constraint)
    with source.at("engine"):
        return MujocoDynamics.from_spec(spec, **options)


def _spec(engine: Engine, file: Path, folder: Path, source: Source) -> mujoco.MjSpec | mujoco.MjModel:
    """The model's specification; a binary file's model itself."""
    from mjslq.dynamics.mujoco.files import existing_file, load_model, load_spec, urdf_spec

    for key in ("floating", "floor", "armature", "packages", "self_contacts"):
        if file.suffix.lower() != ".urdf" and getattr(engine, key) is not None:
            raise TaskError(source.sentence(("engine", key), f"is for URDF models; change {file.name} instead"))
    if file.suffix.lower() == ".mjb":
        return load_model(file)
    if file.suffix.lower() != ".urdf":
        return load_spec(existing_file(file))
    packages = [engine.packages] if isinstance(engine.packages, str) else engine.packages
    return urdf_spec(
        file,
        floating=bool(engine.floating),
        floor=bool(engine.floor),
        armature=engine.armature or 0.0,
        self_contacts=engine.self_contacts is not False,
        packages=None if packages is None else [folder / package for package in packages],
        silent=engine.packages is None and file.parent != folder,
    )


def _pinocchio(task: TaskFile, file: Path, clips: Clips, source: Source) -> MujocoDynamics | PinocchioDynamics:
    from mjslq.dynamics.pinocchio import PinocchioDynamics

    engine, outputs = task.engine, []
    for place, key, frame, of in _frames(task, clips, source):
        with source.at(*place, key):
            choose("output of a frame of Pinocchio", of, _PINOCCHIO)
        outputs.append(frame + _PINOCCHIO[of])
    for i, constraint in enumerate(task.constraints):
        if isinstance(constraint, DistanceConstraint):
            raise TaskError(source.sentence(("constraints", i), "distances need kind = 'mujoco' in [engine]"))
    if engine.parameters is not None:
        raise TaskError(source.sentence(("engine", "parameters"), "needs kind = 'mujoco' in [engine]"))
    if engine.timestep is None:
        raise TaskError(source.sentence(("engine", "timestep"), "is missing; a URDF has no timestep of its own"))
    options: dict[str, Any] = {"floating_base": bool(engine.floating), "packages": engine.packages}
    options |= {key: value for key in ("integrator", "armature") if (value := getattr(engine, key)) is not None}
    with source.at("engine"):
        return PinocchioDynamics.from_path(
            file, engine.timestep, engine.locked_joints, tuple(dict.fromkeys(outputs)), **options
        )


def _frames(task: TaskFile, clips: Clips, source: Source) -> Iterator[tuple[tuple[str | int, ...], str, str, str]]:
    """Where the task names frames, the key that says what to read of them, the frame, and that. Raises `TaskError`."""
    for i, cost in enumerate(task.costs):
        if isinstance(cost, FrameCost):
            yield ("costs", i), "of", cost.name, cost.of
        elif isinstance(cost, ClipCost):
            with source.at("costs", i):
                wanted = following.tracked(tracked(cost, clips), cost.weights)
            yield from ((("costs", i), "weights", frame, of) for frame, of, _ in wanted)
    for i, constraint in enumerate(task.constraints):
        if isinstance(constraint, FrameConstraint):
            yield ("constraints", i), "of", constraint.frame, constraint.of


def _frame_of(wanted: FrameCost | FrameConstraint) -> str:
    return wanted.name if isinstance(wanted, FrameCost) else wanted.frame


def output_of(task: TaskFile, wanted: FrameCost | FrameConstraint) -> str:
    """Name of the engine's output that reads a frame."""
    if task.engine.kind == "pinocchio":
        return _frame_of(wanted) + _PINOCCHIO[wanted.of]
    return frame_sensor(_frame_of(wanted), wanted.of)


def _refuse_frames(task: TaskFile, clips: Clips, source: Source) -> None:
    """Refuse frames and distances of binary models, to which no sensor can be added."""
    for place, _, _, _ in _frames(task, clips, source):
        raise TaskError(
            source.sentence(place, f"{task.model} is binary, so that it takes no further sensors; name one")
        )
    for i, constraint in enumerate(task.constraints):
        if isinstance(constraint, DistanceConstraint):
            raise TaskError(source.sentence(("constraints", i), f"{task.model} is binary and takes no further sensors"))


def _add_distance(spec: mujoco.MjSpec, constraint: DistanceConstraint) -> None:
    """Add a sensor that reads the distance of two geoms or bodies, unless it is there."""
    import mujoco

    name = distance_sensor(*constraint.between)
    if spec.sensor(name) is not None:
        return
    geoms, bodies = ([one.name for one in kind if one.name] for kind in (spec.geoms, spec.bodies))
    ends = []
    for given in constraint.between:
        choose("geom or body", given, dict.fromkeys([*geoms, *bodies]))
        ends.append((mujoco.mjtObj.mjOBJ_GEOM if given in geoms else mujoco.mjtObj.mjOBJ_BODY, given))
    (kind, first), (other, second) = ends
    spec.add_sensor(
        name=name, type=mujoco.mjtSensor.mjSENS_GEOMDIST, cutoff=constraint.within,
        objtype=kind, objname=first, reftype=other, refname=second,
    )  # fmt: skip
