"""Methods side by side in the viewer: the curves are the logs' own costs, and the window opens with them."""

import numpy as np
import pytest

import mjslq
from mjslq.reports import convergence
from mjslq.viewer import Player, comparison


@pytest.fixture(scope="module")
def results():
    problem = mjslq.problems.get("van_der_pol", horizon=40)
    return [mjslq.solve(problem, method) for method in ("slq", "newton")]


def test_relative_costs_are_those_of_the_logs(results):
    curves = convergence.relative_costs([result.log for result in results])
    best = min(entry.cost for result in results for entry in result.log)
    for result, curve in zip(results, curves, strict=True):
        assert len(curve) == len(result.log)
        expected = (result.log[0].cost - best) / best
        assert curve[0] == pytest.approx(expected)
    assert curves[0][0] == curves[1][0]  # the same start
    assert any(np.isnan(curve).any() for curve in curves)  # the best has nothing left


def test_results_that_never_started_do_not_break_it(results):
    import dataclasses

    stillborn = dataclasses.replace(results[0], log=())
    assert [len(curve) for curve in convergence.relative_costs([results[0].log, stillborn.log])] == [
        len(results[0].log),
        0,
    ]


def test_player_opens_with_the_comparison(results, monkeypatch):
    drawn, add_plot = [], comparison.plots.add_plot

    def record(gui, x, values, labels, *rest, **more):
        drawn.append((x, values, labels))
        add_plot(gui, x, values, labels, *rest, **more)

    monkeypatch.setattr(comparison.plots, "add_plot", record)
    with Player(results[0], port=8171, autoplay=False, beside=results[1:]) as player:
        assert player.running
    for x, values, labels in drawn:  # against iterations, and against time
        assert labels == ("slq (converged)", "newton (converged)")
        assert values.shape == (len(x), 2) and (np.diff(x) > 0.0).all()
        assert np.isfinite(values).any(axis=0).all()
    assert len(drawn) == 2
