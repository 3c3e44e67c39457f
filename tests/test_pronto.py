"""`pronto` and `gopronto`: quadratic convergence, the paper's variants, limits by barriers, what they refuse."""

import numpy as np
import pytest
from constrained_problems import bryson_denham
from small_problems import linear, pendulum

import mjslq
from mjslq import Status, constraints, costs, solve
from mjslq.method_table import METHODS
from mjslq.policy import Policy

BOTH = ("pronto", "gopronto")
TIGHT = {"tol_direction": 0.0, "tol_gradient": 1e-4}


@pytest.fixture(scope="module")
def train():
    return mjslq.problems.get("cart_train", carts=2, theta=30.0)


@pytest.fixture(scope="module")
def optimum(train):
    return solve(train, "pronto", order="newton", tol_direction=0.0, tol_gradient=1e-8).cost


def norms(result):
    return np.array([entry.gradient_norm for entry in result.log])


def test_newton_converges_quadratically_on_the_unstable_train(train, optimum):
    result = solve(train, "pronto", order="newton", **TIGHT)
    assert result.success and result.iterations <= 10 and result.cost == pytest.approx(optimum, rel=1e-8)
    e = norms(result)[-4:]
    assert (e[1:] <= 10.0 * e[:-1] ** 2 / max(e[0], 1.0)).all() or (np.log(e[2:]) < 1.5 * np.log(e[1:-1])).all()


@pytest.mark.parametrize("gains", ["lqr", "subproblem"])
def test_gauss_newton_converges_in_a_few_iterations(train, optimum, gains):
    result = solve(train, "pronto", gains=gains, **TIGHT)
    assert result.success and result.iterations <= 10 and result.cost == pytest.approx(optimum, rel=1e-8)


@pytest.mark.parametrize(
    "variant, most",
    [("quasi-newton", 30), ("conjugate", 200), ("gradient", 600), ("heavy-ball", 600), ("nesterov", 600)],
)
def test_first_order_variants_reach_the_same_cost(train, optimum, variant, most):
    result = solve(train, "gopronto", variant=variant, **TIGHT)
    assert result.success and result.iterations <= most and result.cost == pytest.approx(optimum, rel=1e-8)


@pytest.mark.parametrize("variant", ["gradient", "heavy-ball", "nesterov"])
@pytest.mark.parametrize("restarts", [True, False])
def test_fixed_steps(train, variant, restarts):
    result = solve(
        train, "gopronto", variant=variant, step_rule="fixed", step_size=0.02, restarts=restarts, max_iterations=60
    )
    assert result.cost < 20.0 and all(entry.alpha == 0.02 for entry in result.log[:-1])


def test_diminishing_steps_diminish(train):
    result = solve(train, "gopronto", variant="gradient", step_rule="diminishing", step_size=0.03, max_iterations=20)
    alphas = [entry.alpha for entry in result.log[:-1]]
    np.testing.assert_allclose(alphas, 0.03 / (np.arange(20) + 1.0) ** 0.6)
    assert result.cost == min(entry.cost for entry in result.log)  # the best iterate, whichever it is


def test_steps_that_blow_up_end_with_the_best_iterate(train):
    result = solve(train, "gopronto", variant="gradient", step_rule="fixed", step_size=10.0)
    assert result.status is Status.DIVERGED and np.isfinite(result.cost)


def test_the_open_loop_gradient_fails_where_the_closed_loop_converges(train):
    result = solve(train, "gradient", line_search="armijo", max_iterations=600)
    assert not result.success and result.cost > 3.0 * 17.8345


def test_hamiltonian_is_stationary_under_the_closed_loop_costates(train):
    """(42): H_u = r + B'lambda and lambda = H_x, with lambda from the recursion under A - B K."""
    from mjslq.solvers.projection import CurveIterate
    from mjslq.solvers.regulator import Regulator

    result = solve(train, "pronto", order="newton", tol_direction=0.0, tol_gradient=1e-9)
    here = CurveIterate(train, result.trajectory, None)
    closed = Regulator("lqr", train.options["regulator"]).with_gains(here).costates
    A, B, _, _ = here.linearization
    _, _, _, q, r = here.expansion
    Hu = r + np.einsum("nij,ni->nj", B, closed[1:])
    assert np.abs(Hu).max() < 1e-9
    Hx = q[:-1] + np.einsum("nij,ni->nj", A, closed[1:])
    np.testing.assert_allclose(closed[:-1], Hx, rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", ["first", "gauss-newton", "newton"])
def test_linear_quadratic_problems_take_one_step_but_for_the_first_order(order):
    result, best = solve(linear(), "pronto", order=order, max_iterations=50), solve(linear(), "slq")
    assert result.success == (order != "first")
    assert result.iterations == 1 if order != "first" else result.iterations > 1
    assert result.cost == pytest.approx(best.cost, rel=1e-8 if result.success else 5e-2)
    assert solve(linear(), "gopronto").iterations == 1  # the metric of the gains is the Hessian


def test_newton_globalized_by_first_order_steps():
    """From 90 degrees the model is not convex: alone, Newton ends at once; after closed-loop steps it converges."""
    problem = mjslq.problems.get("cart_train", carts=2, theta=90.0)
    alone = solve(problem, "pronto", order="newton", globalize="none", **TIGHT)
    assert alone.status is Status.STEP_TOO_SMALL and "positive definite" in alone.message
    result = solve(problem, "pronto", order="newton", globalize="gopronto", **TIGHT)
    assert result.success and result.cost == pytest.approx(288.26532, rel=1e-6)
    e = norms(result)[-3:]
    assert e[2] < 0.02 * e[1] < 4e-4 * e[0]


# Gains that are given


def test_a_policy_gives_its_gains(train):
    made = solve(train, "pronto")
    policy = made.policy
    assert isinstance(policy, Policy)
    again = solve(train, "gopronto", gains=policy)
    assert again.success and again.cost == pytest.approx(made.cost, rel=1e-8)
    np.testing.assert_array_equal(again.gains, policy.K)


@pytest.mark.parametrize("method", BOTH)
@pytest.mark.parametrize(
    "options, said",
    [({"gains": np.zeros((3, 1, 2))}, r"gains must have shape \(40, 1, 2\), got \(3, 1, 2\)"),
     ({"regulator": ((1.0, 1.0, 1.0), 1.0)}, r"regulator: Q must be a number, a diagonal \(2,\)"),
     ({"regulator": (1.0, 0.0)}, "regulator: R must be positive definite")],
)  # fmt: skip
def test_gains_that_do_not_fit_are_refused(method, options, said):
    with pytest.raises(ValueError, match=said):
        solve(pendulum(), method, **options)


def test_subproblem_gains_are_for_pronto():
    with pytest.raises(ValueError, match="'gopronto' solves no LQ problem"):
        solve(pendulum(), "gopronto", gains="subproblem")


# Limits


def limited():
    return pendulum(bounds=mjslq.Bounds(u=(-3.0, 3.0)))


def walled():
    walls = constraints.State([-np.inf, -0.5], [np.inf, 1.5], "always", name="speed")
    problem = pendulum()
    return mjslq.Problem(problem.dynamics, 40, [0.0, 0.0], problem.costs, constraints=[walls])


@pytest.mark.parametrize("problem", [limited, walled])
@pytest.mark.parametrize("method", BOTH)
def test_barriers_keep_limits_at_every_iterate(problem, method):
    problem = problem()
    result = solve(problem, method)
    assert result.success, result.message
    best = solve(problem, "auto")
    assert all(problem.violation(iterate) == 0.0 for iterate in result.iterates)
    assert best.cost - 1e-9 <= result.cost <= 1.001 * best.cost
    name = "controls" if problem.box.bounded else "speed"
    ours, theirs = result.multipliers[name], best.multipliers[name]
    assert np.abs(ours).max() > 0.01
    np.testing.assert_allclose(ours, theirs, atol=0.1 * np.abs(theirs).max())


@pytest.mark.parametrize("method", BOTH)
def test_clipped_limits_are_met_exactly(method):
    result, best = solve(limited(), method, limits="clip"), solve(limited(), "auto")
    assert result.success and result.cost == pytest.approx(best.cost, rel=1e-8)
    np.testing.assert_allclose(result.trajectory.U, best.trajectory.U, atol=1e-3)
    assert (result.active_limits != 0).any()


@pytest.mark.parametrize("method", BOTH)
def test_starts_that_violate_limits_are_drawn_within(method):
    walls = constraints.State([-np.inf, -0.5], [np.inf, 1.5], slice(5, None), name="speed")
    problem = pendulum(x0=(0.0, 2.5))
    problem = mjslq.Problem(problem.dynamics, 40, [0.0, 2.5], problem.costs, constraints=[walls])
    assert problem.violation(problem.rollout(problem.U0)) > 0.1
    result = solve(problem, method)
    assert result.success and result.constraint_violation == 0.0


@pytest.mark.parametrize("method", BOTH)
def test_limits_that_cannot_be_met_are_called_infeasible(method):
    walls = constraints.State([1.0, -np.inf], None, 0, name="start")
    problem = pendulum()
    problem = mjslq.Problem(problem.dynamics, 40, [0.0, 0.0], problem.costs, constraints=[walls])
    result = solve(problem, method)
    assert result.status is not Status.CONVERGED and result.constraint_violation > 0.5


@pytest.mark.parametrize("method", BOTH)
def test_equalities_are_refused(method):
    with pytest.raises(ValueError, match="takes no equality constraints, but the problem has 'goal'; these do"):
        solve(bryson_denham(10), method)


# As other methods


@pytest.mark.parametrize("method", BOTH)
def test_starting_at_the_optimum_ends_at_once(method):
    best = solve(pendulum(), "auto", tol=1e-9)
    result = solve(pendulum(), method, guess=best, tol_gradient=1e-4)
    assert result.success and result.iterations <= 1


@pytest.mark.parametrize("method", BOTH)
def test_results_are_saved_and_carry_a_policy(method, tmp_path, train):
    result = solve(train, method)
    result.save(tmp_path / "r.npz")
    again = mjslq.load(tmp_path / "r.npz")
    x = result.trajectory.X[3]
    np.testing.assert_array_equal(again.policy(x, 0.06), result.policy(x, 0.06))
    assert again.method == method and result.gains.shape == (400, 2, 8)
    kicked = result.trajectory.X[0] + 0.05
    U = [result.policy(kicked, 0.0)]
    assert np.abs(U[0] - result.trajectory.U[0]).max() > 0.1  # it reacts


@pytest.mark.parametrize("method", BOTH)
def test_states_on_a_manifold(method):
    xml = """<mujoco><option timestep="0.02" gravity="0 0 0"/><worldbody><body><joint name="ball" type="ball"/>
    <geom type="box" size=".1 .2 .3" mass="2"/></body></worldbody><actuator><motor joint="ball" gear="1 0 0"/>
    <motor joint="ball" gear="0 1 0"/><motor joint="ball" gear="0 0 1"/></actuator></mujoco>"""
    dynamics = mjslq.MujocoDynamics.from_xml(xml)
    goal = np.array([0.5, 0.5, -0.5, 0.5, 0.0, 0.0, 0.0])
    terms = [costs.Control(0.1), costs.State([50.0] * 3 + [1.0] * 3, goal, "terminal")]
    problem = mjslq.Problem(dynamics, 40, dynamics.initial_state, terms)
    best, result = solve(problem, "auto"), solve(problem, method)
    assert result.success and result.cost == pytest.approx(best.cost, rel=1e-6)


def test_the_table_says_what_they_take():
    for method in BOTH:
        assert METHODS[method].takes_constraints and not METHODS[method].takes_equalities


def test_an_iteration_of_gopronto_makes_no_jacobian_of_all_steps(train, monkeypatch):
    """Neither linearizations of the horizon nor Hessians of the cost: whatever would be (N, nx, nx)."""
    from mjslq.dynamics.dynamics import Dynamics
    from mjslq.solvers.iterate import Iterate

    longest = []

    def refuse(*_):
        raise AssertionError("an array of all steps was asked for")

    slice_of = type(train.dynamics).linearize_slice
    monkeypatch.setattr(Iterate, "linearization", property(refuse))
    monkeypatch.setattr(mjslq.Problem, "expand", refuse)
    monkeypatch.setattr(
        type(train.dynamics), "linearize_slice",
        lambda self, trajectory, first, last: longest.append(last - first) or slice_of(self, trajectory, first, last),
    )  # fmt: skip
    assert solve(train, "gopronto").success
    assert max(longest) <= 400 // 8  # for the gains; the pullback needs none
    longest.clear()
    monkeypatch.setattr(type(train.dynamics), "adjoint", Dynamics.adjoint)
    assert solve(train, "gopronto", max_iterations=2).iterations == 2 and 0 < max(longest) <= 400 // 8


def test_both_engines_of_the_train_have_the_same_optimum():
    results = [
        solve(mjslq.problems.get("cart_train", engine=engine, horizon=100, duration=2.0), "pronto", order="newton")
        for engine in ("function", "mujoco")
    ]
    assert all(result.success for result in results)
    assert results[1].cost == pytest.approx(results[0].cost, rel=1e-10)
    np.testing.assert_allclose(results[1].trajectory.U, results[0].trajectory.U, atol=1e-5)
