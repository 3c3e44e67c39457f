"""FunctionDynamics against plain loops: integrators, Jacobians, outputs, divergence, feedback."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from mjslq.dynamics.function import FunctionDynamics

seeds = st.integers(0, 2**32 - 1)
INTEGRATORS = ("map", "euler", "semi-implicit-euler", "rk4")
P = np.array([1.3, 0.4])


def pendulum(x, u, t, p):
    """Damped, driven and depending on time; the same text runs compiled."""
    out = np.empty_like(x)
    out[0] = x[1]
    out[1] = u[0] - p[0] * np.sin(x[0]) - p[1] * x[1] + 0.3 * np.cos(2.0 * t) * u[1]
    return out


def polynomial(x, u, t, p):
    """Without transcendental functions, whose last digit may differ between libraries."""
    out = np.empty_like(x)
    out[0] = x[1] + t * u[1]
    out[1] = u[0] - p[0] * x[0] + p[0] * x[0] * x[0] * x[0] / 6.0 - p[1] * x[1]
    return out


compiled_pendulum, compiled_polynomial = njit(pendulum), njit(polynomial)


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(4)
    return rng.standard_normal(2), 0.5 * rng.standard_normal((30, 2)), rng.uniform(0.01, 0.1, 30)


def reference_step(f, integrator, x, u, t, h, nv):
    if integrator == "map":
        return f(x, u, t)
    if integrator == "euler":
        return x + h * f(x, u, t)
    if integrator == "semi-implicit-euler":
        q, v = x[:-nv], x[-nv:]
        v_next = v + h * f(x, u, t)[-nv:]
        return np.concatenate([q + h * f(np.concatenate([q, v_next]), u, t)[:-nv], v_next])
    k1 = f(x, u, t)
    k2 = f(x + h / 2 * k1, u, t + h / 2)
    k3 = f(x + h / 2 * k2, u, t + h / 2)
    k4 = f(x + h * k3, u, t + h)
    return x + h * (k1 / 6 + k2 / 3 + k3 / 3 + k4 / 6)


def reference_rollout(f, integrator, x0, U, dt, nv=1):
    X, t = [x0], 0.0
    for u, h in zip(U, dt, strict=True):
        X.append(reference_step(f, integrator, X[-1], u, t, h, nv))
        t += h
    return np.array(X)


# Integrators


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_rollout_is_the_plain_loop(integrator, even, drive):
    x0, U, dt = drive
    dt = np.full(30, 0.05) if even else dt
    dynamics = FunctionDynamics(pendulum, 2, 2, 0.05 if even else dt, integrator=integrator, parameters=P)
    trajectory = dynamics.rollout(x0, U)
    expected = reference_rollout(lambda x, u, t: pendulum(x, u, t, P), integrator, x0, U, dt)
    np.testing.assert_allclose(trajectory.X, expected, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(trajectory.U, U)
    np.testing.assert_array_equal(trajectory.dt, dt)
    np.testing.assert_allclose(trajectory.times[1:], np.cumsum(dt))
    assert not trajectory.diverged


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_step_is_a_step_of_the_rollout(integrator, drive):
    x0, U, dt = drive
    dynamics = FunctionDynamics(
        pendulum, 2, 2, dt, integrator=integrator, parameters=P, outputs=lambda x, u, t: [x[0] + u[0] + t]
    )
    trajectory = dynamics.rollout(x0, U)
    for n in (0, 7, 29):
        ahead, outputs = dynamics.step(trajectory.X[n], U[n], n)
        np.testing.assert_allclose(ahead, trajectory.X[n + 1], rtol=1e-14)
        np.testing.assert_allclose(outputs, trajectory.Y[n], rtol=1e-14)


@pytest.mark.parametrize("nv", [1, 2])
def test_semi_implicit_euler_moves_the_last_nv_entries_first(nv):
    def f(x, u):
        return np.array([x[2] + x[1], u[0] - x[0], -x[0] * x[1] + u[0]])

    dynamics = FunctionDynamics(f, 3, 1, 0.1, integrator="semi-implicit-euler", nv=nv)
    x0, U = np.array([0.3, -0.2, 0.5]), np.linspace(-1, 1, 8)[:, None]
    expected = reference_rollout(lambda x, u, t: f(x, u), "semi-implicit-euler", x0, U, np.full(8, 0.1), nv)
    np.testing.assert_allclose(dynamics.rollout(x0, U).X, expected, rtol=1e-13)


@pytest.mark.parametrize("integrator, order", [("euler", 1), ("semi-implicit-euler", 1), ("rk4", 4)])
def test_order_of_the_integrator(integrator, order):
    """Halving the step divides the error by 2^order, controls held and time running."""

    def end(integrator, N):
        dynamics = FunctionDynamics(compiled_pendulum, 2, 2, 1.0 / N, integrator=integrator, parameters=P)
        return dynamics.rollout([1.0, 0.5], np.tile([0.7, 0.9], (N, 1))).X[-1]

    exact = end("rk4", 4096)
    errors = [np.linalg.norm(end(integrator, N) - exact) for N in (16, 32, 64)]
    for coarse, fine in itertools.pairwise(errors):
        assert abs(np.log2(coarse / fine) - order) < 0.15


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_compiled_is_plain_to_the_last_bit(integrator, drive):
    x0, U, dt = drive
    plain = FunctionDynamics(polynomial, 2, 2, dt, integrator=integrator, parameters=P)
    compiled = FunctionDynamics(compiled_polynomial, 2, 2, dt, integrator=integrator, parameters=P)
    assert compiled.compiled and not plain.compiled
    reference, ours = plain.rollout(x0, U), compiled.rollout(x0, U)
    assert not reference.diverged
    np.testing.assert_allclose(ours.X, reference.X, rtol=1e-15, atol=1e-15)
    K, k = np.full((30, 2, 2), 0.1), np.full((30, 2), 0.2)
    np.testing.assert_allclose(
        compiled.rollout_feedback(ours, K, k, 0.7).X, plain.rollout_feedback(ours, K, k, 0.7).X, rtol=1e-14, atol=1e-15
    )
    for a, b in zip(compiled.linearize(ours), plain.linearize(ours), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("compiled", [False, True])
def test_f_may_take_two_three_or_four_arguments(compiled):
    wrap = njit if compiled else lambda f: f
    two = wrap(lambda x, u: -x + u)
    three = wrap(lambda x, u, t: -x + u + 0.0 * t)
    four = wrap(lambda x, u, t, p: -x + u + 0.0 * t * p[0])
    U = np.linspace(0, 1, 5)[:, None]
    X = [FunctionDynamics(f, 1, 1, 0.1, parameters=[1.0]).rollout([1.0], U).X for f in (two, three, four)]
    np.testing.assert_array_equal(X[0], X[1])
    np.testing.assert_array_equal(X[0], X[2])


def test_times_and_parameters_reach_f():
    seen = []

    def f(x, u, t, p):
        seen.append((float(t), *p))
        return x

    dynamics = FunctionDynamics(f, 1, 1, [0.1, 0.2, 0.4], integrator="map", parameters=[5.0, 6.0])
    seen.clear()
    dynamics.rollout([0.0], np.zeros((3, 1)))
    np.testing.assert_allclose(seen, [(0.0, 5.0, 6.0), (0.1, 5.0, 6.0), (0.3, 5.0, 6.0)])


def test_f_may_return_a_list():
    dynamics = FunctionDynamics(lambda x, u: [x[1], u[0]], 2, 1, 0.1, integrator="euler")
    trajectory = dynamics.rollout([0.0, 1.0], np.ones((3, 1)))
    np.testing.assert_allclose(trajectory.X[:, 1], [1.0, 1.1, 1.2, 1.3])
    np.testing.assert_allclose(dynamics.linearize(trajectory).A[0], [[1.0, 0.1], [0.0, 1.0]])


# Jacobians


def plain_differences(dynamics, trajectory):
    """Centred differences of single steps."""
    e, A, B = 1e-6, [], []
    for n, (x, u) in enumerate(zip(trajectory.X, trajectory.U, strict=False)):
        A.append(
            [(dynamics.step(x + d, u, n)[0] - dynamics.step(x - d, u, n)[0]) / (2 * e) for d in e * np.eye(len(x))]
        )
        B.append(
            [(dynamics.step(x, u + d, n)[0] - dynamics.step(x, u - d, n)[0]) / (2 * e) for d in e * np.eye(len(u))]
        )
    return np.transpose(A, (0, 2, 1)), np.transpose(B, (0, 2, 1))


@pytest.mark.parametrize("f", [pendulum, compiled_pendulum], ids=["plain", "compiled"])
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_all_jacobians_agree(integrator, f, drive):
    x0, U, dt = drive
    options = {"integrator": integrator, "parameters": P}
    complex_step = FunctionDynamics(f, 2, 2, dt, **options)
    differences = FunctionDynamics(f, 2, 2, dt, jacobian="finite-difference", **options)
    trajectory = complex_step.rollout(x0, U)
    A, B, C, D = complex_step.linearize(trajectory)
    assert A.shape == (30, 2, 2) and B.shape == (30, 2, 2) and C.shape == (31, 0, 2) and D.shape == (31, 0, 2)
    table = {round(t, 9): (a, b) for t, a, b in zip(trajectory.times, A, B, strict=False)}
    handed_in = FunctionDynamics(f, 2, 2, dt, jacobian=lambda x, u, t: table[round(t, 9)], **options)
    for other, tolerance in ((differences.linearize(trajectory), 1e-8), (handed_in.linearize(trajectory), 0.0)):
        np.testing.assert_allclose(other.A, A, rtol=0, atol=tolerance)
        np.testing.assert_allclose(other.B, B, rtol=0, atol=tolerance)
    A_reference, B_reference = plain_differences(complex_step, trajectory)
    np.testing.assert_allclose(A, A_reference, rtol=0, atol=1e-8)
    np.testing.assert_allclose(B, B_reference, rtol=0, atol=1e-8)
    assert complex_step.check_derivatives(trajectory).worst_error < 1e-9


def test_complex_step_is_exact_where_it_can_be_written_down(drive):
    x0, U, _ = drive
    h = 0.05
    dynamics = FunctionDynamics(pendulum, 2, 2, h, integrator="euler", parameters=P)
    trajectory = dynamics.rollout(x0, U)
    A, B, _, _ = dynamics.linearize(trajectory)
    for n in range(30):
        lower = [-h * P[0] * np.cos(trajectory.X[n, 0]), 1.0 - h * P[1]]
        np.testing.assert_allclose(A[n], [[1.0, h], lower], rtol=1e-14)
        np.testing.assert_allclose(B[n], [[0.0, 0.0], [h, h * 0.3 * np.cos(2 * n * h)]], rtol=1e-13)


@settings(max_examples=10)
@given(seeds)
def test_differences_scale_with_large_entries(seed):
    rng = np.random.default_rng(seed)
    x = 10.0 ** rng.uniform(0, 6, 2) * rng.choice([-1, 1], 2)
    dynamics = FunctionDynamics(lambda x, u: x * x + u, 2, 2, 1.0, integrator="map", jacobian="finite-difference")
    trajectory = dynamics.rollout(x, np.zeros((1, 2)))
    np.testing.assert_allclose(dynamics.linearize(trajectory).A[0], np.diag(2 * x), rtol=1e-8)


def test_derivative_check_names_the_wrong_entry(drive):
    x0, U, _ = drive
    right = FunctionDynamics(pendulum, 2, 2, 0.05, integrator="euler", parameters=P)

    def wrong(x, u, t):
        trajectory = right.rollout(x, u[None])
        A = right.linearize(trajectory).A
        A[0, 1, 0] += 0.5 * (t > 0.4)
        return A[0], np.array([[0.0, 0.0], [0.05, 0.05 * 0.3 * np.cos(2 * t)]])

    dynamics = FunctionDynamics(pendulum, 2, 2, 0.05, integrator="euler", parameters=P, jacobian=wrong)
    check = dynamics.check_derivatives(dynamics.rollout(x0, U))
    step, row, column = check.worst["A"]
    assert check.errors["A"] > 0.1 and check.errors["B"] < 1e-9
    assert step > 8 and (row, column) == (1, 0)


# Outputs


@pytest.mark.parametrize("jacobian", ["complex-step", "finite-difference"])
@pytest.mark.parametrize("compiled", [False, True])
def test_outputs_are_read_along_the_rollout_and_differentiated(jacobian, compiled, drive):
    def outputs(x, u, t):
        return np.array([x[0] * u[0], np.sin(x[1]) + t, u[1] * u[1]])

    x0, U, dt = drive
    f = compiled_pendulum if compiled else pendulum
    dynamics = FunctionDynamics(f, 2, 2, dt, parameters=P, outputs=outputs, jacobian=jacobian)
    trajectory = dynamics.rollout(x0, U)
    assert dynamics.ny == 3 and trajectory.Y.shape == (31, 3)
    X, held = trajectory.X, np.vstack([U, [0.0, 0.0]])  # at the end, with zero control
    np.testing.assert_allclose(trajectory.Y[:, 0], X[:, 0] * held[:, 0])
    np.testing.assert_allclose(trajectory.Y[:, 1], np.sin(X[:, 1]) + trajectory.times)
    np.testing.assert_allclose(trajectory.Y[:, 2], held[:, 1] ** 2)
    _, _, C, D = dynamics.linearize(trajectory)
    assert C.shape == (31, 3, 2) and D.shape == (31, 3, 2)
    C_expected, D_expected = np.zeros((31, 3, 2)), np.zeros((31, 3, 2))
    C_expected[:, 0, 0], C_expected[:, 1, 1] = held[:, 0], np.cos(X[:, 1])
    D_expected[:30, 0, 0], D_expected[:30, 2, 1] = X[:30, 0], 2 * U[:, 1]
    np.testing.assert_allclose(C, C_expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(D, D_expected, rtol=0, atol=1e-9)
    assert dynamics.check_derivatives(trajectory).worst_error < 1e-8


def swing_energy(x, u, t, p):
    out = np.empty(2, dtype=x.dtype)
    out[0] = 0.5 * x[1] * x[1] - p[0] * np.cos(x[0])
    out[1] = u[0] * x[1] + np.sin(t) * u[1]
    return out


@pytest.mark.parametrize("jacobian", ["complex-step", "finite-difference"])
@pytest.mark.parametrize("arguments", [2, 3, 4])
def test_compiled_outputs_are_the_plain_ones(jacobian, arguments, drive):
    x0, U, dt = drive
    texts = {
        2: lambda x, u: x * x[0] + u,
        3: lambda x, u, t: x * u[0] + t * u,
        4: swing_energy,
    }
    plain, compiled = (
        FunctionDynamics(compiled_pendulum, 2, 2, dt, parameters=P, outputs=outputs, jacobian=jacobian)
        for outputs in (texts[arguments], njit(texts[arguments]))
    )
    trajectory, same = plain.rollout(x0, U), compiled.rollout(x0, U)
    np.testing.assert_allclose(same.Y, trajectory.Y, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(compiled.step(x0, U[3], 3)[1], plain.step(x0, U[3], 3)[1], rtol=1e-14)
    for ours, theirs in zip(compiled.linearize(same), plain.linearize(trajectory), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    rng = np.random.default_rng(0)
    costates, weights = rng.normal(size=(31, 2)), rng.normal(size=(31, 2))
    for ours, theirs in zip(
        compiled.hessian(same, costates, weights), plain.hessian(trajectory, costates, weights), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize(
    "outputs, ny", [(lambda x, u: x[0] * u[0], 1), (lambda x, u: (x[0], u[0]), 2), (lambda x, u: [x[0], x[0]], 2)]
)
def test_compiled_outputs_may_be_numbers_or_tuples(outputs, ny):
    dynamics = FunctionDynamics(njit(lambda x, u: x * u[0]), 1, 1, 0.1, outputs=njit(outputs))
    trajectory = dynamics.rollout([2.0], np.full((4, 1), 0.3))
    for n in range(4):
        np.testing.assert_allclose(
            trajectory.Y[n], np.atleast_1d(outputs(trajectory.X[n], trajectory.U[n])), rtol=1e-15
        )
    assert dynamics.ny == ny and dynamics.check_derivatives(trajectory).worst_error < 1e-9


def test_outputs_of_a_rollout_that_blows_up_end_there():
    for outputs in (lambda x, u: x + u, njit(lambda x, u: x + u)):
        dynamics = FunctionDynamics(njit(lambda x, u: x * x + u), 1, 1, 1.0, integrator="map", outputs=outputs)
        trajectory = dynamics.rollout([10.0], np.zeros((9, 1)))
        n = trajectory.diverged_at
        assert np.isfinite(trajectory.Y[:n]).all() and np.isnan(trajectory.Y[n:]).all()


def test_outputs_may_leave_out_the_time_and_return_a_number():
    dynamics = FunctionDynamics(lambda x, u: u, 1, 1, 0.5, outputs=lambda x, u: x[0] ** 2)
    trajectory = dynamics.rollout([1.0], np.ones((2, 1)))
    np.testing.assert_allclose(trajectory.Y, [[1.0], [2.25], [4.0]])
    np.testing.assert_allclose(dynamics.linearize(trajectory).C[:, 0, 0], [2.0, 3.0, 4.0])


# Divergence


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("spoil", [np.nan, np.inf, -np.inf, 1e16])
def test_divergence_is_reported_at_its_knot(spoil, compiled):
    def f(x, u):
        out = x.copy()
        if x[0].real > 3.5:
            out[1] = spoil
        out[0] += 1.0
        return out

    dynamics = FunctionDynamics(
        njit(f) if compiled else f, 2, 1, 1.0, integrator="map", outputs=lambda x, u: x[0] + u[0]
    )
    trajectory = dynamics.rollout(np.zeros(2), np.zeros((8, 1)))
    assert trajectory.diverged and trajectory.diverged_at == 5  # x_4 = 4 is the first beyond 3.5
    np.testing.assert_array_equal(trajectory.X[:5, 0], [0, 1, 2, 3, 4])
    assert np.isnan(trajectory.X[5:]).all()
    np.testing.assert_array_equal(trajectory.Y[:5, 0], [0, 1, 2, 3, 4])
    assert np.isnan(trajectory.Y[5:]).all()


def test_blow_up_is_found_before_it_overflows():
    dynamics = FunctionDynamics(lambda x, u: x * x + u, 1, 1, 1.0, integrator="euler")
    trajectory = dynamics.rollout([10.0], np.zeros((40, 1)))
    x, n = 10.0, 0
    while abs(x) < 1e15:
        x, n = x + x * x, n + 1
    assert trajectory.diverged_at == n
    assert np.isfinite(trajectory.X[:n]).all() and np.isnan(trajectory.X[n:]).all()


def test_feedback_that_blows_up_says_so_and_keeps_finite_controls():
    dynamics = FunctionDynamics(lambda x, u: x + u, 1, 1, 1.0, integrator="map")
    reference = dynamics.rollout([0.0], np.ones((50, 1)))
    K = np.full((50, 1, 1), -1e3)
    trajectory = dynamics.rollout_feedback(reference, K, np.zeros((50, 1)), x0=[1.0])
    assert trajectory.diverged and np.isfinite(trajectory.U).all()
    n = trajectory.diverged_at
    assert np.isfinite(trajectory.X[:n]).all() and np.isnan(trajectory.X[n:]).all()


# Feedback


@settings(max_examples=10)
@given(seeds, st.sampled_from(INTEGRATORS), st.booleans())
def test_feedback_rollout_is_the_plain_loop(seed, integrator, compiled):
    rng = np.random.default_rng(seed)
    N, dt = 12, rng.uniform(0.01, 0.1, 12)
    f = compiled_pendulum if compiled else pendulum
    dynamics = FunctionDynamics(f, 2, 2, dt, integrator=integrator, parameters=P)
    reference = dynamics.rollout(rng.standard_normal(2), 0.3 * rng.standard_normal((N, 2)))
    K, k, alpha = 0.3 * rng.standard_normal((N, 2, 2)), 0.3 * rng.standard_normal((N, 2)), rng.uniform()
    x0 = rng.standard_normal(2)
    ours = dynamics.rollout_feedback(reference, K, k, alpha, x0)
    x = x0
    for n in range(N):
        u = reference.U[n] + alpha * k[n] - K[n] @ (x - reference.X[n])
        np.testing.assert_allclose(ours.U[n], u, rtol=1e-9, atol=1e-9)
        x = dynamics.step(x, u, n)[0]
        np.testing.assert_allclose(ours.X[n + 1], x, rtol=1e-9, atol=1e-9)
    still = dynamics.rollout_feedback(reference, K, k, 0.0)
    np.testing.assert_allclose(still.X, reference.X, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(still.U, reference.U, rtol=1e-12, atol=1e-12)
