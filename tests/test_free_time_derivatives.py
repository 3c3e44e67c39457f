"""Derivatives by final time and parameters: of steps, costs and constraints, against differences on all engines."""

import numba
import numpy as np
import pytest
from free_time_problems import of_function, of_mujoco, of_pinocchio, pendulum

from mjslq.dynamics.variation import derivative, places
from mjslq.lq.adjoint import adjoint
from mjslq.solvers.iterate import Iterate

CASES = {
    "euler": lambda: of_function("euler"),
    "semi-implicit": lambda: of_function("semi-implicit-euler"),
    "rk4": lambda: of_function("rk4"),
    "compiled": lambda: of_function("rk4", numba.njit(pendulum)),
    "time alone": lambda: of_function(free_parameters={}),
    "parameters alone": lambda: of_function(free_time=None),
    "mujoco": of_mujoco,
    "mujoco, substeps": lambda: of_mujoco("implicitfast", 3),
    "mujoco, rk4": lambda: of_mujoco("RK4", 2),
    "pinocchio": of_pinocchio,
    "pinocchio, rk4": lambda: of_pinocchio("rk4"),
    "pinocchio, floating": lambda: of_pinocchio(floating=True),
}


def lifted(case, seed=0):
    """The problem as methods see it, and controls with values off their first ones."""
    problem = CASES[case]()
    posed, rng = problem.lifted, np.random.default_rng(seed)
    U, nu = np.array(posed.U0), problem.dynamics.nu
    U[:, :nu] += 0.3 * rng.normal(size=(len(U), nu))
    U[0, nu:] *= rng.uniform(0.8, 1.2, U.shape[1] - nu)
    return problem, posed, U


def rolled(posed, U):
    return posed.dynamics.rollouts(np.asarray(posed.x0)[None], U[None])[0]


def five_point(function, step):
    near, far = function(step) - function(-step), function(2 * step) - function(-2 * step)
    return (8.0 * near - far) / (12.0 * step)


def moved(U, j, d):
    V = U.copy()
    V[0, j] += d
    return V


@pytest.mark.parametrize("case", CASES)
def test_gradients_by_time_and_parameters_are_those_of_differences(case):
    problem, posed, U = lifted(case)
    gradient = Iterate(posed, rolled(posed, U)).gradient
    for j in range(problem.dynamics.nu, U.shape[1]):
        fine = five_point(lambda d, j=j: posed.cost(rolled(posed, moved(U, j, d))), 1e-3 * abs(U[0, j]))
        assert gradient[0, j] == pytest.approx(fine, rel=1e-7, abs=1e-8), posed.dynamics.control_names[j]
    assert not gradient[1:, problem.dynamics.nu :].any()


@pytest.mark.parametrize("case", ["rk4", "mujoco, substeps", "pinocchio, floating"])
def test_gradients_without_jacobians_are_the_same(case):
    _, posed, U = lifted(case)
    here = Iterate(posed, rolled(posed, U))
    slopes = posed.slopes(here.trajectory)
    found = posed.dynamics.adjoint(here.trajectory, slopes.q, slopes.r, y=slopes.y)
    np.testing.assert_allclose(found.gradient, here.gradient, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("case", ["semi-implicit", "rk4", "time alone", "mujoco, substeps", "mujoco, rk4", "pinocchio"])
def test_second_derivatives_are_those_of_differences_of_gradients(case):
    problem, posed, U = lifted(case)
    model, nu, e = Iterate(posed, rolled(posed, U)).newton, problem.dynamics.nu, 1e-4
    rng = np.random.default_rng(1)
    for direction in (1.0, 0.0):
        along = direction * rng.normal(size=U.shape)
        along[:, nu:] = 0.0
        along[0, nu:] = rng.normal(size=U.shape[1] - nu)
        gradients = [Iterate(posed, rolled(posed, U + s * e * along)).gradient for s in (1.0, -1.0, 2.0, -2.0)]
        fine = (8.0 * (gradients[0] - gradients[1]) - (gradients[2] - gradients[3])) / (12.0 * e)
        plain = model._replace(q=np.zeros_like(model.q), r=np.zeros_like(model.r))
        about = plain.about(model.states(along), along)
        product = adjoint(model.A, model.B, about.q, about.r)[1]
        assert np.abs(product - fine).max() < 1e-5 * np.abs(fine).max()


@pytest.mark.parametrize("case", ["rk4", "time alone", "parameters alone"])
def test_constraints_have_the_jacobians_of_differences(case):
    """Along (dx, du) that the linearized system takes, w follows the Jacobian of each residual."""
    _, posed, U = lifted(case)
    here = Iterate(posed, rolled(posed, U))
    along = np.zeros_like(U)
    along[:] = np.random.default_rng(2).normal(size=U.shape)
    along[1:, posed.dynamics.inner.nu :] = 0.0
    X = here.gauss_newton.states(along)
    assert len(posed.bound_constraints) == 5
    for constraint in posed.bound_constraints:
        residual = constraint.residual
        J = residual.jacobian(here.trajectory, here.linearization)
        change = np.zeros((len(residual.knots), residual.size))
        if J.x is not None:
            change += np.einsum("kmi,ki->km", J.x, X[residual.knots.indices])
        if J.u is not None:
            steps = residual.knots.steps
            change[: len(steps)] += np.einsum("kmi,ki->km", J.u[: len(steps)], along[steps])
        fine = five_point(lambda d, r=residual: r.value(rolled(posed, U + d * along)), 1e-4)
        np.testing.assert_allclose(change, fine, rtol=1e-6, atol=1e-7, err_msg=constraint.name)


@pytest.mark.parametrize("case", ["semi-implicit", "rk4", "mujoco, substeps", "pinocchio, floating"])
def test_the_derivative_check_covers_them(case):
    _, posed, U = lifted(case)
    check = posed.dynamics.check_derivatives(rolled(posed, U))
    assert not check.suspects and check.worst_error < 1e-6


def test_a_step_is_the_rollouts_step():
    for case in ("rk4", "mujoco, substeps", "pinocchio, floating"):
        _, posed, U = lifted(case)
        trajectory = rolled(posed, U)
        for n in (0, 1, 7):
            forward, y = posed.dynamics.step(trajectory.X[n], trajectory.U[n], n)
            np.testing.assert_allclose(forward, trajectory.X[n + 1], rtol=1e-12, atol=1e-13)
            np.testing.assert_allclose(y, trajectory.Y[n], rtol=1e-9, atol=1e-10)
        ends, _ = posed.dynamics.step_each(trajectory.X, trajectory.U)
        np.testing.assert_allclose(ends, trajectory.X[1:], rtol=1e-12, atol=1e-13)


def test_rollouts_under_feedback_follow_the_law_that_steps_follow():
    """The engine does not see the values among the states; what the law says of them is in the controls."""
    from mjslq.dynamics.dynamics import Feedback

    _, posed, U = lifted("rk4")
    reference, rng = rolled(posed, U), np.random.default_rng(3)
    N, nu, ndx = posed.horizon, posed.dynamics.nu, posed.dynamics.ndx
    K = 0.1 * rng.normal(size=(N, nu, ndx))
    K[1:, posed.dynamics.inner.nu :] = 0.0
    K[:, :, 0] += 0.2
    lower, upper = np.full((N, nu), -1.0), np.full((N, nu), 12.0)
    x0 = reference.X[0] + np.concatenate([[0.05, -0.02], np.zeros(3)])
    law = Feedback(reference.X, K, lower, upper)
    V = reference.U + 0.1 * rng.normal(size=U.shape)
    V[1:, posed.dynamics.inner.nu :] = 0.0
    found = posed.dynamics.rollouts(x0[None], V[None], law)[0]
    x = x0
    for n in range(N):
        u = np.clip(V[n] - K[n] @ (x - reference.X[n]), lower[n], upper[n])
        own = slice(None) if n == 0 else slice(0, posed.dynamics.inner.nu)
        np.testing.assert_allclose(found.U[n, own], u[own], rtol=1e-9, atol=1e-11)
        x = posed.dynamics.step(x, u, n)[0]
        np.testing.assert_allclose(found.X[n + 1], x, rtol=1e-9, atol=1e-11)


def test_differences_stay_within_limits():
    for value, lower, upper in ((1.0, 0.0, 2.0), (0.0, 0.0, 2.0), (2.0, 0.0, 2.0)):
        asked = []

        def cubed(d, value=value, asked=asked):
            asked.append(value + d)
            return [np.array([(value + d) ** 2])]

        (slope,) = derivative(cubed, places(value, 1e-3, lower, upper))
        assert slope[0] == pytest.approx(2.0 * value, abs=1e-9)
        assert min(asked) >= lower and max(asked) <= upper
