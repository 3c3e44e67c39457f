"""The benchmark measures what it says, on the smallest case; its numbers are for reading, not for passing tests."""

import json
import subprocess
import sys

import numpy as np
import pytest

from mjslq.reports import bench, starts, tables


@pytest.fixture(autouse=True)
def hurried(monkeypatch):
    monkeypatch.setattr(bench, "BUDGET", 0.0)
    monkeypatch.setattr(bench, "ITERATIONS", 2)


def test_a_row_holds_positive_times_and_their_ratios():
    row = bench.run("hopper")
    assert (row.engine, row.N, row.nx, row.nu) == ("mujoco", 100, 4, 1)
    assert "transition" in row.linearize
    times = [row.rollout, row.sweep, row.free_sweep, row.iteration, *row.linearize.values(), *row.bare.values()]
    assert np.isfinite(times).all() and min(times) > 0.0
    assert row.ratio_to_bare == pytest.approx(row.iteration / (row.bare["mjd_transitionFD"] + row.bare["mj_step"]))
    assert row.ratio_to_calls == pytest.approx(
        row.iteration / (row.rollouts_per_iteration * row.bare["mj_step"] + row.bare["mj_inverse"])
    )
    assert row.errors["inverse"] < row.errors["transition"] < 1e-6
    assert row.ratio_of_jacobians == pytest.approx(row.bare["mjd_transitionFD"] / min(row.linearize.values()))


def test_limits_are_measured_where_they_hold(capsys):
    row = bench.run("cart-pole within limits")
    assert row.limited > 0 and row.sweep > 0.0 and row.free_sweep > 0.0
    tables.benchmark([row], {})
    assert "free)" in capsys.readouterr().out
    assert bench.run("hopper").limited == 0


def test_other_engines_have_no_bare_calls():
    row = bench.run("panda_reach on pinocchio")
    assert row.engine == "pinocchio" and row.bare == {}
    assert row.ratio_to_bare is None and row.ratio_to_calls is None and row.ratio_of_jacobians is None


def test_growth_is_measured_by_horizon_states_iterations_and_threads():
    assert list(bench.growth("panda_reach", (5, 10))) == [5, 10]
    assert list(bench.growth_with_states((1, 3))) == [2, 6]
    memory = bench.growth_of_memory("hopper", iterations=20)
    assert not memory or memory[20] >= memory[2] > 1.0
    assert bench.speedup("hopper")[1] == 1.0
    for name, measure in bench.GROWTH.items():
        assert name and callable(measure)


def test_the_table_has_a_line_a_case(capsys):
    rows = [bench.run("hopper")]
    tables.benchmark(rows, {"milliseconds by the horizon": {100: 1.0, 200: 2.0}})
    printed = capsys.readouterr().out
    assert printed.count("hopper") == 2 and "200: 2" in printed


@pytest.mark.parametrize("case", bench.CASES)
def test_every_case_is_a_problem_that_rolls_out(case):
    problem = bench.CASES[case]()
    assert not problem.rollout(problem.U0).diverged


def test_solo12_in_flight_touches_nothing():
    import mujoco

    problem = bench.CASES["solo12 in flight"]()
    model, X = problem.dynamics.model, problem.rollout(problem.U0).X
    data = mujoco.MjData(model)
    for x in X:
        data.qpos[:] = x[: model.nq]
        mujoco.mj_forward(model, data)
        assert data.ncon == 0


def test_json_is_for_machines():
    command = [sys.executable, "-m", "mjslq.cli", "bench", "hopper", "--json"]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    (row,) = json.loads(outcome.stdout)["cases"]
    assert row["case"] == "hopper" and row["iteration"] > 0.0


def test_many_starts_in_a_table(capsys):
    row = starts.measure("cart-pole 2.5 N", 2)
    assert row.solved == 2 and row.violation == 0.0 and row.failures == ""
    numbers = row.as_dict()
    assert len(numbers["iterations"]) == len(numbers["costs"]) == 2
    tables.many_starts([row])
    assert "2 of 2" in capsys.readouterr().out
