"""Cost terms on states with quaternions: gradients and Hessians in tangent directions."""

import numpy as np
import pytest

from mjslq import MujocoDynamics, Problem, costs
from mjslq.trajectory import Trajectory

FLOATER = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body><freejoint/><geom type="box" size="0.2 0.1 0.05" mass="1"/>
      <body pos="0.3 0 0"><joint name="hinge" axis="0 1 0"/><geom type="capsule" size="0.02 0.1" mass="0.2"/></body>
    </body>
  </worldbody>
  <actuator><motor joint="hinge"/></actuator>
</mujoco>"""


@pytest.fixture(scope="module")
def floating():
    """Dynamics, a tumbling trajectory and another state far away from it."""
    engine = MujocoDynamics.from_xml(FLOATER)
    rng = np.random.default_rng(11)
    zero = np.zeros(engine.nx)
    zero[3] = 1.0
    x0, target = (engine.integrate(zero, 0.8 * rng.standard_normal(engine.ndx)) for _ in range(2))
    return engine, engine.rollout(x0, rng.standard_normal((5, 1))), target


@pytest.mark.parametrize(
    "term",
    [
        lambda target: costs.State(np.diag(np.linspace(1, 2, 14)), target, "always"),
        lambda target: costs.Tracking(1.0, 1.0, 3.0, x_target=target),
        lambda target: costs.Residual(lambda x, u, t: x[3:7] * x[0] - target[3:7], 2.0, "always"),
        lambda target: costs.Function(lambda x, u, t: (x[3] * x[4] + x[8] ** 2) * x[5] + x[1] ** 2, "always"),
    ],
    ids=["state", "tracking", "residual", "function"],
)
def test_gradients_on_a_manifold_go_along_its_tangents(term, floating):
    engine, trajectory, target = floating
    problem = Problem(engine, 5, trajectory.X[0], [term(target)])
    expansion = problem.expand(trajectory)
    assert expansion.q.shape == (6, engine.ndx) and engine.ndx == engine.nx - 1
    e = 1e-4
    for n in range(6):
        for i in range(engine.ndx):
            J = []
            for factor in (1, -1, 2, -2):
                X = np.array(trajectory.X)
                X[n] = engine.integrate(X[n], factor * e * np.eye(engine.ndx)[i])
                J.append(problem.cost(Trajectory(X, trajectory.U, trajectory.Y, trajectory.dt)))
            slope = (8 * (J[0] - J[1]) - (J[2] - J[3])) / (12 * e)
            assert expansion.q[n, i] == pytest.approx(slope, rel=1e-6, abs=1e-7)
    assert (np.linalg.eigvalsh(expansion.Q)[:, 0] > -1e-9).all()


def test_state_hessian_at_the_target_is_the_weight(floating):
    """There the difference's own curvature vanishes."""
    engine, trajectory, _ = floating
    problem = Problem(engine, 5, trajectory.X[0], [costs.State(2.0, trajectory.X, "terminal")])
    np.testing.assert_allclose(problem.expand(trajectory).Q[5], 2.0 * np.eye(engine.ndx), atol=1e-9)
    assert problem.cost(trajectory) == pytest.approx(0.0, abs=1e-20)


def test_a_state_with_quaternions_has_no_zero_to_default_to(floating):
    engine, trajectory, _ = floating
    with pytest.raises(ValueError, match=r"costs\[0\] \(State\): target must be given: a state with quaternions"):
        Problem(engine, 5, trajectory.X[0], [costs.State(1.0)])
