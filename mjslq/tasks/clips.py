"""The clips that a task file names, read once."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mjslq.clips import Clip, load
from mjslq.tasks.reading import Source
from mjslq.tasks.schema import ClipCost, TaskFile

Clips = Mapping[str, Clip]
"""Clips by what the task file calls their files."""


def read(task: TaskFile, folder: Path, source: Source) -> Clips:
    """Read all clips of a task file in `folder`. Raises `TaskError`."""
    places: dict[str, tuple[str | int, ...]] = {
        cost.file: ("costs", i, "file") for i, cost in enumerate(task.costs) if isinstance(cost, ClipCost)
    }
    if task.start.clip is not None:
        places.setdefault(task.start.clip, ("start", "clip"))
    found = {}
    for name, place in places.items():
        with source.at(*place):
            found[name] = load(folder / Path(name).expanduser())
    return found


def tracked(cost: ClipCost, clips: Clips) -> Clip:
    """The clip of a cost, its frames called as in the model. Raises ValueError."""
    clip = clips[cost.file]
    return clip if cost.names is None else clip.renamed(cost.names)
