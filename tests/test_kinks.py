"""Kinks and jumps of the cost: what is found of them, the way past them, and how a solve ends at one."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mjslq
from mjslq import problems
from mjslq.reports import robots
from mjslq.solvers import kinks
from mjslq.solvers.edges import edge_between
from mjslq.solvers.iterate import Iterate

THREE = np.array([[1.0, 0.2], [-1.0, 0.3], [0.1, -1.0]])
VALLEY = np.array([[10.0, 0.5], [-10.0, 0.5]])


def _at_kink(U, slopes):
    """One step, x_1 = u, whose cost is the largest of slopes'x_1, and 1/2 |u|^2."""
    dynamics = mjslq.FunctionDynamics(lambda x, u: u + 0.0 * x, 2, 2, 1.0, integrator="map")
    largest = mjslq.costs.Function(
        lambda x, u, t: np.max(slopes @ x),
        when="terminal",
        gradient=lambda x, u, t: (slopes[np.argmax(slopes @ x)], np.zeros(2)),
        hessian=lambda x, u, t: np.zeros((4, 4)),
    )
    problem = mjslq.Problem(dynamics, 1, [0.0, 0.0], [largest, mjslq.costs.Control(1.0)], bounds=None)
    return Iterate(problem, problem.rollout(np.array([U])))


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(0, 3))
def test_the_weights_are_those_of_the_shortest_average(seed, gradients, edges):
    rng = np.random.default_rng(seed)
    G = rng.standard_normal((gradients + edges, 12)) * 10.0 ** rng.uniform(-2.0, 2.0, (gradients + edges, 1))
    is_edge = np.arange(gradients + edges) >= gradients
    off = np.where(is_edge, 0.01, -0.1) * rng.uniform(size=len(G)) * (np.arange(len(G)) > 0)
    w = kinks.weights(G @ G.T, is_edge, off)
    assert (w >= 0.0).all() and w[~is_edge].sum() == pytest.approx(1.0)
    slope = G @ (w @ G) - off  # of the objective: equal where w is not zero, and nowhere less among its kind
    size = np.abs(G @ G.T).max()
    level = w @ np.where(is_edge, 0.0, slope)
    assert np.abs(w * (slope - np.where(is_edge, 0.0, level))).max() < 1e-5 * size
    assert (slope - np.where(is_edge, 0.0, level)).min() > -1e-5 * size


def test_a_step_past_a_kink_lowers_what_no_gradient_step_does():
    here = _at_kink([1e-9, 1.0], VALLEY)
    found = kinks.beyond_kinks(here)
    assert found.iterate is not None and found.kinks == 1
    assert found.iterate.cost < -0.1 < 0.9 < here.cost  # the least is at (0, -1/2): -1/8


def test_at_the_minimum_of_kinks_the_solve_says_so_and_does_not_say_converged():
    # The least of max_i(s_i'u) + 1/2 |u|^2 is at zero, if zero is an average of the s_i: it is, of these three.
    here = _at_kink([1e-12, -2e-12], THREE)
    assert here.gradient_norm > 0.5
    found = kinks.beyond_kinks(here)
    assert found.iterate is None and found.stationary and found.norm < 1e-5 * here.gradient_norm
    result = mjslq.solve(here.problem, U0=np.array([[0.3, 0.4]]))
    assert result.status.value == "at_kink" and not result.success
    assert result.cost < 1e-6 and result.gradient_norm > 0.5 and "shortest average" in result.message


def _jumping(normal, level):
    """x_next = x + u, and a unit further along the last state beyond the plane normal'(x, u) = level."""

    def f(x, u):
        side = normal[0] * x[0] + normal[1] * x[1] + normal[2] * u[0]
        far = 1.0 if side.real > level else 0.0
        return np.array([x[0] + u[0], x[1] + far])

    return mjslq.FunctionDynamics(f, 2, 1, 1.0, integrator="map", jacobian="finite-difference")


@pytest.mark.parametrize("normal", [(0.6, 0.0, 0.8), (-0.3, 0.9, 0.1), (0.2, 0.0, -1.0)])
def test_the_normal_of_an_edge_is_found(normal):
    normal = np.array(normal) / np.linalg.norm(normal)
    dynamics = _jumping(normal, 0.0)
    problem = mjslq.Problem(dynamics, 3, [0.0, 0.0], [mjslq.costs.State(1.0), mjslq.costs.Control(1.0)])
    U = np.zeros((3, 1))
    x = dynamics.rollout([0.0, 0.0], U).X[1]
    assert np.allclose(x, 0.0)  # on the plane
    way = normal + 0.3
    low, high = (Iterate(problem, problem.rollout(U + sign * 1e-13 * np.sign(normal[2] or 1.0))) for sign in (-1, 1))
    edge = edge_between(low, high, lambda n: way, [])
    assert edge is not None and edge.knot == 0
    assert np.abs(edge.normal - normal).max() < 1e-3


@pytest.mark.parametrize("name", ["double_pendulum", "cart_pole", "quadrotor", "drag_cart"])
def test_smooth_problems_never_get_here(name, monkeypatch):
    def never(*args):
        raise AssertionError("a smooth problem is searched for kinks")

    monkeypatch.setattr(kinks, "beyond_kinks", never)
    result = mjslq.solve(problems.get(name), keep_iterates=False)
    assert result.success and not result.error and "kinks" not in result.message


def test_a_stiff_push_goes_on_beside_the_places_where_it_jumps(monkeypatch):
    problem, _ = next(robots.started(robots.CASES["box push, stiff"], 1, 1))
    monkeypatch.setattr(kinks.Kinks, "step", lambda self, here, failed: failed)
    before = mjslq.solve(problem, curvature="always", max_iterations=60, keep_iterates=False)
    assert before.status.value == "step_too_small"
    monkeypatch.undo()
    found = kinks.beyond_kinks(Iterate(problem, before.trajectory))
    assert found.edges >= 1 and found.iterate is not None and found.iterate.cost < 0.995 * before.cost
    after = mjslq.solve(problem, curvature="always", max_iterations=25, keep_iterates=False)
    costs = [entry.cost for entry in after.log]
    assert all(later < earlier for earlier, later in itertools.pairwise(costs))
    assert after.cost < 0.97 * before.cost and "past kinks" in after.message
