"""Which constraints are in force: in summaries, in JSON, in files, and in plots."""

import dataclasses

import numpy as np
import pytest
from constrained_problems import bryson_denham

import mjslq
from mjslq import solve
from mjslq.reports import in_force
from mjslq.reports.tables import as_dict, print_summary
from mjslq.viewer import panels, series
from mjslq.viewer.drawing import Shown, draw
from mjslq.viewer.signals import Registry


@pytest.fixture(scope="module")
def result():
    return solve(bryson_denham())


def test_names_knots_and_multipliers(result):
    wall, goal = in_force.in_force(result)
    assert wall.name == "wall" and goal.name == "goal" and goal.knots == (50,)
    values = result.multipliers["wall"][:, 0]
    assert wall.knots == tuple(np.flatnonzero(values)) and wall.largest == values.max() > 0.0
    assert goal.largest == result.multipliers["goal"][0, np.abs(result.multipliers["goal"][0]).argmax()]
    assert str(goal) == f"goal at knot 50 (multiplier {goal.largest:.3g})"
    assert len(in_force.multipliers(result)["wall"]) == 51 and in_force.touching(result)["goal"].sum() == 1


def test_runs_of_knots():
    told = in_force.InForce("wall", (1, 2, 3, 7, 9, 10), -2.0)
    assert str(told) == "wall at knots 1-3, 7, 9-10 (multiplier -2)"
    scattered = in_force.InForce("wall", tuple(range(0, 20, 2)), 1.0)
    assert str(scattered) == "wall at 10 knots from 0 to 18 (multiplier 1)"


def test_summary_and_json(result, capsys):
    print_summary(result, bryson_denham())
    told = " ".join(capsys.readouterr().out.split())
    assert "constraints wall at knots" in told and "goal at knot 50" in told and "largest violation" in told
    assert [entry["name"] for entry in as_dict(result)["constraints"]] == ["wall", "goal"]
    loose = dataclasses.replace(result, multipliers={})
    assert "none in force" in in_force.describe(loose) and as_dict(loose)["constraints"] == []
    assert in_force.describe(dataclasses.replace(result, violations={})) == ""


def test_knots_are_kept_in_files(result, tmp_path):
    result.save(tmp_path / "result.npz")
    again = mjslq.load(tmp_path / "result.npz")
    assert in_force.in_force(again) == in_force.in_force(result)


def test_plots_of_multipliers_and_violations(result):
    multipliers, violations = series.groups(result, "constraints")
    assert multipliers.title == "multipliers" and multipliers.labels == ("wall", "goal")
    assert violations.title == "violations" and violations.labels == ("wall", "goal")
    times, values = series.curves(result.trajectory, multipliers)
    np.testing.assert_array_equal(times, result.trajectory.times)
    np.testing.assert_array_equal(values[:, 0], in_force.multipliers(result)["wall"])
    assert series.values_at(result.trajectory, multipliers, times[-1])[1] == values[-1, 1] != 0.0
    found = series.limits(result, result.trajectory, multipliers)
    assert found is not None and found.lines() == []
    np.testing.assert_array_equal(found.active, values != 0.0)
    registry = Registry(result)
    drawn = draw([Shown(result, result.trajectory, registry)], registry.groups["Constraints: multipliers"])
    assert drawn.bars == 2 and drawn.ranges[0][0] < values.min()
    assert dict(panels.facts(result))["in force"].startswith("wall at knots")
    iterations, worst = series.violations(result.log)
    assert len(iterations) == len(result.log) and worst[-1] == result.constraint_violation


def test_results_without_constraints_have_no_such_plots():
    free = solve(mjslq.problems.get("drag_particle"))
    assert series.groups(free, "constraints") == [] and "in force" not in dict(panels.facts(free))
