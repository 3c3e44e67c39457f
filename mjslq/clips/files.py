"""Clips as files: CSV, a column for each number, and NumPy's npz, an array for each quantity; read without pickle.

CSV: a line of names, then a line for each sample; separated by commas, lines that begin with # left out

    time                                    [s]
    pelvis.x, pelvis.y, pelvis.z            position of the frame "pelvis" [m]
    pelvis.qw, pelvis.qx, .qy, .qz          its orientation
    pelvis.vx, pelvis.vy, pelvis.vz         its linear velocity [m/s]
    pelvis.wx, pelvis.wy, pelvis.wz         its angular velocity [rad/s]
    qpos.knee, qpos.root.x, qpos.root.qw    joint positions, by entry of the state (`Dynamics.state_names`)
    qvel.knee, qvel.root.vx                 joint velocities

npz: arrays of the same samples

    time (T,)     pelvis.position (T, 3)     pelvis.orientation (T, 4)     pelvis.linear_velocity (T, 3)
                  pelvis.angular_velocity (T, 3)     qpos.knee (T,)     qvel.knee (T,)     format: 1, optional

Columns come in any order; each quantity is there with all its columns or not at all.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjslq.clips.clip import SIZES, Clip
from mjslq.dynamics.records import QUANTITIES
from mjslq.files import atomic_write, read_arrays
from mjslq.validation import Array, count

FORMAT = 1
"""Version of the npz format."""
ENDINGS = (".npz", ".csv")
COLUMNS: dict[str, tuple[str, ...]] = {
    "position": ("x", "y", "z"),
    "orientation": ("qw", "qx", "qy", "qz"),
    "linear-velocity": ("vx", "vy", "vz"),
    "angular-velocity": ("wx", "wy", "wz"),
}
"""How the columns of a quantity end."""
_QUANTITY = {column: of for of, columns in COLUMNS.items() for column in columns}
Samples = dict[str, Array]


def load(path: str | os.PathLike[str]) -> Clip:
    """Read a clip from an .npz or .csv file; see the head of `mjslq.clips.files` for what these hold.

    Raises ValueError, in one sentence that names the file, for a file that does not exist, is damaged or something
    else, lacks columns, or has samples that `Clip` refuses.
    """
    file = Path(path).expanduser()
    ending = _ending(file)
    if not file.is_file():
        raise ValueError(f"clip file {str(path)!r} {'is a folder' if file.is_dir() else 'does not exist'}")
    arrays = read_arrays(file, "a recorded motion") if ending == ".npz" else None
    try:
        return Clip(*(_from_csv(file) if arrays is None else _from_arrays(arrays)), name=file.stem)
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}") from None


def save(clip: Clip, path: str | os.PathLike[str], digits: int | None = None) -> None:
    """See `Clip.save`."""
    file = Path(path).expanduser()
    if _ending(file) == ".npz":
        arrays: dict[str, Any] = {"time": clip.times, "format": np.array(FORMAT)}
        for frame, of, samples in _quantities(clip):
            arrays[f"{frame}.{of.replace('-', '_')}"] = samples
        for kind in ("qpos", "qvel"):
            arrays |= {f"{kind}.{entry}": samples for entry, samples in getattr(clip, kind).items()}
        with atomic_write(file) as stream:
            np.savez_compressed(stream, **arrays)
        return
    columns: dict[str, Array] = {"time": clip.times}
    for frame, of, samples in _quantities(clip):
        columns |= {f"{frame}.{end}": column for end, column in zip(COLUMNS[of], samples.T, strict=True)}
    for kind in ("qpos", "qvel"):
        columns |= {f"{kind}.{entry}": samples for entry, samples in getattr(clip, kind).items()}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    decimals = None if digits is None else count("digits", digits, 0)
    for row in np.stack(list(columns.values()), axis=1).tolist():
        writer.writerow([repr(v) if decimals is None else _rounded(v, decimals) for v in row])
    with atomic_write(file) as stream:
        stream.write(text.getvalue().encode())


def _ending(file: Path) -> str:
    ending = file.suffix.lower()
    if ending not in ENDINGS:
        raise ValueError(f"a clip's file must end in {' or '.join(ENDINGS)}, got {file.name!r}")
    return ending


def _quantities(clip: Clip) -> Iterator[tuple[str, str, Array]]:
    for frame, quantities in clip.frames.items():
        for of in QUANTITIES:
            if of in quantities:
                yield frame, of, quantities[of]


def _rounded(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text


def _from_csv(file: Path) -> tuple[Array, dict[str, Samples], Samples, Samples]:
    """Times, frames, joint positions and velocities."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("it is no text file") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    if len(lines) < 2:
        raise ValueError("there must be a line of column names and lines of numbers below it")
    names = [name.strip() for name in next(csv.reader([lines[0][1]]))]
    if "time" not in names:
        raise ValueError(f"there is no column 'time'; there are: {', '.join(names[:8])}{', ...' * (len(names) > 8)}")
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    if twice:
        raise ValueError(f"the column {twice[0]!r} is there twice")
    table = np.empty((len(lines) - 1, len(names)))
    for row, (number, line) in enumerate(lines[1:]):
        cells = next(csv.reader([line]))
        if len(cells) != len(names):
            raise ValueError(f"line {number} has {len(cells)} entries, but there are {len(names)} columns")
        for i, cell in enumerate(cells):
            try:
                table[row, i] = float(cell)
            except ValueError:
                raise ValueError(f"line {number}, column {names[i]!r}: {cell.strip()!r} is no number") from None
            if not np.isfinite(table[row, i]):
                raise ValueError(f"line {number}, column {names[i]!r}: must be finite, got {cell.strip()}")
    return _sorted_columns({name: table[:, i] for i, name in enumerate(names)})


def _sorted_columns(columns: Mapping[str, Array]) -> tuple[Array, dict[str, Samples], Samples, Samples]:
    """Columns by name as frames and joints."""
    single: dict[str, dict[str, dict[str, Array]]] = {}
    joints: dict[str, Samples] = {"qpos": {}, "qvel": {}}
    for name, column in columns.items():
        kind, dot, entry = name.partition(".")
        frame, _, end = name.rpartition(".")
        if name == "time":
            continue
        if kind in joints and dot and entry:
            joints[kind][entry] = column
        elif frame and end in _QUANTITY:
            single.setdefault(frame, {}).setdefault(_QUANTITY[end], {})[end] = column
        else:
            raise ValueError(
                f"the column {name!r} is neither 'time', 'qpos.JOINT', 'qvel.JOINT' nor 'FRAME.' followed by one of "
                f"{', '.join(_QUANTITY)}"
            )
    frames: dict[str, Samples] = {}
    for frame, quantities in single.items():
        for of, found in quantities.items():
            missing = [f"{frame}.{end}" for end in COLUMNS[of] if end not in found]
            if missing:
                raise ValueError(f"the {of} of {frame!r} is not whole: there is no column {', '.join(missing)}")
            frames.setdefault(frame, {})[of] = np.stack([found[end] for end in COLUMNS[of]], axis=1)
    return columns["time"], frames, joints["qpos"], joints["qvel"]


def _from_arrays(arrays: dict[str, Array]) -> tuple[Array, dict[str, Samples], Samples, Samples]:
    """Times, frames, joint positions and velocities."""
    version = arrays.pop("format", np.array(FORMAT))
    if version.shape != () or version != FORMAT:
        raise ValueError(f"has the format {version}, this version of mjslq reads format {FORMAT}")
    if "time" not in arrays:
        raise ValueError(f"there is no array 'time'; there are: {', '.join(list(arrays)[:8]) or 'none'}")
    frames: dict[str, Samples] = {}
    joints: dict[str, Samples] = {"qpos": {}, "qvel": {}}
    for name, array in arrays.items():
        kind, dot, entry = name.partition(".")
        frame, _, end = name.rpartition(".")
        if name == "time":
            continue
        if kind in joints and dot and entry:
            joints[kind][entry] = array
        elif frame and (of := end.replace("_", "-")) in SIZES:
            frames.setdefault(frame, {})[of] = array
        else:
            known = ", ".join(of.replace("-", "_") for of in QUANTITIES)
            raise ValueError(
                f"the array {name!r} is neither 'time', 'qpos.JOINT', 'qvel.JOINT' nor 'FRAME.' followed by one of "
                f"{known}"
            )
    return arrays["time"], frames, joints["qpos"], joints["qvel"]
