"""Constraints in problems: values and Jacobians on three engines, names, intervals, and what is refused."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mjslq
from mjslq import Bounds, FunctionDynamics, MujocoDynamics, PinocchioDynamics, Problem
from mjslq.constraints import Control, Path, Sensor, State, Terminal
from mjslq.costs import Control as Effort
from mjslq.solvers.augmented import IntervalLoss

N, H = 5, 0.05
CRAFT = """
<mujoco><option timestep="0.05"/><worldbody><body pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .05" mass="1"/>
<site name="middle"/><body pos=".2 0 0"><joint name="hinge" axis="0 1 0"/><site name="tip" pos=".3 0 0"/>
<geom name="arm" type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".3"/></body></body>
<geom name="post" type="sphere" size=".1" pos="1 0 1" contype="0" conaffinity="0"/></worldbody>
<actuator><motor joint="hinge"/><motor site="middle" gear="0 0 1 .2 .5 .2"/></actuator>
<sensor><framepos name="tip" objtype="site" objname="tip"/><framequat name="attitude" objtype="site" objname="tip"/>
<distance name="gap" geom1="arm" geom2="post" cutoff="10"/></sensor></mujoco>"""
ARM = """
<robot name="twolink"><link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.01" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"><inertial><origin xyz="0.05 0 0.1"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="tip"/><origin xyz="0 0 0.4"/>
    <axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="7" velocity="1"/></joint></robot>"""


def double(**options):
    return FunctionDynamics(lambda x, u: np.array([x[1], u[0]]), 2, 1, 0.1, **options)


def problem(*constraints, engine=None, **options):
    return Problem(engine or double(), N, [0.0, 0.0], [Effort(1.0)], constraints=constraints, **options)


@pytest.fixture(scope="module")
def engines(tmp_path_factory):
    file = tmp_path_factory.mktemp("robots") / "twolink.urdf"
    file.write_text(ARM)

    def equations(x, u):
        return np.stack([x[2], x[3], u[0] - np.sin(x[0]) * x[1], u[1] - x[3]])

    names = ("tip[0]", "tip[1]", "tip[2]")
    outputs = {"outputs": lambda x, u: np.stack([np.sin(x[0]), x[1] * x[2], x[3] * u[1]]), "output_names": names}
    return {
        "function": FunctionDynamics(equations, 4, 2, H, **outputs),
        "mujoco": MujocoDynamics.from_xml(CRAFT),
        "pinocchio": PinocchioDynamics.from_path(file, H, outputs=("tip",)),
    }


def w(x, u, t):
    return np.stack([x[0] * u[1] + x[1] * x[1] - t, np.sin(x[2]) - u[0] + x[3] * x[3]])


def term(kind, engine, when):
    limits = np.full(engine.nx, np.inf)
    limits[:2] = 0.1
    return {
        "state": lambda: State(-limits, limits, when),
        "sensor": lambda: Sensor("tip", -0.1, [0.1, np.inf, 0.2], when),
        "gap": lambda: Sensor("gap", 0.02, when=when),
        "path": lambda: Path(w, when=when),
        "end": lambda: Path(w, True, when, "end"),
        "terminal": lambda: Terminal(lambda x: x[:2] * x[2:4]),
    }[kind]()


CASES = [
    (engine, kind, when)
    for engine in ("function", "mujoco", "pinocchio")
    for kind in ("state", "sensor", "gap", "path", "end", "terminal")
    for when in ("running", "always", [1, 3])
    if (kind != "gap" or engine == "mujoco") and (kind, when) != ("end", "always")
]


@pytest.mark.parametrize("name,kind,when", CASES)
def test_jacobians_are_those_of_rollouts(engines, name, kind, when):
    engine, rng = engines[name], np.random.default_rng(3)
    zero = engine.initial_state if hasattr(engine, "initial_state") else np.zeros(engine.nx)
    x0 = engine.integrate(zero, 0.3 * rng.standard_normal(engine.ndx))
    made = Problem(engine, N, x0, [Effort(1.0)], constraints=[term(kind, engine, when)])
    (bound,) = made.bound_constraints
    U, dU = rng.standard_normal((2, N, engine.nu))
    trajectory, e = made.rollout(U), 1e-5
    linearization = engine.linearize(trajectory)
    J = bound.residual.jacobian(trajectory, linearization)
    dX = np.zeros((N + 1, engine.ndx))
    for n in range(N):
        dX[n + 1] = linearization.A[n] @ dX[n] + linearization.B[n] @ dU[n]
    indices = bound.residual.knots.indices
    change = np.einsum("nij,nj->ni", J.x, dX[indices])
    steps = np.flatnonzero(indices < N)
    if J.u is not None:
        change[steps] += np.einsum("nij,nj->ni", J.u[steps], dU[indices[steps]])
    there, before = (bound.residual.value(made.rollout(U + s * e * dU)) for s in (1.0, -1.0))
    np.testing.assert_allclose(change, (there - before) / (2.0 * e), rtol=1e-4, atol=2e-5 * np.abs(change).max())


def test_values_and_violations_knot_by_knot():
    made = problem(
        State([-1.0, -np.inf], [0.05, 0.2], name="box"),
        Path(lambda x, u, t: x[0] + 2.0 * u[0] - t, when=[1, 4], name="path"),
        Path(lambda x, u, t: x[0] + 2.0 * u[0] - t, True, "running", "end", name="end"),
        Terminal(lambda x: x[1] - 1.0, equality=False, name="goal"),
        State(None, [[0.0, 1.0], [0.1, 1.0]], when=[2, 3], name="listed"),
    )
    trajectory = made.rollout([1.0])
    X, U = trajectory.X, trajectory.U
    found = made.violations(trajectory)
    positive = lambda value: np.maximum(value, 0.0)  # noqa: E731
    np.testing.assert_allclose(found["box"], positive(np.maximum(X[:, 0] - 0.05, X[:, 1] - 0.2)))
    path = np.zeros(N + 1)
    for n in (1, 4):
        path[n] = positive(X[n, 0] + 2.0 * U[n, 0] - 0.1 * n)
    np.testing.assert_allclose(found["path"], path)
    end = np.abs([0.0, *(X[n + 1, 0] + 2.0 * U[n, 0] - 0.1 * (n + 1) for n in range(N))])
    np.testing.assert_allclose(found["end"], end)
    np.testing.assert_allclose(found["goal"], [0.0] * N + [positive(X[N, 1] - 1.0)])
    np.testing.assert_allclose(found["listed"], [0.0, 0.0, X[2, 0], positive(X[3, 0] - 0.1), 0.0, 0.0])
    assert made.violation(trajectory) == max(violation.max() for violation in found.values())


def test_limits_of_states_are_a_constraint_and_those_of_controls_make_the_box_smaller():
    made = problem(Control(-2.0, 3.0), engine=double(control_limits=(-5.0, 2.5)), bounds=Bounds(x=(None, [1.0, 0.5])))
    assert (made.box.lower == -2.0).all() and (made.box.upper == 2.5).all()
    assert [constraint.name for constraint in made.bound_constraints] == ["bounds"]
    trajectory = made.rollout([2.0])
    np.testing.assert_allclose(made.violations(trajectory)["bounds"], np.maximum(trajectory.X[:, 1] - 0.5, 0.0))
    only_controls = problem(Control([-1.0], np.full((N, 1), 1.0)))
    assert not only_controls.bound_constraints and mjslq.solve(only_controls, "slq").success


def test_a_diverged_trajectory_violates_without_end():
    made = problem(
        State(0.0, 1.0), engine=FunctionDynamics(lambda x, u: 1e200 * x * x + u, 2, 2, 1.0, integrator="map")
    )
    assert made.violation(made.rollout(np.full((N, 2), 1e200))) == np.inf


def test_names_are_given_or_made():
    made = problem(State(0.0, 1.0), State(0.0, 2.0), Path(lambda x, u, t: x[0]), State(0.0, 3.0, name="state 2"))
    assert [constraint.name for constraint in made.bound_constraints] == ["state", "state 3", "path", "state 2"]
    engine = double(outputs=lambda x, u: x[:1], output_names=("height",))
    assert [c.name for c in problem(Sensor("height", 0.0), engine=engine).bound_constraints] == ["height"]


def test_time_is_the_one_of_the_knot_and_moves_with_the_problem():
    made = problem(Path(lambda x, u, t: t, name="now"), Path(lambda x, u, t: t, at="end", name="then"))
    trajectory = made.rollout([0.0])
    np.testing.assert_allclose(made.violations(trajectory)["now"], [0.0, 0.1, 0.2, 0.3, 0.4, 0.0])
    np.testing.assert_allclose(made.violations(trajectory)["then"], [0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    later = made.at([0.0, 0.0], 1.0).violations(trajectory)
    np.testing.assert_allclose(later["now"], [1.0, 1.1, 1.2, 1.3, 1.4, 0.0])
    np.testing.assert_allclose(later["then"], [0.0, 1.1, 1.2, 1.3, 1.4, 1.5])


def test_given_jacobians_are_used():
    used = []

    def by_x_and_u(x, u, t):
        used.append("path")
        return np.array([[0.0, 2.0]]), np.array([[3.0]])

    def by_x(x):
        used.append("terminal")
        return [0.0, 5.0]

    made = problem(Path(lambda x, u, t: abs(x[0]), jacobian=by_x_and_u), Terminal(lambda x: abs(x[0]), jacobian=by_x))
    trajectory = made.rollout([0.0])
    for bound, wanted in zip(made.bound_constraints, (2.0, 5.0), strict=True):
        J = bound.residual.jacobian(trajectory, made.dynamics.linearize(trajectory))
        assert (J.x[:, 0, 1] == wanted).all()
    assert set(used) == {"path", "terminal"}


def test_constraints_are_pickled():
    given = [Sensor("gap", 0.02), State(upper=3.0, name="box"), Path(w, at="end"), Terminal(np.sin)]
    assert pickle.loads(pickle.dumps(given)) == given


number = st.floats(-3.0, 3.0)


@given(r=number, ends=st.tuples(number, number), kind=st.integers(0, 3), multiplier=number, rho=st.floats(0.1, 10.0))
def test_the_loss_of_an_interval_is_a_minimum_over_slacks(r, ends, kind, multiplier, rho):
    low, high = sorted(ends)
    low, high = [(low, high), (-np.inf, high), (low, np.inf), (low, low)][kind]
    loss = IntervalLoss(*(np.array([[value]]) for value in (low, high, multiplier, rho)))
    at = lambda r: float(loss.value(np.array([[r]]))[0])  # noqa: E731
    slacks = np.clip(np.concatenate([np.linspace(-40.0, 40.0, 4001), [r + multiplier / rho]]), low, high)
    assert at(r) == pytest.approx((multiplier * (r - slacks) + 0.5 * rho * (r - slacks) ** 2).min(), abs=1e-9)
    slope = float(loss.slope(np.array([[r]]))[0, 0])
    assert slope == pytest.approx((at(r + 1e-6) - at(r - 1e-6)) / 2e-6, abs=1e-4)
    assert float(loss.curvature(np.array([[r]])).W[0, 0, 0]) == (rho if slope != 0.0 else 0.0)
    if kind == 1:
        assert at(r) == pytest.approx(
            (max(0.0, multiplier + rho * (r - high)) ** 2 - multiplier**2) / (2.0 * rho), abs=1e-9
        )


QUATERNION = "reads an orientation"
REFUSED = {
    "lower must not lie above upper": [State([1.0, 1.0], [0.0, 2.0])],
    "got 1 and 0 for 'x\\[0\\]' at knot 0": [State([1.0, 1.0], [0.0, 2.0])],
    "got inf and inf": [State(np.inf)],
    "no finite limit": [State(None, [np.inf, np.inf])],
    "unknown sensor 'nose'; there are: none": [Sensor("nose", 0.0)],
    "must be a function, got int": [Path(3)],
    "m\\(x\\) must be a function": [Terminal(3)],
    "unknown at 'middle'": [Path(lambda x, u, t: x, at="middle")],
    'steps with at="end"': [Path(lambda x, u, t: x, at="end", when="always")],
    "name 'a' is another constraint's": [State(0.0, name="a"), State(0.0, name="a")],
    "belongs to the limits of the controls": [State(0.0, name="controls")],
    "a text that is not empty": [State(0.0, name="")],
    "must not be NaN; write -inf": [State([np.nan, 0.0])],
    "equality must be True or False": [Path(lambda x, u, t: x, equality=1)],
    "names knot 30": [State(0.0, when=[30])],
    "one a knot and entry \\(6, 2\\), got shape \\(3,\\)": [State([0.0, 0.0, 0.0])],
    "constraints\\[1\\] must be one of mjslq.constraints, got int": [State(0.0), 3],
    "lower must be an array of numbers": [State("low")],
}


@pytest.mark.parametrize("message", REFUSED)
def test_wrong_constraints_are_refused_in_a_sentence(message):
    with pytest.raises(ValueError, match=message):
        problem(*REFUSED[message])


def test_wrong_lists_bounds_and_orientations_are_refused():
    for constraints in (3, None, "wall"):
        with pytest.raises(ValueError, match="constraints"):
            Problem(double(), N, [0.0, 0.0], [Effort(1.0)], constraints=constraints)
    with pytest.raises(ValueError, match="leave nothing at step 0: one asks for \\[0, 1\\], another for \\[3, 4\\]"):
        problem(Control(3.0, 4.0), bounds=Bounds(u=(0.0, 1.0)))
    with pytest.raises(ValueError, match="x must be None or a pair"):
        problem(bounds=Bounds(x=3))
    with pytest.raises(ValueError, match="bounds: x: lower must be a number"):
        problem(bounds=Bounds(x=([1.0, 1.0, 1.0], None)))
    with pytest.raises(ValueError, match="give the other another name"):
        problem(State(0.0, name="bounds"), bounds=Bounds(x=(0.0, 1.0)))
    engine = MujocoDynamics.from_xml(CRAFT)
    with pytest.raises(ValueError, match=QUATERNION):
        Problem(engine, N, engine.initial_state, [Effort(1.0)], constraints=[Sensor("attitude", 0.0, 1.0)])
