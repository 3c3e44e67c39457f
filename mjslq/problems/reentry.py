"""A lifting vehicle enters the atmosphere and levels off (McQuade 1989, chapter 5).

    v' = -D/m - g sin a,   a' = L/(m v) + (v/(R + h) - g/v) cos a,   h' = v sin a                (5.1)-(5.3)
    L/m = C_L rho v^2 S/2m,  D/m = C_D rho v^2 S/2m,  C_L = .6 sin 2u,  C_D = .27 + 1.82 sin^2 u  (5.7)-(5.10)
    rho = .002378 exp(-h/22000),   g = 32.172 R^2/(R + h)^2                                       (5.11)-(5.12)

u, the angle of attack, is the control; the speed v is 36000 ft/s at first, the flight path angle a -7.5 degrees, the
altitude h 400000 ft. After 300 s the path has to be level, a = 0, with u <= 22.5 degrees (5.13) and an aerodynamic
acceleration of 5 times 32.172 ft/s^2 at most (5.14). 300 Runge-Kutta steps of 1 s with the control held; the load is
that of a step's end with the control that led there (2.22). States are in 1e4 ft/s, rad, 1e5 ft. (5.3) is missing in
print, and (5.2) has L/(m v).

The thesis asks for constraints only, nothing is minimized: variant "thesis". The variant "tracking" is not of the
thesis: it minimizes 1/2 int (u - nominal)^2 dt, keeps u above -30 degrees, so that the solution is a definite one, and
takes the load where steps begin.
"""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
from numba import njit

from mjslq.constraints import Path, Terminal
from mjslq.costs import Control
from mjslq.dynamics.function import FunctionDynamics
from mjslq.lq import square_root
from mjslq.lq.problem import LQProblem
from mjslq.lq.square_root import PathRows, StateRows
from mjslq.problem import Problem
from mjslq.problems.drawings import scene
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose, count, positive

NOMINAL = ((0.0, 59.412, 86.964, 300.0), (28.248, 28.248, -6.928, 7.399))
"""The angles of attack that the thesis starts from (Fig. 5.1): times [s], angles [deg], straight lines between."""
PAPER = {"final angle": 1.0422, "peak load": 6.4422, "peak time": 64.0}
"""Of the nominal trajectory, as the thesis tells: flight path angle at the end [deg], load, time [s]."""
TRACKING_COST = 0.40124
"""Cost at the solution of the variant "tracking"."""


def reentry(
    variant: str = "thesis",
    start: str = "nominal",
    limits: str = "control",
    horizon: int = 300,
    duration: float = 300.0,
    attack: float = 22.5,
    load: float = 5.0,
) -> Problem:
    """Level off within `duration` [s], the angle of attack up to `attack` [deg], the acceleration up to `load` [g].

    `variant` is "thesis" or "tracking". `start` is "nominal" or "second", the trajectory after one correction of all
    violations at once from the nominal one, which climbs and plunges: the thesis found no way back from it. `limits`
    says what limits the angle of attack: "control", which all iterates keep, so that starts are clipped; or "row", a
    constraint that they may violate, as in the thesis.
    """
    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    tracking = choose("variant", variant, ("thesis", "tracking")) == "tracking"
    choose("start", start, ("nominal", "second"))
    as_row = choose("limits", limits, ("control", "row")) == "row"
    high, low = np.radians(positive("attack", attack)), np.radians(-30.0) if tracking else -np.inf
    dynamics = FunctionDynamics(
        _equations, 3, 1, dt, integrator="rk4", control_limits=(low, np.inf if as_row else high),
        state_names=("speed", "path", "altitude"), control_names=("attack",),
    )  # fmt: skip
    nominal = nominal_angles(N, dt)
    row = [Path(_attack, parameters=[high], name="attack")] if as_row else []
    made = Problem(
        dynamics=dynamics,
        horizon=N,
        x0=[3.6, np.radians(-7.5), 4.0],
        costs=[Control(1.0 if tracking else 0.0, nominal)],
        constraints=[
            *row,
            Path(_load, at="start" if tracking else "end", parameters=[positive("load", load)], name="load"),
            Terminal(_level, jacobian=_level_jacobian, name="level"),
        ],
        U0=nominal,
        describe=partial(describe, load=load, at_end=not tracking),
        drawing=scene(
            "reentry",
            '<geom type="box" size="3 0.5 0.02" pos="0 0 -0.05" material="rail"/>'
            '<body><joint type="hinge" axis="0 -1 0"/><joint type="slide" axis="0 0 1"/>'
            '<geom type="capsule" fromto="-0.3 0 0 0.3 0 0" size="0.06" material="body"/>'
            '<geom type="box" size="0.15 0.25 0.01" pos="-0.12 0 0" material="link"/></body>',
            (1, 2), center="0 0 1.5", extent=4.0,
        ),
    )  # fmt: skip
    return made if start == "nominal" else dataclasses.replace(made, U0=second_angles(made))


def nominal_angles(N: int = 300, dt: float = 1.0) -> Array:
    """Fig. 5.1. Shape (N, 1). [rad]"""
    times, angles = NOMINAL
    return np.radians(np.interp(np.arange(N) * dt, times, angles))[:, None]


def second_angles(problem: Problem) -> Array:
    """The nominal angles after one correction of all violations at once (Figs. 5.6 and 5.7). Shape (N, 1). [rad]

    Where angle and load are too large for several steps, the linearized rows contradict each other. Here the load and
    the end are corrected by least squares; what the thesis got must have come of rounding, and went farther off.
    """
    nominal, limit = nominal_angles(problem.horizon, float(np.min(problem.dynamics.dt))), np.radians(22.5)
    trajectory = problem.dynamics.rollout(problem.x0, nominal)
    linearization = problem.dynamics.linearize(trajectory)
    load = next(c for c in problem.bound_constraints if c.name == "load")
    J, over = load.residual.jacobian(trajectory, linearization), load.residual.value(trajectory)[:, 0]
    beyond, late = nominal[:, 0] > limit, over > 0.0
    steps = np.concatenate([np.flatnonzero(beyond), np.flatnonzero(late)])
    first = int(beyond.sum())
    H, C = np.zeros((len(steps), 3)), np.ones((len(steps), 1))
    H[first:], C[first:] = np.asarray(J.x)[late, 0], np.asarray(J.u)[late, 0]
    d = np.concatenate([limit - nominal[beyond, 0], -over[late]])
    scale = np.where(np.arange(len(steps)) < first, 0.0, 1e-9)
    zero, N = np.zeros, problem.horizon
    change = square_root.solve(
        LQProblem(
            linearization.A, linearization.B, zero((N + 1, 3, 3)), np.ones((N, 1, 1)), zero((N, 1, 3)),
            zero((N + 1, 3)), zero((N, 1)), zero((N, 3)),
        ),
        PathRows(steps, H, C, d, scale),
        StateRows([[0.0, 1.0, 0.0]], [-trajectory.X[-1, 1]], [1e-9]),
    )  # fmt: skip
    return nominal + change.U


def describe(trajectory: Trajectory, load: float, at_end: bool = True) -> dict[str, str]:
    """The peak of the acceleration, the largest angle of attack, and the end."""
    U, (v, path, h) = np.degrees(trajectory.U), trajectory.X[-1]
    felt = loads(trajectory, at_end)
    return {
        "attack": f"{U.min():.3f} to {U.max():.3f} deg",
        "load": f"{felt.max():.4f} g of {load:g} g, at {trajectory.times[felt.argmax()]:.0f} s",
        "end": f"path {np.degrees(path):+.2e} deg, {1e4 * v:.0f} ft/s, {1e5 * h:.0f} ft",
    }


def loads(trajectory: Trajectory, at_end: bool = True) -> Array:
    """Aerodynamic acceleration at the end of each step, or at its beginning. Shape (N,). [g]"""
    found: Array = _loads(trajectory.X[1:] if at_end else trajectory.X[:-1], trajectory.U)
    return found


@njit(cache=True, error_model="numpy")
def _forces(v, h, u):
    """Lift and drag over mass. [ft/s^2]"""
    pressure = 0.002378 * np.exp(-h / 22000.0) * v * v * 0.26245
    sine = np.sin(u)
    return 0.6 * np.sin(2.0 * u) * pressure, (0.27 + 1.82 * sine * sine) * pressure


@njit(cache=True, error_model="numpy")
def _equations(x, u, t, p):
    v, path, h = x[0] * 1e4, x[1], x[2] * 1e5
    radius = 20904000.0
    g = 32.172 * radius * radius / ((radius + h) * (radius + h))
    lift, drag = _forces(v, h, u[0])
    out = np.empty_like(x)
    out[0] = (-drag - g * np.sin(path)) / 1e4
    out[1] = lift / v + (v / (radius + h) - g / v) * np.cos(path)
    out[2] = v * np.sin(path) / 1e5
    return out


@njit(cache=True, error_model="numpy")
def _load(x, u, t, p):
    out = np.empty(1, dtype=x.dtype)
    lift, drag = _forces(x[0] * 1e4, x[2] * 1e5, u[0])
    out[0] = np.sqrt(lift * lift + drag * drag) / 32.172 - p[0]
    return out


@njit(cache=True)
def _attack(x, u, t, p):
    out = np.empty(1, dtype=x.dtype)
    out[0] = u[0] - p[0]
    return out


@njit(cache=True, error_model="numpy")
def _loads(X, U):
    out = np.empty(len(U))
    for n in range(len(U)):
        lift, drag = _forces(X[n, 0] * 1e4, X[n, 2] * 1e5, U[n, 0])
        out[n] = np.sqrt(lift * lift + drag * drag) / 32.172
    return out


def _level(x: Array) -> Array:
    return x[1:2]


def _level_jacobian(x: Array) -> Array:
    return np.array([[0.0, 1.0, 0.0]])
