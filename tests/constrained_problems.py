"""Problems with constraints whose optima are known, for the tests of methods that take constraints.

They are those of the catalogue, with the starts that the tests were written for.
"""

import numpy as np

from mjslq import problems
from mjslq.problems.reentry import nominal_angles as nominal_reentry  # noqa: F401


def starts(problem, seed, count=10):
    """Controls to start from: zeros first, then white noise and smooth curves up to the limits, in turns."""
    rng = np.random.default_rng(seed)
    lower, upper = problem.box
    nominal = np.asarray(problem.U0)
    low, high = np.where(np.isfinite(lower), lower, nominal - 5.0), np.where(np.isfinite(upper), upper, nominal + 5.0)
    N, nu = low.shape
    tau = np.arange(N)[:, None] / N
    found = [nominal]
    while len(found) < count:
        if len(found) % 2:
            share = rng.uniform(0.0, 1.0, (N, nu))
        else:
            share = 0.5 + 0.5 * np.sin(2.0 * np.pi * (rng.uniform(0.3, 2.0, nu) * tau + rng.uniform(0.0, 1.0, nu)))
        found.append(low + share * (high - low))
    return found


def bryson_denham(N=50, limit=0.1, force=np.inf):
    """A particle thrown at a wall that it must not pass `limit` of, back where it came from after a second."""
    force = force if np.isfinite(force) else 0.0
    return problems.get("bryson_denham", horizon=N, limit=limit, force=force, start=0.0)


def cart_pole(force=5.0, track=0.5):
    """A pole swung up from hanging to standing on a short track."""
    return problems.get("cart_pole_track", force=force, track=track)


def quadrotor():
    """A planar quadrotor that flies three metres past two discs, from rest to rest."""
    return problems.get("quadrotor_obstacles")


def car(discs=(1.0, 0.5, 0.35, 2.0, 1.3, 0.4, 1.3, 1.8, 0.4)):
    """A car that parks past three discs."""
    return problems.get("car_obstacles", discs=discs)


def reentry():
    """A lifting vehicle that returns from orbit to level flight within 5 g, near a nominal angle of attack."""
    return problems.get("reentry", variant="tracking")


def arm():
    """An arm of three links that swings its hand up past a disc."""
    return problems.get("arm_obstacle")
