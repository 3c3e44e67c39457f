"""The models under assets: the hopping machine and the particle in drag are what their equations say."""

import mujoco
import numpy as np
import pytest

from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.problems.assets import asset_path
from mjslq.problems.drag_particle import drag_spec
from mjslq.problems.hopper import hopper_spec


def spring(e, k, alpha):
    return 0.0 if e < 0 else k / (2 * alpha) * e * e if e < alpha else k * e - k * alpha / 2


def slope(e, k, alpha):
    return 0.0 if e < 0 else k / alpha * e if e < alpha else k


def hop(N=150):
    return 20.0 * np.sin(0.12 * np.arange(N))[:, None]


def direct_hop(U, k, alpha, g, h):
    """Semi-implicit Euler by hand; states in MuJoCo's order (y, y_p, y', y_p')."""
    y = v = p = 0.0
    X = [(0.0, 0.0, 0.0, 0.0)]
    for (u,) in U:
        v += h * (spring(p - y, k, alpha) - g)
        y += h * v
        p += h * u
        X.append((y, p, v, u))
    return np.array(X)


@pytest.mark.parametrize("alpha, tolerance", [(0.1, 1e-12), (1e-2, 1e-11), (1e-4, 1e-10), (1e-6, 2e-9), (1e-8, 1e-6)])
def test_hopper_is_the_equations(alpha, tolerance):
    U = hop()
    dynamics = MujocoDynamics.from_spec(hopper_spec(smoothing=alpha))
    trajectory = dynamics.rollout(dynamics.keyframe("rest"), U)
    X = direct_hop(U, 500.0, alpha, 386.4, 0.01)
    contact = X[:, 1] > X[:, 0]
    assert np.count_nonzero(np.diff(contact)) >= 4  # stance, flight, stance, flight, stance
    assert np.abs(trajectory.X - X).max() < tolerance * np.abs(X).max()
    np.testing.assert_array_equal(trajectory.Y, trajectory.X[:, [0, 2, 1]])


def test_hopper_parameters():
    U = hop(60)
    dynamics = MujocoDynamics.from_spec(hopper_spec(stiffness=300.0, smoothing=0.3, gravity=100.0, timestep=0.004))
    trajectory = dynamics.rollout(dynamics.keyframe("rest"), U)
    X = direct_hop(U, 300.0, 0.3, 100.0, 0.004)
    assert np.abs(trajectory.X - X).max() < 1e-12 * np.abs(X).max()


def test_hopper_file_has_the_defaults():
    built, plain = hopper_spec().compile(), mujoco.MjModel.from_xml_path(str(asset_path("hopper.xml")))
    for name in (
        "tendon_lengthspring",
        "tendon_stiffness",
        "tendon_stiffnesspoly",
        "actuator_gainprm",
        "actuator_biasprm",
    ):
        np.testing.assert_array_equal(getattr(built, name), getattr(plain, name))


@pytest.mark.parametrize("alpha, tolerance", [(0.1, 1e-7), (1e-2, 1e-6), (1e-4, 1e-4)])
def test_hopper_jacobians_are_the_equations(alpha, tolerance):
    dynamics = MujocoDynamics.from_spec(hopper_spec(smoothing=alpha))
    trajectory = dynamics.rollout(dynamics.keyframe("rest"), hop())
    h, k = 0.01, 500.0
    result = dynamics.linearize(trajectory)
    for n, x in enumerate(trajectory.X[:-1]):
        e = x[1] - x[0]
        if min(abs(e), abs(e - alpha)) < 3e-6:
            continue  # the differences straddle a kink of the slope
        s = slope(e, k, alpha)
        velocity = np.array([-h * s, h * s, 1.0, 0.0])
        A = np.array([[1, 0, 0, 0] + h * velocity, [0, 1, 0, 0], velocity, [0, 0, 0, 0]])
        assert np.abs(result.A[n] - A).max() < tolerance * max(1.0, h * k)
        assert np.abs(result.B[n] - [[0], [h], [0], [1]]).max() < 1e-8
    assert np.abs(result.C - np.eye(4)[[0, 2, 1]]).max() < 1e-8
    assert np.abs(result.D).max() < 1e-12


def test_drag_is_the_equations():
    beta, h, m = 0.3, 1.0 / 500.0, 0.0259
    dynamics = MujocoDynamics.from_spec(drag_spec(beta))
    U = 4.0 * np.sin(0.02 * np.arange(400))[:, None]
    x = v = 0.0
    X = [(x, v)]
    for (u,) in U:
        v += h / m * (u - beta * v * abs(v))
        x += h * v
        X.append((x, v))
    trajectory = dynamics.rollout(dynamics.keyframe("start"), U)
    np.testing.assert_allclose(trajectory.X, X, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(trajectory.Y, trajectory.X)
    A = dynamics.linearize(trajectory).A
    expected = 1.0 - 2.0 * h / m * beta * np.abs(np.array(X)[:-1, 1])
    np.testing.assert_allclose(A[:, 1, 1], expected, atol=1e-6)


def test_assets_are_listed():
    with pytest.raises(ValueError, match=r"unknown asset 'hoper.xml'; there are: .*hopper.xml"):
        asset_path("hoper.xml")


@pytest.mark.parametrize("call", [lambda: hopper_spec(smoothing=0.0), lambda: drag_spec(-1.0)])
def test_parameters_must_be_positive(call):
    with pytest.raises(ValueError, match="must be positive"):
        call()
