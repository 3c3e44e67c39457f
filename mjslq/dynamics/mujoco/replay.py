"""Results of MuJoCo models simulated again, from what a result holds: with other contacts, for instance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjslq.contact import Contact, Replay
from mjslq.dynamics.dynamics import Feedback
from mjslq.dynamics.mujoco import contacts
from mjslq.dynamics.mujoco.engine import MujocoDynamics

if TYPE_CHECKING:
    import mujoco

    from mjslq.result import Result


def penetration(result: Result) -> float:
    """Largest depth of a contact along the trajectory of a result. [m]"""
    return contacts.penetration(_model(result), result.trajectory.X)


def replay(result: Result, contact: Contact, feedback: bool) -> Replay:
    """See `Result.replay`."""
    model, plan = _model(result), result.trajectory
    substeps = max(1, round(float(np.asarray(plan.dt)[0]) / float(model.opt.timestep)))
    dynamics = MujocoDynamics(model, substeps=substeps, contact=contact)
    law = None
    if feedback and result.gains is not None:
        law = Feedback(plan.X, result.gains, result.lower, result.upper)
    trajectory = dynamics.rollouts(plan.X[:1], np.array(plan.U[None]), law)[0]
    deviation = dynamics.difference(plan.X, trajectory.X)
    return Replay(trajectory, contact, contacts.penetration(model, trajectory.X), np.abs(deviation))


def _model(result: Result) -> mujoco.MjModel:
    """The model of the scene, with contacts as its engine was given them."""
    assert result.scene is not None
    return contacts.model_of_scene(result.scene.model)
