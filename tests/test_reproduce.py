"""`reproduce` tells the truth: its verdicts follow from the two numbers beside them."""

import subprocess
import sys
from types import SimpleNamespace

import pytest

from mjslq import Status
from mjslq.reports import reproduce


@pytest.fixture(scope="module")
def slq_rows():
    return list(reproduce.slq())


def test_table_1_is_reproduced_or_beaten(slq_rows):
    rows = [row for row in slq_rows if row.what.startswith("Table 1")]
    assert [row.paper for row in rows] == ["9", "20", "21", "35", "none in 300"]
    assert all(row.verdict.startswith("reproduced") for row in rows[:4])
    assert rows[4].verdict == "the paper's method fails here, ours converges"
    assert not any("another minimum" in row.ours for row in rows)


def test_every_row_holds_both_numbers(slq_rows):
    assert all(row.what and row.paper and row.ours and row.verdict for row in slq_rows)
    assert any("alpha = 1e-06" in row.what and "ours converges" in row.verdict for row in slq_rows)


@pytest.mark.parametrize(
    "iterations, success, reported, verdict",
    [
        (20, True, 20, "reproduced"),
        (10, True, 20, "reproduced, in fewer"),
        (25, True, 20, "differs: 5 more"),
        (300, False, 20, "not reached"),
        (30, True, None, "the paper's method fails here, ours converges"),
        (300, False, None, "the paper fails here, and so does ours"),
    ],
)
def test_verdicts_say_what_the_numbers_say(iterations, success, reported, verdict):
    status = Status.CONVERGED if success else Status.MAX_ITERATIONS
    result = SimpleNamespace(iterations=iterations, success=success, status=status)
    assert reproduce._iterations("x", result, reported, "").verdict == verdict


def test_table_i_of_the_trust_region_paper():
    *rows, end = reproduce.trust_region()
    assert len(rows) == 6
    assert all(row.verdict.startswith("same radius, same decision") for row in rows)
    assert "J 4.392865" in end.ours and end.verdict.startswith("converged")


def test_figure_2_shows_the_three_methods(tmp_path):
    reproduce.figure_2(tmp_path / "figure.svg")
    text = (tmp_path / "figure.svg").read_text()
    assert all(method in text for method in ("slq", "newton", "gradient"))


def test_unknown_papers_are_named():
    command = [sys.executable, "-m", "mjslq.cli", "reproduce", "slk"]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert outcome.returncode == 2
    assert "unknown paper 'slk'; there are: slq, trust-region" in outcome.stderr
