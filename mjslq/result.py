"""`Result`: everything that a solve leaves behind, kept so that it can be shown again without the solver."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from mjslq.files import atomic_write
from mjslq.log import IterationLog
from mjslq.scene import Scene
from mjslq.status import Status
from mjslq.trajectory import Trajectory
from mjslq.validation import Array

FORMAT = 1
"""Version of the file format; files of a later version are refused."""


@dataclass(frozen=True)
class Result:
    """Outcome of `solve`; every array of it survives `save` and `load`."""

    status: Status
    """Why the solve stopped."""
    message: str
    """What that means here, and what can be tried."""
    cost: float
    """Cost of `trajectory`."""
    iterations: int
    """Steps taken."""
    gradient_norm: float
    """Euclidean norm of dJ/dU at `trajectory`."""
    trajectory: Trajectory
    """The best iterate."""
    gains: Array
    """Feedback gains K of u_n + K_n difference(x, x_n) = u_n - K_n difference(x_n, x). Shape (N, nu, ndx)."""
    constraint_violation: float = 0.0
    """Largest violation of any constraint; 0 without constraints."""
    log: tuple[IterationLog, ...] = ()
    """One entry an iteration, the start included."""
    iterates: tuple[Trajectory, ...] = ()
    """The trajectory of each entry of `log`, when kept."""
    seconds: float = 0.0
    """Wall time of the solve. [s]"""
    problem: str = ""
    """The problem's name."""
    method: str = ""
    """The method's name."""
    options: dict[str, Any] = field(default_factory=dict)
    """The options that the method ran with, and the problem's parameters."""
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Names of the entries of "states", "controls" and "outputs"."""
    scene: Scene | None = None
    """What a viewer draws; None when the problem has nothing to draw."""

    @property
    def success(self) -> bool:
        """Whether the solve converged."""
        return self.status is Status.CONVERGED

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write everything to `path` (NumPy's npz), whole or not at all."""
        arrays: dict[str, Any] = {"gains": self.gains} | _pack("trajectory", [self.trajectory])
        if self.iterates:
            arrays |= _pack("iterates", self.iterates)
        if self.scene is not None:
            arrays["scene_model"] = np.frombuffer(self.scene.model, dtype=np.uint8)
            arrays["scene_columns"] = np.array(self.scene.columns, dtype=np.int64)
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name in _PLAIN}
        header = plain | {
            "format": FORMAT,
            "status": self.status.value,
            "log": [asdict(entry) for entry in self.log],
            "scene_name": None if self.scene is None else self.scene.name,
        }
        with atomic_write(path) as stream:
            np.savez_compressed(stream, header=np.array(json.dumps(header, default=_plain)), **arrays)


_PLAIN = {
    "message", "cost", "iterations", "gradient_norm", "constraint_violation",
    "seconds", "problem", "method", "options", "names",
}  # fmt: skip


def load(path: str | os.PathLike[str]) -> Result:
    """Read a result that `Result.save` wrote.

    Raises FileNotFoundError when there is no such file, ValueError when it is something else than a result.
    """
    name = os.fspath(path)
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as data:
            header = json.loads(str(data["header"]))
            if header["format"] > FORMAT:
                raise _LaterFormat(
                    f"{name} has format {header['format']}, this version of mjslq reads up to {FORMAT}; upgrade it"
                )
            return _result_of(header, {entry: data[entry] for entry in data.files})
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no file {name}") from None
    except _LaterFormat:
        raise
    except Exception as error:  # whatever a foreign or damaged file makes the readers of zip, npy and JSON raise
        raise ValueError(f"{name} is not a result saved by mjslq ({' '.join(str(error).split())})") from None


class _LaterFormat(ValueError):
    """The file comes from a later version."""


def _result_of(header: dict[str, Any], arrays: dict[str, Array]) -> Result:
    scene = None
    if "scene_model" in arrays:
        columns = tuple(int(i) for i in arrays["scene_columns"])
        scene = Scene(arrays["scene_model"].tobytes(), columns, header["scene_name"])
    return Result(
        **{name: header[name] for name in _PLAIN - {"names"}},
        names={kind: tuple(entries) for kind, entries in header["names"].items()},
        status=Status(header["status"]),
        log=tuple(IterationLog(**entry) for entry in header["log"]),
        trajectory=_unpack("trajectory", arrays)[0],
        iterates=_unpack("iterates", arrays),
        gains=arrays["gains"],
        scene=scene,
    )


def _pack(name: str, trajectories: Any) -> dict[str, Array]:
    packed = {f"{name}_{part}": np.stack([getattr(t, part) for t in trajectories]) for part in ("X", "U", "Y")}
    packed[f"{name}_dt"] = trajectories[0].dt
    packed[f"{name}_diverged_at"] = np.array(
        [-1 if t.diverged_at is None else t.diverged_at for t in trajectories], dtype=np.int64
    )
    return packed


def _unpack(name: str, arrays: dict[str, Array]) -> tuple[Trajectory, ...]:
    if f"{name}_X" not in arrays:
        return ()
    X, U, Y, dt, diverged_at = (arrays[f"{name}_{part}"] for part in ("X", "U", "Y", "dt", "diverged_at"))
    return tuple(
        Trajectory(x, u, y, dt, None if at < 0 else int(at)) for x, u, y, at in zip(X, U, Y, diverged_at, strict=True)
    )


def _plain(value: Any) -> Any:
    """What JSON does not know: numpy's numbers and arrays; anything else by its text."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)
