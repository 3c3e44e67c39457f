"""Free final time: minimum time, results, and what takes such problems and what refuses them."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from free_time_problems import of_function, of_mujoco, pendulum
from hypothesis import given, settings
from hypothesis import strategies as st

import mjslq
from mjslq import FunctionDynamics, Problem, constraints, costs, problems, solve
from mjslq.problems.cart_pole_time import OPTIMAL_TIME
from mjslq.reports.compare import compare


def accelerated(x, u):
    """A mass on a line."""
    return np.array([x[1], u[0]])


def mass(N=20, time=(0.2, 10.0), effort=0.1, **options):
    """A mass that is to be at rest a metre away, by its cost."""
    dynamics = FunctionDynamics(accelerated, 2, 1, 2.0 / N, control_limits=(-3.0, 3.0))
    terms = [costs.Time(), costs.Control(effort), costs.State(100.0, [1.0, 0.0], "terminal")]
    return Problem(dynamics, N, [0.0, 0.0], terms, free_time=time, **options)


def least_time(N):
    """Of a mass under forces of one that change at N knots: full, for odd N but in the middle step, which is idle."""
    return 2.0 if N % 2 == 0 else N / np.sqrt((N // 2) * (N // 2 + 1))


@pytest.mark.parametrize("N", [10, 41])
@pytest.mark.parametrize("duration", [1.0, 4.0])
def test_the_least_time_of_a_mass_is_the_discrete_optimum(N, duration):
    """To the tolerance of constraints, 1e-6: for an even number of steps that of continuous controls, 2 sqrt(d/a)."""
    result = solve(problems.get("double_integrator_time", horizon=N, duration=duration))
    assert result.success and result.constraint_violation <= 1e-6, result.message
    assert result.final_time == pytest.approx(least_time(N), abs=3e-6)
    assert result.cost == pytest.approx(result.final_time, rel=1e-12)
    full = np.abs(result.trajectory.U[:, 0]) == 1.0
    assert full[: N // 2].all() and full[-(N // 2) :].all()


@pytest.mark.parametrize("engine", ["mujoco", "function"])
def test_a_cart_pole_swings_up_in_the_least_time(engine):
    """On both engines the same, which step alike."""
    result = solve(problems.get("cart_pole_time", engine=engine))
    assert result.success, result.message
    assert result.final_time == pytest.approx(OPTIMAL_TIME, abs=2e-6)
    assert np.mean(np.abs(result.trajectory.U) == 5.0) > 0.9
    assert np.abs(result.trajectory.X[-1]).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mujoco", "function"])
@pytest.mark.parametrize("duration", [1.0, 3.0])
@pytest.mark.parametrize("effort", [0.0, 1e-3, 1e-2])
def test_a_cart_pole_does_so_from_other_times(engine, duration, effort):
    result = solve(problems.get("cart_pole_time", engine=engine, duration=duration, effort=effort, limit=10.0))
    expected = {0.0: 1.159691, 1e-3: 1.160617, 1e-2: 1.236240}[effort]
    assert result.success and result.final_time == pytest.approx(expected, abs=3e-6), result.message


@settings(max_examples=15)
@given(
    time=st.floats(0.5, 4.0), effort=st.floats(0.05, 2.0), N=st.integers(1, 12),
    method=st.sampled_from(["auto", "slq", "newton"]),
)  # fmt: skip
def test_a_time_that_is_fixed_by_its_limits_is_a_fixed_time(time, effort, N, method):
    free = mass(N, (time, time), effort)
    dynamics = FunctionDynamics(accelerated, 2, 1, time / N, control_limits=(-3.0, 3.0))
    fixed = Problem(dynamics, N, [0.0, 0.0], free.costs)
    ours, theirs = solve(free, method), solve(fixed, method)
    assert ours.success and theirs.success
    assert ours.final_time == pytest.approx(time, rel=1e-14) and ours.unknowns == {"final time": time}
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-9)
    np.testing.assert_allclose(ours.trajectory.U, theirs.trajectory.U, rtol=1e-5, atol=1e-5)


def test_all_that_take_free_time_find_the_same():
    found = {name: solve(mass(), name) for name in ("auto", "slq", "newton", "trust-region", "constrained")}
    assert all(result.success for result in found.values())
    for result in found.values():
        assert result.final_time == pytest.approx(found["newton"].final_time, rel=1e-5)
    start = found["newton"].trajectory
    descended = solve(mass(), "gradient", guess=start, U0=None, max_iterations=20)
    assert descended.cost <= found["newton"].cost * (1.0 + 1e-9)
    takers = "auto, slq, newton, trust-region, gradient, constrained"
    for name in set(mjslq.methods()) - set(takers.split(", ")):
        with pytest.raises(ValueError, match=f"'{name}' takes no free time.*has final time; these do: {takers}$"):
            solve(mass(), name)


def test_methods_are_compared_as_far_as_they_take_it():
    problem = problems.get("double_integrator_time", horizon=10)
    assert [entry.method for entry in compare(problem, max_iterations=3)] == ["constrained"]


def test_a_stationary_time_is_one():
    """The cost of the best motions with times near by is higher, by as much as quadratics are."""
    result = solve(mass())
    best = result.final_time

    def cost(time):
        return solve(mass(time=(time, time)), tol=1e-9).cost

    assert result.cost == pytest.approx(cost(best), rel=1e-9)
    beyond, before = cost(best + 1e-2), cost(best - 1e-2)
    assert min(beyond, before) > result.cost and abs(beyond - before) < 0.1 * (beyond + before - 2.0 * result.cost)


def test_multipliers_of_the_limits_of_time_are_the_slope_of_the_cost():
    held, e = solve(mass(time=(0.2, 0.8)), tol=1e-9), 1e-4
    shorter, longer = (solve(mass(time=(0.2, 0.8 + d)), tol=1e-9).cost for d in (-e, e))
    assert held.final_time == pytest.approx(0.8, rel=1e-14)
    assert held.multipliers["final time"][0] == pytest.approx(-(longer - shorter) / (2.0 * e), rel=1e-4)
    assert held.multipliers["controls"].shape == held.trajectory.U.shape


def test_running_terms_grow_with_the_steps_and_sums_do_not():
    problem = of_function(free_parameters={}, constraints=[])
    times = (0.5, 2.0)
    for term in (costs.Control(2.0), costs.Tracking(1.0, 1.0, 1.0), costs.State(1.0, when="terminal"), costs.Time(3.0)):
        alone = Problem(problem.dynamics, 20, [0.4, 0.0], [term], free_time=(0.2, 4.0))
        X, U = np.ones((21, 2)), np.ones((20, 1))
        short, long = (alone.cost(mjslq.Trajectory(X, U, np.zeros((21, 1)), T / 20)) for T in times)
        assert short > 0.0 and long / short == pytest.approx(4.0 if type(term).__name__ in ("Control", "Time") else 1.0)


def test_a_time_that_is_too_short_is_infeasible():
    dynamics = problems.get("double_integrator_time", horizon=10, duration=1.0).dynamics
    held = [constraints.State([1.0, 0.0], [1.0, 0.0], "terminal")]
    result = solve(Problem(dynamics, 10, [0.0, 0.0], [costs.Time()], constraints=held, free_time=(0.5, 1.5)))
    assert result.status is mjslq.Status.INFEASIBLE and result.final_time == 1.5


def test_functions_see_the_times_of_the_knots():
    seen = []

    def clock(x, u, t):
        seen.append(t)
        return t * x[0]

    dynamics = FunctionDynamics(accelerated, 2, 1, 0.1)
    problem = Problem(dynamics, 10, [1.0, 0.0], [costs.Control(1.0), costs.Residual(clock)], free_time=(0.5, 4.0))
    seen.clear()
    problem.cost(mjslq.Trajectory(np.ones((11, 2)), np.zeros((10, 1)), dt=0.3))
    np.testing.assert_allclose(sorted(set(seen)), 0.3 * np.arange(10), atol=1e-12)
    seen.clear()
    shifted = problem.at([1.0, 0.0], 5.0)
    shifted.cost(mjslq.Trajectory(np.ones((11, 2)), np.zeros((10, 1)), dt=0.3))
    np.testing.assert_allclose(sorted(set(seen)), 5.0 + 0.3 * np.arange(10), atol=1e-12)


def test_steps_of_unequal_length_are_stretched_alike():
    steps = np.array([0.05, 0.1, 0.1, 0.2, 0.05])
    dynamics = FunctionDynamics(accelerated, 2, 1, steps)
    result = solve(Problem(dynamics, 5, [0.0, 0.0], mass().costs, free_time=(0.2, 9.0)))
    assert result.success and result.final_time > 0.6
    np.testing.assert_allclose(result.trajectory.dt, steps * result.final_time / 0.5, rtol=1e-12)


@pytest.fixture(scope="module")
def swung():
    problem = of_mujoco(substeps=2, free_parameters={})
    return problem, solve(problem)


def test_a_result_is_the_users(swung, tmp_path):
    problem, result = swung
    assert result.success and problem.dynamics.model.opt.timestep == 0.008
    assert result.trajectory.X.shape == (21, 2) and result.gains.shape == (20, 1, 2) and result.lower.shape == (20, 1)
    assert result.gradient.shape == (20, 1) and len(result.names["states"]) == 2 and result.space.nx == 2
    assert result.final_time == pytest.approx(result.unknowns["final time"], rel=1e-12)
    assert sum(result.cost_terms.values()) == pytest.approx(result.cost) and "unused" not in result.cost_terms
    assert problem.cost(result.trajectory) == pytest.approx(result.cost, rel=1e-12)
    again = problem.fixed(result.unknowns).rollout(result.trajectory.U)
    np.testing.assert_allclose(again.X, result.trajectory.X, rtol=1e-12, atol=1e-14)
    result.save(tmp_path / "result.npz")
    loaded = mjslq.load(tmp_path / "result.npz")
    assert loaded.unknowns == result.unknowns and loaded.final_time == result.final_time
    np.testing.assert_array_equal(loaded.trajectory.dt, result.trajectory.dt)
    for kept in (result, loaded):
        x, t = kept.trajectory.X[7], kept.trajectory.times[7]
        np.testing.assert_allclose(kept.policy(x, t), kept.trajectory.U[7])
        replayed = kept.replay("model")
        assert replayed.deviation.max() < 1e-9  # the scene's model has the step length that was found


def test_results_and_policies_are_guesses(swung):
    problem, result = swung
    for guess in (result, result.policy, result.trajectory):
        again = solve(problem, guess=guess)
        assert again.success and again.iterations <= 2
        assert again.final_time == pytest.approx(result.final_time, rel=1e-6)
    with pytest.raises(ValueError, match="free time or parameters takes no state guess X0"):
        solve(problem, X0=result.trajectory.X)


def test_problems_are_solved_side_by_side_and_travel(swung):
    """Threads share the problem and its engine; processes get their own."""
    problem, result = swung
    with ThreadPoolExecutor(2) as executor:
        found = list(executor.map(lambda _: solve(problem), range(2)))
    for other in (*found, solve(pickle.loads(pickle.dumps(problem)))):
        np.testing.assert_array_equal(other.trajectory.U, result.trajectory.U)
        assert other.unknowns == result.unknowns
    assert pickle.loads(pickle.dumps(problem)).lifted.dynamics.names == ("final time",)


def test_a_receding_horizon_takes_the_time_that_was_found(swung):
    problem, result = swung
    with pytest.raises(ValueError, match=r"takes no free time.*has final time.*problem\.fixed\(result\.unknowns\)"):
        mjslq.MPC(problem)
    mpc = mjslq.MPC(problem.fixed(result.unknowns), guess=result)
    assert mpc.period == pytest.approx(result.final_time / 20)
    assert np.shape(mpc.step(np.asarray(problem.x0), 0.0)) == (1,)


def test_the_first_state_may_be_free_as_well():
    goal = [1.0, 0.0]
    held = [constraints.State(goal, goal, "terminal"), constraints.Initial(lambda x: x[1] + x[0] - 0.5)]
    problem = Problem(mass().dynamics, 20, [0.3, 0.0], [costs.Time(), costs.Control(0.1)], constraints=held,
                      free_time=(0.2, 9.0))  # fmt: skip
    result = solve(problem)
    assert result.success and sum(result.trajectory.X[0]) == pytest.approx(0.5, abs=1e-6)
    assert np.allclose(result.trajectory.X[-1], goal, atol=1e-6)


def test_a_held_time_is_not_in_the_way_of_other_endings():
    problem = problems.get("double_integrator_time", horizon=10)
    stopped = solve(problem, callback=lambda entry: entry.iteration >= 3)
    assert stopped.status is mjslq.Status.STOPPED and "still held, at 3 s" in stopped.message
    short = solve(problem, max_iterations=4)
    assert (
        short.status is mjslq.Status.MAX_ITERATIONS and short.iterations == 4 and short.final_time == pytest.approx(3)
    )
    wild = FunctionDynamics(lambda x, u: 50.0 * x**3 + u, 1, 1, 0.1)
    blown = solve(Problem(wild, 20, [2.0], [costs.Control(1.0), costs.Time()], free_time=(0.1, 3.0)))
    assert blown.status is mjslq.Status.DIVERGED and "The start blew up at step 1" in blown.message

    def broken(x, u, t):
        broken.calls += 1
        if broken.calls > 300:
            raise RuntimeError("boom")
        return x[0] - 2.0

    broken.calls = 0
    terms = [costs.Control(1.0), costs.Residual(broken), costs.Time()]
    failed = solve(Problem(mass().dynamics, 20, [0.0, 0.0], terms, free_time=(0.1, 3.0)))
    assert failed.status is mjslq.Status.FAILED and "RuntimeError: boom" in failed.message


@pytest.mark.parametrize(
    "make, sentence",
    [
        (lambda: mass(time=(0.0, 1.0)), "free_time: T_min must be above zero, got 0"),
        (lambda: mass(time=(2.0, 1.0)), r"free_time must be a pair \(T_min, T_max\) with the lower one first, got"),
        (lambda: mass(time=(np.nan, 1.0)), r"free_time must be a pair \(T_min, T_max\) with the lower one first"),
        (lambda: mass(time=3.0), r"free_time must be a pair \(T_min, T_max\), got 3.0"),
        (
            lambda: Problem(mass().dynamics, 20, [0, 0], [costs.State(1.0, when=1.0)], free_time=(1.0, 2.0)),
            "State, knot 10: when names times, but the final time is free",
        ),
        (
            lambda: Problem(
                FunctionDynamics(lambda x, u: x + u, 1, 1, 1.0, integrator="map"), 5, [0.0], [costs.Control(1.0)],
                free_time=(1.0, 2.0),
            ),
            "free_time: a map has no step length",
        ),
        (
            lambda: Problem(
                FunctionDynamics(lambda x, u: x + u, 1, 1, 1.0, jacobian=lambda x, u, t: (np.eye(1), np.eye(1))), 5,
                [0.0], [costs.Control(1.0)], free_time=(1.0, 2.0),
            ),
            "free_time: derivatives that are given are those of fixed steps",
        ),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_told(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()


def test_an_engine_without_says_so():
    class Engine(FunctionDynamics):
        def variation(self, names=()):
            return mjslq.Dynamics.variation(self, names)

    engine = Engine(pendulum, 2, 1, 0.1, parameters=[1.0, 0.1])
    with pytest.raises(ValueError, match="free_time: Engine has steps of fixed length and no parameters"):
        Problem(engine, 5, [0.0, 0.0], [costs.Control(1.0)], free_time=(0.1, 1.0))


def test_the_summary_tells_the_time(capsys):
    from mjslq.reports.tables import as_dict, print_summary
    from mjslq.viewer import panels

    problem = problems.get("double_integrator_time", horizon=10)
    result = solve(problem)
    print_summary(result, problem)
    told = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["final", "time", f"{result.final_time:.8g}", "s"] in told
    assert as_dict(result)["unknowns"] == result.unknowns
    assert "final time" in dict(panels.facts(result))
    assert "The final time was held for" in result.message
    assert "derivatives" in {section.title for section in mjslq.explain(result, problem).sections}
