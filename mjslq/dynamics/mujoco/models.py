"""The two MJCF models that come with the package, with their parameters: the hopping machine, the particle in drag."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mjslq.validation import choose, positive

if TYPE_CHECKING:
    import mujoco

_PACKAGE = Path(__file__).resolve().parents[2]
_FAR = 1e6  # upper end of the springs' dead bands: never reached


def asset_path(name: str) -> Path:
    """File `name` of the assets: in the package when it was installed, beside it in a checkout.

    Raises ValueError, which lists the files there are, when there is none of that name.
    """
    folders = [folder for folder in (_PACKAGE / "assets", _PACKAGE.parent / "assets") if folder.is_dir()]
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    choose("asset", name, sorted(path.name for folder in folders for path in folder.iterdir()))
    raise ValueError(f"the asset {name!r} is not a file")


def hopper_spec(
    stiffness: float = 500.0, smoothing: float = 0.1, gravity: float = 386.4, timestep: float = 0.01
) -> mujoco.MjSpec:
    """Load the hopping machine of assets/hopper.xml, which explains the construction.

    Parameters
    ----------
    stiffness
        Spring constant over mass, k / m. [1/s^2]
    smoothing
        Compression alpha below which the spring is quadratic. [in]  Small values cost digits: the force is exact
        to about 1e-16 / alpha relative to the compression.
    gravity
        Gravitational acceleration g. [in/s^2]
    timestep
        Step length h. [s]
    """
    stiffness, smoothing = positive("stiffness", stiffness), positive("smoothing", smoothing)
    spec = _load("hopper.xml", timestep)
    spec.option.gravity = [0.0, 0.0, -positive("gravity", gravity)]
    curvature = stiffness / (2.0 * smoothing)
    for name, lower, sign in (("spring", 0.0, -1.0), ("smoothing", -smoothing, 1.0)):
        tendon = spec.tendon(name)
        tendon.springlength = [lower, _FAR]
        tendon.stiffness = [0.0, sign * curvature, 0.0]
    drive = spec.joint("piston").armature / spec.option.timestep
    actuator = spec.actuator("piston")
    actuator.gainprm[0], actuator.biasprm[2] = drive, -drive
    return spec


def drag_spec(beta: float, timestep: float = 1.0 / 500.0) -> mujoco.MjSpec:
    """Load the particle with quadratic drag of assets/drag_particle.xml.

    Parameters
    ----------
    beta
        Drag coefficient: the force is -beta v |v|. [kg/m]
    timestep
        Step length h. [s]
    """
    spec = _load("drag_particle.xml", timestep)
    spec.joint("x").damping = [0.0, positive("beta", beta), 0.0]
    return spec


def _load(name: str, timestep: float) -> mujoco.MjSpec:
    from mjslq.dynamics.mujoco.files import load_spec

    spec = load_spec(asset_path(name))
    spec.option.timestep = positive("timestep", timestep)
    return spec
