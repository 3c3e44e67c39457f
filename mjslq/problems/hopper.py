"""The gas-actuated hopping machine (Sideris and Bobrow 2005, section 4.2, (66)).

    m y'' = F(y_p - y) - m g,    y_p' = u
    F(e) = 0 (e < 0),  k/(2 alpha) e^2 (e < alpha),  k e - k alpha/2 (beyond)        a spring, smoothed at touch-down

    J = 1/2 q_final (y_N - height)^2 + ydot_N^2 + t_f/(2N) sum_n [ q y_p,n^2 + r u_n^2 ]

y is the height of the mass, y_p the unstretched length of the spring (how far the piston reaches down), u the flow
of gas. Units: inch and second; m = 1. The machine starts at rest on its unstretched spring, pumps itself up over
several stances and leaves the ground. Stance and flight follow from the dynamics; nobody tells when they change.

Reported: convergence in 3 iterations at height 1 to 166 at height 50, and none for alpha below 1e-5. Semi-implicit
Euler, MuJoCo's own, reproduces these counts; explicit Euler does not.
"""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.bounds import Bounds
from mjslq.constraints import State
from mjslq.costs import Tracking
from mjslq.dynamics.dynamics import Dynamics
from mjslq.problem import Problem
from mjslq.problems.assets import load_asset
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.validation import choose, count, finite, nonnegative, positive

if TYPE_CHECKING:
    import mujoco

    from mjslq.dynamics.function import FunctionDynamics, Integrator

FAR = 1e6
"""Upper end of the springs' dead bands: never reached. [in]"""
PAPER_ITERATIONS = {1.0: 3, 50.0: 166}
"""Iterations that the paper reports, by height."""


def hopper(
    height: float = 20.0,
    horizon: int = 100,
    duration: float = 1.0,
    stiffness: float = 500.0,
    alpha: float = 0.1,
    gravity: float = 386.4,
    q_final: float = 1000.0,
    q: float = 1000.0,
    r: float = 1.0,
    engine: str = "mujoco",
    integrator: Integrator = "semi-implicit-euler",
    stroke: float = 0.0,
    flow: float = 0.0,
) -> Problem:
    """Reach `height` [in] at time `duration` [s] with little speed and little gas.

    `stiffness` is k/m [1/s^2], `alpha` the smoothing length [in], `gravity` in [in/s^2]; q_final, q, r weigh the
    height reached, the piston's stroke and the gas. `engine` is "mujoco" (state y, y_p, and their velocities) or
    "function" (state y, y_p, ydot; there `integrator` may also be "euler"). Not of the paper: the piston's travel
    |y_p| within `stroke` [in], the flow of gas |u| within `flow` [in/s]; 0 for none.
    """
    N, dt = count("horizon", horizon), positive("duration", duration) / horizon
    for name, value in (("stiffness", stiffness), ("alpha", alpha), ("gravity", gravity)):
        positive(name, value)
    choose("engine", engine, ("mujoco", "function"))
    choose("integrator", integrator, ("semi-implicit-euler", "euler"))
    scene: Scene | None
    if engine == "mujoco":
        if integrator != "semi-implicit-euler":
            raise ValueError("integrator must be 'semi-implicit-euler' with engine='mujoco', whose Euler it is")
        dynamics, scene = mujoco_dynamics(stiffness, alpha, gravity, dt), None
    else:
        dynamics, scene = function_dynamics(stiffness, alpha, gravity, dt, integrator), _scene()
    Q, Q_final, target = (np.zeros(dynamics.nx) for _ in range(3))
    Q[1] = dt * positive("q", q)
    Q_final[0], Q_final[2] = positive("q_final", q_final), 2.0  # (66) has no 1/2 before ydot^2
    target[0] = finite("height", height)
    most, far = nonnegative("flow", flow), np.full(dynamics.nx, np.inf)
    far[1] = nonnegative("stroke", stroke) or np.inf
    return Problem(
        dynamics=dynamics,
        horizon=N,
        x0=np.zeros(dynamics.nx),
        costs=[Tracking(Q, dt * positive("r", r), Q_final, x_target=target)],
        constraints=[State(-far, far, name="stroke")] if stroke else [],
        bounds=Bounds(u=(-most, most)) if flow else None,
        # Gauss-Newton ends slowly here (the piston's stroke is a large residual); four digits of the controls do.
        # Feedback keeps the instants of touch-down where they are while the controls change.
        options={"tol_direction": 1e-4, "step": "closed-loop"},
        describe=partial(describe, height=height),
        drawing=scene,
    )


def function_dynamics(
    stiffness: float, alpha: float, gravity: float, dt: float, integrator: Integrator
) -> FunctionDynamics:
    """The equations above, state (y, y_p, ydot)."""
    from mjslq.dynamics.function import FunctionDynamics

    return FunctionDynamics(
        _compiled_equations(), 3, 1, dt, integrator=integrator, parameters=[stiffness, alpha, gravity],
        state_names=("y", "piston", "y.vel"), control_names=("gas",),
    )  # fmt: skip


def mujoco_dynamics(stiffness: float, alpha: float, gravity: float, dt: float) -> Dynamics:
    """The same machine as an MJCF model, state (y, y_p, ydot, y_p')."""
    from mjslq.dynamics.mujoco import MujocoDynamics

    return MujocoDynamics.from_spec(hopper_spec(stiffness, alpha, gravity, dt))


def hopper_spec(
    stiffness: float = 500.0, smoothing: float = 0.1, gravity: float = 386.4, timestep: float = 0.01
) -> mujoco.MjSpec:
    """Load the hopping machine of assets/hopper.xml, which explains the construction.

    Parameters
    ----------
    stiffness
        Spring constant over mass, k / m. [1/s^2]
    smoothing
        Compression alpha below which the spring is quadratic. [in]  Small values cost digits: the force is exact
        to about 1e-16 / alpha relative to the compression.
    gravity
        Gravitational acceleration g. [in/s^2]
    timestep
        Step length h. [s]
    """
    stiffness, smoothing = positive("stiffness", stiffness), positive("smoothing", smoothing)
    spec = load_asset("hopper.xml", timestep)
    spec.option.gravity = [0.0, 0.0, -positive("gravity", gravity)]
    curvature = stiffness / (2.0 * smoothing)
    for name, lower, sign in (("spring", 0.0, -1.0), ("smoothing", -smoothing, 1.0)):
        tendon = spec.tendon(name)
        tendon.springlength = [lower, FAR]
        tendon.stiffness = [0.0, sign * curvature, 0.0]
    drive = spec.joint("piston").armature / spec.option.timestep
    actuator = spec.actuator("piston")
    actuator.gainprm[0], actuator.biasprm[2] = drive, -drive
    return spec


def phases(X: np.ndarray) -> list[str]:
    """Name the phases, stance or flight, in the order in which they occur; contact is y < y_p. X: (N + 1, nx)."""
    sequence: list[str] = []
    for y, piston in X[1:, :2]:  # at the start the spring is just unloaded, which is neither
        phase = "stance" if y < piston else "flight"
        if not sequence or sequence[-1] != phase:
            sequence.append(phase)
    return sequence


def describe(trajectory: Trajectory, height: float) -> dict[str, str]:
    """Summary of a hop: the height reached, phases of stance and flight, stroke and flow."""
    y, speed = trajectory.X[-1, 0], trajectory.X[-1, 2]
    return {
        "height": f"{y:.3f} in of {height:g} in ({100.0 * (y / height - 1.0):+.2f} %), speed {speed:+.2f} in/s",
        "phases": ", ".join(phases(trajectory.X)),
        "piston": f"{np.abs(trajectory.X[:, 1]).max():.4f} in at most, flow {np.abs(trajectory.U).max():.3f} in/s",
    }


def _scene() -> Scene | None:
    return mujoco_dynamics(500.0, 0.1, 386.4, 0.01).scene()


@cache
def _compiled_equations() -> Any:
    import numba

    return numba.njit(cache=True)(_equations)


def _equations(x, u, t, p):
    stiffness, alpha, gravity = p[0], p[1], p[2]
    e = x[1] - x[0]
    out = np.empty_like(x)
    out[0] = x[2]
    out[1] = u[0]
    out[2] = -gravity
    if e.real >= alpha:
        out[2] += stiffness * (e - 0.5 * alpha)
    elif e.real > 0.0:
        out[2] += stiffness / (2.0 * alpha) * e * e
    return out
