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
    """Names that `robot_path` knows.

    Returns
    -------
    tuple of str
        In alphabetical order.

    Examples
    --------
    >>> from mjslq.robots import robot_names
    >>> "panda" in robot_names()
    True
    """
    return tuple(_robots())


def robot_path(name: str) -> Path:
    """Path of the URDF file of a robot of the package example-robot-data.

    Parameters
    ----------
    name : str
        Such as "panda", "ur5", "solo12" or "g1"; `mjslq.robots.robot_names` lists them.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    ValueError
        When there is no such robot; lists the names.

    Examples
    --------
    >>> mjslq.robot_path("ur5").name
    'ur5_robot.urdf'
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
    name : str
        As in `robot_path`.
    floating : bool
        Give the root link a free joint, named "root", instead of fixing it to the world.
    motors : bool
        Add a motor, limited by the joint's effort, to every joint with one axis that does not mimic another.
    floor : bool
        Add a ground plane at height zero, and a light.
    armature : float
        Rotor inertia of every joint with one axis. [kg m^2 or kg]
    self_contacts : bool
        Let the robot's links touch each other; in many URDF files they overlap where they are joined.

    Returns
    -------
    mujoco.MjSpec
        Without the meshes that MuJoCo cannot read, of which the package has many (.dae): no warning tells of them.

    Raises
    ------
    ValueError
        When there is no such robot.

    Examples
    --------
    >>> from mjslq.robots import robot_spec
    >>> arm = mjslq.MujocoDynamics.from_spec(robot_spec("ur5", armature=0.01, self_contacts=False))
    >>> arm.nu
    6
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
