"""The quadruped Solo12 flips backward: it leaps, turns once about its pitch axis in the air, and stands again.

    J = h sum_n [ 1/2 |x_n - x_ref(t_n)|^2_W + 1/2 effort |u_n|^2 ] + 1/2 |x_N - x_stand|^2_{W_N}

x = (q, v) with a free base, u the twelve joint torques [Nm]. x_ref stands, but for the base in the air: its pitch turns
by 360 deg at a constant rate, and its height is that of a throw. A pose alone cannot ask for a whole turn, since it is
the same after it: orientations are compared along the shorter way. Here the targets turn with time, and the start turns
with them: servos kick the front legs out first and the hind legs 90 ms later, tuck them, and reach for the floor.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from mjslq.costs import Control, State
from mjslq.dynamics.dynamics import Feedback
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problem import Problem
from mjslq.problems.legged import standing
from mjslq.problems.solo12_stand import posture, solo12
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, count, nonnegative, positive

KICK_FRONT, KICK_HIND, TUCK, REACH = 0.12, 0.21, 0.32, 0.70
"""When the servos of the start change what they aim at. [s]"""
CROUCH, TUCKED = 1.2, 0.96
"""Angles of the thighs before and after the kick, knees at twice as much. [rad]"""
FRONT, HIND = (1.38, -0.175), (-1.5, 1.12)
"""Angles of thighs and knees that front and hind legs kick to. [rad]"""
STIFFNESS, DAMPING = 15.0, 0.27
"""Of the servos. [Nm/rad], [Nms/rad]"""
TAKE_OFF, LANDING = 0.22, 0.62
"""When the base's targets begin and end to turn. [s]"""


def solo12_flip(
    horizon: int = 100,
    timestep: float = 0.01,
    stand: float = 0.8,
    height: float = 0.4,
    spin: float = 1.0,
    effort: float = 5e-2,
    torque: float = 0.0,
    contact: str = "smooth",
) -> Problem:
    """Turn backward once in the air, the base as high as `height` [m], and stand again, thighs at `stand` [rad].

    `spin` weighs orientation and pitch rate in the air, `effort` the torques [1/(Nm)^2 s], of which the motors have
    `torque` [Nm] (0: any). `contact` is "smooth" or "stiff" (`mjslq.Contact`).
    """
    dynamics = solo12(positive("timestep", timestep), contact, nonnegative("torque", torque))
    N, goal = count("horizon", horizon, 4), standing(dynamics.model, posture(stand))
    nv = dynamics.ndx // 2
    times: Array = timestep * np.arange(N + 1, dtype=np.float64)
    positions = np.concatenate([[1.0, 1.0, 0.0, 0.0, 0.0, 0.0], np.full(nv - 6, 0.1)])
    running = np.concatenate([positions, np.full(nv, 0.01)])
    running[nv + 3 : nv + 6] = 0.0
    base = np.zeros(dynamics.ndx)
    base[2], base[3:6], base[nv + 3 : nv + 6] = 30.0, 10.0, 0.1
    final = np.concatenate([[1e3] * 6, np.full(nv - 6, 100.0), np.full(nv, 1.0)])
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=goal,
        costs=[
            State(running, goal),
            State(positive("spin", spin) * base, thrown(goal, times, positive("height", height))),
            Control(positive("effort", effort)),
            State(final, goal, "terminal"),
        ],
        U0=kicking_legs(dynamics, goal, goal, N),
        options={"tol_direction": 1e-3},
        describe=partial(describe, end=goal[:3]),
    )


def thrown(goal: Array, times: Array, height: float) -> Array:
    """States at `times` (N + 1,) whose base flies and turns once, and stands at `goal` before and after. (N + 1, nx)"""
    share = np.clip((times - TAKE_OFF) / (LANDING - TAKE_OFF), 0.0, 1.0)
    X = np.tile(goal, (len(times), 1))
    X[:, 2] += 4.0 * share * (1.0 - share) * (height - goal[2])
    X[:, 3], X[:, 5] = np.cos(-np.pi * share), np.sin(-np.pi * share)
    flying = (share > 0.0) & (share < 1.0)
    X[flying, 19 + 4] = -2.0 * np.pi / (LANDING - TAKE_OFF)
    return X


def kicking_legs(dynamics: MujocoDynamics, start: Array, goal: Array, N: int) -> Array:
    """Torques of servos that leap backward: a start that turns, and comes down on its feet. Shape (N, nu)."""
    nv, joints, times = dynamics.ndx // 2, np.arange(dynamics.nu), dynamics.model.opt.timestep * np.arange(N + 1)
    names = [dynamics.model.joint(1 + i).name for i in joints]
    X = np.tile(goal, (N + 1, 1))

    def aim(angles: dict[str, float], during: Array, legs: str = "FH") -> None:
        for i, name in enumerate(names):
            if name[0] in legs:
                X[during, 7 + i] = angles.get(name, 0.0)

    aim(posture(CROUCH), times < KICK_FRONT)
    aim(posture(CROUCH), (times >= KICK_FRONT) & (times < KICK_HIND), "H")
    for legs, begin, (thigh, knee) in (("F", KICK_FRONT, FRONT), ("H", KICK_HIND, HIND)):
        kicked = {name: thigh if name.endswith("HFE") else knee for name in names if name[3:] in ("HFE", "KFE")}
        aim(kicked, (times >= begin) & (times < TUCK), legs)
    aim(posture(TUCKED), (times >= TUCK) & (times < REACH))
    K = np.zeros((N, dynamics.nu, dynamics.ndx))
    K[:, joints, 6 + joints], K[:, joints, nv + 6 + joints] = STIFFNESS, DAMPING
    law = Feedback.unlimited(X, K)
    return dynamics.rollouts(start[None], np.zeros((1, N, dynamics.nu)), law)[0].U


def turned(trajectory: Trajectory) -> float:
    """Angle by which the base has turned about its pitch axis, whole turns included. [rad]"""
    return float(np.unwrap(2.0 * np.arctan2(trajectory.X[:, 5], trajectory.X[:, 3]))[-1])


def describe(trajectory: Trajectory, end: Array) -> dict[str, str]:
    """How far the base turns, how high it comes, and where it ends."""
    away = 1e3 * float(np.linalg.norm(trajectory.X[-1, :3] - end))
    top, torque = trajectory.X[:, 2].max(), float(np.abs(trajectory.U).max())
    angle = np.degrees(turned(trajectory))
    return {
        "base": f"turns by {angle:.1f} deg, as high as {top:.3f} m, ends {away:.1f} mm away; {torque:.1f} Nm at most"
    }
