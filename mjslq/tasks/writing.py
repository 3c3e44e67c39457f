"""`mjslq new`: a task file to begin with, which lists what the model has and solves as it is.

The task reaches with the tip, the last body of the longest chain, to where it is when all joints have turned a little;
a robot whose base floats, or slides undriven, holds its pose. All names that a user may want to write stand in comments
beside where they go.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjslq.tasks import engines
from mjslq.tasks.reading import Source
from mjslq.tasks.schema import Engine, TaskFile

if TYPE_CHECKING:
    import mujoco

    from mjslq.dynamics.mujoco import MujocoDynamics

STEP = 0.01
"""Length that a step of the horizon has at least, where the model's own is shorter. [s]"""
NEAR = 0.02
"""Part of its range within which a joint is near an end of it."""
TURN, SHIFT = 0.4, 0.1
"""How far joints turn [rad], or slide [m], from the start to the goal; half of what their range leaves at most."""
DURATION = 2.0
"""Length of the motion, about. [s]"""
_WIDTH = 100


def text_for(model: str, folder: Path) -> str:
    """The text of a task file in `folder` for `model`, as a task file names it. Raises ValueError."""
    given = {"model": model, "horizon": 1, "costs": [{"kind": "control", "weight": 1.0}]}
    file = TaskFile.model_validate(given)
    source = Source("", {})
    is_urdf = not model.lower().endswith((".xml", ".mjb")) and not model.startswith(engines.MENAGERIE)
    dynamics: Any = engines.make(file, folder, source)
    if is_urdf:
        extra = {"armature": 0.01, "timestep": STEP}
        dynamics = engines.make(file.model_copy(update={"engine": Engine(**extra)}), folder, source)  # type: ignore[arg-type]
    if dynamics.nu == 0:
        raise ValueError(f"{model} has no actuators, so there is nothing to optimize; add some to the model")
    return _text(model, dynamics, is_urdf)


def _text(model: str, dynamics: MujocoDynamics, is_urdf: bool) -> str:
    h = float(dynamics.model.opt.timestep)
    substeps = max(1, round(STEP / h))
    dt = substeps * h
    lines = [
        f"# {dynamics.name}: {dynamics.nu} controls, {dynamics.nv} velocities; `mjslq solve` solves it.",
        f'model = "{model}"',
        f"horizon = {round(DURATION / dt)}                # steps of substeps * timestep = {dt:g} s",
        "",
        "[engine]",
        f"timestep = {h:g}" + ("" if is_urdf else "             # the model's own"),
        f"substeps = {substeps}                 # simulator steps that a control is held for",
    ]
    if is_urdf:
        lines.append("armature = 0.01              # rotor inertia, which URDF has not [kg m^2 or kg]")
        lines.append("self_contacts = false        # links of URDF files often overlap")
        lines.append("# floating = true            # free the base, for robots that walk, fly or swim")
        lines.append('# floor = true               # a ground to stand on; contact = "smooth" makes it easier')
    lines += ["", "[start]", *_start(dynamics), ""]
    lines += _costs(dynamics)
    lines += ["", *_constraints(dynamics), "", "[solve]", 'method = "auto"', "# max_iterations = 300", ""]
    return "\n".join(lines)


def _start(dynamics: MujocoDynamics) -> list[str]:
    """The start: the first keyframe where there is one."""
    keyframes = dynamics.keyframe_names
    nq = dynamics.model.nq
    lines = [*_comment("keyframes", keyframes), *_comment("positions", dynamics.state_names[:nq])]
    if keyframes:
        lines.append(f"keyframe = {_quoted(keyframes[0])}")
    outside = {} if keyframes else _outside(dynamics)
    if outside:
        entries = ", ".join(f"{_quoted(name)} = {value:.4g}" for name, value in outside.items())
        lines.append(f"positions = {{ {entries} }}  # the middle of their ranges")
    else:
        lines.append(f"# positions = {{ {_quoted(dynamics.state_names[0])} = 0.1 }}")
    lines.append('controls = "hold"            # balance the start; "zero", "keyframe" or a list')
    return lines


def _costs(dynamics: MujocoDynamics) -> list[str]:
    """Effort, speed at the end, and a reach or a pose to hold."""
    named = [f"{n} [{a:g}, {b:g}]" for n, (a, b) in zip(dynamics.control_names, dynamics.control_limits, strict=True)]
    lines = [
        *_comment("controls, with their limits", named),
        "[[costs]]",
        'kind = "control"',
        f"weight = {_effort(dynamics):.1g}",
        "",
    ]
    model, data = dynamics.model, _at_start(dynamics)
    tip = _tip(model, data)
    if tip is None:
        return [*lines, "[[costs]]", 'kind = "state"               # hold the start', "weight = 1.0", 'when = "always"']
    kind, name = tip
    position = _position(data, kind, name)
    _turn(dynamics, data)
    goal = _position(data, kind, name)
    frames = [model.site(i).name for i in range(model.nsite)] + [model.body(i).name for i in range(1, model.nbody)]
    sensors = [name for name in dynamics.outputs]
    return [
        *lines,
        *_comment("sites and bodies", frames),
        *_comment('sensors, for kind = "sensor"', sensors),
        "[[costs]]",
        f'kind = "frame"               # {kind} {name!r}, now at {_rounded(position)}',
        f"name = {_quoted(name)}",
        f"target = {_rounded(goal)}",
        "weight = 1000.0",
        'when = "terminal"',
        "",
        "[[costs]]",
        'kind = "joints"              # keep near the pose of the start, away from the joints\' ends',
        'target = "start"',
        "weight = 1.0",
        "",
        "[[costs]]",
        'kind = "velocities"          # move smoothly, and come to rest',
        "weight = 0.1",
        'when = "always"',
        "terminal_weight = 1.0",
    ]


def _constraints(dynamics: MujocoDynamics) -> list[str]:
    """Limits that hold without a word, and those that can be asked for."""
    lines = ["[bounds]", 'u = "model"                  # the limits of the controls hold exactly']
    ranges = [f"{name} [{a:g}, {b:g}]" for name, (a, b) in dynamics.joint_ranges.items()]
    if ranges:
        lines += ["", *_comment("joint ranges", ranges), "# [[constraints]]", '# kind = "joints"', '# limits = "model"']
    return lines


def _effort(dynamics: MujocoDynamics) -> float:
    """A weight under which controls at their limits cost about 1."""
    widest = np.abs(np.where(np.isfinite(dynamics.control_limits), dynamics.control_limits, 0.0)).max(initial=0.0)
    return 1e-2 if widest == 0.0 else float(min(1.0, 1.0 / widest**2))


def _outside(dynamics: MujocoDynamics) -> dict[str, float]:
    """Joints whose reference position lies outside of their range, or near its end, and the middle of it.

    None of a robot that floats: it may stand, and would no longer.
    """
    if _floats(dynamics.model):
        return {}
    x0, names = dynamics.initial_state, list(dynamics.state_names)

    def inside(q: float, low: float, high: float) -> bool:
        return low + NEAR * (high - low) < q < high - NEAR * (high - low)

    ranges = dynamics.joint_ranges.items()
    return {name: (a + b) / 2.0 for name, (a, b) in ranges if not inside(x0[names.index(name)], a, b)}


def _at_start(dynamics: MujocoDynamics) -> Any:
    """The model's poses at the start."""
    import mujoco

    data, names = mujoco.MjData(dynamics.model), list(dynamics.state_names)
    x0 = dynamics.keyframe(dynamics.keyframe_names[0]) if dynamics.keyframe_names else dynamics.initial_state
    data.qpos[:] = x0[: dynamics.model.nq]
    for name, value in {} if dynamics.keyframe_names else _outside(dynamics).items():
        data.qpos[names.index(name)] = value
    mujoco.mj_kinematics(dynamics.model, data)
    return data


def _turn(dynamics: MujocoDynamics, data: Any) -> None:
    """Move all joints with one axis from where they are."""
    import mujoco

    names, model = list(dynamics.state_names), dynamics.model
    speeds = names[model.nq : model.nq + model.nv]
    for j in range(model.njnt):
        kind, at = mujoco.mjtJoint(model.jnt_type[j]), int(model.jnt_qposadr[j])
        if f"{names[at]}.vel" in speeds:
            move = TURN if kind == mujoco.mjtJoint.mjJNT_HINGE else SHIFT
            _, upper = dynamics.joint_ranges.get(names[at], (-np.inf, np.inf))
            data.qpos[at] += min(move, max(0.0, (upper - data.qpos[at]) / 2.0))
    mujoco.mj_kinematics(model, data)


def _position(data: Any, kind: str, name: str) -> Any:
    """Where a site or a body is. Shape (3,). [m]"""
    return (data.site(name) if kind == "site" else data.body(name)).xpos.copy()


def _tip(model: mujoco.MjModel, data: Any) -> tuple[str, str] | None:
    """The named end of the longest chain: its kind and name; None for a floating base.

    Where a chain ends in several fingers, its end is what carries them; of several legs, the end of one.
    """
    if _floats(model):
        return None
    parents, joints, length = model.body_parentid, _driven(model), np.zeros(model.nbody)
    for b in range(1, model.nbody):
        joints[b] += joints[parents[b]]
        if joints[parents[b]]:
            length[b] = length[parents[b]] + np.linalg.norm(data.xpos[b] - data.xpos[parents[b]])
    last = end = int(joints.argmax())
    while joints[end] and not _is_alone(end, joints, parents):
        end = parents[end]
    if not joints[end]:  # nothing carries all the chains, as with the legs of a base that stands still
        end = last
    named = [b for b in range(1, model.nbody) if joints[b] == joints[end] and model.body(b).name]
    if not joints[end] or not named:
        return None
    body = max(named, key=lambda b: length[b])
    sites = [s for s in range(model.nsite) if model.site_bodyid[s] == body and model.site(s).name]
    if sites:
        return "site", model.site(sites[0]).name
    return "body", model.body(body).name


def _floats(model: mujoco.MjModel) -> bool:
    """Whether what carries actuated joints can go away: on a free joint, or on slides that nothing drives."""
    import mujoco

    if (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any():
        return True
    driven = set(model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT, 0])
    slides = {int(model.jnt_bodyid[j]) for j in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
              if j not in driven}  # fmt: skip
    return any(_is_above(body, int(model.jnt_bodyid[j]), model.body_parentid) for body in slides for j in driven)


def _driven(model: mujoco.MjModel) -> Any:
    """How many of its joints with one axis an actuator drives, for each body."""
    import mujoco

    found = np.zeros(model.nbody, int)
    at_joints = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    for j in np.unique(model.actuator_trnid[at_joints, 0]):
        found[model.jnt_bodyid[j]] += 1
    return found


def _is_alone(body: int, joints: Any, parents: Any) -> bool:
    """Whether no other chain has as many joints as the one that ends in this body."""
    for other in map(int, np.flatnonzero(joints == joints[body])):
        if not (_is_above(other, body, parents) or _is_above(body, other, parents)):
            return False
    return True


def _is_above(body: int, other: int, parents: Any) -> bool:
    while other > 0 and other != body:
        other = parents[other]
    return bool(other == body)


def _comment(title: str, names: Any) -> list[str]:
    """Names as comment lines no longer than a screen; nothing where there are none."""
    if not names:
        return []
    lines = [f"# {title}:"]
    for name in names:
        if len(lines[-1]) + len(name) > _WIDTH:
            lines.append("#  ")
        lines[-1] += f" {name},"
    lines[-1] = lines[-1].rstrip(",")
    return lines


def _quoted(name: str) -> str:
    import json

    return json.dumps(name, ensure_ascii=False)


def _rounded(values: Any) -> str:
    return "[" + ", ".join(f"{value:g}" for value in np.round(values, 3) + 0.0) + "]"
