"""Frames of MuJoCo models, bodies, sites, geoms and cameras: sensors that read them, and where states have them.

    position, orientation              of the frame in the world; quaternions (w, x, y, z)
    linear-velocity, angular-velocity  of the frame's origin and of the frame, in the world's axes

A name is looked up among the sites first, then bodies (their frames, not their centres of mass), geoms and cameras.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.records import QUANTITIES, frame_sensor
from mjslq.validation import Array, choose

Wanted = Iterable[str] | Mapping[str, Sequence[str]] | Mapping[str, Mapping[str, Any]] | None
"""Frames to add sensors for: names, or a clip's frames, all four quantities of each; or quantities by name."""
_SENSORS = {
    "position": mujoco.mjtSensor.mjSENS_FRAMEPOS,
    "orientation": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
    "linear-velocity": mujoco.mjtSensor.mjSENS_FRAMELINVEL,
    "angular-velocity": mujoco.mjtSensor.mjSENS_FRAMEANGVEL,
}
_OBJECTS = (
    mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_CAMERA,
)  # fmt: skip


def add_frames(spec: mujoco.MjSpec, wanted: Wanted) -> None:
    """Add the sensors of frames to a specification. Raises ValueError, which lists the names there are."""
    if wanted is None:
        return
    if isinstance(wanted, str):
        raise ValueError(f"frames must be a list of names, got the text {wanted!r}; write [{wanted!r}]")
    for frame in wanted:
        of = wanted[frame] if isinstance(wanted, Mapping) else QUANTITIES
        if isinstance(of, Mapping):  # of a clip, which has velocities whether or not they were recorded
            of = QUANTITIES
        for quantity in [of] if isinstance(of, str) else of:
            add_frame_sensor(spec, frame, choose(f"quantity of frame {frame!r}", quantity, QUANTITIES))


def add_frame_sensor(spec: mujoco.MjSpec, frame: str, of: str) -> None:
    """Add a sensor that reads a frame, called "frame.of", unless it is there. Raises ValueError."""
    name = frame_sensor(frame, of)
    if spec.sensor(name) is not None:
        return
    objects = {
        mujoco.mjtObj.mjOBJ_SITE: [site.name for site in spec.sites],
        mujoco.mjtObj.mjOBJ_XBODY: [body.name for body in spec.bodies if body.name != "world"],
        mujoco.mjtObj.mjOBJ_GEOM: [geom.name for geom in spec.geoms],
        mujoco.mjtObj.mjOBJ_CAMERA: [camera.name for camera in spec.cameras],
    }
    choose("site, body, geom or camera", frame, dict.fromkeys(n for names in objects.values() for n in names if n))
    kind = next(kind for kind, names in objects.items() if frame in names)
    spec.add_sensor(name=name, type=_SENSORS[of], objtype=kind, objname=frame)


def frame_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the frames of a model."""
    counts = (model.nsite, model.nbody, model.ngeom, model.ncam)
    found = [
        mujoco.mj_id2name(model, kind, i)
        for kind, number in zip(_OBJECTS, counts, strict=True)
        for i in range(1 if kind == mujoco.mjtObj.mjOBJ_XBODY else 0, number)
    ]
    return tuple(dict.fromkeys(name for name in found if name))


def frame_output(model: mujoco.MjModel, frame: str, of: str) -> str:
    """Name of the sensor that reads a frame, whatever it is called. Raises ValueError."""
    kind, index = _object(model, frame)
    for s in range(model.nsensor):
        reads = (model.sensor_type[s], model.sensor_objtype[s], model.sensor_objid[s], model.sensor_refid[s])
        if reads == (_SENSORS[of], kind, index, -1) and not model.sensor_cutoff[s]:
            return model.sensor(s).name or f"sensor{s}"
    raise ValueError(
        f"no sensor reads the {of} of {frame!r}; make the engine with frames=[{frame!r}, ...] (from_path, from_xml, "
        f"from_spec), or add one to the model"
    )


def frame_motion(model: mujoco.MjModel, X: Array, frames: Sequence[str]) -> dict[str, dict[str, Array]]:
    """The four quantities of frames at the states X (k, nx), by frame and quantity. Shapes (k, 3), (k, 4).

    Raises ValueError, which lists the names there are.
    """
    places = {frame: _object(model, frame) for frame in frames}
    sizes = dict(zip(QUANTITIES, (3, 4, 3, 3), strict=True))
    found: dict[str, dict[str, Array]] = {
        frame: {of: np.empty((len(X), size)) for of, size in sizes.items()} for frame in frames
    }
    data, velocity = mujoco.MjData(model), np.empty(6)
    for n, x in enumerate(X):
        data.qpos, data.qvel = x[: model.nq], x[model.nq : model.nq + model.nv]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        for frame, (kind, index) in places.items():
            of = found[frame]
            of["position"][n], of["orientation"][n] = _pose(data, kind, index)
            mujoco.mj_objectVelocity(model, data, kind, index, velocity, 0)
            of["angular-velocity"][n], of["linear-velocity"][n] = velocity[:3], velocity[3:]
    return found


def _object(model: mujoco.MjModel, frame: str) -> tuple[Any, int]:
    """Kind and index of a frame."""
    choose("site, body, geom or camera", frame, frame_names(model))
    return next((kind, i) for kind in _OBJECTS if (i := mujoco.mj_name2id(model, kind, frame)) >= 0)


def _pose(data: mujoco.MjData, kind: Any, index: int) -> tuple[Array, Array]:
    """Position and quaternion of a frame."""
    if kind == mujoco.mjtObj.mjOBJ_XBODY:
        return data.xpos[index], data.xquat[index]
    prefix = {_OBJECTS[0]: "site", _OBJECTS[2]: "geom", _OBJECTS[3]: "cam"}[kind]
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, getattr(data, f"{prefix}_xmat")[index].ravel())
    return getattr(data, f"{prefix}_xpos")[index], quaternion
