"""The humanoid G1 (29 joints) is pushed and recovers its stance, both feet where they are, driven by servos.

    J = h sum_n [ 1/2 |x_n - x_stance|^2_W + 1/2 effort |u_n - u_stance|^2 ] + 1/2 |x_N - x_stance|^2_{W_N}

x = (q, v) with a free base, which starts at the speed that the push gives it; u the angles [rad] that the joints'
position servos are told.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mjslq.costs import Control, State
from mjslq.problem import Problem
from mjslq.problems.g1_reach import STANCE, g1
from mjslq.problems.legged import standing
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, count, finite, positive


def g1_push(
    vx: float = 0.5,
    vy: float = 0.0,
    horizon: int = 50,
    timestep: float = 0.02,
    effort: float = 1.0,
    contact: str = "smooth",
) -> Problem:
    """Stand still again after a push that makes the base move at (`vx`, `vy`) [m/s], in `horizon` steps.

    `effort` weighs the departure of the servos from the stance [1/rad^2 s]. `contact` is "smooth" or "stiff".
    """
    dynamics = g1(positive("timestep", timestep), contact)
    stance = standing(dynamics.model, STANCE)
    hold, nv = stance[7 : 7 + dynamics.nu], dynamics.ndx // 2
    x0 = np.array(stance)
    x0[7 + dynamics.nu : 9 + dynamics.nu] = finite("vx", vx), finite("vy", vy)
    running = np.concatenate([np.full(6, 10.0), np.full(nv - 6, 0.1), np.full(nv, 0.1)])
    final = np.concatenate([np.full(6, 1e3), np.full(nv - 6, 10.0), np.full(nv, 10.0)])
    return Problem(
        dynamics=dynamics,
        horizon=count("horizon", horizon),
        x0=x0,
        costs=[State(running, stance), Control(positive("effort", effort), hold), State(final, stance, "terminal")],
        U0=hold,
        options={"tol_direction": 1e-3},
        describe=partial(describe, stance=stance),
    )


def errors(trajectory: Trajectory, stance: Array) -> tuple[float, float, float]:
    """Distance of the base from its place [m], its tilt [rad] and its speed [m/s] at the end."""
    x = trajectory.X[-1]
    tilt = 2.0 * float(np.arcsin(min(1.0, float(np.hypot(x[4], x[5])))))
    nq = (len(x) + 1) // 2
    return float(np.linalg.norm(x[:3] - stance[:3])), tilt, float(np.linalg.norm(x[nq : nq + 3]))


def describe(trajectory: Trajectory, stance: Array) -> dict[str, str]:
    """How the base ends."""
    away, tilt, speed = errors(trajectory, stance)
    return {"base": f"{1e3 * away:.1f} mm from its place, tilted by {np.degrees(tilt):.1f} deg, speed {speed:.3f} m/s"}
