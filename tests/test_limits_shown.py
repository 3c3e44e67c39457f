"""Which limits are active, as text: spans, names, units, and nothing where there is nothing to tell."""

import dataclasses

import numpy as np
import pytest

from mjslq import MujocoDynamics, Problem, costs, solve
from mjslq.reports import limits
from mjslq.reports.tables import as_dict, print_summary
from mjslq.result import Result
from mjslq.status import Status
from mjslq.trajectory import Trajectory


def result(U, lower, upper, dt=0.1, names=()):
    U = np.asarray(U, dtype=float)
    lower, upper = (np.array(np.broadcast_to(limit, U.shape), dtype=float) for limit in (lower, upper))
    trajectory = Trajectory(np.zeros((len(U) + 1, 1)), U, dt=dt)
    return Result(Status.CONVERGED, "", 0.0, 1, 0.0, trajectory, None, lower, upper, names={"controls": tuple(names)})


def test_spans_are_runs_of_steps():
    found = result([[1], [1], [0], [1], [-2]], -2.0, 1.0, names=["hip"])
    upper, lower = limits.at_limits(found)
    assert (upper.name, upper.side, upper.limit) == ("hip", 1, 1.0)
    np.testing.assert_allclose(upper.spans, [(0.0, 0.2), (0.3, 0.4)])
    assert lower.side == -1 and lower.limit == -2.0 and lower.seconds == pytest.approx(0.1)
    assert limits.describe(found) == "hip at +1 during 0-0.2 s and 0.3-0.4 s, at -2 during 0.4-0.5 s"
    assert limits.describe(found, brief=True) == "hip 0.4 s"


@pytest.mark.parametrize(
    "U, lower, upper, said",
    [
        ([[0.5], [0.2]], -1.0, 1.0, ""),
        ([[5.0], [9.0]], -np.inf, np.inf, ""),
        ([[1.0], [1.0]], -1.0, 1.0, "u[0] at +1 throughout"),
        ([[0.9995], [0.0]], -1.0, 1.0, "u[0] at +1 during 0-0.1 s"),  # as near as it can be told
        ([[0.99], [0.0]], -1.0, 1.0, ""),
        ([[1.0], [2.0], [0.0]], -5.0, [[1.0], [2.0], [3.0]], "u[0] at its upper limit during 0-0.2 s"),
        ([[2.0], [0.0]], 0.0, np.inf, "u[0] at +0 during 0.1-0.2 s"),
        ([[1, 0, 1, 0, 1, 0, 1, 0]], -1.0, 1.0, None),
        (np.tile([[1.0], [0.0]], (5, 1)), -1.0, 1.0, "u[0] at +1 for 0.5 s in 5 spans within 0-0.9 s"),
    ],
)
def test_sentences(U, lower, upper, said):
    text = limits.describe(result(U, lower, upper))
    if said is None:
        assert text.count("throughout") == 4
    else:
        assert text == said


def test_many_controls_are_counted():
    U = np.ones((10, 7))
    U[5:, 0] = 0.0
    text = limits.describe(result(U, -1.0, 1.0))
    assert text.endswith("; 3 more") and "u[0]" not in text


def test_limits_near_are_those_that_are_exact_and_more():
    rng = np.random.default_rng(3)
    U = np.clip(rng.normal(size=(200, 3)), [-1.0, -np.inf, -0.5], [1.0, 0.7, np.inf])
    found = result(U, [-1.0, -np.inf, -0.5], [1.0, 0.7, np.inf])
    exact, near = found.active_limits, limits.reached(found, U)
    assert (near[exact != 0] == exact[exact != 0]).all() and np.count_nonzero(exact) > 100


@pytest.fixture(scope="module")
def pushed():
    """A weight that is pushed as far as its motor can."""
    xml = """<mujoco><option timestep=".05"/><worldbody><body><joint name="rail" type="slide" axis="1 0 0"/>
      <geom size=".1" mass="1"/></body></worldbody>
      <actuator><motor name="motor" joint="rail" ctrlrange="-2 2"/></actuator></mujoco>"""
    goal = costs.State([100.0, 1.0], [1.0, 0.0], when="terminal")
    problem = Problem(MujocoDynamics.from_xml(xml), 20, np.zeros(2), [goal, costs.Control(1e-3)], name="push")
    return problem, solve(problem, "slq")


def test_summary_tells_active_limits_with_unit(pushed, capsys):
    problem, found = pushed
    assert found.success and found.active_limits.any()
    print_summary(found, problem)
    assert "motor at +2 N during 0-" in " ".join(capsys.readouterr().out.split())
    free = dataclasses.replace(found, lower=found.lower - 9.0, upper=found.upper + 9.0, compile_seconds=1.25)
    print_summary(free, problem)
    printed = capsys.readouterr().out
    assert "limits" not in printed and "compiling" in printed and "1.2 s, the first time only" in printed


def test_numbers_for_machines_name_limits_and_are_json(pushed):
    import json

    _, found = pushed
    (first, *_) = as_dict(found)["limits"]
    assert (first["control"], first["limit"], first["side"]) == ("motor", 2.0, 1) and first["spans"][0][0] == 0.0
    lost = dataclasses.replace(found, cost=np.inf, gradient_norm=np.nan)
    assert json.loads(json.dumps(as_dict(lost), allow_nan=False))["cost"] is None
