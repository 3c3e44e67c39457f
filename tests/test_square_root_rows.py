"""Rows of the square-root sweep: new right-hand sides, contradictions, initial states, refusals; its reflections."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from square_root_problems import constrained, dense, random_lq, random_scale, verdict

from mjslq.lq import householder
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.lq.square_root import Infeasible, PathRows, StateRows, Unbounded, factorize, solve

seeds = st.integers(0, 2**32 - 1)

# Other right-hand sides


@given(seeds)
@settings(max_examples=30)
def test_solving_again_is_solving_anew(seed):
    rng = np.random.default_rng(seed)
    nx, nu, N, m = 4, 3, 9, 12
    lq = random_lq(rng, nx, nu, N, 1.0)
    H, C, step = rng.standard_normal((m, nx)), rng.standard_normal((m, nu)), rng.integers(0, N // 2, m) * 2
    step = np.minimum(np.arange(m) * N // m, N - 1)
    scale = random_scale(rng, m, 0.3)
    E, E_0 = rng.standard_normal((2, 2, nx))
    old, new = rng.standard_normal((2, m)), rng.standard_normal((2, m))
    first = factorize(lq, PathRows(step, H, C, old[0], scale), StateRows(E, old[1][:2]), StateRows(E_0, old[1][2:4]))
    other = lq._replace(q=2.0 * lq.q, r=lq.r + 1.0, c=-lq.c)
    again = first.solve(
        path=new[0], terminal=new[1][:2], initial=new[1][2:4], q=other.q, r=other.r, c=other.c, refinements=1
    )
    anew = solve(
        other, PathRows(step, H, C, new[0], scale), StateRows(E, new[1][:2]), StateRows(E_0, new[1][2:4]), refinements=1
    )
    for one, two in zip(again._replace(to_go=()), anew._replace(to_go=()), strict=True):
        np.testing.assert_array_equal(one, two)


def test_smaller_percentages_of_all_right_sides_scale_the_solution():
    """(2.41): with no linear terms the solution is proportional to Delta."""
    rng = np.random.default_rng(2)
    lq = random_lq(rng, 4, 2, 12, 1.1)
    lq = lq._replace(q=0.0 * lq.q, r=0.0 * lq.r, c=0.0 * lq.c)
    path = PathRows([2, 5, 7], rng.standard_normal((3, 4)), rng.standard_normal((3, 2)), [1.0, -2.0, 0.5])
    factorization = factorize(lq, path, StateRows(np.eye(4)[:2], [1.0, 2.0]))
    whole = factorization.solve()
    half = factorization.solve(path=np.multiply(0.5, path.d), terminal=[0.5, 1.0])
    np.testing.assert_allclose(half.U, 0.5 * whole.U, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(half.cost, 0.25 * whole.cost, rtol=1e-10)


# Dependent rows and contradictions


def combination(problem, error):
    """Left and right side of the combination that `error` names, the dynamics taken out by least squares."""
    lq, path, terminal, _ = problem
    _, _, J, b, _ = dense(*problem)
    dynamics, m = lq.c.size, len(path.d)
    place = {"path": dynamics, "terminal": dynamics + m, "initial": dynamics + m + len(terminal.d)}
    rows = [place[row.kind] + row.number for row in error.rows]
    left, right = error.multipliers @ J[rows], error.multipliers @ b[rows]
    y = np.linalg.lstsq(J[:dynamics].T, -left, rcond=None)[0]
    return left + J[:dynamics].T @ y, right + b[:dynamics] @ y, np.abs(error.multipliers).max()


def test_contradictions_are_proved():
    """The rows named add up to zero on the left and to something else on the right."""
    proved = 0
    for seed in range(1000):
        problem = constrained(np.random.default_rng(seed))
        ours, error = verdict(*problem)
        if ours == "infeasible":
            left, right, size = combination(problem, error)
            assert np.abs(left).max() < 1e-5 * size and abs(right) > 1e-7 * size, seed
            proved += 1
    assert proved > 30


def double_integrator(N):
    zeros = np.zeros
    return LQProblem(
        A=np.tile([[1.0, 1.0], [0.0, 1.0]], (N, 1, 1)), B=np.tile([[0.5], [1.0]], (N, 1, 1)), c=zeros((N, 2)),
        Q=zeros((N + 1, 2, 2)), R=np.ones((N, 1, 1)), M=zeros((N, 1, 2)), q=zeros((N + 1, 2)), r=zeros((N, 1)),
    )  # fmt: skip


def names(error):
    return {(row.kind, row.number, row.step) for row in error.value.rows}


def test_contradicting_rows_are_named():
    lq, position = double_integrator(6), [1.0, 0.0]
    # another row (step 1) and the terminal row do not take part
    path = PathRows([4, 1, 4], [position, position, position], None, [1.0, 5.0, 2.0])
    with pytest.raises(Infeasible, match=r"from step 4 on.*path row 0 \(step 4\), path row 2 \(step 4\)$") as error:
        solve(lq, path, StateRows([position], [0.0]), "free")
    assert error.value.step == 4 and names(error) == {("path", 0, 4), ("path", 2, 4)}
    # x_0 = 0 fixes x_1 in position by u_0 = 0
    path = PathRows([0, 1], [[0.0, 0.0], position], [[1.0], [0.0]], [0.0, 1.0])
    with pytest.raises(Infeasible) as error:
        solve(lq, path)
    taking_part = {("path", 0, 0), ("path", 1, 1), ("initial", 0, 0), ("initial", 1, 0)}
    assert names(error) == taking_part
    # the same on a manifold, and terminal rows against each other
    with pytest.raises(Infeasible) as error:
        solve(lq, path, None, StateRows(np.eye(2), [0.0, 0.0]))
    assert names(error) == taking_part
    with pytest.raises(Infeasible) as error:
        solve(lq, None, StateRows([[1.0, 1.0], [2.0, 2.0]], [1.0, 1.0]))
    assert error.value.step == 6 and names(error) == {("terminal", 0, 6), ("terminal", 1, 6)}


def test_a_row_without_coefficients():
    lq = double_integrator(3)
    nothing = PathRows([1], [[0.0, 0.0]], [[0.0]], [0.0])
    np.testing.assert_array_equal(solve(lq, nothing).U, 0.0)
    with pytest.raises(Infeasible) as error:
        solve(lq, nothing._replace(d=[1e-3]))
    assert names(error) == {("path", 0, 1)}


def test_dependent_rows_that_agree_are_dropped():
    rng = np.random.default_rng(4)
    lq = random_lq(rng, 4, 2, 10, 1.2)
    H, C, d = rng.standard_normal((3, 4)), rng.standard_normal((3, 2)), rng.standard_normal(3)
    once = solve(lq, PathRows([2, 4, 6], H, C, d))
    twice = solve(lq, PathRows([2, 4, 6, 6, 2], [*H, 3 * H[2], -H[0]], [*C, 3 * C[2], -C[0]], [*d, 3 * d[2], -d[0]]))
    np.testing.assert_allclose(twice.X, once.X, atol=1e-10)
    np.testing.assert_allclose(twice.costates, once.costates, atol=1e-9)
    np.testing.assert_allclose(twice.mu[2] + 3 * twice.mu[3], once.mu[2], atol=1e-9)
    np.testing.assert_allclose(twice.mu[0] - twice.mu[4], once.mu[0], atol=1e-9)


def test_rounding_in_repeated_rows_is_no_contradiction():
    lq, position = double_integrator(5), [1.0, 0.0]
    rows = PathRows([3, 3], [position, position], None, [1e-15, -1e-15])
    assert np.abs(solve(lq, rows).X).max() < 1e-12
    with pytest.raises(Infeasible):
        solve(lq, rows, slack=0.0)
    with pytest.raises(Infeasible):
        solve(lq, rows._replace(d=[1e-8, -1e-8]))


def test_dynamics_that_forget():
    """A = 0: what a row asks of the next state, controls alone must bring."""
    lq = double_integrator(4)._replace(A=np.zeros((4, 2, 2)))
    solution = solve(lq, None, StateRows([[1.0, 0.0]], [1.0]), [3.0, 4.0])
    np.testing.assert_allclose(solution.U.ravel(), [0.0, 0.0, 0.0, 2.0], atol=1e-15)
    with pytest.raises(Infeasible) as error:
        solve(lq, None, StateRows(np.eye(2), [1.0, 1.0]), [3.0, 4.0])
    assert error.value.step == 3 and names(error) == {("terminal", 0, 4), ("terminal", 1, 4)}


# Initial states


def test_what_nothing_determines_of_the_initial_state_is_least():
    lq = double_integrator(4)
    solution = solve(lq, None, StateRows([[1.0, 1.0]], [10.0]), "free")  # position + speed = p + 5 s at the end
    np.testing.assert_allclose(solution.X[0], np.array([1.0, 5.0]) * 10.0 / 26.0, rtol=1e-12)
    np.testing.assert_allclose(solution.U, 0.0, atol=1e-14)


def test_a_cost_without_end():
    lq = double_integrator(4)
    with pytest.raises(Unbounded, match="no minimum over the initial states"):
        solve(lq._replace(q=np.ones((5, 2))), None, None, "free")


# Weights without a minimizer


def test_the_step_without_a_minimizer_is_named():
    lq = double_integrator(5)._replace(Q=np.tile(np.eye(2), (6, 1, 1)))
    R, Q, M = lq.R.copy(), lq.Q.copy(), lq.M.copy()
    R[3] = -1.0
    with pytest.raises(NotPositiveDefinite) as error:
        solve(lq._replace(R=R))
    assert error.value.step == 3
    Q[2] = [[1.0, 2.0], [2.0, 1.0]]
    with pytest.raises(NotPositiveDefinite) as error:
        solve(lq._replace(Q=Q))
    assert error.value.step == 2
    Q[2], Q[5] = np.eye(2), -np.eye(2)
    with pytest.raises(NotPositiveDefinite) as error:
        solve(lq._replace(Q=Q))
    assert error.value.step == 5
    M[1] = [[2.0, 0.0]]
    with pytest.raises(NotPositiveDefinite) as error:
        solve(lq._replace(M=M))
    assert error.value.step == 1
    with pytest.raises(NotPositiveDefinite) as error:  # nothing weighs the last control
        solve(lq._replace(R=0.0 * lq.R, Q=0.0 * lq.Q))
    assert error.value.step == 4


def test_a_hard_row_stands_in_for_a_weight():
    lq = double_integrator(5)
    R = lq.R.copy()
    R[3] = 0.0
    solution = solve(lq._replace(R=R), PathRows([3], None, [[1.0]], [0.7]))
    np.testing.assert_allclose(solution.U[3], 0.7)


# Refusals


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"path": PathRows([5], None, [[1.0]], [0.0])}, "path.step must lie between 0 and 4, got 5; rows on x_5"),
        ({"path": PathRows([-1], None, [[1.0]], [0.0])}, "path.step must lie between 0 and 4, got -1"),
        ({"path": PathRows([0.5], None, [[1.0]], [0.0])}, "path.step must be whole numbers"),
        ({"path": PathRows([0], [[1.0]], None, [0.0])}, r"path.H must have shape \(1, 2\), got \(1, 1\)"),
        ({"path": PathRows([0], None, [[1.0]], [np.nan])}, "path.d must be finite"),
        ({"path": PathRows([0], None, [[1.0]], [0.0], [-1.0])}, "path.scale must not be negative, got -1"),
        ({"terminal": StateRows([1.0, 0.0], [0.0])}, r"terminal.H must have shape \(m, 2\), got \(2,\)"),
        ({"initial": StateRows(np.eye(2), [0.0])}, r"initial.d must have shape \(2,\), got \(1,\)"),
        ({"initial": [1.0]}, r"initial must have shape \(2,\), got \(1,\)"),
        ({"initial": "fre"}, r"initial must be 'free', a state \(2,\), StateRows or None, got 'fre'"),
        ({"refinements": -1}, "refinements must be a whole number of at least 0"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ValueError, match=message):
        solve(double_integrator(5), **arguments)


def test_refusals_of_problems_and_right_sides():
    lq = double_integrator(5)
    with pytest.raises(ValueError, match=r"q must have shape \(6, 2\), got \(5, 2\)"):
        solve(lq._replace(q=np.zeros((5, 2))))
    with pytest.raises(ValueError, match=r"B must hold at least one step, state and control, got shape \(0, 2, 1\)"):
        solve(lq._replace(B=np.zeros((0, 2, 1))))
    factorization = factorize(lq, PathRows([1], None, [[1.0]], [0.0]), StateRows([[1.0, 0.0]], [0.0]))
    with pytest.raises(ValueError, match=r"path must have shape \(1,\), got \(2,\)"):
        factorization.solve(path=[0.0, 0.0])
    with pytest.raises(ValueError, match=r"terminal must have shape \(1,\), got \(2,\)"):
        factorization.solve(terminal=[0.0, 0.0])
    with pytest.raises(ValueError, match=r"c must have shape \(5, 2\), got \(4, 2\)"):
        factorization.solve(c=np.zeros((4, 2)))


def test_what_is_given_stays_as_it_is():
    rng = np.random.default_rng(0)
    lq, path, terminal, initial = constrained(rng, 4, 2, 8, 1.0)
    arrays = [*lq, *path, *terminal, *[part for part in (initial,) if isinstance(part, np.ndarray)]]
    copies = [np.copy(array) for array in arrays]
    verdict(lq, path, terminal, initial)
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    for array in lq[:-1]:  # but for `free`
        array.flags.writeable = False
    verdict(lq, path, terminal, initial)


# The transformations


@given(st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 9)), seeds)
def test_hard_rows_keep_their_row_space(size, seed):
    rng = np.random.default_rng(seed)
    nu, nx, rows = size
    given_rows = rng.standard_normal((rows, nu + nx))
    if rows > 2:
        given_rows[2] = given_rows[0] - given_rows[1]
    given_rows /= np.linalg.norm(given_rows, axis=1)[:, None]
    block, order = given_rows.copy(), np.arange(nu)
    V, h = np.zeros((rows, rows)), np.zeros(rows)
    rank, carried = householder.eliminate_hard(block, rows, nu, 1e-12, order, V, h, np.empty((3, nu + nx)))
    assert rank + carried == np.linalg.matrix_rank(given_rows)
    assert rank == np.linalg.matrix_rank(given_rows[:, :nu])
    np.testing.assert_array_equal(block[rank:, :nu], 0.0)
    np.testing.assert_array_equal(block[rank + carried :], 0.0)
    np.testing.assert_array_equal(np.tril(block[:rank, :rank], -1), 0.0)
    again = np.hstack([given_rows[:, order], given_rows[:, nu:]])
    for column in range(nu + nx):
        y = again[:, column].copy()
        householder.reflect_vector(V, h, rank + carried, rows, y, False)
        np.testing.assert_allclose(y, block[:, column], atol=1e-13)
        householder.reflect_vector(V, h, rank + carried, rows, y, True)
        np.testing.assert_allclose(y, again[:, column], atol=1e-13)
    variance = rng.random(rows)
    total = variance.sum()
    Q = np.eye(rows)
    for row in Q:
        householder.reflect_vector(V, h, rank + carried, rows, row, False)
    expected = variance if rank + carried == 0 else (Q.T**2) @ variance if rank + carried == 1 else None
    householder.reflect_variance(V, h, rank + carried, rows, variance)
    np.testing.assert_allclose(variance.sum(), total)
    if expected is not None:
        np.testing.assert_allclose(variance, expected, atol=1e-14)


@given(st.integers(1, 8), st.integers(0, 9), seeds, st.floats(0.0, 6.0))
def test_merging_keeps_the_sum_of_squares(n, rows, seed, orders):
    rng = np.random.default_rng(seed)
    whole = np.zeros((n + 2, n + 2))
    whole[:2], whole[2:, :2] = rng.standard_normal((2, n + 2)), 7.0  # what is not to be touched
    whole[2:, 2:] = np.triu(rng.standard_normal((n, n)))
    S = rng.standard_normal((rows, n + 2)) * 10.0 ** rng.uniform(0, orders)
    T = whole[2:, 2:]
    if n > 2:
        T[1] = 0.0
    expected, before = T.T @ T + S[:, 2:].T @ S[:, 2:], whole.copy()
    householder.merge(whole, S.copy(), 2, 0, rows, np.empty(n + 2))
    np.testing.assert_array_equal(whole[:2], before[:2])
    np.testing.assert_array_equal(whole[2:, :2], 7.0)
    np.testing.assert_array_equal(np.tril(T, -1), 0.0)
    np.testing.assert_allclose(T.T @ T, expected, atol=1e-12 * np.abs(expected).max())


@given(st.integers(1, 7), st.integers(0, 7), seeds)
def test_semidefinite_factors(n, rank, seed):
    rng = np.random.default_rng(seed)
    G = rng.standard_normal((rank, n)) * 10.0 ** rng.uniform(-3, 3, n)
    S = G.T @ G
    F = np.zeros((n, n))
    found = householder.pivoted_cholesky_rows(S.copy(), F)
    assert found == min(n, rank) and not F[found:].any()
    size = np.sqrt(np.outer(np.diag(S), np.diag(S))) + 1e-300
    assert (np.abs(F.T @ F - S) < 1e-11 * size).all()
    upper = np.triu(S)
    if householder.cholesky_rows(S, upper):
        assert (np.abs(upper.T @ upper - S) < 1e-11 * size).all() and not np.tril(upper, -1).any()
    else:
        assert rank < n
    indefinite = np.diag(np.append(np.ones(n), -1.0))
    assert householder.pivoted_cholesky_rows(indefinite.copy(), np.zeros((n + 1, n + 1))) == -1
    assert not householder.cholesky_rows(indefinite, np.triu(indefinite))
