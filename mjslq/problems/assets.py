"""The MJCF files that come with the package."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mjslq.validation import choose, positive

if TYPE_CHECKING:
    import mujoco

_PACKAGE = Path(__file__).resolve().parents[1]


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


def load_asset(name: str, timestep: float) -> mujoco.MjSpec:
    """Read the MJCF file `name` of the assets, with steps of `timestep` [s]."""
    from mjslq.dynamics.mujoco.files import load_spec

    spec = load_spec(asset_path(name))
    spec.option.timestep = positive("timestep", timestep)
    return spec
