"""Trust region: the ball problem against a dense twin, Table I, global and quadratic convergence, wrong input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lq_problems import dense, random_lq
from small_problems import pendulum

from mjslq import FunctionDynamics, Problem, Status, costs, problems, solve
from mjslq.lq.box import Box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.trust_region import BallSolution, solve_in_ball
from mjslq.problems.drag_particle import OPTIMAL_COSTS
from mjslq.problems.van_der_pol import OPTIMAL_COST, PAPER_TABLE


def in_ball(problem, radius, weights, guess=0.0) -> BallSolution:
    """Without limits of the controls."""
    unlimited = np.full(problem.r.shape, np.inf)
    return solve_in_ball(problem, Box(-unlimited, unlimited), radius, weights, guess)


def check_optimal(problem, radius, weights):
    """More and Sorensen's conditions, on the dense Hessian."""
    found = in_ball(problem, radius, weights)
    U = found.found.lq.U
    H, g = dense(problem)
    W, v = np.diag(np.repeat(weights, problem.B.shape[2])), U.ravel()
    length, values = np.sqrt(v @ W @ v), np.linalg.eigvalsh(H)
    scale = np.abs(values).max() + found.multiplier * np.abs(W).max()
    assert found.multiplier >= 0.0 and length <= radius * (1.0 + 1e-6)
    assert np.linalg.eigvalsh(H + found.multiplier * W)[0] >= -1e-6 * scale
    assert np.linalg.norm((H + found.multiplier * W) @ v + g) <= 1e-5 * (np.linalg.norm(g) + scale * length)
    if found.multiplier > 0.0:
        assert length == pytest.approx(radius, rel=1e-6)
    assert found.value == pytest.approx(g @ v + 0.5 * v @ H @ v, rel=1e-8, abs=1e-10 * scale)
    assert found.value == pytest.approx(problem.value(problem.states(U), U)) and found.value < 0.0
    return found


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 0.1, 1.0, 10.0, 1e3]))
def test_the_ball_problem_is_solved_to_its_optimality_conditions(seed, radius):
    problem = random_lq(seed)
    weights = np.random.default_rng(seed).uniform(0.1, 2.0, len(problem.B))
    found = check_optimal(problem, radius, weights)
    x, lq = np.zeros(problem.A.shape[1]), found.found.lq
    for n, u in enumerate(lq.U):  # the same as feedforward beside the gains
        np.testing.assert_allclose(lq.k[n] - lq.K[n] @ x, u, rtol=1e-5, atol=1e-6 * (1.0 + np.abs(lq.k[n]).max()))
        x = problem.A[n] @ x + problem.B[n] @ u
    np.testing.assert_allclose(lq.X[-1], x, rtol=1e-8, atol=1e-9 * (1.0 + np.abs(lq.X).max()))


def diagonal(curvatures, gradient):
    """One stage, no states to speak of: H and g are given directly."""
    nu = len(curvatures)
    return LQProblem(
        np.zeros((1, 1, 1)), np.zeros((1, 1, nu)), np.zeros((2, 1, 1)), np.diag(curvatures)[None].astype(float),
        np.zeros((1, nu, 1)), np.zeros((2, 1)), np.array([gradient], dtype=float), np.zeros((1, 1)),
    )  # fmt: skip


@pytest.mark.parametrize("slight", [0.0, 1e-14, 1e-9, 1e-5])
def test_the_hard_case(slight):
    """No gradient along the direction of most negative curvature: the border is reached along that direction."""
    found = check_optimal(diagonal([-2.0, 1.0, 3.0], [slight, 1.0, 1.0]), 5.0, np.ones(1))
    assert found.multiplier == pytest.approx(2.0, abs=1e-4)
    assert abs(found.found.lq.U[0, 0]) == pytest.approx(np.sqrt(25.0 - 1 / 9 - 1 / 25), rel=1e-3)
    if slight == 1e-5:
        assert found.found.lq.U[0, 0] < 0.0


def test_a_saddle_without_any_gradient_is_left():
    found = in_ball(diagonal([-1.0, 2.0], [0.0, 0.0]), 3.0, np.ones(1))
    assert np.abs(found.found.lq.U) == pytest.approx(np.array([[3.0, 0.0]]), abs=1e-6)
    assert found.value == pytest.approx(-4.5)


def test_stages_have_to_be_positive_definite_each():
    """(2.15) alone, H_uu + alpha >= 0, would let alpha = 0 pass: the indefinite part is in the states."""
    problem = LQProblem(
        np.ones((3, 1, 1)), np.ones((3, 1, 1)), np.full((4, 1, 1), -1.0), np.ones((3, 1, 1)), np.zeros((3, 1, 1)),
        np.ones((4, 1)), np.zeros((3, 1)), np.zeros((3, 1)),
    )  # fmt: skip
    assert check_optimal(problem, 1.0, np.ones(3)).multiplier > -np.linalg.eigvalsh(dense(problem)[0])[0] > 0.0


def test_numbers_that_are_not_finite_are_told():
    with pytest.raises(NotPositiveDefinite):
        in_ball(diagonal([np.nan, 1.0], [1.0, 1.0]), 1.0, np.ones(1))


# Table I

OURS = (
    (9.437, 6.370, -2.994, 1.024, 1.0, 2.834),
    (6.370, 9.988, -6.800, -0.532, 2.0, 1.907),
    (6.370, 4.909, -1.563, 0.935, 0.5, 6.396),
    (4.909, 6.509, -1.198, -1.336, 1.0, 0.361),
    (4.909, 4.483, -0.546, 0.780, 0.25, 6.933),
    (4.483, 4.397, -0.093, 0.931, 0.5, 0.0),
)


def test_table_1():
    result = solve(problems.get("van_der_pol"), "trust-region")
    rows = [(e.cost, e.cost + e.ratio * e.predicted, e.predicted, e.ratio, e.radius, e.multiplier) for e in result.log]
    np.testing.assert_allclose(rows[:6], OURS, atol=1.2e-3)
    for ours, paper in zip(rows, PAPER_TABLE, strict=False):
        assert ours[4] == paper[4]  # the radii
        assert (ours[3] > 0.25) == (paper[3] > 0.25)  # accepted or rejected
        assert ours[0] == pytest.approx(paper[0], rel=0.017)
    assert result.status is Status.CONVERGED and len(result.log) - 1 == 9  # 12 in the paper
    assert result.iterations == 7
    assert result.cost == pytest.approx(OPTIMAL_COST, abs=1e-6)
    assert result.gradient_norm / np.sqrt(0.05) < 1e-8
    assert [entry.alpha for entry in result.log[:6]] == [1.0, 0.0, 1.0, 0.0, 1.0, 1.0]
    decisions = ["accepted", "rejected", "accepted", "rejected"] + 5 * ["accepted"] + ["final"]
    assert [entry.outcome for entry in result.log] == decisions
    assert [entry.iteration for entry in result.log] == [0, 1, 1, 2, 2, 3, 4, 5, 6, 7]


def test_rejected_trials_are_no_iterations_but_use_them_up():
    problem = problems.get("van_der_pol")
    result = solve(problem, "trust-region", max_iterations=4)
    assert result.status is Status.MAX_ITERATIONS
    assert [entry.outcome for entry in result.log] == ["accepted", "rejected", "accepted", "rejected", "final"]
    assert result.iterations == 2 and all(entry.alpha == 0.0 for entry in result.log if entry.outcome != "accepted")
    refused = result.log[1]
    assert refused.ratio < 0.25 and refused.cost == result.log[2].cost and refused.iteration == 1


def test_van_der_pol_is_the_problem_of_the_paper():
    """The cost is the fourth-order quadrature of the paper's integral along the paper's equations."""
    problem = problems.get("van_der_pol")
    U = np.random.default_rng(0).standard_normal((100, 1))

    def f(z, u):
        a, b, _ = z
        return np.array([(1.0 - b * b) * a - b + u, a, 0.5 * (a * a + b * b + u * u)])

    z, h = np.array([1.5, 1.5, 0.0]), 0.05
    for (u,) in U:
        k1 = f(z, u)
        k2 = f(z + 0.5 * h * k1, u)
        k3 = f(z + 0.5 * h * k2, u)
        z = z + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + f(z + h * k3, u))
    trajectory = problem.rollout(U)
    np.testing.assert_allclose(trajectory.X[-1], z[:2], rtol=1e-12)
    assert problem.cost(trajectory) == pytest.approx(z[2], rel=1e-12)


# Convergence


@pytest.mark.parametrize("hessian", ["newton", "gauss-newton"])
@pytest.mark.parametrize("beta", [0.1, 0.5, 1.0])
def test_drag_particle(beta, hessian):
    result = solve(problems.get("drag_particle", beta=beta), "trust-region", hessian=hessian)
    assert result.status is Status.CONVERGED and len(result.log) <= 100
    assert result.cost == pytest.approx(OPTIMAL_COSTS[beta], rel=2e-9) and result.gradient_norm < 1e-6


def test_the_last_steps_converge_quadratically():
    for problem in (problems.get("van_der_pol"), pendulum()):
        result = solve(problem, "trust-region", tol=0.0, tol_gradient=1e-9)
        g = [entry.gradient_norm for entry in result.log]
        assert result.success and g[-1] < max(50.0 * g[-2] ** 2, 1e-11) and g[-2] < 0.1 * g[-3]


def test_the_cost_never_rises_and_the_radius_follows_its_rule():
    result = solve(
        problems.get("hopper", height=10.0, engine="function"), "trust-region", eta=(0.1, 0.9), gamma=(0.5, 3.0)
    )
    J = np.array([entry.cost for entry in result.log])
    assert (np.diff(J) <= 2e-8 * J[:-1]).all() and result.success
    for entry, following in zip(result.log, result.log[1:], strict=False):
        factor = 0.5 if entry.ratio < 0.1 else 3.0 if entry.ratio >= 0.9 else 1.0
        assert following.radius == pytest.approx(factor * entry.radius)
        assert (entry.alpha == 1.0) == (entry.ratio >= 0.1) == (entry.outcome == "accepted")
        if entry.outcome == "rejected":
            assert (following.iteration, following.cost) == (entry.iteration, entry.cost)
        assert entry.direction_norm * np.sqrt(0.01) <= entry.radius * (1.0 + 1e-6)


@pytest.mark.parametrize("seed", range(50))
def test_van_der_pol_from_random_controls(seed):
    rng = np.random.default_rng(seed)
    U0 = rng.choice([1.0, 3.0, 10.0]) * rng.standard_normal((100, 1))
    result = solve(problems.get("van_der_pol"), "trust-region", U0=U0)
    assert result.status is Status.CONVERGED, result.message
    assert result.gradient_norm < 1e-8


@pytest.mark.parametrize("seed", range(10))
def test_hopper_from_random_controls(seed):
    rng = np.random.default_rng(seed)
    problem = problems.get("hopper", height=rng.uniform(5.0, 40.0), engine="function")
    U0 = rng.choice([1.0, 10.0]) * rng.standard_normal((100, 1))
    result = solve(problem, "trust-region", U0=U0, tol=0.0, tol_gradient=1e-4, max_iterations=3000)
    assert result.status is Status.CONVERGED and result.gradient_norm <= 1e-4, result.message


def test_a_saddle_point_to_start_from_is_left():
    """At U = 0 the gradient vanishes, but the curvature is negative: Theorem 3.1 wants H_uu >= 0, too."""
    dynamics = FunctionDynamics(lambda x, u: np.stack([x[1], u[0]]), 2, 1, 0.1)
    problem = Problem(
        dynamics,
        10,
        [0.0, 0.0],
        [costs.Control(0.1), costs.Function(lambda x, u, t: np.cos(3.0 * x[0]) ** 2, "terminal")],
    )
    start = problem.rollout(np.full((10, 1), 1e-7))
    result = solve(problem, "trust-region", U0=start.U, tol=0.0, tol_gradient=1e-9)
    assert result.success and result.cost < 0.7 * problem.cost(start)


@pytest.mark.parametrize(
    "options, sentence",
    [
        ({"radius": 0.0}, "radius must be positive and finite, got 0.0"),
        ({"radius": "one"}, "radius must be a number, got str 'one'"),
        ({"eta": (0.8, 0.2)}, r"eta must be a pair of numbers with 0 < eta_1 < eta_2 < 1, got \(0.8, 0.2\)"),
        ({"eta": 0.5}, "eta must be a pair of numbers"),
        ({"gamma": (0.5, 0.9)}, r"gamma must be a pair of numbers with 0 < gamma_1 < 1 < gamma_2, got"),
        ({"hessian": "exact"}, "unknown hessian 'exact'; there are: newton, gauss-newton"),
        ({"step": "closed"}, "unknown step 'closed'; there are: closed-loop, open-loop"),
    ],
)
def test_wrong_options_are_refused_in_one_sentence(options, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        solve(pendulum(), "trust-region", **options)
    assert "\n" not in str(caught.value)
