"""A train of carts with pendulums upside down, coupled by springs and dampers (Sforni et al., GoPRONTO, section V).

    (M + m) p_i'' + m l cos(th_i) th_i'' = u_i + m l sin(th_i) th_i'^2 - f_c p_i' + coupling_i
    m l cos(th_i) p_i'' + I th_i''       = m g l sin(th_i) - f_p th_i'
    coupling_i = sum over neighbours j of  k (p_j - p_i) + d (p_j' - p_i'),     I = m l^2 + 2/5 m b^2

p_i is the cart's position about its place in the train, th_i the pendulum's angle from upright, u_i the force on the
cart. Runge-Kutta steps of h = `duration` / `horizon`, the control held. All pendulums are to swing between
+`theta` and -`theta`, along a smooth reference, while the carts stay about their places:

    J = h sum_n [ 1/2 |x_n - x_ref,n|^2_Q + 1/2 r |u_n|^2 ] + 1/2 |x_N|^2_P,

P the solution of the discrete algebraic Riccati equation of the train upright, for the weights h Q and h r. Coupled
carts are alike, so that it falls apart into one of four states for each mode of the train.

The paper's parameters, weights and reference are lost; the numbers here are ours. They make a train whose open loop
grows by 1.13 a step. The MJCF model of the same train (`engine="mujoco"`) has the springs as tendons between the carts.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numba import njit
from scipy.linalg import solve_discrete_are

from mjslq.costs import Control, State
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.function import FunctionDynamics
from mjslq.problem import Problem
from mjslq.problems.cart_train_model import Train, mujoco_dynamics
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose, count, nonnegative, positive

LARGEST = 200
"""Carts, at most."""
STATE_WEIGHTS = (0.3, 100.0, 0.3, 10.0)
"""Of position [1/m^2], angle [1/rad^2] and their velocities. Ours."""
SWING = ((0.05, 1.0), (0.2, -2.0), (0.35, 2.0), (0.5, -2.0), (0.65, 2.0), (0.8, -1.0))
"""Changes of the reference: when they begin, as shares of the duration, and by how many thetas. Ours."""
SHARE = 0.15
"""Of the duration, that a change takes."""


def cart_train(
    carts: int = 2,
    theta: float = 30.0,
    horizon: int = 400,
    duration: float = 8.0,
    limit: float = 0.0,
    effort: float = 0.01,
    engine: str = "function",
) -> Problem:
    """Swing the pendulums of `carts` coupled carts between +-`theta` [deg] within `duration` [s].

    Forces within `limit` [N] (0: none); `effort` weighs them [1/N^2]. `engine` is "function" or "mujoco".
    """
    number, N = count("carts", carts), count("horizon", horizon)
    if number > LARGEST:
        raise ValueError(f"carts must be at most {LARGEST}, got {carts}")
    h, train = positive("duration", duration) / N, Train(number)
    limits = (-limit, limit) if nonnegative("limit", limit) else None
    made: dict[str, Callable[..., Dynamics]] = {"function": function_dynamics, "mujoco": mujoco_dynamics}
    dynamics = made[choose("engine", engine, made)](train, h, limits)
    weights, effort = spread(STATE_WEIGHTS, number), positive("effort", effort)
    P = terminal_weight(train, h, effort)
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=np.zeros(dynamics.nx),
        costs=[
            State(weights, reference(train, np.radians(nonnegative("theta", theta)), N, h)),
            State(P, np.zeros(dynamics.nx), when="terminal"),
            Control(effort),
        ],
        options={"regulator": (tuple(h * weights), h * effort)},
        describe=partial(describe, carts=number),
        drawing=mujoco_dynamics(train, h, limits).scene() if engine == "function" else None,
    )


def spread(four: tuple[float, ...], carts: int) -> Array:
    """Numbers for position, angle and their velocities as one for each entry of the state. Shape (4 carts,)."""
    return np.concatenate([np.tile(four[:2], carts), np.tile(four[2:], carts)])


def reference(train: Train, theta: float, N: int, h: float) -> Array:
    """States to follow: zero, but for the angles and their velocities. Shape (N + 1, 4 carts)."""
    t, T = h * np.arange(N + 1), h * N
    angle, speed = np.zeros(N + 1), np.zeros(N + 1)
    for start, change in SWING:
        s = np.clip((t / T - start) / SHARE, 0.0, 1.0)
        angle += theta * change * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        speed += theta * change * 30.0 * s * s * (1.0 - s) ** 2 / (SHARE * T)
    X = np.zeros((N + 1, 4 * train.carts))
    X[:, 1 : 2 * train.carts : 2] = angle[:, None]
    X[:, 2 * train.carts + 1 :: 2] = speed[:, None]
    return X


def terminal_weight(train: Train, h: float, effort: float) -> Array:
    """P of the whole train, from one Riccati equation a mode. Shape (4 carts, 4 carts)."""
    carts = train.carts
    laplacian = 2.0 * np.eye(carts) - np.eye(carts, k=1) - np.eye(carts, k=-1)
    laplacian[0, 0] -= 1.0
    laplacian[-1, -1] -= 1.0
    stretches, modes = np.linalg.eigh(laplacian)
    blocks = np.stack([_mode_weight(train, max(stretch, 0.0), h, effort) for stretch in stretches])
    P = np.einsum("ia,axy,ja->xiyj", modes, blocks, modes)  # (4, carts, 4, carts), kinds of state outside
    order = np.arange(4 * carts).reshape(2, carts, 2).swapaxes(1, 2).reshape(4, carts)
    whole = np.empty((4 * carts, 4 * carts))
    whole[np.ix_(order.ravel(), order.ravel())] = P.reshape(4 * carts, 4 * carts)
    return 0.5 * (whole + whole.T)


def _mode_weight(train: Train, stretch: float, h: float, effort: float) -> Array:
    """P of one mode, the train upright: carts move so that the coupling is -stretch (k p + d p'). Shape (4, 4)."""
    M, ml, inertia = train.cart_mass + train.bob_mass, train.bob_mass * train.length, train.inertia
    mass = np.array([[M, ml], [ml, inertia]])
    force = np.array(
        [
            [-stretch * train.stiffness, 0.0, -stretch * train.damping - train.rail_damping, 0.0],
            [0.0, ml * train.gravity, 0.0, -train.hinge_damping],
        ]
    )
    F, G = np.zeros((4, 4)), np.zeros((4, 1))
    F[:2, 2:], F[2:] = np.eye(2), np.linalg.solve(mass, force)
    G[2:, 0] = np.linalg.solve(mass, [1.0, 0.0])
    powers = h * (np.eye(4) + h * F / 2.0 @ (np.eye(4) + h * F / 3.0 @ (np.eye(4) + h * F / 4.0)))
    A, B = np.eye(4) + powers @ F, powers @ G
    weight: Array = solve_discrete_are(A, B, h * np.diag(STATE_WEIGHTS), np.array([[h * effort]]))
    return weight


def function_dynamics(train: Train, h: float, limits: tuple[float, float] | None = None) -> FunctionDynamics:
    """The equations above, compiled; state (p_1, th_1, p_2, th_2, ..., and their velocities)."""
    names = [f"{kind}{i + 1}" for i in range(train.carts) for kind in ("cart", "pole")]
    return FunctionDynamics(
        _equations, 4 * train.carts, train.carts, h, integrator="rk4", parameters=train.parameters, pullback=_pullback,
        control_limits=limits, state_names=[*names, *(f"{name}.vel" for name in names)],
        control_names=[f"force{i + 1}" for i in range(train.carts)],
    )  # fmt: skip


def describe(trajectory: Trajectory, carts: int) -> dict[str, str]:
    """How far the pendulums swing and the carts go, and how strong the forces are."""
    X = trajectory.X
    angle, way = np.degrees(np.abs(X[:, 1 : 2 * carts : 2]).max()), np.abs(X[:, 0 : 2 * carts : 2]).max()
    return {"swing": f"to {angle:.1f} deg, carts within {way:.2f} m, forces within {np.abs(trajectory.U).max():.1f} N"}


@njit(cache=True)
def _equations(x, u, t, p):
    M, ml, inertia, g = p[0], p[1], p[2], p[3]
    k, d, f_c, f_p = p[4], p[5], p[6], p[7]
    carts = u.shape[0]
    nq, out = 2 * carts, np.empty_like(x)
    for i in range(carts):
        a, v = 2 * i, nq + 2 * i
        force = u[i] - f_c * x[v]
        if i > 0:
            force += k * (x[a - 2] - x[a]) + d * (x[v - 2] - x[v])
        if i < carts - 1:
            force += k * (x[a + 2] - x[a]) + d * (x[v + 2] - x[v])
        s, c, w = np.sin(x[a + 1]), np.cos(x[a + 1]), x[v + 1]
        along, about = force + ml * s * w * w, ml * g * s - f_p * w
        det = M * inertia - ml * c * ml * c
        out[a], out[a + 1] = x[v], w
        out[v] = (inertia * along - ml * c * about) / det
        out[v + 1] = (M * about - ml * c * along) / det
    return out


@njit(cache=True)
def _pullback(x, u, t, p, weights):
    """f_x'w and f_u'w, cart by cart."""
    M, ml, inertia, g = p[0], p[1], p[2], p[3]
    k, d, f_c, f_p = p[4], p[5], p[6], p[7]
    carts = u.shape[0]
    nq, nx = 2 * carts, 4 * carts
    out = np.zeros(nx + carts)
    for i in range(carts):
        a, v = 2 * i, nq + 2 * i
        force = u[i] - f_c * x[v]
        if i > 0:
            force += k * (x[a - 2] - x[a]) + d * (x[v - 2] - x[v])
        if i < carts - 1:
            force += k * (x[a + 2] - x[a]) + d * (x[v + 2] - x[v])
        s, c, w = np.sin(x[a + 1]), np.cos(x[a + 1]), x[v + 1]
        along, about = force + ml * s * w * w, ml * g * s - f_p * w
        det = M * inertia - ml * c * ml * c
        speeding, turning = (inertia * along - ml * c * about) / det, (M * about - ml * c * along) / det
        by_along = (inertia * weights[v] - ml * c * weights[v + 1]) / det
        by_about = (M * weights[v + 1] - ml * c * weights[v]) / det
        out[a + 1] = by_along * (ml * c * w * w + ml * s * turning) + by_about * (ml * g * c + ml * s * speeding)
        out[v] += weights[a] - f_c * by_along
        out[v + 1] = weights[a + 1] + 2.0 * by_along * ml * s * w - by_about * f_p
        out[nx + i] = by_along
        for j in (i - 1, i + 1):
            if 0 <= j < carts:
                out[a] -= k * by_along
                out[v] -= d * by_along
                out[2 * j] += k * by_along
                out[nq + 2 * j] += d * by_along
    return out
