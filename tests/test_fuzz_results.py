"""Files of results at random: each loads as it was, or is refused in one sentence. Nothing is unpickled."""

import io
import json
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wrong_inputs import one_sentence, pose_arm

import mjslq
from mjslq import constraints, solve


class Trap:
    """Would leave a folder if it were unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (self.path,)


class Whole:
    """A file's bytes and what is in it."""

    def __init__(self, content, arrays):
        self.content, self.arrays = content, arrays


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module")
def whole(folder):
    """The bytes of a saved result with a scene, limits, multipliers and iterates, and what is in it."""
    problem = pose_arm(constraints=[constraints.State(-0.2, 0.2, name="a/b")], x0=[0.1, 0.0])
    solve(problem, max_iterations=2).save(folder / "whole.npz")
    with np.load(folder / "whole.npz") as data:
        arrays = dict(data)
    return Whole((folder / "whole.npz").read_bytes(), arrays)


SHAPES = st.sampled_from(
    [(), (0,), (1,), (2,), (3, 3), (10, 1), (11, 2), (10, 1, 2), (2, 11, 2), (2, 10, 1), (1, 0, 5)]
)
KINDS = st.sampled_from(["f8", "f4", "i8", "u1", "b1", "c16", "U3", "S2", "M8[s]", "O", "f8,i4"])
PLACES = st.integers(0, 10**9)
"""Where something is changed: the remainder by how many places there are."""
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-2, 10**20) | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=5,
)


def load(content, folder):
    """Load a file of these bytes, and use what is in it; None where it was refused in one sentence."""
    file = folder / "fuzzed.npz"
    file.write_bytes(content)
    try:
        result = mjslq.load(file)
    except ValueError as error:
        one_sentence(str(error), "fuzzed.npz")
        return None
    finally:
        assert not (folder / "trap").exists()
    used(result)
    return result


def used(result):
    """Everything that needs the arrays to belong together."""
    N, nu = result.trajectory.U.shape
    assert result.policy(result.trajectory.X[0], 0.0).shape == (nu,) or result.trajectory.diverged
    assert result.active_limits.shape == (N, nu) and result.status.message
    assert all(iterate.X.shape == result.trajectory.X.shape for iterate in result.iterates)


@settings(max_examples=150)
@given(flips=st.lists(st.tuples(PLACES, st.integers(1, 255)), min_size=1, max_size=8), kept=st.none() | PLACES)
def test_flipped_and_cut_bytes(flips, kept, whole, folder):
    content = bytearray(whole.content)
    for place, bits in flips:
        content[place % len(content)] ^= bits
    if kept is not None:
        del content[kept % len(content) :]
    result = load(bytes(content), folder)
    if result is not None:  # what was changed is not read: names in the archive, times of files
        np.testing.assert_array_equal(result.trajectory.X, whole.arrays["trajectory_X"][0])


def packed(arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


ARRAYS = st.tuples(KINDS, SHAPES, st.integers(0, 5)) | st.text(alphabet="ab_/", min_size=1, max_size=4)
"""An array of a type and shape, or another name for the one that is there."""


@settings(max_examples=200)
@given(changes=st.lists(st.tuples(PLACES, ARRAYS), min_size=1, max_size=2))
def test_other_arrays_in_place_of_the_right_ones(changes, whole, folder):
    arrays = dict(whole.arrays)
    for place, change in changes:
        name = sorted(arrays)[place % len(arrays)]
        if isinstance(change, str):
            arrays[change] = arrays.pop(name)
            continue
        kind, shape, seed = change
        if kind == "O":
            arrays[name] = np.full(shape, Trap(str(folder / "trap")), dtype=object)
        else:
            with np.errstate(all="ignore"):
                arrays[name] = np.asarray(9.0 * np.random.default_rng(seed).standard_normal(shape)).astype(kind)
    load(packed(arrays), folder)


@settings(max_examples=200)
@given(changes=st.lists(st.tuples(PLACES, st.just(...) | JSON), min_size=1, max_size=2), cut=st.integers(0, 9))
def test_other_headers(changes, cut, whole, folder):
    header = json.loads(str(whole.arrays["header"]))
    for place, value in changes:
        owner, key = deep(header, place)
        if value is ...:
            del owner[key]
        else:
            owner[key] = value
    text = json.dumps([header] if cut == 1 else header)
    load(packed(whole.arrays | {"header": np.array(text[:-cut] if cut > 5 else text)}), folder)


def deep(owner, place):
    """An entry of a nested table, and the table that it is in."""
    while True:
        place, n = divmod(place, len(owner))
        key = sorted(owner)[n] if isinstance(owner, dict) else n
        if not (isinstance(owner[key], (dict, list)) and owner[key]) or place % 4 == 0:
            return owner, key
        owner = owner[key]


@settings(max_examples=50)
@given(content=st.binary(max_size=300))
def test_any_bytes(content, folder):
    assert load(content, folder) is None


def test_the_file_itself_loads(whole, folder):
    assert load(whole.content, folder).multipliers.keys() == {"a/b", "controls"}
    assert load(packed(whole.arrays), folder) is not None
