"""A point mass that must be at a sequence of targets, one of which is an outlier: what each loss makes of it."""

import numpy as np
import pytest

import mjslq
from mjslq import FunctionDynamics, Problem, costs

KNOTS = [10, 20, 30, 40, 50]
TARGETS = np.array([[0.2, 0.0], [0.4, 0.2], [4.0, -6.0], [0.8, 0.2], [1.0, 0.0]])
OUTLIER = 2


def equations(x, u):
    return np.stack([x[2], x[3], u[0], u[1]])


def reach(loss, weight=10.0, **options):
    mass = FunctionDynamics(equations, 4, 2, 0.02, outputs=lambda x, u: x[:2], output_names=("p[0]", "p[1]"))
    terms = [
        costs.Control(1e-2),
        costs.Sensor("p", TARGETS, weight, KNOTS, loss, **options),
        costs.State([0.0, 0.0, 0.1, 0.1], when="terminal"),
    ]
    return Problem(mass, 50, np.zeros(4), terms)


def misses(problem):
    """Distance from each target: of the others, and of the outlier."""
    result = mjslq.solve(problem, "slq")
    assert result.success, result.message
    missed = np.linalg.norm(result.trajectory.Y[KNOTS] - TARGETS, axis=1)
    return np.delete(missed, OUTLIER), missed[OUTLIER]


@pytest.mark.parametrize("width", [0.01, 0.001])
@pytest.mark.parametrize("loss", ["smooth-abs", "huber", "pseudo-huber"])
def test_robust_losses_ignore_the_outlier(loss, width):
    """All pull with the same force far out: 10 |r|."""
    others, outlier = misses(reach(loss, 10.0 if loss == "smooth-abs" else 10.0 / width, width=width))
    assert others.max() < 2.0 * width and outlier > 6.0


def test_the_quadratic_loss_follows_the_outlier():
    others, outlier = misses(reach("quadratic"))
    assert others.max() > 1.5 and outlier < 3.0
