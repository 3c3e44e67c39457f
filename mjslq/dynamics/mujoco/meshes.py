"""Mesh files of a URDF: where they are, and which of them MuJoCo can read.

    package://name/rest    rest in the package `name`, looked up, in this order, in
                           packages=             its folder by name, or folders that hold packages (or are the package);
                           the folders above the file that have this name, and beside which it lies;
                           ROS_PACKAGE_PATH      folders that hold packages, or are the package;
                           AMENT_PREFIX_PATH     prefixes, in whose share/ packages are
    file:///path, path     an absolute path, or one from the file's folder on

MuJoCo reads OBJ, MSH and binary STL. Elements with other meshes, or meshes that are not there, are left out, each with
a warning: a visual one costs looks, a collision one its contacts. Visual ones that are there and cannot be read, of
which a robot may have dozens, share one.
"""

from __future__ import annotations

import os
import struct
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping
from pathlib import Path

Packages = str | Path | Iterable[str | Path] | Mapping[str, str | Path] | None
"""A folder that holds packages or is one, several of them, or packages' folders by name."""


def resolve_meshes(root: ElementTree.Element, file: Path, packages: Packages = None, silent: bool = False) -> None:
    """Make mesh paths absolute; drop elements whose mesh is not there or cannot be read, with a warning each.

    Raises ValueError when `packages` names a folder that does not exist. `silent` is for those who draw alone.
    """
    named, folders = _given(packages)
    left: dict[tuple[str, str], Path | None] = {}
    for link in root.iter("link"):
        for element in link.findall("visual") + link.findall("collision"):
            element.attrib.pop("name", None)  # often given twice, which MuJoCo complains of
            mesh = element.find("geometry/mesh")
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            found = _mesh_file(name, file, named, folders)
            if found is not None and _is_readable(found):
                mesh.set("filename", str(found))
                continue
            link.remove(element)
            left[element.tag, name] = found
    if silent:
        return
    groups: dict[tuple[str, str], tuple[list[str], Path | None]] = {}
    for (role, name), found in left.items():
        shared = role == "visual" and found is not None
        groups.setdefault((role, found.suffix if shared and found else name), ([], found))[0].append(repr(name))
    for (role, _), (names, found) in groups.items():
        warnings.warn(_sentence(file, role, ", ".join(names), found), stacklevel=2)


def _sentence(file: Path, role: str, name: str, found: Path | None) -> str:
    """What is left out, and why."""
    loss = "contacts" if role == "collision" else "looks"
    if found is not None:
        kind = "STL text files" if found.suffix.lower() == ".stl" else f"{found.suffix or 'such'} files"
        reason = f"MuJoCo cannot read {kind} (.obj, .msh and binary .stl it can)"
    elif "package://" in name:
        reason = "it was not found; packages= takes the package's folder, as do ROS_PACKAGE_PATH and AMENT_PREFIX_PATH"
    else:
        reason = f"there is no such file in {file.parent}"
    return f"{file.name}: the {role} mesh {name} is left out, and its {loss} with it: {reason}"


def _given(packages: Packages) -> tuple[dict[str, Path], list[Path]]:
    """Packages by name, and folders to look in."""
    if packages is None:
        return {}, []
    if isinstance(packages, Mapping):
        named = {name: Path(folder).expanduser() for name, folder in packages.items()}
        folders: list[Path] = []
    else:
        given = [packages] if isinstance(packages, (str, Path)) else list(packages)
        named, folders = {}, [Path(folder).expanduser() for folder in given]
    for folder in (*named.values(), *folders):
        if not folder.is_dir():
            raise ValueError(f"packages must name folders, but {str(folder)!r} is none")
    return named, folders


def _mesh_file(name: str, file: Path, named: Mapping[str, Path], folders: list[Path]) -> Path | None:
    """Where a mesh lies, as an absolute path; None where it was not found."""
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        above = list(file.parents)
        places = [named[package] / rest] if package in named else []
        places += _within(folders, package, rest)
        places += [a / rest for a in above if a.name == package] + [a / package / rest for a in above]
        places += _within(_listed("ROS_PACKAGE_PATH"), package, rest)
        places += [prefix / "share" / package / rest for prefix in _listed("AMENT_PREFIX_PATH")]
    else:
        places = [file.parent / name.removeprefix("file://")]
    return next((place.absolute() for place in places if place.is_file()), None)


def _within(folders: list[Path], package: str, rest: str) -> list[Path]:
    return [place for f in folders for place in (f / package / rest, *([f / rest] if f.name == package else []))]


def _listed(variable: str) -> list[Path]:
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def _is_readable(mesh: Path) -> bool:
    """Whether MuJoCo can decode a mesh file: OBJ, MSH and binary STL, whose length follows from its head."""
    if mesh.suffix.lower() != ".stl":
        return mesh.suffix.lower() in (".obj", ".msh")
    with mesh.open("rb") as stream:
        head = stream.read(84)
    return len(head) == 84 and mesh.stat().st_size == 84 + 50 * struct.unpack("<I", head[80:])[0]
