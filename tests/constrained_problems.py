"""Problems with constraints whose optima are known, for the tests of methods that take constraints.

They are those of the catalogue, with the starts that the tests were written for.
"""

import numpy as np
from numba import njit

from mjslq import FunctionDynamics, Problem, problems
from mjslq.constraints import Path, State, Terminal
from mjslq.costs import Control
from mjslq.problems.reentry import nominal_angles as nominal_reentry  # noqa: F401


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


def bryson_denham(N=50, limit=0.1, force=np.inf):
    """A particle thrown at a wall that it must not pass `limit` of, back where it came from after a second."""
    force = force if np.isfinite(force) else 0.0
    return problems.get("bryson_denham", horizon=N, limit=limit, force=force, start=0.0)


def cart_pole(force=5.0, track=0.5):
    """A pole swung up from hanging to standing on a short track."""
    return problems.get("cart_pole_track", force=force, track=track)


def quadrotor():
    """A planar quadrotor that flies three metres past two discs, from rest to rest."""
    return problems.get("quadrotor_obstacles")


def car(discs=(1.0, 0.5, 0.35, 2.0, 1.3, 0.4, 1.3, 1.8, 0.4)):
    """A car that parks past three discs."""
    return problems.get("car_obstacles", discs=discs)


def reentry():
    """A lifting vehicle that returns from orbit to level flight within 5 g, near a nominal angle of attack."""
    return problems.get("reentry", variant="tracking")


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
    """An arm of three damped links that swings its hand up past a disc; torques weigh by their limits."""
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
