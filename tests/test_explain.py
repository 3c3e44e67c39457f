"""`explain`: what a page says about a result is what the result is."""

import dataclasses

import numpy as np
import pytest
from test_cli import refused, run

import mjslq
from mjslq.reports.touches import touches
from mjslq.status import Status

BALL = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="ball" pos="0 0 0.3">
      <joint name="height" type="slide" axis="0 0 1"/><geom name="shell" size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="lift" joint="height" ctrlrange="-30 30" ctrllimited="true"/></actuator>
</mujoco>
"""


def section(page, title):
    found = [s for s in page.sections if s.title == title]
    return " ".join(found[0].lines) if found else ""


def ball(**options):
    dynamics = mjslq.MujocoDynamics.from_xml(BALL, **options)
    costs = [mjslq.costs.Control(1e-3), mjslq.costs.State([10.0, 0.1], [0.2, 0.0]), mjslq.costs.State(1.0, [0.2, 0.0])]
    return mjslq.Problem(dynamics, 60, [0.3, 0.0], costs)


def test_terms_add_up_and_are_listed_by_size():
    problem = ball()
    result = mjslq.solve(problem)
    assert list(result.cost_terms) == ["Control, running", "State, running", "State, running (2)"]
    assert sum(result.cost_terms.values()) == pytest.approx(result.cost, rel=1e-13)
    lines = next(s.lines for s in mjslq.explain(result).sections if s.title == "cost")
    shares = [float(line.split("%")[0]) for line in lines]
    assert shares == sorted(shares, reverse=True) and sum(shares) == pytest.approx(100.0, abs=0.3)


def test_a_page_survives_saving(tmp_path):
    result = mjslq.solve(ball(), max_iterations=2)
    result.save(tmp_path / "r.npz")
    again = mjslq.load(tmp_path / "r.npz")
    assert np.array_equal(again.gradient, result.gradient) and again.cost_terms == result.cost_terms
    assert str(mjslq.explain(again)) == str(mjslq.explain(result))
    assert np.linalg.norm(result.gradient) == pytest.approx(result.gradient_norm)


def test_a_solve_that_failed_is_never_told_that_all_is_well():
    result = mjslq.solve(ball(), max_iterations=0)
    for status in Status:
        ended = dataclasses.replace(result, status=status, log=())
        assert ("Nothing" in str(mjslq.explain(ended))) == (status is Status.CONVERGED)


def test_touches_are_those_of_the_motion():
    problem = ball()
    trajectory = problem.rollout(np.zeros((60, 1)))  # it falls, and rests on the floor
    result = mjslq.solve(problem, U0=np.zeros(1), max_iterations=0)
    (touch,) = touches(result)
    depth = np.maximum(0.1 - (trajectory.X[:, 0] + 0.3), 0.0)
    assert {touch.first, touch.second} == {"floor", "shell"}
    assert touch.knots == np.count_nonzero(depth) > 5
    assert touch.depth == pytest.approx(depth.max())
    assert touch.changes == np.count_nonzero(np.diff(depth > 0.0))
    assert "floor and shell" in section(mjslq.explain(result), "contacts")


def test_limits_constraints_and_advice():
    problem = ball()
    held = mjslq.Problem(
        problem.dynamics, 60, [0.3, 0.0], problem.costs, constraints=[mjslq.constraints.State([0.28, -np.inf])]
    )
    result = mjslq.solve(held)
    assert result.success
    page = mjslq.explain(result, held)
    assert "constraint state at knots" in section(page, "limits")
    assert "agree" in section(page, "derivatives")
    short = mjslq.explain(mjslq.solve(problem, max_iterations=1))
    assert any("go on from here" in advice for advice in short.advice)


def test_wrong_derivatives_come_first():
    def step(x, u):
        return np.array([x[0] + 0.1 * x[1], x[1] + 0.1 * u[0] - 0.05 * x[0]])

    def wrong(x, u, t):
        return np.array([[1.0, 0.1], [0.05, 1.0]]), np.array([[0.0], [0.1]])

    problem = mjslq.Problem(
        mjslq.FunctionDynamics(step, 2, 1, 0.1, jacobian=wrong), 20, [1.0, 0.0],
        [mjslq.costs.Control(0.1), mjslq.costs.State(1.0)],
    )  # fmt: skip
    page = mjslq.explain(mjslq.solve(problem, max_iterations=5), problem)
    assert page.advice == ("Mend the derivatives first: with wrong ones nothing else is to be trusted.",)
    with pytest.raises(ValueError, match="the problem has 60 steps, 2 states and 1 controls, but the result 20, 2 and"):
        mjslq.explain(mjslq.solve(problem, max_iterations=1), ball())


def test_what_failed_is_told():
    def fall(x, u):
        raise RuntimeError("out of oil")

    problem = ball()
    result = mjslq.solve(problem, callback=lambda entry: fall(0, 0))
    assert result.status is Status.FAILED
    assert "out of oil" in section(mjslq.explain(result), "ending")


def test_the_command(tmp_path):
    file = tmp_path / "p.npz"
    mjslq.solve(mjslq.problems.get("double_pendulum"), max_iterations=3).save(file)
    shown = run("explain", str(file))
    assert shown.returncode == 0, shown.stderr
    for title in ("ending", "cost", "gradient", "progress", "derivatives", "next"):
        assert f"\n{title}\n" in "\n" + shown.stdout
    assert "derivatives" not in run("explain", str(file), "--no-check").stdout
    assert "unknown problem 'pendulm'" in refused("explain", str(file), "--problem", "pendulm")
    assert "there is no file" in refused("explain", str(tmp_path / "none.npz"))
