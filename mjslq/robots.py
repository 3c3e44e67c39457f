"""Robots of example-robot-data by short name.

The package brings URDF files of some seventy robots, which both engines read: `MujocoDynamics.from_path` and
`PinocchioDynamics.from_path`.

    mjslq.robot_path("panda")                            the file
    mjslq.robots.robot_spec("go2", floating=True)        the same as an MjSpec, with a free base
"""

from __future__ import annotations

import functools
import importlib.metadata
from pathlib import Path
from typing import TYPE_CHECKING

from mjslq.validation import choose

if TYPE_CHECKING:
    import mujoco

_PACKAGE = "example-robot-data"
_FOLDER = "cmeel.prefix/share/example-robot-data/robots"

# Short names for files whose own names are long, or not alone. All others go by their file's name.
_SHORT = {
    "alex": "alex_description/urdf/alex_nub_hands.urdf",
    "alexander": "alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf",
    "allegro_left": "allegro_hand_description/urdf/allegro_left_hand.urdf",
    "allegro_right": "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "anymal_b": "anymal_b_simple_description/robots/anymal.urdf",
    "anymal_b_kinova": "anymal_b_simple_description/robots/anymal-kinova.urdf",
    "anymal_c": "anymal_c_simple_description/urdf/anymal.urdf",
    "b1_z1": "b1_description/urdf/b1-z1.urdf",
    "borinot": "borinot_description/urdf/borinot_flying_arm_2.urdf",
    "g1": "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "g1_hands": "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf",
    "hextilt": "hextilt_description/urdf/hextilt_flying_arm_5.urdf",
    "hyq": "hyq_description/robots/hyq_no_sensors.urdf",
    "quadrotor": "hector_description/robots/quadrotor_base.urdf",
    "talos": "talos_data/robots/talos_full_v2.urdf",
    "talos_arm": "talos_data/robots/talos_left_arm.urdf",
    "two_dofs": "asr_twodof_description/urdf/TwoDofs.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
}


def robot_names() -> tuple[str, ...]:
    """Names that `robot_path` knows, in alphabetical order."""
    return tuple(_robots())


def robot_path(name: str) -> Path:
    """URDF file of the robot `name` ("panda", "ur5", "solo12", "g1", ...).

    Raises ValueError, which lists the names, when there is no such robot.
    """
    return _robots()[choose("robot", name, _robots())]


def robot_spec(
    name: str,
    *,
    floating: bool = False,
    motors: bool = True,
    floor: bool = False,
    armature: float = 0.0,
    self_contacts: bool = True,
) -> mujoco.MjSpec:
    """Read the robot `name` as an editable MuJoCo specification, for `MujocoDynamics.from_spec`.

    Parameters
    ----------
    name
        As in `robot_path`.
    floating
        Give the root link a free joint, named "root", instead of fixing it to the world.
    motors
        Add a motor, limited by the joint's effort, to every joint with one axis that does not mimic another.
    floor
        Add a ground plane at height zero, and a light.
    armature
        Rotor inertia of every joint with one axis. [kg m^2 or kg]
    self_contacts
        Let the robot's links touch each other; in many URDF files they overlap where they are joined.

    Meshes that MuJoCo cannot read (the package has many in .dae) are left out without a warning, as they are known.
    """
    from mjslq.dynamics.mujoco.files import urdf_spec

    return urdf_spec(
        robot_path(name), floating=floating, motors=motors, floor=floor, armature=armature, self_contacts=self_contacts,
        silent=True,
    )  # fmt: skip


@functools.cache
def _robots() -> dict[str, Path]:
    try:
        folder = Path(str(importlib.metadata.distribution(_PACKAGE).locate_file(_FOLDER)))
    except importlib.metadata.PackageNotFoundError:
        raise ValueError(
            f"the robots come with the package {_PACKAGE}; install it with: pip install {_PACKAGE}"
        ) from None
    short = {name: folder / path for name, path in _SHORT.items() if (folder / path).is_file()}
    named = set(short.values())
    long = {path.stem: path for path in sorted(folder.rglob("*.urdf")) if path not in named}
    return dict(sorted((long | short).items(), key=lambda item: item[0].lower()))
