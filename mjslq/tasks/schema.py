"""What a task file may hold: the tables of the TOML, their keys, and the kinds of values that these take.

    model = "arm.xml"        a file, a robot's name, or "menagerie:NAME"
    horizon = 100            steps; or duration = 2.0, in seconds
    free_time = [1.0, 4.0]   limits of the final time, if it is unknown [s]
    [engine]                 which engine, and its options
    [start]                  where the motion begins, and the first controls
    [[costs]]                one table a term; `kind` says which
    [[constraints]]          one table a constraint; `kind` says which
    [bounds]                 limits of the controls
    [solve]                  the method and its options

`mjslq schema` prints these records as a JSON schema, which editors use for completion; `reading` turns what does not
fit into a sentence with its line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from mjslq.dynamics.records import OfFrame
from mjslq.losses import LossName


@dataclass(frozen=True)
class Says:
    """What a value has to be, in words for a message."""

    words: str


Names = Annotated[dict[str, float], Says("a table of numbers by name")]
Numbers = Annotated[
    float | list[float] | list[list[float]], Says("a number, a list of numbers or a list of such lists")
]
Weight = Annotated[
    float | list[float] | list[list[float]] | dict[str, float],
    Says("a number, a list (a diagonal), a list of lists (a matrix) or a table of numbers by name"),
]
ByJoint = Annotated[float | dict[str, float], Says("a number or a table of numbers by joint")]
Limits = Annotated[list[float], Field(min_length=2, max_length=2), Says("a pair [lower, upper]")]
Quantities = Annotated[
    dict[str, str], Says('a table of quantities of the model by name, such as { mass = "body/pole/mass" }')
]
Text = Annotated[str, Field(min_length=1)]
Positive = Annotated[float, Field(gt=0.0), Says("a number above 0")]
Count = Annotated[int, Field(ge=1), Says("a whole number of at least 1")]


class Table(BaseModel):
    """A table of the file; keys that it does not have are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, populate_by_name=True)


class Window(Table):
    """A part of the horizon, both ends included: knots where they are whole numbers, else times [s]."""

    first: Annotated[int | float, Says("a knot or a time")] = Field(alias="from")
    last: Annotated[int | float, Says("a knot or a time")] = Field(alias="to")


When = Annotated[
    Literal["running", "terminal", "always", "initial"] | int | float | list[int] | list[float] | Window,
    Says('"running", "terminal", "always", "initial", a knot, a time, a list of either, or a window { from = , to = }'),
]
Of = Literal["position", "velocity"]


class Engine(Table):
    """The engine and its options."""

    kind: Literal["mujoco", "pinocchio"] = "mujoco"
    timestep: Positive | None = Field(default=None, description="Simulator step, in place of the model's own. [s]")
    substeps: Count | None = Field(default=None, description="Simulator steps that a control is held for. mujoco")
    integrator: Text | None = Field(default=None, description="In place of the model's own.")
    jacobian: Literal["auto", "inverse", "transition"] | None = Field(default=None, description="mujoco")
    threads: Count | None = Field(default=None, description="Threads for Jacobians. mujoco")
    parameters: Quantities | None = Field(
        default=None, description="Numbers of the model for free_parameters, by name. mujoco"
    )
    floating: bool | None = Field(default=None, description="Free the base of a URDF.")
    floor: bool | None = Field(default=None, description="Add a ground plane to a URDF. mujoco")
    self_contacts: bool | None = Field(
        default=None, description="Let the links of a URDF touch each other; true unless given. mujoco"
    )
    contact: Literal["model", "smooth", "stiff"] | None = Field(
        default=None, description="How hard bodies touch, in place of the model's own: smooth to find motions. mujoco"
    )
    foresight: Annotated[float, Field(ge=0.0), Says("a number of at least 0")] | None = Field(
        default=None, description="Distance from which on derivatives feel contacts that are not there yet. mujoco [m]"
    )
    armature: Annotated[float, Field(ge=0.0), Says("a number of at least 0")] | None = Field(
        default=None, description="Rotor inertia of a URDF's joints. [kg m^2 or kg]"
    )
    packages: Text | list[Text] | None = Field(default=None, description="Folders of a URDF's package:// meshes.")
    locked_joints: list[Text] | dict[str, float] | None = Field(
        default=None, description="Joints to fix, at zero or at these positions. pinocchio"
    )


class Start(Table):
    """Where the motion begins, and the first controls."""

    keyframe: Text | None = Field(default=None, description="A keyframe of the model.")
    clip: Text | None = Field(
        default=None, description="A .csv or .npz file with joint positions, in which the motion begins."
    )
    positions: Names | None = Field(default=None, description="Entries of the state that differ, by name.")
    velocities: Names | None = Field(default=None, description="Velocities by joint name. [rad/s or m/s]")
    controls: Annotated[
        Literal["zero", "hold", "keyframe", "clip"] | list[float],
        Says(
            '"zero", "hold" (which balances the start), "keyframe", "clip" (the states of the start\'s clip) or a list '
            "with a number for each control"
        ),
    ] = "zero"


class _Loss(Table):
    loss: LossName = Field(default="quadratic", description="Loss of the residual; see mjslq.losses.")
    width: Positive | None = Field(default=None, description="Width of the losses other than quadratic.")


class ControlCost(_Loss):
    """1/2 weight |u - target|^2, integrated over time."""

    kind: Literal["control"]
    weight: Weight
    target: Annotated[
        float | list[float] | list[list[float]] | dict[str, float],
        Says("a number, a list with a number for each control, a list of such lists, or a table by name"),
    ] = 0.0
    when: When = "running"


class StateCost(_Loss):
    """1/2 weight |x - target|^2."""

    kind: Literal["state"]
    weight: Weight
    target: Annotated[
        Literal["start"] | list[float] | list[list[float]] | dict[str, float],
        Says('"start", a list with a number for each entry, or a table of entries that differ from the start'),
    ] = "start"
    when: When = "running"
    terminal_weight: Weight | None = None


class JointsCost(_Loss):
    """1/2 weight |q - target|^2 for the joints with one axis, or some of them, or of their velocities."""

    kind: Literal["joints"]
    target: Annotated[Literal["start"] | dict[str, float], Says('"start" or a table of numbers by joint')]
    weight: ByJoint = 1.0
    of: Of = "position"
    when: When = "running"
    terminal_weight: ByJoint | None = None


class VelocitiesCost(_Loss):
    """1/2 weight |v|^2 of all velocities, or of those of some joints."""

    kind: Literal["velocities"]
    weight: ByJoint
    when: When = "running"
    terminal_weight: ByJoint | None = None


class SensorCost(_Loss):
    """1/2 weight |reading - target|^2 of a sensor of the model."""

    kind: Literal["sensor"]
    name: Text
    target: Numbers
    weight: Weight = 1.0
    when: When = "running"
    terminal_weight: Weight | None = None


class FrameCost(SensorCost):
    """The same for a site, body, geom, camera (mujoco) or frame (pinocchio), which needs no sensor in the model."""

    kind: Literal["frame"]  # type: ignore[assignment]
    of: OfFrame = "position"


class ClipCost(Table):
    """Distance of frames from those of a recorded motion; see `mjslq.Clip.costs`."""

    kind: Literal["clip"]
    file: Text = Field(description="A .csv or .npz file; see mjslq.clips.files.")
    weights: Annotated[dict[str, float], Says("a table of numbers by quantity of frames")] | None = Field(
        default=None, description="Of position, orientation, linear-velocity, angular-velocity; 100, 10, 1 and 0.1."
    )
    names: Annotated[dict[str, Text], Says("a table of the model's names by those of the clip")] | None = Field(
        default=None, description="Frames to track, name in the clip = name in the model; all unless given."
    )
    loss: Annotated[LossName | dict[str, LossName], Says("a loss or a table of losses by quantity of frames")] = (
        "pseudo-huber"
    )
    width: (
        Annotated[Positive | dict[str, float], Says("a number above 0 or a table of such by quantity of frames")] | None
    ) = Field(default=None, description="Width of the losses other than quadratic.")
    when: When = "always"
    terminal: Annotated[float, Field(ge=0.0), Says("a number of at least 0")] = Field(
        default=1.0, description='Factor of the weights at the last knot, with when = "always".'
    )
    offset: float = Field(default=0.0, description="Time after the clip's beginning at which the horizon begins. [s]")
    stretch: Positive = Field(default=1.0, description="How much longer the motion takes than the recording.")
    beyond: Annotated[Literal["hold", "refuse"], Says('"hold" or "refuse"')] = "hold"


class TimeCost(Table):
    """The final time, times a weight."""

    kind: Literal["time"]
    weight: float = 1.0


class ControlConstraint(Table):
    """Limits of the controls beside those of the model."""

    kind: Literal["control"]
    limits: Annotated[dict[str, Limits], Says("a table of pairs [lower, upper] by control")]
    name: Text | None = None


class JointsConstraint(Table):
    """Limits of joints, or of their velocities: the model's own ranges, or given ones."""

    kind: Literal["joints"]
    limits: Annotated[Literal["model"] | dict[str, Limits], Says('"model" or a table of pairs [lower, upper] by joint')]
    margin: Annotated[float, Field(ge=0.0), Says("a number of at least 0")] = Field(
        default=0.0, description="How far to keep within them, away from the springs at the ends. [rad or m]"
    )
    of: Of = "position"
    when: When = "always"
    name: Text | None = None


class SensorConstraint(Table):
    """Limits of a sensor's reading; equal ones make it an equality."""

    kind: Literal["sensor"]
    sensor: Text
    lower: Numbers | None = None
    upper: Numbers | None = None
    when: When = "always"
    name: Text | None = None


class FrameConstraint(Table):
    """The same for a site, body, geom, camera (mujoco) or frame (pinocchio)."""

    kind: Literal["frame"]
    frame: Text
    of: OfFrame = "position"
    lower: Numbers | None = None
    upper: Numbers | None = None
    when: When = "always"
    name: Text | None = None


class DistanceConstraint(Table):
    """A least distance between two geoms or bodies. [m]"""

    kind: Literal["distance"]
    between: Annotated[list[Text], Field(min_length=2, max_length=2), Says("a pair of names of geoms or bodies")]
    lower: float = 0.0
    within: Positive = Field(default=1.0, description="Distance up to which it is measured. [m]")
    when: When = "always"
    name: Text | None = None


OneCost = ControlCost | StateCost | JointsCost | VelocitiesCost | SensorCost | FrameCost | TimeCost
"""Tables that are a term of the cost each."""
Cost = Annotated[OneCost | ClipCost, Field(discriminator="kind")]
Constraint = Annotated[
    ControlConstraint | JointsConstraint | SensorConstraint | FrameConstraint | DistanceConstraint,
    Field(discriminator="kind"),
]


class Bounds(Table):
    """Limits of the controls."""

    u: Annotated[
        Literal["model", "none"] | dict[str, Limits],
        Says('"model", "none" or a table of pairs [lower, upper] by control'),
    ] = "model"


class Solve(Table):
    """The method and its options."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True)
    method: Text = "auto"

    @property
    def options(self) -> dict[str, Any]:
        """What was given beside the method."""
        return dict(self.model_extra or {})


class TaskFile(Table):
    """A task file."""

    model: Text = Field(description="A file (.xml, .urdf, .mjb), a robot's name, or menagerie:NAME.")
    name: Text | None = Field(default=None, description="What the problem is called; the file's name unless given.")
    horizon: Count | None = Field(default=None, description="Number of steps N.")
    duration: Positive | None = Field(default=None, description="In place of the horizon. [s]")
    free_time: Limits | None = Field(
        default=None, description="[shortest, longest]: the final time is unknown, and starts from the duration. [s]"
    )
    free_parameters: Annotated[dict[str, Limits], Says("a table of pairs [lower, upper] by parameter")] | None = Field(
        default=None, description="Parameters of the engine that are unknown, with their limits."
    )
    engine: Engine = Engine()
    start: Start = Start()
    costs: Annotated[list[Cost], Field(min_length=1), Says("a list of tables, written [[costs]]")]
    constraints: Annotated[list[Constraint], Says("a list of tables, written [[constraints]]")] = []
    bounds: Bounds = Bounds()
    solve: Solve = Solve()
