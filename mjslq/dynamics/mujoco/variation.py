"""A `MujocoDynamics` whose steps are stretched, and numbers in whose model change; the user's model never does.

A parameter is a quantity of the model, "kind/name/field" or "kind/name/field/index" as in `model.body("pole").mass[0]`:
"body/pole/mass", "joint/hinge/damping", "geom/foot/friction/0", "actuator/motor/gainprm/0"; or a pair (set, value) of
a function set(model, value) that writes what belongs together, and the value that the model has as it is.

Other parameters make another model: a copy of the given one, on which `set` is called and whose constants MuJoCo
computes anew (mj_setConst). Another step length is written into the engine's own copy. It changes the model where
MuJoCo's own rules do: contacts and limits have no time constant below two steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np

from mjslq.dynamics.variation import Variation
from mjslq.validation import Array, choose, finite

if TYPE_CHECKING:
    from mjslq.dynamics.mujoco.engine import MujocoDynamics

KINDS = {
    "body": "nbody", "joint": "njnt", "geom": "ngeom", "site": "nsite", "actuator": "nu", "tendon": "ntendon",
    "equality": "neq", "pair": "npair", "sensor": "nsensor",
}  # fmt: skip
"""What has quantities by name, and what its number is called."""
DERIVED = ("invweight0", "subtreemass", "M0", "acc0", "length0", "lengthspring")
"""What MuJoCo computes from the rest."""


class Field(NamedTuple):
    """A quantity of a model, by its place."""

    kind: str
    name: str
    field: str
    entry: int

    def write(self, model: Any, value: float) -> None:
        """Write the value."""
        self.of(model)[self.entry] = value

    def of(self, model: mujoco.MjModel) -> Any:
        """The array that it is an entry of."""
        return np.reshape(getattr(getattr(model, self.kind)(self.name), self.field), -1)


class Parameter(NamedTuple):
    """What sets a parameter, and what it is in the model as given."""

    set: Callable[[Any, float], object]
    value: float


def parameters_of(given: Mapping[str, Any] | None, model: mujoco.MjModel) -> dict[str, Parameter]:
    """Parameters by name, as a user wrote them down. Raises ValueError."""
    if given is not None and not isinstance(given, Mapping):
        raise ValueError(f"parameters must be a mapping from names to quantities, got {type(given).__name__}")
    found = {}
    for name, what in (given or {}).items():
        try:
            found[str(name)] = _parameter(what, model)
        except ValueError as error:
            raise ValueError(f"parameters[{name!r}]: {error}") from None
    return found


def _parameter(what: Any, model: mujoco.MjModel) -> Parameter:
    if isinstance(what, str):
        field = _field(what, model)
        return Parameter(field.write, float(field.of(model)[field.entry]))
    if isinstance(what, tuple) and len(what) == 2 and callable(what[0]):
        return Parameter(what[0], finite("its value", what[1]))
    raise ValueError(
        'must be a quantity such as "body/pole/mass", or a pair (set, value) with a function set(model, value), '
        f"got {what!r}"
    )


def _field(text: str, model: mujoco.MjModel) -> Field:
    parts = text.split("/")
    if len(parts) not in (3, 4):
        raise ValueError(f'must be "kind/name/field" or "kind/name/field/index", got {text!r}')
    kind, name, field = choose("kind of quantity", parts[0], KINDS), parts[1], parts[2]
    names = [getattr(model, kind)(i).name for i in range(getattr(model, KINDS[kind]))]
    view = getattr(model, kind)(choose(kind, name, [found for found in names if found]))
    arrays = [entry for entry in dir(view) if isinstance(getattr(view, entry, None), np.ndarray)]
    numbers = [entry for entry in arrays if getattr(view, entry).dtype.kind == "f" and entry not in DERIVED]
    array = np.reshape(getattr(view, choose(f"number of a {kind}", field, numbers)), -1)
    index = int(parts[3]) if len(parts) == 4 and parts[3].isdigit() else 0 if len(parts) == 3 else -1
    if not 0 <= index < array.size or (len(parts) == 3 and array.size > 1):
        first = "/".join((*parts[:3], "0"))
        raise ValueError(f"{text!r}: {field} has {array.size} entries; say which, such as {first!r}")
    return Field(kind, name, field, index)


class MujocoVariation(Variation):
    """See `Variation`."""

    def __init__(self, dynamics: MujocoDynamics, names: tuple[str, ...]) -> None:
        self.names, self._dynamics = names, dynamics
        self.nominal = np.array([dynamics.parameters[name].value for name in names])
        self._engines: dict[bytes, MujocoDynamics] = {}

    def at(self, stretch: float, values: Array) -> MujocoDynamics:
        """See `Variation.at`."""
        key = values.tobytes()
        engine = self._engines.pop(key, None)
        if engine is None:
            engine = self._made(values)
        while len(self._engines) > 2 * len(self.names):
            self._engines.pop(next(iter(self._engines)))
        self._engines[key] = engine  # the latest one last
        engine.retime(float(self._dynamics.model.opt.timestep) * stretch)
        return engine

    def __getstate__(self) -> dict[str, Any]:
        """Engines are made anew."""
        return vars(self) | {"_engines": {}}

    def _made(self, values: Array) -> MujocoDynamics:
        """An engine of its own, with these parameters."""

        def change(model: mujoco.MjModel) -> None:
            for name, value in zip(self.names, values, strict=True):
                self._dynamics.parameters[name].set(model, float(value))
            if self.names:
                mujoco.mj_setConst(model, mujoco.MjData(model))

        return self._dynamics.with_model(change)
