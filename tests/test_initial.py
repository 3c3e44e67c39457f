"""Initial states that are free or on a manifold: in the sweeps against dense twins, and in whole problems."""

import numpy as np
import pytest
from lq_problems import dense, random_problem
from test_box import dense_minimizer, random_box

import mjslq
from mjslq import FunctionDynamics, MujocoDynamics, PinocchioDynamics, Problem, Status, solve
from mjslq.constraints import Initial, Path, State, Terminal
from mjslq.costs import Control, Function
from mjslq.costs import State as Near
from mjslq.lq import box as box_module
from mjslq.lq import square_root
from mjslq.lq.box import Box, solve_in_box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.riccati import solve as sweep
from mjslq.reports.compare import compare

DOUBLE = FunctionDynamics(
    lambda x, u: np.array([x[1], u[0]]), 2, 1, 0.1, integrator="rk4", state_names=("position", "speed")
)
FLOATING = """<mujoco><option timestep="0.02"/><worldbody><body pos="0 0 1"><freejoint/>
<geom type="box" size=".2 .1 .05" mass="1"/>
<body pos=".2 0 0"><joint name="hinge" axis="0 1 0" damping=".1"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"
mass=".3"/></body></body></worldbody><actuator><motor joint="hinge"/></actuator></mujoco>"""


# The sweeps


def free_problem(rng):
    """A random convex LQ problem with some entries of x_0 unknown."""
    N, nx, nu = int(rng.integers(1, 9)), int(rng.integers(1, 5)), int(rng.integers(1, 4))
    free = rng.uniform(size=nx) < 0.6
    free[rng.integers(nx)] = True
    return random_problem(rng, nx, nu, N, radius=rng.uniform(0.5, 1.1))[0]._replace(free=free)


def with_a_step_before(lq):
    """The same problem from zero: the free entries are the controls of a step that comes first."""
    nu, nx = lq.r.shape[1], lq.q.shape[1]
    places = np.flatnonzero(lq.free)
    width = max(nu, len(places))
    first = np.zeros((1, nx, width))
    first[0, places, np.arange(len(places))] = 1.0

    def wide(blocks, axes):
        pad = [(0, 0)] * blocks.ndim
        for axis in axes:
            pad[axis] = (0, width - nu)
        return np.pad(blocks, pad)

    R = wide(lq.R, (1, 2))
    R[:, range(nu, width), range(nu, width)] = 1.0
    unused = np.zeros((1, width, width))
    unused[0, range(len(places), width), range(len(places), width)] = 1.0
    zeros = np.zeros
    return LQProblem(
        np.concatenate([zeros((1, nx, nx)), lq.A]), np.concatenate([first, wide(lq.B, (2,))]),
        np.concatenate([zeros((1, nx, nx)), lq.Q]), np.concatenate([unused, R]),
        np.concatenate([zeros((1, width, nx)), wide(lq.M, (1,))]), np.concatenate([zeros((1, nx)), lq.q]),
        np.concatenate([zeros((1, width)), wide(lq.r, (1,))]), np.concatenate([zeros((1, nx)), lq.c]),
    )  # fmt: skip


def check_minimum(lq, limits, found):
    (N, nu), width = lq.r.shape, max(lq.r.shape[1], int(lq.free.sum()))
    H, g = dense(with_a_step_before(lq))
    lower, upper = np.full((N + 1, width), -np.inf), np.full((N + 1, width), np.inf)
    lower[1:, :nu], upper[1:, :nu] = limits
    expected = dense_minimizer(H, g, lower.ravel(), upper.ravel()).reshape(N + 1, width)
    size = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(found.lq.X[0, lq.free], expected[0, : lq.free.sum()], atol=1e-9 * size)
    np.testing.assert_allclose(found.lq.U, expected[1:, :nu], atol=1e-9 * size)
    assert (found.lq.X[0, ~lq.free] == 0.0).all()
    np.testing.assert_allclose(lq.states(found.lq.U, found.lq.X[0]), found.lq.X, atol=1e-9 * size)
    np.testing.assert_allclose(found.lq.U, found.lq.k - np.einsum("nij,nj->ni", found.lq.K, found.lq.X[:-1]))
    assert np.abs(found.lq.costates[0, lq.free]).max() < 1e-8 * max(1.0, np.abs(g).max()) * size


@pytest.mark.parametrize("seed", range(60))
@pytest.mark.parametrize("refinements", [0, 1])
def test_free_entries_of_the_start_against_a_dense_twin(seed, refinements):
    lq = free_problem(np.random.default_rng(seed))
    found = sweep(lq, refinements=refinements)
    unlimited = Box(np.full_like(lq.r, -np.inf), np.full_like(lq.r, np.inf))
    check_minimum(lq, unlimited, box_module.BoxSolution(found, lq.r < -np.inf, 1, True))


@pytest.mark.parametrize("guesses", [12, -1])
@pytest.mark.parametrize("seed", range(60))
def test_free_starts_beside_limits_of_the_controls(seed, guesses, monkeypatch):
    monkeypatch.setattr(box_module, "GUESSES", guesses)
    rng = np.random.default_rng(1000 + seed)
    lq = free_problem(rng)
    limits = random_box(rng, lq.r.shape)
    found = solve_in_box(lq, limits)
    assert found.converged
    check_minimum(lq, limits, found)


def test_what_the_cost_does_not_tell_of_the_start_stays():
    lq = free_problem(np.random.default_rng(0))
    nx = lq.q.shape[1] + 1  # one more state, which nothing depends on
    pad = {name: [(0, 0)] + [(0, 1)] * (getattr(lq, name).ndim - 1) for name in ("A", "Q", "q", "c")}
    pad |= {"B": [(0, 0), (0, 1), (0, 0)], "M": [(0, 0), (0, 0), (0, 1)]}
    wide = lq._replace(free=np.ones(nx, np.bool_), **{name: np.pad(getattr(lq, name), by) for name, by in pad.items()})
    assert sweep(wide).X[0, -1] == 0.0
    Q = wide.Q.copy()
    Q[0, -1, -1] = -1.0
    with pytest.raises(NotPositiveDefinite, match="the initial state is not positive definite"):
        sweep(wide._replace(Q=Q))


# Problems


def test_example_of_section_3_6():
    """McQuade 1989: a = 0, b = 0.3, c = 1, d = 0.2."""
    engine = FunctionDynamics(
        lambda x, u: np.array([x[0] + x[1] + 0.5 * u[0], x[1] + u[0]]), 2, 1, 1.0, integrator="map"
    )
    problem = Problem(
        engine, 2, [0.0, 0.0], [Control(1.0)],
        constraints=[
            Initial(lambda x: x[0], name="start"),
            State([0.3, -np.inf], [0.3, np.inf], when=1, name="middle"),
            Path(lambda x, u, t: u - 0.2, equality=True, when=1, name="second"),
            Terminal(lambda x: x[0] - 1.0, name="end"),
        ],
    )  # fmt: skip
    result = solve(problem, tol_violation=1e-12, tol=1e-12)
    assert result.success
    exactly = {"rtol": 0.0, "atol": 1e-11}
    np.testing.assert_allclose(result.trajectory.U.ravel(), [0.6, 0.2], **exactly)
    np.testing.assert_allclose(result.trajectory.X, np.transpose([[0.0, 0.3, 1.0], [0.0, 0.6, 0.8]]), **exactly)
    assert result.cost == pytest.approx(0.2, abs=1e-11)
    for name, multiplier in (("start", -1.2), ("middle", 2.4), ("second", 0.4), ("end", -1.2)):
        np.testing.assert_allclose(result.multipliers[name], [[multiplier]], rtol=1e-10)


def circle(x):
    return x[0] * x[0] + x[1] * x[1] - 4.0


def test_an_initial_manifold_and_its_multiplier():
    """The start is to be found on a circle: lambda_0 = -(dq/dx)'nu, (2.35)."""
    problem = Problem(
        DOUBLE, 20, [2.0, 0.5], [Control(1.0), Near([1.0, 0.5], [1.0, -0.3], "always")],
        constraints=[Initial(circle, name="circle"), Terminal(lambda x: x[0] + x[1] - 0.5)],
    )  # fmt: skip
    result = solve(problem, tol_violation=1e-9, tol=1e-9)
    x0 = result.trajectory.X[0]
    assert result.success and abs(circle(x0)) < 1e-9 and result.violations["circle"][0] == abs(circle(x0))
    linearization = DOUBLE.linearize(result.trajectory)
    expansion = problem.expand(result.trajectory, linearization)
    costate = expansion.q[-1] + result.multipliers["terminal"][0] * np.ones(2)
    for n in range(19, -1, -1):
        costate = expansion.q[n] + linearization.A[n].T @ costate
    np.testing.assert_allclose(costate, -2.0 * x0 * result.multipliers["circle"][0, 0], atol=1e-7)
    around = []
    for turn in np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False):  # it is the best start on the circle
        fixed = Problem(DOUBLE, 20, 2.0 * np.array([np.cos(turn), np.sin(turn)]), problem.costs,
                        constraints=[Terminal(lambda x: x[0] + x[1] - 0.5)])  # fmt: skip
        around.append(solve(fixed).cost)
    assert result.cost <= min(around) + 1e-6 and min(around) < result.cost + 0.1


def test_a_free_speed_by_name_and_by_index():
    for free in ("speed", ("speed",), 1, (-1,), np.int64(1)):
        problem = Problem(
            DOUBLE, 10, [0.0, 0.0], [Control(1.0)], constraints=[Initial(free=free), Terminal(lambda x: x[:1] - 1.0)]
        )
        result = solve(problem)
        assert result.success and result.cost < 1e-20
        np.testing.assert_allclose(result.trajectory.X[0], [0.0, 1.0], atol=1e-9)
        np.testing.assert_array_equal(result.policy.X[0], result.trajectory.X[0])


@pytest.mark.parametrize("method", ["auto", "slq"])
def test_without_constraints_methods_of_least_squares_take_free_starts(method):
    """The whole state is free, and its cost at the start is one among others."""
    engine = FunctionDynamics(lambda x, u: np.array([x[1], u[0] - np.sin(x[0])]), 2, 1, 0.1, integrator="rk4")
    costs = [Control(0.1), Near([3.0, 1.0], [0.5, 0.0], "initial"), Near([50.0, 5.0], [2.0, 0.0], "terminal")]
    problem = Problem(engine, 25, [0.0, 0.0], costs, constraints=[Initial(free=(0, 1))])
    result = solve(problem, method)
    assert result.success and result.constraint_violation == 0.0 and "initial" not in result.violations
    fixed = Problem(engine, 25, [0.0, 0.0], costs)

    def best_from(x0):
        return solve(fixed.at(x0), method).cost

    x0, e = result.trajectory.X[0], 1e-3
    assert result.cost < best_from(np.zeros(2)) and result.cost == pytest.approx(best_from(x0), rel=1e-9)
    for direction in (np.array([e, 0.0]), np.array([0.0, e])):
        assert best_from(x0 + direction) > result.cost < best_from(x0 - direction)
    again = solve(problem, method, guess=result)
    assert again.success and len(again.log) <= 2
    np.testing.assert_allclose(again.trajectory.X[0], x0, atol=1e-5)
    states = solve(problem, method, X0=result.trajectory.X + 0.05)
    assert states.success and states.cost == pytest.approx(result.cost, rel=1e-6)


def test_second_derivatives_with_a_free_start():
    problem = Problem(
        DOUBLE, 20, [2.0, 0.5],
        [Control(1.0), Function(lambda x, u, t: (x[0] * x[0] - 1.0) ** 2 + x[1] ** 4, "always")],
        constraints=[Initial(free=(0, 1))],
    )  # fmt: skip
    result = solve(problem, curvature="always")
    assert result.success and abs(abs(result.trajectory.X[0, 0]) - 1.0) < 1e-4


def test_limits_of_states_hold_at_a_free_start():
    problem = Problem(
        DOUBLE, 20, [0.0, 0.0], [Control(1.0), Near([1.0, 0.0], [3.0, 0.0], "always")],
        constraints=[Initial(free="position"), State([-np.inf, -np.inf], [1.0, np.inf], name="wall")],
    )  # fmt: skip
    result = solve(problem)
    assert result.success and result.trajectory.X[0, 0] == pytest.approx(1.0, abs=1e-5)
    beyond = Problem(DOUBLE, 20, [2.0, 0.0], problem.costs, constraints=problem.constraints)
    assert solve(beyond).cost == pytest.approx(result.cost, rel=1e-6)  # the start violates the wall, and may move
    pinned = Problem(
        DOUBLE, 20, [2.0, 0.0], problem.costs, constraints=[Initial(free="speed"), *problem.constraints[1:]]
    )
    result = solve(pinned)
    assert result.status is Status.INFEASIBLE and "initial state itself violates 'wall'" in result.message


def test_a_floating_body_turned_into_its_start():
    """MuJoCo: the orientation that a body is dropped in is free, its pose at the end is asked for."""
    engine = MujocoDynamics.from_xml(FLOATING)
    x0 = engine.checked_start([0, 0, 1, 1, 0.2, -0.1, 0.3, 0.4, *[0.0, 0.0, 0.0, 0.5, -1.0, 0.3], 0.2])
    turn = tuple(range(3, 7))
    goal = engine.rollout(x0, np.zeros((15, 1))).X[-1].copy()
    weights = np.full(engine.ndx, 10.0)
    costs = [Control(1e-3), Near(weights, goal, "terminal")]
    tilted = x0.copy()
    tilted[3:7] = [1.0, 0.0, 0.0, 0.0]
    problem = Problem(engine, 15, tilted, costs, constraints=[Initial(free=turn)])
    result = solve(problem)
    assert result.success and result.cost < 1e-8
    np.testing.assert_allclose(result.trajectory.X[0], x0, atol=1e-3)
    kept = [i for i in range(engine.nx) if i not in turn]
    np.testing.assert_array_equal(result.trajectory.X[0, kept], np.asarray(problem.x0)[kept])
    assert problem.cost(engine.rollout(result.trajectory.X[0], result.trajectory.U)) == result.cost
    with pytest.raises(ValueError, match=r"free must name all of the entries .* or none: they turn together"):
        Problem(engine, 15, tilted, costs, constraints=[Initial(free=(4,))])
    level = [Initial(lambda x: x[4], free=turn, name="no roll"), Terminal(lambda x: x[2] - goal[2])]
    result = solve(Problem(engine, 15, tilted, costs, constraints=level))
    assert result.success and abs(result.trajectory.X[0, 4]) < 1e-6 and result.multipliers["no roll"][0, 0] != 0.0


def test_joint_angles_of_an_arm_to_start_from():
    """Pinocchio: the speeds are zero at the start, the angles free."""
    engine = PinocchioDynamics.from_path(
        mjslq.robot_path("panda"), 0.02, locked_joints=["panda_finger_joint1", "panda_finger_joint2"]
    )
    nominal = np.array([0.3, -0.4, 0.2, -1.6, 0.1, 1.5, 0.4])
    x0 = np.concatenate([nominal, np.zeros(7)])
    goal = np.concatenate([nominal + 0.1, np.zeros(7)])
    costs = [Control(1e-4), Near(np.r_[np.ones(7), 0.1 * np.ones(7)], goal, "terminal")]
    fixed = Problem(engine, 10, x0, costs)
    free = Problem(engine, 10, x0, costs, constraints=[Initial(free=engine.state_names[:7])])
    result = solve(free)
    assert result.success and result.cost < solve(fixed).cost and (result.trajectory.X[0, 7:] == 0.0).all()


def test_what_is_refused():
    def problem(*constraints):
        return Problem(DOUBLE, 5, [0.0, 0.0], [Control(1.0)], constraints=constraints)

    for given, match in (
        (Initial(), r"give q\(x\), the entries of the initial state that are free, or both"),
        (Initial(free=()), "free must name at least one entry"),
        (Initial(free=2), "free must name entries of the state, 0 to 1 or names, got 2"),
        (Initial(free=True), "got True"),
        (Initial(free="sped"), "'sped'.*position, speed"),
        (Initial(free=3.0), "free must name entries"),
        (Initial(q=3.0), r"q\(x\) must be a function, got float"),
    ):
        with pytest.raises(ValueError, match=match):
            problem(given)
    for method in ("newton", "trust-region", "gradient"):
        with pytest.raises(ValueError, match="takes no free initial state; these do: auto, slq, constrained"):
            solve(problem(Initial(free=0)), method)


def test_comparisons_leave_out_what_takes_no_free_start():
    problem = Problem(
        DOUBLE, 5, [0.0, 0.0], [Control(1.0), Near([1.0, 1.0], [1.0, 0.0], "always")], constraints=[Initial(free=0)]
    )
    assert [entry.method for entry in compare(problem)] == ["auto", "slq"]


def test_the_square_root_sweep_takes_free_starts_by_its_own_argument():
    lq = free_problem(np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"problem.free must be None; say by initial="):
        square_root.solve(lq)
    everything = np.ones(lq.q.shape[1], np.bool_)
    np.testing.assert_allclose(
        square_root.solve(lq._replace(free=None), initial="free").X, sweep(lq._replace(free=everything)).X, atol=1e-9
    )
