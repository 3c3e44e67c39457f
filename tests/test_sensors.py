"""`costs.Sensor` on MuJoCo's sensors: positions, orientations, forces, at all knots and at the end."""

import numpy as np
import pytest

import mjslq

CRAFT = """
<mujoco><option timestep="0.01"/><worldbody><body name="hull" pos="0 0 1"><freejoint/>
<geom type="box" size=".1 .2 .05" mass="1"/><site name="middle"/>
<body pos=".2 0 0"><joint name="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".3"/><site name="tip" pos=".3 0 0"/>
</body></body></worldbody>
<actuator><motor name="elbow" joint="hinge"/><motor site="middle" gear="0 0 1 0 0 0"/>
<motor site="middle" gear="0 0 0 1 .5 .2"/></actuator>
<sensor><framepos name="tip" objtype="site" objname="tip"/><framequat name="attitude" objtype="site" objname="tip"/>
<actuatorfrc name="effort" actuator="elbow"/></sensor></mujoco>
"""


@pytest.fixture(scope="module")
def craft():
    return mjslq.MujocoDynamics.from_xml(CRAFT)


def problem_of(craft, *terms):
    return mjslq.Problem(craft, 25, craft.initial_state, [mjslq.costs.Control(0.01), *terms])


ATTITUDE = [0.9, 0.1, 0.2, 0.3]
TERMS = {
    "position": mjslq.costs.Sensor("tip", [0.5, 0.1, 1.1], [1.0, 2.0, 3.0], "always"),
    "orientation": mjslq.costs.Sensor("attitude", ATTITUDE, 10.0, "always"),
    "force": mjslq.costs.Sensor("effort", 0.3, 2.0),
    "moving target": mjslq.costs.Sensor("tip", np.linspace([0, 0, 1], [1, 1, 2], 26), np.diag([1.0, 0.0, 2.0])),
}


@pytest.mark.parametrize("term", TERMS.values(), ids=TERMS)
def test_gradient_is_the_derivative_of_the_cost(craft, term):
    problem, rng = problem_of(craft, term), np.random.default_rng(0)
    U, direction = rng.normal(size=(2, 25, craft.nu))
    e = 1e-5
    difference = (
        problem.cost(problem.rollout(U + e * direction)) - problem.cost(problem.rollout(U - e * direction))
    ) / e
    np.testing.assert_allclose(2.0 * np.vdot(problem.gradient(problem.rollout(U)), direction), difference, rtol=1e-6)


def test_cost_is_the_weighted_distance(craft):
    target, weight = np.array([0.5, 0.1, 1.1]), np.array([1.0, 2.0, 3.0])
    problem = mjslq.Problem(craft, 25, craft.initial_state, [mjslq.costs.Sensor("tip", target, weight, "always")])
    trajectory = problem.rollout(np.ones((25, 3)))
    squares = ((trajectory.Y[:, :3] - target) ** 2 * weight).sum(axis=1)
    assert problem.cost(trajectory) == pytest.approx(0.5 * (0.01 * squares[:-1].sum() + squares[-1]), rel=1e-13)


def test_orientation_is_measured_by_the_angle(craft):
    """A target turned by 0.4 rad about an axis costs 1/2 0.4^2 at rest, whatever the sign of its quaternion."""
    turned = np.array([np.cos(0.2), 0.0, np.sin(0.2), 0.0])
    for target in (turned, -turned, 3.0 * turned):
        term = mjslq.costs.Sensor("attitude", target, when="terminal")
        problem = mjslq.Problem(craft, 1, craft.initial_state, [term])
        assert problem.cost(problem.rollout(np.zeros((1, 3)))) == pytest.approx(0.5 * 0.4**2, rel=1e-6)


def test_expansion_is_gauss_newton(craft):
    """Q, M, R are the products of the residual's own Jacobian, by finite differences of the readings."""
    problem, rng = problem_of(craft, TERMS["force"]), np.random.default_rng(1)
    trajectory = problem.rollout(rng.normal(size=(25, 3)))
    expansion = problem.expand(trajectory)
    _, _, C, D = craft.linearize(trajectory)
    columns = craft.outputs["effort"].columns
    for n in (0, 7, 24):
        c, d = C[n, columns], D[n, columns]
        np.testing.assert_allclose(expansion.Q[n], 0.01 * 2.0 * c.T @ c, atol=1e-12)
        np.testing.assert_allclose(expansion.M[n], 0.01 * 2.0 * d.T @ c, atol=1e-12)
        np.testing.assert_allclose(expansion.R[n], 0.01 * (2.0 * d.T @ d + 0.01 * np.eye(3)), atol=1e-12)


def test_solves_to_the_target(craft):
    """From hovering: up by 0.2 m, the arm down, within half a second."""
    target, hover = [0.45, 0.0, 1.2], [0.0, 1.3 * 9.81, 0.0]
    terms = [mjslq.costs.Control(0.01, hover), mjslq.costs.Sensor("tip", target, 1e3, "terminal")]
    result = mjslq.solve(mjslq.Problem(craft, 50, craft.initial_state, terms, U0=hover))
    assert result.success, result.message
    np.testing.assert_allclose(result.trajectory.Y[-1, :3], target, atol=5e-3)


@pytest.mark.parametrize(
    "term, said",
    [
        (
            mjslq.costs.Sensor("tipp", 0.0),
            "unknown sensor 'tipp'; there are: tip, attitude, effort; did you mean 'tip'?",
        ),
        (mjslq.costs.Sensor("tip", [1.0, 2.0]), r"target must be a number, a vector \(3,\)"),
        (mjslq.costs.Sensor("attitude", 0.0), "must be a quaternion"),
        (mjslq.costs.Sensor("tip", 0.0, -1.0), "weight must be positive semidefinite"),
        (mjslq.costs.Sensor("tip", 0.0, when="sometimes"), "there are: running, terminal, always"),
    ],
)
def test_wrong_sensors_are_named(craft, term, said):
    with pytest.raises(ValueError, match=said):
        problem_of(craft, term)
