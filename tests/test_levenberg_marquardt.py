"""SLQ with a multiplier: the damped direction against a dense twin, the schedule, the remedy, wrong input."""

import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lq_problems import response
from small_problems import pendulum

import mjslq
from mjslq import Status, problems
from mjslq.lq.box import Box
from mjslq.lq.problem import LQProblem
from mjslq.options import SLQOptions
from mjslq.problems.drag_particle import OPTIMAL_COSTS
from mjslq.solvers.damping import GROW, SHRINK, Damping
from mjslq.solvers.iterate import LIMITING, Iterate
from mjslq.solvers.merit import CostAndGaps
from mjslq.solvers.method import Step
from mjslq.solvers.slq import SLQ

solve = functools.partial(mjslq.solve, method="slq")


def start():
    problem = pendulum()
    return Iterate(problem, problem.rollout(problem.U0))


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
    S = response(model.A, model.B, model.c)[0].reshape((N + 1) * nx, N * nu)
    free = Box(np.full((N, nu), -np.inf), np.full((N, nu), np.inf))
    H = np.kron(np.eye(N), np.zeros((nu, nu)))
    for n in range(N):
        H[n * nu : (n + 1) * nu, n * nu : (n + 1) * nu] = model.R[n]
    for n in range(N + 1):
        rows = S[n * nx : (n + 1) * nx]
        H += rows.T @ model.Q[n] @ rows
    g = model.r.ravel() + S.T @ model.q.ravel()
    for kind, weight, penalty in (("control", model.R, np.eye(N * nu)), ("state", model.Q, S.T @ S)):
        direction = Damping(kind, mu).direction(model, free)
        scaled = mu * np.abs(weight).max()
        assert direction.multiplier == pytest.approx(scaled)
        dense = np.linalg.solve(H + scaled * penalty, -g)
        np.testing.assert_allclose(direction.U.ravel(), dense, rtol=1e-7, atol=1e-9 * np.abs(dense).max())
        share = scaled * (dense @ penalty @ dense) / abs(g @ dense)  # of the curvature along the direction
        if abs(share - LIMITING) > 1e-6:
            assert direction.limited == (share > LIMITING)
        assert direction.expected == pytest.approx(g @ dense + 0.5 * dense @ H @ dense, rel=1e-8)
        assert direction.expected < 0.0


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
    damping = Damping("control", 0.1)
    damping.adapt(Step(start(), alpha, 3))
    assert damping.mu == pytest.approx(0.1 * factor)


def test_a_small_multiplier_is_dropped():
    here, damping = start(), Damping("state", 2e-7)
    assert damping.direction(here.gauss_newton, here.box).multiplier > 0.0
    damping.adapt(Step(here, 1.0, 1))
    assert damping.mu == 0.0
    direction = damping.direction(here.gauss_newton, here.box)
    assert direction.multiplier == 0.0 and not direction.limited


def test_a_short_step_without_multiplier_brings_none():
    damping = Damping()
    damping.adapt(Step(start(), 0.01, 3))
    assert damping.mu == 0.0


@pytest.mark.parametrize("kind", ["open-loop", "closed-loop"])
def test_rescue_when_the_line_search_fails(kind):
    """Without any multiplier asked for: full steps with growing ones, until the cost falls enough."""
    here, damping = start(), Damping()
    rescued = damping.rescue(here, here.gauss_newton, kind, CostAndGaps())
    assert rescued.iterate is not None and rescued.rollouts > 0 and damping.mu > 0.0
    assert rescued.alpha == 1.0 and rescued.iterate.cost < here.cost


def test_the_rescue_gives_up_where_nothing_descends():
    here, damping = start(), Damping()
    uphill = here.gauss_newton._replace(q=-here.gauss_newton.q, r=-here.gauss_newton.r)
    rescued = damping.rescue(here, uphill, "closed-loop", CostAndGaps())
    assert rescued.iterate is None and 0 < rescued.rollouts < 40


def test_the_method_rescues_a_failed_search_unless_told_otherwise(monkeypatch):
    """The rollouts of both are counted, and the method says nothing of a step where there is none."""
    here, merit = start(), CostAndGaps()
    for rescue in (True, False):
        method = SLQ(SLQOptions(rescue=rescue))
        ahead = method.direction(here)
        monkeypatch.setattr(method, "search", lambda here, ahead, merit: Step(None, rollouts=7))
        step = method.step(here, ahead, merit)
        assert (step.iterate is not None) == rescue == (method.damping.mu > 0.0)
        assert step.rollouts > 7 if rescue else step.rollouts == 7


@pytest.mark.parametrize("kind", [None, "control", "state"])
def test_the_multiplier_of_the_options_is_the_one_to_start_with(kind):
    method = SLQ(SLQOptions(multiplier=kind, damping=0.5))
    assert method.damping.mu == (0.5 if kind else 0.0) and method.damping.by == (kind or "control")


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
