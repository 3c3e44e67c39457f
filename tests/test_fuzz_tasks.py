"""Task files at random: every one is read, or refused in one sentence. Nothing else is raised, nothing hangs."""

import copy
import datetime
import json
import warnings

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wrong_inputs import ARM, one_sentence

from mjslq import load_task
from mjslq.tasks.lines import lines_of
from mjslq.tasks.reading import TaskError, parse

TASK = {
    "model": "arm.xml",
    "name": "reach",
    "horizon": 10,
    "engine": {"timestep": 0.01, "substeps": 2, "integrator": "implicitfast", "threads": 1},
    "start": {"keyframe": "home", "positions": {"j": 0.1}, "velocities": {"j": 0.0}, "controls": [0.5]},
    "costs": [
        {"kind": "control", "weight": {"m": 0.1}, "target": 0.0},
        {
            "kind": "state",
            "weight": 1.0,
            "target": "start",
            "when": {"from": 2, "to": 4},
            "loss": "huber",
            "width": 0.1,
        },
        {"kind": "joints", "target": {"j": 1.0}, "weight": 1.0, "when": "always", "terminal_weight": 5.0},
        {"kind": "velocities", "weight": 0.1, "when": [1, 2]},
        {"kind": "sensor", "name": "hand", "target": [0.1, 0.0, 0.2], "weight": [1.0, 1.0, 2.0], "when": "terminal"},
        {"kind": "frame", "name": "tip", "of": "orientation", "target": [1.0, 0.0, 0.0, 0.0], "weight": 1.0},
    ],
    "constraints": [
        {"kind": "joints", "limits": "model", "margin": 0.001},
        {"kind": "control", "limits": {"m": [-1.0, 1.0]}, "name": "effort"},
        {"kind": "sensor", "sensor": "hand", "upper": [1.0, 1.0, 1.0]},
        {"kind": "distance", "between": ["ball", "crate"], "lower": 0.01},
    ],
    "bounds": {"u": {"m": [-1.5, 1.5]}},
    "solve": {"method": "constrained", "max_iterations": 5, "tol": 1e-3},
}
"""A task with something of everything."""

NUMBERS = st.sampled_from([-1, 0, 1, 3, 11, 10**20, -0.5, 0.0, 0.02, 1.5, 1e300, float("nan"), float("inf")])
WORDS = st.sampled_from(["", "j", "m", "hand", "tip", "always", "model", "start", "slq", "huber", "Euler", "ü", "a\nb"])
LEAVES = st.one_of(NUMBERS, WORDS, st.booleans(), st.just(datetime.date(2020, 1, 1)), st.text(max_size=5))
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(WORDS | st.text(max_size=3), inner, max_size=3),
    max_leaves=6,
)


def toml(value):
    """A value as TOML writes it, tables in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, bool):
        return str(value).lower()
    return value.isoformat() if isinstance(value, datetime.date) else repr(value)


def written(task):
    """The text of a task file, with a line for each key at the top."""
    return "".join(f"{json.dumps(key)} = {toml(value)}\n" for key, value in task.items())


def places(value, path=()):
    """All keys and indices of a nested table."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, entry in entries:
        yield (*path, key)
        yield from places(entry, (*path, key))


@st.composite
def spoiled(draw):
    """The task with some keys taken out, called something else, or with another value."""
    task = copy.deepcopy(TASK)
    for _ in range(draw(st.integers(1, 3))):
        *path, last = draw(st.sampled_from(list(places(task)) or [("model",)]))
        owner = task
        for key in path:
            owner = owner[key]
        change = draw(st.sampled_from(["delete", "rename", "replace", "replace"]))
        if change == "replace" or isinstance(owner, list):
            owner[last] = draw(VALUES)
        elif last in owner:
            value = owner.pop(last)
            if change == "rename":
                owner[draw(WORDS | st.text(max_size=4))] = value
    return written(task)


@st.composite
def scribbled(draw):
    """The text of the task with letters taken out, put in, or lines moved."""
    text = written(TASK).replace("\n", "\n\n")
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(text)))
        until = min(len(text), at + draw(st.integers(0, 5)))
        text = text[:at] + draw(st.text(alphabet="[]{}=\"'#,.\n 0a\\ü\0", max_size=3)) + text[until:]
    return text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("fuzz")
    (place / "arm.xml").write_text(ARM)
    return place


def read_or_refused(text, folder):
    """Load a task file; the problem, or None where it was refused in one sentence."""
    file = folder / "task.toml"
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MuJoCo's compiler has its own words about odd names
            return load_task(file).problem
    except TaskError as error:
        one_sentence(str(error), "task.toml")
        return None


def test_the_task_itself_is_read(folder):
    problem = read_or_refused(written(TASK), folder)
    assert problem.horizon == 10 and len(problem.costs) == 6 and len(problem.constraints) == 4


@settings(max_examples=150)
@given(text=spoiled())
def test_spoiled_tasks(text, folder):
    problem = read_or_refused(text, folder)
    assert problem is None or problem.rollout(problem.U0).horizon == problem.horizon


@settings(max_examples=100)
@given(text=scribbled() | st.text())
def test_scribbled_tasks(text, folder):
    read_or_refused(text, folder)


@settings(max_examples=100)
@given(text=st.text(alphabet="[]{}=\"'#,.\n a1\\", max_size=40))
def test_lines_are_found_or_not_in_any_text(text):
    lines = lines_of(text)
    assert all(1 <= number <= len(text.splitlines()) for number in lines.values())
    with pytest.raises(TaskError) as caught:
        parse(text)
    one_sentence(str(caught.value))
