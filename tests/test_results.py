"""Saved results: complete, whole or not at all, and refused in one sentence when they are something else."""

import dataclasses
import json
import math
import os
import pickle

import numpy as np
import pytest

import mjslq
from mjslq import Result, Status, problems, solve, storage
from mjslq.files import atomic_write
from mjslq.lie_groups import MOTION, ROTATION, SLIDE, TURN
from mjslq.log import IterationLog
from mjslq.manifold import StateSpace
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory

GROUPS = StateSpace.of(
    15, 12, [(MOTION, range(7), range(6)), (TURN, (9, 8), (7,)), (SLIDE, (13, 10, 11, 12), (11, 8, 9))]
)
"""A state with everything in it, in an order of its own."""


def sample(**change):
    """A result with something in every field, and numbers that do not end after a few digits."""
    rng = np.random.default_rng(0)
    space = change.get("space", StateSpace.of(4, 3, [(ROTATION, range(4), range(3))]))
    nx, ndx = (3, 3) if space is None else (space.nx, space.ndx)

    def trajectory(factor=1.0):
        X, U, Y = (rng.standard_normal(shape) for shape in ((4, nx), (3, 2), (4, 1)))
        return Trajectory(X, U, Y, factor * np.array([0.1, 0.2, 1.0 / 3.0]))

    numbers = rng.standard_normal((2, 11)).tolist()
    log = tuple(
        IterationLog(i, *row[:5], outcome, i + 1, *row[5:], limited=i)
        for (i, row), outcome in zip(enumerate(numbers), ("rejected", "final"), strict=True)
    )
    values = {
        "status": Status.MAX_ITERATIONS, "message": "Über die Zeit.", "cost": 1.0 / 3.0, "iterations": 1,
        "gradient_norm": 1e-300, "trajectory": trajectory(), "gains": rng.standard_normal((3, 2, ndx)),
        "lower": np.array([[-1.0 / 3.0, -math.inf]] * 3), "upper": np.array([[1.0 / 7.0, math.inf]] * 3),
        "constraint_violation": 5e-324, "violations": {"a gap/wide": rng.standard_normal(4)},
        "multipliers": {"controls": rng.standard_normal((3, 2)), "a gap/wide": rng.standard_normal((4, 1))},
        "knots": {"a gap/wide": np.arange(4)},
        "log": log, "iterates": (trajectory(), trajectory(2.0)), "seconds": 0.1 + 0.2, "compile_seconds": 1.0 / 9.0,
        "problem": "reach", "method": "slq", "options": {"tol": 1e-6, "eta": None}, "error": "Traceback\n  ...\n",
        "parameters": {"height": 2.5, "engine": "x"}, "space": space,
        "names": {"states": tuple(f"x{i}" for i in range(nx)), "controls": ("u", "v"), "outputs": ("y",)},
        "scene": Scene(bytes(range(256)), (2, 0), "arm"),
    }  # fmt: skip
    return Result(**(values | change))


def assert_same(a, b):
    """Equal to the last bit, field by field."""
    assert type(a) is type(b)
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    elif isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            assert_same(one, other)
    elif isinstance(a, float) and math.isnan(a):
        assert math.isnan(b)
    else:
        assert a == b


# Round trips


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"scene": None},
        {"iterates": ()},
        {"scene": None, "iterates": (), "log": (), "options": {}, "names": {}},
        {"gains": None},
        {"space": None, "multipliers": {}, "violations": {}, "error": ""},
        {"space": StateSpace.plain(3)},
        {
            "space": StateSpace.of(
                15, 12, [(MOTION, range(7), range(6)), (TURN, (9, 10), (6,)), (SLIDE, (12, 11, 13, 14), (8, 9, 7))]
            )
        },
        {"cost": math.inf, "gradient_norm": math.inf, "status": Status.DIVERGED},
        {"cost": math.nan},
        *({"status": status} for status in Status),
    ],
)
def test_every_field_survives_bit_for_bit(change, tmp_path):
    before = sample(**change)
    before.save(tmp_path / "one.npz")
    after = mjslq.load(tmp_path / "one.npz")
    assert_same(after, before)
    assert after.success == before.success


def test_diverged_trajectories_survive(tmp_path):
    X, Y = np.zeros((4, 4)), np.zeros((4, 1))
    X[2:] = Y[2:] = np.nan
    diverged = Trajectory(X, np.zeros((3, 2)), Y, dt=0.1, diverged_at=2)
    whole = Trajectory(np.zeros((4, 4)), np.zeros((3, 2)), np.zeros((4, 1)), dt=0.1)
    before = sample(trajectory=diverged, iterates=(whole, diverged))
    before.save(tmp_path / "one.npz")
    assert_same(mjslq.load(tmp_path / "one.npz"), before)


@pytest.mark.parametrize("engine", ["function", "mujoco"])
def test_a_solved_problem_survives(engine, tmp_path):
    problem = problems.get("hopper", height=1.0, engine=engine)
    before = solve(problem, max_iterations=3)
    before.save(str(tmp_path / "hop.npz"))  # a text will do as well as a path
    after = mjslq.load(str(tmp_path / "hop.npz"))
    assert_same(after, before)
    assert after.scene.model == problem.scene().model and len(after.scene.model) > 1000
    assert after.parameters["height"] == 1.0
    assert after.policy.horizon == before.trajectory.horizon
    assert problem.cost(after.trajectory) == before.cost


def test_numpy_values_in_options_become_plain(tmp_path):
    options = {"a": np.float64(0.1), "b": np.arange(3), "c": np.int64(4), "d": np.bool_(True)}
    sample(options=options).save(tmp_path / "o")
    assert mjslq.load(tmp_path / "o").options == {"a": 0.1, "b": [0, 1, 2], "c": 4, "d": True}


def test_the_name_of_the_file_is_kept_as_given(tmp_path):
    sample().save(tmp_path / "without_ending")
    assert os.listdir(tmp_path) == ["without_ending"]


def test_what_is_loaded_cannot_be_changed_by_accident(tmp_path):
    sample().save(tmp_path / "one.npz")
    after = mjslq.load(tmp_path / "one.npz")
    assert not after.trajectory.X.flags.writeable
    with pytest.raises(dataclasses.FrozenInstanceError):
        after.cost = 0.0


# Whole or not at all


@pytest.mark.parametrize("failure", [OSError("disk full"), KeyboardInterrupt()], ids=["disk full", "ctrl-c"])
def test_a_failure_in_the_middle_leaves_the_old_file(failure, tmp_path, monkeypatch):
    path = tmp_path / "one.npz"
    sample(message="old").save(path)

    def half(stream, **arrays):
        stream.write(b"half of it")
        raise failure

    monkeypatch.setattr(np, "savez_compressed", half)
    with pytest.raises(BaseException) as caught:
        sample(message="new").save(path)
    assert isinstance(caught.value, (type(failure), ValueError))
    assert os.listdir(tmp_path) == ["one.npz"]  # and nothing half-written beside it
    assert mjslq.load(path).message == "old"


def test_options_that_cannot_be_written_leave_the_old_file(tmp_path):
    path = tmp_path / "one.npz"
    sample(message="old").save(path)
    circle = {}
    circle["itself"] = circle
    with pytest.raises(ValueError):
        sample(options=circle).save(path)
    assert os.listdir(tmp_path) == ["one.npz"] and mjslq.load(path).message == "old"


def test_a_new_file_replaces_the_old_one(tmp_path):
    path = tmp_path / "one.npz"
    sample(message="old").save(path)
    sample(message="new").save(path)
    assert mjslq.load(path).message == "new" and os.listdir(tmp_path) == ["one.npz"]


def test_files_have_the_usual_permissions(tmp_path):
    sample().save(tmp_path / "one.npz")
    (tmp_path / "usual").write_bytes(b"")
    assert (tmp_path / "one.npz").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_a_folder_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"cannot write .*nowhere/one.npz: there is no folder .*nowhere$"):
        sample().save(tmp_path / "nowhere" / "one.npz")


def test_a_folder_in_place_of_a_file_is_named(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(ValueError, match=r"cannot write .*folder"):
        sample().save(tmp_path / "folder")
    assert os.listdir(tmp_path) == ["folder"]


def test_atomic_write_writes_bytes(tmp_path):
    with atomic_write(tmp_path / "a") as stream:
        stream.write(b"abc")
        assert not (tmp_path / "a").exists()  # before it is whole it has another name
    assert (tmp_path / "a").read_bytes() == b"abc"


# What is no result


def one_sentence(caught, path):
    text = str(caught.value)
    assert "\n" not in text and str(path) in text and len(text) < 300 + len(str(path))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no file .*none.npz") as caught:
        mjslq.load(tmp_path / "none.npz")
    one_sentence(caught, tmp_path / "none.npz")


def write_text(path):
    path.write_text("Dear diary,\n" * 30)


def write_nothing(path):
    path.write_bytes(b"")


def write_array(path):
    with path.open("wb") as stream:
        np.save(stream, np.zeros(3))


def write_pickle(path):
    path.write_bytes(pickle.dumps({"a": 1}))


def write_other_npz(path):
    with path.open("wb") as stream:
        np.savez(stream, X=np.zeros(3))


def write_wrong_header(path):
    with path.open("wb") as stream:
        np.savez(stream, header=np.array("not json"))


def write_short_header(path):
    with path.open("wb") as stream:
        np.savez(stream, header=np.array(json.dumps({"author": "somebody"})))


def write_header_that_is_a_list(path):
    with path.open("wb") as stream:
        np.savez(stream, header=np.array("[1, 2]"))


def write_header_alone(path):
    with path.open("wb") as stream:
        np.savez(stream, header=np.array(json.dumps({"format": storage.FORMAT})))


def make_folder(path):
    path.mkdir()


@pytest.mark.parametrize(
    "write",
    [write_text, write_nothing, write_array, write_pickle, write_other_npz, write_wrong_header, write_short_header,
     write_header_that_is_a_list, write_header_alone, make_folder],
)  # fmt: skip
def test_other_files_are_refused_in_one_sentence(write, tmp_path):
    path = tmp_path / "other.npz"
    write(path)
    with pytest.raises(ValueError, match=r"other.npz is .*not a (result saved by|whole result of) mjslq") as caught:
        mjslq.load(path)
    one_sentence(caught, path)


@pytest.mark.parametrize("kept", [0.1, 0.5, 0.9, 0.99])
def test_truncated_files_are_refused(kept, tmp_path):
    path = tmp_path / "one.npz"
    sample().save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(ValueError, match="not a result saved by mjslq") as caught:
        mjslq.load(path)
    one_sentence(caught, path)


def test_damaged_files_are_refused(tmp_path):
    """Wherever a stretch of it was overwritten, a file loads as it was or is refused."""
    path = tmp_path / "one.npz"
    before = sample()
    before.save(path)
    whole, refused = path.read_bytes(), 0
    for start in range(0, len(whole) - 8, len(whole) // 60):
        path.write_bytes(whole[:start] + b"\xff" * 8 + whole[start + 8 :])
        try:
            assert_same(mjslq.load(path), before)
        except ValueError as error:
            assert "\n" not in str(error) and "one.npz" in str(error)
            refused += 1
    assert refused > 30


def test_files_of_a_later_version_ask_for_an_upgrade(tmp_path, monkeypatch):
    path = tmp_path / "one.npz"
    with monkeypatch.context() as later:
        later.setattr(storage, "FORMAT", 99)
        sample().save(path)
    with pytest.raises(ValueError, match=r"one.npz has format 99, .* reads format \d+; upgrade mjslq") as caught:
        mjslq.load(path)
    one_sentence(caught, path)


def test_files_of_an_earlier_version_are_to_be_made_anew(tmp_path, monkeypatch):
    path = tmp_path / "one.npz"
    with monkeypatch.context() as earlier:
        earlier.setattr(storage, "FORMAT", 1)
        sample().save(path)
    with pytest.raises(
        ValueError, match=r"one.npz has format 1, .* reads format \d+; solve the problem again"
    ) as caught:
        mjslq.load(path)
    one_sentence(caught, path)


@pytest.mark.parametrize("field", ["message", "gains", "trajectory_X", "lower", "iterates_dt", "names"])
def test_files_that_lack_something_name_it(field, tmp_path):
    """Gains may be missing, for there are methods without; nothing else."""
    path = tmp_path / "one.npz"
    sample().save(path)
    with np.load(path) as data:
        arrays = dict(data)
    if field in arrays:
        del arrays[field]
    else:
        header = json.loads(str(arrays["header"]))
        del header[field]
        arrays["header"] = np.array(json.dumps(header))
    with path.open("wb") as stream:
        np.savez(stream, **arrays)
    if field == "gains":
        assert mjslq.load(path).gains is None
        return
    with pytest.raises(ValueError, match=f"one.npz is not a whole result of mjslq: '{field}' is missing") as caught:
        mjslq.load(path)
    one_sentence(caught, path)


def test_errors_of_the_program_are_not_taken_for_a_foreign_file(tmp_path, monkeypatch):
    path = tmp_path / "one.npz"
    sample().save(path)

    def broken(**fields):
        raise TypeError("of the program")

    monkeypatch.setattr(storage, "Result", broken)
    with pytest.raises(TypeError, match="of the program"):
        mjslq.load(path)


# No pickle


class Trap:
    """Would leave a trace if it were unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (self.path,)


@pytest.mark.parametrize("where", ["header", "gains", "trajectory_X"])
def test_nothing_is_ever_unpickled(where, tmp_path):
    path, trace = tmp_path / "one.npz", tmp_path / "trace"
    sample().save(path)
    with np.load(path) as data:
        arrays = dict(data)
    arrays[where] = np.array([Trap(str(trace))], dtype=object)
    with path.open("wb") as stream:
        np.savez(stream, **arrays)
    with pytest.raises(ValueError, match="not a result saved by mjslq"):
        mjslq.load(path)
    assert not trace.exists()


def test_nothing_is_ever_pickled(tmp_path):
    path = tmp_path / "one.npz"
    sample(options={"callback": print}).save(path)  # kept by its text
    with np.load(path, allow_pickle=False) as data:
        assert all(data[name].dtype != object for name in data.files)
    assert "print" in mjslq.load(path).options["callback"]


def test_states_between_knots_survive(tmp_path):
    pendulum = """<mujoco><option timestep="0.01"/><worldbody><body><joint name="hinge" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03"/></body></worldbody>
    <actuator><motor joint="hinge" ctrlrange="-1 1"/></actuator></mujoco>"""
    dynamics = mjslq.MujocoDynamics.from_xml(pendulum, substeps=3)
    terms = [mjslq.costs.Control(0.1), mjslq.costs.State(10.0, [0.3, 0.0], "terminal")]
    result = mjslq.solve(mjslq.Problem(dynamics, 8, [0.0, 0.0], terms))
    result.save(tmp_path / "r.npz")
    loaded = mjslq.load(tmp_path / "r.npz")
    assert loaded.trajectory.substates.shape == (8, 2, 2)
    np.testing.assert_array_equal(loaded.trajectory.substates, result.trajectory.substates)
    assert loaded.trajectory.dt[0] == pytest.approx(0.03)
