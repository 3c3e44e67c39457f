"""A planar arm of three links swings its hand round a disc, with gravity, limited torques and joints.

    sum_j a_ij [ cos(f_i - f_j) f_j'' + sin(f_i - f_j) f_j'^2 ] + b_i g cos f_i = u_i - u_{i+1},  f_i = q_1 + ... + q_i

    J = 1/2 weight int |u|^2 dt,    |u| <= (18, 10, 4) Nm,   |q| <= (1.7, 2.4, 2.4) rad,   hand outside of the disc

Links are uniform rods of .4, .4, .3 m and 1, .8, .5 kg; f_i is the angle of link i from the horizontal. Runge-Kutta
steps with the controls held; limits of the joints and the disc act at the knots. The hand ends at a point, at rest.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

from mjslq.bounds import Bounds
from mjslq.constraints import Path
from mjslq.costs import Control
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.problems.drawings import discs, scene
from mjslq.problems.obstacles import clearance
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, count, finite, nonnegative, positive

LENGTHS, MASSES = (0.4, 0.4, 0.3), (1.0, 0.8, 0.5)
"""Of the links. [m], [kg]"""
OPTIMAL_COST = 12.3211
"""At the best solution known with the default parameters."""
TORQUES, RANGES = (18.0, 10.0, 4.0), (1.7, 2.4, 2.4)
"""Limits of the joints. [Nm], [rad]"""
DISC = (0.85, 0.25, 0.18)
"""The obstacle: x, y, radius. [m]"""
START = (-1.2, 0.5, 0.3)
"""Angles of the joints to start from, at rest. [rad]"""


def arm_obstacle(
    x: float = 0.35, y: float = 0.75, horizon: int = 60, duration: float = 1.2, weight: float = 1.0,
    gravity: float = 9.81,
) -> Problem:  # fmt: skip
    """Bring the hand to (`x`, `y`) [m], at rest, within `duration` [s]; `weight` is that of the torques."""
    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    most, far = np.array(TORQUES), np.array([*RANGES, np.inf, np.inf, np.inf])
    parameters = _parameters(nonnegative("gravity", gravity))
    dynamics = FunctionDynamics(
        _equations, 6, 3, dt, integrator="rk4", control_limits=(-most, most), parameters=parameters,
        state_names=("q1", "q2", "q3", "q1.vel", "q2.vel", "q3.vel"), control_names=("u1", "u2", "u3"),
    )  # fmt: skip
    target = np.array([finite("x", x), finite("y", y)])
    x0 = np.array([*START, 0.0, 0.0, 0.0])
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=x0,
        costs=[Control(positive("weight", weight))],
        bounds=Bounds(x=(-far, far)),
        constraints=[
            Path(_outside, when="always", parameters=DISC, name="disc"),
            Path(_off, equality=True, when="terminal", parameters=target, name="goal"),
        ],
        U0=_holding(x0[:3], parameters),
        describe=partial(describe, target=target),
        drawing=scene("arm_obstacle", _drawn(x, y), (0, 1, 2), center="0.4 0 0.2", extent=1.4),
    )


def hand(X: Array) -> Array:
    """Where the hand is in the states `X` (n, 6). Shape (n, 2). [m]"""
    angles, lengths = np.cumsum(X[:, :3], axis=1), np.array(LENGTHS)
    return np.stack([np.cos(angles) @ lengths, np.sin(angles) @ lengths], axis=1)


def describe(trajectory: Trajectory, target: Array) -> dict[str, str]:
    """How near the disc the hand comes, and how far from its target it ends."""
    points = hand(trajectory.X)
    off, speed = np.linalg.norm(points[-1] - target), np.abs(trajectory.X[-1, 3:]).max()
    return {
        "clearance": f"{clearance(points, DISC):+.4f} m at the knots",
        "hand": f"{off:.1e} m from its target, joints at {speed:.1e} rad/s",
    }


def _parameters(gravity: float) -> Array:
    """A (3, 3) in a row, then b g (3,)."""
    m, length = np.array(MASSES), np.array(LENGTHS)
    beyond = np.array([m[1:].sum(), m[2:].sum(), 0.0])
    a = np.diag(m * length**2 / 3.0 + length**2 * beyond)
    for i in range(3):
        for j in range(i + 1, 3):
            a[i, j] = a[j, i] = length[i] * length[j] * (0.5 * m[j] + beyond[j])
    return np.concatenate([a.ravel(), gravity * length * (0.5 * m + beyond)])


def _holding(q: Array, parameters: Array) -> Array:
    """Torques that hold the arm up. Shape (3,)."""
    weights: Array = parameters[9:] * np.cos(np.cumsum(q))
    return np.cumsum(weights[::-1])[::-1].copy()


def _drawn(x: float, y: float) -> str:
    links = "".join(
        f'<body pos="{0.0 if i == 0 else LENGTHS[i - 1]} 0 0"><joint type="hinge" axis="0 -1 0"/>'
        f'<geom type="capsule" fromto="0 0 0 {LENGTHS[i]} 0 0" size="{0.035 - 0.007 * i}" material="link"/>'
        for i in range(3)
    )
    goal = f'<geom type="sphere" size="0.03" pos="{x} 0 {y}" material="goal"/>'
    return discs(DISC, upright=True) + goal + links + "</body>" * 3


@njit(cache=True)
def _equations(x, u, t, p):
    out = np.empty_like(x)
    c1, c2, c3 = x[0], x[0] + x[1], x[0] + x[1] + x[2]
    w1, w2, w3 = x[3], x[3] + x[4], x[3] + x[4] + x[5]
    s12, s13, s23 = np.sin(c1 - c2), np.sin(c1 - c3), np.sin(c2 - c3)
    m12, m13, m23 = p[1] * np.cos(c1 - c2), p[2] * np.cos(c1 - c3), p[5] * np.cos(c2 - c3)
    r1 = u[0] - u[1] - p[1] * s12 * w2 * w2 - p[2] * s13 * w3 * w3 - p[9] * np.cos(c1)
    r2 = u[1] - u[2] + p[1] * s12 * w1 * w1 - p[5] * s23 * w3 * w3 - p[10] * np.cos(c2)
    r3 = u[2] + p[2] * s13 * w1 * w1 + p[5] * s23 * w2 * w2 - p[11] * np.cos(c3)
    # Gauss' elimination of the positive definite 3x3 system
    f21, f31 = m12 / p[0], m13 / p[0]
    d22, d23, d33 = p[4] - f21 * m12, m23 - f21 * m13, p[8] - f31 * m13
    r2, r3 = r2 - f21 * r1, r3 - f31 * r1
    f32 = d23 / d22
    a3 = (r3 - f32 * r2) / (d33 - f32 * d23)
    a2 = (r2 - d23 * a3) / d22
    a1 = (r1 - m12 * a2 - m13 * a3) / p[0]
    out[0], out[1], out[2] = x[3], x[4], x[5]
    out[3], out[4], out[5] = a1, a2 - a1, a3 - a2
    return out


@njit(cache=True)
def _place(x):
    c1, c2, c3 = x[0], x[0] + x[1], x[0] + x[1] + x[2]
    return (
        0.4 * np.cos(c1) + 0.4 * np.cos(c2) + 0.3 * np.cos(c3),
        0.4 * np.sin(c1) + 0.4 * np.sin(c2) + 0.3 * np.sin(c3),
    )


@njit(cache=True)
def _outside(x, u, t, p):
    out = np.empty(1, dtype=x.dtype)
    a, b = _place(x)
    out[0] = p[2] * p[2] - (a - p[0]) * (a - p[0]) - (b - p[1]) * (b - p[1])
    return out


@njit(cache=True)
def _off(x, u, t, p):
    out = np.empty(5, dtype=x.dtype)
    a, b = _place(x)
    out[0], out[1] = a - p[0], b - p[1]
    for i in range(3):
        out[2 + i] = x[3 + i]
    return out
