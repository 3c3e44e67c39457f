"""Checks of a problem's records, and of the trajectories that it is given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import instance

if TYPE_CHECKING:
    from mjslq.problem import Problem


def check_records(problem: Problem) -> None:
    """Check what is there for reports and viewers alone. Raises ValueError."""
    instance("parameters", problem.parameters, Mapping, "a table of values by name")
    if problem.drawing is not None:
        instance("drawing", problem.drawing, Scene, "a mjslq.Scene")


def check_trajectory(problem: Problem, trajectory: Trajectory) -> None:
    """Raise ValueError for what is no trajectory of the problem's system and horizon."""
    instance("trajectory", trajectory, Trajectory, "a mjslq.Trajectory")
    N, nx, nu = problem.horizon, problem.dynamics.nx, problem.dynamics.nu
    X, U = trajectory.X.shape, trajectory.U.shape
    if ((N + 1, nx), (N, nu)) != (X, U):
        raise ValueError(
            f"trajectory must have {N} steps, {nx} states and {nu} controls, got {U[0]}, {X[1]} and {U[1]}"
        )
