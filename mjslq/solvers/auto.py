"""`auto`: Gauss-Newton first, second derivatives where its tail is slow, multipliers where the model is poor.

Model
-----
    H(theta) = H_GN + theta (H_exact - H_GN)       theta = 0 while Gauss-Newton does well, then the largest of
                                                   1, 1/2, 1/4, ... with which the sweep finds a minimizer

H_GN is the Gauss-Newton Hessian, H_exact has the curvature of dynamics and residuals too, weighed by the costates of
the sweep before (those of sequential quadratic programming). theta may double from an iteration to the next. At a
solution theta = 1, and the last steps are Newton's own.

Multipliers
-----------
    model + mu_x/2 |x|^2 + mu_u/2 |u|^2            |x|^2 = sum_n x_bar'x_bar,  |u|^2 = sum_n u_bar'D u_bar, D the
                                                   diagonal of the control weights

The natural scale of a multiplier is the one with which it weighs as much as the whole model along the direction,
-g'd / |.|^2. A step of at most 1/4 raises mu_x to that scale at once: the states then keep to where the model holds,
while the controls may do what it takes. Limits among which the minimizer is not found in a few sweeps (almost all
controls at a limit) raise mu_u, and so does a model without a minimizer. Full steps divide both by 5; below a
thousandth of the scale they are zero. Where no step descends, mu_x grows by 2, 4, 8, ... until one does. When damped
steps creep, `PATIENCE_TO_CREEP` in a row with hardly any decrease, mu_x and mu_u change parts: at a kink the controls
have to be kept, not the states. Where nothing of this descends, `kinks` looks for a way past what is there.

Steps are halved until one descends, under the sweep's feedback; full ones that bring more than the model expects are
doubled as long as that pays.

Second derivatives are taken in when full steps shrink the expected decrease by less than `SLOW`, or steps have to be
shortened, three times in a row: then Gauss-Newton converges slowly, or points the wrong way. Where they are dear
(`Dynamics.curvature_price` above `DEAR`), not before the iterations in a row have cost as much as they do; and they
rest, for 4, 8, 16, ... iterations, where `TRIED` iterations with them have brought less for their price than the last
ones without. A direction with a multiplier counts as converged only if it were short without, too.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from mjslq.lq.box import BoxSolution, solve_in_box
from mjslq.lq.problem import LQProblem, NotPositiveDefinite
from mjslq.options import AutoOptions
from mjslq.solvers.iterate import Direction, Iterate
from mjslq.solvers.kinks import Kinks
from mjslq.solvers.linesearch import C1, Trial, in_roundoff, search
from mjslq.solvers.merit import Merit
from mjslq.solvers.method import Method, Step
from mjslq.solvers.steps import candidates, close_gaps
from mjslq.validation import Array

SLOW = 0.3
"""Factor by which a full step has to shrink the expected decrease."""
PATIENCE, ITERATION, DEAR, TRIED = 3, 3.0, 9.0, 4
"""Slow iterations in a row, after which second derivatives are taken in where they cost little; in linearizations, the
cost of an iteration without them, and the price from which on they are dear; iterations that these are tried for."""
LITTLE = 0.1
"""Share of the multipliers in the model, up to which a step is as good as without."""
NEARLY = 1e-2
"""Length of a damped direction, relative to the controls, below which it is told how long it were without."""
LEAST_THETA = 0.01
"""Share of the curvature below which none is taken in."""
SWEEPS = 15
"""Sweeps within which a model's minimizer among the limits has to be found."""
SHORT, SHRINK, GROW, NEGLIGIBLE = 0.25, 5.0, 4.0, 1e-3
MORE, LONGEST = 1.1, 64.0
"""Decrease relative to the expected one from which on longer steps are tried, and the longest of these."""
SMALLEST = 1e-3
"""Step below which the line search gives up."""
RAISES = 40
"""Times that mu_u is raised for one direction, at most."""
CREEP, PATIENCE_TO_CREEP = 1e-4, 8
"""Decrease, relative to the cost, below which a step creeps, and how many of them in a row are too many."""
LEAST_MU = 1e-6
"""The first mu_u where its natural scale does not tell, relative to the control weights."""
RESCUES = 14
"""Times that mu_x is raised where no step descends, at most."""


class Multipliers(NamedTuple):
    """mu_x and mu_u, or their natural scales."""

    state: float = 0.0
    control: float = 0.0

    def at_least(self, kind: str, least: float) -> Multipliers:
        """The same with one of them raised to `least`."""
        return self._replace(**{kind: max(getattr(self, kind), least)})


class Candidate(NamedTuple):
    """Minimizer of a model, and what it was found with."""

    found: BoxSolution
    model: LQProblem
    theta: float
    mu: Multipliers
    decrease: float
    """-g'd, the slope of the model."""
    natural: Multipliers
    """Natural scales of the multipliers."""

    @property
    def share(self) -> float:
        """How much the multipliers weigh beside the whole model along the direction."""
        return sum(m / scale if scale else np.inf * m for m, scale in zip(self.mu, self.natural, strict=True) if m)

    @property
    def fine(self) -> bool:
        """Whether it is the minimizer, and descends."""
        return self.found.converged and self.decrease >= 0.0


class Auto(Method):
    """The method, with its multipliers, its share of the curvature and the costates of the sweep before."""

    def __init__(self, options: AutoOptions, kinks: bool = True) -> None:
        self.options = options
        self.kinks = Kinks() if kinks else None
        """What to do where no step descends; None for leaving that to others."""
        self.mu, self.theta = Multipliers(), 1.0
        self._kind = "state"  # which multiplier short steps raise
        self._creeping = 0
        self._resting, self._rest = 0, 4  # iterations that second derivatives rest, and the next time
        self._second_from: int | None = 0 if options.curvature == "always" else None
        self._slow, self._last, self._iterations, self._damped = 0, np.inf, 0, 0
        self._brought: dict[bool, list[float]] = {False: [], True: []}  # latest decreases, without and with curvature
        self._costates: Array | None = None
        self._exact: LQProblem | None = None
        self._latest: Candidate | None = None

    def direction(self, here: Iterate) -> Direction:
        """Minimize the model at the head of this file."""
        self._exact = None
        self._resting -= self._resting > 0
        if self._second_from is not None and not self._resting:
            self._exact = _finite(here.hamiltonian(self._costates_for(here)))
        for raised in range(RAISES):
            try:
                latest = self._minimize(here, self.mu)
                if latest.fine:
                    break
                least = latest.natural.control * (0.1 if raised == 0 else 1.0)
            except NotPositiveDefinite:
                least = 0.0
            self.mu = self.mu.at_least("control", max(10.0 * self.mu.control, least, LEAST_MU))
        else:
            raise NotPositiveDefinite(0)
        self._latest, self.theta = latest, latest.theta
        return _direction(latest)._replace(limited=any(latest.mu), undamped=_undamped(here, latest))

    def step(self, here: Iterate, direction: Direction, merit: Merit) -> Step:
        """Search along the direction; learn from the step how good the model is."""
        if here.gaps is not None:
            self._costates = direction.costates
            return close_gaps(here, direction, merit)
        assert self._latest is not None
        trial = Trial(
            merit, here, merit.slope(here, direction), direction.expected,
            lambda alphas: candidates(here, direction, alphas, "closed-loop"),
            at_once=here.problem.dynamics.threads, smallest=SMALLEST,
        )  # fmt: skip
        found = search("armijo", trial)
        self._iterations += 1
        self._damped += any(self._latest.mu)
        if found is None:
            rescued = self._rescue(here, merit)
            if rescued.iterate is None and self.kinks is not None:
                rescued = self.kinks.step(here, rescued)
            return dataclasses.replace(rescued, rollouts=trial.evaluations + rescued.rollouts)
        self._costates = direction.costates
        self._adapt(found.alpha, self._latest, here.problem.dynamics.curvature_price)
        alpha = _expanded(trial, found.alpha)
        self._watch(trial.start - trial.cost(alpha), trial.start)
        self._judge(trial.start - trial.cost(alpha), here.problem.dynamics.curvature_price)
        return Step(trial(alpha), alpha, trial.evaluations)

    @property
    def second(self) -> bool:
        """Whether second derivatives have been taken in."""
        return self._second_from is not None

    @property
    def damped(self) -> bool:
        """Whether multipliers weigh enough in the latest direction to make it short."""
        return self._latest is not None and self._latest.share > LITTLE

    def remark(self) -> str:
        """What the method chose."""
        if self._second_from is None:
            parts = ["Gauss-Newton throughout"]
        elif self._second_from == 0:
            parts = ["second derivatives throughout"]
        else:
            parts = [f"Gauss-Newton, with second derivatives from iteration {self._second_from} on"]
        if self._damped:
            parts.append(f"a multiplier in {self._damped} of {self._iterations} iterations")
        said = f"auto: {', '.join(parts)}."
        return said if self.kinks is None else f"{self.kinks.remark()} {said}".strip()

    def _minimize(self, here: Iterate, mu: Multipliers) -> Candidate:
        """Minimizer with the largest share of the curvature that leaves one."""
        convex, exact = here.gauss_newton, self._exact
        theta = min(1.0, 2.0 * self.theta)
        while exact is not None and theta >= LEAST_THETA:
            try:
                return _solve(here, exact if theta == 1.0 else _between(convex, exact, theta), theta, mu)
            except NotPositiveDefinite:
                theta *= 0.5
        return _solve(here, convex, self.theta if exact is None else 0.5 * LEAST_THETA, mu)

    def _adapt(self, alpha: float, latest: Candidate, price: float) -> None:
        """Change the multipliers after a step, and decide on second derivatives."""
        factor = GROW if alpha <= SHORT else 1.0 / SHRINK if alpha == 1.0 else 0.5
        mu = Multipliers(factor * self.mu.state, factor * self.mu.control)
        if alpha <= SHORT:
            mu = mu.at_least(self._kind, getattr(latest.natural, self._kind))
        kept = [m if m > NEGLIGIBLE * scale else 0.0 for m, scale in zip(mu, latest.natural, strict=True)]
        self.mu = Multipliers(*kept)
        if self._second_from is not None or self.options.curvature == "never":
            return
        poor = alpha < 1.0 or (latest.share < LITTLE and latest.decrease > SLOW * self._last)
        self._slow, self._last = self._slow + 1 if poor else 0, latest.decrease
        if self._slow >= (PATIENCE if price <= DEAR else max(PATIENCE, price / ITERATION)):
            self._second_from, self.theta = self._iterations, 1.0

    def _rescue(self, here: Iterate, merit: Merit) -> Step:
        """Full steps with a growing multiplier, where the line search found none.

        Multipliers of either kind are tried, and last Gauss-Newton, whereupon second derivatives rest for a while.
        """
        assert self._latest is not None
        spent, exact, scale = 0, self._exact, self._latest.natural
        for self._exact in (exact, None) if exact is not None else (None,):
            for kind in (self._kind, _other(self._kind)):
                step = self._raise(here, merit, kind, self.mu.at_least(kind, getattr(scale, kind)), scale)
                spent += step.rollouts
                if step.iterate is not None:
                    self._kind, self._slow = kind, self._slow + 1
                    if exact is not None and self._exact is None:
                        self._resting, self._rest = self._rest, 2 * self._rest
                    self._watch(merit.value(here) - merit.value(step.iterate), merit.value(here))
                    return Step(step.iterate, 1.0, spent)
        return Step(None, rollouts=spent)

    def _raise(self, here: Iterate, merit: Merit, kind: str, mu: Multipliers, scale: Multipliers) -> Step:
        """Raise one multiplier until a full step descends."""
        factor, spent = 2.0, 0
        for _ in range(RESCUES):
            try:
                latest = self._minimize(here, mu)
            except NotPositiveDefinite:
                latest = None
            if latest is None or not latest.fine:
                mu = mu.at_least("control", max(4.0 * mu.control, 0.1 * scale.control))
            else:
                ahead = _direction(latest)
                slope = merit.slope(here, ahead)
                if in_roundoff(slope, here.cost):
                    break
                there, spent = candidates(here, ahead, [1.0], "closed-loop")[0], spent + 1
                if merit.value(there) < merit.value(here) + C1 * slope:
                    self.mu, self.theta, self._costates = mu, latest.theta, ahead.costates
                    return Step(there, 1.0, spent)
            mu, factor = mu.at_least(kind, factor * getattr(mu, kind)), 2.0 * factor
        return Step(None, rollouts=spent)

    def _watch(self, decrease: float, start: float) -> None:
        """Let the multipliers change parts when damped steps creep."""
        self._creeping = self._creeping + 1 if any(self.mu) and decrease < CREEP * abs(start) else 0
        if self._creeping >= PATIENCE_TO_CREEP:
            self._kind, self._creeping, self.mu = _other(self._kind), 0, Multipliers()

    def _judge(self, decrease: float, price: float) -> None:
        """Let dear second derivatives rest where they bring less for their price than iterations without them."""
        if price <= DEAR or self.options.curvature == "always":
            return
        recent = self._brought[self._exact is not None]
        recent.append(decrease)
        del recent[:-TRIED]
        plain, second = self._brought[False], self._brought[True]
        if self._exact is None or len(second) < TRIED or not plain:
            return
        if np.mean(second) / (ITERATION + price) < np.mean(plain) / ITERATION:
            self._resting, self._rest = self._rest, 2 * self._rest
            plain.clear()
        second.clear()

    def _costates_for(self, here: Iterate) -> Array:
        """Costates of the sweep before; at the start those of a Gauss-Newton sweep."""
        if self._costates is not None:
            return self._costates
        try:
            return _solve(here, here.gauss_newton, 1.0, self.mu).found.lq.costates
        except NotPositiveDefinite:
            return here.costates


def _other(kind: str) -> str:
    return "control" if kind == "state" else "state"


def _undamped(here: Iterate, latest: Candidate) -> float | None:
    """Length of the direction without multipliers, where there are some and it may be short enough to matter."""
    U = latest.found.lq.U
    if not any(latest.mu) or np.linalg.norm(U) > NEARLY * np.linalg.norm(here.trajectory.U):
        return None
    try:
        free = _solve(here, latest.model, latest.theta, Multipliers())
    except NotPositiveDefinite:
        return None
    return float(np.linalg.norm(free.found.lq.U)) if free.fine else None


def _expanded(trial: Trial, alpha: float) -> float:
    """A step that has brought more than the model expects is doubled as long as the merit falls."""
    if alpha < 1.0 or trial.cost(alpha) > trial.start + MORE * trial.expected or trial.in_roundoff:
        return alpha
    while alpha < LONGEST and trial.cost(2.0 * alpha) < trial.cost(alpha):
        alpha *= 2.0
    return alpha


def _solve(here: Iterate, model: LQProblem, theta: float, mu: Multipliers) -> Candidate:
    """Minimize a model with multipliers; they are relative to max|Q| and to D."""
    convex = here.gauss_newton
    D = np.abs(np.einsum("nii->ni", convex.R)).max(axis=0, initial=0.0)
    Q = max(float(np.abs(convex.Q).max(initial=0.0)) or float(D.max(initial=0.0)), 1e-300)
    D = np.maximum(D, 1e-6 * D.max(initial=0.0) + 1e-300)
    found = solve_in_box(model, here.box, mu.control * D, mu.state * Q, SWEEPS)
    X, U = found.lq.X, found.lq.U
    decrease = -float(np.vdot(model.q, X) + np.vdot(model.r, U))
    if here.gaps is not None:
        decrease = abs(decrease)  # the cost may rise while gaps close
    sizes = Q * float(np.vdot(X, X)), float((D * U * U).sum())
    natural = Multipliers(*(abs(decrease) / max(size, 1e-300) for size in sizes))
    return Candidate(found, model, theta, mu, decrease, natural)


def _direction(latest: Candidate) -> Direction:
    lq, multiplier = latest.found.lq, max(latest.mu)
    expected = latest.model.value(lq.X, lq.U)
    return Direction(lq.X, lq.U, lq.k, lq.K, expected, latest.found.held, multiplier, sweep=lq)


def _between(convex: LQProblem, exact: LQProblem, theta: float) -> LQProblem:
    parts = {name: getattr(convex, name) + theta * (getattr(exact, name) - getattr(convex, name)) for name in "QRM"}
    return convex._replace(**parts)


def _finite(model: LQProblem) -> LQProblem | None:
    """The model, or None where its Hessians are not finite."""
    return model if np.isfinite(model.Q.sum() + model.R.sum() + model.M.sum()) else None
