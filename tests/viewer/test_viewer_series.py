"""Groups of curves, their units, and what happens to them on the way to a plot."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mjslq.reports.units import model_from_mjb
from mjslq.result import Result
from mjslq.scene import Scene
from mjslq.trajectory import Trajectory
from mjslq.viewer import drawing, panels, series
from mjslq.viewer.playback import Playback


def test_groups_carry_names_and_units(arm: Result) -> None:
    assert arm.scene is not None
    model = model_from_mjb(arm.scene.model)
    states = series.groups(arm, "states", model)
    assert [group.title for group in states] == ["positions [rad]", "velocities [rad/s]"]
    assert states[1].labels == ("shoulder rate", "elbow rate") and states[1].columns == (2, 3)
    assert [group.title for group in series.groups(arm, "controls", model)] == ["torques [Nm]"]
    assert series.groups(arm, "outputs", model) == []


def test_groups_without_a_model_have_no_units(function: Result) -> None:
    (group,) = series.groups(function, "states")
    assert group.title == "states" and group.labels == ("x[0]", "x[1]", "x[2]", "x[3]") and group.unit == ""


def test_a_large_robot_is_split_so_that_it_can_be_read(function: Result) -> None:
    big = dataclasses.replace(function, trajectory=Trajectory(np.zeros((4, 70)), np.zeros((3, 20))))
    groups = series.groups(big, "states")
    assert [len(group.columns) for group in groups] == [8] * 8 + [6]
    assert groups[-1].title == "states, 65 to 70 of 70"


def test_free_joint_tells_metres_from_quaternions(function: Result) -> None:
    xml = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(xml)
    flying = dataclasses.replace(
        function, trajectory=Trajectory(np.zeros((4, 13)), np.zeros((3, 1))), scene=Scene(b"", tuple(range(7)))
    )
    found = {group.title: len(group.columns) for group in series.groups(flying, "states", model)}
    assert found == {"positions [m]": 3, "quaternions": 4, "velocities [m/s]": 3, "velocities [rad/s]": 3}


def test_controls_are_held_over_their_step(function: Result) -> None:
    (group,) = series.groups(function, "controls")
    times, values = series.curves(function.trajectory, group)
    np.testing.assert_allclose(times[:4], [0.0, 0.04, 0.04, 0.08])
    np.testing.assert_array_equal(values[0], values[1])
    np.testing.assert_array_equal(series.values_at(function.trajectory, group, 0.05), function.trajectory.U[1])


def test_diverged_curves_end_where_they_are_finite(function: Result) -> None:
    X = function.trajectory.X.copy()
    X[10:] = np.nan
    lost = Trajectory(X, function.trajectory.U, dt=0.04, diverged_at=10)
    for kind, length in (("states", 10), ("controls", 18)):
        (group,) = series.groups(function, kind)
        times, values = series.curves(lost, group)
        assert len(times) == length and np.isfinite(values).all()


def test_plots_of_controls_show_their_limits(arm: Result) -> None:
    (group,) = series.groups(arm, "controls")
    found = series.limits(arm, arm.trajectory, group)
    assert found is not None
    ((upper, first), (lower, second)) = found.lines()  # of the shoulder alone; the elbow has none
    assert (first, second) == (0, 0) and (upper == 1.5).all() and (lower == -1.5).all()
    assert not found.active[:, 1].any()
    np.testing.assert_array_equal(found.active[::2, 0], arm.trajectory.times[:-1] >= 1.5 - 1.5e-3)
    assert series.limits(arm, arm.trajectory, series.groups(arm, "states")[0]) is None


def test_limits_that_controls_share_are_one_line_and_far_ones_leave_the_axis_alone() -> None:
    shared = series.Limits(-np.ones((4, 3)), np.ones((4, 3)), np.zeros((4, 3), dtype=bool))
    assert [(line[0], curve) for line, curve in shared.lines()] == [(1.0, None), (-1.0, None)]
    values = np.array([[-0.5], [0.5]])
    near, far = np.full(2, 1.0), np.full(2, 87.0)
    low, high = series.range_with_limits(values, [near, far])
    assert low < -0.5 and 1.0 < high < 2.0


def test_limits_follow_the_iterate_shown(arm: Result) -> None:
    (group,) = series.groups(arm, "controls")
    early = Trajectory(arm.trajectory.X, 0.1 * arm.trajectory.U, dt=0.02)
    found = series.limits(arm, early, group)
    assert found is not None and not found.active.any()


def test_switches_survive_thinning() -> None:
    values, switches = np.zeros((5000, 1)), np.zeros((5000, 1), dtype=bool)
    switches[1001:1207] = True
    index = series.thinning(values, 100, switches)
    assert {1000, 1001, 1206, 1207} <= set(index.tolist())


def test_thinning_keeps_peaks() -> None:
    values = np.zeros((5000, 2))
    values[1234, 0], values[4321, 1] = 7.0, -3.0
    index = series.thinning(values, 300)
    assert len(index) <= 320 and (np.diff(index) > 0).all()
    assert values[index].max() == 7.0 and values[index].min() == -3.0


@pytest.mark.parametrize("values", [np.array([2.0, 2.0]), np.zeros(3), np.array([np.nan]), np.array([-1.0, 5.0])])
def test_axis_limits_are_never_empty(values: np.ndarray) -> None:
    low, high = series.value_range(values)
    assert low < high and np.isfinite([low, high]).all()


@pytest.mark.parametrize("at", [0.0, 0.5, 1.0, 1.7, 2.0])
def test_mark_rises_at_its_place_and_leaves_the_curves_alone(at: float) -> None:
    x, y = np.array([0.0, 1.0, 2.0]), np.array([[0.0], [3.0], [4.0]])
    times, curve, mark = drawing.with_mark(x, y, at, (-1.0, 5.0))
    assert (np.diff(times) >= 0).all() and times[np.argmax(mark)] == at
    assert mark.max() == 5.0 and np.count_nonzero(mark > -1.0) == 1
    np.testing.assert_allclose(curve, np.interp(times, x, y[:, 0]))


def test_playback_runs_rests_and_starts_over() -> None:
    clock = Playback(1.0, playing=True, speed=2.0, rest=0.5)
    assert clock.elapse(0.25) and clock.time == 0.5
    assert clock.elapse(9.0) and clock.time == 1.0
    assert not clock.elapse(0.3) and clock.time == 1.0
    assert clock.elapse(0.3) and clock.time == 0.0 and clock.playing


def test_playback_without_loop_stops_at_the_end_and_plays_again() -> None:
    clock = Playback(1.0, playing=True, loop=False)
    clock.elapse(2.0)
    clock.elapse(0.1)
    assert clock.time == 1.0 and not clock.playing
    clock.toggle()
    assert clock.time == 0.0 and clock.playing


def test_seeking_pauses_and_stays_inside() -> None:
    clock = Playback(1.0, playing=True)
    clock.seek(7.0)
    assert clock.time == 1.0 and not clock.playing and not clock.elapse(1.0)
    clock.seek(-1.0)
    assert clock.time == 0.0


def test_summary_escapes_what_it_is_told(function: Result) -> None:
    text = panels.summary(function)
    assert "a &lt;b&gt; &amp; c" in text and "max iterations" in text and function.message[:20] in text
