"""Signals by name, and what plots draw of them: values, limits, bars, results of different lengths, two units."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mjslq
from mjslq.reports.units import model_from_mjb, sensor_kinds
from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.viewer import drawing
from mjslq.viewer.drawing import Shown
from mjslq.viewer.signals import Registry


def shown(result: Result, color: str = "", label: str = "") -> Shown:
    model = None if result.scene is None else model_from_mjb(result.scene.model)
    return Shown(result, result.trajectory, Registry(result, model), color, label)


@pytest.fixture(scope="module")
def solved() -> Result:
    return mjslq.solve(mjslq.problems.get("bryson_denham", horizon=20))


def test_signals_have_names_units_and_groups(arm: Result) -> None:
    registry = shown(arm).registry
    assert list(registry.groups) == ["States: positions [rad]", "States: velocities [rad/s]", "Controls: torques [Nm]"]
    assert registry.first == ["States: positions [rad]", "Controls: torques [Nm]"]
    assert next(iter(registry.signals)) == "shoulder \u00b7 positions [rad]"
    assert registry.signals["elbow \u00b7 torques [Nm]"].unit == "Nm"


def test_what_belongs_to_the_result_is_there_by_name(solved: Result) -> None:
    signals = shown(solved).registry.signals
    assert solved.violations and {f"{name} \u00b7 violations" for name in solved.violations} <= set(signals)
    assert {f"{name} \u00b7 multipliers" for name in solved.knots} <= set(signals)
    for wanted, values in (("costates", solved.costates), ("gradient", solved.gradient)):
        assert values is not None
        found = [signal for signal in signals.values() if signal.group.kind == wanted]
        assert len(found) == values.shape[1]
    assert "Control, running \u00b7 residuals" in signals


def test_sensors_have_units_by_their_type() -> None:
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><body name="b"><joint name="h"/><geom size=".1"/><site name="s"/>
      <body><joint name="p" type="slide"/><geom size=".1"/></body></body></worldbody>
      <sensor><jointpos joint="h"/><jointvel joint="p"/><framepos objtype="body" objname="b"/><gyro site="s"/>
        <clock/></sensor></mujoco>""")
    assert [unit for _, unit in sensor_kinds(model)] == ["rad", "m/s", "m", "m", "m", "rad/s", "rad/s", "rad/s", ""]


def test_equal_names_stay_apart(function: Result) -> None:
    twins = dataclasses.replace(function, names={"controls": ("motor", "motor")})
    names = list(shown(twins).registry.signals)
    assert names[-2:] == ["motor \u00b7 controls", "motor (2) \u00b7 controls"]


@given(st.floats(0.0, 1.0))
def test_drawn_values_are_the_trajectorys(share: float) -> None:
    """A state is interpolated, a control held, also where they share a plot."""
    rng = np.random.default_rng(3)
    trajectory = Trajectory(rng.normal(size=(8, 1)), rng.normal(size=(7, 1)), dt=rng.uniform(0.1, 0.5, size=7))
    result = dataclasses.replace(plain(), trajectory=trajectory, **unlimited(7))
    drawn = drawing.draw([shown(result)], ["x[0] \u00b7 states", "u[0] \u00b7 controls"])
    t = share * trajectory.times[-1]
    assert np.interp(t, drawn.x, drawn.columns[:, 0]) == pytest.approx(
        np.interp(t, trajectory.times, trajectory.X[:, 0])
    )
    step = min(int(np.searchsorted(trajectory.times, t, side="right")) - 1, 6)
    if np.abs(trajectory.times - t).min() > 1e-9:
        assert np.interp(t, drawn.x, drawn.columns[:, 1]) == pytest.approx(trajectory.U[step, 0])


def test_limits_are_lines_and_bars(arm: Result) -> None:
    drawn = drawing.draw([shown(arm)], ["shoulder \u00b7 torques [Nm]", "elbow \u00b7 torques [Nm]"])
    assert drawn.columns.shape == (200, 5) and drawn.bars == 1  # two curves, two lines, one bar
    assert (drawn.columns[:, 2] == 1.5).all() and (drawn.columns[:, 3] == -1.5).all()
    foot, top = drawn.styles[4]["fillTo"], drawn.columns[:, 4]
    at_limit = drawn.columns[:, 0] >= 1.5 - 1.5e-3
    np.testing.assert_array_equal(top > foot, at_limit)
    assert drawn.ranges[0][0] <= foot and top.max() < drawn.columns[:, :2].min() and drawn.ranges[0][1] > 1.5


def test_joints_at_the_ends_of_their_ranges_are_marked(arm: Result) -> None:
    assert arm.scene is not None
    model = model_from_mjb(arm.scene.model)
    model.jnt_limited[0], model.jnt_range[0] = True, (-0.5, 0.8)
    drawn = drawing.draw([Shown(arm, arm.trajectory, Registry(arm, model))], ["shoulder \u00b7 positions [rad]"])
    assert sorted(drawn.columns[0, 1:3]) == [-0.5, 0.8] and drawn.bars == 1
    q = arm.trajectory.X[:, 0]
    np.testing.assert_array_equal(
        drawn.columns[:, 3] > drawn.styles[3]["fillTo"], (q >= 0.8 - 1.3e-3) | (q <= -0.5 + 1.3e-3)
    )


def test_shorter_results_end_where_they_end(function: Result) -> None:
    t = function.trajectory
    short = dataclasses.replace(function, trajectory=Trajectory(t.X[:21], t.U[:20], dt=0.05), **unlimited(20))
    names = ["x[0] \u00b7 states", "u[0] \u00b7 controls"]
    drawn = drawing.draw([shown(function, "#111111", "long"), shown(short, "#222222", "short")], names)
    long_x, short_x, long_u, short_u = drawn.columns[:, :4].T
    assert drawn.x[-1] == pytest.approx(2.0) and np.isfinite(long_x).all() and np.isfinite(long_u).all()
    for column in (short_x, short_u):
        inside = np.abs(drawn.x - 1.0) > 1e-9  # there, a control has ended and a state has not
        np.testing.assert_array_equal(np.isfinite(column[inside]), drawn.x[inside] < 1.0)
    assert np.interp(0.5, drawn.x, short_x) == pytest.approx(t.X[10, 0])
    assert [style["stroke"] for style in drawn.styles[:4]] == ["#111111", "#222222"] * 2
    assert drawn.styles[0].get("dash") != drawn.styles[2].get("dash")  # colour tells the result, the dash the signal


def test_two_units_have_an_axis_each(arm: Result) -> None:
    names = ["shoulder \u00b7 positions [rad]", "shoulder \u00b7 torques [Nm]", "elbow \u00b7 torques [Nm]"]
    drawn = drawing.draw([shown(arm)], names)
    assert drawn.units == ("rad", "Nm") and len(drawn.ranges) == 2
    assert [style["scale"] for style in drawn.styles[:3]] == ["y", "y2", "y2"]


def test_nothing_chosen_and_nothing_finite_can_be_drawn(function: Result) -> None:
    assert drawing.draw([shown(function)], []).lines == ()
    lost = Trajectory(np.full_like(function.trajectory.X, np.nan), function.trajectory.U, dt=0.04, diverged_at=0)
    one = dataclasses.replace(shown(function), trajectory=lost)
    drawn = drawing.draw([one], ["x[0] \u00b7 states", "u[0] \u00b7 controls"])
    assert np.isfinite(drawn.ranges).all()


def test_residual_sizes_are_those_of_the_cost() -> None:
    problem = mjslq.Problem(
        mjslq.FunctionDynamics(lambda x, u: x + 0.1 * np.array([x[1], u[0]]), 2, 1, 0.1), 5, [1.0, 0.0],
        [mjslq.costs.State(2.0, [0.5, 0.0]), mjslq.costs.Control(1.0), mjslq.costs.State(3.0, when="terminal")],
    )  # fmt: skip
    result = mjslq.solve(problem)
    along, controls, end = result.residuals.values()
    assert 0.1 * 0.5 * 2.0 * np.nansum(along**2) == pytest.approx(result.cost_terms["State, running"])
    assert 0.1 * 0.5 * np.nansum(controls**2) == pytest.approx(result.cost_terms["Control, running"])
    assert np.isnan(end[:-1]).all() and 1.5 * end[-1] ** 2 == pytest.approx(result.cost_terms["State, terminal"])


def test_costates_are_the_slopes_by_the_states(solved: Result) -> None:
    problem = mjslq.problems.get("van_der_pol", horizon=30)
    result = mjslq.solve(problem)
    assert result.costates is not None
    for i in range(2):
        away = 1e-6 * np.eye(2)[i]
        costs = [problem.cost(problem.at(problem.x0 + s * away).rollout(result.trajectory.U)) for s in (1.0, -1.0)]
        assert result.costates[0, i] == pytest.approx((costs[0] - costs[1]) / 2e-6, rel=1e-5, abs=1e-7)


def test_new_fields_survive_a_file_and_old_files_load(solved: Result, tmp_path) -> None:
    solved.save(tmp_path / "new.npz")
    loaded = mjslq.load(tmp_path / "new.npz")
    np.testing.assert_array_equal(loaded.costates, solved.costates)
    assert list(loaded.residuals) == list(solved.residuals)
    with np.load(tmp_path / "new.npz") as data:
        old = {name: data[name] for name in data.files if name != "costates" and not name.startswith("residuals/")}
    np.savez(tmp_path / "old.npz", **old)
    assert mjslq.load(tmp_path / "old.npz").costates is None
    assert Registry(mjslq.load(tmp_path / "old.npz")).groups


def plain() -> Result:
    trajectory = Trajectory(np.zeros((2, 1)), np.zeros((1, 1)))
    return Result(mjslq.Status.CONVERGED, "", 0.0, 0, 0.0, trajectory, None, **unlimited(1))


def unlimited(steps: int) -> dict[str, np.ndarray]:
    return {"lower": np.full((steps, 2), -np.inf), "upper": np.full((steps, 2), np.inf)}
