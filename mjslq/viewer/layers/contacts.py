"""Contact points and forces: a disc where two bodies touch, and an arrow for the force on the moving one.

The forces are those of mj_contactForce at the states and controls of the trajectory, computed once for each motion.
One scale serves a whole motion: the force that 80 % of its contacts stay below is a third of the model long, and no
arrow longer than three times that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mjslq.contact import Contact
from mjslq.dynamics.mujoco.contacts import ContactForces, contact_forces, with_contact
from mjslq.reports.units import length_unit
from mjslq.validation import Array
from mjslq.viewer.layers.layer import Layer, Stage, turn_z_to
from mjslq.viewer.motion import Frame, Motion

_USUAL, _SHARE = 0.3, 80.0  # of the model's size; percentile of the forces
_DISC, _SHAFT, _HEAD = 0.022, 0.006, 0.014  # radii, in sizes of the model
_LEAST = 1e-3  # of the largest force: below it nothing presses


@dataclass(frozen=True)
class _Presses:
    """Contacts that press, on the moving of the two bodies; rows beyond their number are zero."""

    positions: Array
    """Shape (n, k, 3). [m]"""
    normals: Array
    """Shape (n, k, 3)."""
    forces: Array
    """Shape (n, k, 3). [N]"""
    scale: float
    """Length of an arrow per force. [m/N]"""
    largest: float
    """[N]"""


class Contacts(Layer):
    """Contact points and force arrows at each time."""

    title = "Contact forces"
    hint = "Points of contact, and the forces on what moves"

    def __init__(self, stage: Stage, moved: Motion, visible: bool = False, contact: Contact | None = None) -> None:
        """Draw the contacts of a motion that was computed with some parameters of `contact`."""
        model = stage.model if contact is None else with_contact(stage.model, contact)
        self._physics = collidable(model)
        super().__init__(stage, moved, visible)

    @staticmethod
    def offered(model: Any, moved: Motion) -> bool:
        """Whether a motion has states that contact forces follow from, and anything could touch."""
        able = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        return moved.states is not None and (int(able.sum()) + model.nflex > 1 or model.npair > 0)

    @property
    def note(self) -> str:
        """What the length of arrows stands for."""
        if not self.visible:
            return ""
        presses = self._presses(self._moved)
        if presses.largest == 0.0:
            return "Nothing touches in this motion."
        unit = _round(0.25 * self._stage.length / presses.scale)
        length = length_unit(self._stage.model)
        newton = " N" if length == "m" else ""  # of a model in other units nobody knows it
        told = f"An arrow of {_length(unit * presses.scale, length)} is {unit:g}{newton}"
        return f"{told}; the largest force is {presses.largest:.3g}{newton}."

    def _build(self) -> list[Any]:
        scene, length, theme = self._stage.server.scene, self._stage.length, self._stage.theme
        self._arrows = scene.add_arrows(
            "/contacts/forces",
            np.zeros((0, 2, 3), dtype=np.float32),
            theme.force,
            shaft_radius=_SHAFT * length,
            head_radius=_HEAD * length,
            head_length=2.2 * _HEAD * length,
        )
        vertices, faces = _disc()
        most = self._presses(self._moved).positions.shape[1]
        self._discs = self._batch(
            "contacts/points", vertices, faces, max(most, 1), theme.contact, cast_shadow=False, receive_shadow=False
        )
        return [self._arrows, self._discs]

    def _pose(self, frame: Frame) -> None:
        presses = self._presses(frame.moved)
        n, number = frame.nearest, len(self._discs.batched_positions)
        on = np.linalg.norm(presses.forces[n], axis=1) > _LEAST * max(presses.largest, 1e-12)
        positions, normals, forces = presses.positions[n][on], presses.normals[n][on], presses.forces[n][on]
        scale = self._presses(self._moved).scale or presses.scale
        ends = positions + np.minimum(scale, 3.0 * _USUAL * self._stage.length / _norms(forces))[:, None] * forces
        points = np.stack([positions, ends], axis=1).astype(np.float32)
        if points.shape != self._arrows.points.shape or not np.array_equal(points, self._arrows.points):
            self._arrows.points = points
            place, turn = np.zeros((number, 3), dtype=np.float32), np.zeros((number, 4), dtype=np.float32)
            size = np.zeros((number, 3), dtype=np.float32)
            k, turn[:, 0] = min(number, len(positions)), 1.0
            place[:k], turn[:k], size[:k] = positions[:k], turn_z_to(normals)[:k], _DISC * self._stage.length
            self._discs.batched_positions, self._discs.batched_wxyzs = place, turn
            self._discs.batched_scales = size

    def _presses(self, moved: Motion) -> _Presses:
        return moved.once("presses", lambda: self._find(moved))

    def _find(self, moved: Motion) -> _Presses:
        if moved.states is None:
            nothing = np.zeros((len(moved.times), 0, 3))
            return _Presses(nothing, nothing, nothing, 0.0, 0.0)
        found = contact_forces(self._physics, *moved.states)
        forces = np.nan_to_num(found.forces, posinf=0.0, neginf=0.0) * _signs(self._physics, found)[:, :, None]
        norms = np.linalg.norm(forces, axis=2)
        largest = float(norms.max(initial=0.0))
        usual = np.percentile(norms[norms > 0.01 * largest], _SHARE) if largest > 0.0 else 0.0
        scale = _USUAL * self._stage.length / usual if usual > 0.0 else 0.0
        return _Presses(found.positions, found.normals, forces, float(scale), largest)


def collidable(model: Any) -> Any:
    """The model with the collisions that its scene may have lost the boxes about parts of meshes for."""
    import copy

    import mujoco

    changed = copy.copy(model)
    changed.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    return changed


def _signs(model: Any, found: ContactForces) -> Array:
    """-1 where the first of two geoms moves and the second does not, 1 elsewhere. Shape (n, k)."""
    fixed = np.append(model.body_weldid[model.geom_bodyid] == 0, False)  # the last is that of flexes
    return np.where(fixed[found.geoms[:, :, 1]] & ~fixed[found.geoms[:, :, 0]], -1.0, 1.0)


def _disc() -> tuple[Array, Any]:
    """A flat cylinder of radius 1 across z."""
    turn = np.arange(20) * (2.0 * np.pi / 20.0)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    vertices = np.concatenate([np.column_stack([ring, np.full(20, z)]) for z in (-0.15, 0.15)] * 2)
    i, j = np.arange(20), (np.arange(20) + 1) % 20
    side = np.concatenate([np.stack([i, j, j + 20], axis=1), np.stack([i, j + 20, i + 20], axis=1)])
    top = np.stack([np.full(18, 60), 60 + np.arange(1, 19), 60 + np.arange(2, 20)], axis=1)
    bottom = np.stack([np.full(18, 40), 40 + np.arange(2, 20), 40 + np.arange(1, 19)], axis=1)
    return vertices, np.concatenate([side, top, bottom])


def _norms(forces: Array) -> Array:
    return np.maximum(np.linalg.norm(forces, axis=1), 1e-12)


def _round(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `value`."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-9)))


def _length(length: float, unit: str) -> str:
    return f"{100.0 * length:.2g} cm" if length < 1.0 and unit == "m" else f"{length:.2g} {unit}"
