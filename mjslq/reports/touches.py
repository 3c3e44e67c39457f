"""Which geoms touch along a trajectory, for how long, how deep, and how often they come together and part."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjslq.dynamics.mujoco.contacts import model_of_scene
from mjslq.result import Result


@dataclass(frozen=True)
class Touch:
    """Two geoms that touch at some knots."""

    first: str
    """Name of a geom, or of the body that it belongs to."""
    second: str
    knots: int
    """At how many."""
    of: int
    """Knots in all."""
    depth: float
    """How deep they were in each other at most. [m]"""
    changes: int
    """How often they came together or parted."""

    def __str__(self) -> str:
        often = f", together or apart {self.changes} times" if self.changes else ""
        return f"{self.first} and {self.second} at {self.knots} of {self.of} knots, {1e3 * self.depth:.2f} mm{often}"


def touches(result: Result) -> list[Touch]:
    """Pairs of geoms that touch at knots of a result; none where its scene does not show the states."""
    assert result.scene is not None
    model, X = model_of_scene(result.scene.model), result.trajectory.X
    off = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    columns = np.asarray(result.scene.columns, dtype=np.int64)
    if model.opt.disableflags & off or len(columns) != model.nq or result.contact is None:
        return []
    data = mujoco.MjData(model)
    found: dict[tuple[str, str], tuple[NDArray[np.bool_], float]] = {}
    for n, x in enumerate(X):
        if not np.isfinite(x).all():
            break
        data.qpos[:] = x[columns]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        for i in range(data.ncon):
            contact = data.contact[i]
            if contact.dist <= 0.0:
                pair = (_name(model, int(contact.geom[0])), _name(model, int(contact.geom[1])))
                at, depth = found.setdefault(pair, (np.zeros(len(X), np.bool_), 0.0))
                at[n] = True
                found[pair] = (at, max(depth, -float(contact.dist)))
    return [
        Touch(*pair, int(at.sum()), len(X), depth, int(np.count_nonzero(np.diff(at))))
        for pair, (at, depth) in found.items()
    ]


def _name(model: mujoco.MjModel, geom: int) -> str:
    if geom < 0:
        return "a flex"
    return str(model.geom(geom).name or model.body(int(model.geom_bodyid[geom])).name or f"geom {geom}")
