"""What the kernel has to know about bodies in a fluid: the pieces that the fluid acts on, and their coefficients."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.inverse.table.plan import GEOM, OFF, disabled


def fluid_table(model: mujoco.MjModel) -> dict[str, Any]:
    """Body, geom (-1: the body's box of inertia) and coefficients of each piece, in the terms of `fluid`."""
    bodies, geoms, numbers = [], [], []
    still = disabled(model, OFF.mjDSBL_SPRING) and disabled(model, OFF.mjDSBL_DAMPER)
    for b in range(1, model.nbody) if in_fluid(model) and not still else ():
        if model.body_mass[b] < mujoco.mjMINVAL:
            continue
        own = [model.body_geomadr[b] + k for k in range(model.body_geomnum[b])]
        shaped = [g for g in own if model.geom_fluid[g, 0] > 0]
        bodies += [b] * max(len(shaped), 1)
        geoms += shaped or [-1]
        numbers += [_ellipsoid(model, g) for g in shaped] or [_box(model, b)]
    return {
        "nfluid": len(bodies), "fluid_body": np.array(bodies, np.int64), "fluid_geom": np.array(geoms, np.int64),
        "fluid_prm": np.array(numbers, float).reshape(-1, columns.FLUID_NUMBERS), "wind": model.opt.wind,
        "symmetric": int(model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
    }  # fmt: skip


def in_fluid(model: mujoco.MjModel) -> bool:
    """Whether the world is filled with a fluid."""
    return bool(model.opt.density > 0 or model.opt.viscosity > 0)


def _box(model: mujoco.MjModel, b: int) -> Any:
    """Linear and quadratic coefficients of torques and forces on the box that has a body's inertia."""
    inertia, density, viscosity = model.body_inertia[b], model.opt.density, model.opt.viscosity
    x, y, z = (np.sqrt(max(mujoco.mjMINVAL, inertia.sum() - 2.0 * own) / model.body_mass[b] * 6.0) for own in inertia)
    diameter = (x + y + z) / 3.0
    linear = np.pi * viscosity * diameter * np.repeat([diameter**2, 3.0], 3)
    turning = np.array([x * (y**4 + z**4), y * (x**4 + z**4), z * (x**4 + y**4)]) / 64.0
    quadratic = density * np.concatenate([turning, 0.5 * np.array([y * z, x * z, x * y])])
    return np.pad(np.concatenate([linear, quadratic]), (0, columns.FLUID_NUMBERS - 12))


def _ellipsoid(model: mujoco.MjModel, g: int) -> Any:
    """Coefficients of the ellipsoid that stands for a geom, in the order of columns.FLUID_*."""
    density, viscosity = model.opt.density, model.opt.viscosity
    _, blunt, slender, angular, kutta, magnus = model.geom_fluid[g, :6]
    r = _semiaxes(model, g)
    low, middle, high = np.sort(r)
    sphere = 2.0 / 3.0 * r.sum()
    greater = np.array([max(r[1], r[2]), max(r[2], r[0]), max(r[0], r[1])])
    moments, most = 8.0 / 15.0 * np.pi * r * greater**4, 8.0 / 15.0 * np.pi * middle * high**4
    return np.concatenate([
        np.array([r[1] * r[2], r[2] * r[0], r[0] * r[1]]) ** 2,
        density * model.geom_fluid[g, 6:9], density * model.geom_fluid[g, 9:12],
        angular * moments + slender * (most - moments),
        [
            magnus * density * 4.0 / 3.0 * np.pi * low * middle * high, kutta * density, density * (blunt - slender),
            density * slender * np.pi * high * middle, viscosity * 3.0 * np.pi * sphere,
            viscosity * np.pi * sphere**3, density,
        ],
    ])  # fmt: skip


def _semiaxes(model: mujoco.MjModel, g: int) -> Any:
    size = model.geom_size[g]
    kind = model.geom_type[g]
    if kind == GEOM.mjGEOM_SPHERE:
        return np.repeat(size[0], 3)
    if kind == GEOM.mjGEOM_CAPSULE:
        return np.array([size[0], size[0], size[1] + size[0]])
    if kind == GEOM.mjGEOM_CYLINDER:
        return np.array([size[0], size[0], size[1]])
    return np.array(size)
