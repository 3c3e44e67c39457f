"""Signals: everything of a result that is a curve over time, by name, with unit and limits.

    Registry(result, model).signals["knee · positions [rad]"]

What can be plotted, and from which fields of a result it comes:

    states                      X: positions, velocities by joint; limits are the ranges of the joints
    controls                    U: forces, torques, ... by actuator; limits are those the problem was solved with
    outputs                     Y: readings of the sensors
    constraints                 multipliers and violations by the constraint's name; bars where one is in force
    residuals of the cost       |r| of each term that acts along the motion: tracking errors
    multipliers of limits       one for each control
    costates, gradient          dJ/dx and dJ/du

A new kind of signal is one more entry in `series.MORE_KINDS`, and where `series.groups` finds its values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from mjslq.result import Result
from mjslq.viewer import series

SEPARATOR = " \u00b7 "
"""Between the label of a signal and its quantity, in its name."""


@dataclass(frozen=True)
class Signal:
    """One curve."""

    name: str
    """Label, quantity and unit; one signal a name."""
    label: str
    """Name of the joint, actuator, sensor or constraint."""
    unit: str
    """Unit; empty when unknown."""
    group: series.Group
    """A group that holds this signal alone."""


class Registry:
    """The signals of a result, by name and in groups."""

    def __init__(self, result: Result, model: Any = None) -> None:
        """Find them; `model` is that of the result's scene, for units and joint ranges."""
        self.signals: dict[str, Signal] = {}
        """By name, in the order of the lists that offer them."""
        self.groups: dict[str, list[str]] = {}
        """Names of the signals in each group, by the group's title."""
        self.first: list[str] = []
        """Titles of the groups to show first: one of each of `series.KINDS`."""
        for title, kind in (*series.KINDS, *series.MORE_KINDS):
            found = series.groups(result, kind, model)
            for number, group in enumerate(found):
                own = group.title if group.title.lower() != title.lower() else ""
                shown = self._unused(f"{title}: {own}" if own and own != kind else title)
                self.groups[shown] = [self._add(group, place) for place in range(len(group.labels))]
                if not number and (title, kind) in series.KINDS:
                    self.first.append(shown)

    def _add(self, group: series.Group, place: int) -> str:
        label, quantity = group.labels[place], group.title.partition(", ")[0]
        name, number = f"{label}{SEPARATOR}{quantity}", 1
        while name in self.signals:
            number += 1
            name = f"{label} ({number}){SEPARATOR}{quantity}"
        ends = None if group.ends is None else (group.ends[0][[place]], group.ends[1][[place]])
        alone = replace(group, columns=(group.columns[place],), labels=(label,), ends=ends)
        self.signals[name] = Signal(name, label, group.unit, alone)
        return name

    def _unused(self, title: str) -> str:
        number, found = 1, title
        while found in self.groups:
            number += 1
            found = f"{title} ({number})"
        return found
