"""Distances of sensors from the targets of the cost, in the sensors' units, for summaries.

A term that acts at one knot is told by the distance there; one that acts along the way by its largest distance and the
one at its last knot. Quaternions count by the angle between them and the target. Many frames, such as those of a clip,
are told together, a line for positions, one for orientations, and so on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mjslq.binding import bind_output
from mjslq.costs import Frame, Sensor
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.records import frame_sensor
from mjslq.knots import knots_of
from mjslq.problem import Problem
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

_UNITS = {
    "m": ("FRAMEPOS", "GEOMDIST", "SUBTREECOM", "TENDONPOS", "RANGEFINDER"),
    "rad": ("FRAMEQUAT", "BALLQUAT"),
    "m/s": ("FRAMELINVEL", "VELOCIMETER", "SUBTREELINVEL"),
    "rad/s": ("FRAMEANGVEL", "GYRO", "BALLANGVEL"),
    "m/s^2": ("FRAMELINACC", "ACCELEROMETER"),
    "rad/s^2": ("FRAMEANGACC",),
    "N": ("FORCE", "TOUCH"),
    "Nm": ("TORQUE",),
}
"""Kinds of MuJoCo's sensors, mjSENS_..., by the unit of what they read."""
_BY_JOINT = {"JOINTPOS": ("rad", "m"), "JOINTVEL": ("rad/s", "m/s"), "JOINTACTFRC": ("Nm", "N")}
"""Units by hinge and slide."""
FEW = 4
"""Frames that are told one by one."""


@dataclass(frozen=True)
class TaskError:
    """Distance of a sensor from its target."""

    sensor: str
    unit: str
    """Empty where it is not known."""
    largest: float
    last: float
    """At the last of the knots."""
    knots: int
    """How many there are."""
    mean: float
    of: str = ""
    """What is read of a frame; empty for sensors."""

    def __str__(self) -> str:
        """In a few words."""
        last = _shown(self.last, self.unit)
        return f"{last} off" if self.knots == 1 else f"{last} off in the end, {_shown(self.largest, self.unit)} at most"


def task_errors(problem: Problem, trajectory: Trajectory) -> list[TaskError]:
    """The distance of each sensor or frame that the cost names from its target, the last term of each counting."""
    found: dict[str, TaskError] = {}
    for term in problem.costs:
        if isinstance(term, (Sensor, Frame)) and not trajectory.diverged:
            of = term.of if isinstance(term, Frame) else ""
            name = frame_sensor(term.name, of) if isinstance(term, Frame) else term.name
            output = term.output(problem.dynamics) if isinstance(term, Frame) else term.name
            knots = knots_of(term.when, problem.dynamics.steps(problem.horizon))
            residual = bind_output(problem.dynamics, output, term.target, knots).at(problem.t0)
            away: Array = np.linalg.norm(residual.value(trajectory), axis=1)
            unit, last = sensor_unit(problem.dynamics, output), float(away[-1])
            found[name] = TaskError(name, unit, float(away.max()), last, len(away), float(away.mean()), of)
    return list(found.values())


def lines(errors: list[TaskError]) -> dict[str, str]:
    """A line for each sensor, and for each quantity of more than a few frames. Name -> text."""
    told: dict[str, str] = {}
    for error in errors:
        alike = [other for other in errors if other.of and other.of == error.of]
        if len(alike) <= FEW:
            told[error.sensor] = str(error)
            continue
        worst = max(alike, key=lambda one: one.largest)
        mean = sum(one.mean for one in alike) / len(alike)
        told[f"{len(alike)} frames, {error.of}"] = (
            f"{_shown(mean, error.unit)} off on average, {_shown(worst.largest, error.unit)} at most "
            f"({worst.sensor.removesuffix(frame_sensor('', error.of))})"
        )
    return told


def sensor_unit(dynamics: Dynamics, name: str) -> str:
    """Unit of the distance between readings of a sensor; empty where it is not known."""
    model: Any = getattr(dynamics, "model", None)
    if not hasattr(model, "sensor_type"):
        if not hasattr(model, "frames"):
            return ""
        return "rad" if dynamics.outputs[name].quaternion else "m"  # Pinocchio's outputs
    import mujoco

    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name) < 0:
        return ""
    sensor = model.sensor(name)
    kind = mujoco.mjtSensor(int(sensor.type[0])).name.removeprefix("mjSENS_")
    if kind in _BY_JOINT:
        hinge = model.jnt_type[int(sensor.objid[0])] == mujoco.mjtJoint.mjJNT_HINGE
        return _BY_JOINT[kind][0 if hinge else 1]
    return next((unit for unit, kinds in _UNITS.items() if kind in kinds), "")


def _shown(value: float, unit: str) -> str:
    return f"{1e3 * value:.2f} mm" if unit == "m" and value < 0.1 else f"{value:.3g} {unit}".strip()
