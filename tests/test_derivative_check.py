"""The reference that Jacobians are checked against."""

import numpy as np
import pytest

from mjslq import FunctionDynamics
from mjslq.dynamics.derivative_check import fine_reference


def pendulum(x, u):
    return np.array([x[1], u[0] - np.sin(x[0])])


@pytest.mark.parametrize("dt", [0.1, np.linspace(0.05, 0.3, 8)])
def test_outputs_of_the_last_knot_are_read_at_its_own_time(dt):
    def outputs(x, u, t):
        return np.array([t * np.sin(x[0]) + u[0]])

    dynamics = FunctionDynamics(pendulum, 2, 1, dt, outputs=outputs)
    trajectory = dynamics.rollout([0.3, 1.0], np.full((8, 1), 0.2))
    fine = fine_reference(dynamics, trajectory)
    expected = trajectory.times[-1] * np.cos(trajectory.X[-1, 0])
    np.testing.assert_allclose(fine.C[-1], [[expected, 0.0]], rtol=0, atol=1e-9)
    np.testing.assert_allclose(fine.D[:, 0, 0], [1.0] * 8 + [0.0], rtol=0, atol=1e-9)
    check = dynamics.check_derivatives(trajectory)
    assert not check.suspects and check.worst_error < 1e-8
