"""`pronto` and `gopronto` from many perturbed curves, and limited carts beside `auto`: longer tests."""

import dataclasses

import numpy as np
import pytest

import mjslq
from mjslq import costs, solve
from mjslq.policy import Policy
from mjslq.solvers.projection import CurveIterate
from mjslq.solvers.regulator import Regulator

WAYS = {
    "pronto": [{"order": "gauss-newton"}, {"order": "newton"}],
    "gopronto": [{"variant": v} for v in ("quasi-newton", "conjugate", "heavy-ball", "nesterov", "gradient")],
}


def perturbed(problem, K, seed):
    """A curve to be projected: smooth states that obey nothing, and noise for controls."""
    rng, N = np.random.default_rng(seed), problem.horizon
    shares = np.arange(N + 1) / N
    sizes = 0.08 * np.tile([1.0, 1.2], 4)
    waves = [np.sin(np.pi * (k + 1) * shares)[:, None] for k in range(5)]
    alpha = sizes * sum(rng.normal(size=8) * wave for wave in waves)
    return Policy(alpha, 0.3 * rng.normal(size=(N, 2)), K, problem.dynamics.dt)


def check(seeds, method, options):
    problem = mjslq.problems.get("cart_train", theta=60.0)
    start = CurveIterate(problem, problem.rollout(problem.U0), None)
    K = Regulator("lqr", problem.options["regulator"]).with_gains(start).K
    for seed in seeds:
        guess = perturbed(problem, K, seed)
        result = solve(
            problem, method, guess=guess, tol_direction=0.0, tol_gradient=1e-4, max_iterations=2000,
            keep_iterates=False, **options,
        )  # fmt: skip
        assert result.success and result.cost == pytest.approx(90.38146555, rel=1e-8), (seed, result.message)


@pytest.mark.parametrize("method, options", [("pronto", {}), ("gopronto", {})])
def test_a_perturbed_curve_at_sixty_degrees(method, options):
    check([0, 1], method, options)


@pytest.mark.slow
@pytest.mark.parametrize("method, options", [(m, o) for m, options in WAYS.items() for o in options])
def test_twenty_perturbed_curves_at_sixty_degrees(method, options):
    check(range(20), method, options)


def limited(carts, kind):
    """Carts to be balanced from leaning pendulums, or swung up, with limited forces."""
    limit = 3.0 if kind == "balance" else 6.0
    problem = mjslq.problems.get("cart_train", carts=carts, theta=0.0, limit=limit, horizon=200, duration=4.0)
    x0 = np.zeros(4 * carts)
    x0[1 : 2 * carts : 2] = 0.25 * (-1.0) ** np.arange(carts) if kind == "balance" else np.pi
    if kind == "balance":
        return dataclasses.replace(problem, x0=x0)
    weights = np.concatenate([np.tile([1.0, 100.0], carts), np.tile([1.0, 10.0], carts)])
    target = np.zeros(4 * carts)
    terms = [costs.Control(0.01), costs.State(weights, target, "terminal"), costs.State(weights / 1e3, target)]
    return mjslq.Problem(problem.dynamics, 200, x0, terms)


def check_limited(carts, kind):
    problem = limited(carts, kind)
    best = solve(problem, "auto", max_iterations=600)
    result = solve(problem, "pronto", max_iterations=600)
    assert best.success and result.success, result.message
    assert all(problem.violation(iterate) == 0.0 for iterate in result.iterates)
    assert best.cost * (1.0 - 1e-9) <= result.cost <= 1.01 * best.cost
    assert (best.active_limits != 0).any()


@pytest.mark.parametrize("carts", [1, 2])
def test_limited_carts_are_balanced(carts):
    check_limited(carts, "balance")


@pytest.mark.slow
@pytest.mark.parametrize("carts", [1, 2, 3])
@pytest.mark.parametrize("kind", ["balance", "swing-up"])
def test_limited_carts_are_balanced_and_swung_up(carts, kind):
    check_limited(carts, kind)


@pytest.mark.parametrize("name", ["solo12_stand", pytest.param("g1_reach", marks=pytest.mark.slow)])
def test_legged_robots(name):
    problem = mjslq.problems.get(name)
    best, result = solve(problem, "slq"), solve(problem, "pronto")
    assert result.success and result.cost == pytest.approx(best.cost, rel=1e-3)
    assert solve(problem, "gopronto", max_iterations=60).cost < 1.01 * best.cost
