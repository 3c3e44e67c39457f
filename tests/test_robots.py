"""The robots' tasks: each in short from one start; from twenty, as the catalogue promises, when there is time."""

import json
import subprocess
import sys

import numpy as np
import pytest

import mjslq
from mjslq.problems import g1_clip, g1_motion
from mjslq.reports import robots

QUICK = ("quadrotor, 90 deg", "Panda, Pinocchio", "G1 reach", "Solo12 stand", "double pendulum")
WANTED = [name for name, case in robots.CASES.items() if case.wanted]


@pytest.mark.parametrize("name", QUICK)
def test_tasks_are_done_from_a_perturbed_start(name):
    row = robots.measure(name, 1)
    assert row.solved == 1 and row.violation == 0.0
    assert 0 < row.iterations[0] <= robots.CASES[name].most


@pytest.mark.slow
@pytest.mark.parametrize("name", WANTED)
def test_tasks_are_done_from_twenty_starts(name):
    row = robots.measure(name, 20)
    assert row.solved >= robots.CASES[name].wanted, row.as_dict()
    assert row.violation == 0.0 and len(row.done) == 20


def test_solo_leaves_the_floor_and_comes_down_on_its_feet():
    """With few iterations: the middle is up in the air, where no foot touches; the end is on the feet."""
    problem = mjslq.problems.get("solo12_jump")
    result = mjslq.solve(problem, "slq", max_iterations=40)
    X, model = result.trajectory.X, problem.dynamics.model
    assert X[50, 2] > problem.x0[2] + 0.15
    assert abs(X[-1, 2] - problem.x0[2]) < 0.03 and np.abs(X[-1, 4:7]).max() < 0.1
    from mjslq.dynamics.mujoco.contacts import penetration

    assert penetration(model, X[48:52]) == 0.0 and penetration(model, X[-5:]) > 0.0
    assert str(result.contact).startswith("smooth")


def test_solo_flips_all_the_way_round_and_lands_on_its_feet():
    problem = mjslq.problems.get("solo12_flip")
    result = mjslq.solve(problem, max_iterations=20)
    assert robots.CASES["Solo12 flip"].met(problem, result.trajectory)
    X = result.trajectory.X
    assert (X[:, 3] < -0.9).any() and np.abs(X[:, [4, 6]]).max() < 1e-2  # upside down and on, about its pitch axis
    highest = int(X[:, 2].argmax())
    from mjslq.dynamics.mujoco.contacts import penetration

    assert penetration(problem.dynamics.model, X[highest - 1 : highest + 2]) == 0.0
    standing = mjslq.problems.get("solo12_stand", crouch=0.8)
    still = problem.rollout(mjslq.solve(standing, max_iterations=5).trajectory.U)
    assert abs(still.X[-1, 2] - problem.x0[2]) < 0.03 and not robots.CASES["Solo12 flip"].met(problem, still)


def test_g1_stands_still_again():
    problem = mjslq.problems.get("g1_push")
    assert problem.x0[36] == 0.5
    result = mjslq.solve(problem, max_iterations=15)
    assert robots.CASES["G1 push 0.5 m/s"].met(problem, result.trajectory)
    assert not robots.CASES["G1 push 0.5 m/s"].met(problem, problem.rollout(problem.U0))


def test_thrusts_of_the_quadrotor_keep_to_their_limits():
    problem = mjslq.problems.get("quadrotor", roll=180.0, limit=5.0)
    result = mjslq.solve(problem)
    assert result.success, result.message
    U = result.trajectory.U
    assert U.min() >= 0.0 and U.max() <= 5.0 and result.active_limits.any()
    assert np.abs(problem.dynamics.difference(problem.costs[-1].target, result.trajectory.X[-1])).max() < 0.05


def test_box_is_pushed_along_a_line_and_turned():
    problem = mjslq.problems.get("box_push", x=0.2, y=-0.05, yaw=-0.3)
    result = mjslq.solve(problem, max_iterations=12)
    assert robots.CASES["box push"].met(problem, result.trajectory), problem.describe(result.trajectory)


@pytest.mark.parametrize("drive, start, iterations", [("servo", 0.0, 5), ("servo", 1.5, 12), ("motor", 0.0, 12)])
def test_g1_tracks_its_clip(drive, start, iterations):
    """In the squat, and over the first step, where the start falls."""
    problem = mjslq.problems.get("g1_clip", drive=drive, start=start)
    result = mjslq.solve(problem, max_iterations=iterations)
    first, last = (g1_clip.distances(t, problem.costs, problem.dynamics) for t in (
        problem.rollout(problem.U0), result.trajectory))  # fmt: skip
    assert first.shape == last.shape == (51, 12) and first.max() > 0.1
    assert last.mean() < 0.025 and last.max() < 0.12 and last.mean() < 0.5 * first.mean()
    lower, upper = problem.dynamics.control_limits.T
    assert (lower <= result.trajectory.U).all() and (upper >= result.trajectory.U).all()
    assert set(upper[:3]) == ({88.0, 139.0} if drive == "motor" else {2.8798, 2.9671, 2.7576})


def test_the_clip_of_g1_squats_waves_and_steps_on_level_feet():
    clip = g1_clip.recorded()
    feet = [clip.frames[f"{side}_ankle_roll_link"] for side in ("left", "right")]
    t, moves = clip.times, []
    for foot in feet:
        place = foot["position"]
        assert np.abs(np.abs(foot["orientation"][:, 0]) - 1.0).max() < 1e-5
        assert place[-1] - place[0] == pytest.approx([g1_motion.STRIDE, 0.0, 0.0], abs=2e-3)
        moves.append(np.abs(np.diff(place, axis=0)).max(axis=1) > 2e-3)
    assert not (moves[0] & moves[1]).any()  # one foot stands
    assert not moves[0][t[1:] < 3.1].any() and moves[1].sum() > 5
    assert clip.frames["pelvis"]["position"][t == 0.76, 2] < clip.frames["pelvis"]["position"][0, 2] - 0.12
    hand = clip.frames["right_wrist_yaw_link"]["position"]
    assert hand[(t > 1.2) & (t < 3.4), 2].min() > 1.15 and np.ptp(hand[t > 1.2, 1]) > 0.3


def test_the_clip_of_g1_is_what_its_module_makes():
    made = g1_motion.motion(g1_clip.robot(0.02, "smooth", "servo"), g1_clip.BODIES)
    clip = g1_clip.recorded()
    np.testing.assert_allclose(clip.times, made.times, rtol=0, atol=1e-12)
    for entry, samples in made.qpos.items():
        np.testing.assert_allclose(clip.qpos[entry], samples, rtol=0, atol=2e-4, err_msg=entry)
    for frame, quantities in made.frames.items():
        for of, samples in quantities.items():
            np.testing.assert_allclose(clip.frames[frame][of], samples, rtol=0, atol=2e-4, err_msg=frame)


def test_g1_moves_along_its_clip_on_a_receding_horizon():
    """Three plans, two of them begun on the way, as the demo makes them for all of the clip."""
    problem = mjslq.problems.get("g1_clip", horizon=20)
    loop = mjslq.MPC(problem, iterations=8, replan_every=10).run(duration=0.6)
    along = problem.dynamics.rollout(loop.trajectory.X[0], loop.trajectory.U)
    away = g1_clip.distances(along, problem.costs, problem.dynamics)
    assert away.mean() < 0.025 and away.max() < 0.08
    pelvis = g1_clip.recorded().signal("pelvis")
    assert pelvis(0.6)[2] < pelvis(0.0)[2] - 0.08  # it is on the way down


@pytest.mark.parametrize(
    "name, values, said",
    [
        ("box_push", {"start": "walk"}, "unknown start 'walk'; there are: line, still"),
        ("box_push", {"contact": "hard"}, "unknown contact 'hard'; there are: model, smooth, stiff"),
        ("box_push", {"foresight": -1.0}, "foresight must be at least 0"),
        ("quadrotor", {"limit": 0.0}, "limit must be positive"),
        ("solo12_jump", {"height": -1.0}, "height must be positive"),
        ("solo12_flip", {"spin": 0.0}, "spin must be positive"),
        ("solo12_jump", {"horizon": 3}, "horizon must be a whole number of at least 4"),
        ("g1_push", {"vx": np.inf}, "vx must be finite"),
    ],
)
def test_wrong_values_are_refused_in_one_sentence(name, values, said):
    with pytest.raises(ValueError, match=said):
        mjslq.problems.get(name, **values)


def test_the_first_iteration_that_counts_is_the_one_after_which_the_task_stays_done():
    problem = mjslq.problems.get("quadrotor")
    result = mjslq.solve(problem)
    case = robots.CASES["quadrotor, 90 deg"]
    at = robots.first_met(case, problem, result)
    assert all(case.met(problem, trajectory) for trajectory in result.iterates[at:])
    assert not case.met(problem, result.iterates[at - 1])
    assert robots.first_met(case, problem, mjslq.solve(problem, max_iterations=1)) is None


def test_the_bench_command_prints_a_row_a_task():
    command = [sys.executable, "-m", "mjslq.cli", "bench", "--robots", "cart-pole 5 N", "--starts", "1"]
    printed = subprocess.run([*command, "--json"], capture_output=True, text=True, timeout=120)
    assert printed.returncode == 0, printed.stderr
    (row,) = json.loads(printed.stdout)["robots"]
    assert row["case"] == "cart-pole 5 N" and row["solved"] == 1 and row["within"] == 40
    assert robots.summary([robots.Row("box push", [None, 3], [1.0, 2.0], penetration=0.01)]).row_count == 1


def test_other_seeds_are_other_starts():
    case = robots.CASES["cart-pole 5 N"]
    all_of_them = [problem.x0 for problem, _ in robots.started(case, 4)]
    later = [problem.x0 for problem, _ in robots.started(case, 2, 2)]
    assert np.array_equal(later, all_of_them[2:]) and not np.array_equal(later, all_of_them[:2])
    asked = [sys.executable, "-m", "mjslq.cli", "bench", "--seed", "3"]
    refused = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert refused.returncode != 0 and "give it with --robots or --starts" in refused.stderr
