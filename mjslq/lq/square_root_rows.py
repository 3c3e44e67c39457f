"""Rows of the constrained LQ problem: as a user states them, sorted by step for the kernels, and the initial state.

Notation is that of `lq.square_root`. The initial state x_0 = x_p + Z z solves, with G = [E; E_0] the hard rows on it,

    G x_p = [-v; d_0]   (least norm),   G Z = 0,   min over z of 1/2 |W x_0|^2 + p'x_0   (least norm)

both by singular values, once a solve.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mjslq.lq.householder import reflect_vector
from mjslq.lq.problem import NotPositiveDefinite
from mjslq.lq.square_root_matrices import DEPENDENT, Factors, Integers, SortedRows
from mjslq.lq.square_root_vectors import CONSISTENT
from mjslq.validation import Array, as_array

SINGULAR = 1e-13
"""Singular value, relative to the weights, below which the cost does not depend on a direction of x_0."""
NAMED = 1e-6
"""Share of the largest multiplier above which a row is said to take part in a contradiction."""


class PathRows(NamedTuple):
    """Rows H_i x_n + C_i u_n = d_i at the steps n = step_i, in any order."""

    step: ArrayLike
    """Steps, 0 to N - 1, of the rows. Shape (m,)."""
    H: ArrayLike | None
    """Coefficients of the state; None: zero. Shape (m, nx)."""
    C: ArrayLike | None
    """Coefficients of the control; None: zero. Shape (m, nu)."""
    d: ArrayLike
    """Right-hand sides. Shape (m,)."""
    scale: ArrayLike | None = None
    """Scale factors: 0 for a hard row, s > 0 for the cost (H x + C u - d)^2 / (2 s); None: zero. Shape (m,)."""


class StateRows(NamedTuple):
    """Rows H_i x = d_i on the initial or on the terminal state."""

    H: ArrayLike
    """Coefficients. Shape (m, nx)."""
    d: ArrayLike
    """Right-hand sides. Shape (m,)."""
    scale: ArrayLike | None = None
    """Scale factors as in `PathRows`. Shape (m,)."""


class Row(NamedTuple):
    """Place of a row."""

    kind: str
    """"path", "terminal" or "initial"."""
    number: int
    """Place among the rows of this kind; that of the component where the initial state is given."""
    step: int
    """Its step."""

    def __str__(self) -> str:
        return f"{self.kind} row {self.number} (step {self.step})"


class Infeasible(ArithmeticError):
    """Hard rows contradict each other."""

    def __init__(self, step: int, rows: list[Row], multipliers: Array) -> None:
        names = ", ".join(str(row) for row in rows[:8]) + (f" and {len(rows) - 8} more" if len(rows) > 8 else "")
        super().__init__(f"no trajectory meets all rows: from step {step} on these contradict each other: {names}")
        self.step = step
        """Step at which no state is left that meets the rows from there on."""
        self.rows = rows
        """The rows that contradict each other, by this combination."""
        self.multipliers = multipliers
        """Factors with which these rows add up to zero on the left, and not on the right."""


class Unbounded(NotPositiveDefinite):
    """The cost falls without bound along initial states that the rows leave free."""

    def __init__(self) -> None:
        ArithmeticError.__init__(self, "the cost has no minimum over the initial states that are free")
        self.step = 0


class Sorting(NamedTuple):
    """Path and terminal rows by step, apart by kind, and where they came from."""

    hard: SortedRows
    weighted: SortedRows
    d: Array
    """Right-hand sides, path rows before terminal rows. Shape (m,)."""
    paths: int
    """Number of path rows."""
    from_hard: Integers
    """Places of the hard rows in `d`."""
    from_weighted: Integers
    """Places of the weighted rows in `d`."""

    def right_side(self, path: ArrayLike | None, terminal: ArrayLike | None) -> Array:
        """`d` with the parts given put in."""
        d = self.d.copy()
        if path is not None:
            d[: self.paths] = as_array("path", path, (self.paths,))
        if terminal is not None:
            d[self.paths :] = as_array("terminal", terminal, (len(d) - self.paths,))
        return d

    def merged(self, hard: Array, weighted: Array) -> Array:
        """Numbers of hard and weighted rows, in the order of `d`."""
        merged = np.empty_like(self.d)
        merged[self.from_hard], merged[self.from_weighted] = hard, weighted
        return merged

    def violation(self, X: Array, U: Array, d_hard: Array) -> float:
        """Largest residual of a hard row over its norm."""
        H, C, _, start = self.hard
        step = np.repeat(np.arange(len(start) - 1), np.diff(start))
        rest = (H * X[step]).sum(axis=1) + (C * U[np.minimum(step, len(U) - 1)]).sum(axis=1) - d_hard
        return float(np.abs(rest / self._norms()).max(initial=0.0))

    def _norms(self) -> Array:
        """Norms of the hard rows; one for rows without coefficients."""
        norms = np.hypot(np.linalg.norm(self.hard.H, axis=1), np.linalg.norm(self.hard.C, axis=1))
        return np.where(norms > 0.0, norms, 1.0)

    def named(self, hard: Array) -> tuple[list[Row], Array]:
        """Rows with more than negligible multipliers, and these."""
        sizes = np.abs(hard) * self._norms()
        chosen = np.flatnonzero(sizes > NAMED * sizes.max(initial=0.0))
        rows = []
        for i in chosen:
            place, step = int(self.from_hard[i]), int(np.searchsorted(self.hard.start, i, side="right")) - 1
            is_path = place < self.paths
            rows.append(Row("path" if is_path else "terminal", place if is_path else place - self.paths, step))
        return rows, hard[chosen]


def sorted_rows(path: PathRows | None, terminal: StateRows | None, N: int, nx: int, nu: int) -> Sorting:
    """Check path and terminal rows, and sort them."""
    step, H, C, d, scale = _checked_path(path, N, nx, nu)
    H_end, d_end, scale_end = checked_state_rows("terminal", terminal, nx)
    step = np.concatenate([step, np.full(len(d_end), N)])
    H, d, scale = np.concatenate([H, H_end]), np.concatenate([d, d_end]), np.concatenate([scale, scale_end])
    C = np.concatenate([C, np.zeros((len(d_end), nu))])
    order = np.argsort(step, kind="stable")
    hard, weighted = order[scale[order] == 0.0], order[scale[order] > 0.0]

    def taken(rows: Integers) -> SortedRows:
        start = np.searchsorted(step[rows], np.arange(N + 2)).astype(np.int64)
        return SortedRows(H[rows], C[rows], scale[rows], start)

    return Sorting(taken(hard), taken(weighted), d, len(d) - len(d_end), hard, weighted)


def _checked_path(path: PathRows | None, N: int, nx: int, nu: int) -> tuple[Integers, Array, Array, Array, Array]:
    if path is None:
        return np.zeros(0, np.int64), np.zeros((0, nx)), np.zeros((0, nu)), np.zeros(0), np.zeros(0)
    given = np.asarray(path.step)
    if given.ndim != 1 or (given.size and given.dtype.kind not in "iu"):
        raise ValueError(f"path.step must be whole numbers of shape (m,), got {given.dtype} of shape {given.shape}")
    step, m = given.astype(np.int64), given.size
    if m and not (step.min() >= 0 and step.max() < N):
        wrong = int(step[(step < 0) | (step >= N)][0])
        raise ValueError(f"path.step must lie between 0 and {N - 1}, got {wrong}; rows on x_{N} are terminal rows")
    H = np.zeros((m, nx)) if path.H is None else as_array("path.H", path.H, (m, nx))
    C = np.zeros((m, nu)) if path.C is None else as_array("path.C", path.C, (m, nu))
    return step, H, C, as_array("path.d", path.d, (m,)), _checked_scale("path.scale", path.scale, m)


def checked_state_rows(name: str, rows: StateRows | None, nx: int) -> tuple[Array, Array, Array]:
    """H, d and scale factors."""
    if rows is None:
        return np.zeros((0, nx)), np.zeros(0), np.zeros(0)
    H = as_array(f"{name}.H", rows.H, ("m", nx))
    return H, as_array(f"{name}.d", rows.d, (len(H),)), _checked_scale(f"{name}.scale", rows.scale, len(H))


def _checked_scale(name: str, value: ArrayLike | None, m: int) -> Array:
    if value is None:
        return np.zeros(m)
    scale = as_array(name, value, (m,))
    if scale.size and scale.min() < 0.0:
        raise ValueError(f"{name} must not be negative, got {scale.min():.3g}: zero makes a row hard")
    return scale


def conflicting(hard: SortedRows, f: Factors, step: int, rest: Array) -> Array:
    """Multipliers of the hard rows with which those from `step` on add up to `rest` (in transformed rows) there."""
    multipliers, N = np.zeros(len(hard.scale)), len(f.K)
    w = rest
    for n in range(step, N + 1):
        carried = int(f.carried[n + 1]) if n < N else 0
        first, last = hard.start[n], hard.start[n + 1]
        rows = carried + last - first
        reflect_vector(f.V[n], f.h[n], int(f.pivots[n] + f.carried[n]), rows, w, True)
        w[:rows] *= f.norm[n, :rows]
        multipliers[first:last] = w[carried:rows]
        if n < N:
            following = np.zeros_like(w)
            following[f.pivots[n + 1] : f.pivots[n + 1] + carried] = w[:carried]
            w = following
    return multipliers


class InitialState(NamedTuple):
    """What is solved for at n = 0: x_0, psi_0 and the multipliers of the initial rows."""

    x: Array
    psi: Array
    nu: Array


class InitialStage(NamedTuple):
    """Rows on the initial state together with the cost-to-go there, factorized."""

    given: bool
    """Whether x_0 itself is given; H is the identity then."""
    H: Array
    d: Array
    scale: Array
    G: Array
    """Hard rows [E; H], of norm one."""
    norm: Array
    """Reciprocal norms."""
    U: Array
    s: Array
    Vt: Array
    """Singular values of G."""
    Z: Array
    """Basis of what they leave free."""
    t: Array
    Yt: Array
    """Singular values and right vectors of the weighted rows on it."""

    def right_side(self, d: ArrayLike | None) -> Array:
        """The right-hand side, x_0 where that is given."""
        return self.d if d is None else as_array("initial", d, self.d.shape)

    def solve(self, f: Factors, v: Array, p: Array, d: Array, variance: Array, slack: float) -> InitialState | Array:
        """Initial state and multipliers; what is left of the right side of the hard rows where they contradict."""
        e = int(f.carried[0])
        if self.given:
            rest = f.E[0, :e] @ d + v[:e]
            size = np.abs(f.E[0, :e]) @ np.abs(d) + np.abs(v[:e])
            if (np.abs(rest) > CONSISTENT * size + np.sqrt(variance[:e]) + slack).any():
                return rest
            return InitialState(d, np.zeros(f.E.shape[1]), np.zeros(len(d)))
        hard = self.scale == 0.0
        side = self.norm * np.concatenate([-v[:e], d[hard]])
        inside = self.U.T @ side
        rest = side - self.U @ inside
        rounding = np.sqrt(variance[:e]) @ self.norm[:e]
        if (np.abs(rest) > CONSISTENT * np.abs(side).max(initial=0.0) + rounding + slack).any():
            return rest * self.norm
        x = self.Vt.T @ (inside / self.s)
        g = self.Z.T @ self._gradient(f.W[0], p, d, x)
        along = self.Yt @ g
        if np.abs(g - self.Yt.T @ along).max(initial=0.0) > CONSISTENT * np.abs(g).max(initial=0.0) + slack:
            raise Unbounded()
        x = x - self.Z @ (self.Yt.T @ (along / self.t**2))
        w = -self.norm * (self.U @ (self.Vt @ self._gradient(f.W[0], p, d, x) / self.s))
        psi, nu = np.zeros(f.E.shape[1]), np.zeros(len(d))
        psi[:e], nu[hard] = w[:e], w[e:]
        nu[~hard] = (self.H[~hard] @ x - d[~hard]) / self.scale[~hard]
        return InitialState(x, psi, nu)

    def _gradient(self, W: Array, p: Array, d: Array, x: Array) -> Array:
        """Derivative by x_0 of all but the hard rows."""
        soft = self.scale > 0.0
        H = self.H[soft]
        gradient: Array = p + W.T @ (W @ x) + H.T @ ((H @ x - d[soft]) / self.scale[soft])
        return gradient


def initial_stage(initial: object, f: Factors) -> InitialStage:
    """Check what is said about the initial state, and factorize."""
    nx = f.W.shape[1]
    given = False
    if isinstance(initial, StateRows):
        H, d, scale = checked_state_rows("initial", initial, nx)
    elif isinstance(initial, str):
        if initial != "free":
            raise ValueError(f"initial must be 'free', a state ({nx},), StateRows or None, got {initial!r}")
        H, d, scale = checked_state_rows("initial", None, nx)
    else:
        given = True
        x = np.zeros(nx) if initial is None else as_array("initial", initial, (nx,))  # type: ignore[arg-type]
        H, d, scale = np.eye(nx), x, np.zeros(nx)
        none, empty = np.zeros(0), np.zeros((0, nx))
        return InitialStage(given, H, d, scale, empty, none, empty, none, empty, empty, none, empty)
    G = np.concatenate([f.E[0, : f.carried[0]], H[scale == 0.0]])
    length = np.linalg.norm(G, axis=1)
    norm = 1.0 / np.where(length > 0.0, length, 1.0)
    U, s, Vt = np.linalg.svd(norm[:, None] * G, full_matrices=True)
    rank = int((s > DEPENDENT).sum())
    Z = Vt[rank:].T
    soft = scale > 0.0
    W = np.concatenate([f.W[0], H[soft] / np.sqrt(scale[soft])[:, None]])
    _, t, Yt = np.linalg.svd(W @ Z, full_matrices=False)
    held = int((t > SINGULAR * np.linalg.norm(W)).sum())
    return InitialStage(given, H, d, scale, G, norm, U[:, :rank], s[:rank], Vt[:rank], Z, t[:held], Yt[:held])
