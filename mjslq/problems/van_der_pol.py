"""A Van der Pol oscillator brought to rest (Fukushima and Yamamoto 1986, section IV, Table I).

    x_1' = (1 - x_2^2) x_1 - x_2 + u,   x_2' = x_1,   x(0) = (1.5, 1.5)

    J = 1/2 int_0^5 (x_1^2 + x_2^2 + u^2) dt

by Runge-Kutta steps of 0.05 s, controls constant over a step, the integral by the same quadrature: over a step of
length h with stages x^1 ... x^4, h/6 (L(x^1) + 2 L(x^2) + 2 L(x^3) + L(x^4)), which is a sum of squares. The paper
prints (1 - x_1^2) x_1, which is no Van der Pol oscillator and does not give its table. With the equations above the
table's radii and its pattern of accepted and rejected steps come out, while the costs differ by 0.6 to 1.6 %.

From u = 0 the second-order model is not convex: H_xx is negative around t = 1.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mjslq.costs import Control, Residual
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import count, finite, positive

PAPER_TABLE = (
    (9.586, 6.476, -3.024, 1.028, 1.0),
    (6.476, 10.256, -6.146, -0.615, 2.0),
    (6.476, 4.957, -1.583, 0.960, 0.5),
    (4.957, 4.893, 0.357, -0.181, 1.0),
    (4.957, 4.504, -0.548, 0.838, 0.25),
    (4.504, 4.468, -0.073, 0.494, 0.5),
)
"""Table I: J(u), J(u + v), Q(v), rho and Delta of the first six iterations."""
PAPER_COST = 4.418
"""After 12 iterations."""
OPTIMAL_COST = 4.392865
"""At the solution with the default parameters."""


def van_der_pol(
    x1: float = 1.5, x2: float = 1.5, horizon: int = 100, duration: float = 5.0, effort: float = 1.0
) -> Problem:
    """Bring the oscillator from (`x1`, `x2`) towards rest within `duration` [s]; `effort` weighs the control."""
    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    dynamics = FunctionDynamics(
        _equations, 2, 1, dt, integrator="rk4", state_names=("x1", "x2"), control_names=("u",)
    )  # fmt: skip
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=np.array([finite("x1", x1), finite("x2", x2)]),
        costs=[
            Residual(_stages, weight=np.repeat([1.0, 2.0, 2.0, 1.0], 2) / 6.0, parameters=[dt]),
            Control(positive("effort", effort)),
        ],
        options={
            "tol_direction": 0.0,
            "tol_gradient": 2e-9,
            "step": "open-loop",
        },  # ||H_u|| = ||dJ/dU|| / sqrt(h) below 1e-8
        describe=describe,
        drawing=_scene(dt),
    )


def describe(trajectory: Trajectory) -> dict[str, str]:
    """Where the oscillator ends."""
    return {"rest": f"({trajectory.X[-1, 0]:+.4f}, {trajectory.X[-1, 1]:+.4f}) at the end"}


@njit(cache=True)
def _equations(x, u, t, p):
    out = np.empty_like(x)
    out[0] = (1.0 - x[1] * x[1]) * x[0] - x[1] + u[0]
    out[1] = x[0]
    return out


@njit(cache=True)
def _stages(x, u, t, p):
    """States at the four stages of a Runge-Kutta step of length p[0]. Shape (8,)."""
    h = p[0]
    out, z, part = np.empty(8, dtype=x.dtype), x, (0.0, 0.5 * h, 0.5 * h, h)
    for i in range(4):
        if i > 0:
            z = x + part[i] * _equations(z, u, t, p)
        out[2 * i : 2 * i + 2] = z
    return out


def _scene(dt: float) -> Scene | None:
    """A bead on a rail, at x_2."""
    from mjslq.dynamics.mujoco import MujocoDynamics
    from mjslq.problems.drag_particle import drag_spec

    scene = MujocoDynamics.from_spec(drag_spec(1.0, dt)).scene()
    return Scene(scene.model, (1,), scene.name)
