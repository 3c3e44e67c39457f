"""Executors by name, for the command line, and one for Ray, which has none of its own.

processes    concurrent.futures.ProcessPoolExecutor, started by `solve_many` itself
threads      concurrent.futures.ThreadPoolExecutor
dask         the executor of a Dask cluster: that at `address`, or one on this machine (pip install "mjslq[dask]")
ray          `RayExecutor` on a Ray cluster, found in the same way (pip install "mjslq[ray]")
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from mjslq.validation import choose

KINDS = ("processes", "threads", "dask", "ray")


@contextmanager
def open_executor(kind: str, workers: int | None = None, address: str | None = None) -> Iterator[Executor | None]:
    """An executor for the time of the context; None for processes, which `solve_many` starts itself.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    workers : int
        Threads, or processes of a cluster on this machine; as many as usual there unless given.
    address : str
        Of a running cluster; for dask and ray.

    Raises ValueError for an unknown kind, for an address where there is no cluster, and for packages that are missing.
    """
    choose("executor", kind, KINDS)
    if address is not None and kind in ("processes", "threads"):
        raise ValueError(f"an address belongs to the executors dask and ray, not to {kind!r}")
    if address is not None and workers is not None:
        raise ValueError("give either address or workers: a running cluster has workers of its own")
    if kind == "processes":
        yield None
    elif kind == "threads":
        with ThreadPoolExecutor(workers) as executor:
            yield executor
    elif kind == "dask":
        distributed = _needed("distributed", "dask")
        where = {"address": address} if address else {"n_workers": workers, "threads_per_worker": 1}
        with distributed.Client(**where) as client:
            yield client.get_executor()
    else:
        with RayExecutor(workers, address) as executor:
            yield executor


class RayExecutor(Executor):
    """Ray's tasks behind the interface of `concurrent.futures`.

    Starts Ray on this machine, with `workers` processors, or connects to the cluster at `address`, unless a connection
    stands already; ends what it began. Raises ValueError where Ray is not installed.
    """

    def __init__(self, workers: int | None = None, address: str | None = None) -> None:
        self._ray = _needed("ray", "ray")
        self._began = not self._ray.is_initialized()
        if self._began:
            where = {"address": address} if address else {"num_cpus": workers, "include_dashboard": False}
            self._ray.init(log_to_driver=False, **where)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """See `concurrent.futures.Executor.submit`."""
        future: Future[Any] = self._ray.remote(fn).remote(*args, **kwargs).future()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Disconnect, where this executor has connected."""
        if self._began:
            self._ray.shutdown()
            self._began = False


def _needed(package: str, extra: str) -> Any:
    try:
        return importlib.import_module(package)
    except ImportError:
        raise ValueError(
            f'the executor {extra!r} needs the package {package}; install it with: pip install "mjslq[{extra}]"'
        ) from None
