"""Multiple shooting: gaps close, also from guesses of no use to single shooting, and results obey the dynamics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_problems import pendulum

from mjslq import FunctionDynamics, MujocoDynamics, Problem, Status, costs, problems, solve
from mjslq.options import SLQOptions, Stopping
from mjslq.problems.drag_particle import BETAS, OPTIMAL_COSTS
from mjslq.solvers.interrupts import Interrupts
from mjslq.solvers.iterate import Iterate
from mjslq.solvers.loop import descend
from mjslq.solvers.merit import CostAndGaps
from mjslq.solvers.monitor import Monitor
from mjslq.solvers.slq import SLQ
from mjslq.solvers.steps import close_gaps

METHODS = ["newton", "slq"]
ARM = """
<mujoco><option timestep="0.02"/><worldbody><body><joint name="b" type="ball" damping=".3"/>
<geom type="capsule" fromto="0 0 0 .3 .1 -.4" size=".05" mass="1"/>
<body pos=".3 .1 -.4"><joint name="h" axis="0 1 0" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".04" mass=".5"/><site name="tip" pos="0 0 -.3"/></body></body>
</worldbody><actuator><motor joint="b" gear="1 0 0"/><motor joint="b" gear="0 1 0"/><motor joint="b" gear="0 0 1"/>
<motor joint="h"/></actuator><sensor><framepos name="tip" objtype="site" objname="tip"/></sensor></mujoco>
"""


def swing(goal=3.0, N=40):
    return np.linspace(0.0, 1.0, N + 1)[:, None] * np.array([goal, 0.0])


def ball_arm():
    dynamics = MujocoDynamics.from_xml(ARM)
    rest = np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 0])
    # weights with which single and multiple shooting end in the same minimum, open loop or closed loop
    terms = [costs.Control(0.1), costs.Sensor("tip", [0.5, 0.2, -0.2], 100.0, "terminal"), costs.State(1.0, rest)]
    return Problem(dynamics, 25, rest, terms)


def ramp(N=500):
    return np.stack([np.linspace(0.0, 10.0, N + 1), np.full(N + 1, 10.0)], axis=1)


def check_feasible(problem, result):
    """Every step ends where the next begins, to rounding; and from the problem's own start."""
    X, U = result.trajectory.X, result.trajectory.U
    np.testing.assert_array_equal(X[0], problem.x0)
    ends, _ = problem.dynamics.step_each(X, U)
    assert np.abs(problem.dynamics.difference(X[1:], ends)).max() <= 1e-11 * max(1.0, np.abs(X).max())
    assert result.cost == problem.cost(result.trajectory)


@pytest.mark.parametrize("beta", BETAS)
def test_drag_from_the_ramp_in_at_most_eight_iterations(beta):
    """What the paper reports as failing: x = 10 t, v = 10, u = 100 beta."""
    problem = problems.get("drag_particle", beta=beta)
    result = solve(problem, "newton", X0=ramp(), U0=[100.0 * beta])
    assert result.status is Status.CONVERGED and result.iterations <= 8
    assert result.cost == pytest.approx(OPTIMAL_COSTS[beta], rel=2e-9) and result.gradient_norm < 1e-6
    assert result.log[0].gap > 1.0 and result.log[-1].gap == 0.0
    check_feasible(problem, result)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("beta", [0.01, 0.1, 0.5])
def test_drag_from_zero_states(beta, method):
    problem = problems.get("drag_particle", beta=beta)
    result = solve(problem, method, X0=np.zeros((501, 2)))
    assert result.status is Status.CONVERGED and result.iterations <= (8 if method == "newton" else 40)
    assert result.cost == pytest.approx(OPTIMAL_COSTS[beta], rel=2e-9)


@pytest.mark.parametrize("method", METHODS)
def test_states_of_a_pendulum(method):
    problem = pendulum()
    result = solve(problem, method, X0=swing())
    assert result.status is Status.CONVERGED, result.message
    assert result.cost == pytest.approx(solve(problem, method).cost, rel=1e-8)
    check_feasible(problem, result)


@pytest.mark.parametrize("method", METHODS)
def test_states_on_a_manifold(method):
    """A ball joint, and an engine that reads where a step ends off the trajectory."""
    problem = ball_arm()
    X0 = np.tile(problem.x0, (26, 1))
    tilt = np.linspace(0.0, 0.4, 26)
    X0[:, 0], X0[:, 2], X0[:, 4] = np.cos(tilt), np.sin(tilt), tilt
    guess = Iterate.guess(problem, X0, np.zeros((25, 4)))
    assert guess.gap > 0.01
    result = solve(problem, method, X0=X0, tol=0.0, tol_gradient=1e-5)
    assert result.status is Status.CONVERGED, result.message
    assert result.log[0].gap == pytest.approx(guess.gap)
    assert result.cost == pytest.approx(solve(problem, method, tol=0.0, tol_gradient=1e-5).cost, rel=1e-6)
    check_feasible(problem, result)


def test_an_arm_held_still_in_space():
    """From zero torques single shooting lets the arm fall first, and ends at 7.98; from a static guess it need not."""
    problem = problems.get("panda_reach")
    result = solve(problem, "slq", X0=np.tile(problem.x0, (201, 1)), U0=np.zeros(7), tol_direction=1e-5)
    assert result.status is Status.CONVERGED and result.cost < 1.1
    check_feasible(problem, result)


@given(st.integers(0, 2**32 - 1))
def test_linear_dynamics_take_one_step_from_any_guess(seed):
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((3, 3)), rng.standard_normal((3, 2))
    dynamics = FunctionDynamics(lambda x, u: A @ x + B @ u, 3, 2, 1.0, integrator="map")
    problem = Problem(dynamics, 8, rng.standard_normal(3), [costs.Tracking(1.0, 1.0, 2.0)])
    for method in METHODS:
        result = solve(problem, method, X0=rng.standard_normal((9, 3)), U0=rng.standard_normal((8, 2)), tol=1e-7)
        assert result.status is Status.CONVERGED and result.iterations <= 2 and result.log[0].alpha == 1.0
        assert result.cost == pytest.approx(solve(problem, "slq").cost, rel=1e-9)


def test_the_model_of_a_guess_holds_to_second_order():
    """Its cost and gaps against those of guesses nearby."""
    problem, rng = pendulum(), np.random.default_rng(0)
    X, U = swing(), rng.standard_normal((40, 1))
    X[0] = problem.x0
    here, dX, dU = Iterate.guess(problem, X, U), rng.standard_normal(X.shape), rng.standard_normal(U.shape)
    dX[0] = 0.0
    A, B, _, _, _, q, r, c, _ = here.gauss_newton
    np.testing.assert_array_equal(c, here.gaps)
    e = 1e-5
    beyond, before = (Iterate.guess(problem, X + s * e * dX, U + s * e * dU) for s in (1.0, -1.0))
    assert (beyond.cost - before.cost) / (2 * e) == pytest.approx(np.vdot(q, dX) + np.vdot(r, dU), rel=1e-7)
    gaps = np.einsum("nij,nj->ni", A, dX[:-1]) + np.einsum("nij,nj->ni", B, dU) - dX[1:]
    np.testing.assert_allclose((beyond.gaps - before.gaps) / (2 * e), gaps, atol=1e-7)
    costates = rng.standard_normal((41, 2))

    def lagrangian(s):
        there = Iterate.guess(problem, X + s * dX, U + s * dU)
        return there.cost + np.vdot(costates[1:], there.gaps)

    model, e = here.hamiltonian(costates), 1e-3
    curvature = np.einsum("ni,nij,nj", dX, model.Q, dX) + np.einsum("ni,nij,nj", dU, model.R, dU)
    curvature += 2.0 * np.einsum("ni,nij,nj", dU, model.M, dX[:-1])
    assert (lagrangian(e) - 2.0 * lagrangian(0.0) + lagrangian(-e)) / e**2 == pytest.approx(curvature, rel=1e-5)


def test_a_feasible_guess_is_only_rolled_out():
    problem = pendulum()
    optimum = solve(problem, "newton")
    again = solve(problem, "newton", X0=optimum.trajectory.X, U0=optimum.trajectory.U)
    assert again.success and again.iterations <= 1 and again.log[0].gap == 0.0


def test_log_counts_on_and_limits_hold():
    problem = pendulum()
    result = solve(problem, "slq", X0=swing())
    assert [entry.iteration for entry in result.log] == list(range(len(result.log)))
    assert len(result.iterates) == len(result.log) and result.iterations == len(result.log) - 1
    for limit in (0, 1, 3):
        short = solve(problem, "slq", X0=swing(), max_iterations=limit)
        assert short.status is Status.MAX_ITERATIONS and short.iterations == limit
        check_feasible(problem, short)


@pytest.mark.parametrize("how", [True, KeyboardInterrupt])
def test_stops_while_gaps_are_open_leave_a_rollout(how):
    def callback(entry):
        if entry.iteration == 1:
            if how is True:
                return True
            raise KeyboardInterrupt
        return None

    problem = pendulum()
    result = solve(problem, "newton", X0=swing(), callback=callback)
    assert result.status is (Status.STOPPED if how is True else Status.INTERRUPTED)
    assert np.isfinite(result.cost)
    check_feasible(problem, result)


def test_guesses_that_blow_up_are_a_status():
    dynamics = FunctionDynamics(lambda x, u: x * x + u, 1, 1, 1.0, integrator="map")
    problem = Problem(dynamics, 20, [2.0], [costs.Control(1.0), costs.State(1.0, when="always")])
    result = solve(problem, X0=np.full((21, 1), 1e9))
    assert result.status is not Status.CONVERGED or np.isfinite(result.cost)
    strong = problems.get("drag_particle", beta=10.0)  # explicit Euler cannot follow: |v| beyond its stability
    result = solve(strong, "newton", X0=ramp(), U0=[1000.0], max_iterations=20)
    assert result.status is not Status.CONVERGED


def test_the_first_state_is_the_problems():
    problem = pendulum()
    X0 = swing()
    moved = X0.copy()
    moved[0] = [7.0, 7.0]
    first, second = (solve(problem, "newton", X0=guess) for guess in (X0, moved))
    np.testing.assert_array_equal(first.trajectory.U, second.trajectory.U)


@pytest.mark.parametrize(
    "method, X0, sentence",
    [
        ("gradient", swing(), "method 'gradient' takes no state guess X0; these do: .*slq, newton"),
        ("trust-region", swing(), "method 'trust-region' takes no state guess X0; these do: .*slq, newton"),
        ("slq", swing()[:-1], r"X0 must have shape \(41, 2\), got \(40, 2\)"),
        ("slq", np.full((41, 2), np.nan), r"X0 must be finite, but X0\[0, 0\] is nan"),
        ("slq", "straight", "X0 must be an array of numbers, got str 'straight'"),
    ],
)
def test_wrong_guesses_are_refused_in_one_sentence(method, X0, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        solve(pendulum(), method, X0=X0)
    assert "\n" not in str(caught.value)


def open_guess(problem):
    return Iterate.guess(problem, np.vstack([problem.x0, swing()[1:]]), np.zeros((problem.horizon, 1)))


def test_closing_gaps_by_itself():
    """The merit falls along every direction and with every step, until a rollout takes over."""
    problem, method, merit = pendulum(), SLQ(SLQOptions()), CostAndGaps()
    here = open_guess(problem)
    merits, gaps = [], [here.gap]
    while here.gaps is not None:
        direction = method.direction(here)
        merit.update(here, direction)
        assert merit.slope(here, direction) < 0.0 and direction.K.any()
        e = 1e-6  # the slope is that of the merit along the step
        beyond = Iterate.guess(problem, here.trajectory.X + e * direction.X, here.trajectory.U + e * direction.U)
        slope = (merit.value(beyond) - merit.value(here)) / e
        assert slope == pytest.approx(merit.slope(here, direction), rel=1e-3)
        step = close_gaps(here, direction, merit)
        assert merit.value(step.iterate) < merit.value(here) or step.iterate.gaps is None
        merits.append(merit.value(here))
        here = step.iterate
        gaps.append(here.gap)
        assert len(gaps) < 30
    assert gaps[-1] == 0.0 and gaps[-2] < 0.3 * gaps[0]


def test_the_loop_takes_a_guess_as_it_takes_a_rollout():
    problem, monitor = pendulum(), Monitor()
    with Interrupts() as interrupts:
        outcome = descend(open_guess(problem), SLQ(SLQOptions()), Stopping(), monitor, interrupts)
    assert outcome.status is Status.CONVERGED and outcome.gains.any() and outcome.iterate.gaps is None
    gaps = [entry.gap for entry in monitor.log]
    assert gaps[0] > 0.0 == gaps[-1] and all(entry.slope < 0.0 for entry in monitor.log[:-1])


def test_a_rollout_has_no_gaps_and_a_guess_along_it_none_worth_the_name():
    problem = pendulum()
    trajectory = problem.rollout(np.full((40, 1), 0.3))
    assert Iterate(problem, trajectory).gaps is None and Iterate(problem, trajectory).gap == 0.0
    along = Iterate.guess(problem, np.array(trajectory.X), np.array(trajectory.U))
    assert along.gap < 1e-12 and along.closed and along.cost == Iterate(problem, trajectory).cost


def test_stationarity_of_a_guess_is_that_of_its_lagrangian():
    """At a minimum the costates of the sweep make the derivative by the controls vanish, and by the states, too."""
    problem = pendulum()
    optimum = solve(problem, "slq", tol=0.0, tol_gradient=1e-9, max_iterations=1000).trajectory
    here = Iterate.guess(problem, np.array(optimum.X), np.array(optimum.U))
    direction = SLQ(SLQOptions()).direction(here)
    assert here.stationarity(direction) < 1e-7
    far = open_guess(problem)
    assert far.stationarity(SLQ(SLQOptions()).direction(far)) > 1e-3


def test_no_rollout_is_made_and_thrown_away(monkeypatch):
    """A guess of the states needs single steps only, until its gaps are nearly closed."""
    problem, order = pendulum(), []
    engine = type(problem.dynamics)
    for name in ("rollouts", "step_each"):
        original = getattr(engine, name)

        def counted(self, *args, name=name, original=original, **more):
            order.append(name)
            return original(self, *args, **more)

        monkeypatch.setattr(engine, name, counted)
    assert solve(problem, "newton", X0=swing()).success
    assert order[0] == "step_each" and "rollouts" in order
    first = order.index("rollouts")
    assert order[:first].count("step_each") > 1
