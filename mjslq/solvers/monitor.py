"""What watches a solve: the table on the screen, the callback, the log and the iterates kept."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TextIO

from mjslq.compiling import CompileClock
from mjslq.log import IterationLog
from mjslq.trajectory import Trajectory


@dataclass
class Monitor:
    """Keeps the log of a solve and tells of it."""

    verbose: int = 0
    callback: Callable[[IterationLog], object] | None = None
    watcher: Callable[[IterationLog, Trajectory], object] | None = None
    keep_iterates: bool = True
    stream: TextIO = field(default_factory=lambda: sys.stdout)
    compiling: CompileClock = field(default_factory=CompileClock)
    log: list[IterationLog] = field(default_factory=list)
    steps: int = 0
    """Steps taken; rejected trials do not count."""
    iterates: list[Trajectory] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)

    def record(self, entry: IterationLog, trajectory: Trajectory) -> bool:
        """Keep an entry, print it, tell watcher and callback; True when one of them asks to stop."""
        self.log.append(entry)
        self.steps += entry.outcome == "accepted"
        if self.keep_iterates:
            self.iterates.append(trajectory)
        if (len(self.log) - 1) % 20 == 0:
            self.say(_HEADER)
        self.say(_line(entry))
        stop = bool(self.watcher is not None and self.watcher(entry, trajectory))
        return bool(self.callback is not None and self.callback(entry)) or stop

    def say(self, line: str) -> None:
        """Print a line if `verbose`; a stream that cannot be written to any more ends that, and not the solve."""
        if self.verbose:
            try:
                print(line, file=self.stream, flush=True)
            except (OSError, ValueError):  # the reader of a pipe has gone, the disk is full, the file was closed
                self.verbose = 0

    @property
    def seconds(self) -> float:
        """Wall time since the solve began, without that spent on compiling. [s]"""
        return time.perf_counter() - self.started - self.compiling.seconds


_TITLES = (
    ("it", 4),
    ("cost", 16),
    ("|gradient|", 10),
    ("|direction|", 11),
    ("step", 8),
    ("rollouts", 8),
    ("time [s]", 8),
)
_HEADER = "  ".join(f"{title:>{width}}" for title, width in _TITLES)


def _line(e: IterationLog) -> str:
    taken = (
        f"{e.alpha:.2g}" if e.outcome == "accepted" else {"rejected": "rejected", "failed": "none"}.get(e.outcome, "-")
    )
    norms = f"{e.gradient_norm:>10.2e}  {e.direction_norm:>11.2e}"
    return f"{e.iteration:>4}  {e.cost:>16.9g}  {norms}  {taken:>8}  {e.evaluations or '-':>8}  {e.seconds:>8.3f}"
