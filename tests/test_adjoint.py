"""Costates under feedback, a few steps at a time, against plain loops over all Jacobians."""

import numpy as np
import pytest
from numba import njit
from test_rollouts import ENGINES

from mjslq import FunctionDynamics, MujocoDynamics
from mjslq.dynamics.dynamics import Dynamics
from mjslq.dynamics.function import Integrator
from mjslq.lq.adjoint import FIXED, FREE, LOWER, UPPER

N = 45


def plain(linearization, q, r, K, y, sides):
    """The recursion at the head of `lq.adjoint`, step by step."""
    A, B, C, D = linearization
    costates, gradient, held = np.zeros_like(q), np.zeros_like(r), np.zeros(r.shape, bool)
    costates[N] = q[N] + C[N].T @ y[N]
    for n in reversed(range(N)):
        w = gradient[n] = r[n] + D[n].T @ y[n] + B[n].T @ costates[n + 1]
        held[n] = (sides[n] == FIXED) | ((sides[n] == LOWER) & (w > 0)) | ((sides[n] == UPPER) & (w < 0))
        costates[n] = q[n] + C[n].T @ y[n] + A[n].T @ costates[n + 1] - K[n].T @ np.where(held[n], 0.0, w)
    return costates, gradient, held


def case(dynamics, seed=0):
    rng = np.random.default_rng(seed)
    start = dynamics.integrate(
        getattr(dynamics, "initial_state", np.zeros(dynamics.nx)), 0.1 * rng.normal(size=dynamics.ndx)
    )
    trajectory = dynamics.rollout(start, 0.1 * rng.normal(size=(N, dynamics.nu)))
    shapes = (N + 1, dynamics.ndx), (N, dynamics.nu), (N, dynamics.nu, dynamics.ndx), (N + 1, dynamics.ny)
    q, r, K, y = (rng.normal(size=shape) for shape in shapes)
    sides = rng.choice(np.array([FREE, LOWER, UPPER, FIXED], np.int8), size=r.shape)
    return trajectory, q, r, 0.1 * K, y, sides


def check(dynamics, arguments):
    trajectory, q, r, K, y, sides = arguments
    wanted = plain(dynamics.linearize(trajectory), q, r, K, y, sides)
    ours = dynamics.adjoint(trajectory, q, r, K, y, sides)
    for mine, other in zip(ours, wanted, strict=True):
        np.testing.assert_allclose(mine, other, rtol=0, atol=1e-9 * max(1.0, np.abs(other).max()))
    np.testing.assert_array_equal(ours.held, wanted[2])


@pytest.mark.parametrize("engine", [name for name in ENGINES if "threads" not in name])
def test_slices_are_the_whole(engine):
    dynamics = ENGINES[engine]()
    check(dynamics, case(dynamics))


def test_held_controls_and_substeps():
    xml = """<mujoco><option timestep="0.01"/><worldbody><body><joint name="a" axis="0 1 0" damping=".1"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1"/><site name="tip" pos="0 0 -.5"/></body></worldbody>
    <actuator><motor joint="a"/></actuator><sensor><framepos objtype="site" objname="tip"/></sensor></mujoco>"""
    dynamics = MujocoDynamics.from_xml(xml, substeps=3, jacobian="transition")
    check(dynamics, case(dynamics))


@njit
def timed(x, u, t):
    out = np.empty_like(x)
    out[0] = x[1] * (1.0 + t) + u[1]
    out[1] = u[0] - np.sin(x[0]) * (2.0 + t * t) - 0.1 * x[1] * x[2]
    out[2] = x[0] * x[1] + u[1] * u[0]
    out[3] = x[2] - x[3]
    return out


@njit
def timed_pullback(x, u, t, p, w):
    return np.array(
        [-w[1] * np.cos(x[0]) * (2.0 + t * t) + w[2] * x[1], w[0] * (1.0 + t) - 0.1 * w[1] * x[2] + w[2] * x[0],
         -0.1 * w[1] * x[1] + w[3], -w[3], w[1] + w[2] * u[1], w[0] + w[2] * u[0]]
    )  # fmt: skip


@pytest.mark.parametrize("integrator", Integrator.__args__)
def test_pullbacks_serve_every_integrator_and_time(integrator):
    """Steps of different lengths, a function of time: each slice knows when it is."""
    dt = np.linspace(0.01, 0.03, N)
    with_pullback, without = (
        FunctionDynamics(timed, 4, 2, dt, integrator=integrator, pullback=back) for back in (timed_pullback, None)
    )
    trajectory, q, r, K, y, sides = case(without)
    check(without, (trajectory, q, r, K, y, sides))
    for gains, at in ((None, None), (K, None), (K, sides)):
        ours = with_pullback.adjoint(trajectory, q, r, gains, None, at)
        slow = Dynamics.adjoint(without, trajectory, q, r, gains, None, at)
        for mine, other in zip(ours, slow, strict=True):
            np.testing.assert_allclose(mine, other, rtol=0, atol=1e-12 * max(1.0, np.abs(other).max()))


@pytest.mark.parametrize(
    "f, back, said",
    [(timed, lambda x, u, t, p, w: w, "must be compiled itself"), (lambda x, u: x, timed_pullback, "compiled"),
     (timed, njit(lambda x, u, t, p, w: w), r"must return .* of shape \(6,\), got \(4,\)"),
     (timed, njit(lambda x, u: x), "pullback.* fails")],
)  # fmt: skip
def test_wrong_pullbacks_are_refused(f, back, said):
    with pytest.raises(ValueError, match=said):
        FunctionDynamics(f, 4, 2, 0.1, pullback=back)
