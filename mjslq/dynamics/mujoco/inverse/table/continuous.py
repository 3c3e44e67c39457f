"""A model whose integrator takes nothing implicitly, so that its step shows the continuous acceleration.

Euler without implicit damping: v_{n+1} = v + h a(q, v, act, u), act_{n+1} = act + h w(q, v, act, u)
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.table.plan import DYN, INT, OFF

_WITH_RATES = (int(DYN.mjDYN_NONE), int(DYN.mjDYN_INTEGRATOR), int(DYN.mjDYN_FILTER), int(DYN.mjDYN_MUSCLE))
"""Activations that an Euler step advances by h w."""


def is_runge_kutta(model: mujoco.MjModel) -> bool:
    """Whether the integrator is RK4."""
    return bool(model.opt.integrator == INT.mjINT_RK4)


def continuous_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of `model` with that step, and without limits of activations."""
    part = copy.copy(model)
    part.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    part.opt.disableflags |= int(OFF.mjDSBL_EULERDAMP)
    part.actuator_actlimited[:] = 0
    return part


def has_odd_activations(model: mujoco.MjModel) -> bool:
    """Whether activations do not advance by h w, or forces read the next, clipped one."""
    clipped_early = (np.asarray(model.actuator_actlimited) & np.asarray(model.actuator_actearly)).any()
    return bool(model.na and (not np.isin(model.actuator_dyntype, _WITH_RATES).all() or clipped_early))


def activation_ranges(model: mujoco.MjModel) -> np.ndarray:
    """Range that each activation is clipped to at the end of a step. Shape (na, 2)."""
    ranges = np.tile([-np.inf, np.inf], (model.na, 1))
    for i in range(model.nactuator):
        if model.actuator_actlimited[i]:
            first = model.actuator_actadr[i]
            ranges[first : first + model.actuator_actnum[i]] = model.actuator_actrange[i]
    return ranges
