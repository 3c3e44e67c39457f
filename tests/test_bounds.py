"""Limits of the controls: what problems take for them, and that every method on every engine keeps to them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from limited_problems import function_pendulum, mujoco_pendulum, pinocchio_pendulum
from lq_problems import dense
from scipy.optimize import lsq_linear, minimize
from small_problems import DOUBLE_INTEGRATOR, pendulum

from mjslq import Bounds, FunctionDynamics, Problem, Status, costs, solve
from mjslq.solvers.iterate import Iterate

INF = np.inf
METHODS = ["auto", "slq", "newton", "trust-region", "gradient"]
ENGINES = ["function", "mujoco", "pinocchio"]


@pytest.fixture(scope="module")
def make(tmp_path_factory):
    """make(engine, bounds=..., ...) -> a problem with limits that matter."""
    folder = tmp_path_factory.mktemp("urdf")

    def build(engine, **more):
        if engine == "function":
            return function_pendulum(-4.0, 8.0, **more)
        return mujoco_pendulum(**more) if engine == "mujoco" else pinocchio_pendulum(folder, **more)

    return build


# What a problem takes


@pytest.mark.parametrize("engine", ENGINES)
def test_the_models_own_limits_hold_unless_told_otherwise(make, engine):
    problem = make(engine)
    limits = problem.dynamics.control_limits
    assert np.isfinite(limits).all()
    for bounds in (None, Bounds(), Bounds(u="model")):
        box = make(engine, bounds=bounds).box
        np.testing.assert_array_equal(box.lower, np.tile(limits[:, 0], (30, 1)))
        np.testing.assert_array_equal(box.upper, np.tile(limits[:, 1], (30, 1)))
    lifted = make(engine, bounds=Bounds(u=None)).box
    assert not lifted.bounded and (lifted.lower == -INF).all() and (lifted.upper == INF).all()
    assert not pendulum().box.bounded  # an engine without limits


def two_controls(**more):
    dynamics = FunctionDynamics(
        lambda x, u: np.stack([x[1], u[0] - u[1]]), 2, 2, 0.1, control_names=("left", "right"),
        control_limits=([-1.0, -INF], [2.0, 3.0]),
    )  # fmt: skip
    return Problem(dynamics, 3, [1.0, 0.0], [costs.Control(0.1), costs.State(1.0)], **more)


@pytest.mark.parametrize(
    "given, lower, upper",
    [
        ((-0.5, 0.25), [-0.5, -0.5], [0.25, 0.25]),
        (([-1.0, -INF], [INF, 2.0]), [-1.0, -INF], [INF, 2.0]),
        ((-2, [1, 7]), [-2.0, -2.0], [1.0, 7.0]),  # also wider than the model's
        ((np.arange(6.0).reshape(3, 2), 9.0), np.arange(6.0).reshape(3, 2), [9.0, 9.0]),
        ([0.0, 0.0], [0.0, 0.0], [0.0, 0.0]),
    ],
)
def test_limits_can_be_given_as_numbers_one_a_control_and_one_a_step(given, lower, upper):
    box = two_controls(bounds=Bounds(u=given)).box
    np.testing.assert_array_equal(box.lower, np.broadcast_to(lower, (3, 2)))
    np.testing.assert_array_equal(box.upper, np.broadcast_to(upper, (3, 2)))
    assert box.lower.flags.c_contiguous and box.upper.flags.c_contiguous


@pytest.mark.parametrize(
    "bounds, sentence",
    [
        (Bounds(u=(1.0, -1.0)), "the lower limit of control 'left' must not lie above the upper one, got 1 and -1"),
        (Bounds(u=([0.0, 2.0], [1.0, 1.0])), "control 'right' must not lie above the upper one, got 2 and 1 at step 0"),
        (Bounds(u=(np.array([[0, 0], [0, 0], [5, 0.0]]), 1.0)), "'left' .* got 5 and 1 at step 2"),
        (Bounds(u=(np.nan, 1.0)), "the lower limit of the controls must not be NaN; write -inf or inf for none"),
        (Bounds(u=(0.0, [1.0, np.nan])), "the upper limit of the controls must not be NaN"),
        (
            Bounds(u=(0.0, [1.0, 2.0, 3.0])),
            r"one a control \(2,\) or one a step and control \(3, 2\), got shape \(3,\)",
        ),
        (Bounds(u=(np.zeros((2, 2)), 1.0)), r"the lower limit .* got shape \(2, 2\)"),
        (Bounds(u="none"), r"""u must be "model", None or a pair \(lower, upper\), got 'none'"""),
        (Bounds(u=(0.0, "wide")), r"""u must be "model", None or a pair"""),
        (Bounds(u=1.0), r"""u must be "model", None or a pair"""),
        (Bounds(u=(0.0, 1.0, 2.0)), r"""u must be "model", None or a pair"""),
        (Bounds(u=(None, 1.0)), "NaN; write -inf or inf for none|a pair"),
        ((-1.0, 1.0), "bounds must be mjslq.Bounds, got tuple"),
        (1.0, "bounds must be mjslq.Bounds, got float"),
        ("model", "bounds must be mjslq.Bounds, got str"),
    ],
)
def test_wrong_limits_are_refused_in_one_sentence(bounds, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        two_controls(bounds=bounds)
    assert "\n" not in str(caught.value) and "bounds" in str(caught.value)


def test_limits_are_not_the_callers_array():
    given = np.full((3, 2), -1.0)
    problem = two_controls(bounds=Bounds(u=(given, 1.0)))
    given[:] = 0.5
    assert (problem.box.lower == -1.0).all()


def test_the_start_of_a_problem_is_clipped_to_its_limits():
    np.testing.assert_array_equal(two_controls(U0=[5.0, -5.0]).U0, np.tile([2.0, -5.0], (3, 1)))
    np.testing.assert_array_equal(two_controls(bounds=Bounds(u=(1.0, 2.0))).U0, np.ones((3, 2)))


def test_violation_is_the_distance_from_the_limits():
    problem = two_controls()
    assert problem.violation(problem.rollout([1.0, 3.0])) == 0.0
    assert problem.violation(problem.rollout([-1.5, 3.25])) == 0.5


# That methods keep to them


def within(problem, trajectory):
    return (problem.box.lower <= trajectory.U).all() and (problem.box.upper >= trajectory.U).all()


def assert_kept(problem, result):
    assert within(problem, result.trajectory) and problem.violation(result.trajectory) == 0.0
    assert all(within(problem, iterate) for iterate in result.iterates)
    np.testing.assert_array_equal(result.lower, problem.box.lower)
    np.testing.assert_array_equal(result.upper, problem.box.upper)


@pytest.mark.parametrize(
    "method, options",
    [(method, {}) for method in METHODS]
    + [(method, {"step": "open-loop"}) for method in ("slq", "newton", "trust-region")],
)
@pytest.mark.parametrize("engine", ENGINES)
def test_no_control_of_any_iterate_leaves_the_limits(make, engine, method, options):
    """To the last bit; and what a method ends at is the minimum that the others find, too."""
    problem = make(engine)
    result = solve(problem, method, max_iterations=20 if method == "gradient" else 100, **options)
    assert_kept(problem, result)
    at_limit = np.abs(result.active_limits)
    assert (1 if method == "gradient" else 5) <= at_limit.sum() < at_limit.size
    if method != "gradient":
        assert result.status is Status.CONVERGED, result.message
        reference = solve(problem, "newton", tol=0.0, tol_gradient=1e-6, max_iterations=100)
        assert reference.success and result.cost == pytest.approx(reference.cost, rel=1e-6)
        assert not result.gains[result.active_limits != 0].any()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_bounded_quasi_newton_method_finds_nothing_better(make, engine):
    """SciPy's L-BFGS-B on the same rollouts."""
    problem = make(engine)
    shape = problem.U0.shape

    def cost_and_gradient(z):
        trajectory = problem.rollout(z.reshape(shape))
        return problem.cost(trajectory), problem.gradient(trajectory).ravel()

    limits = list(zip(problem.box.lower.ravel(), problem.box.upper.ravel(), strict=True))
    options = {"maxiter": 3000, "maxfun": 6000, "ftol": 1e-12, "gtol": 1e-7}
    theirs = minimize(
        cost_and_gradient, problem.U0.ravel(), jac=True, bounds=limits, method="L-BFGS-B", options=options
    )
    assert solve(problem, "slq").cost <= theirs.fun * (1.0 + 1e-6)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("iterations", [1, 3, 100])
def test_the_stationarity_reported_is_the_projected_gradient_by_differences(make, engine, iterations):
    """Limits within the model's, for MuJoCo clamps where differences would have to go beyond."""
    limits = make(engine).dynamics.control_limits
    bounds = Bounds(u=(0.95 * limits[:, 0], 0.95 * limits[:, 1]))
    problem = make(engine, bounds=bounds)
    result = solve(problem, "slq", max_iterations=iterations)
    U, e = np.array(result.trajectory.U), 1e-4
    gradient = np.empty_like(U)
    for i in range(U.size):
        d = np.zeros_like(U)
        d.flat[i] = e
        gradient.flat[i] = (problem.cost(problem.rollout(U + d)) - problem.cost(problem.rollout(U - d))) / (2.0 * e)
    pushed = ((problem.box.lower >= U) & (gradient > 0.0)) | ((problem.box.upper <= U) & (gradient < 0.0))
    assert pushed.any() or iterations < 100
    assert (result.active_limits != 0)[pushed].all()
    norm, scale = np.linalg.norm(np.where(pushed, 0.0, gradient)), np.abs(gradient).max()
    assert result.gradient_norm == pytest.approx(norm, rel=1e-5, abs=1e-5 * scale)
    np.testing.assert_allclose(
        result.multipliers["controls"], np.where(pushed, -gradient, 0.0), rtol=1e-5, atol=1e-6 * scale
    )
    assert result.log[-1].gradient_norm == result.gradient_norm


def test_active_limits_and_multipliers_have_the_sign_of_the_side(make):
    problem = make("function")
    result = solve(problem, "newton")
    active, multipliers = result.active_limits, result.multipliers["controls"]
    np.testing.assert_array_equal(active == 1, result.trajectory.U == 8.0)
    np.testing.assert_array_equal(active == -1, result.trajectory.U == -4.0)
    assert (active == 1).any() and (active == -1).any() and (active == 0).any()
    assert (multipliers * active >= 0.0).all() and (np.abs(multipliers[active != 0]) > 1e-6).all()
    assert not multipliers[active == 0].any()
    assert result.log[-1].limited == np.abs(active).sum()


def test_a_multiplier_is_what_a_limit_costs(make):
    """Widened by e at one step, the limit lowers the optimal cost by its multiplier times e."""
    base = solve(make("function"), "newton", tol=0.0, tol_gradient=1e-9)
    e, multipliers = 1e-4, base.multipliers["controls"]
    for side, n in ((1, 15), (-1, 1)):
        assert base.active_limits[n, 0] == side
        moved = []
        for sign in (1.0, -1.0):
            lower, upper = np.array(base.lower), np.array(base.upper)
            (upper if side > 0 else lower)[n, 0] += sign * e
            problem = make("function", bounds=Bounds(u=(lower, upper)))
            moved.append(solve(problem, "newton", U0=base.trajectory.U, tol=0.0, tol_gradient=1e-9).cost)
        slope = (moved[0] - moved[1]) / (2.0 * e)  # dJ/d limit
        assert -slope == pytest.approx(multipliers[n, 0], rel=1e-4)
        assert multipliers[n, 0] * side > 0.0


def test_without_limits_there_are_no_multipliers_and_nothing_is_active():
    result = solve(pendulum(), "slq")
    assert "controls" not in result.multipliers and not result.active_limits.any()
    assert all(entry.limited == 0 for entry in result.log)
    assert (result.lower == -INF).all() and (result.upper == INF).all()


@pytest.mark.parametrize("method", METHODS)
def test_limits_out_of_reach_change_nothing(make, method):
    free, wide = (
        solve(pendulum(bounds=bounds), method, max_iterations=25)
        for bounds in (Bounds(u=None), Bounds(u=(-1e3, [1e3])))
    )
    np.testing.assert_array_equal(wide.trajectory.U, free.trajectory.U)
    assert wide.iterations == free.iterations and not wide.active_limits.any()
    assert not wide.multipliers["controls"].any()


@pytest.mark.parametrize("method", METHODS)
def test_a_control_without_room_stays_where_it_is(method):
    """Limits that meet pin a control, at one step or at all."""
    lower, upper = np.full((40, 1), -6.0), np.full((40, 1), 6.0)
    lower[7:10] = upper[7:10] = 1.0 / 3.0
    problem = pendulum(bounds=Bounds(u=(lower, upper)))
    result = solve(problem, method, max_iterations=30)
    assert_kept(problem, result)
    assert (result.trajectory.U[7:10] == 1.0 / 3.0).all() and np.ptp(result.trajectory.U) > 1.0
    pinned = pendulum(bounds=Bounds(u=(0.5, 0.5)))
    nothing = solve(pinned, method, max_iterations=30)
    assert nothing.status is Status.CONVERGED and nothing.iterations == 0 and nothing.gradient_norm == 0.0
    assert (nothing.trajectory.U == 0.5).all()


@pytest.mark.parametrize("method", ["slq", "newton", "trust-region"])
def test_limits_on_one_side(method):
    problem = pendulum(bounds=Bounds(u=(-INF, 3.0)))
    result = solve(problem, method)
    assert result.success, result.message
    assert_kept(problem, result)
    assert (result.active_limits == 1).any() and not (result.active_limits == -1).any()
    assert result.trajectory.U.min() < -3.0


@pytest.mark.parametrize("method", ["slq", "newton"])
def test_a_guess_of_the_states_keeps_to_the_limits_on_its_way(make, method):
    problem = make("function")
    X0 = np.linspace(0.0, 1.0, 31)[:, None] * np.array([2.0, 0.0])
    result = solve(problem, method, X0=X0, U0=[100.0])
    assert result.success and result.log[0].gap > 0.0, result.message
    assert_kept(problem, result)
    assert result.cost == pytest.approx(solve(problem, "newton").cost, rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_start_beyond_the_limits_is_clipped_and_the_message_says_so(make, method):
    problem, U0 = make("function"), np.zeros((30, 1))
    U0[4:9], U0[20] = 50.0, -70.0
    result = solve(problem, method, U0=U0, max_iterations=3)
    np.testing.assert_array_equal(result.iterates[0].U, np.clip(U0, -4.0, 8.0))
    assert "clipped to the limits of the controls at 6 steps" in result.message
    assert "clipped" not in solve(problem, method, U0=np.clip(U0, -4.0, 8.0), max_iterations=3).message
    assert "clipped" not in solve(problem, method, max_iterations=3).message


def test_lifted_limits_are_not_kept_to(make):
    free = solve(make("function", bounds=Bounds(u=None)), "slq")
    limited = solve(make("function"), "slq")
    assert free.trajectory.U.max() > 8.0 and free.cost < limited.cost


# What is known in closed form


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["slq", "newton"]))
def test_linear_dynamics_take_one_step_to_the_dense_minimum(seed, method):
    rng = np.random.default_rng(seed)
    lower, upper = -rng.uniform(0.0, 1.0, (12, 1)), rng.uniform(0.0, 1.0, (12, 1))
    terms = [costs.Control(0.1), costs.State(1.0, when="always")]
    problem = Problem(DOUBLE_INTEGRATOR, 12, rng.standard_normal(2), terms, bounds=Bounds(u=(lower, upper)))
    result = solve(problem, method)
    H, g = dense(Iterate(problem, problem.rollout([0.0])).gauss_newton)
    L = np.linalg.cholesky(H)
    v = lsq_linear(
        L.T, -np.linalg.solve(L, g), bounds=(lower.ravel(), upper.ravel() + 1e-300), method="bvls", tol=1e-14
    ).x
    assert result.success and result.iterations <= 1
    np.testing.assert_allclose(result.trajectory.U.ravel(), v, rtol=0, atol=1e-8)


def test_bang_bang():
    """Control so cheap that only its limits matter: it ends on them."""
    terms = [costs.Control(1e-6), costs.State([1e3, 1e3], [1.0, 0.0], "terminal")]
    problem = Problem(DOUBLE_INTEGRATOR, 20, [0.0, 0.0], terms, bounds=Bounds(u=(-1.0, 1.0)))
    result = solve(problem, "slq")
    assert result.success, result.message
    U = result.trajectory.U.ravel()
    assert (U[:9] == 1.0).all() and (U[-9:] == -1.0).all()
