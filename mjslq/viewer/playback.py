"""The clock of a viewer: the time shown, and how it runs; independent of Viser."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Playback:
    """Time of a motion that is played, paused, looped, and dragged by hand."""

    duration: float
    """Length of the motion. [s]"""
    time: float = 0.0
    """Time shown, in [0, duration]. [s]"""
    playing: bool = False
    """Whether time runs."""
    speed: float = 1.0
    """Seconds of motion per second of wall time."""
    loop: bool = True
    """Whether it starts again after the end."""
    rest: float = 0.7
    """How long a looped motion rests at its end. [s of wall time]"""
    _rested: float = 0.0

    def elapse(self, seconds: float) -> bool:
        """Let `seconds` of wall time pass; return whether the time shown has changed."""
        if not self.playing or seconds <= 0.0:
            return False
        if self.time >= self.duration:
            return self._at_end(seconds)
        self.time = min(self.time + seconds * self.speed, self.duration)
        self._rested = 0.0
        return True

    def _at_end(self, seconds: float) -> bool:
        if not self.loop:
            self.playing = False
            return False
        self._rested += seconds
        if self._rested < self.rest or self.duration <= 0.0:
            return False
        self.time, self._rested = 0.0, 0.0
        return True

    def toggle(self) -> None:
        """Play or pause; playing from the end starts over."""
        self.playing = not self.playing
        if self.playing and self.time >= self.duration:
            self.time, self._rested = 0.0, 0.0

    def seek(self, time: float) -> None:
        """Go to `time` [s] by hand, which pauses."""
        self.time = min(max(float(time), 0.0), self.duration)
        self.playing = False
