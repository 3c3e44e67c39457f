"""Checks of what was read from the file of a result: kinds of values, and shapes that belong together.

A file that can be read may still be damaged, or made by hand. What is wrong is said in one sentence when it is loaded,
and not met later in a viewer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjslq.log import IterationLog
from mjslq.manifold import StateSpace
from mjslq.result import Result
from mjslq.scene import Scene
from mjslq.validation import Array, as_array, describe

_KINDS: dict[str, tuple[type, ...]] = {"str": (str,), "int": (int,), "float": (int, float), "dict": (dict,)}
"""Types that JSON makes of the annotations of plain fields."""


def checked(result: Result) -> Result:
    """Return `result` with its arrays as floats. Raises ValueError for fields that do not belong to its trajectory."""
    _check_plain(result, "")
    for i, entry in enumerate(result.log):
        _check_plain(entry, f"log[{i}].")
    N, nx = result.trajectory.horizon, result.trajectory.X.shape[1]
    _check_space(result.space, nx)
    ndx = nx if result.space is None else result.space.ndx
    limits = (N, result.trajectory.U.shape[1])
    arrays: dict[str, Any] = {
        name: as_array(name, getattr(result, name), limits, finite=False) for name in ("lower", "upper")
    }
    if not (arrays["lower"] <= arrays["upper"]).all():
        raise ValueError("lower must not lie above upper, and neither may be NaN")
    for name, shape in (("gains", (*limits, ndx)), ("gradient", limits)):
        if getattr(result, name) is not None:
            arrays[name] = as_array(name, getattr(result, name), shape, finite=False)
    _check_iterates(result)
    _check_names(result)
    if result.scene is not None:
        _check_scene(result.scene, nx)
    knots = {name: _indices(f"knots of {name!r}", given, N + 1) for name, given in result.knots.items()}
    violations = {
        name: as_array(f"violations of {name!r}", given, (N + 1,), finite=False)
        for name, given in result.violations.items()
    }
    multipliers = {name: _multipliers(name, given, result, knots) for name, given in result.multipliers.items()}
    return replace(result, **arrays, knots=knots, violations=violations, multipliers=multipliers)


def _check_plain(record: Result | IterationLog, where: str) -> None:
    """Check the fields that JSON holds, by their annotations."""
    for field in fields(record):
        kinds = _KINDS.get(str(field.type).partition("[")[0])
        value = getattr(record, field.name)
        if kinds is not None and (isinstance(value, bool) or not isinstance(value, kinds)):
            raise ValueError(f"{where}{field.name} must be of type {field.type}, got {describe(value)}")


def _check_space(space: StateSpace | None, nx: int) -> None:
    if space is None:
        return
    if space.nx != nx or not 0 <= space.ndx <= nx:
        raise ValueError(f"space must be that of {nx} states, got {space.nx} and {space.ndx} directions")
    if len(space.plain_x) != len(space.plain_dx):
        raise ValueError("space must have a direction for each entry that is a plain number")
    for part in space.parts:
        for name, size, given, most in (("x", part.group.nx, part.x, nx), ("dx", part.group.ndx, part.dx, space.ndx)):
            if given.ndim != 2 or given.shape[1] != size or given.min() < 0 or given.max() >= most:
                raise ValueError(f"space must name {size} entries of {name} for each group, 0 to {most - 1}")


def _check_iterates(result: Result) -> None:
    sizes = (result.trajectory.X.shape, result.trajectory.U.shape)
    for i, iterate in enumerate(result.iterates):
        if (iterate.X.shape, iterate.U.shape) != sizes:
            raise ValueError(f"iterates[{i}] must have shapes {sizes}, got {(iterate.X.shape, iterate.U.shape)}")


def _check_names(result: Result) -> None:
    trajectory = result.trajectory
    sizes = {"states": trajectory.X.shape[1], "controls": trajectory.U.shape[1], "outputs": trajectory.Y.shape[1]}
    for kind, names in result.names.items():
        if not all(isinstance(name, str) for name in names) or len(names) != sizes.get(kind, len(names)):
            raise ValueError(f"names of {kind} must be {sizes.get(kind, 'some')} texts, got {describe(names)}")


def _check_scene(scene: Scene, nx: int) -> None:
    if not isinstance(scene.name, str):
        raise ValueError(f"the scene's name must be a text, got {describe(scene.name)}")
    _indices("columns of the scene", np.asarray(scene.columns, np.int64), nx)
    if len(scene.lines) not in (0, len(scene.columns)):
        raise ValueError(f"the scene must have as many lines as columns, got {len(scene.lines)}")


def _indices(name: str, given: NDArray[Any], size: int) -> NDArray[np.int64]:
    """Whole numbers below a size, in a row."""
    if given.ndim != 1 or given.dtype.kind not in "iu" or (given.size and not 0 <= given.min() <= given.max() < size):
        raise ValueError(f"{name} must be whole numbers from 0 to {size - 1} in a row, got {describe(given)}")
    return given.astype(np.int64)


def _multipliers(name: str, given: Any, result: Result, knots: Mapping[str, NDArray[np.int64]]) -> Array:
    """Multipliers of the limits of the controls (N, nu), of an unknown (1,), or of a constraint at its knots (k, m)."""
    shape: tuple[int | str, ...] = (len(knots[name]) if name in knots else "k", "m")
    if name == "controls":
        shape = result.trajectory.U.shape
    elif name in result.unknowns:
        shape = (1,)
    return as_array(f"multipliers of {name!r}", given, shape, finite=False)
