"""SLQ with a multiplier: the damped direction against a dense twin, the schedule, the remedy, wrong input."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjslq import FunctionDynamics, Problem, Status, costs, problems, solve
from mjslq.lq.riccati import LQProblem
from mjslq.problems.drag_particle import OPTIMAL_COSTS
from mjslq.solvers.damping import GROW, SHRINK, Damping
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.loop import Accepted

PENDULUM = FunctionDynamics(lambda x, u: np.stack([x[1], u[0] - 9.81 * np.sin(x[0]) - 0.1 * x[1]]), 2, 1, 0.05)


def pendulum():
    terms = [costs.Control(0.1), costs.State([200.0, 20.0], [2.0, 0.0], "terminal")]
    return Problem(PENDULUM, 40, [0.0, 0.0], terms, name="pendulum")


def start():
    problem = pendulum()
    return Iterate(problem, problem.rollout(problem.U0))


def sensitivity(A, B):
    N, nx, nu = B.shape
    S = np.zeros((N + 1, nx, N * nu))
    for n in range(N):
        S[n + 1] = A[n] @ S[n]
        S[n + 1][:, n * nu : (n + 1) * nu] += B[n]
    return S.reshape((N + 1) * nx, N * nu)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 1.0, 100.0]))
def test_the_damped_direction_is_marquardts(seed, mu):
    rng = np.random.default_rng(seed)
    N, nx, nu = 4, 2, 2
    Q, R = rng.standard_normal((N + 1, nx, nx)), rng.standard_normal((N, nu, nu))
    model = LQProblem(
        rng.standard_normal((N, nx, nx)), rng.standard_normal((N, nx, nu)), Q @ Q.swapaxes(1, 2),
        R @ R.swapaxes(1, 2) + np.eye(nu), np.zeros((N, nu, nx)), rng.standard_normal((N + 1, nx)),
        rng.standard_normal((N, nu)), np.zeros((N, nx)),
    )  # fmt: skip
    S, here = sensitivity(model.A, model.B), start()
    H = np.kron(np.eye(N), np.zeros((nu, nu)))
    for n in range(N):
        H[n * nu : (n + 1) * nu, n * nu : (n + 1) * nu] = model.R[n]
    for n in range(N + 1):
        rows = S[n * nx : (n + 1) * nx]
        H += rows.T @ model.Q[n] @ rows
    g = model.r.ravel() + S.T @ model.q.ravel()
    for kind, weight, penalty in (("control", model.R, np.eye(N * nu)), ("state", model.Q, S.T @ S)):
        direction = Damping(here, "open-loop", kind, mu).direction(model)
        scaled = mu * np.abs(weight).max()
        assert direction.multiplier == pytest.approx(scaled) and direction.limited
        dense = np.linalg.solve(H + scaled * penalty, -g)
        np.testing.assert_allclose(direction.U.ravel(), dense, rtol=1e-7, atol=1e-9 * np.abs(dense).max())


@pytest.mark.parametrize("step", ["open-loop", "closed-loop"])
@pytest.mark.parametrize("kind", ["control", "state"])
@pytest.mark.parametrize(
    "make", [pendulum, lambda: problems.get("van_der_pol")], ids=["pendulum", "van_der_pol"]
)  # fmt: skip
def test_converges_to_the_same_minimum(make, kind, step):
    problem = make()
    result = solve(problem, multiplier=kind, step=step)
    assert result.status is Status.CONVERGED, result.message
    assert result.cost == pytest.approx(solve(problem).cost, rel=1e-7)
    assert result.log[0].multiplier > 0.0 and result.log[0].multiplier > 10.0 * result.log[-1].multiplier
    assert result.options["multiplier"] == kind


@pytest.mark.parametrize("kind", ["control", "state"])
def test_drag_at_beta_1(kind):
    result = solve(problems.get("drag_particle", beta=1.0), multiplier=kind)
    assert result.status is Status.CONVERGED and result.iterations <= 45
    assert result.cost == pytest.approx(OPTIMAL_COSTS[1.0], rel=2e-9)


@pytest.mark.parametrize(
    "alpha, factor", [(1.0, 1.0 / SHRINK), (0.5, 1.0 / SHRINK), (0.3, 1.0), (0.25, GROW), (0.01, GROW)]
)
def test_schedule(alpha, factor):
    here = start()
    damping = Damping(here, "auto", "control", 0.1)
    advance = damping.guard(lambda here, ahead: (Accepted(alpha, here), 3), lambda here: here.gauss_newton)
    accepted, spent = advance(here, damping.direction(here.gauss_newton))
    assert accepted.alpha == alpha and spent == 3
    assert damping.mu == pytest.approx(0.1 * factor)


def test_a_small_multiplier_is_dropped():
    here = start()
    damping = Damping(here, "auto", "state", 2e-7)
    advance = damping.guard(lambda here, ahead: (Accepted(1.0, here), 1), lambda here: here.gauss_newton)
    advance(here, damping.direction(here.gauss_newton))
    assert damping.mu == 0.0 and not damping.direction(here.gauss_newton).limited


def test_remedy_when_the_line_search_fails():
    """Without any multiplier asked for: full steps with growing ones, until the cost falls enough."""
    here = start()
    damping = Damping(here, "auto", None)
    assert damping.mu == 0.0
    advance = damping.guard(lambda here, ahead: (None, 7), lambda here: here.gauss_newton)
    accepted, spent = advance(here, damping.direction(here.gauss_newton))
    assert accepted is not None and spent > 7 and damping.mu > 0.0
    assert accepted.alpha == 1.0 and accepted.iterate.cost < here.cost


def test_the_remedy_gives_up_where_nothing_descends():
    here = start()
    uphill = here.gauss_newton._replace(q=-here.gauss_newton.q, r=-here.gauss_newton.r)
    damping = Damping(here, "auto", None)
    advance = damping.guard(lambda here, ahead: (None, 0), lambda here: uphill)
    accepted, spent = advance(here, Direction(*[np.zeros((40, 1))] * 3))
    assert accepted is None and 0 < spent < 40


def test_without_multiplier_nothing_changes_where_the_search_succeeds():
    result = solve(pendulum())
    assert all(entry.multiplier == 0.0 for entry in result.log)


@pytest.mark.parametrize(
    "options, sentence",
    [
        (
            {"multiplier": "controls"},
            "unknown multiplier 'controls'; there are: control, state; did you mean 'control'",
        ),
        ({"multiplier": 1.0}, "unknown multiplier 1.0; there are: control, state"),
        ({"damping": 0.0}, "damping must be positive and finite, got 0.0"),
        ({"damping": "much"}, "damping must be a number, got str 'much'"),
    ],
)
def test_wrong_options_are_refused_in_one_sentence(options, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        solve(pendulum(), **options)
    assert "\n" not in str(caught.value)
