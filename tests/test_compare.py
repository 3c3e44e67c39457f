"""Methods side by side: the table's numbers are the results' own, and the plot shows them."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from constrained_problems import bryson_denham

from mjslq import problems
from mjslq.method_table import METHODS
from mjslq.reports import convergence
from mjslq.reports.compare import compare, plot


@pytest.fixture(scope="module")
def entries():
    return list(compare(problems.get("drag_particle", beta=0.01, horizon=50), max_iterations=30))


def test_every_method_starts_at_the_same_point(entries):
    made_for_it = [name for name, of in METHODS.items() if not of.takes_constraints or of.takes_both]
    assert [entry.method for entry in entries] == made_for_it
    assert len({entry.result.log[0].cost for entry in entries}) == 1


def test_entries_tell_what_the_log_holds(entries):
    for entry in entries:
        log = entry.result.log
        assert len(convergence.costs(log)) == len(convergence.seconds(log)) == len(log)
        assert (np.diff(convergence.seconds(log)) >= 0.0).all()
        assert entry.evaluations >= entry.result.iterations


def test_problems_with_constraints_are_solved_by_the_methods_that_take_them():
    assert [entry.method for entry in compare(bryson_denham(10))] == ["constrained", "square-root-sweep"]


def test_methods_can_be_chosen():
    (entry,) = compare(problems.get("hopper", height=1.0), ["slq"], max_iterations=2)
    assert entry.method == "slq" and entry.result.iterations == 2
    with pytest.raises(ValueError, match="unknown method 'sql'"):
        list(compare(problems.get("hopper"), ["sql"]))


def test_plot_names_every_method(entries, tmp_path):
    plot(entries, tmp_path / "costs.svg", "drag")
    text = (tmp_path / "costs.svg").read_text()
    ElementTree.fromstring(text)
    assert "iteration" in text and "time" in text
    for entry in entries:
        assert entry.method in text
    plot(entries, tmp_path / "costs.png")
    assert (tmp_path / "costs.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "name, said", [("costs.gif", "there are: .png, .svg, .pdf"), ("no/such/costs.png", "cannot write")]
)
def test_plots_that_cannot_be_written(name, said, entries, tmp_path):
    with pytest.raises(ValueError, match=said):
        plot(entries, tmp_path / name)
