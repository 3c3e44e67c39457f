"""Problems with constraints whose optima are known, for the tests of methods that take constraints.

All by Runge-Kutta steps with controls that are held over a step, constraints at the knots.
"""

import numpy as np
from numba import njit

from mjslq import Bounds, FunctionDynamics, Problem
from mjslq.constraints import Path, State, Terminal
from mjslq.costs import Control


def starts(problem, seed, count=10):
    """Controls to start from: zeros first, then white noise and smooth curves up to the limits, in turns."""
    rng = np.random.default_rng(seed)
    lower, upper = problem.box
    nominal = np.asarray(problem.U0)
    low, high = np.where(np.isfinite(lower), lower, nominal - 5.0), np.where(np.isfinite(upper), upper, nominal + 5.0)
    N, nu = low.shape
    tau = np.arange(N)[:, None] / N
    found = [nominal]
    while len(found) < count:
        if len(found) % 2:
            share = rng.uniform(0.0, 1.0, (N, nu))
        else:
            share = 0.5 + 0.5 * np.sin(2.0 * np.pi * (rng.uniform(0.3, 2.0, nu) * tau + rng.uniform(0.0, 1.0, nu)))
        found.append(low + share * (high - low))
    return found


@njit(cache=True)
def _double_integrator(x, u):
    return np.array([x[1], u[0]])


def bryson_denham(N=50, limit=0.1, force=np.inf):
    """A particle thrown at a wall that it must not pass `limit` of, back where it came from after a second."""
    dynamics = FunctionDynamics(_double_integrator, 2, 1, 1.0 / N, control_limits=(-force, force))
    goal = [0.0, -1.0]
    return Problem(
        dynamics, N, [0.0, 1.0], [Control(1.0)],
        constraints=[State(None, [limit, np.inf], name="wall"), State(goal, goal, "terminal", name="goal")],
    )  # fmt: skip


@njit(cache=True)
def _cart_pole(x, u):
    sine, cosine, turn = np.sin(x[1]), np.cos(x[1]), x[3]
    mass, pole, length, g = 1.0, 0.1, 0.5, 9.81
    # x[1] = 0 hangs
    push = u[0] + pole * sine * (length * turn * turn + g * cosine)
    cart = push / (mass + pole * sine * sine)
    swing = -(cart * cosine + g * sine) / length
    return np.array([x[2], turn, cart, swing])


def cart_pole(force=5.0, track=0.5):
    """A pole swung up from hanging to standing on a short track."""
    dynamics = FunctionDynamics(_cart_pole, 4, 1, 0.04, control_limits=(-force, force))
    goal = [0.0, np.pi, 0.0, 0.0]
    wide = np.array([track, np.inf, np.inf, np.inf])
    return Problem(
        dynamics, 75, np.zeros(4), [Control(1.0)],
        constraints=[State(-wide, wide, name="track"), State(goal, goal, "terminal", name="goal")],
    )  # fmt: skip


@njit(cache=True)
def _quadrotor(x, u):
    m, inertia, arm, g = 0.5, 0.005, 0.15, 9.81
    thrust = (u[0] + u[1]) / m
    return np.array(
        [x[3], x[4], x[5], -thrust * np.sin(x[2]), thrust * np.cos(x[2]) - g, arm * (u[1] - u[0]) / inertia]
    )


@njit(cache=True)
def _outside_of_discs(x, u, t, p):
    out = np.empty(p.size // 3, dtype=x.dtype)
    for i in range(out.size):
        dx, dy, r = x[0] - p[3 * i], x[1] - p[3 * i + 1], p[3 * i + 2]
        out[i] = r * r - dx * dx - dy * dy
    return out


def quadrotor():
    """A planar quadrotor that flies three metres past two discs, from rest to rest."""
    dynamics = FunctionDynamics(_quadrotor, 6, 2, 0.05, control_limits=(0.0, 4.5))
    goal = [3.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    hover = 0.5 * 0.5 * 9.81
    return Problem(
        dynamics, 60, np.zeros(6), [Control(1.0, hover)], U0=np.full(2, hover),
        constraints=[
            Path(_outside_of_discs, when="always", parameters=[1.0, 0.3, 0.4, 2.0, -0.3, 0.45], name="discs"),
            State(goal, goal, "terminal", name="goal"),
        ],
    )  # fmt: skip


@njit(cache=True)
def _bicycle(x, u):
    return np.array([x[3] * np.cos(x[2]), x[3] * np.sin(x[2]), x[3] * np.tan(u[1]) / 0.5, u[0]])


def car(discs=(1.0, 0.5, 0.35, 2.0, 1.3, 0.4, 1.3, 1.8, 0.4)):
    """A car that parks past three discs."""
    dynamics = FunctionDynamics(_bicycle, 4, 2, 0.1, control_limits=([-1.0, -0.5], [1.0, 0.5]))
    goal, fast = [2.5, 2.2, np.pi / 2.0, 0.0], [np.inf, np.inf, np.inf, 1.2]
    return Problem(
        dynamics, 60, np.zeros(4), [Control(1.0)], bounds=Bounds(x=(-np.array(fast), fast)),
        constraints=[
            Path(_outside_of_discs, when="always", parameters=discs, name="discs"),
            State(goal, goal, "terminal", name="goal"),
        ],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _reentry(x, u):
    v, angle, h = x[0] * 1e4, x[1], x[2] * 1e5
    radius = 20904000.0
    g = 32.172 * radius**2 / (radius + h) ** 2
    pressure = 0.002378 * np.exp(-h / 22000.0) * v * v * 0.26245
    sine = np.sin(u[0])
    lift, drag = 0.6 * np.sin(2.0 * u[0]) * pressure, (0.27 + 1.82 * sine * sine) * pressure
    return np.array(
        [
            (-drag - g * np.sin(angle)) / 1e4,
            lift / v + (v / (radius + h) - g / v) * np.cos(angle),
            v * np.sin(angle) / 1e5,
        ]
    )


@njit(cache=True)
def _load(x, u, t):
    v, h = x[0] * 1e4, x[2] * 1e5
    pressure = 0.002378 * np.exp(-h / 22000.0) * v * v * 0.26245
    sine = np.sin(u[0])
    lift, drag = 0.6 * np.sin(2.0 * u[0]) * pressure, (0.27 + 1.82 * sine * sine) * pressure
    return np.sqrt(lift * lift + drag * drag) / 32.172 - 5.0


def nominal_reentry():
    """The angles of attack that the thesis starts from. Shape (300, 1). [rad]"""
    t = np.arange(300.0)
    angles = np.interp(t, [0.0, 59.412, 86.964, 300.0], [28.248, 28.248, -6.928, 7.399])
    return np.radians(angles)[:, None]


def reentry():
    """A lifting vehicle that returns from orbit to level flight within 5 g, near a nominal angle of attack."""
    dynamics = FunctionDynamics(_reentry, 3, 1, 1.0, control_limits=(np.radians(-30.0), np.radians(22.5)))
    nominal = nominal_reentry()
    return Problem(
        dynamics, 300, [3.6, np.radians(-7.5), 4.0], [Control(1.0, nominal)], U0=nominal,
        constraints=[Path(_load, name="load"), Terminal(lambda x: x[1], name="level")],
    )  # fmt: skip


@njit(cache=True)
def _three_links(x, u):
    """Uniform rods of 0.4, 0.4, 0.3 m and 1, 0.8, 0.5 kg in a vertical plane, joints damped by 0.5 Nms/rad."""
    length, mass = (0.4, 0.4, 0.3), (1.0, 0.8, 0.5)
    beyond = (1.3, 0.5, 0.0)  # masses of the links after each
    angle, turn = np.empty_like(x[:3]), np.empty_like(x[:3])
    angle[0], turn[0] = x[0], x[3]
    for i in range(1, 3):
        angle[i], turn[i] = angle[i - 1] + x[i], turn[i - 1] + x[3 + i]
    M, b = np.empty((3, 3), x.dtype), np.empty_like(angle)
    for i in range(3):
        lever = 0.5 * mass[i] * length[i] + length[i] * beyond[i]
        b[i] = u[i] - 0.5 * x[3 + i] - (u[i + 1] - 0.5 * x[4 + i] if i < 2 else 0.0) - 9.81 * lever * np.cos(angle[i])
        for j in range(3):
            far, near = max(i, j), min(i, j)
            inertia = length[near] * (0.5 * mass[far] * length[far] + length[far] * beyond[far])
            if i == j:
                inertia = mass[i] * length[i] ** 2 / 3.0 + length[i] ** 2 * beyond[i]
            M[i, j] = inertia * np.cos(angle[i] - angle[j])
            b[i] -= inertia * np.sin(angle[i] - angle[j]) * turn[j] * turn[j]
    for k in range(2):
        for i in range(k + 1, 3):
            factor = M[i, k] / M[k, k]
            for j in range(k, 3):
                M[i, j] -= factor * M[k, j]
            b[i] -= factor * b[k]
    third = b[2] / M[2, 2]
    second = (b[1] - M[1, 2] * third) / M[1, 1]
    first = (b[0] - M[0, 1] * second - M[0, 2] * third) / M[0, 0]
    return np.array([x[3], x[4], x[5], first, second - first, third - second])


@njit(cache=True)
def _hand_outside(x, u, t, p):
    a, b, c = x[0], x[0] + x[1], x[0] + x[1] + x[2]
    dx = 0.4 * np.cos(a) + 0.4 * np.cos(b) + 0.3 * np.cos(c) - p[0]
    dy = 0.4 * np.sin(a) + 0.4 * np.sin(b) + 0.3 * np.sin(c) - p[1]
    return np.array([p[2] * p[2] - dx * dx - dy * dy])


def _hand_at_rest(x):
    a, b, c = x[0], x[0] + x[1], x[0] + x[1] + x[2]
    hand = 0.4 * np.cos(a) + 0.4 * np.cos(b) + 0.3 * np.cos(c), 0.4 * np.sin(a) + 0.4 * np.sin(b) + 0.3 * np.sin(c)
    return np.array([hand[0] - 0.35, hand[1] - 0.75, x[3], x[4], x[5]])


def arm():
    """An arm of three links that swings its hand up past a disc. FACTS' problem leaves its cost and gravity open."""
    torque, reach = np.array([18.0, 10.0, 4.0]), np.array([1.7, 2.4, 2.4, np.inf, np.inf, np.inf])
    dynamics = FunctionDynamics(_three_links, 6, 3, 0.02, control_limits=(-torque, torque))
    return Problem(
        dynamics, 60, [-1.2, 0.5, 0.3, 0.0, 0.0, 0.0], [Control(np.diag(1.0 / torque))],
        constraints=[
            State(-reach, reach, name="joints"),
            Path(_hand_outside, when="always", parameters=[0.85, 0.25, 0.18], name="disc"),
            Terminal(_hand_at_rest, name="hand"),
        ],
    )  # fmt: skip
