"""The LQ sweep with limits on the controls against a dense box-constrained QP, and its optimality conditions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lq_problems import dense, random_lq, random_problem
from scipy.optimize import lsq_linear

from mjslq.lq.adjoint import adjoint
from mjslq.lq.box import Box, solve_in_box
from mjslq.lq.problem import NotPositiveDefinite
from mjslq.lq.riccati import solve
from mjslq.lq.trust_region import solve_in_ball

INF = np.inf
seeds = st.integers(0, 2**32 - 1)


def convex_problem(rng, *, gaps=True):
    """A random convex problem of any shape, cross terms included, with weights that leave it well conditioned."""
    N, nx, nu = int(rng.integers(1, 13)), int(rng.integers(1, 6)), int(rng.integers(1, 5))
    return random_problem(rng, nx, nu, N, radius=rng.uniform(0.5, 1.1), gaps=gaps)[0]


def random_box(rng, shape):
    """Limits around zero: narrow and wide ones, at zero on one side or on both, and some that are infinite."""
    width = 10.0 ** rng.uniform(-2.0, 0.7)
    lower, upper = -width * rng.uniform(size=shape), width * rng.uniform(size=shape)
    kind = rng.uniform(size=shape)
    lower[kind < 0.1] = 0.0
    upper[(kind > 0.05) & (kind < 0.15)] = 0.0
    lower[kind > 0.9] = -INF
    upper[(kind > 0.85) & (kind < 0.95)] = INF
    return Box(lower, upper)


def dense_minimizer(H, g, lower, upper):
    """Minimum of g'v + 1/2 v'H v over the box: bounded least squares finds the active set, a solve polishes it."""
    fixed = lower == upper
    v, free = np.where(fixed, lower, 0.0), ~fixed
    if free.any():
        L = np.linalg.cholesky(H[np.ix_(free, free)])
        target = -np.linalg.solve(L, g[free] + H[np.ix_(free, fixed)] @ v[fixed])
        found = lsq_linear(L.T, target, bounds=(lower[free], upper[free]), method="bvls", tol=1e-15, max_iter=1000)
        v[free] = found.x
        at = np.zeros(len(v), dtype=int)
        at[free] = found.active_mask
        v[at < 0], v[at > 0] = lower[at < 0], upper[at > 0]
        free &= at == 0
        v[free] = np.linalg.solve(H[np.ix_(free, free)], -(g[free] + H[np.ix_(free, ~free)] @ v[~free]))
    slope, size = H @ v + g, np.abs(g).max() + np.abs(H).max() * np.abs(v).max()
    assert (lower - 1e-9 <= v).all() and (v <= upper + 1e-9).all()  # it is the minimum
    assert (slope[(v > lower) & ~fixed] <= 1e-9 * size).all() and (slope[(v < upper) & ~fixed] >= -1e-9 * size).all()
    return v


def assert_minimum(problem, box, found, shift=0.0):
    """Karush, Kuhn and Tucker's conditions, and what else a solution says of itself."""
    lq = found.lq
    assert found.converged and (box.lower <= lq.U).all() and (box.upper >= lq.U).all()
    whole = problem._replace(R=problem.R + shift * np.eye(problem.r.shape[1]))
    about = whole.about(lq.X, lq.U)
    gradient = adjoint(about.A, about.B, about.q, about.r)[1]
    scale = np.abs(adjoint(problem.A, problem.B, problem.q, problem.r)[1]).max() + np.abs(whole.R).max()
    at_lower, at_upper = box.lower >= lq.U, box.upper <= lq.U
    assert np.abs(gradient[~at_lower & ~at_upper]).max(initial=0.0) < 1e-8 * scale
    assert (gradient[at_lower & ~at_upper] > -1e-8 * scale).all()
    assert (gradient[at_upper & ~at_lower] < 1e-8 * scale).all()
    assert (at_lower | at_upper)[found.held].all()
    assert not lq.K[found.held].any()
    np.testing.assert_allclose(lq.X, problem.states(lq.U), rtol=1e-9, atol=1e-9 * (1.0 + np.abs(lq.X).max()))
    followed = lq.k - np.einsum("nij,nj->ni", lq.K, lq.X[:-1])
    np.testing.assert_allclose(followed, lq.U, rtol=1e-9, atol=1e-10 * (1.0 + np.abs(lq.k).max()))


@pytest.mark.parametrize("batch", range(10))
def test_the_minimizer_is_that_of_the_dense_problem(batch):
    """300 random problems in all."""
    rng, limited, sweeps = np.random.default_rng(batch), 0, []
    for _ in range(30):
        problem = convex_problem(rng)
        box = random_box(rng, problem.r.shape)
        found = solve_in_box(problem, box)
        reference = dense_minimizer(*dense(problem), box.lower.ravel(), box.upper.ravel()).reshape(problem.r.shape)
        error = np.abs(found.lq.U - reference).max()
        assert error <= 1e-10 * np.abs(reference).max()
        assert_minimum(problem, box, found)
        limited += bool(found.held.any())
        sweeps.append(found.sweeps)
    assert limited >= 15 and max(sweeps) <= 25 and np.median(sweeps) <= 5


SHIFTS = {
    "one": lambda N, nu: (),
    "a step": lambda N, nu: (N, 1),
    "a control": lambda N, nu: (nu,),
    "each": lambda N, nu: (N, nu),
}


@given(seeds, st.sampled_from([1e-3, 0.1, 10.0]), st.sampled_from([0.0, 1e-2, 1.0]), st.sampled_from(sorted(SHIFTS)))
def test_shifts_are_in_the_weights(seed, sigma, tau, shape):
    """A multiplier on the controls, the same for all or another for each, and one on the states."""
    rng = np.random.default_rng(seed)
    problem = convex_problem(rng)
    (N, nu), nx = problem.r.shape, problem.q.shape[1]
    box = random_box(rng, problem.r.shape)
    shift = sigma * rng.uniform(0.5, 1.5, SHIFTS[shape](N, nu))
    found = solve_in_box(problem, box, shift, tau)
    R = problem.R + np.broadcast_to(shift, (N, nu))[:, :, None] * np.eye(nu)
    whole = problem._replace(R=R, Q=problem.Q + tau * np.eye(nx))
    reference = dense_minimizer(*dense(whole), box.lower.ravel(), box.upper.ravel()).reshape(N, nu)
    np.testing.assert_allclose(found.lq.U, reference, rtol=1e-9, atol=1e-9 * np.abs(reference).max(initial=1e-300))
    assert_minimum(whole, box, found)


@given(seeds)
def test_where_no_limit_is_in_reach_it_is_the_plain_sweep_bit_for_bit(seed):
    rng = np.random.default_rng(seed)
    problem = convex_problem(rng)
    plain = solve(problem)
    beyond = 1.0 + 2.0 * np.abs(plain.U)
    boxes = [Box(-beyond, beyond), Box(-beyond, np.full_like(beyond, INF)), Box(-INF * beyond, INF * beyond)]
    for box in boxes:
        found = solve_in_box(problem, box)
        assert found.sweeps == 1 and found.converged and not found.held.any()
        for name, ours, theirs in zip(plain._fields, found.lq, plain, strict=True):
            np.testing.assert_array_equal(ours, theirs, err_msg=name)


@given(seeds)
def test_limits_that_just_do_not_bind_change_nothing_and_those_that_just_do_little(seed):
    rng = np.random.default_rng(seed)
    problem = convex_problem(rng)
    plain = solve(problem).U
    touching = solve_in_box(problem, Box(np.minimum(plain, 0.0), np.maximum(plain, 0.0)))
    np.testing.assert_allclose(touching.lq.U, plain, rtol=0, atol=1e-9 * np.abs(plain).max())
    assert touching.converged
    closer = solve_in_box(problem, Box(np.minimum(0.999 * plain, 0.0), np.maximum(0.999 * plain, 0.0)))
    assert closer.converged and closer.held.any()
    H, g = dense(problem)
    costs = [g @ U.ravel() + 0.5 * U.ravel() @ H @ U.ravel() for U in (plain, closer.lq.U, 0.999 * plain)]
    assert costs[0] < costs[1] <= costs[2] + 1e-12 * abs(costs[2])


@given(seeds)
def test_the_gains_are_those_of_the_free_controls(seed):
    rng = np.random.default_rng(seed)
    problem = convex_problem(rng)
    found = solve_in_box(problem, random_box(rng, problem.r.shape))
    free = solve(problem, held=found.held)
    np.testing.assert_allclose(found.lq.K, free.K, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(free.K).max()))
    np.testing.assert_allclose(found.lq.P, free.P, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(free.P).max()))
    # the cost-to-go is that of the clipped solution: its gradient is the costate of the adjoint
    about = problem.about(found.lq.X, found.lq.U)
    costates = adjoint(about.A, about.B, about.q, about.r)[0]
    np.testing.assert_allclose(found.lq.costates, costates, rtol=1e-7, atol=1e-8 * (1.0 + np.abs(costates).max()))


def test_no_room_at_all():
    """Both limits at zero everywhere, or on one control: the others minimize."""
    problem = random_problem(np.random.default_rng(0), 3, 2, 8)[0]
    zero = np.zeros((8, 2))
    found = solve_in_box(problem, Box(zero, zero.copy()))
    assert found.converged and not found.lq.U.any() and not np.signbit(found.lq.U).all()
    lower, upper = np.full((8, 2), -INF), np.full((8, 2), INF)
    lower[:, 1] = upper[:, 1] = 0.0
    found, held = solve_in_box(problem, Box(lower, upper)), np.zeros((8, 2), bool)
    held[:, 1] = True
    np.testing.assert_allclose(found.lq.U, solve(problem, held=held).U, rtol=1e-9, atol=1e-12)
    assert not found.lq.U[:, 1].any()


@given(seeds)
def test_an_iterate_on_its_limits_is_where_the_sweep_begins(seed):
    """Started from the minimizer, the working set is right at once: one sweep, and no change."""
    rng = np.random.default_rng(seed)
    problem = convex_problem(rng)
    box = random_box(rng, problem.r.shape)
    first = solve_in_box(problem, box)
    again = solve_in_box(problem.about(first.lq.X, first.lq.U), box.about(first.lq.U))
    assert again.sweeps == 1 and again.converged
    assert np.abs(again.lq.U).max() <= 1e-9 * (1.0 + np.abs(first.lq.U).max())


def test_long_horizons_with_many_limits_take_few_sweeps():
    counts = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        problem = random_problem(rng, 14, 7, 200, radius=rng.uniform(0.5, 0.9))[0]
        plain = solve(problem).U
        width = np.full(plain.shape, np.quantile(np.abs(plain), rng.uniform(0.2, 0.9)))
        found = solve_in_box(problem, Box(-width, width))
        assert_minimum(problem, Box(-width, width), found)
        assert 0.05 < found.held.mean() < 0.95
        counts.append(found.sweeps)
    assert max(counts) <= 25


def test_rounds_that_did_not_suffice_are_told():
    rng = np.random.default_rng(1)
    for _ in range(20):
        problem = convex_problem(rng)
        box = random_box(rng, problem.r.shape)
        full = solve_in_box(problem, box)
        for rounds in range(1, full.sweeps):
            short = solve_in_box(problem, box, rounds=rounds)
            assert not short.converged and short.sweeps == rounds
            assert (box.lower <= short.lq.U).all() and (box.upper >= short.lq.U).all()
            np.testing.assert_allclose(
                short.lq.X, problem.states(short.lq.U), atol=1e-9 * (1 + np.abs(short.lq.X).max())
            )
            value = problem.value(short.lq.X, short.lq.U)
            assert value >= problem.value(full.lq.X, full.lq.U) - 1e-9 * abs(value)


@given(seeds)
def test_a_problem_without_minimizer_is_refused_unless_limits_hold_the_controls(seed):
    problem = random_lq(seed)
    H, _ = dense(problem)
    if np.linalg.eigvalsh(H)[0] > -1e-6:
        return
    free = np.full(problem.r.shape, INF)
    with pytest.raises(NotPositiveDefinite):
        solve_in_box(problem, Box(-free, free))
    none = np.zeros_like(free)
    assert not solve_in_box(problem._replace(q=0.0 * problem.q), Box(none, none.copy())).lq.U.any()


# The ball within the box


@given(seeds, st.sampled_from([1e-2, 0.3, 3.0]))
def test_the_ball_problem_keeps_to_the_limits(seed, radius):
    """A minimum over the ball and the box: its multiplier makes it one of the shifted problem in the box."""
    rng = np.random.default_rng(seed)
    problem = convex_problem(rng, gaps=False)
    box, weights = random_box(rng, problem.r.shape), rng.uniform(0.5, 1.5, len(problem.r))
    ball = solve_in_ball(problem, box, radius, weights)
    U = ball.found.lq.U
    assert (box.lower <= U).all() and (box.upper >= U).all()
    length = np.sqrt(weights @ (U * U).sum(axis=1))
    assert length <= radius * (1.0 + 1e-6) and ball.value <= 0.0
    if ball.multiplier > 0.0:
        assert length == pytest.approx(radius, rel=1e-6)
    whole = problem._replace(R=problem.R + (ball.multiplier * weights)[:, None, None] * np.eye(problem.r.shape[1]))
    reference = dense_minimizer(*dense(whole), box.lower.ravel(), box.upper.ravel()).reshape(U.shape)
    np.testing.assert_allclose(U, reference, rtol=1e-6, atol=1e-7 * np.abs(reference).max(initial=1e-300))


# The box's own functions


def test_functions_of_a_box():
    box = Box(np.array([[-1.0, -INF, 0.0]]), np.array([[1.0, 2.0, 0.0]]))
    assert box.bounded and not Box(-INF * np.ones((1, 1)), INF * np.ones((1, 1))).bounded
    U = np.array([[1.5, 7.0, -3.0]])
    np.testing.assert_array_equal(box.clip(U), [[1.0, 2.0, 0.0]])
    assert box.contains(box.clip(U)) and not box.contains(U)
    assert box.contains(np.array([[1.0 + 1e-13, 0.0, 0.0]])) and not box.contains(np.array([[1.0 + 1e-9, 0.0, 0.0]]))
    about = box.about(np.array([[1.0, 0.5, 0.0]]))
    np.testing.assert_array_equal(about.lower, [[-2.0, -INF, 0.0]])
    np.testing.assert_array_equal(about.upper, [[0.0, 1.5, 0.0]])
    assert about.touches(np.zeros((1, 3))) and not Box(-np.ones((1, 3)), np.ones((1, 3))).touches(np.zeros((1, 3)))
    at = np.array([[1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(box.pushed(at, np.array([[-1.0, -1.0, -1.0]])), [[True, False, True]])
    np.testing.assert_array_equal(box.pushed(at, np.array([[1.0, 1.0, 1.0]])), [[False, False, True]])
    np.testing.assert_array_equal(box.pushed(at, np.zeros((1, 3))), [[False, False, False]])
    np.testing.assert_array_equal(box.projected(at, np.array([[-1.0, -2.0, 3.0]])), [[0.0, -2.0, 0.0]])
