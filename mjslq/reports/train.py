"""What an iteration of `slq`, `pronto` and `gopronto` costs on the train of carts, by the number of carts.

Times are processor times on one thread, of an iteration alone: that of a solve of some iterations less that of one,
so that gains made beforehand do not count. Memory is the peak resident size of a process of its own that does one
iteration, gains included.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from mjslq import problems
from mjslq.optimize import solve
from mjslq.problem import Problem

METHODS: dict[str, dict[str, Any]] = {
    "slq": {"method": "slq"},
    "pronto": {"method": "pronto"},
    "gopronto": {"method": "gopronto", "variant": "gradient"},
}
"""What is compared."""
HORIZON, STEP = 100, 0.02
ITERATIONS = {"slq": 5, "pronto": 5, "gopronto": 40}
"""So many that gains, which are made once, are a small part of the time."""
COUNTS = (2, 5, 10, 20, 50)
MORE = (*COUNTS, 100, 200)
"""Carts; the first-order method is measured with more of them."""
_CHILD = """
import resource
from mjslq.reports.train import METHODS, train
from mjslq.optimize import solve
solve(train(2), max_iterations=1, tol=0.0, **METHODS[{method!r}])
solve(train({carts}, {horizon}), max_iterations=1, tol=0.0, keep_iterates=False, **METHODS[{method!r}])
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:  # on Linux ru_maxrss is at least what the process that started this one had
    with open("/proc/self/status") as status:
        peak = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
except OSError:
    pass
print(peak)
"""


def train(carts: int, horizon: int = HORIZON) -> Problem:
    """A train with steps as long as those of the catalogue's."""
    return problems.get("cart_train", carts=carts, horizon=horizon, duration=STEP * horizon)


def milliseconds(method: str, carts: int, iterations: int | None = None) -> float:
    """Processor time of an iteration. [ms]"""
    problem, times = train(carts), []
    solve(train(1), max_iterations=1, **METHODS[method])  # compiling, and loading what is compiled
    for number in (1, 1 + (ITERATIONS[method] if iterations is None else iterations)):
        started = time.process_time()
        result = solve(problem, max_iterations=number, tol=0.0, keep_iterates=False, **METHODS[method])
        times.append((time.process_time() - started, len(result.log)))
    (short, few), (long, many) = times
    return 1e3 * (long - short) / max(many - few, 1)


def growth(method: str) -> dict[int, float]:
    """Milliseconds of an iteration by the number of carts."""
    return {carts: milliseconds(method, carts) for carts in (MORE if method == "gopronto" else COUNTS)}


def exponent(times: dict[int, float], least: int = 20) -> float:
    """The power of the number of carts with which times grow, from `least` carts on: a line through the logarithms."""
    carts, milli = (np.log([part[i] for part in times.items() if part[0] >= least]) for i in (0, 1))
    return float(np.polyfit(carts, milli, 1)[0])


def peak_memory(method: str, carts: int, horizon: int = HORIZON) -> float:
    """Peak resident size of a process that does one iteration. [MB]"""
    code = _CHILD.format(method=method, carts=carts, horizon=horizon)
    one_thread = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    child = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ, **one_thread}
    )
    return float(child.stdout.split()[-1]) / (1e6 if sys.platform == "darwin" else 1e3)


GROWTH: dict[str, Callable[[], dict[int, float]]] = {
    f"milliseconds of an iteration of {method} by the number of carts": partial(growth, method) for method in METHODS
}
"""What `mjslq bench` measures."""
