"""States and controls that a model names: its keyframes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjslq.validation import Array, choose

if TYPE_CHECKING:
    import mujoco

    from mjslq.manifold import StateSpace


class Keyframes:
    """What an engine with a MuJoCo model knows of its keyframes."""

    model: mujoco.MjModel
    space: StateSpace

    @property
    def keyframe_names(self) -> tuple[str, ...]:
        """Names of the model's keyframes."""
        return tuple(self.model.key(i).name or f"key{i}" for i in range(self.model.nkey))

    def keyframe(self, name: str) -> Array:
        """Look up the state of a keyframe. Shape (nx,).  Raises ValueError, which lists the names there are."""
        i = self._keyframe_index(name)
        return self.space.normalized(
            np.concatenate([self.model.key_qpos[i], self.model.key_qvel[i], self.model.key_act[i]])
        )

    def keyframe_control(self, name: str) -> Array:
        """Look up the controls of a keyframe. Shape (nu,).  Raises ValueError, which lists the names there are."""
        return np.array(self.model.key_ctrl[self._keyframe_index(name)])

    def _keyframe_index(self, name: str) -> int:
        return self.keyframe_names.index(choose("keyframe", name, self.keyframe_names))
