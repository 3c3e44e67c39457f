"""Starts of a search: guesses that a user gives, and starts made from the problem itself.

    hold     u_n = u_hold: the controls under which the initial state changes least over a step
    servo    u(x) = [ u_hold - K (x - x_target) ]: a computed-torque servo, which pulls the robot towards a state;
             u_hold and K are those of the target

Both linearize one step, x_next = f(x, u_hold) + B (u - u_hold), so that they serve every engine, floating bases and
contacts included: what the controls cannot move they leave alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mjslq.dynamics.dynamics import Feedback
from mjslq.policy import Policy
from mjslq.problem import Problem
from mjslq.result import Result
from mjslq.trajectory import Trajectory
from mjslq.unknowns import Unknowns
from mjslq.validation import Array, as_array, describe, instance, positive

ROUNDS = 20
"""Newton steps towards the controls that hold a state, at most."""


class Start(NamedTuple):
    """Controls to start from, and states where these are a guess."""

    U: Array
    """Within the limits. Shape (N, nu)."""
    x0: Array
    """The problem's own initial state, with free entries from the guess. Shape (nx,)."""
    X: Array | None = None
    """States that need not obey the dynamics, the first of them the problem's own. Shape (N + 1, nx)."""
    remark: str = ""
    """What was changed about the guess."""
    multipliers: Mapping[str, Array] = {}
    """Of the constraints, by name, where the guess is a result."""


def hold(problem: Problem, x: ArrayLike | None = None) -> Array:
    """Controls that keep a state at rest as well as they can, within the limits.

    Least squares over the change of the state in one step: what cannot be balanced (a falling base) is left out.

    Parameters
    ----------
    problem : Problem
        Its engine and limits are used.
    x : array
        The state to hold; the problem's x0 unless given. Shape (nx,).

    Returns
    -------
    array
        Shape (N, nu).

    Raises
    ------
    ValueError
        For a state of the wrong shape.

    Examples
    --------
    >>> dynamics = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0] - 9.81]), nx=2, nu=1, dt=0.1)
    >>> problem = mjslq.Problem(dynamics, 20, [0.0, 0.0], [mjslq.costs.Control(1.0)])
    >>> mjslq.starts.hold(problem)[0].round(6)  # gravity is balanced
    array([9.81])
    """
    instance("problem", problem, Problem, "a mjslq.Problem")
    x = np.asarray(problem.x0) if x is None else problem.dynamics.checked_start(x, "x")
    u, lower, upper = np.array(np.asarray(problem.U0)[0]), problem.box.lower[0], problem.box.upper[0]
    best, least = u, np.inf
    for _ in range(ROUNDS):
        change, B = _one_step(problem, x, u)
        if not np.isfinite(change).all():
            break
        if np.linalg.norm(change) < least * (1.0 - 1e-9):
            best, least = u, float(np.linalg.norm(change))
        else:
            break
        u = np.clip(u - np.linalg.lstsq(B, change, rcond=1e-9)[0], lower, upper)
    return problem.box.clip(np.tile(best, (problem.horizon, 1)))


def servo(
    problem: Problem, target: ArrayLike | None = None, stiffness: float = 100.0, damping: float | None = None
) -> Policy:
    """A servo towards a state, as a policy to start from.

    Parameters
    ----------
    problem : Problem
        Its engine and limits are used.
    target : array
        State to go to; the problem's x0 unless given. Shape (nx,).
    stiffness : float
        Acceleration for each unit of distance. [1/s^2]
    damping : float
        Acceleration for each unit of speed; critical unless given. [1/s]

    Returns
    -------
    Policy
        Hand it to `solve(problem, guess=...)`.

    Raises
    ------
    ValueError
        For a state of the wrong shape, gains that are not positive, and systems without a velocity for each position.

    Examples
    --------
    >>> dynamics = mjslq.FunctionDynamics(lambda x, u: np.array([x[1], u[0]]), nx=2, nu=1, dt=0.01)
    >>> problem = mjslq.Problem(dynamics, 20, [0.0, 0.0], [mjslq.costs.Control(1.0)])
    >>> servo = mjslq.starts.servo(problem, target=[1.0, 0.0], stiffness=25.0)
    >>> servo([0.0, 0.0], t=0.0).round(1)
    array([25.])
    """
    dynamics, N = instance("problem", problem, Problem, "a mjslq.Problem").dynamics, problem.horizon
    goal = np.asarray(problem.x0) if target is None else dynamics.checked_start(target, "target")
    stiffness = positive("stiffness", stiffness)
    damping = 2.0 * np.sqrt(stiffness) if damping is None else positive("damping", damping)
    u = hold(problem, goal)
    h = float(np.ravel(dynamics.dt)[0])
    positions, velocities = _halves(problem)
    B = _one_step(problem, goal, u[0])[1]
    K = np.zeros((dynamics.nu, dynamics.ndx))
    inverse = h * np.linalg.pinv(B[velocities], rcond=1e-9)
    K[:, positions], K[:, velocities] = stiffness * inverse, damping * inverse
    X = np.tile(goal, (N + 1, 1))
    return Policy(X, u, np.tile(K, (N, 1, 1)), dynamics.dt, problem.box.lower, problem.box.upper, dynamics.space)


def read(problem: Problem, guess: Any, U0: ArrayLike | None, X0: ArrayLike | None) -> Start:
    """Read the guess that `solve` was given.

    `guess` is a Result (its policy is followed), a Trajectory (its controls), a Policy, controls (N, nu) or (nu,), or
    states (N + 1, nx), which need not obey the dynamics; U0 and X0 name the last two.

    Raises ValueError for anything else, and for shapes that do not belong to the problem.
    """
    if guess is not None and (U0 is not None or X0 is not None):
        raise ValueError("give either guess or U0 and X0, not both")
    if problem.unknowns is not None:
        return _with_values(problem, problem.unknowns, guess, U0, X0)
    if isinstance(guess, Result):
        multipliers = guess.multipliers
        start = read(problem, guess.policy if guess.gains is not None else guess.trajectory, None, None)
        return start._replace(multipliers=multipliers)
    x0 = np.asarray(problem.x0)
    if isinstance(guess, (Policy, Trajectory)) and guess.X.shape[1:] == x0.shape:
        x0 = problem.start(guess.X[0])
    if isinstance(guess, Policy):
        return _clipped(problem, _followed(problem, guess, x0), x0)
    if isinstance(guess, Trajectory):
        if guess.U.shape != (problem.horizon, problem.dynamics.nu):
            raise ValueError(
                f"the guess is a trajectory of {guess.U.shape[0]} steps and {guess.U.shape[1]} controls, but the "
                f"problem has {problem.horizon} and {problem.dynamics.nu}"
            )
        U0 = guess.U
    elif guess is not None:
        if isinstance(guess, str) or callable(guess):
            raise ValueError(
                f"guess must be a Result, a Trajectory, a Policy or an array of controls or states, got "
                f"{describe(guess)}"
            )
        array = as_array("guess", guess)
        shapes = {"U0": [(problem.dynamics.nu,), (problem.horizon, problem.dynamics.nu)]}
        shapes["X0"] = [(problem.horizon + 1, problem.dynamics.nx)]
        if array.shape in shapes["X0"]:
            X0 = array
        elif array.shape in shapes["U0"]:
            U0 = array
        else:
            raise ValueError(
                f"guess must be a Result, a Trajectory, a Policy, controls {shapes['U0'][1]} or states "
                f"{shapes['X0'][0]}, got shape {array.shape}"
            )
    given = problem.U0 if U0 is None else U0
    assert given is not None  # a problem fills in its own start when it is made
    start = _clipped(problem, problem.checked_controls(given), x0)
    return start if X0 is None else start._replace(X=_states(problem, X0))


def _with_values(problem: Problem, unknowns: Unknowns, guess: Any, U0: ArrayLike | None, X0: ArrayLike | None) -> Start:
    """A start for `Problem.lifted`: values of the unknowns from the guess, the rest on the system with these."""
    values, system = unknowns.values_of(problem, guess), unknowns.system(problem.dynamics, problem.horizon)
    fixed = problem.on(system.at(values))
    object.__setattr__(fixed, "unknowns", None)
    start = read(fixed, guess, U0, X0)
    if start.X is not None:
        raise ValueError("a problem with free time or parameters takes no state guess X0; give controls, U0")
    return start._replace(U=unknowns.controls(start.U, values), x0=system.state(start.x0))


def _clipped(problem: Problem, U: Array, x0: Array) -> Start:
    """Controls within the limits, and a remark where they were not."""
    clipped = problem.box.clip(U)
    beyond = int((clipped != U).any(axis=1).sum())
    remark = f"The start was clipped to the limits of the controls at {beyond} steps." if beyond else ""
    return Start(clipped, x0, None, remark)


def _states(problem: Problem, X0: ArrayLike) -> Array:
    """X0 as states (N + 1, nx), the first of them the problem's own but for free entries."""
    dynamics = problem.dynamics
    X = as_array("X0", X0, (problem.horizon + 1, dynamics.nx))
    X = np.stack([dynamics.checked_start(x) for x in X])
    X[0] = problem.start(X[0])
    return X


def _followed(problem: Problem, policy: Policy, x0: Array) -> Array:
    """Controls of a rollout from `x0` (nx,) under a policy, whose horizon may be another. Shape (N, nu)."""
    dynamics, N = problem.dynamics, problem.horizon
    if policy.X.shape[1] != dynamics.nx or policy.U.shape[1] != dynamics.nu:
        raise ValueError(
            f"the guess is a policy of {policy.X.shape[1]} states and {policy.U.shape[1]} controls, but the problem "
            f"has {dynamics.nx} and {dynamics.nu}"
        )
    if policy.horizon < N:
        rest = N - policy.horizon
        at = np.minimum(np.arange(N), policy.horizon - 1)
        X = np.concatenate([policy.X, np.tile(policy.X[-1], (rest, 1))])
    else:
        at, X = np.arange(N), policy.X[: N + 1]
    U = policy.U[at]
    if policy.K is None:
        return U
    feedback = Feedback(np.ascontiguousarray(X), policy.K[at], problem.box.lower, problem.box.upper)
    trajectory = dynamics.rollouts(x0[None], U[None].copy(), feedback)[0]
    return U if trajectory.diverged else np.array(trajectory.U)


def _halves(problem: Problem) -> tuple[slice, slice]:
    """Tangent directions of positions and of velocities, which pair up in robots."""
    nv, ndx = problem.dynamics.nv, problem.dynamics.ndx
    if not 0 < 2 * nv <= ndx:
        raise ValueError(
            f"a servo needs a velocity for each position, but of the {ndx} directions of this state {nv} are velocities"
        )
    return slice(0, nv), slice(nv, 2 * nv)


def _one_step(problem: Problem, x: Array, u: Array) -> tuple[Array, Array]:
    """Change of the state over the first step from (x, u), and its derivative by u. Shapes (ndx,), (ndx, nu)."""
    dynamics, N = problem.dynamics, problem.horizon
    X, U = np.tile(x, (N + 1, 1)), np.tile(u, (N, 1))  # engines may have steps of differing lengths
    ends, _ = dynamics.step_each(X, U)
    if not np.isfinite(ends[0]).all():
        return np.full(dynamics.ndx, np.nan), np.zeros((dynamics.ndx, dynamics.nu))
    return dynamics.difference(x, ends[0]), dynamics.linearize_steps(X, U, ends).B[0]
