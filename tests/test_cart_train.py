"""The train of carts with pendulums: both models agree, derivatives, terminal weight, and what can be set."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import mjslq
from mjslq.dynamics.dynamics import Dynamics
from mjslq.problems import cart_train as module
from mjslq.problems.cart_train_model import Train, mjcf, mujoco_dynamics

H = 0.02


def motion(dynamics, steps=40, seed=0):
    rng = np.random.default_rng(seed)
    return dynamics.rollout(0.4 * rng.normal(size=dynamics.nx), rng.normal(size=(steps, dynamics.nu)))


@pytest.mark.parametrize("carts", [1, 2, 5])
def test_function_and_mjcf_are_the_same_train(carts):
    function, mujoco = module.function_dynamics(Train(carts), H), mujoco_dynamics(Train(carts), H)
    assert sorted(function.state_names) == sorted(mujoco.state_names) and function.nx == 4 * carts
    ours = motion(function)
    theirs = mujoco.rollout(ours.X[0], ours.U)
    np.testing.assert_allclose(theirs.X, ours.X, rtol=0, atol=1e-12 * np.abs(ours.X).max())
    assert np.abs(ours.X[:, 1]).max() > 0.5  # far from upright
    for name in "AB":
        mine, other = (getattr(engine.linearize(ours), name) for engine in (function, mujoco))
        np.testing.assert_allclose(other, mine, rtol=0, atol=1e-12 * np.abs(mine).max())


def test_couplings_are_tendons_with_springs_and_dampers():
    model = mujoco_dynamics(Train(4), H).model
    assert model.ntendon == 3 and (model.tendon_stiffness > 0.0).all() and (model.tendon_damping > 0.0).all()
    assert mjcf(Train(4), H).count("<spatial") == 3


@pytest.mark.parametrize("carts", [1, 3])
def test_pullback_is_the_transposed_jacobian(carts):
    dynamics, rng = module.function_dynamics(Train(carts), H), np.random.default_rng(1)
    trajectory = motion(dynamics)
    q, r = rng.normal(size=trajectory.X.shape), rng.normal(size=trajectory.U.shape)
    K = rng.normal(size=(len(r), carts, 4 * carts))
    for gains in (None, K):
        ours, slow = dynamics.adjoint(trajectory, q, r, gains), Dynamics.adjoint(dynamics, trajectory, q, r, gains)
        for name in ("costates", "gradient"):
            mine, other = getattr(ours, name), getattr(slow, name)
            np.testing.assert_allclose(mine, other, rtol=0, atol=1e-13 * np.abs(other).max())


def test_terminal_weight_solves_the_riccati_equation_of_the_whole_train():
    train = Train(3)
    dynamics = module.function_dynamics(train, H)
    A, B, _, _ = dynamics.linearize(dynamics.rollout(np.zeros(12), np.zeros((1, 3))))
    P = solve_discrete_are(A[0], B[0], H * np.diag(module.spread(module.STATE_WEIGHTS, 3)), 0.01 * H * np.eye(3))
    np.testing.assert_allclose(module.terminal_weight(train, H, 0.01), P, rtol=0, atol=1e-11 * np.abs(P).max())
    radius = np.abs(np.linalg.eigvals(A[0])).max()
    assert radius == pytest.approx(1.129, abs=1e-3)  # the open loop is unstable


def test_reference_swings_smoothly_between_plus_and_minus_theta():
    X = module.reference(Train(2), 0.5, 400, H)
    angles, speeds = X[:, 1:4:2], X[:, 5::2]
    assert angles.max() == pytest.approx(0.5) and angles.min() == pytest.approx(-0.5)
    assert not X[0].any() and not X[-1].any() and not X[:, :4:2].any() and not X[:, 4::2].any()
    np.testing.assert_allclose(np.gradient(angles, H, axis=0), speeds, atol=5e-3)


def test_a_train_of_two_hundred_carts_can_be_made():
    problem = mjslq.problems.get("cart_train", carts=200, horizon=5)
    assert problem.dynamics.nx == 800 and np.isfinite(problem.cost(problem.rollout(problem.U0)))


@pytest.mark.parametrize(
    "values, said",
    [({"carts": 0}, "carts must be a whole number of at least 1"), ({"carts": 201}, "carts must be at most 200"),
     ({"theta": -1.0}, "theta must be at least 0"), ({"engine": "bullet"}, "unknown engine 'bullet'"),
     ({"limit": -2.0}, "limit must be at least 0"), ({"effort": 0.0}, "effort must be positive")],
)  # fmt: skip
def test_wrong_values_are_refused(values, said):
    with pytest.raises(ValueError, match=said):
        mjslq.problems.get("cart_train", **values)


def test_limits_and_summary():
    problem = mjslq.problems.get("cart_train", limit=5.0)
    np.testing.assert_array_equal(problem.dynamics.control_limits, [[-5.0, 5.0]] * 2)
    assert "deg" in problem.describe(problem.rollout(problem.U0))["swing"]
