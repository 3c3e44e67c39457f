"""A `FunctionDynamics` whose steps are stretched and whose parameters change."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjslq.dynamics.variation import Variation
from mjslq.validation import Array

if TYPE_CHECKING:
    from mjslq.dynamics.function import FunctionDynamics


class FunctionVariation(Variation):
    """See `Variation`."""

    def __init__(self, dynamics: FunctionDynamics, names: tuple[str, ...]) -> None:
        self.names, self._dynamics = names, dynamics
        self._places = np.array([dynamics.parameter_names.index(name) for name in names], np.intp)
        self.nominal = dynamics.parameters[self._places]
        self._derivatives = dynamics.copied_derivatives()

    def __reduce__(self) -> tuple[type[FunctionVariation], tuple[FunctionDynamics, tuple[str, ...]]]:
        """Derivatives hold functions as they cannot travel."""
        return FunctionVariation, (self._dynamics, self.names)

    def at(self, stretch: float, values: Array) -> FunctionDynamics:
        """See `Variation.at`."""
        if stretch != 1.0 and self._dynamics.integrator == "map":
            raise ValueError('a map has no step length: free_time takes x\' = f, with an integrator, not "map"')
        parameters = self._dynamics.parameters.copy()
        parameters[self._places] = values
        for part in self._derivatives:
            part.under(parameters)
        return self._dynamics.changed(self._dynamics.dt * stretch, parameters, *self._derivatives)
