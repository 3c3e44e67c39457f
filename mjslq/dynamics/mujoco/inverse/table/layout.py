"""Where constraint rows and contacts lie: MuJoCo puts them into a new place of its arena at every step.

All other arrays of mjData stay where they are, and the kernels reach them through the views of the Python bindings.
For the arena's the kernels read the pointers in mjData itself. Their offsets follow from the description of MuJoCo's
structs that comes with the Python package (mujoco.introspect), laid out as a C compiler does; `offsets` compares the
result with the bindings' own view of a small model, and raises RuntimeError when they disagree.
"""

from __future__ import annotations

import ctypes
import functools
from typing import Any

import mujoco

ARENA = (
    "contact", "efc_type", "efc_id", "efc_state", "efc_J_rownnz", "efc_J_rowadr", "efc_J_colind",
    "efc_J", "efc_pos", "efc_margin", "efc_KBIP", "efc_D", "efc_R", "efc_force", "efc_aref", "efc_vel",
)  # fmt: skip
COUNTS = ("ncon", "nefc")
CONTACT = ("dist", "pos", "frame", "includemargin", "friction", "H", "dim", "geom", "efc_address", "solref")

_VALUES = {
    "int": ctypes.c_int,
    "mjtNum": ctypes.c_double,
    "double": ctypes.c_double,
    "mjtSize": ctypes.c_int64,
    "mjtByte": ctypes.c_ubyte,
    "mjtBool": ctypes.c_bool,
    "float": ctypes.c_float,
    "size_t": ctypes.c_size_t,
    "uintptr_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
}
_PROBE = """
<mujoco><worldbody>
  <geom type="plane" size="1 1 1"/>
  <body pos="0 0 .05"><freejoint/><geom size=".1"/></body>
</worldbody></mujoco>
"""


@functools.cache
def offsets() -> dict[str, int]:
    """Offsets in bytes of the fields of mjData and ("contact.dist") of mjContact that the kernels read.

    Raises RuntimeError when MuJoCo's description of its structs does not fit its library.
    """
    data, contact = _structure("mjData"), _structure("mjContact")
    found = {name: getattr(data, name).offset for name in ARENA + COUNTS}
    found |= {f"contact.{name}": getattr(contact, name).offset for name in CONTACT}
    found["contact.size"] = ctypes.sizeof(contact)
    _compare(found)
    return found


def _compare(found: dict[str, int]) -> None:
    """Hold the offsets against the bindings' views of a sphere that rests on a plane."""
    model = mujoco.MjModel.from_xml_string(_PROBE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    fits = all(ctypes.c_int.from_address(data._address + found[name]).value == getattr(data, name) for name in COUNTS)
    pointers = {name: ctypes.c_void_p.from_address(data._address + found[name]).value or 0 for name in ARENA}
    fits = fits and all(pointers[name] == getattr(data, name).ctypes.data for name in ARENA if name != "contact")
    if fits:
        first, seen = pointers["contact"], data.contact[0]
        fits = (
            ctypes.c_double.from_address(first + found["contact.dist"]).value == seen.dist
            and ctypes.c_double.from_address(first + found["contact.H"] - 8).value == seen.mu
            and ctypes.c_int.from_address(first + found["contact.dim"]).value == seen.dim
            and ctypes.c_int.from_address(first + found["contact.geom"] + 4).value == seen.geom[1]
            and ctypes.c_int.from_address(first + found["contact.efc_address"]).value == seen.efc_address
        )
    if not fits:
        raise RuntimeError(f"MuJoCo {mujoco.__version__} lays out mjData otherwise than it says")


def _structure(name: str) -> Any:
    """Build the ctypes structure of one of MuJoCo's structs."""
    from mujoco.introspect import structs

    fields = [(field.name, _type(field.type)) for field in structs.STRUCTS[name].fields]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def _type(kind: Any) -> Any:
    """Find the ctypes counterpart of a C type."""
    from mujoco.introspect import ast_nodes

    if isinstance(kind, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(kind, ast_nodes.ArrayType):
        size = 1
        for extent in kind.extents:
            size *= extent
        return _type(kind.inner_type) * size
    return _VALUES[kind.name] if kind.name in _VALUES else _structure(kind.name)
