"""The method `constrained`: known optima, a quadratic program, verdicts, duals, and endings that lose nothing."""

import numpy as np
import pytest
from constrained_problems import bryson_denham, car, cart_pole, quadrotor, reentry, starts
from scipy.optimize import linprog, minimize

import mjslq
from mjslq import Bounds, FunctionDynamics, MujocoDynamics, Problem, Status, solve
from mjslq.constraints import Path, Sensor, State, Terminal
from mjslq.costs import Control, Tracking
from mjslq.costs import State as Near
from mjslq.lq.adjoint import adjoint

POLE = """<mujoco><option timestep="0.02"/><worldbody><body pos="0 0 1"><joint name="hinge" axis="0 1 0" damping=".05"/>
<geom name="rod" type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1" contype="0" conaffinity="0"/>
<site name="tip" pos="0 0 -.5"/></body>
<geom name="wall" type="box" size=".05 .5 1" pos=".4 0 1" contype="0" conaffinity="0"/></worldbody>
<actuator><motor name="m" joint="hinge" ctrlrange="-6 6" ctrllimited="true"/></actuator>
<sensor><framepos name="tip" objtype="site" objname="tip"/><distance name="gap" geom1="rod" geom2="wall" cutoff="5"/>
</sensor></mujoco>"""


def stationarity(problem, result):
    """Gradient of the Lagrangian made of the result's multipliers, without what limits of the controls hold."""
    trajectory, dynamics = result.trajectory, problem.dynamics
    linearization = dynamics.linearize(trajectory)
    expansion = problem.expand(trajectory, linearization)
    q, r = expansion.q.copy(), expansion.r.copy()
    for constraint in problem.bound_constraints:
        multipliers, knots = result.multipliers[constraint.name], constraint.residual.knots
        J = constraint.residual.jacobian(trajectory, linearization)
        if J.x is not None:
            q[knots.indices] += np.einsum("nij,ni->nj", J.x, multipliers)
        if J.u is not None:
            r[knots.steps] += np.einsum("nij,ni->nj", J.u, multipliers)[: len(knots.steps)]
    gradient = adjoint(linearization.A, linearization.B, q, r)[1]
    return float(np.abs(problem.box.projected(trajectory.U, gradient)).max())


def check_solution(problem, result, cost, tol=1e-4):
    assert result.success and result.method == "constrained", result.message
    assert result.constraint_violation == problem.violation(problem.rollout(result.trajectory.U)) <= 1e-6
    assert result.cost == pytest.approx(cost, abs=tol) and problem.cost(result.trajectory) == result.cost
    assert stationarity(problem, result) < 1e-4
    for constraint in problem.bound_constraints:
        r, multipliers = constraint.residual.value(result.trajectory), result.multipliers[constraint.name]
        assert np.abs(r - constraint.upper)[multipliers > 1e-6].max(initial=0.0) < 2e-6
        assert np.abs(r - constraint.lower)[multipliers < -1e-6].max(initial=0.0) < 2e-6


@pytest.mark.parametrize("start", range(4))
@pytest.mark.parametrize(
    "make,cost,sweeps", [(bryson_denham, 4.44939, 32), (cart_pole, 15.31268, 75), (car, 0.520328, 55)]
)
def test_known_optima_from_good_and_poor_starts(make, cost, sweeps, start):
    problem = make()
    result = solve(problem, U0=starts(problem, 0)[start])
    check_solution(problem, result, cost)
    assert len(result.log) <= sweeps and result.constraint_violation <= 1e-9


@pytest.mark.parametrize("N,cost", [(10, 4.5745), (17, 4.4880), (200, 4.44475)])
def test_bryson_and_denham_at_other_steps(N, cost):
    check_solution(bryson_denham(N), solve(bryson_denham(N)), cost, 1e-4)


def test_reentry_from_the_nominal_angles():
    problem = reentry()
    check_solution(problem, solve(problem), 0.40124)


def test_a_quadrotor_past_discs_ends_at_a_stationary_point():
    problem = quadrotor()
    result = solve(problem)
    assert result.success and stationarity(problem, result) < 1e-4 and result.constraint_violation <= 1e-6
    assert result.cost < 0.1  # the best optimum known is 0.0885


def linear_problem(rng, N=6, nx=3, nu=2):
    """A linear system with a quadratic cost, limits of states and controls, and rows of both."""
    A, B = rng.standard_normal((nx, nx)) / 1.5, rng.standard_normal((nx, nu))
    C, D, d = rng.standard_normal((2, nx)), rng.standard_normal((2, nu)), rng.uniform(0.5, 1.5, 2)
    root = rng.standard_normal((nx, nx))
    engine = FunctionDynamics(lambda x, u: A @ x + B @ u, nx, nu, 1.0, integrator="map", control_limits=(-0.8, 0.8))
    target, goal = rng.standard_normal(nx), 0.3 * rng.standard_normal()
    return Problem(
        engine, N, rng.standard_normal(nx),
        [Tracking(root.T @ root, np.eye(nu), 10.0, target)],
        bounds=Bounds(x=(np.vstack([np.full(nx, -np.inf), np.full((N, nx), -3.0)]), None)),
        constraints=[Path(lambda x, u, t: C @ x + D @ u - d, when=slice(1, N)), Terminal(lambda x: x[0] - goal)],
    )  # fmt: skip


def by_quadratic_program(problem):
    """Least cost over the controls alone by SLSQP, None where linear programming finds no controls at all."""
    N, nu = problem.box.lower.shape
    at = lambda U: problem.rollout(U.reshape(N, nu))  # noqa: E731
    zero, units = at(np.zeros(N * nu)), np.eye(N * nu)
    rows, ends = [], []
    for constraint in problem.bound_constraints:
        value = constraint.residual.value(zero).ravel()
        rows.append(np.stack([constraint.residual.value(at(unit)).ravel() - value for unit in units], axis=1))
        ends.append(np.stack([constraint.lower.ravel() - value, constraint.upper.ravel() - value]))
    rows, (low, high) = np.vstack(rows), np.hstack(ends)
    equal, below, above = low == high, (low != high) & np.isfinite(low), (low != high) & np.isfinite(high)
    A, a = np.vstack([rows[above], -rows[below]]), np.concatenate([high[above], -low[below]])
    limits = [(-0.8, 0.8)] * (N * nu)
    inside = linprog(np.zeros(N * nu), A, a, rows[equal], low[equal], limits)
    if inside.status == 2:
        return None
    g = problem.gradient(zero).ravel()
    H = np.stack([problem.gradient(at(unit)).ravel() - g for unit in units])
    found = minimize(
        lambda U: 0.5 * U @ H @ U + g @ U, inside.x, jac=lambda U: H @ U + g, method="SLSQP", bounds=limits,
        constraints=[
            {"type": "ineq", "fun": lambda U: a - A @ U, "jac": lambda U: -A},
            {"type": "eq", "fun": lambda U: rows[equal] @ U - low[equal], "jac": lambda U: rows[equal]},
        ],
        options={"maxiter": 1000, "ftol": 1e-14},
    )  # fmt: skip
    assert found.status in (0, 8), found.message  # 8: the last digits
    return problem.cost(zero) + float(found.fun)


def test_linear_problems_agree_with_a_quadratic_program():
    rng, feasible = np.random.default_rng(0), 0
    for _ in range(30):
        problem = linear_problem(rng)
        cost, result = by_quadratic_program(problem), solve(problem, tol_violation=1e-9)
        if cost is None:
            assert result.status is Status.INFEASIBLE, result.message
            continue
        feasible += 1
        assert result.success, result.message
        assert result.cost == pytest.approx(cost, rel=1e-6, abs=1e-6)
    assert feasible > 10


def test_multipliers_are_the_price_of_a_limit():
    def cost(limit, goal):
        ends = [0.0, goal]
        given = bryson_denham()
        walls = [State(None, [limit, np.inf], name="wall"), State(ends, ends, "terminal", name="goal")]
        problem = Problem(given.dynamics, 50, [0.0, 1.0], [Control(1.0)], constraints=walls)
        return solve(problem, tol_violation=1e-10, tol=1e-10)

    here, e = cost(0.1, -1.0), 1e-5
    by_limit = (cost(0.1 + e, -1.0).cost - cost(0.1 - e, -1.0).cost) / (2.0 * e)
    by_goal = (cost(0.1, -1.0 + e).cost - cost(0.1, -1.0 - e).cost) / (2.0 * e)
    assert here.multipliers["wall"][:, 0].sum() == pytest.approx(-by_limit, rel=1e-3)
    assert here.multipliers["goal"][0, 1] == pytest.approx(-by_goal, rel=1e-3)
    assert (here.multipliers["wall"] >= 0.0).all()


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_units_of_the_cost_do_not_matter(factor):
    given = car()
    problem = Problem(
        given.dynamics, 60, given.x0, [Control(factor)], bounds=given.bounds, constraints=given.constraints
    )
    result = solve(problem)
    assert result.success and result.cost / factor == pytest.approx(0.520328, abs=1e-4) and len(result.log) < 70


@pytest.mark.parametrize("curvature", ["always", "never"])
def test_with_and_without_second_derivatives(curvature):
    check_solution(car(), solve(car(), curvature=curvature), 0.520328)


@pytest.mark.parametrize(
    "make,names",
    [
        (lambda: bryson_denham(force=4.0), ("wall", "goal")),
        (lambda: cart_pole(force=1.0), ("goal",)),
        (lambda: car(discs=(2.5, 2.2, 0.3)), ("discs", "goal")),
    ],
)
def test_problems_without_a_solution_are_called_so(make, names):
    result = solve(make())
    assert result.status is Status.INFEASIBLE and not result.success
    assert all(f"{name!r} at" in result.message for name in names) and "2 restarts" in result.message
    assert len(result.log) < 3 * 80 and result.constraint_violation > 1e-3


def test_an_initial_state_that_violates_a_constraint_is_named_at_once():
    problem = bryson_denham(limit=-0.1)
    result = solve(problem)
    assert result.status is Status.INFEASIBLE and len(result.log) == 1
    assert "initial state itself violates 'wall', by 0.1" in result.message


def pole(**options):
    dynamics = MujocoDynamics.from_xml(POLE)
    costs = [Control(0.01), Near([10.0, 0.1], [-1.0, 0.0], "terminal")]
    return Problem(dynamics, 60, np.zeros(2), costs, **options)


@pytest.mark.parametrize(
    "constraint", [Sensor("tip", [-np.inf, -1.0, -1.0], [0.3, 1.0, 1.0], name="in"), Sensor("gap", 0.02)]
)
def test_sensors_of_mujoco_are_limited(constraint):
    unlimited, problem = solve(pole()), pole(constraints=[constraint])
    assert problem.violation(unlimited.trajectory) > 0.01
    result = solve(problem)
    assert result.success, result.message
    again = problem.rollout(result.trajectory.U)
    assert problem.violation(again) == result.constraint_violation <= 1e-6
    assert result.cost > unlimited.cost and np.abs(result.multipliers[next(iter(result.violations))]).max() > 0.0


def test_an_arm_keeps_its_joints_slow():
    given = mjslq.problems.get("panda_reach")
    free = solve(given)
    limit = np.full(14, np.inf)
    limit[7:] = 0.8 * np.abs(free.trajectory.X[:, 7:]).max(axis=0)
    problem = Problem(
        given.dynamics, given.horizon, given.x0, given.costs, bounds=Bounds(x=(-limit, limit)), U0=given.U0
    )
    result = solve(problem, curvature="never")
    assert result.success, result.message
    assert problem.violation(problem.rollout(result.trajectory.U)) == result.constraint_violation <= 1e-6
    assert result.cost > free.cost


def test_auto_takes_constraints_and_says_so_and_others_refuse():
    problem = bryson_denham()
    assert "'constrained', since the problem has constraints" in solve(problem, max_iterations=1).message
    for method in ("slq", "newton", "gradient", "trust-region", "ilqr"):
        with pytest.raises(ValueError, match="but the problem has 'wall', 'goal'; these do: auto"):
            solve(problem, method)
    with pytest.raises(ValueError, match="with constraints takes no state guess X0; give controls"):
        solve(problem, X0=np.zeros((51, 2)))
    with pytest.raises(ValueError, match="tol_violation must be"):
        solve(problem, tol_violation=0.0)


def test_without_constraints_it_is_the_sweeps_of_auto():
    problem = mjslq.problems.get("drag_particle")
    plain, constrained = solve(problem), solve(problem, "constrained")
    assert plain.cost == constrained.cost and len(plain.log) == len(constrained.log)


def test_results_are_kept_in_files(tmp_path):
    result = solve(bryson_denham())
    result.save(tmp_path / "result.npz")
    again = mjslq.load(tmp_path / "result.npz")
    assert again.constraint_violation == result.constraint_violation and again.log == result.log
    for kind in ("violations", "multipliers"):
        ours, theirs = getattr(result, kind), getattr(again, kind)
        assert ours.keys() == theirs.keys() and all((ours[name] == theirs[name]).all() for name in ours)


def keeps_the_best(result, problem):
    seen = [(max(problem.violation(t), 1e-6), problem.cost(t)) for t in result.iterates]
    mine = max(result.constraint_violation, 1e-6), result.cost
    return mine <= min(seen) and np.isfinite(result.gains).all()


def test_whatever_ends_a_solve_the_best_iterate_is_kept():
    problem = car()

    def stop(entry):
        return entry.iteration == 12

    def interrupt(entry):
        if entry.iteration == 12:
            raise KeyboardInterrupt

    def fail(entry):
        if entry.iteration == 12:
            raise RuntimeError("a slip")

    for options, status in (
        ({"callback": stop}, Status.STOPPED),
        ({"callback": interrupt}, Status.INTERRUPTED),
        ({"callback": fail}, Status.FAILED),
        ({"max_iterations": 15}, Status.MAX_ITERATIONS),
    ):
        result = solve(problem, **options)
        assert result.status is status and keeps_the_best(result, problem)
        assert set(result.multipliers) == {"controls", "discs", "goal", "bounds"}
        assert result.violations.keys() == {"discs", "goal", "bounds"}


def test_errors_in_constraints_end_the_solve_with_what_there_is():
    calls = [0]

    def w(x, u, t):
        calls[0] += 1
        if calls[0] > 3000:
            raise RuntimeError("a slip")
        return x[0] - 0.1

    given, ends = bryson_denham(), [0.0, -1.0]
    constraints = [State(ends, ends, "terminal"), Path(w)]
    result = solve(Problem(given.dynamics, 50, [0.0, 1.0], [Control(1.0)], constraints=constraints))
    assert result.status is Status.FAILED and "a slip" in result.error and result.trajectory.X.shape == (51, 2)


def test_the_log_counts_all_sweeps_and_tells_violations():
    result = solve(bryson_denham())
    assert result.iterations == sum(entry.outcome == "accepted" for entry in result.log) < len(result.log)
    assert result.log[0].violation == pytest.approx(2.0) and result.log[-1].violation == result.constraint_violation
    assert result.log[0].cost == 0.0 and result.log[-1].cost == result.cost
