"""What a viewer draws of a MuJoCo model."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from mjslq.scene import Scene


def drawn_scene(model: mujoco.MjModel, name: str) -> Scene:
    """What a viewer needs to draw `model`, and what saved results hold of it."""
    drawn = copy.copy(model)
    drawn.bvh_aabb[:] = 0.0  # half of a model with meshes, which only collisions read; zeros take no room in files
    data = np.empty(mujoco.mj_sizeModel(drawn), np.uint8)
    mujoco.mj_saveModel(drawn, None, data)
    return Scene(data.tobytes(), tuple(range(model.nq)), name)
