"""Contact parameters of MuJoCo models, penetration along trajectories, and the model that linearizations foresee with.

Foresight
---------
    Before two bodies touch, none of their forces depends on where they are: derivatives are zero, and a search cannot
    know that there is something to push. With a foresight m > 0, `linearize` differentiates, at the states of the true
    rollout, the step of a model whose contacts begin at the distance m already,

        A_n, B_n = derivatives of f_m at (x_n, u_n),      x_{n+1} = f(x_n, u_n)   as ever

    with smooth contact of width m + w and a time constant sqrt(m / a), so soft that two bodies at touch part with an
    acceleration of about a, less than gravity (after arXiv 2506.14186, where such contacts are added to the backward
    pass of a differentiable simulator). f_m is stepped once from each knot, so that its
    derivatives are taken at a step of its own.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjslq.contact import Contact
from mjslq.dynamics.dynamics import Dynamics, Linearization
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

if TYPE_CHECKING:
    import mujoco

AT_TOUCH = 3.0
"""Acceleration a by which a contact that acts from a distance parts two bodies as they touch: less than gravity, so
that derivatives are not those of bodies that a floor throws into the air. [m/s^2]"""


def with_contact(model: mujoco.MjModel, contact: Contact) -> mujoco.MjModel:
    """The model with the parameters of all its contacts set; itself where they are to stay."""
    if contact.kind == "model":
        return model
    changed = copy.copy(model)
    for solref, solimp in ((changed.geom_solref, changed.geom_solimp), (changed.pair_solref, changed.pair_solimp)):
        solref[:], solimp[:] = contact.solref, contact.solimp
    return changed


def foreseeing(model: mujoco.MjModel, foresight: float) -> mujoco.MjModel:
    """The model whose contacts act from the distance `foresight` [m] on."""
    smooth = Contact("smooth")
    assert smooth.width is not None
    changed = with_contact(
        model, Contact("smooth", width=foresight + smooth.width, time_constant=float(np.sqrt(foresight / AT_TOUCH)))
    )
    changed.geom_margin[:] = np.maximum(changed.geom_margin, foresight)
    changed.geom_gap[:] = 0.0
    if changed.npair:
        changed.pair_margin[:], changed.pair_gap[:] = np.maximum(changed.pair_margin, foresight), 0.0
    return changed


def foreseen(foreseeing: Dynamics, trajectory: Trajectory) -> Linearization:
    """Derivatives of the steps of another engine from the knots of a trajectory."""
    X, U = trajectory.X, trajectory.U
    return foreseeing.linearize_steps(X, U, foreseeing.step_each(X, U)[0])


def penetration(model: mujoco.MjModel, X: Array) -> float:
    """Largest depth of a contact at the states `X` (N + 1, nx), up to the first that is not finite; 0 for none. [m]"""
    import mujoco

    if model.opt.disableflags & (mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT):
        return 0.0
    data, deepest = mujoco.MjData(model), 0.0
    for x in X:
        if not np.isfinite(x).all():
            break
        data.qpos = x[: model.nq]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            deepest = max(deepest, -float(data.contact.dist[: data.ncon].min()))
    return deepest


def model_of_scene(data: bytes) -> mujoco.MjModel:
    """A model read from a `Scene`, fit for collisions: without the boxes about parts of meshes that it may lack."""
    import mujoco

    model = mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": data})
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    return model


@dataclass(frozen=True)
class ContactForces:
    """Contacts and their forces at n states; rows beyond the contacts of a state are zero, with geoms -1."""

    count: NDArray[np.intp]
    """Contacts at each state. Shape (n,)."""
    positions: Array
    """Shape (n, k, 3). [m]"""
    normals: Array
    """From the first geom to the second. Shape (n, k, 3)."""
    forces: Array
    """On the second geom, in the world. Shape (n, k, 3). [N]"""
    geoms: NDArray[np.intp]
    """The two geoms; -1 for a flex. Shape (n, k, 2)."""


def contact_forces(model: mujoco.MjModel, X: Array, U: Array) -> ContactForces:
    """Contact forces, by mj_contactForce, at states `X` (n, nx) under controls `U` (n, nu)."""
    import mujoco

    data, found = mujoco.MjData(model), []
    wrench = np.zeros(6)
    for x, u in zip(X, U, strict=True):
        data.qpos, data.qvel = x[: model.nq], x[model.nq : model.nq + model.nv]
        data.act, data.ctrl = x[model.nq + model.nv :], u
        mujoco.mj_forward(model, data)
        rows = []
        for i in range(data.ncon):
            mujoco.mj_contactForce(model, data, i, wrench)
            axes = data.contact.frame[i].reshape(3, 3)
            rows.append((data.contact.pos[i].copy(), axes[0].copy(), wrench[:3] @ axes, data.contact.geom[i].copy()))
        found.append(rows)
    count = np.array([len(rows) for rows in found], dtype=np.intp)
    arrays = [np.zeros((len(found), max(count, default=0), 3)) for _ in range(3)]
    geoms = np.full((*arrays[0].shape[:2], 2), -1, dtype=np.intp)
    for n, rows in enumerate(found):
        for i, row in enumerate(rows):
            for array, value in zip(arrays, row, strict=False):
                array[n, i] = value
            geoms[n, i] = row[3]
    return ContactForces(count, arrays[0], arrays[1], arrays[2], geoms)
