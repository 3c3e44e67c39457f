"""`auto`: from many starts, within limits, against an independent judge, and in its own words."""

import numpy as np
import pytest
from scipy.optimize import minimize
from small_problems import linear, pendulum

import mjslq
from mjslq import Bounds, FunctionDynamics, MujocoDynamics, Problem, Status, costs, problems, solve
from mjslq.options import AutoOptions
from mjslq.reports import starts
from mjslq.solvers.auto import Auto

SOLVED = {  # median and largest iterations allowed
    "cart-pole 5 N": (40, 60),
    "cart-pole without limit": (60, 80),
    "double pendulum 8 and 4 Nm": (25, 40),
    "acrobot 10 Nm": (150, 200),
    "panda_reach with effort limits": (25, 60),
}


@pytest.mark.parametrize("case", SOLVED)
def test_swing_ups_and_reaches_from_perturbed_starts(case):
    check_starts(case, 5)


@pytest.mark.slow
@pytest.mark.parametrize("case", SOLVED)
def test_swing_ups_and_reaches_from_many_starts(case):
    check_starts(case, 20)


def check_starts(case, number):
    row = starts.measure(case, number)
    median, most = SOLVED[case]
    assert row.solved == number, row.failures
    assert np.median(row.iterations) <= median and row.iterations.max() <= most
    assert row.violation == 0.0


def judge(problem, U0):
    """Least cost that bounded L-BFGS-B finds on the same rollouts from the same start."""
    shape, lower, upper = problem.U0.shape, problem.box.lower.ravel(), problem.box.upper.ravel()

    def cost_and_gradient(u):
        trajectory = problem.rollout(u.reshape(shape))
        if trajectory.diverged:
            return 1e10, np.zeros(u.size)
        return problem.cost(trajectory), problem.gradient(trajectory).ravel()

    options = {"maxiter": 3000, "maxfun": 6000, "ftol": 1e-15, "gtol": 1e-9, "maxcor": 30}
    bounds = np.stack([lower, upper], axis=1)
    return minimize(cost_and_gradient, U0.ravel(), jac=True, method="L-BFGS-B", bounds=bounds, options=options).fun


WEAK_PENDULUM = """
<mujoco><option timestep="0.02" integrator="implicitfast"><flag contact="disable"/></option><worldbody>
<body><joint name="hinge" axis="0 1 0" damping="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.02" mass="1"/></body></worldbody>
<actuator><motor joint="hinge" ctrlrange="-0.8 0.8"/></actuator></mujoco>"""


def weak_pendulum():
    """A motor of 0.8 Nm that has to swing a rod up which weighs 2.45 Nm."""
    dynamics = MujocoDynamics.from_xml(WEAK_PENDULUM)
    terms = [costs.Control(0.01), costs.State([100.0, 10.0], [0.0, 0.0], "terminal")]
    return Problem(dynamics, 200, [np.pi, 0.0], terms)


@pytest.mark.parametrize(
    "make", [weak_pendulum, lambda: problems.get("cart_pole", limit=2.5)], ids=["pendulum", "cart"]
)
def test_as_good_as_bounded_quasi_newton_or_better(make):
    problem = make()
    rng = np.random.default_rng(0)
    U0 = problem.box.clip(0.1 * rng.standard_normal(problem.U0.shape))
    result = solve(problem, U0=U0)
    assert result.success
    assert result.cost <= judge(problem, U0) * (1.0 + 1e-3)


def large_residuals(seed):
    """Random smooth dynamics and residuals that cannot be made small, within limits half of the time."""
    rng = np.random.default_rng(seed)
    nx, nu, N, m = rng.integers(1, 5), rng.integers(1, 3), int(rng.integers(8, 20)), int(rng.integers(2, 7))
    A = rng.standard_normal((nx, nx))
    A *= rng.uniform(0.5, 1.05) / max(np.abs(np.linalg.eigvals(A)).max(), 1e-3)
    B, C, D = rng.standard_normal((nx, nu)), rng.standard_normal((nx, nx)), rng.standard_normal((nx, nu))
    E, F, G = rng.standard_normal((m, nx + nu)), rng.standard_normal((m, m)), rng.standard_normal((m, nx + nu))
    d = 2.0 * rng.standard_normal(m)
    dynamics = FunctionDynamics(
        lambda x, u: A @ x + B @ u + 0.5 * np.tanh(C @ x + D @ u), nx, nu, 1.0, integrator="map"
    )

    def residual(x, u, t):
        z = np.concatenate([x, u])
        return E @ z + F @ np.tanh(G @ z) - d

    terms = [costs.Control(0.1), costs.Residual(residual, when="always")]
    limit = rng.uniform(0.3, 1.5) if seed % 2 else np.inf
    return Problem(dynamics, N, rng.standard_normal(nx), terms, bounds=Bounds(u=(-limit, limit)))


@pytest.mark.parametrize("seed", range(12))
def test_large_residuals_within_forty_iterations(seed):
    result = solve(large_residuals(seed))
    assert result.success and result.iterations <= 40


def test_second_derivatives_are_needed_there():
    slow = [solve(large_residuals(seed), "slq", max_iterations=60) for seed in range(6)]
    assert not all(result.success for result in slow)


def test_gauss_newton_alone_where_it_is_fast():
    result = solve(linear())
    assert result.success and result.iterations <= 2
    assert "Gauss-Newton throughout" in result.message


def test_says_what_it_did():
    always = solve(pendulum(), curvature="always")
    assert "second derivatives throughout" in always.message
    never = solve(problems.get("cart_pole"), curvature="never", max_iterations=8)
    assert "Gauss-Newton throughout" in never.message and never.status is Status.MAX_ITERATIONS
    both = solve(problems.get("cart_pole"))
    assert "with second derivatives from iteration" in both.message and "a multiplier in" in both.message


@pytest.mark.parametrize("height", [1.0, 10.0, 50.0])
def test_hopper_at_any_height(height):
    result = solve(problems.get("hopper", height=height, engine="function"), tol=1e-6)
    assert result.success and result.iterations <= 60
    assert abs(result.trajectory.X[-1, 0] - height) < 0.01 * height


@pytest.mark.parametrize("alpha", [1e-4, 1e-6, 1e-8])
def test_hopper_with_contacts_as_stiff_as_the_paper_gave_up_at(alpha):
    result = solve(problems.get("hopper", alpha=alpha, engine="function"))
    assert result.success and abs(result.trajectory.X[-1, 0] - 20.0) < 0.1


@pytest.mark.parametrize("beta", [0.01, 0.1, 0.5, 1.0])
def test_drag_particle_at_the_papers_minima(beta):
    from mjslq.problems.drag_particle import OPTIMAL_COSTS

    result = solve(problems.get("drag_particle", beta=beta))
    assert result.success and result.cost == pytest.approx(OPTIMAL_COSTS[beta], rel=1e-8)


def test_states_as_a_guess():
    problem = problems.get("drag_particle", beta=1.0)
    t = np.linspace(0.0, 1.0, 501)
    result = solve(problem, X0=np.stack([10.0 * t, np.full(501, 10.0)], axis=1), U0=np.array([100.0]))
    assert result.success and result.cost == pytest.approx(100395.1954, rel=1e-8)
    assert result.log[0].gap > 1.0 and result.log[-1].gap == 0.0


def test_a_start_at_the_minimum_stays_there():
    first = solve(pendulum())
    again = solve(pendulum(), guess=first)
    assert again.success and again.iterations <= 1


def test_controls_that_weigh_nothing():
    dynamics = FunctionDynamics(lambda x, u: np.stack([x[1], u[0] + u[1]]), 2, 2, 0.1)
    terms = [costs.Control([1.0, 0.0]), costs.State([100.0, 10.0], [1.0, 0.0], "terminal")]
    result = solve(Problem(dynamics, 20, [0.0, 0.0], terms, bounds=Bounds(u=(-1.0, 1.0))))
    assert result.success


def test_it_is_the_default():
    assert next(iter(mjslq.methods())) == "auto"
    assert solve(pendulum()).method == "auto"


def test_dear_second_derivatives_rest_where_they_are_not_worth_their_price():
    def told(gain, price, curvature="auto"):
        """Iterations that they rest after iterations that bring 1 without them, and `gain` with them."""
        method = Auto(AutoOptions(curvature=curvature))
        for exact, brought in ((None, 1.0), (object(), gain)):
            method._exact = exact
            for _ in range(4):
                method._judge(brought, price)
        return method._resting

    assert told(1.0, 10.0) == 4 and told(4.0, 10.0) == 4  # an iteration costs (3 + 10) / 3 times as much
    assert told(5.0, 10.0) == 0
    assert told(20.0, 100.0) == 4 and told(40.0, 100.0) == 0
    assert told(0.1, 2.0) == 0  # cheap ones are not judged
    assert told(0.1, 10.0, "always") == 0


def test_the_clip_converges_without_second_derivatives_by_differences(monkeypatch):
    problem = mjslq.problems.get("g1_clip")
    assert problem.dynamics.curvature_price > 100.0

    def never(*args):
        raise AssertionError("second derivatives by differences of 7 ms each")

    monkeypatch.setattr(type(problem.dynamics), "hessian", never)
    result = mjslq.solve(problem, keep_iterates=False)
    assert result.success and not result.error and "Gauss-Newton throughout" in result.message
