"""Ways to make an engine: from a file, from MJCF text, from an `MjSpec`, from a compiled model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    import mujoco

    from mjslq.dynamics.mujoco.frames import Wanted
    from mjslq.dynamics.mujoco.meshes import Packages


class Constructors:
    """What `MujocoDynamics` can be made of; its own initializer takes a compiled model and the options."""

    if TYPE_CHECKING:

        def __init__(self, model: mujoco.MjModel, **options: Any) -> None: ...

    @classmethod
    def from_path(
        cls,
        path: str | Path,
        timestep: float | None = None,
        substeps: int = 1,
        jacobian: str = "auto",
        threads: int | None = None,
        packages: Packages = None,
        frames: Wanted = None,
        **options: Any,
    ) -> Self:
        """Read an MJCF (.xml), URDF (.urdf) or binary (.mjb) file; see the class for the options, and for `frames`.

        A URDF has no actuators: each joint gets a motor. `mjslq.robots.robot_spec` gives more say over that,
        and a floating base. Its meshes at package://name/... are looked for in `packages` (a folder that holds
        packages or is one, several, or folders by name), above the file, in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH;
        those that are left out are warned of.
        """
        from mjslq.dynamics.mujoco.files import check_kind, load_model
        from mjslq.dynamics.mujoco.names import model_name

        check_kind("from_path", path)
        model = load_model(path, packages, frames)
        options.setdefault("name", model_name(model) or Path(path).stem)
        return cls(model, timestep=timestep, substeps=substeps, jacobian=jacobian, threads=threads, **options)

    @classmethod
    def from_xml(
        cls,
        text: str,
        timestep: float | None = None,
        substeps: int = 1,
        jacobian: str = "auto",
        threads: int | None = None,
        frames: Wanted = None,
        **options: Any,
    ) -> Self:
        """Compile MJCF text; see the class for the options, and for `frames`."""
        from mjslq.dynamics.mujoco.files import model_of_text

        model = model_of_text(text, frames)
        return cls(model, timestep=timestep, substeps=substeps, jacobian=jacobian, threads=threads, **options)

    @classmethod
    def from_spec(
        cls,
        spec: mujoco.MjSpec,
        timestep: float | None = None,
        substeps: int = 1,
        jacobian: str = "auto",
        threads: int | None = None,
        frames: Wanted = None,
        **options: Any,
    ) -> Self:
        """Compile a copy of an `MjSpec`; see the class for the options, and for `frames`."""
        from mjslq.dynamics.mujoco.files import check_kind, compiled
        from mjslq.dynamics.mujoco.frames import add_frames

        check_kind("from_spec", spec)
        spec = spec.copy()
        add_frames(spec, frames)
        return cls(compiled(spec), timestep=timestep, substeps=substeps, jacobian=jacobian, threads=threads, **options)

    @classmethod
    def from_model(
        cls,
        model: mujoco.MjModel,
        timestep: float | None = None,
        substeps: int = 1,
        jacobian: str = "auto",
        threads: int | None = None,
        **options: Any,
    ) -> Self:
        """Copy a compiled `MjModel`; see the class for the options."""
        from mjslq.dynamics.mujoco.files import check_kind

        check_kind("from_model", model)
        if options.pop("frames", None) is not None:
            raise ValueError("a compiled model takes no sensors; frames is for from_path, from_xml and from_spec")
        return cls(model, timestep=timestep, substeps=substeps, jacobian=jacobian, threads=threads, **options)
