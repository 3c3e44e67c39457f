"""Results as tables (CSV): one row a knot, one header line with names and units.

    time [s]              time of the knot
    NAME [unit]           each state: positions by joint, then velocities (NAME.vel) and activations
    control NAME [unit]   each control, held from this knot to the next one; empty in the last row
    sensor NAME [unit]    each output of the model at the knot

Units stand where the model tells them. Numbers have all their digits; entries that are not known (of a motion that
diverged) are empty. `numpy.genfromtxt(file, delimiter=",", names=True)` and `pandas.read_csv(file)` read the file;
NumPy turns the names into identifiers, "hip.vel [rad/s]" into hipvel_rads, unless it is given deletechars="".
"""

from __future__ import annotations

import os
from typing import Any

import mujoco
import numpy as np

from mjslq.files import atomic_write
from mjslq.reports.units import control_kinds, length_unit, model_from_mjb, state_kinds
from mjslq.result import Result
from mjslq.validation import Array

_FORBIDDEN = str.maketrans({",": ";", '"': "'", "#": "_", "\n": " ", "\r": " "})
"""What would end a name, or make NumPy take the rest for a comment."""


def write_table(result: Result, path: str | os.PathLike[str]) -> None:
    """Write the trajectory of `result` to `path` as CSV, whole or not at all.

    Raises ValueError when the file cannot be written.
    """
    t = result.trajectory
    U = np.vstack([t.U, np.full((1, t.U.shape[1]), np.nan)])
    values = np.hstack([t.times[:, None], t.X, U, t.Y])
    lines = [",".join(columns(result)), *(",".join(_text(value) for value in row) for row in values)]
    with atomic_write(path) as stream:
        stream.write(("\n".join(lines) + "\n").encode())


def columns(result: Result) -> list[str]:
    """Names of the columns, units included, each once."""
    t = result.trajectory
    nx, nu, ny = t.X.shape[1], t.U.shape[1], t.Y.shape[1]
    model = None if result.scene is None else model_from_mjb(result.scene.model)
    states, controls, outputs = [""] * nx, [""] * nu, [""] * ny
    if model is not None and result.scene is not None:
        states = [unit for _, unit in state_kinds(model, result.scene.columns, nx)]
        if model.nu == nu:
            controls = [unit for _, unit in control_kinds(model)]
        if model.nsensordata == ny:
            outputs = sensor_units(model)
    told = ["time [s]"]
    for kind, letter, prefix, units in (
        ("states", "x", "", states),
        ("controls", "u", "control ", controls),
        ("outputs", "y", "sensor ", outputs),
    ):
        given = result.names.get(kind, ())
        names = given if len(given) == len(units) else [f"{letter}[{i}]" for i in range(len(units))]
        told += [prefix + name + (f" [{unit}]" if unit else "") for name, unit in zip(names, units, strict=True)]
    return _distinct([name.translate(_FORBIDDEN) for name in told])


def sensor_units(model: Any) -> list[str]:
    """Unit of each entry of the model's sensor data; empty where it has none, or none is known."""
    known = {f"mjSENS_{name}": unit for unit, names in _UNITS.items() for name in names.split()}
    units: list[str] = []
    for i in range(model.nsensor):
        unit = known.get(mujoco.mjtSensor(model.sensor_type[i]).name, "")
        if "JOINT" in unit:
            slides = model.jnt_type[model.sensor_objid[i]] == mujoco.mjtJoint.mjJNT_SLIDE
            unit = unit.replace("JOINT", "LENGTH" if slides else "rad")
        units += [unit.replace("LENGTH", length_unit(model))] * int(model.sensor_dim[i])
    return units


_UNITS = {
    "LENGTH": "FRAMEPOS SUBTREECOM RANGEFINDER TENDONPOS GEOMDIST",
    "LENGTH/s": "FRAMELINVEL VELOCIMETER SUBTREELINVEL TENDONVEL",
    "LENGTH/s^2": "FRAMELINACC ACCELEROMETER",
    "rad/s": "FRAMEANGVEL GYRO BALLANGVEL",
    "rad/s^2": "FRAMEANGACC",
    "N": "FORCE TOUCH",
    "Nm": "TORQUE",
    "s": "CLOCK",
    "JOINT": "JOINTPOS",
    "JOINT/s": "JOINTVEL",
}
"""Names of mjtSensor by the unit of what they read; JOINT is that of a length or an angle."""


def _distinct(names: list[str]) -> list[str]:
    """Names with a number where one comes again."""
    seen: dict[str, int] = {}
    told = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        told.append(name if seen[name] == 1 else f"{name} {seen[name]}")
    return told


def _text(value: Array) -> str:
    return repr(float(value)) if np.isfinite(value) else ""
