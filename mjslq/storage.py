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
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mjslq.contact import Contact
from mjslq.files import atomic_write, read_arrays
from mjslq.lie_groups import MOTION, ROTATION, SLIDE, TURN, Group
from mjslq.log import IterationLog
from mjslq.manifold import StateSpace
from mjslq.result import Result
from mjslq.scene import Marker, Scene
from mjslq.status import Status
from mjslq.stored import checked
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, as_array, describe, gist

FORMAT = 2
"""Version of the file format; files of another version are refused."""
PLAIN = (
    "message", "cost", "iterations", "gradient_norm", "constraint_violation", "seconds", "compile_seconds", "problem",
    "method", "options", "parameters", "names", "error", "cost_terms",
    "unknowns",
)  # fmt: skip
"""Fields that JSON holds as they are."""
NAMED = ("violations", "multipliers", "knots", "residuals")
"""Fields that are arrays by name."""
_DAMAGED = (LookupError, ValueError, TypeError, AttributeError, ArithmeticError)
"""What parts of a file raise that do not fit together."""


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
        arrays |= pack_space(result.space)
    header = {name: getattr(result, name) for name in PLAIN} | {
        "format": FORMAT,
        "status": result.status.value,
        "log": [asdict(entry) for entry in result.log],
        "scene_name": None if result.scene is None else result.scene.name,
        "scene_markers": [] if result.scene is None else [asdict(marker) for marker in result.scene.markers],
        "contact": None if result.contact is None else asdict(result.contact),
    }
    with atomic_write(path) as stream:
        np.savez_compressed(stream, header=np.array(json.dumps(header, default=_plain)), **arrays)


def load(path: str | os.PathLike[str]) -> Result:
    """Read what `save` wrote; see `mjslq.load`."""
    name, arrays = os.fspath(path), read_arrays(path, "a result saved by mjslq")
    try:
        header = json.loads(str(arrays.pop("header")))
        version = header["format"]
    except (KeyError, TypeError, ValueError, RecursionError):
        raise ValueError(f"{name} is not a result saved by mjslq (it has no header that can be read)") from None
    if isinstance(version, bool) or not isinstance(version, int):
        raise ValueError(f"{name} is not a result saved by mjslq (its format is {describe(version)})")
    if version != FORMAT:
        raise ValueError(
            f"{name} has format {version}, this version of mjslq reads format {FORMAT}; "
            + ("upgrade mjslq" if version > FORMAT else "solve the problem again")
        )
    try:
        found = _fields_of(header, arrays)
    except KeyError as error:
        raise ValueError(f"{name} is not a whole result of mjslq: {error} is missing") from None
    except _DAMAGED as error:
        raise ValueError(f"{name} is not a whole result of mjslq: {gist(error)}") from None
    result = Result(**found)
    try:
        return checked(result)
    except ValueError as error:
        raise ValueError(f"{name} is not a whole result of mjslq: {error}") from None


def _fields_of(header: dict[str, Any], arrays: dict[str, Array]) -> dict[str, Any]:
    scene = None
    if "scene_model" in arrays:
        columns = tuple(_whole("scene_columns", arrays).tolist())
        lines = tuple((m, o) for m, o in as_array("scene_lines", arrays.get("scene_lines", np.zeros((0, 2)))).tolist())
        if arrays["scene_model"].dtype != np.uint8:
            raise ValueError(f"scene_model must be bytes, got {describe(arrays['scene_model'])}")
        markers = tuple(Marker(m["name"], tuple(m["position"])) for m in header.get("scene_markers", ()))
        scene = Scene(arrays["scene_model"].tobytes(), columns, header["scene_name"], lines, markers)
    named: dict[str, Any] = {kind: {} for kind in NAMED}
    for entry, array in arrays.items():
        kind, slash, name = entry.partition("/")
        if slash and kind in named:
            named[kind][name] = array
    return dict(
        **{name: header[name] for name in PLAIN if name not in ("names", "cost_terms", "unknowns")},
        cost_terms=header.get("cost_terms", {}),
        unknowns=header.get("unknowns", {}),
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
        space=unpack_space(arrays),
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
    stacked = [*(arrays[f"{name}_{part}"] for part in _PARTS), _whole(f"{name}_diverged_at", arrays)]
    substates = arrays.get(f"{name}_substates", [None] * len(stacked[0]))
    return tuple(
        Trajectory(x, u, y, dt, None if at < 0 else int(at), between)
        for x, u, y, dt, at, between in zip(*stacked, substates, strict=True)
    )


def pack_space(space: StateSpace) -> dict[str, Array]:
    """Where the rotations of a state are, as arrays by name."""
    packed: dict[str, Any] = {"space_size": np.array([space.nx, space.ndx])}
    for part in space.parts:
        name = type(part.group).__name__
        packed |= {f"space_x/{name}": part.x, f"space_dx/{name}": part.dx}
    return packed


def unpack_space(arrays: dict[str, Array]) -> StateSpace | None:
    """Read what `pack_space` wrote; None where it wrote nothing."""
    if "space_size" not in arrays:
        return None
    nx, ndx = _whole("space_size", arrays).tolist()
    elements: list[tuple[Group, Any, Any]] = []
    for name, group in _GROUPS.items():
        if f"space_x/{name}" in arrays:
            x, dx = (_whole(f"space_{part}/{name}", arrays, 2).tolist() for part in ("x", "dx"))
            rows = zip(x, dx, strict=True)
            elements += [(group, *row) for row in rows]
    return StateSpace.of(nx, ndx, elements)


def _whole(name: str, arrays: dict[str, Array], dimensions: int = 1) -> Array:
    """An array of whole numbers. Raises ValueError for another."""
    array = arrays[name]
    if array.dtype.kind not in "iu" or array.ndim != dimensions:
        raise ValueError(f"{name} must be whole numbers, got {describe(array)}")
    return array


def _plain(value: Any) -> Any:
    """What JSON does not know: numpy's numbers and arrays; anything else by its text."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)
