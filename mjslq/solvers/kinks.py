"""Descent where the cost has kinks or jumps: the way down that all sides agree on, or a proof that there is none.

A search that finds no step although the gradient is not zero stands at a kink, where the cost has another slope behind
it (friction, contacts that open and close), or at an edge, where it jumps (`edges`). Both have to be known before a
way past them is found: pieces are collected where trial steps fail.

Notation
--------
    v_n      feedforward: u_n = u_ref,n + v_n - K_n (x_n - x_ref,n), under the gains K of the sweep at the iterate
    g_i      gradients of the cost by v: g_0 at the iterate, others behind kinks that trial steps met. Shape (N, nu)
    a_k      gradients of the distances from edges, which are not to be crossed
    e_i      linearization errors: how far the line through a kink's piece lies below the cost at the iterate, e_0 = 0
    b_k      how far to keep from edges; zero at first
    H        Gauss-Newton Hessian by v: H^{-1} g is one sweep, controls that limits hold left out

Direction
---------
    d = argmin   max_i (g_i'd - e_i) + 1/2 d'H d    subject to  a_k'd + b_k <= 0                       (1)
      = -H^{-1} g,   g = sum_i w_i g_i + sum_k w_k a_k,   w >= 0,  sum_i w_i = 1                        (2)
    w = argmin   1/2 g'H^{-1} g + sum_i w_i e_i - sum_k w_k b_k

so that -g is the shortest vector, in the metric of H^{-1}, among the averages of the pieces: it descends by
g'H^{-1}g + sum_i w_i e_i on all of them, or that is zero, and the iterate is stationary.

Rounds
------
    1  d by (2); the iterate is stationary, as far as the pieces tell, where `STATIONARY` holds
    2  steps 1, 1/4, ... along d under the sweep's feedback; the first that descends by c_1 alpha g_0'd ends the search
    3  between the shortest step that fails and the iterate, by bisection, either a gradient with g_i'd - e_i above half
       of the slope along d, a kink; or a place where nothing but a jump is left: an edge
    4  an edge that is met again, since it is curved, is kept off: b_k grows
    5  from 1 with the new piece, `ROUNDS` times at most

Sources: Lemarechal 1978 and Kiwiel 1985 (bundle methods), "Methods of Descent for Nondifferentiable Optimization";
Burke, Lewis and Overton 2005, "A robust gradient sampling algorithm for nonsmooth, nonconvex optimization". Edges are
added here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mjslq.lq.adjoint import closed_loop_adjoint
from mjslq.lq.problem import LQSolution, Mask, NotPositiveDefinite
from mjslq.lq.riccati import solve
from mjslq.solvers.edges import Edge, edge_between
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.linesearch import C1, ROUNDOFF, in_roundoff
from mjslq.solvers.method import Step
from mjslq.solvers.steps import candidates
from mjslq.status import Status
from mjslq.validation import Array

ROUNDS = 30
"""Pieces that are looked for, at most."""
STATIONARY = 1e-5
"""Decrease that (1) promises, relative to the cost or to what the gradient alone promises, below which the iterate is
stationary."""
SMALLEST, SHORTER = 1e-3, 0.25
"""Steps along a direction."""
FLATTER, EXPLAINED = 0.5, 0.5
"""Share of the slope that a kink's piece may leave along a direction, and the largest e_i, relative to the slope."""
BISECTIONS = 50
"""Between a step that fails and the iterate, at most."""
KEPT_OFF, MORE, ENOUGH = 1e-2, 4.0, 10.0
"""b_k when an edge is met again, relative to how far the first direction went beyond it; growth, and the largest."""
SAME = 0.9
"""Cosine of two normals from which on they are those of one edge."""
STEEP = 1e4
"""Weight of the sum of w_i beside (2), relative to the size of the shortest piece."""


STEPS, CREEP, PATIENCE = 100, 1e-4, 5
"""Searches of a solve, at most; decrease, relative to the cost, below which one creeps, and how many in a row may."""


class Kinks:
    """What a method does where its own search finds no step, and what it says of it in the end."""

    def __init__(self) -> None:
        self._steps = self._creeping = 0
        self._last: Found | None = None
        self._ended, self._cost = False, 0.0

    def step(self, here: Iterate, failed: Step) -> Step:
        """A step past the kinks and edges at `here`, or an ending that says what is there.

        `failed` is the step that was not found. Problems with a free initial state are left as they are.
        """
        if here.gaps is not None or here.problem.free_start is not None:
            return failed
        rounds = 1 if self._steps >= STEPS or self._creeping >= PATIENCE else ROUNDS
        self._last = found = beyond_kinks(here, rounds)
        spent = failed.rollouts + found.rollouts
        self._ended, self._cost = found.iterate is None or rounds == 1, here.cost
        if self._ended or found.iterate is None:
            return Step(None, rollouts=spent, status=Status.AT_KINK if found.stationary else failed.status)
        self._steps += 1
        creeps = here.cost - found.iterate.cost < CREEP * abs(here.cost)
        self._creeping = self._creeping + 1 if creeps else 0
        return Step(found.iterate, found.alpha, spent)

    def remark(self) -> str:
        """What was found, in a sentence or two; empty where nothing was in the way."""
        said, last = [], self._last
        if self._steps:
            said.append(f"{self._steps} {'step' if self._steps == 1 else 'steps'} past kinks or jumps of the cost.")
        if self._ended and last is not None and np.isfinite(last.norm):
            said.append(
                f"Around this point {last.kinks} kinks and {last.edges} jumps were found; the shortest average of "
                f"the gradients on their sides has the norm {last.norm:.1e} and promises a decrease of "
                f"{last.decrease:.1e}."
            )
            if abs(last.jump) > ROUNDOFF * abs(self._cost):
                said.append(
                    f"The cost jumps by {last.jump:.1e} from one point to the next and the place was not found: where "
                    f"that is small, the simulator's own solver may stop too early (its tolerance)."
                )
        return " ".join(said)


class Found(NamedTuple):
    """What came of a search."""

    iterate: Iterate | None
    """The next iterate; None where none was found."""
    direction: Direction | None
    """The latest direction."""
    alpha: float
    rollouts: int
    decrease: float
    """What (1) promises."""
    norm: float
    """|g|, of the shortest average of the pieces."""
    stationary: bool
    kinks: int
    edges: int
    jump: float
    """Of the cost, at a place where it jumps but no edge was found; 0 for none."""


@dataclass
class Piece:
    """A gradient of the cost, or of the distance from an edge."""

    gradient: Array
    pull: Array
    """The same with the derivatives by controls that limits hold, which `gradient` leaves out."""
    edge: Edge | None = None
    beyond: float = 0.0
    """How far the direction that met the edge first went beyond it."""
    off: float = 0.0
    """b_k, or -e_i."""
    sweep: LQSolution | None = field(default=None, repr=False)


def beyond_kinks(here: Iterate, rounds: int = ROUNDS) -> Found:
    """Search a step from `here`, a rollout, as the head of this file says."""
    try:
        return Bundle(here).search(rounds)
    except NotPositiveDefinite:
        return Found(None, None, 0.0, 0, np.inf, np.inf, False, 0, 0, 0.0)


class Bundle:
    """The pieces about an iterate."""

    def __init__(self, here: Iterate) -> None:
        self.here = here
        self.held = here.problem.box.pushed(here.trajectory.U, here.gradient)
        self.K = solve(here.gauss_newton, held=self.held).K
        self.pieces = [Piece(*self._gradient(here))]
        self.rollouts, self.jump = 0, 0.0

    def search(self, rounds: int) -> Found:
        """The rounds."""
        ahead, decrease, norm, stationary, first = None, np.inf, np.inf, False, 0.0
        for _ in range(rounds):
            ahead, decrease, norm, released = self._direction()
            slope = float(np.vdot(self.pieces[0].gradient, ahead.k))
            if len(self.pieces) == 1 and in_roundoff(slope, self.here.cost):
                break  # what is lost in rounding is no kink
            first = max(first, decrease)
            stationary = decrease <= STATIONARY * max(abs(self.here.cost), first) and not released
            if stationary or not slope < 0.0:
                break
            alpha = 1.0
            while alpha >= SMALLEST:
                there = self._at(ahead, alpha)
                if there.cost < self.here.cost + C1 * alpha * slope:
                    return self._found(there, ahead, alpha, decrease, norm, False)
                alpha *= SHORTER
            short = self._learn(ahead, slope, alpha / SHORTER, there)
            if short is not None:
                there, alpha = short
                return self._found(there if alpha else None, ahead, alpha, decrease, norm, False)
        return self._found(None, ahead, 0.0, decrease, norm, stationary)

    def _found(
        self, there: Iterate | None, ahead: Direction | None, alpha: float, decrease: float, norm: float, proved: bool
    ) -> Found:
        edges = sum(piece.edge is not None for piece in self.pieces)
        kinks = len(self.pieces) - 1 - edges
        return Found(there, ahead, alpha, self.rollouts, decrease, norm, proved, kinks, edges, self.jump)

    def _at(self, ahead: Direction, alpha: float) -> Iterate:
        self.rollouts += 1
        return candidates(self.here, ahead, [alpha], "closed-loop")[0]

    def _gradient(self, there: Iterate) -> tuple[Array, Array]:
        """Derivative of the cost by v at an iterate on the way: zero for controls that are held, and in whole."""
        return self._by_feedforward(there, np.array(there.gauss_newton.q), np.array(there.gauss_newton.r))

    def _by_feedforward(self, there: Iterate, q: Array, r: Array) -> tuple[Array, Array]:
        """Derivative by v of what has the derivatives `q` by states and `r` by controls, which are overwritten."""
        model, U, box = there.gauss_newton, there.trajectory.U, there.problem.box
        clipped = ((box.lower >= U) | (box.upper <= U)) & ~self.held
        K = np.where(clipped[:, :, None], 0.0, self.K)
        closed_loop_adjoint(model.A, model.B, K, np.zeros(U.shape, np.int8), q, r, np.zeros(U.shape, np.bool_))
        return np.where(self.held | clipped, 0.0, r), r

    def _direction(self) -> tuple[Direction, float, float, bool]:
        """d, what (1) promises, |g|, and whether g pulls a control away from the limit that holds it."""
        model = self.here.gauss_newton
        for piece in self.pieces:
            if piece.sweep is None:
                alone = model._replace(q=np.zeros_like(model.q), r=piece.gradient)
                alone.q[:-1] = np.einsum("nij,ni->nj", self.K, piece.gradient)
                piece.sweep = solve(alone, held=self.held)
        sweeps = [piece.sweep for piece in self.pieces if piece.sweep is not None]
        gram = np.array([[-np.vdot(piece.gradient, sweep.k) for sweep in sweeps] for piece in self.pieces])
        edges = np.array([piece.edge is not None for piece in self.pieces])
        off = np.array([piece.off for piece in self.pieces])
        w = weights(0.5 * (gram + gram.T), edges, off)
        X, U, k = (sum(wi * getattr(sweep, name) for wi, sweep in zip(w, sweeps, strict=True)) for name in "XUk")
        g = np.einsum("i,inj->nj", w, np.stack([piece.gradient for piece in self.pieces]))
        decrease = float(-np.vdot(g, k) - w[~edges] @ off[~edges])
        ahead = Direction(X, U, k, self.K, -0.5 * decrease, self.held)
        return ahead, decrease, float(np.linalg.norm(g)), self._releases(w)

    def _releases(self, w: Array) -> bool:
        """Whether a control that is held would rather leave its limit, by the average of the pieces."""
        pull = np.einsum("i,inj->nj", w, np.stack([piece.pull for piece in self.pieces]))
        pushed = self.here.problem.box.pushed(self.here.trajectory.U, pull)
        return bool((self.held & ~pushed & (pull != 0.0)).any())

    def _learn(self, ahead: Direction, slope: float, alpha: float, there: Iterate) -> tuple[Iterate, float] | None:
        """Add the piece that makes a step of size alpha fail.

        Where there is none to be found, the longest step known to descend, and its size.
        """
        low, high, below = 0.0, alpha, self.here
        for _ in range(BISECTIONS):
            if np.isfinite(there.gradient_norm):
                gradient, pull = self._gradient(there)
                cut = float(np.vdot(gradient, ahead.k))
                error = abs(self.here.cost + high * cut - there.cost)
                if cut - error > FLATTER * slope and error < EXPLAINED * abs(slope):
                    self.pieces.append(Piece(gradient, pull, off=-error))
                    return None
            middle = 0.5 * (low + high)
            if not low < middle < high or high - low < 1e-15 * alpha:
                break
            between = self._at(ahead, middle)
            if between.cost < self.here.cost + C1 * middle * slope:
                low, below = middle, between
            else:
                high, there = middle, between
        return None if self._learn_edge(ahead, below, there) else (below, low)

    def _learn_edge(self, ahead: Direction, below: Iterate, beyond: Iterate) -> bool:
        known = [piece.edge for piece in self.pieces if piece.edge is not None]
        X, U, ndx = ahead.X, ahead.U, ahead.X.shape[1]
        edge = edge_between(below, beyond, lambda n: np.concatenate([X[n], U[n]]), known)
        if edge is None:
            self.jump = beyond.cost - below.cost
            return False
        q, r = np.zeros_like(X), np.zeros_like(U)
        q[edge.knot], r[edge.knot] = edge.normal[:ndx], edge.normal[ndx:]
        gradient, pull = self._by_feedforward(self.here, q, r)
        for piece in self.pieces:
            if piece.edge is None or piece.edge.knot != edge.knot or piece.edge.normal @ edge.normal < SAME:
                continue
            piece.gradient, piece.pull, piece.edge, piece.sweep = gradient, pull, edge, None
            piece.off = max(MORE * piece.off, KEPT_OFF * piece.beyond)
            return piece.off <= ENOUGH * piece.beyond
        self.pieces.append(Piece(gradient, pull, edge, abs(float(np.vdot(gradient, ahead.k)))))
        return True


def weights(gram: Array, edges: Mask, off: Array) -> Array:
    """W of (2), from the products g_i'H^{-1}g_j (m, m), for pieces of which some are `edges` (m,). Shape (m,)."""
    from scipy.optimize import nnls  # which takes as long to import as all the rest

    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    least = size[~edges].min()
    scale = least / size
    values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
    kept = values > 1e-14 * values[-1]
    root = np.sqrt(values[kept])
    rows = np.vstack([(vectors[:, kept] * root).T, STEEP * least * np.where(edges, 0.0, scale)])
    right = np.append((vectors[:, kept] / root).T @ (off * scale), STEEP * least)
    w = nnls(rows, right, maxiter=50 * len(rows))[0] * scale
    total: float = w[~edges].sum()
    return np.asarray(w / total)
