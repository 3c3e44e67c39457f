"""Joints of a URDF file that mimic others, at position m times theirs + o.

Those that mimic a locked joint are locked with it; the others follow: the model has no position and no velocity of
theirs (`tie`). Followers may have followers.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mjslq.dynamics.locked_joints import LockedJoints, locked_positions
from mjslq.dynamics.pinocchio.algorithms import Ties
from mjslq.dynamics.pinocchio.models import read_urdf


class Follower(NamedTuple):
    """What a joint follows: position = multiplier * (position of the leader) + offset."""

    leader: str
    multiplier: float
    offset: float


def lock_followers(path: str | Path, joints: LockedJoints | None) -> tuple[dict[str, float], dict[str, Follower]]:
    """Joints to lock and where, with those that mimic a locked one; and the followers that are left, by name.

    The leaders of these do not follow any joint themselves. Fixed joints follow none, and lead to their place.
    Raises ValueError for joints that follow each other.
    """
    locked, (file, root) = locked_positions(joints), read_urdf(path)
    waiting: dict[str, Follower] = {}
    fixed = {joint.get("name", "") for joint in root.findall("joint") if joint.get("type") == "fixed"}
    for joint in root.findall("joint"):
        mimic, name = joint.find("mimic"), joint.get("name", "")
        if mimic is not None and name not in locked and name not in fixed:
            numbers = float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))
            waiting[name] = Follower(mimic.get("joint", ""), *numbers)
    for _ in range(len(waiting)):
        for name, (leader, multiplier, offset) in waiting.items():
            if leader in waiting:
                first, m, o = waiting[leader]
                waiting[name] = Follower(first, multiplier * m, multiplier * o + offset)
    for name, follower in waiting.items():
        if follower.leader in waiting:
            raise ValueError(f"{file.name}: joint {name!r} mimics itself, by way of {follower.leader!r}")
        if follower.leader in locked or follower.leader in fixed:
            locked[name] = follower.multiplier * locked.get(follower.leader, 0.0) + follower.offset
    return locked, {name: follower for name, follower in waiting.items() if name not in locked}


def tie(free: Any, followers: Mapping[str, tuple[str, float, float]]) -> tuple[Any, Ties]:
    """Return a copy of `free` in which `followers` mimic their leaders, and how the two are related.

    The armature of followers becomes their leaders'.

    Raises ValueError for a leader that there is not, or that comes after its follower, and for joints with several
    axes.
    """
    model, names = free, list(free.names)
    for name, (leader, multiplier, offset) in followers.items():
        for joint in (name, leader):
            if joint not in names or free.nvs[free.getJointId(joint)] != 1:
                has = "has several axes" if joint in names else "is not in the model"
                raise ValueError(f"joint {name!r} mimics {leader!r}, but {joint!r} {has}")
        first, second = model.getJointId(leader), model.getJointId(name)
        if first > second:
            raise ValueError(
                f"joint {name!r} mimics {leader!r}, which Pinocchio takes only if {leader!r} comes first; lock one of "
                f'them, or exchange them: <mimic joint="{name}"> in {leader!r}, with multiplier {1.0 / multiplier:g} '
                f"and offset {-offset / multiplier:g}"
            )
        model = pin.transformJointIntoMimic(model, first, second, multiplier, offset)
    T, o, G = np.zeros((free.nq, model.nq)), np.zeros(free.nq), np.zeros((free.nv, model.nv))
    for j in range(1, free.njoints):
        name = names[j]
        leader, multiplier, offset = followers.get(name, (name, 1.0, 0.0))
        k, own_q, own_v = model.getJointId(leader), free.idx_qs[j], free.idx_vs[j]
        for i in range(free.nqs[j]):
            T[own_q + i, model.idx_qs[k] + i], o[own_q + i] = multiplier, offset
        for i in range(free.nvs[j]):
            G[own_v + i, model.idx_vs[k] + i] = multiplier
    ties = Ties(free, T, o, G, followers)
    model.armature = ties.reduced(free.armature)
    return model, ties
