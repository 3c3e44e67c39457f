"""The camera: a view in which a whole motion is visible."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjslq.validation import Array

FIELD_OF_VIEW = np.deg2rad(32.0)
"""Vertical; narrow, so that parallel edges stay nearly parallel. [rad]"""


@dataclass(frozen=True)
class View:
    """A pose of the camera."""

    position: Array
    """Shape (3,). [m]"""
    look_at: Array
    """Shape (3,). [m]"""


def fit(low: Array, high: Array, aspect: float, margin: float = 0.8) -> View:
    """Return the view in which the box `low` ... `high` (3,) [m] fills `margin` of a window of width / height `aspect`.

    The camera looks across the longer horizontal side of the box, from slightly above.
    """
    centre, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-3)
    away = np.array([0.80, 0.52, 0.34]) if half[1] > 1.2 * half[0] else np.array([0.52, -0.80, 0.34])
    forward = -away / np.linalg.norm(away)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    tall = np.tan(FIELD_OF_VIEW / 2) * margin
    across, along = np.abs(corners @ right) / (tall * aspect), np.abs(corners @ up) / tall
    distance = float(np.max(np.maximum(across, along) - corners @ forward))
    return View(centre - distance * forward, centre)
