"""`reproduce` tells the truth: its verdicts follow from the two numbers beside them."""

import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from mjslq import problems, solve
from mjslq.reports import fukushima_yamamoto, mcquade, reproduce, sideris_bobrow
from mjslq.reports.rows import verdict


def of(rows, what):
    return [row for row in rows if what in row.what]


@pytest.fixture(scope="module")
def table_1():
    return list(sideris_bobrow.table_1_slq())


def test_armijo_counts_are_those_computed_independently(table_1):
    rows = of(table_1, "Armijo")
    assert [row.paper for row in rows] == ["9", "20", "21", "35", "none in 300"]
    counts = [row.ours.split()[0] for row in rows]
    assert counts[:4] == ["9", "20", "26", "37"]
    assert rows[0].verdict == rows[1].verdict == "reproduced"
    assert rows[2].verdict.startswith("differs: 5 more") and rows[3].verdict.startswith("differs: 2 more")
    assert rows[4].verdict.startswith("differs: the paper's fails, ours converges")


def test_quadratic_fit_needs_no_more_than_the_paper(table_1):
    rows = of(table_1, "quadratic fit")
    counts = [int(row.ours.split()[0]) for row in rows]
    assert all(count <= reported for count, reported in zip(counts, (9, 20, 21, 35), strict=False))
    assert all(row.verdict.startswith("reproduced") for row in rows[:4])


def test_defaults_end_in_the_minimum_of_the_table_and_claim_nothing_for_the_paper(table_1):
    rows = of(table_1, "as it is here")
    assert len(rows) == 5 and not any("another minimum" in row.ours for row in rows)
    assert not any("reproduced" in row.verdict for row in rows)


def test_the_preset_is_algorithm_2_and_nothing_else():
    """U_{k+1} = U_k + alpha_k U_bar_k, U_bar_k the dense minimizer of the LQ problem: nothing is added."""
    problem = problems.get("drag_particle", beta=0.1, horizon=30)
    result = solve(problem, "slq", preset="sideris-bobrow", max_iterations=6, tol=0.0)
    assert len(result.iterates) == 7
    for now, after, entry in zip(result.iterates, result.iterates[1:], result.log, strict=False):
        change = after.U - now.U
        direction = _gauss_newton_direction(problem, now)
        np.testing.assert_allclose(change, entry.alpha * direction, rtol=1e-6, atol=1e-8 * np.abs(direction).max())
        assert entry.multiplier == 0.0 and 0.0 < entry.alpha <= 1.0


def _gauss_newton_direction(problem, trajectory):
    """-(G'WG)^-1 grad J with G = d(X, U)/dU, column by column (60)."""
    linearization = problem.dynamics.linearize(trajectory)
    A, B = linearization.A, linearization.B
    N, nx, nu = B.shape
    G = np.zeros((N + 1, nx, N * nu))
    for n in range(N):
        G[n + 1] = A[n] @ G[n]
        G[n + 1][:, n * nu : (n + 1) * nu] += B[n]
    Q, R, _, q, r = problem.expand(trajectory, linearization)
    H = sum(G[n].T @ Q[n] @ G[n] for n in range(N + 1))
    H[np.arange(N * nu), np.arange(N * nu)] += R[:, 0, 0]
    gradient = sum(G[n].T @ q[n] for n in range(N + 1)) + r.ravel()
    return -np.linalg.solve(H, gradient).reshape(N, nu)


def test_newton_rows_tell_every_modification():
    rows = list(sideris_bobrow.table_1_newton())
    newton = of(rows, "costates of J(U)")
    assert [row.paper for row in newton] == ["72", "123", "90", "none in 300", "none in 300"]
    assert all(name in row.ours for row in newton for name in ("multiplier", "blend", "stage"))
    assert all(row.verdict.startswith("fewer") for row in newton[:3])
    steps = of(rows, "against SLQ")
    assert len(steps) == 5
    for row in steps:
        smaller, count = (int(word.strip(";")) for word in row.ours.split() if word.strip(";").isdigit())
        assert smaller <= count
        assert ("not reproduced" in row.verdict) == (smaller <= 0.5 * count)


def test_hopper_heights_and_weights(monkeypatch):
    monkeypatch.setattr(sideris_bobrow, "HEIGHTS", (1.0, 5.0, 50.0))
    rows = list(sideris_bobrow.hopper_heights())
    ends = of(rows, "Algorithm 2")
    assert [row.paper for row in ends] == ["3", "3 to 166", "166", "increase"]
    assert ends[0].ours.startswith("4,") and ends[0].verdict == "differs: 1 more"
    assert ends[-1].verdict == "reproduced"
    monkeypatch.setattr(sideris_bobrow, "WEIGHTS", (1.0, 10.0, 100.0))
    *each, last, _ = sideris_bobrow.hopper_weights()
    assert [row.verdict for row in of(each, "Algorithm 2")] == ["the first", "fewer", "more, not fewer"]
    assert last.verdict.startswith("reproduced up to r = 10 only")


def test_smoothing(monkeypatch):
    monkeypatch.setattr(sideris_bobrow, "ALPHAS", (1e-4, 1e-6))
    first, second, third, fourth = sideris_bobrow.hopper_smoothing()
    assert (first.verdict, second.verdict) == ("reproduced", "converges, too")
    assert third.verdict == "differs: the paper's fails, ours converges"
    assert fourth.verdict == "the paper's fails, this one converges"


@pytest.mark.parametrize(
    "count, reported, faithful, said",
    [
        (20, 20, True, "reproduced"),
        (10, 20, True, "reproduced, in fewer"),
        (25, 20, True, "differs: 5 more"),
        (None, 20, True, "not reached"),
        (30, None, True, "differs: the paper's fails, ours converges"),
        (None, None, True, "the paper fails here, and so does ours"),
        (20, 20, False, "as many"),
        (10, 20, False, "fewer"),
        (25, 20, False, "5 more"),
        (30, None, False, "the paper's fails, this one converges"),
    ],
)
def test_verdicts_say_what_the_numbers_say(count, reported, faithful, said):
    assert verdict(count, reported, faithful=faithful) == said


def test_table_i_of_the_trust_region_paper():
    *rows, end = fukushima_yamamoto.rows()
    assert len(rows) == 6
    assert all(row.verdict.startswith("same radius, same decision") for row in rows)
    assert "J 4.392865" in end.ours and end.verdict.startswith("converged")


@pytest.fixture(scope="module")
def thesis():
    return list(mcquade.rows())


def test_the_thesis_examples_tell_what_the_method_reached(thesis):
    reproduced = [row.what for row in thesis if row.verdict.startswith("reproduced")]
    assert {"du(1)", "dx_1 at the three samples", "N = 17, threshold 1.3", "square-root-sweep"} <= set(reproduced)
    for row in of(thesis, "N = "):
        cost = float(row.ours.split()[2].rstrip(","))
        optimum = 4.488 if "17" in row.what else 4.4494
        assert cost > optimum - 1e-4
        assert ("stopped, not converged" in row.ours) == ("constrained" not in row.what)
        assert row.verdict.startswith("reproduced") == ("constrained" not in row.what and cost < 4.495)
    (first,) = of(thesis, "row of the cost off")
    assert first.verdict == "reproduced" and first.ours.startswith("J 2 -> 23.01")


def test_the_thesis_reentry_fails_and_succeeds_where_it_says(thesis):
    assert [row.verdict.split(":")[0] for row in thesis if "nominal trajectory, its" in row.section][:2] == (
        ["reproduced", "reproduced"]
    )
    (all_at_once,) = of(thesis, "all rows at once")
    assert all_at_once.ours.startswith("no step: rows contradict each other, linearized: 'attack' at 4 steps")
    first, second = of(thesis, "limit of the angle first, ")[:2]
    assert first.verdict == "reproduced" and first.ours.startswith("converged after 7: 5.0000 g")
    assert second.verdict == "not reached"
    (end,) = of(thesis, "end, beside the nominal one")
    assert end.verdict.startswith("differs") == (not end.ours.startswith("-"))
    later = [row for row in thesis if row.section.startswith("Section 5.5")]
    assert len(later) == 3
    assert all(row.verdict.startswith("differs") == row.ours.startswith("converged") for row in later)


@pytest.mark.parametrize(
    "paper, words",
    [("slq", ("position", "steepest descent", "stance")), ("trust-region", ()), ("square-root-sweep", ("altitude",))],
)
def test_figures_are_drawn_as_png_and_svg(paper, words, tmp_path):
    files = list(reproduce.draw(paper, tmp_path))
    assert {file.suffix for file in files} == {".png", ".svg"}
    assert len(files) == 2 * len(reproduce.FIGURES[paper]) and all(file.parent == tmp_path for file in files)
    texts = ""
    for file in files:
        if file.suffix == ".png":
            assert file.read_bytes().startswith(b"\x89PNG")
        else:
            ElementTree.fromstring(file.read_text())
            texts += file.read_text()
    assert all(word in texts for word in words)


def test_files_of_figures_begin_with_the_name_given(tmp_path):
    (file,) = reproduce.draw("trust-region", tmp_path / "fig.svg")
    assert file.name == "fig-trust-region-figure-1.svg" and file.exists()
    files = list(reproduce.draw("trust-region", tmp_path / "paper"))
    assert [file.name for file in files] == [f"paper-trust-region-figure-1.{end}" for end in ("png", "svg")]
    with pytest.raises(ValueError, match="cannot write"):
        list(reproduce.draw("trust-region", tmp_path / "nowhere" / "fig"))


def test_command_prints_rows_under_their_headings():
    command = [sys.executable, "-m", "mjslq.cli", "reproduce", "trust-region"]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    lines = outcome.stdout.splitlines()
    assert any(line.startswith("Table I, the first iterations") for line in lines)
    assert sum(line.startswith("iteration ") for line in lines) == 6


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["slk"], "unknown paper 'slk'; there are: slq, trust-region, square-root-sweep"),
        (["slq", "--plot", "no/such/fig"], "no folder"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_solved(arguments, said):
    command = [sys.executable, "-m", "mjslq.cli", "reproduce", *arguments]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert outcome.returncode == 2 and outcome.stdout == ""
    assert said in outcome.stderr and len(outcome.stderr.strip().splitlines()) == 1
