"""A `PinocchioDynamics` whose steps are stretched, and the derivative of its semi-implicit Euler step by that.

Notation
--------
    v+ = v + h a,  a = (M + h D)^-1 (S u - D v - c),  q+ = q (+) h v+          see `simulator`; h -> s h

    da/ds  = -h (M + h D)^-1 D a                    by two calls of the same forward dynamics
    dv+/ds = h a + h da/ds
    dq+/ds = J1 (h v+ + h dv+/ds)                   J1 the derivative of q (+) d by d
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

from mjslq.dynamics.variation import Variation
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.dynamics.pinocchio.engine import PinocchioDynamics
    from mjslq.dynamics.pinocchio.simulator import Simulator


class PinocchioVariation(Variation):
    """See `Variation`."""

    def __init__(self, dynamics: PinocchioDynamics) -> None:
        self._dynamics, self.nominal = dynamics, np.zeros(0)
        self._latest: PinocchioDynamics | None = None

    def at(self, stretch: float, values: Array) -> PinocchioDynamics:
        """See `Variation.at`."""
        dt = float(self._dynamics.dt) * stretch
        if self._latest is None or self._latest.dt != dt:
            self._latest = copy.copy(self._dynamics)  # without its memory
            self._latest.dt = dt
        return self._latest


def euler_by_stretch(simulator: Simulator, X: Array, U: Array) -> Array:
    """Derivatives of semi-implicit Euler steps by a factor on h, at one. Shape (N, 2 nv)."""
    model, body, h = simulator.model, simulator.body, simulator.h
    nq, nv, damping = model.nq, model.nv, simulator.damping
    S = np.empty((len(U), 2 * nv))
    for n, u in enumerate(U):
        q, v = X[n, :nq].copy(), X[n, nq:].copy()
        tau = -damping * v
        tau[simulator.actuated] += u
        body.accelerate(q, v, tau)
        a = body.acceleration.copy()
        by_s = np.zeros(nv)
        if damping.any():
            body.accelerate(q, v, tau - h * damping * a)
            by_s = body.acceleration - a
        change = h * (a + by_s)
        walk, rate = h * (v + h * a), h * (v + h * a + change)
        S[n, nv:], S[n, :nv] = change, rate
        if not simulator.plain:
            curved = simulator.curved
            S[n, curved] = simulator.walk_jacobians(q, walk)[1] @ rate[curved]
    return S
