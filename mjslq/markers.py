"""Where a problem's costs want frames and sensors to be, for viewers to mark."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjslq.costs import CostTerm, Frame, Sensor
from mjslq.dynamics.dynamics import Dynamics
from mjslq.scene import Marker


def markers(costs: CostTerm | Sequence[CostTerm], dynamics: Dynamics) -> tuple[Marker, ...]:
    """A marker for each place in the world that is a frame's or a sensor's target, the same at all knots."""
    found: dict[tuple[float, ...], Marker] = {}
    for cost in [costs] if isinstance(costs, CostTerm) else costs:
        if not isinstance(cost, Frame | Sensor) or callable(cost.target):
            continue
        if cost.of != "position" if isinstance(cost, Frame) else cost.name not in dynamics.places:
            continue
        target = np.asarray(cost.target, dtype=float)
        if target.shape in ((), (3,)):
            position = tuple(float(p) for p in np.broadcast_to(target, 3))
            found.setdefault(position, Marker(cost.name, (position[0], position[1], position[2])))
    return tuple(found.values())
