"""Jacobians by differences of whole steps, for integrators that mjd_transitionFD refuses.

Notation
--------
    f, g              a step of the horizon, all its substeps included, and the outputs at its start
    e                 size of the differences
    x (+) d           a walk along the tangent direction d

    A_i = (f(x (+) e_i, u) (-) f(x (-) e_i, u)) / 2e, or (f(x (+) e_i, u) (-) f(x, u)) / e; B, C, D likewise

Each column is one simulation of a step from every knot, on all threads. Every step starts from a clean mjData, so that
a knot's Jacobians do not depend on its neighbours. Controls next to a limit are moved to the inside only.
"""

from __future__ import annotations

import numpy as np

from mjslq.dynamics.dynamics import Linearization
from mjslq.dynamics.mujoco.simulator import Simulator
from mjslq.manifold import StateSpace
from mjslq.validation import Array


def step_differences(
    simulator: Simulator, space: StateSpace, limits: Array, X: Array, U: Array, eps: float, centered: bool
) -> Linearization:
    """Differentiate the steps from the knots X (N + 1, nx) under U (N, nu); controls have limits (nu, 2)."""
    N, nu, ndx = len(U), U.shape[1], space.ndx
    F0, _, Y0 = simulator.step_each(X, U)
    ny = Y0.shape[1]
    result = Linearization(
        np.zeros((N, ndx, ndx)), np.zeros((N, ndx, nu)), np.zeros((N + 1, ny, ndx)), np.zeros((N + 1, ny, nu))
    )

    def ends(X: Array, U: Array) -> tuple[Array, Array]:
        F, _, Y = simulator.step_each(X, U)
        return space.difference(F0, F), Y

    here = np.zeros((N, ndx)), Y0
    for i in range(ndx):
        move = np.zeros(ndx)
        move[i] = eps
        F, Y = ends(space.integrate(X, move), U)
        F_, Y_ = ends(space.integrate(X, -move), U) if centered else here
        apart = 2.0 * eps if centered else eps
        result.A[:, :, i], result.C[:, :, i] = (F - F_) / apart, (Y - Y_) / apart
    for i in range(nu):
        up, down = _inside(U[:, i], limits[i], eps, centered)
        F, Y = ends(X, _moved(U, i, up))
        F_, Y_ = ends(X, _moved(U, i, -down)) if down.any() else here
        apart = np.maximum(up + down, 1e-300)[:, None]
        result.B[:, :, i], result.D[:-1, :, i] = (F - F_) / apart, (Y - Y_)[:-1] / apart
    return result


def _inside(u: Array, limits: Array, eps: float, centered: bool) -> tuple[Array, Array]:
    """How far each control is moved up and down: not beyond a limit, which is a kink. Shapes (N,)."""
    up = np.where(u + eps <= limits[1], eps, 0.0)
    down = np.where((u - eps >= limits[0]) & (centered | (up == 0.0)), eps, 0.0)
    return up, down


def _moved(U: Array, i: int, by: Array) -> Array:
    """`U` with control i moved."""
    U = U.copy()
    U[:, i] += by
    return U
