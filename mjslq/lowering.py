"""Results of problems with free time or parameters: from the augmented system (`dynamics.augmented`) to the user's.

States, controls, gains, limits and multipliers lose what belongs to the values; these are `Result.unknowns`. The time
steps of the trajectory are those of the final time, and so is the scene's model.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from mjslq.dynamics.augmented import Augmented
from mjslq.problem import Problem
from mjslq.result import Result
from mjslq.time_costs import UNUSED
from mjslq.validation import Array


def lowered(result: Result, stated: Problem) -> Result:
    """The result of `stated.lifted` as one of `stated`; itself where that is the same problem."""
    system = stated.lifted.dynamics
    if stated.unknowns is None or not isinstance(system, Augmented):
        return result
    nu, ndx, at = system.inner.nu, system.inner.ndx, result.trajectory
    values = np.array(at.U[0, nu:])
    multipliers = {name: array for name, array in result.multipliers.items() if name != "controls"}
    if "controls" in result.multipliers:
        of_controls = result.multipliers["controls"]
        own: dict[str, Array] = {name: of_controls[0, nu + j : nu + j + 1] for j, name in enumerate(system.names)}
        multipliers = {"controls": of_controls[:, :nu]} | own | multipliers
    return dataclasses.replace(
        result,
        trajectory=system.stripped(at),
        gains=None if result.gains is None else np.ascontiguousarray(result.gains[:, :nu, :ndx]),
        lower=result.lower[:, :nu],
        upper=result.upper[:, :nu],
        multipliers=multipliers,
        cost_terms={label: cost for label, cost in result.cost_terms.items() if label != UNUSED},
        gradient=None if result.gradient is None else result.gradient[:, :nu],
        iterates=tuple(system.stripped(trajectory) for trajectory in result.iterates),
        names={
            "states": tuple(system.inner.state_names),
            "controls": tuple(system.inner.control_names),
            "outputs": tuple(system.inner.output_names),
        },
        space=system.inner.space,
        scene=system.scene_at(values) if stated.drawing is None else stated.drawing,
        unknowns=dict(zip(system.names, map(float, values), strict=True)),
    )
