"""MuJoCo models that gymnasium's and dm_control's wheels carry, and what happens to each: load, check, solve.

The files are found where these packages are installed (pip install mjslq[models]), or below the folder that the
environment variable MJSLQ_MODELS names (a wheel unzipped there will do). What plain MuJoCo does not compile, such as
files that others include, and what has no joints, such as arenas, is left out.
"""

from __future__ import annotations

import importlib.util
import os
import traceback
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

import mjslq

PACKAGES = ("gymnasium", "dm_control")
VARIABLE = "MJSLQ_MODELS"


def folders() -> list[Path]:
    """Folders of the packages, or the one that the environment names."""
    if named := os.environ.get(VARIABLE):
        return [Path(named)]
    found = [importlib.util.find_spec(name) for name in PACKAGES]  # which imports nothing
    return [Path(spec.origin).parent for spec in found if spec is not None and spec.origin is not None]


def model_files() -> list[Path]:
    """All files that plain MuJoCo compiles to a model with joints."""
    candidates = sorted({path for folder in folders() for path in folder.rglob("*.xml")})
    return [path for path in candidates if _has_joints(path)]


def _has_joints(path: Path) -> bool:
    try:
        return mujoco.MjModel.from_xml_path(str(path)).nv > 0
    except (ValueError, OSError):
        return False


@dataclass
class Row:
    """What became of a model."""

    name: str
    served: str = "refused"
    """ "inverse" or "transition", or "refused"."""
    size: str = ""
    checked: str = ""
    """What `check_derivatives` found."""
    wrong: bool = False
    solved: str = ""
    said: list[str] = field(default_factory=list)
    """Why it is refused, linearized by differences or not solved; warnings."""
    traceback: str = ""

    def __str__(self) -> str:
        columns = f"{self.name:42s} {self.served:10s} {self.size:14s} {self.checked:12s} {self.solved}"
        return "\n    ".join([columns, *self.said, *self.traceback.splitlines()])


def survey(path: Path, steps: int = 4, horizon: int = 50, deadline: float = 10.0) -> Row:
    """Load a model, check its derivatives along a short motion, and solve for a rest pose at little effort."""
    row = Row("/".join(path.parts[-3:]))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            dynamics = mjslq.MujocoDynamics.from_path(path, threads=1)
            _describe(row, dynamics)
            _check(row, dynamics, steps)
            if dynamics.nu:
                _solve(row, dynamics, horizon, deadline)
        except ValueError as error:
            row.said.append(str(error))
        except Exception:
            row.traceback = traceback.format_exc()
    row.said += sorted({f"warning: {warning.message}" for warning in caught})
    return row


def _describe(row: Row, dynamics: mjslq.MujocoDynamics) -> None:
    row.served, row.size = dynamics.jacobian, f"nv {dynamics.nv} nu {dynamics.nu}"
    if row.served == "transition":
        row.said.append(dict(dynamics.support_report())['no jacobian="inverse"'])
    row.said += dynamics.faults()


def _start(dynamics: mjslq.MujocoDynamics) -> np.ndarray:
    names = dynamics.keyframe_names
    return dynamics.keyframe(names[0]) if names else dynamics.initial_state


def _check(row: Row, dynamics: mjslq.MujocoDynamics, steps: int) -> None:
    limits = np.clip(dynamics.control_limits, -1.0, 1.0).T
    noise = np.random.default_rng(0).uniform(*limits, (steps, dynamics.nu))
    check = dynamics.check_derivatives(dynamics.rollout(_start(dynamics), dynamics.initial_control + 0.1 * noise))
    reasons = [name for name in ("kinks", "jumps", "unsolved") if any(getattr(check, name).values())]
    row.wrong, row.checked = bool(check.suspects), ", ".join(reasons) or f"{check.worst_error:.0e}"
    if row.wrong:
        row.checked = "WRONG"
        row.said.append(check.verdict)


def _solve(row: Row, dynamics: mjslq.MujocoDynamics, horizon: int, deadline: float) -> None:
    x0 = _start(dynamics)
    costs = [mjslq.costs.Control(1e-2), mjslq.costs.State(1.0, target=x0)]
    problem = mjslq.Problem(dynamics=dynamics, horizon=horizon, x0=x0, costs=costs)
    result = mjslq.solve(problem, deadline=deadline, max_iterations=30)
    before = result.log[0].cost
    row.solved = (
        f"{result.status.value} {result.iterations} it {before:.3g} -> {result.cost:.3g} {result.seconds:.1f} s"
    )
