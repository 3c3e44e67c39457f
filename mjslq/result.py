"""`Result`: everything that a solve leaves behind, kept so that it can be shown again without the solver."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjslq.contact import Contact, Replay
from mjslq.log import IterationLog
from mjslq.manifold import StateSpace
from mjslq.policy import Policy
from mjslq.scene import Scene
from mjslq.status import Status
from mjslq.trajectory import Trajectory
from mjslq.unknowns import TIME
from mjslq.validation import Array


@dataclass(frozen=True, eq=False)
class Result:
    """Outcome of `solve`; all of it survives `save` and `load`.

    Examples
    --------
    >>> result = mjslq.solve(mjslq.problems.get("hopper", height=1.0))
    >>> result.success, result.problem, result.trajectory.X.shape
    (True, 'hopper', (101, 4))
    >>> u = result.policy(result.trajectory.X[0], t=0.0)  # feedback, without the solver
    """

    status: Status
    """Why the solve stopped."""
    message: str
    """What that means here: the test that fired, what the method did, and what can be tried."""
    cost: float
    """Cost of `trajectory`."""
    iterations: int
    """Steps taken; trials that were rejected do not count."""
    gradient_norm: float
    """Euclidean norm of the projected gradient dJ/dU at `trajectory`: without the entries that push against limits.
    With constraints, the one of the Lagrangian. Infinite where it was not found. Of `pronto` and `gopronto` the one by
    the curve (alpha, mu) under feedback, barriers included: on unstable systems dJ/dU is all rounding."""
    trajectory: Trajectory
    """The best iterate."""
    gains: Array | None
    """Feedback gains K of u_n - K_n difference(x_n, x), zero for controls at their limits; None where the method has
    none. Shape (N, nu, ndx)."""
    lower: Array
    """Lower limits of the controls, -inf where there are none. Shape (N, nu)."""
    upper: Array
    """Upper limits of the controls. Shape (N, nu)."""
    constraint_violation: float = 0.0
    """Largest violation of any constraint, in its own unit; 0 without constraints."""
    violations: dict[str, Array] = field(default_factory=dict)
    """Violation of each constraint at each knot, by its name, the largest of its entries'; zero where it does not act.
    Shape (N + 1,)."""
    multipliers: dict[str, Array] = field(default_factory=dict)
    """Multipliers by the name of what they belong to: "controls" for the limits of the controls, positive at an upper
    limit and negative at a lower one, shape (N, nu); "final time" and free parameters, shape (1,), where the problem
    has such; those of the constraints in the same way, one for each of the k
    knots where a constraint acts and each of its m entries, shape (k, m): -dJ/d(limit)."""
    knots: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    """Knots that the multipliers of each constraint belong to, by its name. Whole numbers, shape (k,)."""
    log: tuple[IterationLog, ...] = ()
    """One entry an iteration, the start included."""
    iterates: tuple[Trajectory, ...] = ()
    """The trajectory of each entry of `log`, when kept."""
    seconds: float = 0.0
    """Wall time of the solve, without `compile_seconds`. [s]"""
    compile_seconds: float = 0.0
    """Wall time spent on compiling kernels, the first time only. [s]"""
    problem: str = ""
    """The problem's name."""
    method: str = ""
    """The method's name."""
    options: dict[str, Any] = field(default_factory=dict)
    """The options that the method ran with."""
    parameters: dict[str, Any] = field(default_factory=dict)
    """The parameters that the problem was made with."""
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Names of the entries of "states", "controls" and "outputs"."""
    space: StateSpace | None = None
    """Where the state's quaternions are."""
    scene: Scene | None = None
    """What a viewer draws; None when the problem has nothing to draw."""
    cost_terms: dict[str, float] = field(default_factory=dict)
    """Share of each term in `cost`, by what it is and where it acts."""
    gradient: Array | None = None
    """Projected gradient dJ/dU at `trajectory`; with constraints, the one of the Lagrangian. None where derivatives
    fail. Shape (N, nu)."""
    costates: Array | None = None
    """Costates dJ/dx_n at `trajectory`, in tangent directions of the state; with constraints, those of the Lagrangian.
    None where derivatives fail. Shape (N + 1, ndx)."""
    residuals: dict[str, Array] = field(default_factory=dict)
    """Length of the residual of each term of the cost at each knot, named as in `cost_terms`: tracking errors and such,
    but for user's functions. NaN where the term does not act. Shape (N + 1,)."""
    contact: Contact | None = None
    """How hard bodies touched in the model that it was solved with; None where the engine knows no contacts."""
    unknowns: dict[str, float] = field(default_factory=dict)
    """What was found of the problem's free time, "final time" [s], and of its free parameters, by name."""
    error: str = ""
    """Traceback of the error that ended the solve; empty for other endings."""

    @property
    def success(self) -> bool:
        """Whether the solve converged."""
        return self.status is Status.CONVERGED

    @property
    def final_time(self) -> float:
        """Duration of `trajectory`, free or not. [s]"""
        return float(np.sum(self.trajectory.dt))

    @property
    def free_parameters(self) -> dict[str, float]:
        """Values found for the problem's free parameters, by name."""
        return {name: value for name, value in self.unknowns.items() if name != TIME}

    @property
    def active_limits(self) -> np.ndarray[Any, np.dtype[np.int8]]:
        """1 where a control is at its upper limit, -1 at its lower one, 0 between them. Shape (N, nu)."""
        U = self.trajectory.U
        above, below = (self.upper <= U) & np.isfinite(self.upper), (self.lower >= U) & np.isfinite(self.lower)
        return above.astype(np.int8) - below.astype(np.int8)

    @property
    def policy(self) -> Policy:
        """The feedback about `trajectory`, limits included; it needs no solver."""
        t = self.trajectory
        return Policy(t.X, t.U, self.gains, t.dt, self.lower, self.upper, self.space)

    @cached_property
    def penetration(self) -> float:
        """Largest depth of a contact at the knots of `trajectory`; 0 where nothing touches or nothing is known. [m]"""
        if self.contact is None or self.scene is None:
            return 0.0
        from mjslq.dynamics.mujoco.replay import penetration

        return penetration(self)

    def replay(self, contact: str | Contact = "stiff", *, feedback: bool = True) -> Replay:
        """Simulate the same controls on the same model with another kind of contact: what a smooth one has hidden.

        Parameters
        ----------
        contact : str or Contact
            "stiff", "smooth", "model" (the model's own parameters) or a `mjslq.Contact`.
        feedback : bool
            Whether the policy acts, its gains included; the controls alone otherwise.

        Returns
        -------
        Replay
            Its trajectory can be handed to `problem.cost`.

        Raises
        ------
        ValueError
            For results whose engine knows no contacts, and unknown kinds.
        """
        if self.contact is None or self.scene is None:
            raise ValueError("only results of MuJoCo models can be replayed with other contacts")
        from mjslq.dynamics.mujoco.replay import replay

        return replay(self, Contact.of(contact), feedback)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything to the file `path` (NumPy's npz), whole or not at all.

        Raises ValueError where it cannot be written, such as on a full disk; a file that was there stays as it was.
        """
        from mjslq.storage import save

        save(self, path)


def load(path: str | os.PathLike[str]) -> Result:
    """Read a result that `Result.save` wrote; nothing in the file is executed.

    Parameters
    ----------
    path : str or path
        The .npz file.

    Returns
    -------
    Result
        Equal to the one that was saved, bit for bit.

    Raises
    ------
    FileNotFoundError
        When there is no such file.
    ValueError
        When it is something else than a result, damaged, or of another version of the format.

    Examples
    --------
    >>> import os, tempfile
    >>> result = mjslq.solve(mjslq.problems.get("hopper", height=1.0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result.save(os.path.join(folder, "hop.npz"))
    ...     again = mjslq.load(os.path.join(folder, "hop.npz"))
    >>> again.cost == result.cost
    True
    """
    from mjslq.storage import load as read

    return read(path)
