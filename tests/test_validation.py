"""What goes in is checked where it enters, and the sentence says which argument, what was expected and what came."""

import numpy as np
import pytest

from mjslq.trajectory import Trajectory
from mjslq.validation import as_array, choose, count, frozen, per_step_matrices, per_step_vectors, positive

nan, inf = float("nan"), float("inf")


# Arrays


def test_as_array_takes_lists_numbers_and_any_order():
    np.testing.assert_array_equal(as_array("a", [[1, 2], [3, 4]]), [[1.0, 2.0], [3.0, 4.0]])
    assert as_array("a", 3).shape == ()
    fortran = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    assert as_array("a", fortran, (2, "columns")).flags.c_contiguous


@pytest.mark.parametrize(
    "value, shape, sentence",
    [
        ("abc", None, r"a must be an array of numbers, got str 'abc'"),
        ([[1, 2], [3]], None, r"a must be an array of numbers, got list \[\[1, 2\], \[3\]\]"),
        (None, (3,), r"a must "),
        ({"x": 1}, None, r"a must be an array of numbers, got dict"),
        ([1.0, 2.0], (3,), r"a must have shape \(3,\), got \(2,\)"),
        (1.0, (1,), r"a must have shape \(1,\), got \(\)"),
        (np.zeros((2, 3)), ("N", 2), r"a must have shape \(N, 2\), got \(2, 3\)"),
        ([0.0, nan], None, r"a must be finite, but a\[1\] is nan"),
        ([[0.0, 1.0], [-inf, nan]], None, r"a must be finite, but a\[1, 0\] is -inf"),
        (inf, None, r"a must be finite, but a is inf"),
    ],
)
def test_as_array_says_what_is_wrong(value, shape, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        as_array("a", value, shape)
    assert "\n" not in str(caught.value)


def test_complex_numbers_are_refused_without_a_warning():
    with pytest.raises(ValueError, match="a must be an array of numbers"):
        as_array("a", np.array([1.0 + 2.0j]))


def test_long_values_are_cut_short_in_messages():
    with pytest.raises(ValueError) as caught:
        as_array("a", "x" * 1000)
    assert len(str(caught.value)) < 120


def test_frozen_arrays_cannot_be_written_but_their_source_can():
    source = np.zeros(3)
    with pytest.raises(ValueError, match="read-only"):
        frozen(source)[0] = 1.0
    source[0] = 1.0


# Weights a step


@pytest.mark.parametrize("definite", [True, False])
def test_matrices_in_every_form_mean_the_same(definite):
    for form in (2.0, [2.0, 2.0], 2.0 * np.eye(2), np.tile(2.0 * np.eye(2), (5, 1, 1))):
        matrices = per_step_matrices("Q", form, 5, 2, definite=definite)
        np.testing.assert_array_equal(matrices, np.tile(2.0 * np.eye(2), (5, 1, 1)))
        matrices[0, 0, 0] = 9.0  # the caller's own: written to, it changes nothing else
        assert matrices[1, 0, 0] == 2.0


def spoiled(step, matrix):
    matrices = np.tile(np.eye(2), (5, 1, 1))
    matrices[step] = matrix
    return matrices


@pytest.mark.parametrize(
    "value, definite, sentence",
    [
        (0.0, True, r"^R must be positive definite, but has the eigenvalue 0$"),
        (-1.0, False, r"^R must be positive semidefinite, but has the eigenvalue -1$"),
        ([1.0, -2.0], False, r"^R must be positive semidefinite, but has the eigenvalue -2$"),
        ([[1.0, 2.0], [2.0, 1.0]], True, r"^R must be positive definite, but has the eigenvalue -1$"),
        ([[1.0, 0.5], [0.0, 1.0]], True, r"^R must be symmetric, but has an asymmetry 0.5$"),
        (spoiled(3, [[1.0, 2.0], [2.0, 1.0]]), True, r"^R\[3\] must be positive definite"),
        (spoiled(2, [[1.0, 2.0], [0.0, 1.0]]), False, r"^R\[2\] must be symmetric"),
        (spoiled(4, nan), True, r"^R must be finite, but R\[4, 0, 0\] is nan"),
        (np.eye(3), True, r"R must be a number, a diagonal \(2,\), a matrix \(2, 2\) or one matrix a step \(5, 2, 2\)"),
        (np.ones(3), True, r"got shape \(3,\)"),
        (np.tile(np.eye(2), (4, 1, 1)), True, r"got shape \(4, 2, 2\)"),
    ],
)
def test_matrices_say_what_is_wrong_and_at_which_step(value, definite, sentence):
    with pytest.raises(ValueError, match=sentence):
        per_step_matrices("R", value, 5, 2, definite=definite)


def test_rounding_is_no_asymmetry_and_no_negative_eigenvalue():
    root = np.random.default_rng(0).standard_normal((3, 6))
    low_rank = root.T @ root
    low_rank[0, 1] *= 1.0 + 1e-14
    matrices = per_step_matrices("Q", low_rank, 2, 6, definite=False)
    np.testing.assert_array_equal(matrices, matrices.transpose(0, 2, 1))


def test_vectors_in_every_form_mean_the_same():
    for form in (2.0, [2.0, 2.0], np.full((5, 2), 2.0)):
        np.testing.assert_array_equal(per_step_vectors("u", form, 5, 2), np.full((5, 2), 2.0))
    with pytest.raises(
        ValueError, match=r"u must be a number, a vector \(2,\) or one vector a step \(5, 2\), got shape"
    ):
        per_step_vectors("u", np.zeros((2, 5)), 5, 2)


# Names and numbers


def test_choose_lists_the_names_and_the_nearest():
    assert choose("engine", "mujoco", ["function", "mujoco"]) == "mujoco"
    with pytest.raises(
        ValueError, match=r"^unknown engine 'mujco'; there are: function, mujoco; did you mean 'mujoco'\?$"
    ):
        choose("engine", "mujco", ["function", "mujoco"])
    with pytest.raises(ValueError, match=r"^unknown engine 'zzz'; there are: function, mujoco$"):
        choose("engine", "zzz", ["function", "mujoco"])
    with pytest.raises(ValueError, match=r"there are: none$"):
        choose("engine", "zzz", [])


@pytest.mark.parametrize("given", [None, 3, ["mujoco"], np.zeros(2)])
def test_choose_refuses_what_is_no_name(given):
    with pytest.raises(ValueError, match=r"unknown engine .*; there are: function, mujoco"):
        choose("engine", given, ["function", "mujoco"])


@pytest.mark.parametrize("value", [0, -1.0, nan, inf])
def test_positive_says_what_came(value):
    assert positive("mass", "2.5") == 2.5
    with pytest.raises(ValueError, match=f"mass must be positive and finite, got {value}"):
        positive("mass", value)


@pytest.mark.parametrize("value", ["heavy", None, [1.0, 2.0]])
def test_positive_wants_a_number(value):
    with pytest.raises(ValueError, match="mass must be a number, got"):
        positive("mass", value)


@pytest.mark.parametrize("value", [0, -3, 2.0, "5", True, None, nan])
def test_count_wants_whole_numbers(value):
    assert count("horizon", np.int64(7)) == 7 and type(count("horizon", np.int64(7))) is int
    with pytest.raises(ValueError, match="horizon must be a whole number of at least 1, got"):
        count("horizon", value)


# Trajectories


def test_trajectory_fills_in_outputs_and_steps():
    trajectory = Trajectory(np.zeros((4, 2)), np.zeros((3, 1)), dt=0.5)
    assert trajectory.Y.shape == (4, 0) and trajectory.horizon == 3 and not trajectory.diverged
    np.testing.assert_array_equal(trajectory.dt, [0.5, 0.5, 0.5])
    np.testing.assert_array_equal(trajectory.times, [0.0, 0.5, 1.0, 1.5])
    uneven = Trajectory(np.zeros((4, 2)), np.zeros((3, 1)), dt=[0.1, 0.2, 0.3])
    np.testing.assert_allclose(uneven.times, [0.0, 0.1, 0.3, 0.6])


@pytest.mark.parametrize(
    "change, sentence",
    [
        ({"X": np.zeros(4)}, r"X must have shape \(N \+ 1, nx\), got \(4,\)"),
        ({"U": np.zeros((4, 1))}, r"U must have shape \(3, nu\), got \(4, 1\)"),
        ({"Y": np.zeros((3, 1))}, r"Y must have shape \(4, ny\), got \(3, 1\)"),
        ({"X": np.full((4, 2), nan)}, r"X must be finite, but X\[0, 0\] is nan"),
        ({"U": np.full((3, 1), inf)}, r"U must be finite, but U\[0, 0\] is inf"),
        ({"dt": [0.1, 0.2]}, r"dt must be a number or one per step \(3,\), got shape \(2,\)"),
        ({"dt": 0.0}, "dt must be positive, got 0"),
        ({"dt": [0.1, -0.2, 0.3]}, r"dt must be positive, got -0\.2"),
        ({"dt": nan}, "dt must be finite"),
    ],
)
def test_trajectory_says_what_is_wrong(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        Trajectory(**({"X": np.zeros((4, 2)), "U": np.zeros((3, 1)), "dt": 0.1} | change))


def test_trajectory_may_be_nan_from_where_it_diverged():
    X = np.zeros((4, 1))
    X[2:] = nan
    assert Trajectory(X, np.zeros((3, 1)), diverged_at=2).diverged
    with pytest.raises(ValueError, match=r"X must be finite, but X\[2, 0\] is nan"):
        Trajectory(X, np.zeros((3, 1)), diverged_at=3)


def test_trajectory_cannot_be_changed():
    trajectory = Trajectory(np.zeros((4, 2)), np.zeros((3, 1)))
    for array in (trajectory.X, trajectory.U, trajectory.Y, trajectory.dt):
        assert not array.flags.writeable
    with pytest.raises(AttributeError):
        trajectory.X = np.zeros((4, 2))
