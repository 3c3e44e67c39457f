"""`Task`: a problem with its method and options, from a TOML file.

    task = mjslq.load_task("my_task.toml")
    result = task.solve(verbose=1)

`tasks.schema` lists what a file may hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjslq.tasks import engines
from mjslq.tasks.clips import read as read_clips
from mjslq.tasks.posing import Poser
from mjslq.tasks.reading import Source, TaskError, read
from mjslq.tasks.schema import TaskFile

if TYPE_CHECKING:
    from mjslq.problem import Problem
    from mjslq.result import Result
    from mjslq.validation import Array


@dataclass(frozen=True)
class Task:
    """A problem with its method, options and start, as a task file states them.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> text = '''
    ... model = "ur5"
    ... horizon = 20
    ... engine = { timestep = 0.01, armature = 0.01, self_contacts = false }
    ... costs = [{ kind = "control", weight = 1e-3 }, { kind = "velocities", weight = 1.0 }]
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "rest.toml")
    ...     _ = file.write_text(text)
    ...     task = mjslq.load_task(file)
    >>> task.method, task.problem.horizon
    ('auto', 20)
    """

    problem: Problem
    """The problem."""
    method: str
    """The method to solve it by."""
    options: dict[str, Any]
    """Options of the method."""
    guess: Array | None
    """Controls (N, nu) or states (N + 1, nx) to start from; the problem's own start if None."""

    def solve(self, method: str | None = None, **options: Any) -> Result:
        """Solve it; `method` and `options`, as `mjslq.solve` takes them, go before those of the file."""
        from mjslq.optimize import solve

        return solve(self.problem, method or self.method, **({"guess": self.guess} | self.options | options))


def load_task(path: str | Path) -> Task:
    """Read a task file, with paths relative to its folder.

    Parameters
    ----------
    path : str or path
        The file (.toml); `mjslq new MODEL` writes one to begin with, and `mjslq schema` prints what it may hold.

    Returns
    -------
    Task
        Its problem, method, options and start.

    Raises
    ------
    ValueError
        In one sentence with the line and the key, for what does not fit the file, the model or the method.

    Examples
    --------
    >>> mjslq.load_task("none.toml")
    Traceback (most recent call last):
        ...
    mjslq.tasks.reading.TaskError: task file 'none.toml' does not exist; `mjslq new MODEL` writes one to begin with
    """
    file, source = read(path)
    folder = Path(path).expanduser().absolute().parent
    clips = read_clips(file, folder, source)
    dynamics = engines.make(file, folder, source, clips)
    if dynamics.nu == 0:
        raise TaskError(source.sentence(("model",), f"{file.model} has no actuators, so there is nothing to optimize"))
    options = _options(file, source)
    poser = Poser(file, dynamics, source, clips)
    problem = poser.problem()
    return Task(problem, file.solve.method, options, poser.guess(problem))


def _options(file: TaskFile, source: Source) -> dict[str, Any]:
    """Options of [solve], checked as far as the method's record can."""
    from mjslq import method_table as table
    from mjslq.options import check
    from mjslq.validation import choose

    method, given = file.solve.method, file.solve.options
    with source.at("solve", "method"):
        choose("method", method, [*table.METHODS, *table.ALIASES])
    arguments = ("preset",)
    known = dict.fromkeys([*table.settable(method), *arguments])
    for name, value in given.items():
        with source.at("solve", name):
            choose(f"option of method {method!r}", name, known)
            if name not in arguments:
                check({name: value})
    return given
