"""Newton on the constraints in force: its step against a dense system, how fast it ends, and what if it fails."""

import dataclasses
import json

import numpy as np
import pytest
from constrained_problems import arm, bryson_denham, car, cart_pole, quadrotor, reentry, starts
from lq_problems import dense
from typer.testing import CliRunner

from mjslq import FunctionDynamics, MujocoDynamics, Problem, solve
from mjslq.cli import app
from mjslq.constraints import Initial, Path, State, Terminal
from mjslq.costs import Control
from mjslq.costs import State as Near
from mjslq.lq.problem import NotPositiveDefinite
from mjslq.solvers.active_set import ActiveSet, lagrangian
from mjslq.solvers.augmented import scales_of
from mjslq.solvers.iterate import Iterate


def small(free=()):
    """A pendulum with limits of each kind: of a function of state and control, a state, and the end."""
    engine = FunctionDynamics(
        lambda x, u: np.array([x[1], 2.0 * u[0] - 4.0 * np.sin(x[0])]), 2, 1, 0.1, control_limits=(-3.0, 3.0),
        integrator="rk4",
    )  # fmt: skip
    return Problem(
        engine, 8, [0.2, 0.0], [Control(1.0), Near([1.0, 0.2], [1.5, 0.0], "always")],
        constraints=[
            Path(lambda x, u, t: np.array([x[0] * u[0] + u[0] ** 2 - 1.5, x[1] - 1.2]), name="power"),
            State([0.0, -np.inf], [0.5, np.inf], when=slice(3, 6), name="wall"),
            Path(lambda x, u, t: x[0] * x[0] + 0.2 * u[0] * x[1] - 0.1, at="end", when=slice(0, 2), name="first"),
            Terminal(lambda x: np.array([np.sin(x[0]) - 0.45]), name="end"),
            *([Initial(free=free)] if free else []),
        ],
    )  # fmt: skip


def unknowns(problem, z):
    """Rollout from free entries of the start and the controls in a row."""
    free = problem.free_start
    x0, z = np.array(problem.x0), np.asarray(z)
    if free is not None:
        x0[free] = z[: free.sum()]
        z = z[free.sum() :]
    return problem.dynamics.rollout(x0, z.reshape(problem.box.lower.shape))


def gradient(problem, trajectory):
    here = Iterate(problem, trajectory)
    by_start = [] if problem.free_start is None else here.start_gradient[problem.free_start]
    return np.concatenate([by_start, here.gradient.ravel()])


@pytest.mark.parametrize("free", [(), (1,), (0, 1)])
@pytest.mark.parametrize("seed", range(4))
def test_a_step_solves_the_dense_system(seed, free):
    """[H J'; J -delta] (d, lambda_new - lambda) = -(g, r - b), H the Hessian of the Lagrangian by differences."""
    problem, rng = small(free), np.random.default_rng(seed)
    solution = solve(problem)
    assert solution.success
    start = [] if problem.free_start is None else solution.trajectory.X[0, problem.free_start]
    z = np.concatenate([start, solution.trajectory.U.ravel()])
    z = z + 0.01 * rng.standard_normal(z.size)
    multipliers = tuple(
        m * (1.0 + 0.1 * rng.uniform(size=m.shape))
        for m in (solution.multipliers[c.name] for c in problem.bound_constraints)
    )
    here = Iterate(problem, unknowns(problem, z))
    scales, size, rho = scales_of(problem, here), 0.7, 1.0
    method = ActiveSet(problem, scales, size)
    here = method.begin(here, multipliers, rho, True)
    direction = method.direction(here)
    assert method._found.settled and method._found.share == 1.0

    penalized, e = lagrangian(problem, multipliers), 1e-6
    units = np.eye(z.size) * e
    H = np.stack(
        [gradient(penalized, unknowns(problem, z + d)) - gradient(penalized, unknowns(problem, z - d)) for d in units]
    ) / (2.0 * e)
    rows, missed, weights, places = [], [], [], []
    for constraint, scale, new in zip(problem.bound_constraints, scales, method._found.multipliers, strict=True):

        def r(at, constraint=constraint):
            return constraint.residual.value(unknowns(problem, at)).ravel()

        J = np.stack([(r(z + d) - r(z - d)) / (2.0 * e) for d in units], axis=1)
        force = new.ravel() != 0.0
        b = np.where(new.ravel() > 0.0, constraint.upper.ravel(), constraint.lower.ravel())
        rows.append(J[force])
        missed.append((r(z) - b)[force])
        weights.append(np.broadcast_to(1e4 * rho * scale**2, new.shape).ravel()[force])
        places.append(force)
    J, missed, weights = np.vstack(rows), np.concatenate(missed), np.concatenate(weights)
    old = np.concatenate([m.ravel()[f] for m, f in zip(multipliers, places, strict=True)])
    dropped = gradient(penalized, unknowns(problem, z))
    for m, f, constraint in zip(multipliers, places, problem.bound_constraints, strict=True):
        assert not np.any(m.ravel()[~f]), constraint.name  # the multipliers tell what is in force
    system = np.block([[0.5 * (H + H.T), J.T], [J, -np.diag(1.0 / weights)]])
    found = np.linalg.solve(system, -np.concatenate([dropped, missed]))
    d = np.concatenate([direction.X[0, problem.free_start] if free else [], direction.U.ravel()])
    np.testing.assert_allclose(d, found[: z.size], rtol=1e-5, atol=1e-6)
    new = np.concatenate([m.ravel()[f] for m, f in zip(method._found.multipliers, places, strict=True)])
    np.testing.assert_allclose(new, old + found[z.size :], rtol=1e-4, atol=1e-5)
    assert not direction.held.any()


@pytest.mark.parametrize("make,most", [(bryson_denham, 6), (cart_pole, 6), (car, 8)])
def test_it_ends_in_a_few_steps_with_small_violations(make, most, monkeypatch):
    steps, took = [], ActiveSet.step

    def step(self, here, direction):
        steps.append(self.error(here.trajectory, self.multipliers))
        return took(self, here, direction)

    monkeypatch.setattr(ActiveSet, "step", step)
    result = solve(make())
    assert result.success and result.constraint_violation <= 1e-9 and result.gradient_norm < 1e-5
    assert 0 < len(steps) <= most and steps[0] > 1e-4


@pytest.mark.parametrize("kind", ["direction", "step"])
def test_where_it_fails_the_rounds_go_on(kind, monkeypatch):
    def direction(self, here):
        raise NotPositiveDefinite(0)

    def step(self, here, direction):
        from mjslq.solvers.method import Step

        return Step(None)

    monkeypatch.setattr(ActiveSet, kind, direction if kind == "direction" else step)
    for make, cost in ((bryson_denham, 4.44939), (car, 0.520328)):
        result = solve(make())
        assert result.success and result.cost == pytest.approx(cost, abs=1e-4)
        assert result.constraint_violation <= 1e-6


ASKED = {
    bryson_denham: (40, 45),
    cart_pole: (75, 85),
    quadrotor: (250, 800),
    car: (40, 55),
    arm: (105, 150),
    reentry: (35, 50),
}


@pytest.mark.slow
@pytest.mark.parametrize("make", ASKED)
def test_ten_starts_each(make, capsys):
    """Prints what it took: sweeps, the costs found, and violations."""
    problem = make()
    found = [solve(problem, U0=U, keep_iterates=False) for U in starts(problem, 0)]
    sweeps, worst = [len(result.log) for result in found], max(result.constraint_violation for result in found)
    with capsys.disabled():
        costs = ", ".join(f"{cost:.5f}" for cost in sorted({round(result.cost, 5) for result in found}))
        print(f"\n{make.__name__:14s} {np.median(sweeps):6.1f} {max(sweeps):4d}  violation {worst:.0e}  costs {costs}")
    assert all(result.success for result in found) and worst <= 1e-9
    assert np.median(sweeps) <= ASKED[make][0] and max(sweeps) <= ASKED[make][1]


@pytest.mark.parametrize("make", [bryson_denham, cart_pole, car])
def test_a_result_hands_its_multipliers_on(make):
    """As in receding horizons: from a state nearby, a few steps do; without the multipliers it takes the rounds."""
    problem = make()
    result = solve(problem)
    again = solve(problem, guess=result)
    assert again.success and len(again.log) <= 2 and again.cost == pytest.approx(result.cost, rel=1e-9)
    x0 = np.asarray(problem.x0)
    moved = problem.at(x0 + 1e-3 * np.random.default_rng(0).standard_normal(x0.size))
    warm, cold = solve(moved, guess=result), solve(moved, guess=result.policy)
    assert warm.success and cold.success and warm.cost == pytest.approx(cold.cost, rel=1e-6)
    assert len(warm.log) <= 5 < 20 < len(cold.log) and warm.constraint_violation <= 1e-9


def test_multipliers_of_other_constraints_are_left_alone():
    problem, ends = bryson_denham(), [0.0, -1.0]
    result = solve(problem)
    other = Problem(
        problem.dynamics, 50, problem.x0, [Control(1.0)],
        constraints=[State(None, [0.15, np.inf], name="roof"), State(ends, ends, "terminal", name="goal")],
    )  # fmt: skip
    assert solve(other, guess=result).cost == pytest.approx(solve(other).cost, rel=1e-6)
    wrong = dataclasses.replace(result, multipliers={name: 1e3 * m for name, m in result.multipliers.items()})
    assert solve(problem, guess=wrong).cost == pytest.approx(result.cost, rel=1e-6)  # the rounds come in


def test_the_command_line_hands_options_of_constrained_on():
    settings = ["tol_violation=1e-4", "penalty=0.1", "limit=0.12"]
    arguments = ["solve", "bryson_denham", "--json", *(word for setting in settings for word in ("--set", setting))]
    told = json.loads(CliRunner().invoke(app, arguments).stdout)
    assert told["success"] and told["method"] == "constrained"
    assert told["options"]["tol_violation"] == 1e-4 and told["options"]["penalty"] == 0.1


BALL = """<mujoco><option timestep="0.05"/><worldbody><body><joint name="ball" type="ball" damping=".1"/>
<geom type="capsule" fromto="0 0 0 .1 .2 -.4" size=".03" mass="1"/><geom pos=".2 0 0" size=".05" mass=".5"/></body>
</worldbody><actuator><motor joint="ball" gear="1 0 0"/><motor joint="ball" gear="0 1 0"/>
<motor joint="ball" gear="0 0 1"/></actuator></mujoco>"""


def test_second_derivatives_of_constraints_on_quaternions():
    """The Hessian by the sweep's model, states eliminated, against differences of the gradient."""
    engine, rng = MujocoDynamics.from_xml(BALL), np.random.default_rng(0)
    x0 = engine.checked_start([0.8, 0.3, -0.4, 0.2, 0.5, -1.0, 0.7])
    limit = np.array([0.1, *[np.inf] * 6])
    problem = Problem(
        engine, 6, x0, [Control(1.0)],
        constraints=[
            Path(lambda x, u, t: np.array([x[0] * x[1] + x[3] * u[0], x[2] ** 3 + x[4] * x[1]]), name="path"),
            State(-limit, limit, "always", name="entry"),
            Path(lambda x, u, t: x[0] * x[2] + x[1] * u[1] + x[5] ** 2, at="end", name="end"),
            Terminal(lambda x: x[1] * x[2] - x[3], name="goal"),
        ],
    )  # fmt: skip
    multipliers = tuple(rng.standard_normal(c.lower.shape) for c in problem.bound_constraints)
    penalized, z, e = lagrangian(problem, multipliers), 0.3 * rng.standard_normal(18), 1e-5
    H, _ = dense(Iterate(penalized, unknowns(problem, z)).newton)
    units = np.eye(z.size) * e
    expected = np.stack(
        [gradient(penalized, unknowns(problem, z + d)) - gradient(penalized, unknowns(problem, z - d)) for d in units]
    ) / (2.0 * e)
    np.testing.assert_allclose(H, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_units_in_which_constraints_are_small_are_not_called_infeasible():
    """A particle as in Bryson and Denham's problem, in millionths of the unit."""
    unit, ends = 1e-6, [0.0, -1e-6]
    problem = Problem(
        bryson_denham().dynamics, 50, [0.0, unit], [Control(unit**-2)],
        constraints=[State(None, [0.1 * unit, np.inf], name="wall"), State(ends, ends, "terminal", name="goal")],
    )  # fmt: skip
    result = solve(problem, tol_violation=1e-6 * unit, tol_gradient=0.0)
    assert result.success and result.cost == pytest.approx(4.44939, abs=1e-4), result.message
    assert result.constraint_violation <= 1e-6 * unit and "constraints rescaled" in result.message
