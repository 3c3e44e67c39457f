"""mjslq: trajectory optimization for MuJoCo models.

State a cost over the motions of a robot, get an optimal trajectory with feedback gains, look at it in the browser:

    import mjslq
    result = mjslq.solve(mjslq.problems.get("hopper", height=30.0), verbose=1)
    mjslq.view(result)

Names are imported when first used, so that what needs neither MuJoCo nor a browser does not wait for them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mjslq import numba_cache

if TYPE_CHECKING:
    from mjslq import clips as clips
    from mjslq import constraints as constraints
    from mjslq import costs as costs
    from mjslq import lq as lq
    from mjslq import problems as problems
    from mjslq import simulation as simulation
    from mjslq import starts as starts
    from mjslq.batch import solve_many as solve_many
    from mjslq.bounds import Bounds as Bounds
    from mjslq.clips.clip import Clip as Clip
    from mjslq.contact import Contact as Contact
    from mjslq.dynamics.derivative_check import DerivativeCheck as DerivativeCheck
    from mjslq.dynamics.dynamics import Dynamics as Dynamics
    from mjslq.dynamics.dynamics import Linearization as Linearization
    from mjslq.dynamics.function import FunctionDynamics as FunctionDynamics
    from mjslq.dynamics.mujoco import MujocoDynamics as MujocoDynamics
    from mjslq.dynamics.pinocchio import PinocchioDynamics as PinocchioDynamics
    from mjslq.exports import export as export
    from mjslq.log import IterationLog as IterationLog
    from mjslq.method_table import methods as methods
    from mjslq.mpc import MPC as MPC
    from mjslq.optimize import solve as solve
    from mjslq.policy import Policy as Policy
    from mjslq.problem import Problem as Problem
    from mjslq.reports.explain import explain as explain
    from mjslq.result import Result as Result
    from mjslq.result import load as load
    from mjslq.robots import robot_path as robot_path
    from mjslq.scene import Scene as Scene
    from mjslq.status import Status as Status
    from mjslq.tasks.task import Task as Task
    from mjslq.tasks.task import load_task as load_task
    from mjslq.trajectory import Trajectory as Trajectory
    from mjslq.viewer import export_html as export_html
    from mjslq.viewer import live as live
    from mjslq.viewer import view as view
    from mjslq.viewer import watch as watch

numba_cache.provide()

__version__ = "0.4.0"

_HOME = {
    "clips": "mjslq.clips",
    "constraints": "mjslq.constraints",
    "costs": "mjslq.costs",
    "lq": "mjslq.lq",
    "problems": "mjslq.problems",
    "simulation": "mjslq.simulation",
    "starts": "mjslq.starts",
    "Bounds": "mjslq.bounds",
    "Clip": "mjslq.clips",
    "Contact": "mjslq.contact",
    "DerivativeCheck": "mjslq.dynamics.derivative_check",
    "Dynamics": "mjslq.dynamics.dynamics",
    "FunctionDynamics": "mjslq.dynamics.function",
    "IterationLog": "mjslq.log",
    "Linearization": "mjslq.dynamics.dynamics",
    "MPC": "mjslq.mpc",
    "MujocoDynamics": "mjslq.dynamics.mujoco",
    "PinocchioDynamics": "mjslq.dynamics.pinocchio",
    "Policy": "mjslq.policy",
    "Problem": "mjslq.problem",
    "Result": "mjslq.result",
    "Scene": "mjslq.scene",
    "Status": "mjslq.status",
    "Task": "mjslq.tasks.task",
    "Trajectory": "mjslq.trajectory",
    "explain": "mjslq.reports.explain",
    "export": "mjslq.exports",
    "export_html": "mjslq.viewer",
    "live": "mjslq.viewer",
    "load": "mjslq.result",
    "load_task": "mjslq.tasks.task",
    "methods": "mjslq.method_table",
    "robot_path": "mjslq.robots",
    "solve": "mjslq.optimize",
    "solve_many": "mjslq.batch",
    "view": "mjslq.viewer",
    "watch": "mjslq.viewer",
}

_MODULES = ("clips", "constraints", "costs", "lq", "problems", "simulation", "starts")
"""Names that are modules themselves."""

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'mjslq' has no attribute {name!r}; there are: {', '.join(sorted(_HOME))}")
    module = importlib.import_module(_HOME[name])
    value = module if module.__name__ == f"mjslq.{name}" and name in _MODULES else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
