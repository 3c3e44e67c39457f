"""Windows of time: every constructor and every kind of table in a task file acts at the knots that `when` names."""

import numpy as np
import pytest

import mjslq
from mjslq import constraints, costs

N = 20
ARM = """
<mujoco model="arm">
  <option timestep="0.05"/>
  <worldbody>
    <geom name="wall" type="box" size="0.05 0.05 0.05" pos="0.8 0 0.5"/>
    <body name="upper"><joint name="shoulder" axis="0 1 0" range="-0.4 0.4" limited="true" damping="0.1"/>
      <geom name="bone" type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1" contype="0" conaffinity="0"/>
      <site name="tip" pos="0.5 0 0"/>
    </body>
  </worldbody>
  <actuator><motor name="m" joint="shoulder"/></actuator>
  <sensor><framepos name="hand" objtype="site" objname="tip"/></sensor>
</mujoco>
"""
WINDOWS = {
    "from 0.2 to 0.4 s": (slice(4, 9), range(4, 9)),
    "at 0.75 s": (0.75, [15]),
    "times": ([0.1, 0.5, 1.0], [2, 10, 20]),
    "knots": ([3, -1], [3, 20]),
    "every fifth": (slice(None, None, 5), range(0, 21, 5)),
    "initial": ("initial", [0]),
    "terminal": ("terminal", [20]),
}
STEPS = {"from 0.2 to 0.4 s", "at 0.75 s", "initial"}
"""Windows without the last knot, at which there is no control."""


@pytest.fixture(scope="module")
def arm():
    return mjslq.MujocoDynamics.from_xml(ARM, frames=["tip"])


@pytest.fixture(scope="module")
def along(arm):
    return arm.rollout([0.1, 0.7], np.random.default_rng(0).normal(size=(N, 1)))


def clip_term(when):
    frames = {"tip": {"position": np.outer([1.0, 2.0], np.ones(3))}}
    return mjslq.Clip([0.0, 1.0], frames).costs(mjslq.MujocoDynamics.from_xml(ARM, frames=["tip"]), {"position": 2.0},
                                                when=when)[0]  # fmt: skip


COSTS = {
    "State": lambda when: costs.State(2.0, lambda t: [t, 1.0], when),
    "Control": lambda when: costs.Control(2.0, lambda t: t, when),
    "Sensor": lambda when: costs.Sensor("hand", lambda t: [t, 1.0, 0.0], 2.0, when),
    "Frame": lambda when: costs.Frame("tip", lambda t: [t, 0.0, 3.0], 2.0, when, of="linear-velocity"),
    "Residual": lambda when: costs.Residual(lambda x, u, t: x - t, 2.0, when),
    "Function": lambda when: costs.Function(lambda x, u, t: x[0] ** 2 + t, when),
    "clip": clip_term,
}


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("kind", COSTS)
def test_costs_act_within_their_window(arm, along, kind, window):
    """The cost is the sum of the values at single knots, and no other state or control changes it."""
    when, knots = WINDOWS[window]
    if kind == "Control" and window not in STEPS:
        with pytest.raises(ValueError, match="when must name steps for controls"):
            mjslq.Problem(arm, N, [0.0, 0.0], [COSTS[kind](when)])
        return
    cost = mjslq.Problem(arm, N, [0.0, 0.0], [COSTS[kind](when)]).cost
    singles = [mjslq.Problem(arm, N, [0.0, 0.0], [COSTS[kind](n)]).cost(along) for n in knots]
    assert cost(along) == pytest.approx(sum(singles), rel=1e-13) and min(singles) > 0.0
    X, U, Y = (np.array(part) for part in (along.X, along.U, along.Y))
    others = np.setdiff1d(np.arange(N + 1), knots)
    X[others], Y[others], U[others[others < N]] = 7.0, 7.0, 7.0
    assert cost(mjslq.Trajectory(X, U, Y, along.dt)) == pytest.approx(cost(along), rel=1e-13)


CONSTRAINTS = {
    "State": lambda when: constraints.State(lambda t: 9.0 + t, when=when),
    "Sensor": lambda when: constraints.Sensor("hand", lambda t: 9.0 + t, when=when),
    "Frame": lambda when: constraints.Frame("tip", lambda t: 9.0 + t, when=when),
    "Path": lambda when: constraints.Path(lambda x, u, t: 9.0 + t - x, when=when),
}


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("kind", CONSTRAINTS)
def test_constraints_hold_within_their_window(arm, along, kind, window):
    when, knots = WINDOWS[window]
    problem = mjslq.Problem(arm, N, [0.0, 0.0], [costs.Control(1.0)], constraints=[CONSTRAINTS[kind](when)])
    (violation,) = problem.violations(along).values()
    assert np.array_equal(np.flatnonzero(violation), list(knots))
    later = problem.at([0.0, 0.0], 0.5).violations(along).popitem()[1]
    np.testing.assert_allclose((later - violation)[list(knots)], 0.5, rtol=1e-12)


TABLES = {
    "control": "weight = 2.0\ntarget = 1.0",
    "state": "weight = 2.0\ntarget = [0.3, 1.0]",
    "joints": "weight = 2.0\ntarget = { shoulder = 0.4 }",
    "velocities": "weight = 2.0",
    "sensor": 'name = "hand"\ntarget = [0.3, 1.0, 0.0]',
    "frame": 'name = "tip"\nof = "linear-velocity"\ntarget = [0.3, 1.0, 0.0]',
    "clip": 'file = "still.csv"\nweights = { position = 1.0 }',
}
LIMITS = {
    "joints": "limits = { shoulder = [9.0, 10.0] }",
    "sensor": 'sensor = "hand"\nlower = 9.0',
    "frame": 'frame = "tip"\nlower = 9.0',
    "distance": 'between = ["wall", "bone"]\nlower = 9.0\nwithin = 99.0',
}
WINDOWS_OF_TASKS = {
    "{ from = 0.2, to = 0.4 }": range(4, 9),
    "{ from = 4, to = 8 }": range(4, 9),
    "0.75": [15],
    "[0.1, 0.5]": [2, 10],
    '"initial"': [0],
}


def loaded(folder, text):
    (folder / "arm.xml").write_text(ARM)
    (folder / "still.csv").write_text("time,tip.x,tip.y,tip.z\n0,9,9,9\n1,8,8,8\n")
    (folder / "task.toml").write_text(f'model = "arm.xml"\nhorizon = {N}\n{text}')
    return mjslq.load_task(folder / "task.toml").problem


@pytest.mark.parametrize("window", WINDOWS_OF_TASKS)
@pytest.mark.parametrize("kind", TABLES)
def test_tables_of_costs_act_within_their_window(tmp_path, kind, window):
    """At the knots named, and at no other: each one's state and control changes the cost or does not."""
    problem = loaded(tmp_path, f'[[costs]]\nkind = "{kind}"\n{TABLES[kind]}\nwhen = {window}\n')
    along = problem.dynamics.rollout([0.1, 0.7], np.random.default_rng(0).normal(size=(N, 1)))
    acting = []
    for n in range(N + 1):
        X, U, Y = (np.array(part) for part in (along.X, along.U, along.Y))
        X[n], Y[n], U[min(n, N - 1)] = 5.0, 5.0, 5.0
        if n < N and problem.cost(mjslq.Trajectory(X, U, Y, along.dt)) != problem.cost(along):
            acting.append(n)
    assert acting == list(WINDOWS_OF_TASKS[window])


@pytest.mark.parametrize("window", WINDOWS_OF_TASKS)
@pytest.mark.parametrize("kind", LIMITS)
def test_tables_of_constraints_hold_within_their_window(tmp_path, kind, window):
    effort = '[[costs]]\nkind = "control"\nweight = 1.0\n'
    problem = loaded(tmp_path, f'{effort}[[constraints]]\nkind = "{kind}"\n{LIMITS[kind]}\nwhen = {window}\n')
    (violation,) = problem.violations(problem.rollout(np.zeros((N, 1)))).values()
    assert np.array_equal(np.flatnonzero(violation), list(WINDOWS_OF_TASKS[window]))
