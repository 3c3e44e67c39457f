"""The demo of clip tracking compares like with like: its differences are Jacobians of the same steps."""

import runpy
from pathlib import Path

import numpy as np

import mjslq

DEMO = Path(__file__).parent.parent / "demos" / "clip_tracking.py"


def test_differences_are_those_of_the_same_steps():
    """In smooth contact one-sided differences are good to about 1e-4; at kinks, at few knots, to less."""
    made = mjslq.problems.get("g1_clip", horizon=6, drive="motor")
    names = runpy.run_path(str(DEMO))
    theirs = names["Differences"].from_model(made.dynamics.model, substeps=2, threads=1)
    along = made.rollout(made.U0)
    for ours, other in zip(made.dynamics.linearize(along), theirs.linearize(along), strict=True):
        assert ours.shape == other.shape
        error = np.abs(ours - other).max(axis=(1, 2)) / max(np.abs(ours).max(), 1e-9)
        assert np.median(error) < 1e-3


def test_iterations_are_counted_over_all_plans():
    names = runpy.run_path(str(DEMO))
    made = mjslq.problems.get("cart_pole", horizon=50, duration=2.0, running=10.0)
    mpc = names["Timed"](made, iterations=4, replan_every=5)
    mpc.run(duration=0.8)
    assert mpc.statistics.plans == 4 and 4 < mpc.iterations <= 16 and mpc.spent > 0.0
