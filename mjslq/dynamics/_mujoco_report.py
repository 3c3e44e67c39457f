"""What a model consists of, and what serves each part: for `mjslq check`."""

from __future__ import annotations

import mujoco

_JOINT_NAMES = {
    mujoco.mjtJoint.mjJNT_FREE: "free joints",
    mujoco.mjtJoint.mjJNT_BALL: "ball joints",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide joints",
    mujoco.mjtJoint.mjJNT_HINGE: "hinge joints",
}
_INTEGRATORS = {
    mujoco.mjtIntegrator.mjINT_EULER: "Euler",
    mujoco.mjtIntegrator.mjINT_IMPLICIT: "implicit",
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST: "implicitfast",
    mujoco.mjtIntegrator.mjINT_DISCRETE: "discrete",
}


def report(model: mujoco.MjModel, differences: str) -> list[tuple[str, str]]:
    """List the parts `model` has as (part, what serves it); `differences` says how the step is linearized."""
    rows = [(f"integrator {_INTEGRATORS[mujoco.mjtIntegrator(model.opt.integrator)]}", differences)]
    for kind, name in _JOINT_NAMES.items():
        number = int((model.jnt_type == kind).sum())
        chart = "quaternion: tangent directions" if kind in (0, 1) else "plain numbers"
        rows.append((f"{number} {name}", chart) if number else ("", ""))
    limited = int(model.actuator_ctrllimited.sum())
    rows.append((f"{model.nu} actuators", f"{limited} with control limits, clamped by MuJoCo"))
    rows.append((f"{model.na} activations", "part of the state") if model.na else ("", ""))
    sensors = f"outputs y, {model.nsensordata} readings; their Jacobians by {differences}"
    rows.append((f"{model.nsensor} sensors", sensors if model.nsensor else "none: costs on states and controls only"))
    for number, name in ((model.neq, "equality constraints"), (model.ntendon, "tendons"), (model.nflex, "flexes")):
        rows.append((f"{number} {name}", differences) if number else ("", ""))
    rows.append(("contacts", differences) if _has_contacts(model) else ("contacts", "none possible"))
    if model.nmocap:
        rows.append((f"{model.nmocap} mocap bodies", "stay where the model has them"))
    return [row for row in rows if row[0]]


def _has_contacts(model: mujoco.MjModel) -> bool:
    """Whether any pair of geoms could touch, as far as bit masks tell."""
    off = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    if model.opt.disableflags & off:
        return False
    types, affinities = set(model.geom_contype.tolist()), set(model.geom_conaffinity.tolist())
    return model.npair > 0 or model.nflex > 0 or any(t & a for t in types for a in affinities)
