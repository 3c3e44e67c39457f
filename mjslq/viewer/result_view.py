"""A result in the viewer: which of its iterates is shown, how it moves in the scene, and its signals."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.reports.units import model_from_mjb
from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.validation import Array, count
from mjslq.viewer import panels
from mjslq.viewer.drawing import Shown
from mjslq.viewer.framing import MovingBoxes
from mjslq.viewer.motion import Motion, motion
from mjslq.viewer.scene import SceneView
from mjslq.viewer.signals import Registry
from mjslq.viewer.tinted import TintedView, backdrop

if TYPE_CHECKING:
    import viser

_AFTERWARDS = {
    "accepted": ", then a step of {}",
    "rejected": ", then a trial that was rejected",
    "failed": ", then no step was found",
}


class ResultView:
    """One of the results that a player shows, on the player's clock."""

    def __init__(self, result: Result, label: str = "", color: str = "") -> None:
        """Prepare it; `label` and `color` tell it from others, both empty for a result alone."""
        self.result, self.label, self.color = result, label, color
        self.model: Any = None if result.scene is None else model_from_mjb(result.scene.model)
        self.registry = Registry(result, self.model)
        self.trajectory = result.trajectory
        self.iterate = nearest_iterate(result)
        self.visible = True
        self.view: SceneView | TintedView | None = None
        self.stage: SceneView | None = None
        """What has ground, light and camera, if this result drew it: its own view, or a backdrop for several."""
        self._ghosts: Motion | None = None
        self._boxes: MovingBoxes | None = None
        self._motion = lru_cache(maxsize=16)(self._iterate_motion)

    @property
    def duration(self) -> float:
        """Length of the motion. [s]"""
        return float(self.result.trajectory.times[-1])

    @property
    def shown(self) -> Shown:
        """What plots draw of it."""
        return Shown(self.result, self.trajectory, self.registry, self.color, self.label)

    def draw(self, server: viser.ViserServer, aspect: float, place: int, dark: bool = False) -> None:
        """Draw it: alone, or in its colour as one of several, the first of which, `place` 0, has ground and light."""
        if self.result.scene is None:
            return
        if not self.color:
            self.view = self.stage = SceneView(
                server, self.result.scene, self.trajectory, aspect, dark=dark, contact=self.result.contact
            )
            return
        if not place:
            self.stage = SceneView(server, backdrop(self.result.scene), self.trajectory, aspect, dark=dark)
        self.view = TintedView(server, self.model, place, _rgb(self.color))
        self.view.follow(self.moved())

    def close(self) -> None:
        """Forget what was drawn."""
        self.view, self.stage, self._ghosts = None, None, None

    def moved(self) -> Motion:
        """The motion that is shown."""
        if self.iterate is None or self.trajectory is self.result.trajectory:
            return self._of(self.result.trajectory)
        return self._motion(self.iterate)

    def show(self, time: float) -> None:
        """Put it where it is at `time` [s]."""
        if self.view is not None:
            if self._ghosts is not None:
                positions, wxyzs = self._ghosts.at(time)
                self.view.set_ghosts(positions[None], wxyzs[None])
            self.view.show(time)

    def show_iterate(self, index: int) -> None:
        """Show an iterate, the last one where there are fewer."""
        if not self.result.iterates:
            return
        self.iterate = min(index, len(self.result.iterates) - 1)
        self.trajectory = self.result.iterates[self.iterate]
        if self.view is not None:
            self.view.follow(self._motion(self.iterate))

    def set_ghosts(self, mode: str, number: int) -> None:
        """Show ghosts; see `Player.set_ghosts`."""
        self._ghosts = None
        if self.view is None:
            return
        if mode == "along":
            self.view.set_ghosts(*self.moved().spread(count("number", number)))
        elif mode == "off" or not self.iterate:
            self.view.clear_ghosts()
        else:
            self._ghosts = self._motion(self.iterate - 1 if mode == "previous" else 0)

    def set_visible(self, visible: bool) -> None:
        """Show or hide it in the scene, if it is one of several."""
        self.visible = visible
        if isinstance(self.view, TintedView):
            self.view.set_visible(visible)

    def set_trace(self, visible: bool) -> None:
        """Show or hide the paths of its outermost bodies, where it has them."""
        if self.view is not None:
            self.view.set_trace(visible)

    def set_offset(self, offset: Array) -> None:
        """Stand at `offset` (3,) [m]; the first result stays where it is."""
        if isinstance(self.view, TintedView):
            self.view.set_offset(offset)

    def extent(self) -> tuple[Array, Array] | None:
        """Corners (3,) and (3,) [m] of the box that its moving bodies fill over the whole motion; None without any."""
        if self.model is None:
            return None
        if self._boxes is None:
            self._boxes = MovingBoxes(self.model)
        return self._boxes.around(self.moved())

    def note(self) -> str:
        """What is told of the iterate shown: its cost, and the step that followed."""
        entry = self.entry
        if entry is None:
            return ""
        told = f"cost {panels.short(entry.cost)}"
        if self.label:
            return f"{self.label}: iteration {entry.iteration}, {told}"
        return told + _AFTERWARDS.get(entry.outcome, "").format(panels.short(entry.alpha))

    @property
    def entry(self) -> Any:
        """The log's entry of the iterate shown; None where there is none."""
        log = self.result.log
        return log[self.iterate] if self.iterate is not None and self.iterate < len(log) else None

    def _iterate_motion(self, index: int) -> Motion:
        return self._of(self.result.iterates[index])

    def _of(self, trajectory: Trajectory) -> Motion:
        assert self.result.scene is not None
        return motion(self.model, self.result.scene, trajectory)


def nearest_iterate(result: Result) -> int | None:
    """Return the iterate that the result's trajectory is, or the last one; None when none was kept."""
    if not result.iterates:
        return None
    same = [i for i, t in enumerate(result.iterates) if np.array_equal(t.U, result.trajectory.U)]
    return same[-1] if same else len(result.iterates) - 1


def _rgb(color: str) -> tuple[float, float, float]:
    """Red, green and blue of a colour as "#rrggbb"."""
    r, g, b = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return r, g, b
