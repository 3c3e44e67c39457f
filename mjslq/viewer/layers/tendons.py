"""Spatial tendons, with their paths over sites and round geoms."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjslq.validation import Array
from mjslq.viewer.details import between, details
from mjslq.viewer.geometry import SHOWN_GROUPS
from mjslq.viewer.layers.layer import Layer, color_bytes, place_sticks
from mjslq.viewer.motion import Frame

_THINNEST = 0.002  # radius that can still be seen, in sizes of the model


class Tendons(Layer):
    """A stick for each straight piece of each tendon; where it lies on a geom half as thick, as MuJoCo draws it."""

    title = "Tendons"

    @staticmethod
    def offered(model: Any) -> bool:
        """Whether a model has any that can be drawn."""
        return bool(len(_drawn(model)))

    def _build(self) -> list[Any]:
        found, model = details(self._stage.model, self._moved), self._stage.model
        return [
            self._sticks(f"tendons/{tendon}", found.segments[tendon].shape[1], color_bytes(tendon_color(model, tendon)))
            for tendon in _drawn(model)
        ]

    def _pose(self, frame: Frame) -> None:
        model, found = self._stage.model, details(self._stage.model, frame.moved)
        for handle, tendon in zip(self._handles, _drawn(model), strict=True):
            segments, wrapped = found.segments[tendon], found.wrapped[tendon]
            number = len(handle.batched_positions)  # of a motion with fewer or more pieces at most
            pieces = np.zeros((number, 2, 3))
            now = between(frame, segments, wrapped)[:number]
            pieces[: len(now)] = now
            width = max(float(model.tendon_width[tendon]), _THINNEST * self._stage.length)
            radii = np.full(number, width)
            radii[: len(now)][wrapped[frame.nearest][:number]] *= 0.5
            place_sticks(handle, pieces, radii)


def tendon_color(model: Any, tendon: int) -> Array:
    """Colour of a tendon: its material's, or its own. Shape (3,)."""
    rgba, material = model.tendon_rgba[tendon], int(model.tendon_matid[tendon])
    own = material < 0 or not np.allclose(rgba, (0.5, 0.5, 0.5, 1.0))
    return np.array((rgba if own else model.mat_rgba[material])[:3], dtype=float)


def _drawn(model: Any) -> list[int]:
    """Spatial tendons in the groups that are shown; fixed ones have no path."""
    import mujoco

    spatial = [int(model.wrap_type[adr]) != mujoco.mjtWrap.mjWRAP_JOINT for adr in model.tendon_adr]
    return [
        tendon
        for tendon in range(model.ntendon)
        if spatial[tendon] and model.tendon_group[tendon] in SHOWN_GROUPS and model.tendon_rgba[tendon, 3] > 0.0
    ]
