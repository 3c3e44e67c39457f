"""Sweeps: ranges, points, tables, and the command as a user meets it."""

import csv
import subprocess
import sys

import pytest

import mjslq
from mjslq.batch import Solved
from mjslq.commands.common import read_value
from mjslq.reports import sweep


@pytest.mark.parametrize(
    "text, found",
    [
        ("1:50:5", list(range(1, 50, 5))),
        ("1:3", [1, 2, 3]),
        ("0:1:.25", [0.0, 0.25, 0.5, 0.75, 1.0]),
        ("0:.3:.1", [0.0, 0.1, 0.2, pytest.approx(0.3)]),
        ("3:1:-1", [3, 2, 1]),
        ("1,2.5,4", [1, 2.5, 4]),
        ("mujoco, function", ["mujoco", "function"]),
        ("7", [7]),
        ("true", [True]),
        ("[1, 2]", [[1, 2]]),
    ],
)
def test_values_of_a_setting(text, found):
    read = sweep.values("height", text, read_value)
    assert read == found and isinstance(read[0], type(found[0]))


@pytest.mark.parametrize("text", ["1:2:0", "2:1:1", "1:2:-1", "0:1:1e-9"])
def test_ranges_without_values_are_refused(text):
    with pytest.raises(ValueError, match=r"has no values: first:last:step"):
        sweep.values("height", text, read_value)


def test_ranges_of_texts_are_refused():
    with pytest.raises(ValueError, match="takes a range of numbers"):
        sweep.values("height", "1:tall:2", read_value)


def test_points_are_all_combinations():
    grid = sweep.points({"height": [1, 2], "stiffness": [10.0, 20.0, 30.0]})
    assert [point.values for point in grid][:2] == [
        {"height": 1, "stiffness": 10.0},
        {"height": 1, "stiffness": 20.0},
    ]
    assert len(grid) == 6 and len(sweep.points({})) == 1


def test_results_come_to_their_point_and_errors_are_told(tmp_path):
    grid = sweep.points({"height": [1, 2]})
    result = mjslq.solve(mjslq.problems.get("hopper", height=1.0))
    found = [Solved(i, "hopper", result) for i in (0, 3, 1)] + [Solved(2, "hopper", None, "Traceback\nOSError: gone\n")]
    sweep.gather(grid, iter(found), seeds=2)
    assert [len(point.solved) for point in grid] == [2, 2] and grid[1].endings == "1 error"
    sweep.write_csv(grid, tmp_path / "sweep.csv")
    rows = list(csv.DictReader((tmp_path / "sweep.csv").read_text().splitlines()))
    assert [row["index"] for row in rows] == ["0", "1", "2", "3"]
    assert [row["height"] for row in rows] == ["1", "1", "2", "2"]
    assert rows[2]["error"] == "OSError: gone" and float(rows[3]["cost"]) == result.cost
    assert sweep.summary(grid, "hopper").row_count == 2
    sweep.plot(grid, tmp_path / "sweep.svg", "hopper")
    assert (tmp_path / "sweep.svg").stat().st_size > 5000


def run(*arguments, cwd=None):
    command = [sys.executable, "-m", "mjslq.cli", "sweep", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=cwd)


def test_the_command_solves_resumes_and_says_so(tmp_path):
    options = ("-s", "height=1:2", "-s", "tol=1e-5", "--seeds", "2", "--executor", "threads")
    arguments = ("hopper", *options, "--out", "runs")
    first = run(*arguments, cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    assert "2 of 2" in first.stdout and "4/4" in first.stderr and "4 converged" in first.stderr
    files = sorted(path.name for path in (tmp_path / "runs").iterdir())
    assert files == [*(f"000{i}_hopper.npz" for i in range(4)), "sweep.csv", "sweep.png"]
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").glob("*.npz")}
    again = run(*arguments, "--quiet", cwd=tmp_path)
    assert (again.returncode, again.stdout) == (0, first.stdout)
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["hopper", "-s", "heigth=1:2"], "did you mean 'height'?"),
        (["hopper", "--executor", "cloud"], "there are: processes, threads, dask, ray"),
    ],
)
def test_wrong_input_is_answered_in_a_sentence(arguments, said):
    outcome = run(*arguments)
    assert outcome.returncode == 2 and outcome.stdout == "" and "Traceback" not in outcome.stderr
    assert said in outcome.stderr and len(outcome.stderr.strip().splitlines()) == 1
