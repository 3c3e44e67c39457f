"""`solve_many`: many problems on an executor; an error in one of them does not affect the others.

    problems --(at most `in_flight` at a time)--> executor --> Solved, one by one --> files in `out`

Any `concurrent.futures.Executor` serves: threads, processes, `distributed.Client(...).get_executor()` of Dask, or
`executors.RayExecutor`. Without one, processes are started anew (spawn), each with one thread in its engines; a process
that dies takes only its own problem along: those that were under way are tried again, one at a time.

Results are written by the process that calls, whole or not at all, as soon as they come; with the same folder a second
call takes up where the first one was killed. A file counts only if it belongs to the problem: same start, same
options, and states and cost that its controls give again.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import math
import multiprocessing
import os
import re
import signal
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sized
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from concurrent.futures import ProcessPoolExecutor as Processes
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjslq.cores import usable_cores
from mjslq.files import atomic_write
from mjslq.options import check
from mjslq.problem import Problem
from mjslq.result import Result, load
from mjslq.status import Status
from mjslq.validation import choose, count, describe

IN_FLIGHT = 64
"""Problems handed to an executor that was given, at most, before one of them is done."""
SAME = 1e-6
"""Relative difference of states and costs up to which a file belongs to a problem."""


@dataclass(frozen=True)
class Solved:
    """Outcome of one problem of `solve_many`."""

    index: int
    """Its place among the problems."""
    name: str
    """Its name."""
    result: Result | None
    """The result; None where there was an error."""
    error: str = ""
    """Traceback of the error, what happened to the process, or why a result could not be written; empty otherwise."""
    file: Path | None = None
    """Where the result is, with `out`; None where it could not be written."""
    resumed: bool = False
    """Whether it was read from the file of an earlier call."""

    @property
    def success(self) -> bool:
        """Whether the solve converged."""
        return self.result is not None and self.result.success


def solve_many(
    problems: Iterable[Problem],
    executor: Executor | None = None,
    *,
    method: str = "auto",
    out: str | os.PathLike[str] | None = None,
    ordered: bool = False,
    progress: bool = False,
    workers: int | None = None,
    in_flight: int | None = None,
    **options: Any,
) -> Iterator[Solved]:
    """Solve problems side by side; iterate over what comes of them.

    Parameters
    ----------
    problems : iterable of Problem
        May be a generator: problems are taken as there is room for them. They have to pickle, but for threads.
    executor : concurrent.futures.Executor
        Where to solve; it is not shut down. New processes unless given.
    method, **options
        As in `mjslq.solve`. Iterates are not kept unless `keep_iterates` is given.
    out : path
        Folder for the results, made if need be: 0000_hopper.npz, ..., and 0000_hopper.error.json for errors. Problems
        whose file is there already are not solved again; errors and interrupted solves are.
    ordered : bool
        Whether the results come in the order of the problems; as they end unless given.
    progress : bool
        Show a progress bar on standard error.
    workers : int
        Processes that are started where no executor is given; one per usable core unless given.
    in_flight : int
        Problems handed over before one of them is done, at most; one more than workers, or 64 with an executor.

    Returns
    -------
    iterator of Solved
        One for each problem. Leaving the iteration early cancels what has not begun.

    Raises
    ------
    ValueError
        At once for arguments out of range, unknown methods and options, and a folder that cannot be written to; during
        the iteration for a file in `out` that belongs to another problem.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> hops = (mjslq.problems.get("hopper", height=height) for height in (1.0, 2.0))
    >>> with ThreadPoolExecutor(2) as pool:
    ...     [solved.success for solved in mjslq.solve_many(hops, pool, ordered=True)]
    [True, True]
    """
    if executor is not None and not isinstance(executor, Executor):
        raise ValueError(f"executor must be a concurrent.futures.Executor, got {type(executor).__name__}")
    if executor is not None and workers is not None:
        raise ValueError("give either executor or workers, which is for the processes started without one")
    if isinstance(problems, Problem):
        raise ValueError("problems must be several, such as a list; for one there is mjslq.solve")
    if isinstance(problems, (str, Mapping)) or not isinstance(problems, Iterable):
        raise ValueError(f"problems must be several mjslq.Problem, such as a list, got {describe(problems)}")
    _refuse_options(method, options)
    workers = usable_cores() if workers is None else count("workers", workers)
    room = (workers + 1 if executor is None else IN_FLIGHT) if in_flight is None else count("in_flight", in_flight)
    folder = None if out is None else _folder(out)
    options.setdefault("keep_iterates", False)
    batch = _Batch(executor, workers, room, method, options, folder)
    found = batch.run(problems)
    if progress:
        found = _shown(found, len(problems) if isinstance(problems, Sized) else None)
    return _in_order(found) if ordered else found


class _Batch:
    """Problems under way, and what they are solved with."""

    def __init__(
        self, executor: Executor | None, workers: int, room: int, method: str, options: dict[str, Any], out: Path | None
    ) -> None:
        self.given, self.workers, self.room, self.out = executor, workers, room, out
        self.method, self.options = method, options
        self._own: Processes | None = None
        self._pending: dict[Future[Any], tuple[int, Problem]] = {}

    def run(self, problems: Iterable[Problem]) -> Iterator[Solved]:
        """Solve all, as they end."""
        coming, more, broken = enumerate(problems), True, None
        try:
            while more or self._pending:
                while more and len(self._pending) < self.room:
                    try:
                        following = next(coming, None)
                    except Exception as error:  # of a generator of theirs: what is under way is not to be lost
                        following, broken = None, error
                    if following is None:
                        more = False
                    elif (done := self._known(*following) or self._submit(*following)) is not None:
                        yield done
                if self._pending:
                    yield from self._collected()
            if broken is not None:
                raise broken
        finally:
            for future in self._pending:
                future.cancel()
            if self._own is not None:
                self._own.shutdown(wait=True, cancel_futures=True)

    def _collected(self) -> Iterator[Solved]:
        """Wait for some to end; try those again, one at a time, that were under way when a process of ours died."""
        done = wait(self._pending, return_when=FIRST_COMPLETED).done
        if self._own is not None and any(isinstance(_error(future), BrokenExecutor) for future in done):
            suspects = sorted(self._pending.items(), key=lambda item: item[1][0])
            self._pending.clear()
            self._own.shutdown(wait=True)
            self._own = None
            for future, (index, problem) in suspects:
                yield self._alone(index, problem) if _broken(future) else self._ended(future, index, problem)
            return
        for future in done:
            yield self._ended(future, *self._pending.pop(future))

    def _alone(self, index: int, problem: Problem) -> Solved:
        """Solve one problem in a process of its own."""
        with _processes(1) as pool:
            future = pool.submit(_solve_in_process, problem, self.method, self.options)
            wait([future])
        return self._ended(future, index, problem)

    def _submit(self, index: int, problem: Problem) -> Solved | None:
        """Hand a problem over; what came of it where that fails at once."""
        if not isinstance(problem, Problem):
            return self._failed(index, problem, f"problem must be a mjslq.Problem, got {describe(problem)}")
        if self.given is None and self._own is None:
            self._own = _processes(self.workers)
        executor = self.given or self._own
        assert executor is not None  # one of the two
        try:
            future = executor.submit(solve_one if self.given else _solve_in_process, problem, self.method, self.options)
        except Exception as error:  # an executor that is shut down, broken, or cannot pickle the problem
            return self._failed(index, problem, "".join(traceback.format_exception(error)))
        self._pending[future] = index, problem
        return None

    def _ended(self, future: Future[Any], index: int, problem: Problem) -> Solved:
        """What came of a problem, written to its file."""
        error = _error(future)
        if isinstance(error, BrokenExecutor):
            return self._failed(index, problem, f"the process that solved it died ({error})")
        if error is not None:
            return self._failed(index, problem, "".join(traceback.format_exception(error)))
        result: Result = future.result()
        file = self._file(index, problem)
        if file is not None:
            try:
                result.save(file)
            except ValueError as unwritten:  # a full disk: what was found is handed on all the same
                return Solved(index, problem.name, result, str(unwritten))
            _error_file(file).unlink(missing_ok=True)
        return Solved(index, problem.name, result, file=file)

    def _failed(self, index: int, problem: Problem, error: str) -> Solved:
        file, name = self._file(index, problem), str(getattr(problem, "name", "problem"))
        if file is not None:
            with contextlib.suppress(ValueError), atomic_write(_error_file(file)) as stream:
                stream.write(json.dumps({"index": index, "problem": name, "error": error}).encode())
        return Solved(index, name, None, error)

    def _known(self, index: int, problem: Problem) -> Solved | None:
        """The result of an earlier call; None where there is none. Raises ValueError where it is another problem's."""
        file = self._file(index, problem)
        if file is None or not file.is_file():
            return None
        result = load(file)
        if result.status is Status.INTERRUPTED:
            return None
        if differs := _difference(result, problem, self.method, self.options):
            raise ValueError(
                f"{file} belongs to another problem or other options ({differs}); give another folder, or remove it"
            )
        return Solved(index, problem.name, result, file=file, resumed=True)

    def _file(self, index: int, problem: Problem) -> Path | None:
        if self.out is None:
            return None
        return (
            self.out / f"{index:04d}_{re.sub(r'[^A-Za-z0-9._-]+', '_', str(getattr(problem, 'name', 'problem')))}.npz"
        )


def solve_one(problem: Problem, method: str, options: dict[str, Any]) -> Result:
    """Solve one problem, in a worker of the executor."""
    from mjslq.optimize import solve

    return solve(problem, method, **options)


def _solve_in_process(problem: Problem, method: str, options: dict[str, Any]) -> Result:
    """The same in a process of ours: on one thread, and Ctrl-C ends it with the best iterate."""
    problem.dynamics.limit_threads(1)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return solve_one(problem, method, options)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _refuse_options(method: str, options: Mapping[str, Any]) -> None:
    """Refuse methods and options that no problem is solved with, before anything is. Raises ValueError."""
    from mjslq.method_table import ALIASES, METHODS, settable
    from mjslq.optimize import solve

    choose("method", method, [*METHODS, *ALIASES])
    known, arguments = settable(method), inspect.signature(solve).parameters.values()
    others = [given.name for given in arguments if given.kind is given.KEYWORD_ONLY]
    for name in options:
        choose(f"option for method {method!r}", name, dict.fromkeys([*known, *others]))
    check({name: value for name, value in options.items() if name in known and value is not None})


def _difference(result: Result, problem: Problem, method: str, options: dict[str, Any]) -> str:
    """What tells that a result is not of this problem, solved so; empty where it is."""
    if method not in (result.method, "auto"):
        return f"method {result.method!r}, not {method!r}"
    own = {} if "preset" in options else dict(problem.options)
    if "tol" in options:  # it stands for both tolerances, the problem's own included
        own = {name: value for name, value in own.items() if not name.startswith("tol")}
        options = {"tol_gradient": options["tol"], "tol_direction": options["tol"]} | options
    asked = {name: value for name, value in (own | options).items() if name in result.options}
    for name, value in asked.items():
        if not np.array_equal(np.asarray(result.options[name]), np.asarray(value)):
            return f"{name} = {result.options[name]}, not {value}"
    X, U = result.trajectory.X, result.trajectory.U
    if U.shape != (problem.horizon, problem.dynamics.nu) or X.shape[1] != problem.dynamics.nx:
        return f"{U.shape[0]} steps of {X.shape[1]} states and {U.shape[1]} controls"
    if not np.array_equal(result.lower, problem.box.lower) or not np.array_equal(result.upper, problem.box.upper):
        return "other limits of the controls"
    names = () if problem.unknowns is None else problem.unknowns.names
    if tuple(result.unknowns) != names:
        return f"unknowns {', '.join(result.unknowns) or 'none'}, not {', '.join(names) or 'none'}"
    try:
        again = problem.fixed(result.unknowns).rollout(U)
    except ValueError as error:
        return str(error)
    at = result.trajectory.diverged_at
    near = np.allclose(again.X[:at], X[:at], rtol=SAME, atol=SAME * max(1.0, float(np.nanmax(np.abs(X)))))
    if again.diverged_at != at or not near:
        return "other states under the same controls"
    cost = problem.cost(again)
    if math.isfinite(cost) and not math.isclose(cost, result.cost, rel_tol=SAME, abs_tol=1e-12):
        return f"cost {result.cost:g}, not {cost:g}"
    return ""


def _processes(workers: int) -> Processes:
    return Processes(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)


def _begin() -> None:
    """Between problems Ctrl-C is for the process that calls."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _error(future: Future[Any]) -> BaseException | None:
    """The error of a future that is done; None for others."""
    if not future.done():
        return None
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _broken(future: Future[Any]) -> bool:
    return not future.done() or isinstance(_error(future), (BrokenExecutor, CancelledError))


def _error_file(file: Path) -> Path:
    return file.with_suffix(".error.json")


def _folder(out: str | os.PathLike[str]) -> Path:
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"cannot write to {folder}: {error.strerror or error}") from None
    if not os.access(folder, os.W_OK):
        raise ValueError(f"cannot write to {folder}: permission denied")
    return folder


def _in_order(found: Iterator[Solved]) -> Iterator[Solved]:
    waiting: dict[int, Solved] = {}
    following = 0
    for solved in found:
        waiting[solved.index] = solved
        while following in waiting:
            yield waiting.pop(following)
            following += 1


def _shown(found: Iterator[Solved], total: int | None) -> Iterator[Solved]:
    """The same with a progress bar on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("solving"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[told]}"),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task, converged = bar.add_task("solving", total=total, told=""), 0
        for n, solved in enumerate(found, 1):
            converged += solved.success
            bar.update(task, completed=n, told=f"{converged} converged, {n - converged} not")
            yield solved
