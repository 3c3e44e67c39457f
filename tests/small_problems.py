"""Problems that are solved in milliseconds, for tests of the solvers."""

import numpy as np
from numba import njit

from mjslq import FunctionDynamics, Problem, costs, problems


@njit
def pendulum_equations(x, u):
    out = np.empty_like(x)
    out[0] = x[1]
    out[1] = u[0] - 9.81 * np.sin(x[0]) - 0.1 * x[1]
    return out


PENDULUM = FunctionDynamics(pendulum_equations, 2, 1, 0.05)
DOUBLE_INTEGRATOR = FunctionDynamics(lambda x, u: np.stack([x[1], u[0]]), 2, 1, 0.1)


def pendulum(x0=(0.0, 0.0), N=40, dynamics=PENDULUM, bounds=None, **options):
    """Raise the pendulum to an angle at which gravity still pulls."""
    terms = [costs.Control(0.1), costs.State([200.0, 20.0], [2.0, 0.0], "terminal")]
    return Problem(dynamics, N, x0, terms, bounds, name="pendulum", options=options)


def linear():
    return Problem(DOUBLE_INTEGRATOR, 20, [1.0, 0.0], [costs.Control(0.1), costs.State(1.0, [0.0, 0.0], "always")])


def drag(beta=0.1):
    return problems.get("drag_particle", beta=beta)
