"""Second derivatives: of every engine against differences of its steps, and of the total cost against dense ones."""

import numpy as np
import pytest
from numba import njit

from mjslq import FunctionDynamics, MujocoDynamics, Problem, costs, problems
from mjslq.dynamics.dynamics import Dynamics
from mjslq.solvers.iterate import Iterate

BALL = """
<mujoco><option timestep="0.02"/><worldbody><body pos="0 0 1"><joint name="b" type="ball" damping=".1"/>
<geom type="capsule" fromto="0 0 0 .3 .1 -.4" size=".05" mass="1"/>
<body pos=".3 .1 -.4"><joint name="h" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".04" mass=".5"/>
<site name="tip" pos="0 0 -.3"/></body></body></worldbody>
<actuator><motor joint="b" gear="1 0 0"/><motor joint="b" gear="0 1 0"/><motor joint="h"/></actuator>
<sensor><framepos objtype="site" objname="tip"/></sensor></mujoco>
"""


def equations(x, u, t):
    return np.stack([x[1] * np.cos(x[0]) + u[0] * u[1], np.sin(x[0] * x[2]) + u[1], x[2] * x[0] - u[0] * np.exp(x[1])])


@njit
def compiled_equations(x, u, t):
    out = np.empty_like(x)
    out[0] = x[1] * np.cos(x[0]) + u[0] * u[1]
    out[1] = np.sin(x[0] * x[2]) + u[1]
    out[2] = x[2] * x[0] - u[0] * np.exp(x[1])
    return out


def outputs(x, u, t):
    return np.stack([x[0] * x[1] + t, np.sin(u[0]) * x[2]])


def dense(dynamics, trajectory, costates, weights):
    """Second differences of costate'difference(x_{n+1}, step) + weight'output, one knot after the other."""
    N, nu, ndx, e = trajectory.horizon, dynamics.nu, dynamics.ndx, 1e-4
    H = np.zeros((N + 1, ndx + nu, ndx + nu))
    U = np.vstack([trajectory.U, np.zeros(nu)])
    for n in range(N + 1):

        def value(d, n=n):
            x = dynamics.integrate(trajectory.X[n], d[:ndx])
            forward, output = dynamics.step(x, U[n] + d[ndx:], min(n, N - 1))
            total = weights[n] @ output
            return total if n == N else total + costates[n + 1] @ dynamics.difference(trajectory.X[n + 1], forward)

        d = e * np.eye(ndx + nu)
        for i in range(ndx + nu):
            for j in range(i + 1):
                corners = value(d[i] + d[j]) - value(d[i] - d[j]) - value(d[j] - d[i]) + value(-d[i] - d[j])
                H[n, i, j] = H[n, j, i] = corners / (4.0 * e * e)
    return H


def check(dynamics, trajectory, tolerance, hessian=None):
    rng = np.random.default_rng(5)
    costates = rng.standard_normal((trajectory.horizon + 1, dynamics.ndx))
    weights = rng.standard_normal((trajectory.horizon + 1, dynamics.ny))
    xx, ux, uu = (dynamics.hessian if hessian is None else hessian)(trajectory, costates, weights)
    H, ndx = dense(dynamics, trajectory, costates, weights), dynamics.ndx
    assert xx.shape == (trajectory.horizon + 1, ndx, ndx) and ux.shape[1:] == (dynamics.nu, ndx)
    scale = np.abs(H).max()
    for ours, theirs in ((xx, H[:, :ndx, :ndx]), (ux, H[:-1, ndx:, :ndx]), (uu, H[:-1, ndx:, ndx:])):
        np.testing.assert_allclose(ours, theirs, atol=tolerance * scale)
    assert np.abs(xx).max() > 0.0


def function_trajectory(dynamics):
    rng = np.random.default_rng(2)
    return dynamics.rollout(0.3 * rng.standard_normal(3), 0.3 * rng.standard_normal((6, 2)))


@pytest.mark.parametrize("integrator", ["map", "euler", "semi-implicit-euler", "rk4"])
@pytest.mark.parametrize("jacobian", ["complex-step", "finite-difference"])
@pytest.mark.parametrize("f", [equations, compiled_equations])
def test_function_dynamics(f, jacobian, integrator):
    dynamics = FunctionDynamics(f, 3, 2, 0.1, integrator=integrator, jacobian=jacobian, outputs=outputs)
    check(dynamics, function_trajectory(dynamics), 1e-6)


def test_the_default_by_differences_of_jacobians_agrees():
    dynamics = FunctionDynamics(equations, 3, 2, 0.1, outputs=outputs)
    check(dynamics, function_trajectory(dynamics), 1e-6, lambda *args: Dynamics.hessian(dynamics, *args))
    engine = FunctionDynamics(equations, 3, 2, 0.1)
    given = FunctionDynamics(equations, 3, 2, 0.1, jacobian=lambda x, u, t: at(engine, x, u))
    check(given, function_trajectory(given), 1e-6)


def at(engine, x, u):
    one = engine.linearize(engine.rollout(x, u[None]))
    return one.A[0], one.B[0]


def test_a_given_hessian_is_used():
    def hessian(x, u, t, costate):
        return np.diag(2.0 * costate), np.zeros((1, 2)), np.array([[6.0 * costate[0] * u[0]]])

    f = FunctionDynamics(
        lambda x, u: np.stack([x[0] ** 2 + u[0] ** 3, x[1] ** 2]), 2, 1, 1.0, integrator="map", hessian=hessian
    )
    check(f, f.rollout([0.3, -0.4], np.full((4, 1), 0.2)), 1e-6)
    wrong = FunctionDynamics(lambda x, u: x + u[0], 2, 1, 1.0, hessian=lambda x, u, t, c: (np.eye(3), 0, 0))
    trajectory = wrong.rollout([0.0, 0.0], np.zeros((2, 1)))
    with pytest.raises(ValueError, match=r"hessian must return H_xx, H_ux and H_uu of shapes .*\(2, 2\).*got \(3, 3\)"):
        wrong.hessian(trajectory, np.ones((3, 2)))
    with pytest.raises(ValueError, match="hessian must be a function, got str"):
        FunctionDynamics(lambda x, u: x, 2, 1, 1.0, hessian="exact")


def test_mujoco_with_a_ball_joint_and_a_sensor():
    """On a manifold: in tangent directions, of steps as well as of readings."""
    dynamics = MujocoDynamics.from_xml(BALL)
    rng = np.random.default_rng(1)
    x0 = dynamics.integrate(np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 0]), rng.standard_normal(8))
    check(dynamics, dynamics.rollout(x0, rng.standard_normal((5, 3))), 2e-5)


@pytest.mark.parametrize("jacobian", ["inverse", "transition"])
def test_next_to_a_limit_they_are_those_from_inside(jacobian):
    """MuJoCo clamps beyond it, where differences would see B vanish; optimal controls are often there."""
    limited = BALL.replace('<motor joint="h"/>', '<motor joint="h" ctrlrange="-.5 .3"/>')
    clamped, free = (MujocoDynamics.from_xml(xml, jacobian=jacobian) for xml in (limited, BALL))
    rng = np.random.default_rng(4)
    x0 = clamped.integrate(np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 0]), rng.standard_normal(8))
    U = 0.2 * rng.standard_normal((6, 3))
    U[:, 2] = -0.5, -0.5 + 1e-9, -0.5 + 9e-6, 0.3, 0.3 - 1e-7, 0.0
    costates = rng.standard_normal((7, 8))
    ours, theirs = (d.hessian(d.rollout(x0, U), costates) for d in (clamped, free))
    for name, one, other in zip(ours._fields, ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-3 * np.abs(theirs.xx).max(), err_msg=name)
    beyond = U.copy()
    beyond[:, 2] = -0.5 - 1e-4  # as limits that were lifted allow: there is nothing to see there
    assert not np.abs(clamped.hessian(clamped.rollout(x0, beyond), costates).uu[:, 2]).max() > 1e-6


def test_steps_apart_from_each_other():
    """Knots of a state guess, that need not follow each other."""
    dynamics = MujocoDynamics.from_xml(BALL)
    rng = np.random.default_rng(3)
    origin = np.tile(np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 0]), (7, 1))
    X, U = dynamics.integrate(origin, rng.standard_normal((7, 8))), rng.standard_normal((6, 3))
    F, Y = dynamics.step_each(X, U)
    together = dynamics.linearize_steps(X, U, F)
    for n in range(6):
        one = dynamics.rollout(X[n], U[n : n + 1])
        np.testing.assert_allclose(F[n], one.X[1], atol=1e-10)
        np.testing.assert_allclose(Y[n], one.Y[0], atol=1e-10)
        for ours, theirs in zip(together, dynamics.linearize(one), strict=True):
            np.testing.assert_allclose(ours[n], theirs[0], atol=1e-6)


@pytest.mark.parametrize("f", [equations, compiled_equations])
def test_steps_of_functions_apart_from_each_other(f):
    dynamics = FunctionDynamics(f, 3, 2, 0.1, outputs=outputs)
    rng = np.random.default_rng(3)
    X, U = rng.standard_normal((6, 3)), rng.standard_normal((5, 2))
    F, Y = dynamics.step_each(X, U)
    for n in range(5):
        forward, output = dynamics.step(X[n], U[n], n)
        np.testing.assert_allclose(F[n], forward, rtol=1e-12)
        np.testing.assert_allclose(Y[n], output, rtol=1e-12)


# The Hessian of the total cost


def total_hessian(model):
    """d^2J/dU^2 from an LQ problem, states eliminated."""
    A, B, Q, R, M, *_ = model
    N, nx, nu = B.shape
    S = np.zeros((N + 1, nx, N, nu))
    for n in range(N):
        S[n + 1] = np.einsum("ij,jkl->ikl", A[n], S[n])
        S[n + 1, :, n, :] += B[n]
    S, H = S.reshape(N + 1, nx, N * nu), np.zeros((N * nu, N * nu))
    for n in range(N + 1):
        H += S[n].T @ Q[n] @ S[n]
        if n < N:
            rows = slice(n * nu, (n + 1) * nu)
            H[rows, rows] += R[n]
            H[rows] += M[n] @ S[n]
            H[:, rows] += S[n].T @ M[n].T
    return H


def dense_hessian(problem, U, e=1e-5):
    columns = []
    for i in range(U.size):
        d = np.zeros_like(U)
        d.flat[i] = e
        beyond, before = (problem.gradient(problem.rollout(U + s * d)).ravel() for s in (1.0, -1.0))
        columns.append((beyond - before) / (2.0 * e))
    return np.stack(columns, axis=-1)


def indefinite():
    """Every kind of term, one of them with an indefinite Hessian."""
    terms = [
        costs.Control(0.1),
        costs.State(1.0, when="always"),
        costs.Sensor("y", [0.3, -0.2], 2.0, when="always"),
        costs.Residual(lambda x, u, t: np.stack([np.sin(x[0]) * u[1], x[1] ** 2]), 0.7, when="always"),
        costs.Function(lambda x, u, t: np.cos(x[0]) + x[1] * u[0] * x[2], when="always"),
    ]
    return Problem(FunctionDynamics(equations, 3, 2, 0.1, outputs=outputs), 6, [0.4, -0.3, 0.5], terms)


def arm():
    dynamics = MujocoDynamics.from_xml(BALL.replace('type="ball"', 'type="hinge" axis="1 0 0"'))
    terms = [
        costs.Control(0.1),
        costs.State(0.3),
        costs.Sensor(dynamics.output_names[0].split("[")[0], 0.5, 5.0, "always"),
    ]
    return Problem(dynamics, 8, [0.3, -0.4, 0.5, 0.2], terms)


@pytest.mark.parametrize(
    "make, tolerance",
    [(indefinite, 1e-7), (lambda: problems.get("van_der_pol", horizon=12), 1e-7), (arm, 1e-5),
     (lambda: problems.get("hopper", horizon=30, engine="function"), 1e-6),
     (lambda: problems.get("drag_particle", beta=1.0, horizon=40), 1e-6)],
    ids=["terms", "van_der_pol", "mujoco", "hopper", "drag"],
)  # fmt: skip
def test_hessian_of_the_total_cost_against_dense_differences(make, tolerance):
    problem = make()
    U = 0.5 * np.random.default_rng(0).standard_normal((problem.horizon, problem.dynamics.nu))
    here = Iterate(problem, problem.rollout(U))
    ours, theirs = total_hessian(here.newton), dense_hessian(problem, U)
    np.testing.assert_allclose(ours, theirs, atol=tolerance * np.abs(theirs).max())
    gauss_newton = total_hessian(here.gauss_newton)
    assert np.abs(gauss_newton - theirs).max() > 100.0 * tolerance * np.abs(theirs).max()  # what is gained
