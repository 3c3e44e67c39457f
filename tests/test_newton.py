"""Newton and steepest descent: dense twins, convergence, what the papers report as failing, wrong input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lq_problems import dense, random_lq
from small_problems import pendulum

import mjslq
from mjslq import FunctionDynamics, Problem, Status, costs, problems, solve
from mjslq.lq.box import Box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.regularize import LEAST_WEIGHT, damped, modification
from mjslq.lq.riccati import solve as sweep
from mjslq.problems.drag_particle import OPTIMAL_COSTS
from mjslq.solvers.iterate import Iterate
from mjslq.solvers.linesearch import SEARCHES
from mjslq.solvers.newton import MODIFICATIONS, convex_solution, costates_ahead

seeds = st.integers(0, 2**32 - 1)


def unlimited(problem):
    return Box(np.full(problem.r.shape, -np.inf), np.full(problem.r.shape, np.inf))


@given(seeds)
def test_the_sweep_finds_the_newton_direction_where_there_is_one(seed):
    problem = random_lq(seed)
    H, g = dense(problem)
    if np.linalg.eigvalsh(H)[0] > 1e-6:
        np.testing.assert_allclose(sweep(problem).U.ravel(), np.linalg.solve(H, -g), rtol=1e-6, atol=1e-8)
    elif np.linalg.eigvalsh(H)[0] < -1e-6:
        with pytest.raises(NotPositiveDefinite):
            sweep(problem)


@given(seeds)
def test_stage_modification_makes_the_hessian_positive_definite(seed):
    problem = random_lq(seed)
    N = len(problem.B)
    E = modification(problem, np.full(N, 1e-3))
    for e in E:
        assert np.linalg.eigvalsh(e)[0] >= -1e-9  # raises only
    H, _ = dense(problem._replace(R=problem.R + E))
    values = np.linalg.eigvalsh(H)
    assert values[0] > 0.0 or values[0] > -1e-9 * values[-1]
    if np.linalg.eigvalsh(dense(problem)[0])[0] > 0.1:
        np.testing.assert_array_equal(E, 0.0)


@given(seeds, st.sampled_from(sorted(MODIFICATIONS)))
def test_every_modification_descends(seed, name):
    problem = random_lq(seed)
    N, _, nu = problem.B.shape
    convex = problem._replace(
        Q=problem.Q @ problem.Q.swapaxes(1, 2), R=np.tile(np.eye(nu), (N, 1, 1)), M=np.zeros_like(problem.M)
    )
    solution = convex_solution(problem, convex, unlimited(problem), MODIFICATIONS[name])
    assert np.vdot(dense(problem)[1], solution.found.lq.U) < 0.0
    if np.linalg.eigvalsh(dense(problem)[0])[0] > 1e-6:  # none touches a problem that is convex
        assert solution.multiplier == solution.mu == 0.0
        np.testing.assert_array_equal(solution.found.lq.U, sweep(problem).U)


@given(seeds, st.sampled_from(sorted(MODIFICATIONS)))
def test_every_modification_descends_within_limits(seed, name):
    problem, rng = random_lq(seed), np.random.default_rng(seed)
    N, _, nu = problem.B.shape
    convex = problem._replace(
        Q=problem.Q @ problem.Q.swapaxes(1, 2), R=np.tile(np.eye(nu), (N, 1, 1)), M=np.zeros_like(problem.M)
    )
    box = Box(-rng.uniform(0.0, 1.0, (N, nu)), rng.uniform(0.0, 1.0, (N, nu)))
    found = convex_solution(problem, convex, box, MODIFICATIONS[name]).found
    assert (box.lower <= found.lq.U).all() and (box.upper >= found.lq.U).all()
    assert np.vdot(dense(problem)[1], found.lq.U) < 0.0 and not found.lq.K[found.held].any()


def test_a_problem_without_control_weights_gets_the_least_multiplier():
    problem = LQProblem(
        np.ones((3, 1, 1)), np.zeros((3, 1, 1)), np.ones((4, 1, 1)), np.zeros((3, 1, 1)), np.zeros((3, 1, 1)),
        np.ones((4, 1)), np.ones((3, 1)), np.zeros((3, 1)),
    )  # fmt: skip
    solution = damped(problem, unlimited(problem))
    assert solution.mu == pytest.approx(1e-6) and solution.multiplier == pytest.approx(1e-6 * LEAST_WEIGHT)
    with pytest.raises(NotPositiveDefinite):
        damped(problem._replace(Q=np.full((4, 1, 1), np.nan), B=np.ones((3, 1, 1))), unlimited(problem))


# Convergence


@pytest.mark.parametrize("beta, iterations", [(0.01, 6), (0.05, 7), (0.1, 7), (0.5, 7), (1.0, 7)])
def test_every_drag_of_table_1_in_seven_iterations(beta, iterations):
    """The paper's Newton takes 72, 123, 90 iterations for the first three and fails beyond, its SLQ at beta = 1."""
    result = solve(problems.get("drag_particle", beta=beta), "newton")
    assert result.status is Status.CONVERGED, result.message
    assert result.iterations == iterations and result.gradient_norm < 1e-6
    assert result.cost == pytest.approx(OPTIMAL_COSTS[beta], rel=2e-9)


@pytest.mark.parametrize("beta, horizon", [(2.0, 1000), (5.0, 2500), (10.0, 10000)])
def test_stronger_drag_where_explicit_euler_is_stable(beta, horizon):
    """|v| must stay below m N / beta, which 500 steps do not allow beyond beta = 1: the mean speed alone is 10."""
    result = solve(problems.get("drag_particle", beta=beta, horizon=horizon), "newton", keep_iterates=False)
    assert result.status is Status.CONVERGED and result.iterations <= 10 and result.gradient_norm < 1e-6
    assert result.trajectory.X[-1, 0] == pytest.approx(10.0, abs=1.5)


@pytest.mark.parametrize("alpha", [1e-5, 1e-6, 1e-8])
def test_hopper_with_a_stiffer_touch_down_than_the_paper_could(alpha):
    result = solve(problems.get("hopper", height=20.0, alpha=alpha, engine="function"), "newton")
    assert result.status is Status.CONVERGED and result.iterations <= 100
    assert result.trajectory.X[-1, 0] == pytest.approx(20.0, rel=0.01) and result.cost < 260.0


@pytest.mark.parametrize("height, engine", [(5.0, "function"), (50.0, "function"), (10.0, "mujoco")])
def test_hopper(height, engine):
    result = solve(problems.get("hopper", height=height, engine=engine), "newton")
    assert result.status is Status.CONVERGED and result.iterations <= 100
    assert result.trajectory.X[-1, 0] == pytest.approx(height, rel=0.01)


@pytest.mark.parametrize("costates", ["sweep", "adjoint"])
@pytest.mark.parametrize("step", ["open-loop", "closed-loop"])
@pytest.mark.parametrize(
    "make", [pendulum, lambda: problems.get("van_der_pol")], ids=["pendulum", "van_der_pol"]
)  # fmt: skip
def test_the_last_steps_converge_quadratically(make, step, costates):
    problem = make()
    result = solve(problem, "newton", step=step, costates=costates, tol=0.0, tol_gradient=1e-9)
    assert result.status is Status.CONVERGED, result.message
    g = np.array([entry.gradient_norm for entry in result.log])
    assert [entry.alpha for entry in result.log[-3:-1]] == [1.0, 1.0] and g[-2] < 0.1 * g[-3]
    assert g[-1] < max(50.0 * g[-2] ** 2, 1e-11)
    assert all(entry.multiplier == 0.0 for entry in result.log[-2:])
    reference = solve(problem, "slq", tol=0.0, tol_gradient=1e-9, max_iterations=1000)
    assert result.cost == pytest.approx(reference.cost, rel=1e-10)


@pytest.mark.parametrize("modification", sorted(MODIFICATIONS))
@pytest.mark.parametrize("line_search", sorted(SEARCHES))
def test_searches_and_modifications(line_search, modification):
    result = solve(pendulum(), "newton", line_search=line_search, modification=modification)
    assert result.status is Status.CONVERGED, result.message
    J = np.array([entry.cost for entry in result.log])
    assert (np.diff(J) <= 2e-8 * np.abs(J[:-1])).all() and all(entry.slope < 0.0 for entry in result.log)
    assert result.gradient_norm < 1e-3


def test_costates_of_the_sweep_are_those_of_the_trajectory_at_an_optimum():
    problem = pendulum()
    optimum = Iterate(problem, solve(problem, "newton", tol=0.0, tol_gradient=1e-9).trajectory)
    np.testing.assert_allclose(costates_ahead(optimum), optimum.costates, rtol=1e-6, atol=1e-7)
    start = Iterate(problem, problem.rollout(np.zeros((40, 1))))
    assert np.abs(costates_ahead(start) - start.costates).max() > 1.0


def test_an_unstable_arm_converges():
    """Its total Hessian, the controls being open-loop, has eigenvalues of -1e10 at the start."""
    result = solve(problems.get("panda_reach", horizon=60), "newton", max_iterations=60)
    assert result.status is Status.CONVERGED, result.message
    assert result.cost < 1.0


def test_a_direction_kept_short_is_not_taken_for_convergence():
    """Where the model is not convex, a large multiplier makes a short direction far from any minimum."""
    problem = problems.get("hopper", height=20.0, alpha=1e-5, engine="function")
    result = solve(problem, "newton")
    assert any(entry.multiplier > 0.0 for entry in result.log) and result.log[-1].multiplier == 0.0


def test_costs_without_curvature_in_a_control():
    dynamics = FunctionDynamics(lambda x, u: np.stack([x[1], u[0] - np.sin(x[0])]), 2, 2, 0.1)
    problem = Problem(dynamics, 10, [0.0, 0.0], [costs.Function(lambda x, u, t: 0.5 * u[0] ** 2 + (x[0] - 1.0) ** 2)])
    result = solve(problem, "newton")
    assert result.status is Status.CONVERGED and np.abs(result.trajectory.U[:, 1]).max() < 1e-6


# Steepest descent


def test_steepest_descent_at_beta_01_of_figure_2():
    """Relative cost 0.512 after 10 iterations, 0.484 after 300: no method for this problem."""
    result = solve(problems.get("drag_particle", beta=0.1), "gradient", max_iterations=12)
    assert result.status is Status.MAX_ITERATIONS
    J = np.array([entry.cost for entry in result.log])
    assert (np.diff(J) < 0.0).all()
    assert 0.4 < J[10] / OPTIMAL_COSTS[0.1] - 1.0 < 0.65
    assert result.gains is None


def test_steepest_descent_converges_on_a_well_conditioned_problem():
    dynamics = FunctionDynamics(lambda x, u: np.stack([x[1], u[0] - np.sin(x[0])]), 2, 1, 0.1)
    problem = Problem(dynamics, 10, [0.0, 0.0], [costs.Control(1.0), costs.State(1.0, [1.0, 0.0], "terminal")])
    result = solve(problem, "gradient")
    assert result.status is Status.CONVERGED and result.gradient_norm <= 1e-6
    assert result.cost == pytest.approx(solve(problem, "slq").cost, rel=1e-9)
    first, second = (entry.direction_norm for entry in result.log[:2])
    assert second == pytest.approx(4.0 * result.log[0].alpha * first)


def test_steepest_descent_is_exact_along_its_ray():
    problem = pendulum()
    result = solve(problem, "gradient", max_iterations=3)
    for a, b in zip(result.iterates[1:-1], result.iterates[2:], strict=True):
        along = b.U - a.U
        assert abs(np.vdot(problem.gradient(b), along)) < 1e-3 * abs(np.vdot(problem.gradient(a), along))


# Every problem of the catalogue, and wrong input


@pytest.mark.parametrize("method", ["newton", "gradient", "trust-region"])
@pytest.mark.parametrize("name", ["drag_particle", "hopper", "panda_reach", "solo12_stand", "van_der_pol"])
def test_every_problem_of_the_catalogue_can_be_taken(name, method):
    problem = problems.get(name, horizon=10)
    result = solve(problem, method, max_iterations=2)
    assert result.status in (Status.MAX_ITERATIONS, Status.CONVERGED), result.message
    assert result.cost <= problem.cost(problem.rollout(problem.U0))


def test_ways_to_end():
    def blows_up(x, u):
        return x * x + u

    dynamics = FunctionDynamics(blows_up, 1, 1, 1.0, integrator="map")
    for method in ("newton", "gradient", "trust-region"):
        assert solve(Problem(dynamics, 20, [10.0], [costs.Control(1.0)]), method).status is Status.DIVERGED
        stopped = solve(pendulum(), method, callback=lambda entry: entry.iteration == 1)
        assert stopped.status is Status.STOPPED
        assert stopped.cost == pendulum().cost(stopped.trajectory)


@pytest.mark.parametrize(
    "method, options, sentence",
    [
        ("newton", {"modification": "stages"}, "unknown modification 'stages'; there are: multiplier, blend, stage"),
        ("newton", {"costates": "adjont"}, "unknown costates 'adjont'; there are: sweep, adjoint; did you mean"),
        ("newton", {"line_search": "none"}, "unknown line_search 'none'; there are"),
        ("newton", {"step": 1}, "unknown step 1; there are: closed-loop, open-loop"),
        ("newton", {"acceleration": 1}, "acceleration must be True or False, got int 1"),
        ("gradient", {"step": "open-loop"}, "unknown option for method 'gradient' 'step'; there are: line_search, tol"),
    ],
)  # fmt: skip
def test_wrong_options_are_refused_in_one_sentence(method, options, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        solve(pendulum(), method, **options)
    assert "\n" not in str(caught.value)


def test_methods_tell_what_they_need():
    table = mjslq.methods()
    assert table["newton"].needs == table["trust-region"].needs == "second derivatives"
    assert table["gradient"].needs == "first derivatives" and table["gradient"].options == {"line_search": "exact"}
