"""QP solvers on the first LQ problem of the train of carts, beside a Riccati sweep: Table II of GoPRONTO.

Notation
--------
    sparse       minimize over states and controls, the linearized dynamics as equality constraints
    condensed    states eliminated: minimize 1/2 U'H U + g'U,  H = R + S'Q S,  S the impulse response of the open loop

On an unstable train S has entries as large as the growth of a state over the horizon, so that H is beyond any condition
number that doubles can take: the reason why full condensing fails in the paper. The paper's solvers (qpOASES, qpDUNES,
HPIPM, OSQP, from acados) are compared as far as PyPI has them; one that is not installed is named as missing.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from mjslq import problems
from mjslq.lq.problem import LQProblem
from mjslq.lq.riccati import solve as sweep
from mjslq.reports.rows import Row
from mjslq.solvers.iterate import Iterate
from mjslq.validation import Array

GOOD = 1e-4
"""Relative error of the controls up to which a solver has solved the problem."""
CASES = ((2, 40), (2, 400), (10, 400))
"""Carts and steps."""
SHORT, LARGEST = 40, 1000
"""Steps over which the open loop does not grow much, and the most controls that are condensed: dense QPs are slow."""


class Quadratic(NamedTuple):
    """Minimize 1/2 z'P z + q'z subject to A z = b."""

    P: Any
    q: Array
    A: Any
    b: Array
    controls: slice
    """Where the controls are in z."""


def first_problem(carts: int, horizon: int = 400) -> LQProblem:
    """The LQ problem at the start, upright at rest."""
    problem = problems.get("cart_train", carts=carts, horizon=horizon, duration=0.02 * horizon)
    return Iterate(problem, problem.rollout(np.zeros((horizon, carts)))).gauss_newton


def sparse_form(lq: LQProblem) -> Quadratic:
    """States x_1 ... x_N, then controls."""
    N, nx, nu = lq.B.shape
    weights = sparse.block_diag([*lq.Q[1:], *lq.R], format="csc")
    dynamics = sparse.lil_matrix((N * nx, N * (nx + nu)))
    for n in range(N):
        rows = slice(n * nx, (n + 1) * nx)
        dynamics[rows, rows] = np.eye(nx)
        dynamics[rows, N * nx + n * nu : N * nx + (n + 1) * nu] = -lq.B[n]
        if n:
            dynamics[rows, (n - 1) * nx : n * nx] = -lq.A[n]
    slopes = np.concatenate([lq.q[1:].ravel(), lq.r.ravel()])
    return Quadratic(weights, slopes, dynamics.tocsc(), np.zeros(N * nx), slice(N * nx, None))


def condensed_form(lq: LQProblem) -> Quadratic:
    """Controls alone."""
    N, nx, nu = lq.B.shape
    S = np.zeros((N, nx, N * nu))
    S[0, :, :nu] = lq.B[0]
    for n in range(1, N):
        S[n] = lq.A[n] @ S[n - 1]
        S[n, :, n * nu : (n + 1) * nu] += lq.B[n]
    H = sum(Sn.T @ Qn @ Sn for Sn, Qn in zip(S, lq.Q[1:], strict=True))
    for n in range(N):
        H[n * nu : (n + 1) * nu, n * nu : (n + 1) * nu] += lq.R[n]
    g = lq.r.ravel() + sum(Sn.T @ qn for Sn, qn in zip(S, lq.q[1:], strict=True))
    none = sparse.csc_matrix((0, N * nu))
    return Quadratic(sparse.csc_matrix(0.5 * (H + H.T)), g, none, np.zeros(0), slice(None))


FORMS = {"sparse": sparse_form, "condensed": condensed_form}


def by_osqp(given: Quadratic) -> Array:
    """OSQP, first order."""
    import osqp

    solver = osqp.OSQP()
    solver.setup(
        sparse.triu(given.P, format="csc"), given.q, given.A, given.b, given.b, verbose=False, eps_abs=1e-7,
        eps_rel=1e-7, max_iter=20000,
    )  # fmt: skip
    return np.asarray(solver.solve(raise_error=False).x, dtype=np.float64)


def by_piqp(given: Quadratic) -> Array:
    """PIQP, interior point and proximal."""
    import piqp

    solver = piqp.SparseSolver()
    solver.setup(sparse.csc_matrix(given.P), given.q, sparse.csc_matrix(given.A), given.b)
    solver.solve()
    return np.asarray(solver.result.x, dtype=np.float64)


def by_clarabel(given: Quadratic) -> Array:
    """Clarabel, interior point."""
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.ZeroConeT(len(given.b))]
    P = sparse.triu(given.P, format="csc")
    return np.array(clarabel.DefaultSolver(P, given.q, given.A, given.b, cones, settings).solve().x)


def by_proxqp(given: Quadratic) -> Array:
    """ProxQP, proximal augmented Lagrangian."""
    from proxsuite import proxqp

    solver = proxqp.sparse.QP(len(given.q), len(given.b), 0)
    solver.settings.eps_abs = 1e-7
    solver.init(sparse.csc_matrix(given.P), given.q, sparse.csc_matrix(given.A), given.b, None, None, None)
    solver.solve()
    return np.asarray(solver.results.x, dtype=np.float64)


SOLVERS: dict[str, tuple[str, Callable[[Quadratic], Array]]] = {
    "OSQP": ("osqp", by_osqp),
    "PIQP": ("piqp", by_piqp),
    "Clarabel": ("clarabel", by_clarabel),
    "ProxQP": ("proxsuite", by_proxqp),
}
"""Name -> package, and how it is called."""


def rows(cases: tuple[tuple[int, int], ...] = CASES) -> Iterator[Row]:
    """Each solver on both forms: error of the controls, and time."""
    section = "Table II: QP solvers on the first LQ problem: error of the controls, seconds"
    for carts, horizon in cases:
        lq, of = first_problem(carts, horizon), f"{carts} carts, {horizon} steps"
        started = time.process_time()
        U = sweep(lq).U
        seconds = time.process_time() - started
        yield Row(section, f"{of}: one Riccati sweep", "-", f"the reference; {seconds:.2g} s", "-")
        for form, make in FORMS.items():
            if form == "condensed" and carts * horizon > LARGEST:
                continue
            with np.errstate(all="ignore"):
                given = make(lq)
            paper = "mostly succeed" if form == "sparse" else "fail"
            for name, (package, call) in SOLVERS.items():
                what = f"{of}: {name}, {form}"
                if importlib.util.find_spec(package) is None:
                    yield Row(section, what, paper, "-", f"skipped: {package} is not installed")
                    continue
                error, seconds = _measured(call, given, U)
                solved = error <= GOOD
                said = "reproduced" if solved is (form == "sparse") else "differs"
                if horizon <= SHORT:
                    said = "solved: over so short a time nothing grows much" if solved else "differs"
                yield Row(section, what, paper, f"{error:.0e}; {seconds:.2g} s" if solved else "fails", said)


def _measured(call: Callable[[Quadratic], Array], given: Quadratic, U: Array) -> tuple[float, float]:
    """Relative error of the controls, infinite where the solver gives up, and processor time."""
    started = time.process_time()
    try:
        with np.errstate(all="ignore"):
            z = call(given)
        error = float(np.linalg.norm(z[given.controls] - U.ravel()) / np.linalg.norm(U))
    except Exception:  # whatever a foreign solver raises for data that it cannot take
        error = np.inf
    return (error if np.isfinite(error) else np.inf), time.process_time() - started
