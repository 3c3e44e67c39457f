"""Five problems with constraints, by mjslq and by CasADi with Ipopt and Fatrop: iterations and seconds in one table.

Run with    python demos/peers_constrained.py [starts]        needs casadi: pip install "mjslq[peers]"

All solve the same discrete problem (Runge-Kutta steps, controls held, constraints at the knots) from the same controls;
CasADi by multiple shooting, its states started with the rollout of these controls. Functions are compiled on our side
and expanded into scalar operations on CasADi's; building and compiling are not timed.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import mjslq
from mjslq.problems import arm_obstacle, car_obstacles, quadrotor_obstacles

try:
    import casadi
except ImportError:
    casadi = None

SOLVERS = ("ipopt", "fatrop")
MOST = 1000
"""Iterations, of every solver."""


def bryson_denham(x: Any, u: Any) -> list[Any]:
    return [x[1], u[0]]


def cart_pole_track(x: Any, u: Any) -> list[Any]:
    sine, cosine = casadi.sin(x[1]), casadi.cos(x[1])
    cart = (u[0] + 0.1 * sine * (0.5 * x[3] ** 2 + 9.81 * cosine)) / (1.0 + 0.1 * sine**2)
    return [x[2], x[3], cart, -(cart * cosine + 9.81 * sine) / 0.5]


def quadrotor(x: Any, u: Any) -> list[Any]:
    thrust = (u[0] + u[1]) / 0.5
    turn = 0.15 * (u[1] - u[0]) / 0.005
    return [x[3], x[4], x[5], -thrust * casadi.sin(x[2]), thrust * casadi.cos(x[2]) - 9.81, turn]


def car(x: Any, u: Any) -> list[Any]:
    return [x[3] * casadi.cos(x[2]), x[3] * casadi.sin(x[2]), x[3] * casadi.tan(u[1]) / 0.5, u[0]]


def arm(x: Any, u: Any) -> list[Any]:
    length, m = np.array(arm_obstacle.LENGTHS), np.array(arm_obstacle.MASSES)
    beyond = np.array([m[1:].sum(), m[2:].sum(), 0.0])
    f, w = [x[0], x[0] + x[1], x[0] + x[1] + x[2]], [x[3], x[3] + x[4], x[3] + x[4] + x[5]]
    M, rest = casadi.SX.zeros(3, 3) if isinstance(x, casadi.SX) else casadi.MX.zeros(3, 3), []
    for i in range(3):
        rest.append(u[i] - (u[i + 1] if i < 2 else 0.0))
        rest[i] -= 9.81 * length[i] * (0.5 * m[i] + beyond[i]) * casadi.cos(f[i])
        M[i, i] = m[i] * length[i] ** 2 / 3.0 + length[i] ** 2 * beyond[i]
        for j in range(3):
            if j != i:
                low, high = min(i, j), max(i, j)
                a = length[low] * length[high] * (0.5 * m[high] + beyond[high])
                M[i, j] = a * casadi.cos(f[i] - f[j])
                rest[i] -= a * casadi.sin(f[i] - f[j]) * w[j] ** 2
    turn = casadi.solve(M, casadi.vertcat(*rest))
    return [x[3], x[4], x[5], turn[0], turn[1] - turn[0], turn[2] - turn[1]]


def hand(x: Any) -> tuple[Any, Any]:
    f = [x[0], x[0] + x[1], x[0] + x[1] + x[2]]
    pairs = list(zip(arm_obstacle.LENGTHS, f, strict=True))
    return sum(a * casadi.cos(b) for a, b in pairs), sum(a * casadi.sin(b) for a, b in pairs)


def discs(obstacles: Any, of: Callable[[Any], Any] = lambda x: (x[0], x[1])) -> Callable[[Any], list[Any]]:
    """h(x) <= 0 outside of all discs."""

    def h(x: Any) -> list[Any]:
        a, b = of(x)
        return [r * r - (a - p) ** 2 - (b - q) ** 2 for p, q, r in np.reshape(obstacles, (-1, 3))]

    return h


def end_of_arm(x: Any) -> list[Any]:
    a, b = hand(x)
    return [a - 0.35, b - 0.75, x[3], x[4], x[5]]


PEERS: dict[str, dict[str, Any]] = {
    "bryson_denham": {"f": bryson_denham, "h": lambda x: [x[0] - 0.1], "m": lambda x: [x[0], x[1] + 1.0]},
    "cart_pole_track": {
        "f": cart_pole_track,
        "h": lambda x: [x[0] - 0.5, -0.5 - x[0]],
        "m": lambda x: [x[0], x[1] - np.pi, x[2], x[3]],
    },
    "quadrotor_obstacles": {
        "f": quadrotor,
        "h": discs(quadrotor_obstacles.DISCS),
        "m": lambda x: [x[i] - (3.0 if i == 0 else 0.0) for i in range(6)],
        "target": 0.25 * 9.81,
    },
    "car_obstacles": {
        "f": car,
        "h": lambda x: [*discs(car_obstacles.DISCS)(x), x[3] - 1.2, -1.2 - x[3]],
        "m": lambda x: [x[i] - car_obstacles.GOAL[i] for i in range(4)],
    },
    "arm_obstacle": {
        "f": arm,
        "h": lambda x: [
            *discs(arm_obstacle.DISC, hand)(x),
            *[sign * x[i] - arm_obstacle.RANGES[i] for i in range(3) for sign in (1.0, -1.0)],
        ],
        "m": end_of_arm,
    },
}


def peer(name: str, problem: mjslq.Problem, solver: str) -> Callable[[Any], tuple[bool, int, float, float]]:
    """The problem in CasADi: a function of the controls to start from -> (solved, iterations, seconds, cost)."""
    parts, N, dt = PEERS[name], problem.horizon, float(np.min(problem.dynamics.dt))
    nx, nu, x0 = problem.dynamics.nx, problem.dynamics.nu, np.asarray(problem.x0)
    x, u = casadi.SX.sym("x", nx), casadi.SX.sym("u", nu)
    f = casadi.Function("f", [x, u], [casadi.vertcat(*parts["f"](x, u))])
    k1 = f(x, u)
    k2 = f(x + 0.5 * dt * k1, u)
    k3 = f(x + 0.5 * dt * k2, u)
    k4 = f(x + dt * k3, u)
    step = casadi.Function("step", [x, u], [x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)])
    inside = casadi.Function("h", [x], [casadi.vertcat(*parts["h"](x))])
    end = casadi.Function("m", [x], [casadi.vertcat(*parts["m"](x))])
    opti, X, U = casadi.Opti(), [], []
    for n in range(N + 1):  # stage by stage, in the order that Fatrop looks for
        X.append(opti.variable(nx))
        if n < N:
            U.append(opti.variable(nu))
    lower, upper = problem.box.lower, problem.box.upper
    for n in range(N + 1):
        if n < N:
            opti.subject_to(X[n + 1] == step(X[n], U[n]))
        if n == 0:
            opti.subject_to(X[0] == x0)
        elif n < N:
            opti.subject_to(inside(X[n]) <= 0.0)
        else:
            opti.subject_to(end(X[N]) == 0.0)
        if n < N and np.isfinite(lower).all():
            opti.subject_to(opti.bounded(lower[n], U[n], upper[n]))
    off = [v - parts.get("target", 0.0) for v in U]
    opti.minimize(0.5 * dt * sum(casadi.dot(v, v) for v in off))
    quiet = {"ipopt": {"print_level": 0, "sb": "yes", "max_iter": MOST}, "fatrop": {"print_level": 0, "max_iter": MOST}}
    options: dict[str, Any] = {"expand": True, "print_time": False, solver: quiet[solver]}
    if solver == "fatrop":
        options["structure_detection"] = "auto"
    opti.solver(solver, options)

    def run(start: Any) -> tuple[bool, int, float, float]:
        trajectory = problem.rollout(start)
        for n in range(N + 1):
            opti.set_initial(X[n], trajectory.X[n])
            if n < N:
                opti.set_initial(U[n], trajectory.U[n])
        began = time.perf_counter()
        try:
            opti.solve_limited()
        except RuntimeError:  # Fatrop raises where it fails
            return False, 0, time.perf_counter() - began, np.nan
        seconds, stats = time.perf_counter() - began, opti.stats()
        return bool(stats["success"]), int(stats["iter_count"]), seconds, float(opti.debug.value(opti.f))

    return run


def starts(problem: mjslq.Problem, count: int) -> list[Any]:
    """The problem's own start, then white noise and smooth curves between the limits, in turns."""
    rng, N, nu = np.random.default_rng(0), problem.horizon, problem.dynamics.nu
    lower, upper = (np.where(np.isfinite(side), side, 5.0 * sign) for side, sign in
                    ((problem.box.lower, -1.0), (problem.box.upper, 1.0)))  # fmt: skip
    found, tau = [np.asarray(problem.U0)], np.arange(N)[:, None] / N
    while len(found) < count:
        wave = 0.5 + 0.5 * np.sin(2.0 * np.pi * (rng.uniform(0.3, 2.0, nu) * tau + rng.uniform(size=nu)))
        found.append(lower + (rng.uniform(size=(N, nu)) if len(found) % 2 else wave) * (upper - lower))
    return found[:count]


def ours(problem: mjslq.Problem, start: Any) -> tuple[bool, int, float, float]:
    result = mjslq.solve(problem, U0=start, max_iterations=MOST, keep_iterates=False)
    return result.success, result.iterations, result.seconds, result.cost


def row(name: str, by: str, found: list[tuple[bool, int, float, float]]) -> str:
    solved = [entry for entry in found if entry[0]]
    text = f"{name:20} {by:8} {len(solved):3d} of {len(found)}"
    if not solved:
        return f"{text}          -          -              -"
    iterations, seconds, costs = (np.array(column) for column in list(zip(*solved, strict=True))[1:])
    return f"{text}   {np.median(iterations):8.0f}   {np.median(seconds):8.3f}   {costs.min():9.5f} {costs.max():9.5f}"


def main(count: int = 3, names: tuple[str, ...] = tuple(PEERS)) -> None:
    if casadi is None:
        print('This comparison needs CasADi: pip install "mjslq[peers]".')
        return
    print("problem              by        solved   iterations    seconds   cost from        to   (medians of those)")
    for name in names:
        problem = mjslq.problems.get(name)
        begin = starts(problem, count)
        mjslq.solve(problem, max_iterations=30)  # compiles
        print(row(name, "mjslq", [ours(problem, start) for start in begin]), flush=True)
        for solver in SOLVERS:
            run = peer(name, problem, solver)
            print(row(name, solver, [run(start) for start in begin]), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
