"""Results as files: NumPy's npz, written whole or not at all, read without pickle.

    header        JSON: the format's version, the status, the log, all that is no array
    arrays        gains, lower, upper; trajectory_X, ..., iterates_X, ... (stacked; states between the knots only of
                  the trajectory); violations, multipliers and their knots, residuals, by name; costates; the
                  scene's model; the state's rotations

Files of another version are refused in one sentence.
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mjslq.contact import Contact
from mjslq.files import atomic_write
from mjslq.lie_groups import MOTION, ROTATION, SLIDE, TURN, Group
from mjslq.log import IterationLog
from mjslq.manifold import StateSpace
from mjslq.result import Result
from mjslq.scene import Scene
from mjslq.status import Status
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

FORMAT = 2
"""Version of the file format; files of another version are refused."""
PLAIN = (
    "message", "cost", "iterations", "gradient_norm", "constraint_violation", "seconds", "compile_seconds", "problem",
    "method", "options", "parameters", "names", "error", "cost_terms",
)  # fmt: skip
"""Fields that JSON holds as they are."""
NAMED = ("violations", "multipliers", "knots", "residuals")
"""Fields that are arrays by name."""
_DAMAGED = (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile, zlib.error, NotImplementedError)
"""What a foreign or damaged file makes the readers of zip, npy and JSON raise."""


_GROUPS: dict[str, Group] = {type(group).__name__: group for group in (ROTATION, MOTION, TURN, SLIDE)}


def save(result: Result, path: str | os.PathLike[str]) -> None:
    """Write `result` to `path`; see `Result.save`."""
    arrays: dict[str, Any] = {"lower": result.lower, "upper": result.upper}
    for name in ("gains", "gradient", "costates"):
        if getattr(result, name) is not None:
            arrays[name] = getattr(result, name)
    arrays |= _pack("trajectory", [result.trajectory])
    if result.trajectory.substates is not None:
        arrays["trajectory_substates"] = result.trajectory.substates[None]
    if result.iterates:
        arrays |= _pack("iterates", result.iterates)
    for kind in NAMED:
        arrays |= {f"{kind}/{name}": array for name, array in getattr(result, kind).items()}
    if result.scene is not None:
        arrays["scene_model"] = np.frombuffer(result.scene.model, dtype=np.uint8)
        arrays["scene_columns"] = np.array(result.scene.columns, dtype=np.int64)
        arrays["scene_lines"] = np.array(result.scene.lines, dtype=np.float64).reshape(-1, 2)
    if result.space is not None:
        arrays |= _pack_space(result.space)
    header = {name: getattr(result, name) for name in PLAIN} | {
        "format": FORMAT,
        "status": result.status.value,
        "log": [asdict(entry) for entry in result.log],
        "scene_name": None if result.scene is None else result.scene.name,
        "contact": None if result.contact is None else asdict(result.contact),
    }
    with atomic_write(path) as stream:
        np.savez_compressed(stream, header=np.array(json.dumps(header, default=_plain)), **arrays)


def load(path: str | os.PathLike[str]) -> Result:
    """Read what `save` wrote; see `mjslq.load`."""
    name = os.fspath(path)
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as data:
            header = json.loads(str(data["header"]))
            version = header["format"]
            arrays = {entry: data[entry] for entry in data.files}
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no file {name}") from None
    except _DAMAGED as error:
        why = " ".join(str(error).split()) if zipfile.is_zipfile(path) or os.path.isdir(path) else "it is no .npz file"
        raise ValueError(f"{name} is not a result saved by mjslq ({why})") from None
    if version != FORMAT:
        raise ValueError(
            f"{name} has format {version}, this version of mjslq reads format {FORMAT}; "
            + ("upgrade mjslq" if version > FORMAT else "solve the problem again")
        )
    try:
        return _result_of(header, arrays)
    except KeyError as error:
        raise ValueError(f"{name} is not a whole result of mjslq: {error} is missing") from None


def _result_of(header: dict[str, Any], arrays: dict[str, Array]) -> Result:
    scene = None
    if "scene_model" in arrays:
        columns = tuple(int(i) for i in arrays["scene_columns"])
        lines = tuple((float(m), float(o)) for m, o in arrays.get("scene_lines", np.zeros((0, 2))))
        scene = Scene(arrays["scene_model"].tobytes(), columns, header["scene_name"], lines)
    named: dict[str, Any] = {kind: {} for kind in NAMED}
    for entry, array in arrays.items():
        kind, slash, name = entry.partition("/")
        if slash and kind in named:
            named[kind][name] = array
    return Result(
        **{name: header[name] for name in PLAIN if name not in ("names", "cost_terms")},
        cost_terms=header.get("cost_terms", {}),
        **named,
        names={kind: tuple(entries) for kind, entries in header["names"].items()},
        status=Status(header["status"]),
        log=tuple(IterationLog(**entry) for entry in header["log"]),
        trajectory=_unpack("trajectory", arrays)[0],
        iterates=_unpack("iterates", arrays) if "iterates_X" in arrays else (),
        gains=arrays.get("gains"),
        gradient=arrays.get("gradient"),
        costates=arrays.get("costates"),
        lower=arrays["lower"],
        upper=arrays["upper"],
        space=_unpack_space(arrays),
        scene=scene,
        contact=Contact(**header["contact"]) if header.get("contact") else None,
    )


_PARTS = ("X", "U", "Y", "dt")


def _pack(name: str, trajectories: Sequence[Trajectory]) -> dict[str, Array]:
    packed = {f"{name}_{part}": np.stack([getattr(t, part) for t in trajectories]) for part in _PARTS}
    packed[f"{name}_diverged_at"] = np.array(
        [-1 if t.diverged_at is None else t.diverged_at for t in trajectories], dtype=np.int64
    )
    return packed


def _unpack(name: str, arrays: dict[str, Array]) -> tuple[Trajectory, ...]:
    stacked = [arrays[f"{name}_{part}"] for part in (*_PARTS, "diverged_at")]
    substates = arrays.get(f"{name}_substates", [None] * len(stacked[0]))
    return tuple(
        Trajectory(x, u, y, dt, None if at < 0 else int(at), between)
        for x, u, y, dt, at, between in zip(*stacked, substates, strict=True)
    )


def _pack_space(space: StateSpace) -> dict[str, Array]:
    packed: dict[str, Any] = {"space_size": np.array([space.nx, space.ndx])}
    for part in space.parts:
        name = type(part.group).__name__
        packed |= {f"space_x/{name}": part.x, f"space_dx/{name}": part.dx}
    return packed


def _unpack_space(arrays: dict[str, Array]) -> StateSpace | None:
    if "space_size" not in arrays:
        return None
    nx, ndx = (int(size) for size in arrays["space_size"])
    elements: list[tuple[Group, Any, Any]] = []
    for name, group in _GROUPS.items():
        if f"space_x/{name}" in arrays:
            rows = zip(arrays[f"space_x/{name}"].tolist(), arrays[f"space_dx/{name}"].tolist(), strict=True)
            elements += [(group, x, dx) for x, dx in rows]
    return StateSpace.of(nx, ndx, elements)


def _plain(value: Any) -> Any:
    """What JSON does not know: numpy's numbers and arrays; anything else by its text."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)
