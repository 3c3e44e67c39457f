"""The state space of a Pinocchio model: its differences are those of pin.difference and pin.integrate.

Notation
--------
    x = (q, v)      q holds, by kind of joint,
    free-flyer      (x, y, z, qx, qy, qz, qw)   a rigid motion, whose tangent directions are in the body's frame
    spherical       (qx, qy, qz, qw)            a rotation
    planar          (x, y, cos, sin)            a rigid motion of the plane
    unbounded       (cos, sin)                  a rotation about an axis
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mjslq.lie_groups import MOTION, ROTATION, SLIDE, TURN, Group
from mjslq.manifold import StateSpace

_KINDS: dict[tuple[str, int, int], tuple[Group, tuple[int, ...]]] = {
    ("JointModelFreeFlyer", 7, 6): (MOTION, (0, 1, 2, 6, 3, 4, 5)),
    ("JointModelSpherical", 4, 3): (ROTATION, (3, 0, 1, 2)),
    ("JointModelPlanar", 4, 3): (SLIDE, (0, 1, 2, 3)),
}
"""The group of a joint by name and numbers of positions and velocities, and where the group's entries are in q."""
_UNBOUNDED = (TURN, (0, 1))


def state_space(model: Any) -> StateSpace:
    """State space of x = (q, v); raises ValueError for a joint of a kind that is not known here."""
    elements = []
    for j in range(1, model.njoints):
        for name, (nq, nv), q, v in _single(model.joints[j], model.idx_qs[j], model.idx_vs[j]):
            if nq == nv:
                continue
            known = _UNBOUNDED if (nq, nv) == (2, 1) else _KINDS.get((name, nq, nv))
            if known is None:
                raise ValueError(f"joint {model.names[j]!r} is of a kind that is not supported: {name}")
            group, order = known
            elements.append((group, [q + i for i in order], range(v, v + nv)))
    return StateSpace.of(model.nq + model.nv, 2 * model.nv, elements)


def _single(joint: Any, q: int, v: int) -> Iterator[tuple[str, tuple[int, int], int, int]]:
    """Name, sizes and first indices of a joint, or of those that a composite joint is made of."""
    if joint.shortname() != "JointModelComposite":
        yield joint.shortname(), (joint.nq, joint.nv), q, v
        return
    for part in joint.extract().joints:
        yield from _single(part, q, v)
        q, v = q + part.nq, v + part.nv
