"""A mass on a line at three samples, its first speed free (McQuade 1989, section 3.6, (3.130)-(3.132)).

    x_1(k+1) = x_1(k) + x_2(k) + u(k)/2,   x_2(k+1) = x_2(k) + u(k),    k = 0, 1

    minimize  1/2 (u(0)^2 + u(1)^2)    subject to    x_1(0) = a,  x_1(1) = b,  x_1(2) = c,  u(1) = d

x_2(0) is unknown: the thesis's example for a free initial state, and for rows of states and controls at chosen samples.
It leaves a, b, c, d open; with the numbers here u = (0.6, 0.2), x_2 = (0, 0.6, 0.8), J = 0.2. The problem is linear and
quadratic: one step solves it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mjslq.constraints import Initial, Path, State
from mjslq.costs import Control
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.problems.drawings import scene
from mjslq.trajectory import Trajectory
from mjslq.validation import count, finite


def three_samples(a: float = 0.0, b: float = 0.3, c: float = 1.0, d: float = 0.2, horizon: int = 2) -> Problem:
    """Pass `a`, `b` and `c` [m] with the second force `d` [N]; there are two steps, `horizon` cannot be another."""
    if count("horizon", horizon) != 2:
        raise ValueError(f"horizon must be 2, the example has three samples, got {horizon}")
    dynamics = FunctionDynamics(
        _step, 2, 1, 1.0, integrator="map", state_names=("x1", "x2"), control_names=("force",)
    )  # fmt: skip
    places = [np.array([finite(name, value), 0.0]) for name, value in (("b", b), ("c", c))]
    rest = np.array([0.0, np.inf])
    return Problem(
        dynamics=dynamics,
        horizon=2,
        x0=[finite("a", a), 0.0],
        costs=[Control(1.0)],
        constraints=[
            Initial(free="x2"),
            State(places[0] - rest, places[0] + rest, when=1, name="b"),
            State(places[1] - rest, places[1] + rest, when="terminal", name="c"),
            Path(_force, equality=True, when=1, parameters=[finite("d", d)], name="d"),
        ],
        describe=describe,
        drawing=scene(
            "three_samples",
            "".join(f'<geom type="box" size="0.005 0.05 0.05" pos="{x} 0 0" material="goal"/>' for x in (a, b, c))
            + '<body><joint type="slide" axis="1 0 0"/><geom type="sphere" size="0.03" material="body"/></body>',
            (0,), center="0.5 0 0", extent=1.0,
        ),
    )  # fmt: skip


def describe(trajectory: Trajectory) -> dict[str, str]:
    """Places, speeds and forces."""
    (x1, x2), u = trajectory.X.T, trajectory.U[:, 0]
    names = {"places": x1, "speeds": x2, "forces": u}
    return {name: ", ".join(f"{value:.6g}" for value in values.round(12) + 0.0) for name, values in names.items()}


@njit(cache=True)
def _step(x, u, t, p):
    out = np.empty_like(x)
    out[0] = x[0] + x[1] + 0.5 * u[0]
    out[1] = x[1] + u[0]
    return out


@njit(cache=True)
def _force(x, u, t, p):
    out = np.empty(1, dtype=x.dtype)
    out[0] = u[0] - p[0]
    return out
