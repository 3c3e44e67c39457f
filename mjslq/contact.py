"""`Contact`: stiffness and damping of the contacts of a MuJoCo model, recorded with each result.

    model     as the model has it
    smooth    a contact that gives way gently, over `width`: hardly a force at first touch, more with depth; searches
              feel their way through touch-downs and pushes, and feet sink about a centimetre
    stiff     MuJoCo's own default: nearly the whole force within a millimetre

MuJoCo's contact pulls the penetration r back like a spring and damper, r'' = -d(r) (b r' + k r), with the share d(r) of
the force that the constraint has (its impedance) growing from d_0 at first touch to d_width at the depth `width`; k and
b come from a time constant and a damping ratio (MuJoCo's documentation, "Solver parameters").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from mjslq.trajectory import Trajectory
from mjslq.validation import Array, choose, positive

KINDS = ("model", "smooth", "stiff")
_DEFAULTS: dict[str, tuple[float, float, float, float]] = {
    "smooth": (0.0, 0.99, 0.02, 0.02),
    "stiff": (0.9, 0.95, 0.001, 0.02),
}
"""d_0, d_width, width [m], time constant [s]."""


@dataclass(frozen=True)
class Contact:
    """Contact parameters of a MuJoCo model; those that are not given are the defaults of the kind.

    Raises ValueError for an unknown kind, parameters of "model", which has its own, and values out of range.

    Examples
    --------
    >>> mjslq.Contact("smooth", width=0.01).solimp
    (0.0, 0.99, 0.01, 0.5, 2.0)
    """

    kind: str = "model"
    """"model", "smooth" or "stiff"."""
    width: float | None = None
    """Depth at which the contact has its full stiffness; 0.02 smooth, 0.001 stiff. [m]"""
    time_constant: float | None = None
    """Of the spring and damper: the smaller the stiffer; MuJoCo takes no less than two timesteps. 0.02. [s]"""
    damping_ratio: float | None = None
    """Of the spring and damper; 1."""
    at_touch: float | None = None
    """Impedance d_0 at first touch, from 0 to below 1; 0 smooth, 0.9 stiff."""
    at_width: float | None = None
    """Impedance d_width, from 0 to below 1; 0.99 smooth, 0.95 stiff."""

    def __post_init__(self) -> None:
        choose("contact", self.kind, KINDS)
        given = {name: value for name, value in vars(self).items() if name != "kind" and value is not None}
        if self.kind == "model":
            if given:
                raise ValueError(
                    f"contact 'model' keeps the model's own parameters, so {', '.join(given)} cannot be given; "
                    f"choose 'smooth' or 'stiff'"
                )
            return
        d_0, d_width, width, time_constant = _DEFAULTS[self.kind]
        filled = {
            "width": width, "time_constant": time_constant, "damping_ratio": 1.0, "at_touch": d_0, "at_width": d_width,
        } | given  # fmt: skip
        for name, value in filled.items():
            number = float(value)
            if name.startswith("at_"):
                if not 0.0 <= number < 1.0:
                    raise ValueError(f"{name} must lie from 0 to below 1, got {value}")
            else:
                positive(name, number)
            object.__setattr__(self, name, number)

    @property
    def solref(self) -> tuple[float, float]:
        """MuJoCo's parameters of the spring and damper. Raises ValueError for "model"."""
        self._refuse_model()
        assert self.time_constant is not None and self.damping_ratio is not None
        return self.time_constant, self.damping_ratio

    @property
    def solimp(self) -> tuple[float, float, float, float, float]:
        """MuJoCo's parameters of the impedance. Raises ValueError for "model"."""
        self._refuse_model()
        assert self.at_touch is not None and self.at_width is not None and self.width is not None
        return self.at_touch, self.at_width, self.width, 0.5, 2.0

    def __str__(self) -> str:
        """The kind and its parameters, for tables."""
        if self.kind == "model":
            return "model"
        assert self.width is not None and self.time_constant is not None
        return f"{self.kind} (width {1e3 * self.width:g} mm, time constant {1e3 * self.time_constant:g} ms)"

    @classmethod
    def of(cls, given: Any) -> Contact:
        """Return `given`, a kind's name or a `Contact`, as a `Contact`. Raises ValueError for anything else."""
        if isinstance(given, cls):
            return given
        if isinstance(given, str):
            return cls(choose("contact", given, KINDS))
        raise ValueError(f"contact must be one of {', '.join(KINDS)} or mjslq.Contact, got {given!r}")

    def _refuse_model(self) -> None:
        if self.kind == "model":
            raise ValueError("contact 'model' keeps the model's own parameters")


class Replay(NamedTuple):
    """A result's controls, simulated with other contact parameters."""

    trajectory: Trajectory
    """Simulated anew."""
    contact: Contact
    """How hard bodies touched."""
    penetration: float
    """Largest depth of a contact. [m]"""
    deviation: Array
    """Distance of its states from the result's, at each knot, in tangent directions. Shape (N + 1, ndx)."""
