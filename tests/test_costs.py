"""Cost terms against plain loops, and their expansions against differences of their own values."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjslq import FunctionDynamics, Problem, costs
from mjslq.trajectory import Trajectory

seeds = st.integers(0, 2**32 - 1)
NX, NU, N = 3, 2, 6
DT = np.array([0.1, 0.2, 0.15, 0.05, 0.3, 0.1])
TIMES = np.concatenate([[0.0], np.cumsum(DT)])
dynamics = FunctionDynamics(lambda x, u: -x, NX, NU, DT)


def make(term):
    return Problem(dynamics, N, np.zeros(NX), [term])


def random_trajectory(rng):
    """Not a rollout: a cost does not care."""
    return Trajectory(rng.standard_normal((N + 1, NX)), rng.standard_normal((N, NU)), dt=DT)


def random_weight(rng, size, rank=None):
    root = rng.standard_normal((size if rank is None else rank, size))
    return root.T @ root + (1e-3 * np.eye(size) if rank is None else 0.0)


def quadratic(W, d):
    return 0.5 * sum(W[i, j] * d[i] * d[j] for i in range(len(d)) for j in range(len(d)))


def weights_of(when):
    """s_n: step lengths where a running term acts, 1 at the end for terminal ones."""
    running = np.append(DT, 0.0)
    return {"running": running, "terminal": np.eye(N + 1)[N], "always": running + np.eye(N + 1)[N]}[when]


def differences(problem, trajectory, second=False):
    """Gradient (or Hessian, by differences of the gradient) of the cost by all entries of (X, U)."""
    size = trajectory.X.size
    z = np.concatenate([trajectory.X.ravel(), trajectory.U.ravel()])

    def at(z):
        return Trajectory(z[:size].reshape(N + 1, NX), z[size:].reshape(N, NU), dt=DT)

    def gradient(z):
        expansion = problem.expand(at(z))
        return np.concatenate([expansion.q.ravel(), expansion.r.ravel()])

    value, e = (gradient, 1e-5) if second else (lambda z: problem.cost(at(z)), 1e-3)
    columns = []
    for i in range(z.size):
        d = np.zeros(z.size)
        d[i] = e
        near, far = value(z + d) - value(z - d), value(z + 2 * d) - value(z - 2 * d)
        columns.append((8 * near - far) / (12 * e))
    return np.array(columns)


def dense_hessian(expansion):
    """The blocks Q, M, R as one matrix by all entries of (X, U)."""
    states = (N + 1) * NX
    H = np.zeros((states + N * NU,) * 2)
    for n in range(N + 1):
        x, u = slice(n * NX, (n + 1) * NX), slice(states + n * NU, states + (n + 1) * NU)
        H[x, x] = expansion.Q[n]
        if n < N:
            H[u, u], H[u, x], H[x, u] = expansion.R[n], expansion.M[n], expansion.M[n].T
    return H


def check_gradient(problem, trajectory):
    expansion = problem.expand(trajectory)
    gradient = np.concatenate([expansion.q.ravel(), expansion.r.ravel()])
    reference = differences(problem, trajectory)
    np.testing.assert_allclose(gradient, reference, rtol=1e-8, atol=1e-9 * max(1.0, np.abs(reference).max()))


def check_hessian(problem, trajectory):
    H = dense_hessian(problem.expand(trajectory))
    np.testing.assert_allclose(H, differences(problem, trajectory, second=True), rtol=1e-6, atol=1e-6 * np.abs(H).max())


# Quadratic terms


@settings(max_examples=8)
@given(seeds, st.booleans())
def test_tracking_is_equations_3_and_4(seed, per_step):
    rng = np.random.default_rng(seed)
    if per_step:
        Q, R = [random_weight(rng, NX, 2) for _ in range(N)], [random_weight(rng, NU) for _ in range(N)]
        x_o, u_o = rng.standard_normal((N + 1, NX)), rng.standard_normal((N, NU))
        term_arguments = {"x_target": x_o, "u_target": u_o}
    else:
        Q, R = [random_weight(rng, NX, 2)] * N, [random_weight(rng, NU)] * N
        x_target, u_target = rng.standard_normal(NX), rng.standard_normal(NU)
        x_o, u_o = np.tile(x_target, (N + 1, 1)), np.tile(u_target, (N, 1))
        term_arguments = {"x_target": x_target, "u_target": u_target}
    Q_final = random_weight(rng, NX, 1)
    problem = make(costs.Tracking(Q if per_step else Q[0], R if per_step else R[0], Q_final, **term_arguments))
    trajectory = random_trajectory(rng)
    J = quadratic(Q_final, trajectory.X[N] - x_o[N])
    for n in range(N):  # plain sums: no dt
        J += quadratic(Q[n], trajectory.X[n] - x_o[n]) + quadratic(R[n], trajectory.U[n] - u_o[n])
    assert problem.cost(trajectory) == pytest.approx(J, rel=1e-12)
    check_gradient(problem, trajectory)
    check_hessian(problem, trajectory)


def test_targets_are_zero_unless_given():
    trajectory = random_trajectory(np.random.default_rng(0))
    J = 0.5 * (2 * (trajectory.X[:-1] ** 2).sum() + 3 * (trajectory.U**2).sum() + 4 * (trajectory.X[-1] ** 2).sum())
    assert make(costs.Tracking(2.0, 3.0, 4.0)).cost(trajectory) == pytest.approx(J, rel=1e-13)


@pytest.mark.parametrize("when", ["running", "terminal", "always"])
@pytest.mark.parametrize("per_knot", [False, True])
def test_state_term(when, per_knot):
    rng = np.random.default_rng(3)
    W, trajectory = random_weight(rng, NX, 2), random_trajectory(rng)
    target = rng.standard_normal((N + 1, NX) if per_knot else NX)
    problem = make(costs.State(W, target, when))
    targets = np.broadcast_to(target, (N + 1, NX))
    J = sum(s * quadratic(W, trajectory.X[n] - targets[n]) for n, s in enumerate(weights_of(when)))
    assert problem.cost(trajectory) == pytest.approx(J, rel=1e-12)
    check_gradient(problem, trajectory)
    check_hessian(problem, trajectory)


@pytest.mark.parametrize("per_step", [False, True])
def test_control_term_is_an_integral(per_step):
    rng = np.random.default_rng(4)
    W, trajectory = random_weight(rng, NU), random_trajectory(rng)
    target = rng.standard_normal((N, NU) if per_step else NU)
    problem = make(costs.Control(W, target))
    targets = np.broadcast_to(target, (N, NU))
    J = sum(DT[n] * quadratic(W, trajectory.U[n] - targets[n]) for n in range(N))
    assert problem.cost(trajectory) == pytest.approx(J, rel=1e-12)
    check_gradient(problem, trajectory)
    check_hessian(problem, trajectory)


@pytest.mark.parametrize("weight", [2.0, [2.0, 2.0, 2.0], 2.0 * np.eye(3)])
def test_weights_in_every_form_mean_the_same(weight):
    trajectory = random_trajectory(np.random.default_rng(5))
    J = (trajectory.X[N] ** 2).sum()
    assert make(costs.State(weight, when="terminal")).cost(trajectory) == pytest.approx(J, rel=1e-14)


# Residuals


def residual(x, u, t):
    return np.stack([x[0] * x[1] - t, np.sin(x[2]) + u[0], u[1] * u[1] * x[0], x[2]])


def residual_jacobian(x, u, t):
    by_x = [[x[1], x[0], 0.0], [0.0, 0.0, np.cos(x[2])], [u[1] ** 2, 0.0, 0.0], [0.0, 0.0, 1.0]]
    by_u = [[0.0, 0.0], [1.0, 0.0], [0.0, 2 * u[1] * x[0]], [0.0, 0.0]]
    return np.array(by_x), np.array(by_u)


@pytest.mark.parametrize("jacobian", [None, residual_jacobian])
@pytest.mark.parametrize("when", ["running", "terminal", "always"])
def test_residual_term(when, jacobian):
    rng = np.random.default_rng(6)
    W, trajectory = random_weight(rng, 4, 3), random_trajectory(rng)
    problem = make(costs.Residual(residual, W, when, jacobian))
    held = np.vstack([trajectory.U, np.zeros(NU)])  # at the terminal knot u is zero
    J, knots = 0.0, list(zip(weights_of(when), trajectory.X, held, TIMES, strict=True))
    for s, x, u, t in knots:
        J += s * quadratic(W, residual(x, u, t))
    assert problem.cost(trajectory) == pytest.approx(J, rel=1e-12)
    check_gradient(problem, trajectory)
    expansion = problem.expand(trajectory)
    for n, (s, x, u, t) in enumerate(knots):  # Gauss-Newton: J'WJ
        by_x, by_u = residual_jacobian(x, u, t)
        np.testing.assert_allclose(expansion.Q[n], s * by_x.T @ W @ by_x, rtol=1e-10, atol=1e-12)
        if n < N:
            np.testing.assert_allclose(expansion.R[n], s * by_u.T @ W @ by_u, rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(expansion.M[n], s * by_u.T @ W @ by_x, rtol=1e-10, atol=1e-12)


@settings(max_examples=8)
@given(seeds)
def test_hessian_of_a_linear_residual_is_exact(seed):
    rng = np.random.default_rng(seed)
    E, F, g = rng.standard_normal((4, NX)), rng.standard_normal((4, NU)), rng.standard_normal(4)
    problem = make(costs.Residual(lambda x, u, t: E @ x + F @ u + g * t, random_weight(rng, 4), "always"))
    trajectory = random_trajectory(rng)
    check_gradient(problem, trajectory)
    check_hessian(problem, trajectory)


def test_residual_may_return_a_number_or_a_list():
    trajectory = random_trajectory(np.random.default_rng(7))
    J = 1.5 * trajectory.X[N, 0] ** 4
    for r in (lambda x, u, t: x[0] ** 2, lambda x, u, t: [x[0] ** 2], lambda x, u, t: np.array([x[0] ** 2])):
        problem = make(costs.Residual(r, 3.0, "terminal"))
        assert problem.cost(trajectory) == pytest.approx(J, rel=1e-13)
        check_gradient(problem, trajectory)


@pytest.mark.parametrize("term", [costs.Residual, costs.Function])
def test_functions_undefined_at_zero_make_no_noise(term):
    """Sizes are found by a call at the origin, where a user's function need not be defined."""
    trajectory = Trajectory(np.ones((N + 1, NX)), np.ones((N, NU)), dt=DT)
    problem = make(term(lambda x, u, t: np.log(x[0]) + 1.0 / x[1], when="terminal"))
    assert problem.cost(trajectory) == pytest.approx(0.5 if term is costs.Residual else 1.0)


@pytest.mark.parametrize("term", [costs.Residual, costs.Function])
def test_terms_that_take_no_complex_numbers_are_told_what_to_do(term):
    """math.sin drops the imaginary part of a complex step: the derivative would be zero, and wrong."""
    problem = make(term(lambda x, u, t: math.sin(x[0])))
    with pytest.raises(ValueError, match=r"analytic|gradient|jacobian"):
        problem.expand(random_trajectory(np.random.default_rng(0)))


# Any function


def smooth(x, u, t):
    return np.cos(x[0]) * u[0] + x[1] ** 4 + t * u[1] ** 2 + np.exp(0.3 * x[2]) * x[0]


def smooth_gradient(x, u, t):
    grown = np.exp(0.3 * x[2])
    by_x = np.array([-np.sin(x[0]) * u[0] + grown, 4 * x[1] ** 3, 0.3 * grown * x[0]])
    return by_x, np.array([np.cos(x[0]), 2 * t * u[1]])


def smooth_hessian(x, u, t):
    H, grown = np.zeros((5, 5)), np.exp(0.3 * x[2])
    H[0, 0], H[1, 1], H[2, 2], H[4, 4] = -np.cos(x[0]) * u[0], 12 * x[1] ** 2, 0.09 * grown * x[0], 2 * t
    H[0, 2] = H[2, 0] = 0.3 * grown
    H[0, 3] = H[3, 0] = -np.sin(x[0])
    return H


@pytest.mark.parametrize(
    "given", [{}, {"gradient": smooth_gradient}, {"gradient": smooth_gradient, "hessian": smooth_hessian}]
)
@pytest.mark.parametrize("when", ["running", "terminal", "always"])
def test_function_term(when, given):
    trajectory = random_trajectory(np.random.default_rng(8))
    problem = make(costs.Function(smooth, when, **given))
    held = np.vstack([trajectory.U, np.zeros(NU)])
    knots = list(zip(weights_of(when), trajectory.X, held, TIMES, strict=True))
    assert problem.cost(trajectory) == pytest.approx(sum(s * smooth(x, u, t) for s, x, u, t in knots), rel=1e-12)
    check_gradient(problem, trajectory)
    expansion = problem.expand(trajectory)
    for n, (s, x, u, t) in enumerate(knots[:N]):
        values, vectors = np.linalg.eigh(smooth_hessian(x, u, t))
        nearest = s * (vectors * np.maximum(values, 0.0)) @ vectors.T  # the part below zero left out
        ours = np.block([[expansion.Q[n], expansion.M[n].T], [expansion.M[n], expansion.R[n]]])
        np.testing.assert_allclose(ours, nearest, rtol=0, atol=1e-7)


def test_indefinite_hessians_leave_a_semidefinite_model():
    trajectory = random_trajectory(np.random.default_rng(9))
    problem = make(costs.Function(lambda x, u, t: x[0] * u[0] - x[1] ** 2 - np.sin(x[2]) * u[1] ** 2, "always"))
    for term in (problem, make(costs.Function(lambda x, u, t: -x @ x - u @ u))):
        H = dense_hessian(term.expand(trajectory))
        assert np.linalg.eigvalsh(H)[0] > -1e-9
        np.testing.assert_allclose(H, H.T, atol=1e-12)


@settings(max_examples=3)
@given(seeds)
def test_hessian_of_a_quadratic_function_is_exact(seed):
    rng = np.random.default_rng(seed)
    W, g = random_weight(rng, NX + NU), rng.standard_normal(NX + NU)

    def l(x, u, t):  # noqa: E743  (the field's own name)
        z = np.concatenate([x, u])
        return 0.5 * z @ W @ z + g @ z + t

    problem, trajectory = make(costs.Function(l, "running")), random_trajectory(rng)
    check_gradient(problem, trajectory)
    check_hessian(problem, trajectory)


def test_terms_add_up():
    terms = [costs.Control(2.0), costs.State(1.0, when="always"), costs.Residual(residual), costs.Function(smooth)]
    trajectory = random_trajectory(np.random.default_rng(10))
    together = Problem(dynamics, N, np.zeros(NX), terms)
    assert together.cost(trajectory) == pytest.approx(sum(make(term).cost(trajectory) for term in terms), rel=1e-13)
    for field in ("Q", "R", "M", "q", "r"):
        total = sum(getattr(make(term).expand(trajectory), field) for term in terms)
        np.testing.assert_allclose(getattr(together.expand(trajectory), field), total, rtol=1e-12, atol=1e-12)


# What is refused, and how

spoiled = np.tile(np.eye(NU), (N, 1, 1))
spoiled[4, 1, 1] = -1.0


@pytest.mark.parametrize(
    "term, sentence",
    [
        (costs.Tracking(1.0, 0.0, 1.0), r"\(Tracking\): R must be positive definite, but has the eigenvalue 0"),
        (costs.Tracking(1.0, spoiled, 1.0), r"R\[4\] must be positive definite, but has the eigenvalue -1"),
        (costs.Tracking(-1.0, 1.0, 1.0), "Q must be positive semidefinite, but has the eigenvalue -1"),
        (costs.Tracking(1.0, 1.0, [1.0, 1.0, -2.0]), "Q_final must be positive semidefinite"),
        (costs.Tracking([[1, 1, 0], [0, 1, 0], [0, 0, 1]], 1.0, 1.0), "Q must be symmetric, but has an asymmetry 1"),
        (costs.Tracking(np.eye(2), 1.0, 1.0), r"Q must be a number, a diagonal \(3,\), .* got shape \(2, 2\)"),
        (costs.Tracking(1.0, 1.0, np.tile(np.eye(3), (2, 1, 1))), r"Q_final must be .* got shape \(2, 3, 3\)"),
        (costs.Tracking(np.nan, 1.0, 1.0), "Q must be finite, but Q is nan"),
        (costs.Tracking(1.0, 1.0, 1.0, x_target=np.zeros((N, NX))), r"x_target must be a state \(3,\) or one a knot"),
        (costs.Tracking(1.0, 1.0, 1.0, x_target=[0, np.inf, 0]), r"x_target must be finite, but x_target\[1\] is inf"),
        (costs.Tracking(1.0, 1.0, 1.0, u_target=np.zeros(3)), r"u_target must be a number, a vector \(2,\)"),
        (costs.State(-1.0), r"\(State\): weight must be positive semidefinite"),
        (costs.State(1.0, [1.0, 2.0]), r"target must be a state \(3,\) or one a knot \(7, 3\), got shape \(2,\)"),
        (costs.State(1.0, when="end"), "unknown when 'end'; there are: running, terminal, always"),
        (costs.Control([1.0, -1.0]), r"\(Control\): weight must be positive semidefinite"),
        (costs.Control([1.0, 1.0, 1.0]), r"weight must be .* got shape \(3,\)"),
        (costs.Control(1.0, np.zeros((N + 1, NU))), r"target must be .* got shape \(7, 2\)"),
        (costs.Residual(lambda x, u, t: x[9]), r"\(Residual\): r\(x, u, t\) fails for x of shape \(3,\): index 9"),
        (costs.Residual(lambda x: x), r"r\(x, u, t\) fails for x of shape \(3,\): .*positional argument"),
        (costs.Residual(lambda x, u, t: x, np.eye(2)), r"weight must be .* got shape \(2, 2\)"),
        (costs.Residual(lambda x, u, t: x, -1.0), "weight must be positive semidefinite"),
        (costs.Residual(lambda x, u, t: x, when="now"), "unknown when 'now'"),
        (costs.Residual(lambda x, u, t: x[:, None]), r"r\(x, u, t\) must return .*\(3, 1\)"),
        (costs.Function(lambda x, u, t: x), r"\(Function\): l\(x, u, t\) must return a number, got shape \(3,\)"),
        (costs.Function(lambda x, u, t: u[2]), r"l\(x, u, t\) fails for x of shape \(3,\)"),
        (costs.Function(lambda x, u, t: 0.0, "later"), "unknown when 'later'"),
    ],
)
def test_wrong_terms_are_refused_in_one_sentence(term, sentence):
    with pytest.raises(ValueError, match=r"^costs\[0\] .*" + sentence) as caught:
        make(term)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "term",
    [
        costs.Residual(lambda x, u, t: x, jacobian=lambda x, u, t: (np.eye(2), np.zeros((3, 2)))),
        costs.Function(lambda x, u, t: x @ x, gradient=lambda x, u, t: (x[:2], u)),
        costs.Function(lambda x, u, t: x @ x, hessian=lambda x, u, t: np.eye(3)),
    ],
    ids=["jacobian", "gradient", "hessian"],
)
def test_given_derivatives_of_the_wrong_shape_are_named(term, request):
    name = request.node.callspec.id
    with pytest.raises(ValueError, match=rf"{name}.* must return"):
        make(term).expand(random_trajectory(np.random.default_rng(0)))
