"""The method `square-root-sweep`: the thesis's examples, its acceptance rule, its ways out, and what it promises."""

import dataclasses
import itertools

import numpy as np
import pytest

import mjslq
from mjslq import FunctionDynamics, Problem, Status, problems, solve
from mjslq.constraints import Control as Limits
from mjslq.constraints import Initial, Path, State, Terminal
from mjslq.costs import Control, Function
from mjslq.costs import State as Near
from mjslq.options import SquareRootSweepOptions
from mjslq.solvers.constraint_rows import ConstrainedIterate
from mjslq.solvers.square_root_sweep import SquareRootSweep

METHOD = "square-root-sweep"


def double(N=12, constraints=(), costs=None, limits=None, nu=1):
    """A double integrator from rest at 0."""
    bounds = {} if limits is None else {"control_limits": limits}
    engine = FunctionDynamics(lambda x, u: [x[1], u.sum()], 2, nu, 1.0 / N, **bounds)
    return Problem(engine, N, [0.0, 0.0], costs or [Control(1.0)], constraints=constraints, U0=np.full(nu, 0.5))


def goal(x=1.0):
    return State([x, 0.0], [x, 0.0], "terminal", name="goal")


def dense(problem, trajectory):
    """G with dX = G dU, the states in a row."""
    A, B = problem.dynamics.linearize(trajectory)[:2]
    N, nx, nu = B.shape
    G = np.zeros((N + 1, nx, N * nu))
    for n in range(N):
        G[n + 1] = A[n] @ G[n]
        G[n + 1][:, n * nu : (n + 1) * nu] += B[n]
    return G


# One iteration


@pytest.mark.parametrize("weights", [None, (1.0, 4.0)])
def test_a_step_is_the_shortest_change_that_meets_its_rows(weights):
    """(2.46) subject to rows for the cost, the end and the violated wall, by a dense pseudo-inverse."""
    wall = State(None, [0.2, np.inf], name="wall")
    problem = double(constraints=[wall, goal(0.0)], nu=2)
    trajectory = problem.rollout(np.random.default_rng(0).uniform(0.2, 0.8, (12, 2)))
    method = SquareRootSweep(SquareRootSweepOptions(weights=weights, cost_decrease=0.05, path_share=0.5))
    here = method.begin(ConstrainedIterate(problem, trajectory))
    direction = method.direction(here)
    G, over = dense(problem, trajectory), trajectory.X[:, 0] - 0.2
    violated = np.flatnonzero(over[:-1] > 0.0)
    assert violated.size
    final = [G[-1], -trajectory.X[-1]]
    rows = np.vstack([G[violated, 0], final[0], problem.gradient(trajectory).ravel()[None]])
    d = np.concatenate([-0.5 * over[violated], final[1], [-0.05 * here.cost]])
    # the wall acts at the last knot, too, where its row depends on the goal's: it contradicts with half a correction
    assert over[-1] > 0.0
    problem_without = dataclasses.replace(problem, constraints=[dataclasses.replace(wall, when="running"), goal(0.0)])
    here = method.begin(ConstrainedIterate(problem_without, trajectory))
    direction = method.direction(here)
    scale = 1.0 / np.sqrt(np.tile(weights or (1.0, 1.0), 12))
    expected = scale * (np.linalg.pinv(rows * scale) @ d)
    np.testing.assert_allclose(direction.U.ravel(), expected, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(direction.X, np.einsum("nij,j->ni", G, expected), atol=1e-9)
    assert direction.expected == pytest.approx(-0.05 * here.cost, rel=1e-9)


def test_terminal_costs_of_the_user_and_running_ones_give_the_same_row():
    """(4.6): the cost as a state of the user's own, and as the additional one of the method."""
    inside = double(constraints=[goal()])
    N, dt = 12, 1.0 / 12
    engine = FunctionDynamics(lambda x, u: [x[1], u[0], 0.5 * u[0] * u[0]], 3, 1, dt)
    ends = State([1.0, 0.0, -np.inf], [1.0, 0.0, np.inf], "terminal")
    own = Problem(engine, N, np.zeros(3), [Function(lambda x, u, t: x[2], "terminal")], constraints=[ends], U0=[0.5])
    wall = State(None, [np.inf, 1.3], name="speed"), State(None, [np.inf, 1.3, np.inf], name="speed")
    inside, own = (
        dataclasses.replace(problem, constraints=[*problem.constraints, limit])
        for problem, limit in zip((inside, own), wall, strict=True)
    )
    U0 = np.random.default_rng(1).uniform(-3.0, 3.0, (N, 1))
    found = [solve(problem, METHOD, U0=U0, max_iterations=4, step="open-loop") for problem in (inside, own)]
    assert found[0].iterations == found[1].iterations == 4
    assert found[0].cost == pytest.approx(found[1].cost, rel=1e-9)
    np.testing.assert_allclose(found[0].trajectory.U, found[1].trajectory.U, atol=1e-8)


def test_steps_of_the_log_obey_section_2_5():
    """Violations fall, or the cost falls while they are none; the cost rises by no more than is allowed."""
    problem = problems.get("drag_cart", horizon=30)
    result = solve(problem, METHOD, degradation=0.2, max_iterations=60, tol_violation=1e-8)
    steps = [entry for entry in result.log if entry.outcome == "accepted"]
    assert len(steps) > 5
    for now, after in itertools.pairwise(result.log):
        if now.outcome == "accepted":
            fell = after.violation < max(now.violation, 1e-9)
            assert fell or after.cost < now.cost


# The thesis's examples


@pytest.mark.parametrize("N, optimum, above", [(17, 4.4880, 0.06), (50, 4.4494, 0.11)])
def test_example_1_ends_feasible_near_the_optimum_and_says_that_it_has_not_converged(N, optimum, above):
    problem = problems.get("bryson_denham", horizon=N)
    result = solve(problem, METHOD, threshold=1.1)
    assert result.status is Status.STEP_TOO_SMALL and not result.success
    assert result.constraint_violation <= 1e-6
    assert optimum - 1e-4 < result.cost < optimum + above
    assert "no decrease of the cost keeps them so: the projected gradient is" in result.message
    assert result.log[1].cost > result.log[0].cost == pytest.approx(2.0)  # the first does without it (section 4.2)
    assert "of them without the row of the cost" in result.message


def test_a_threshold_is_what_example_1_needs():
    problem = problems.get("bryson_denham", horizon=17)
    plain, thresholded = (solve(problem, METHOD, threshold=threshold).cost for threshold in (1.0, 1.3))
    assert thresholded == pytest.approx(4.4880, abs=1e-4)
    assert plain > 10.0


def test_the_first_step_of_example_1_is_without_the_cost_where_its_row_is_parallel_to_others():
    problem = problems.get("bryson_denham", horizon=10)
    free = dataclasses.replace(problem, constraints=[problem.constraints[1]])
    result = solve(free, METHOD, max_iterations=5)
    assert result.status is Status.CONVERGED and result.cost == pytest.approx(2.0, rel=1e-6)


def test_reentry_by_the_recipe_of_section_5_4():
    """The limit of the angle first, then both, with the controls as they are: in 8 iterations at most."""
    problem = problems.get("reentry", limits="row")
    result = solve(problem, METHOD, first=("attack",), step="open-loop")
    assert result.success and result.iterations <= 8 and result.constraint_violation <= 1e-6
    again = problem.rollout(result.trajectory.U)
    assert np.degrees(again.U.max()) <= 22.5 + 1e-4 and abs(np.degrees(again.X[-1, 1])) <= 1e-6
    assert problems.reentry.loads(again).max() <= 5.0 + 1e-6


def test_reentry_with_all_rows_at_once_is_told_to_contradict():
    result = solve(problems.get("reentry", limits="row"), METHOD)
    assert not result.success and result.iterations == 0
    assert "contradict each other, linearized: 'attack' at 4 steps from 60 to 63, 'load' at 4" in result.message


# What it promises


def test_convergence_means_the_first_order_conditions():
    """Where it converges, the result's multipliers make the gradient of the Lagrangian zero, by dense algebra."""
    wall = State(None, [np.inf, 1.4], name="speed")
    problem = double(20, [wall, goal()], [Control(1.0), Near([0.0, 0.1])], limits=(-6.0, 6.0))
    start = solve(problem, "constrained", tol_gradient=1e-10, tol_violation=1e-10)
    assert start.success
    result = solve(problem, METHOD, guess=start, tol_gradient=1e-5, tol_violation=1e-7)
    assert result.success and result.iterations <= 1
    assert (result.multipliers["speed"] >= 0.0).all() and result.multipliers["speed"].max() > 1e-3
    G = dense(problem, result.trajectory)
    gradient = problem.gradient(result.trajectory).ravel() + result.multipliers["controls"].ravel()
    for constraint in problem.bound_constraints:
        J = constraint.residual.jacobian(result.trajectory, problem.dynamics.linearize(result.trajectory)).x
        at = constraint.residual.knots.indices
        gradient += np.einsum("ki,kij,kjm->m", result.multipliers[constraint.name], J, G[at])
    assert np.abs(gradient).max() < 1e-5
    np.testing.assert_allclose(result.gradient_norm, np.linalg.norm(gradient), atol=1e-8)


def test_no_convergence_where_a_multiplier_has_the_wrong_sign():
    """On a limit that the cost would leave, the projected gradient is not zero."""
    problem = double(constraints=[State([-np.inf, 0.0], [np.inf, 0.5], name="speed")], costs=[Control(1.0), Near(1.0)])
    U = np.zeros((12, 1))
    U[0] = 6.0  # at the limit of the speed from the first step on, for nothing
    here = ConstrainedIterate(problem, problem.rollout(U))
    assert here.violation < 1e-12
    np.testing.assert_allclose(here.projected_gradient, problem.gradient(here.trajectory), atol=1e-9)
    assert not here.duals.multipliers["speed"].any()


def test_limits_of_controls_are_rows_and_have_multipliers():
    problem = double(constraints=[goal(0.3), Limits(-2.0, 2.0)])
    result = solve(problem, METHOD, threshold=1.1, max_iterations=200)
    assert np.abs(result.trajectory.U).max() <= 2.0 + 1e-6 and result.constraint_violation <= 1e-6
    assert result.multipliers["controls"].shape == (12, 1)


def test_free_initial_states_are_unknowns():
    """One step of minimum norm in (dx_0, du) to a goal, the first speed free, by a dense pseudo-inverse."""
    problem = double(constraints=[Initial(free=1), goal(0.3)])
    here = ConstrainedIterate(problem, problem.rollout(problem.U0))
    method = SquareRootSweep(SquareRootSweepOptions(cost_row=False))
    direction = method.direction(method.begin(here))
    A = problem.dynamics.linearize(here.trajectory).A
    G = np.hstack([np.linalg.multi_dot(A[::-1])[:, 1:], dense(problem, here.trajectory)[-1]])
    # of all that meet the goal the shortest change of the controls; x_0 costs nothing
    final = np.array([0.3, 0.0]) - here.trajectory.X[-1]
    speed = np.linalg.lstsq((P := np.linalg.pinv(G[:, 1:])) @ G[:, :1], P @ final)[0]
    np.testing.assert_allclose(direction.X[0], [0.0, speed[0]], atol=1e-9)
    np.testing.assert_allclose(direction.U.ravel(), P @ (final - G[:, 0] * speed[0]), atol=1e-9)


def test_an_initial_manifold():
    """(2.3a): q(x_0) = 0 and the costate of the first knot belong together."""
    engine = FunctionDynamics(lambda x, u: [x[1], u[0]], 2, 1, 1.0 / 12)
    on_circle = Initial(lambda x: x @ x - 1.0, name="circle")
    problem = Problem(engine, 12, [0.6, 0.7], [Control(1.0)], constraints=[on_circle, goal(2.0)], U0=[0.5])
    start = solve(problem, "constrained", tol_violation=1e-10)
    assert start.success
    result = solve(problem, METHOD, guess=start, tol_gradient=1e-5, tol_violation=1e-8)
    assert result.success and result.iterations <= 2
    x0 = result.trajectory.X[0]
    assert x0 @ x0 == pytest.approx(1.0, abs=1e-7)
    G = np.linalg.multi_dot(problem.dynamics.linearize(result.trajectory).A[::-1])
    costate = result.multipliers["goal"][0] @ G
    np.testing.assert_allclose(costate, -2.0 * x0 * result.multipliers["circle"].item(), atol=1e-5)


@pytest.mark.parametrize("method", [METHOD, "constrained"])
def test_section_3_6_to_all_digits(method):
    """Places, speeds, forces, cost and multipliers of the analytic example (by the sweep in one step)."""
    result = solve(problems.get("three_samples"), method, tol_violation=1e-10, tol_gradient=1e-9)
    assert result.success and (result.iterations == 1 or method != METHOD)
    np.testing.assert_allclose(result.trajectory.U.ravel(), [0.6, 0.2], atol=1e-9)
    np.testing.assert_allclose(result.trajectory.X, [[0.0, 0.0], [0.3, 0.6], [1.0, 0.8]], atol=1e-9)
    assert result.cost == pytest.approx(0.2, abs=1e-9)
    found = {name: float(value.item()) for name, value in result.multipliers.items()}
    assert found == pytest.approx({"b": 2.4, "c": -1.2, "d": 0.4}, abs=1e-8)


@pytest.mark.parametrize("a, b, c, d", [(0.5, -0.2, 0.1, 1.0), (1.0, 2.0, 2.5, -0.3)])
def test_section_3_6_with_other_numbers(a, b, c, d):
    """(3.139), and du(1) = d."""
    result = solve(problems.get("three_samples", a=a, b=b, c=c, d=d), METHOD)
    U, X = result.trajectory.U.ravel(), result.trajectory.X
    assert result.success and U[1] == pytest.approx(d)
    assert U[0] == pytest.approx(-4.0 / 3.0 * X[0, 1] - 2.0 / 3.0 * a - (d - 2.0 * c) / 3.0)
    np.testing.assert_allclose(X[:, 0], [a, b, c], atol=1e-9)


def test_an_unconstrained_problem_goes_downhill():
    problem = double(costs=[Control(1.0), Near([10.0, 0.0], [1.0, 0.0], "terminal")])
    result = solve(problem, METHOD, max_iterations=30)
    costs = [entry.cost for entry in result.log]
    assert all(after < now for now, after in itertools.pairwise(costs))
    assert result.cost < 0.7 * costs[0]


def test_feasible_is_not_converged_where_no_decrease_was_asked_for():
    result = solve(double(constraints=[goal()]), METHOD, cost_row=False)
    assert result.constraint_violation <= 1e-6
    if not result.success:
        assert "the cost was not asked to decrease (cost_row=False)" in result.message


def test_rows_that_nothing_can_meet_are_named():
    wall = State(None, [0.4, np.inf], "terminal", name="wall")
    result = solve(double(constraints=[wall, goal()]), METHOD)
    assert not result.success and "Rows contradict each other" in result.message
    assert "'wall'" in result.message and "'goal'" in result.message


def test_a_car_at_rest_cannot_turn_and_the_message_says_which_rows():
    result = solve(problems.get("car_obstacles"), METHOD)
    assert not result.success and "'goal' at 2 steps from 60 to 60" in result.message


@pytest.mark.parametrize(
    "options, said",
    [
        ({"first": ("wal",)}, "unknown constraint in option 'first' 'wal'; there are: wall, goal, controls; did you"),
        ({"weights": (1.0, 2.0)}, "option 'weights' must have one number a control, 1, got 2"),
    ],
)
def test_options_that_do_not_fit_the_problem(options, said):
    with pytest.raises(ValueError, match=said):
        solve(problems.get("bryson_denham", horizon=10), METHOD, **options)


def test_constraints_of_the_initial_state_are_left_alone():
    """What no control can move is no row."""
    result = solve(double(constraints=[State(None, [-0.1, np.inf], 0, name="here"), goal()]), METHOD)
    assert not result.success and result.violations["here"][0] == pytest.approx(0.1)


def test_on_mujoco():
    """A pole is brought to an angle, at rest, under a limit of its speed."""
    pole = mjslq.MujocoDynamics.from_xml(
        """<mujoco><option timestep="0.02"/><worldbody><body><joint name="hinge" axis="0 1 0" damping=".05"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1" contype="0" conaffinity="0"/></body>
        </worldbody><actuator><motor joint="hinge"/></actuator></mujoco>"""
    )
    problem = Problem(
        pole, 40, [0.0, 0.0], [Control(1.0)],
        constraints=[Terminal(lambda x: x - np.array([0.8, 0.0]), name="goal"),
                     Path(lambda x, u, t: x[1:] - 1.7, name="speed")],
    )  # fmt: skip
    result = solve(problem, METHOD, threshold=1.1, max_iterations=60)
    again = problem.rollout(result.trajectory.U)
    assert problem.violation(again) <= 1e-6
    best = solve(problem)
    assert best.success and result.cost < 1.3 * best.cost
