"""`mjslq reproduce gopronto` and the bench of the train: rows, figures, and how growth is told."""

import itertools

import numpy as np
import pytest

from mjslq.lq.riccati import solve as sweep
from mjslq.reports import bench, figures, qp_solvers, reproduce, sforni, train


def test_the_theorem_is_reproduced():
    stationary, growth = sforni.theorem()
    assert stationary.verdict == growth.verdict == "reproduced"
    assert float(stationary.ours) < 1e-9


def test_methods_converge_as_the_paper_says():
    rows = {row.what: row for row in sforni.convergence_of_methods()}
    assert set(sforni.METHODS) < set(rows)
    assert not any(row.verdict.startswith("differs") for row in rows.values())
    assert rows["gradient method, open loop"].verdict == "reproduced: it fails"
    cost = sforni.solved("PRONTO, Newton").cost
    for name, most in (("PRONTO, Gauss-Newton", 10), ("GoPRONTO, conjugate", 200), ("GoPRONTO, gradient", 600)):
        result = sforni.solved(name)
        assert result.success and result.iterations <= most and result.cost == pytest.approx(cost, rel=1e-8)


def test_momentum_is_faster_than_the_gradient_with_fixed_steps():
    assert [row.verdict for row in sforni.momentum()] == ["-", "reproduced", "reproduced"]


def test_figures_are_drawn(tmp_path):
    assert set(reproduce.FIGURES["gopronto"]) == {"figures-5-to-7", "figures-4-and-8", "growth"}
    figures.save(sforni.figure_5(), tmp_path / "five.svg")
    text = (tmp_path / "five.svg").read_text()
    assert "fixed steps" in text and "quasi-Newton" in text
    figures.save(sforni.figure_8(), tmp_path / "eight.png")
    assert (tmp_path / "eight.png").read_bytes().startswith(b"\x89PNG")


def test_growth_is_the_power_of_a_line_through_logarithms():
    assert train.exponent({carts: 3.0 * carts**1.7 for carts in (2, 20, 50, 200)}) == pytest.approx(1.7)
    assert set(train.GROWTH) < set(bench.GROWTH)


@pytest.mark.parametrize("method", train.METHODS)
def test_an_iteration_takes_time(method, monkeypatch):
    monkeypatch.setattr(train, "HORIZON", 20)
    assert train.milliseconds(method, 1, iterations=2) > 0.0


@pytest.mark.slow
def test_every_row_of_the_paper_comes_out():
    rows = list(sforni.rows())
    sections = [section for section, _ in itertools.groupby(rows, key=lambda row: row.section)]
    assert len(sections) == 8 and not any(row.verdict.startswith("differs") for row in rows)


@pytest.mark.slow
def test_first_order_iterations_are_cheap_and_small():
    """Fifty carts: at least ten times cheaper than an LQ iteration. Two hundred: a quarter of the memory at most."""
    ratio = train.milliseconds("slq", 50) / train.milliseconds("gopronto", 50)
    assert ratio > 10.0
    assert train.exponent(train.growth("gopronto")) < 2.0
    small, large = (train.peak_memory("slq", 100, horizon) for horizon in (50, 100))
    ours = train.peak_memory("gopronto", 100, 400)
    assert ours < 0.25 * (large + 6.0 * (large - small))  # at 400 steps


def test_costs_of_figures_are_finite():
    assert np.isfinite([entry.cost for entry in sforni.solved("GoPRONTO, gradient").log]).all()


# QP solvers


@pytest.mark.parametrize("form", qp_solvers.FORMS)
def test_both_forms_are_the_lq_problem(form):
    """Their own optimality conditions, solved densely, give the sweep's controls over a short horizon."""
    lq = qp_solvers.first_problem(2, 30)
    P, q, A, b, controls = qp_solvers.FORMS[form](lq)
    n, m = len(q), len(b)
    K = np.block([[P.toarray(), A.toarray().T], [A.toarray(), np.zeros((m, m))]])
    z = np.linalg.solve(K, np.concatenate([-q, b]))[:n]
    np.testing.assert_allclose(z[controls], sweep(lq).U.ravel(), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", qp_solvers.SOLVERS)
def test_solvers_that_are_installed_solve_the_short_problem(name):
    package, call = qp_solvers.SOLVERS[name]
    pytest.importorskip(package)
    lq = qp_solvers.first_problem(2, 30)
    for make in qp_solvers.FORMS.values():
        given = make(lq)
        np.testing.assert_allclose(call(given)[given.controls], sweep(lq).U.ravel(), rtol=0, atol=1e-4)


def test_solvers_that_are_missing_are_named(monkeypatch):
    monkeypatch.setattr(qp_solvers, "SOLVERS", {"None such": ("no_such_solver", qp_solvers.by_osqp)})
    rows = list(qp_solvers.rows(((1, 10),)))
    assert [row.verdict for row in rows[1:]] == ["skipped: no_such_solver is not installed"] * 2
